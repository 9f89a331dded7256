//! Samples a triangle seen from a point: uniformly over its area where it is small, uniformly
//! over the solid angle it spans where it is not. Never looks at which side emits.
//!
//! The spherical sampler cuts the triangle's solid angle by a great circle through one vertex, as
//! Arvo 1995 does, but from the half-angle tangent of Van Oosterom and Strackee 1983 instead of
//! the three interior angles: one arctangent and one sine-cosine pair, and no cancellation in
//! α + β + γ − π (compare Peters 2021, §4).

use super::{ShapeSample, per_solid_angle};
use crate::math::warp::uniform_triangle;
use glam::{Vec2, Vec3};

/// Squared ratio of the longest edge to the distance below which area sampling is used. At the bound
/// an edge is 0.7 of the distance and 1/d² varies by some two thirds over the shape; the solid
/// angle's own sampling costs five times as much, 8 % of a render of the peers' scene a.
pub(super) const SMALL: f32 = 0.5;
/// Solid angles [sr] below this lose their digits to the vertices' own rounding.
const OMEGA_MIN: f32 = 3e-4;
/// Solid angles [sr] above this mean a point all but on the triangle, near the hemisphere's 2π.
const OMEGA_MAX: f32 = 6.22;

/// A triangle around a point, ready for sampling by solid angle.
pub(super) struct Spherical {
    lengths: Vec3,
    ab: f32,
    bc: f32,
    ca: f32,
    det: f32,
    /// Solid angle in steradians.
    pub(super) omega: f32,
}

impl Spherical {
    /// `r` are the vertices relative to the point, `cross` is the product of the edges.
    #[inline]
    pub(super) fn new(r: [Vec3; 3], cross: Vec3) -> Self {
        let lengths = Vec3::new(r[0].length(), r[1].length(), r[2].length());
        let inverse = lengths.recip();
        let ab = r[0].dot(r[1]) * inverse.x * inverse.y;
        let bc = r[1].dot(r[2]) * inverse.y * inverse.z;
        let ca = r[2].dot(r[0]) * inverse.z * inverse.x;
        let det = r[0].dot(cross).abs() * inverse.x * inverse.y * inverse.z;
        Self { lengths, ab, bc, ca, det, omega: 2.0 * det.atan2(1.0 + ab + bc + ca) }
    }

    /// Barycentric coordinates of a point uniform in solid angle.
    #[inline]
    pub(super) fn sample(&self, u: Vec2) -> Vec3 {
        let (sin, cos) = (0.5 * u.x * self.omega).sin_cos();
        // The half vector of a and c', the point on the arc from a to c where the triangle
        // a b c' spans u.x of the solid angle; c' mirrors a about it.
        let ha = self.det * cos - (self.bc + self.ca) * sin;
        let hc = (1.0 + self.ab) * sin;
        let f = 2.0 * (ha + hc * self.ca) / (ha * ha + 2.0 * ha * hc * self.ca + hc * hc);
        let (ca, cc) = (f * ha - 1.0, f * hc);
        // Uniform in the cosine along the arc from b to c'.
        let end = (ca * self.ab + cc * self.bc).clamp(-1.0, 1.0);
        let s = 1.0 - u.y * (1.0 - end);
        let t = (u.y * (1.0 + s) / (1.0 + end).max(f32::MIN_POSITIVE)).sqrt();
        // The direction is a non-negative combination of the vertices, and so is the point.
        let w = (Vec3::new(t * ca, s - t * end, t * cc) / self.lengths).max(Vec3::ZERO);
        w / w.element_sum()
    }

    /// Whether sampling by solid angle is exact enough.
    #[inline]
    pub(super) fn serves(&self) -> bool {
        (OMEGA_MIN..=OMEGA_MAX).contains(&self.omega)
    }
}

/// The choice between the two methods, from the geometry alone.
#[inline]
fn spherical(p: Vec3, v: [Vec3; 3], cross: Vec3) -> Option<Spherical> {
    let r = [v[0] - p, v[1] - p, v[2] - p];
    let longest = (v[1] - v[0])
        .length_squared()
        .max((v[2] - v[0]).length_squared())
        .max((v[2] - v[1]).length_squared());
    let centre = (r[0] + r[1] + r[2]) * (1.0 / 3.0);
    if longest < SMALL * centre.length_squared() {
        return None;
    }
    Some(Spherical::new(r, cross)).filter(Spherical::serves)
}

/// A point of the triangle as seen from `p`; `b0` and `b1` are the weights of `v0` and `v1`. `None`
/// where the triangle has no area or is seen edge-on.
#[inline]
#[must_use]
pub fn sample(p: Vec3, v0: Vec3, v1: Vec3, v2: Vec3, u: Vec2) -> Option<ShapeSample> {
    let cross = (v1 - v0).cross(v2 - v0);
    let twice_area = cross.length();
    let n = cross / twice_area;
    if let Some(s) = spherical(p, [v0, v1, v2], cross) {
        let b = s.sample(u);
        let point = v0 * b.x + v1 * b.y + v2 * b.z;
        return point.is_finite().then_some(ShapeSample {
            point,
            n,
            pdf_solid_angle: 1.0 / s.omega,
            b0: b.x,
            b1: b.y,
        });
    }
    let (b0, b1) = uniform_triangle(u);
    let point = v0 * b0 + v1 * b1 + v2 * (1.0 - b0 - b1);
    let pdf_solid_angle = per_solid_angle(2.0 / twice_area, point - p, n)?;
    Some(ShapeSample { point, n, pdf_solid_angle, b0, b1 })
}

