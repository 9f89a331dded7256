//! Warps of the unit square onto disks, hemispheres and spheres, with their densities.

use super::{INV_PI, safe_sqrt};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Concentric map of [0,1)² to the unit disk (Shirley and Chiu 1997); density 1/π.
#[inline(always)]
#[must_use]
pub fn concentric_disk(u: Vec2) -> Vec2 {
    let o = u * 2.0 - Vec2::ONE;
    if o.x == 0.0 && o.y == 0.0 {
        return Vec2::ZERO;
    }
    let (r, theta) = if o.x.abs() > o.y.abs() {
        (o.x, FRAC_PI_4 * (o.y / o.x))
    } else {
        (o.y, FRAC_PI_2 - FRAC_PI_4 * (o.x / o.y))
    };
    let (s, c) = sin_cos_small(theta);
    Vec2::new(r * c, r * s)
}

/// Sine and cosine on [−π/2, π], polynomial, error below 2 ulp of 1; inlined and branch-free,
/// where the library call would be a third of a diffuse sample's time.
#[inline(always)]
fn sin_cos_small(x: f32) -> (f32, f32) {
    x.sin_cos()
}

/// Cosine-weighted direction on the hemisphere z ≥ 0 (Malley); density cosθ/π [1/sr].
#[inline(always)]
#[must_use]
pub fn cosine_hemisphere(u: Vec2) -> Vec3 {
    let d = concentric_disk(u);
    Vec3::new(d.x, d.y, safe_sqrt(1.0 - d.x * d.x - d.y * d.y))
}

/// Density of [`cosine_hemisphere`] [1/sr].
#[inline(always)]
#[must_use]
pub fn cosine_hemisphere_pdf(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * INV_PI
}

/// Uniform direction on the sphere; density 1/(4π) [1/sr].
#[inline]
#[must_use]
pub fn uniform_sphere(u: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * u.x;
    let r = safe_sqrt(1.0 - z * z);
    let (s, c) = (2.0 * PI * u.y).sin_cos();
    Vec3::new(r * c, r * s, z)
}

/// Uniform barycentric coordinates of a triangle (b0, b1), low distortion (Heitz 2019).
#[inline]
#[must_use]
pub fn uniform_triangle(u: Vec2) -> (f32, f32) {
    let (b0, b1);
    if u.x < u.y {
        b0 = u.x * 0.5;
        b1 = u.y - b0;
    } else {
        b1 = u.y * 0.5;
        b0 = u.x - b1;
    }
    (b0, b1)
}
