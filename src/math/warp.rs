//! Warps of the unit square onto disks, hemispheres and spheres, with their densities.

use super::{INV_PI, safe_sqrt};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_PI_4, PI};

/// Concentric map of [0,1)² to the unit disk (Shirley and Chiu 1997); density 1/π.
#[inline(always)]
#[must_use]
pub fn concentric_disk(u: Vec2) -> Vec2 {
    let o = u * 2.0 - Vec2::ONE;
    // θ = π/4·y/x, or π/2 − π/4·x/y, whose sine and cosine are those of π/4·x/y exchanged.
    let wide = o.x.abs() > o.y.abs();
    let (x, y) = (o.x.to_bits(), o.y.to_bits());
    let exchanged = (x ^ y) & u32::from(!wide).wrapping_neg();
    let (r, other) = (f32::from_bits(x ^ exchanged), f32::from_bits(y ^ exchanged));
    let (s, c) = sin_cos_eighth(FRAC_PI_4 * (other / r));
    // Selected by mask: half of all points take either side, which no predictor can learn.
    let (s, c) = ((r * s).to_bits(), (r * c).to_bits());
    let exchanged = (s ^ c) & u32::from(!wide).wrapping_neg();
    let at = Vec2::new(f32::from_bits(c ^ exchanged), f32::from_bits(s ^ exchanged));
    // The centre divides zero by zero above. Chosen at the end, so that loops become SIMD.
    if (o.x == 0.0) & (o.y == 0.0) { Vec2::ZERO } else { at }
}

/// Sine and cosine on [−π/4, π/4] by Taylor polynomials: the first terms left out are 2e-9 and
/// 3e-8, below the rounding of the result. Inlined and branch-free, where the library call would
/// be a third of a diffuse sample's time, and the same on every platform, where that is not.
#[inline(always)]
#[must_use]
pub fn sin_cos_eighth(x: f32) -> (f32, f32) {
    let x2 = x * x;
    let s = 1.0 + x2 * (-1.0 / 6.0 + x2 * (1.0 / 120.0 + x2 * (-1.0 / 5040.0 + x2 * (1.0 / 362_880.0))));
    let c = 1.0 + x2 * (-0.5 + x2 * (1.0 / 24.0 + x2 * (-1.0 / 720.0 + x2 * (1.0 / 40320.0))));
    (x * s, c)
}

/// Sine and cosine of 2πu for u in [0, 1]; error below 2e-7. Without branches: the quadrant of a
/// random angle is what no predictor can learn.
#[inline(always)]
#[must_use]
pub fn sin_cos_turns(u: f32) -> (f32, f32) {
    let quadrant = (u * 4.0 + 0.5) as i32;
    let (s, c) = sin_cos_eighth((u - quadrant as f32 * 0.25) * (2.0 * PI));
    let quadrant = quadrant as u32;
    let (s, c) = (s.to_bits(), c.to_bits());
    // All ones where sine and cosine change places; then the signs, bit 31.
    let exchanged = (s ^ c) & (quadrant & 1).wrapping_neg();
    let sine = (s ^ exchanged) ^ ((quadrant & 2) << 30);
    let cosine = (c ^ exchanged) ^ (((quadrant + 1) & 2) << 30);
    (f32::from_bits(sine), f32::from_bits(cosine))
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
