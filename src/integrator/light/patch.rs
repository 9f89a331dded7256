//! Samples an emitting bilinear patch over its area: (u, v) by the bilinear interpolation of the
//! area element at the corners, which is exact for flat patches. Never intersects.

use super::{ShapeSample, per_solid_angle};
use glam::{Vec2, Vec3, Vec4};

/// Four corners: P(u, v) with `p00`, `p10` at u = 1, `p01` at v = 1, `p11`.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    p00: Vec3,
    p10: Vec3,
    p01: Vec3,
    p11: Vec3,
    /// Area elements at the corners, in that order; a small share of the largest is added so that
    /// no part of a patch with a collapsed corner goes unsampled.
    w: Vec4,
}

/// x in [0, 1] with density ∝ (1 − x) a + x b.
#[inline]
fn sample_linear(u: f32, a: f32, b: f32) -> f32 {
    let root = (a * a * (1.0 - u) + b * b * u).sqrt();
    (u * (a + b) / (a + root).max(f32::MIN_POSITIVE)).min(1.0)
}

impl Patch {
    /// `None` where it has no area at all or is not finite.
    #[must_use]
    pub fn new(p00: Vec3, p10: Vec3, p01: Vec3, p11: Vec3) -> Option<Self> {
        let mut patch = Self { p00, p10, p01, p11, w: Vec4::ZERO };
        let at = |u: f32, v: f32| patch.element(Vec2::new(u, v)).length();
        let w = Vec4::new(at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0), at(1.0, 1.0));
        // A twisted patch may have all corner elements zero, yet area in the middle.
        let top = w.max_element().max(at(0.5, 0.5));
        patch.w = w + 1e-3 * top;
        (top > 0.0 && top.is_finite() && patch.w.is_finite()).then_some(patch)
    }

    /// ∂P/∂u × ∂P/∂v.
    #[inline]
    fn element(&self, uv: Vec2) -> Vec3 {
        let du = (self.p10 - self.p00).lerp(self.p11 - self.p01, uv.y);
        let dv = (self.p01 - self.p00).lerp(self.p11 - self.p10, uv.x);
        du.cross(dv)
    }

    /// The point at (u, v).
    #[inline]
    #[must_use]
    pub fn point(&self, uv: Vec2) -> Vec3 {
        self.p00.lerp(self.p10, uv.x).lerp(self.p01.lerp(self.p11, uv.x), uv.y)
    }

    /// Area, by the midpoint rule.
    #[must_use]
    pub fn area(&self) -> f32 {
        const N: usize = 32;
        let at = |i: usize| Vec2::new((i % N) as f32 + 0.5, (i / N) as f32 + 0.5) / N as f32;
        (0..N * N).map(|i| self.element(at(i)).length()).sum::<f32>() / (N * N) as f32
    }

    /// The flat parallelogram that the patch is, if it is one: that one samples by solid angle.
    #[must_use]
    pub fn as_parallelogram(&self) -> Option<super::parallelogram::Parallelogram> {
        let (e0, e1) = (self.p10 - self.p00, self.p01 - self.p00);
        let size = e0.abs().max(e1.abs()).max_element();
        let far = self.p00.abs().max(self.p11.abs()).max_element();
        let off = (self.p00 + e0 + e1 - self.p11).abs().max_element();
        (off <= 1e-5 * size + 4.0 * f32::EPSILON * far)
            .then(|| super::parallelogram::Parallelogram::new(self.p00, e0, e1))
            .flatten()
    }

    #[inline]
    fn pdf_uv(&self, uv: Vec2) -> f32 {
        let w = self.w;
        let low = w.x + uv.x * (w.y - w.x);
        let high = w.z + uv.x * (w.w - w.z);
        4.0 * (low + uv.y * (high - low)) / w.element_sum()
    }

    /// A point of the patch as seen from `p`, normal along ∂P/∂u × ∂P/∂v; (`b0`, `b1`) is (u, v).
    /// `None` where it is seen edge-on or the patch is collapsed there.
    #[inline]
    #[must_use]
    pub fn sample(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        let w = self.w;
        let y = sample_linear(u.y, w.x + w.y, w.z + w.w);
        let x = sample_linear(u.x, w.x + y * (w.z - w.x), w.y + y * (w.w - w.y));
        let uv = Vec2::new(x, y);
        let element = self.element(uv);
        let length = element.length();
        let (point, n) = (self.point(uv), element / length);
        let pdf_solid_angle = per_solid_angle(self.pdf_uv(uv) / length, point - p, n)?;
        Some(ShapeSample { point, n, pdf_solid_angle, b0: x, b1: y })
    }

    /// Density [1/sr] with which [`Patch::sample`] chooses, from `p`, the surface point at `uv`.
    #[inline]
    #[must_use]
    pub fn pdf(&self, p: Vec3, uv: Vec2) -> f32 {
        let element = self.element(uv);
        let length = element.length();
        per_solid_angle(self.pdf_uv(uv) / length, self.point(uv) - p, element / length).unwrap_or(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::analytic::polygon_irradiance;
    use super::super::testing::{Rng, Z_LIMIT, check_irradiance, chi_squared_z};
    use super::*;

    #[test]
    fn irradiance_of_a_flat_quadrilateral_is_lamberts() {
        let [a, b, c, d] = [
            Vec3::new(-1.0, -1.0, 2.0),
            Vec3::new(1.0, -0.8, 2.0),
            Vec3::new(0.3, 0.9, 2.0),
            Vec3::new(-0.4, 0.7, 2.0),
        ];
        let patch = Patch::new(a, b, d, c).expect("area");
        let known = polygon_irradiance(Vec3::ZERO, Vec3::Z, &[a, b, c, d]);
        check_irradiance("patch", Vec3::ZERO, Vec3::Z, known, |u| patch.sample(Vec3::ZERO, u));
        // A triangle: two corners in one.
        let patch = Patch::new(a, b, d, d).expect("area");
        let known = polygon_irradiance(Vec3::ZERO, Vec3::Z, &[a, b, d]);
        check_irradiance("triangle patch", Vec3::ZERO, Vec3::Z, known, |u| patch.sample(Vec3::ZERO, u));
        assert!(patch.as_parallelogram().is_none());
        assert!(Patch::new(a, b, a + d, b + d).expect("area").as_parallelogram().is_some());
        assert!(Patch::new(a, a, a, a).is_none());
    }

    #[test]
    fn a_twisted_patch_is_sampled_by_its_density() {
        let patch = Patch::new(
            Vec3::ZERO,
            Vec3::new(2.0, 0.0, 0.5),
            Vec3::new(0.0, 1.0, -1.0),
            Vec3::new(1.0, 3.0, 2.0),
        );
        let patch = patch.expect("area");
        let p = Vec3::new(0.3, 0.2, 9.0);
        const N: usize = 16;
        const COUNT: usize = 200_000;
        let mut rng = Rng::new(1);
        let mut observed = vec![0.0; N * N];
        for _ in 0..COUNT {
            let s = patch.sample(p, rng.vec2()).expect("not edge-on");
            let bin = |x: f32| ((x * N as f32) as usize).min(N - 1);
            observed[bin(s.b1) * N + bin(s.b0)] += 1.0;
            assert!((patch.pdf(p, Vec2::new(s.b0, s.b1)) / s.pdf_solid_angle - 1.0).abs() < 1e-5);
        }
        // Expected: solid-angle density times solid angle per (u, v), by midpoints.
        let mut expected = vec![0.0; N * N];
        const SUB: usize = 8;
        let step = 1.0 / (N * SUB) as f32;
        for i in 0..(N * SUB) * (N * SUB) {
            let (x, y) = (i % (N * SUB), i / (N * SUB));
            let uv = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) * step;
            let to = patch.point(uv) - p;
            let omega = patch.element(uv).dot(to).abs() / to.length().powi(3) * step * step;
            expected[y / SUB * N + x / SUB] += f64::from(patch.pdf(p, uv) * omega) * COUNT as f64;
        }
        let mass: f64 = expected.iter().sum::<f64>() / COUNT as f64;
        assert!((mass - 1.0).abs() < 1e-4, "{mass}");
        assert!(chi_squared_z(&observed, &expected) < Z_LIMIT);
    }
}