/// Density [1/sr] with which [`sample`] chooses, from `p`, the direction that meets the triangle
/// at `distance` under the cosine `cos` (of either sign).
#[inline]
#[must_use]
pub fn pdf(p: Vec3, v0: Vec3, v1: Vec3, v2: Vec3, distance: f32, cos: f32) -> f32 {
    let cross = (v1 - v0).cross(v2 - v0);
    match spherical(p, [v0, v1, v2], cross) {
        Some(s) => 1.0 / s.omega,
        None => 2.0 * distance * distance / (cos.abs() * cross.length()),
    }
}

/// Solid angle in steradians of a triangle, 0 to 2π (Van Oosterom and Strackee 1983).
#[must_use]
pub fn solid_angle(p: Vec3, v0: Vec3, v1: Vec3, v2: Vec3) -> f32 {
    Spherical::new([v0 - p, v1 - p, v2 - p], (v1 - v0).cross(v2 - v0)).omega
}

#[cfg(test)]
mod tests {
    use super::super::analytic::polygon_irradiance;
    use super::super::testing::{Rng, check_irradiance, check_shape, hit_triangle};
    use super::*;
    use std::f32::consts::{FRAC_PI_2, PI};

    fn directions(p: Vec3, v: [Vec3; 3]) -> impl Fn(Vec3) -> f32 {
        move |w| {
            hit_triangle(p, w, v).map_or(0.0, |t| {
                let n = (v[1] - v[0]).cross(v[2] - v[0]).normalize();
                pdf(p, v[0], v[1], v[2], t, n.dot(w))
            })
        }
    }

    fn cases() -> Vec<(Vec3, [Vec3; 3])> {
        let v = [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.5, -0.5, 0.2), Vec3::new(0.1, 1.0, -0.3)];
        vec![
            (Vec3::new(0.1, 0.1, 30.0), v),
            (Vec3::new(0.3, -0.2, 2.0), v),
            (Vec3::new(0.2, 0.0, 0.3), v),
            (Vec3::new(3.0, 0.0, 0.4), v),
            (Vec3::new(0.0, 0.0, -6.0), v),
            (
                Vec3::new(0.2, 0.3, 1.0),
                [Vec3::new(-4.0, 0.0, 0.0), Vec3::new(4.0, 0.1, 0.0), Vec3::new(0.0, 0.3, 0.0)],
            ),
        ]
    }

    #[test]
    fn an_octant_spans_half_pi() {
        let o = solid_angle(Vec3::ZERO, Vec3::X * 3.0, Vec3::Y * 0.5, Vec3::Z);
        assert!((o - FRAC_PI_2).abs() < 1e-6, "{o}");
        let far = solid_angle(Vec3::Z * 100.0, Vec3::ZERO, Vec3::X, Vec3::Y);
        assert!((far / 0.5e-4 - 1.0).abs() < 1e-3, "{far}");
        let on = Vec3::new(0.2, 0.2, 1e-4);
        assert!((solid_angle(on, Vec3::ZERO, Vec3::X, Vec3::Y) - 2.0 * PI).abs() < 5e-3);
    }

    #[test]
    fn directions_follow_the_density() {
        for (i, (p, v)) in cases().into_iter().enumerate() {
            check_shape(&format!("triangle {i}"), p, |u| sample(p, v[0], v[1], v[2], u), directions(p, v));
        }
    }

    #[test]
    fn irradiance_is_lamberts() {
        for (i, (p, v)) in cases().into_iter().enumerate() {
            let n = (v[0] + v[1] + v[2] - 3.0 * p).normalize();
            let known = polygon_irradiance(p, n, &v);
            check_irradiance(&format!("triangle {i}"), p, n, known, |u| sample(p, v[0], v[1], v[2], u));
        }
    }

    #[test]
    fn degenerate_triangles_give_nothing() {
        let p = Vec3::ZERO;
        assert_eq!(sample(p, Vec3::X, Vec3::X, Vec3::X, Vec2::splat(0.3)), None);
        assert_eq!(sample(p, Vec3::X, Vec3::X * 2.0, Vec3::X * 3.0, Vec2::splat(0.3)), None);
        // Edge-on.
        assert_eq!(sample(p, Vec3::X, Vec3::X * 2.0, Vec3::X + Vec3::Y, Vec2::splat(0.3)), None);
    }

    #[test]
    fn extreme_triangles_stay_finite_and_consistent() {
        let mut rng = Rng::new(11);
        for _ in 0..200_000 {
            let scale = 10f32.powf(rng.f32() * 10.0 - 5.0);
            let mut v = || (Vec3::new(rng.f32(), rng.f32(), rng.f32()) - 0.5) * scale;
            let (v0, v1, v2) = (v(), v(), v());
            let p = Vec3::new(rng.f32(), rng.f32(), rng.f32()) - 0.5;
            if let Some(s) = sample(p, v0, v1, v2, rng.vec2()) {
                let d = s.point - p;
                let again = pdf(p, v0, v1, v2, d.length(), s.n.dot(d.normalize()));
                assert!(s.point.is_finite() && s.pdf_solid_angle > 0.0 && s.pdf_solid_angle.is_finite());
                // Edge-on, the cosine itself is rounding.
                let edge_on = s.n.dot(d.normalize()).abs() < 1e-3;
                assert!(edge_on || (again / s.pdf_solid_angle - 1.0).abs() < 1e-3, "{again} {s:?}");
                assert!(s.b0 >= 0.0 && s.b1 >= 0.0 && s.b0 + s.b1 <= 1.0 + 1e-6);
            }
        }
    }
}
