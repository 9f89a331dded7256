//! A surface placed by an affine transform: carries points, normals and densities per area from
//! object to world space. Knows no particular surface.

use super::{ShapeSample, per_solid_angle};
use crate::math::Transform;
use glam::{Mat3, Vec2, Vec3};

/// An affine placement in f32.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    m: Mat3,
    inv: Mat3,
    origin: Vec3,
    det: f32,
}

impl Placed {
    /// `None` where the transform is singular in f32 or has perspective.
    pub(super) fn new(t: &Transform) -> Option<Self> {
        let linear = |m: glam::DMat4| glam::DMat3::from_mat4(m);
        let affine = t.m.row(3) == glam::DVec4::W;
        let placed = Self {
            m: linear(t.m).as_mat3(),
            inv: linear(t.inv).as_mat3(),
            origin: t.m.w_axis.truncate().as_vec3(),
            det: linear(t.m).determinant().abs() as f32,
        };
        let finite = placed.m.is_finite() && placed.inv.is_finite() && placed.origin.is_finite();
        (affine && finite && placed.det > 0.0 && placed.det.is_finite()).then_some(placed)
    }

    pub(super) fn origin(&self) -> Vec3 {
        self.origin
    }

    /// The scale of a transform that keeps all shapes similar; `None` for any other.
    pub(super) fn uniform_scale(&self) -> Option<f32> {
        let gram = self.m.transpose() * self.m;
        let s2 = (gram.x_axis.x + gram.y_axis.y + gram.z_axis.z) / 3.0;
        // Rotations composed in f64 and rounded once stay far inside; a visible stretch does not.
        let off = (gram - Mat3::from_diagonal(Vec3::splat(s2))).abs();
        let off = off.x_axis.max(off.y_axis).max(off.z_axis).max_element();
        (off <= 1e-5 * s2).then(|| s2.sqrt())
    }

    #[inline]
    pub(super) fn point_to_object(&self, p: Vec3) -> Vec3 {
        self.inv * (p - self.origin)
    }

    /// World normal, not normalised: its length times `det` is the growth of area there.
    #[inline]
    fn normal(&self, n: Vec3) -> Vec3 {
        self.inv.transpose() * n
    }

    /// World area per object area where the unit object normal is `n`.
    pub(super) fn area_scale(&self, n: Vec3) -> f32 {
        self.det * self.normal(n).length()
    }

    /// The sample at `point` with unit normal `n`, both in object space, chosen there with
    /// `pdf_area`, as seen from the world point `p`.
    #[inline]
    pub(super) fn sample(
        &self,
        p: Vec3,
        point: Vec3,
        n: Vec3,
        pdf_area: f32,
        parameters: Vec2,
    ) -> Option<ShapeSample> {
        let point = self.m * point + self.origin;
        let normal = self.normal(n);
        let stretch = normal.length();
        let n = normal / stretch;
        let pdf_solid_angle = per_solid_angle(pdf_area / (self.det * stretch), point - p, n)?;
        Some(ShapeSample { point, n, pdf_solid_angle, b0: parameters.x, b1: parameters.y })
    }

    /// The density of [`Placed::sample`] for a world point `hit`; 0 where it would be refused.
    #[inline]
    pub(super) fn pdf(&self, p: Vec3, hit: Vec3, n: Vec3, pdf_area: f32) -> f32 {
        let normal = self.normal(n);
        let stretch = normal.length();
        per_solid_angle(pdf_area / (self.det * stretch), hit - p, normal / stretch).unwrap_or(0.0)
    }
}

/// What spheres, disks and cylinders share: their placement and their sweep in radians. `None` where
/// nothing is swept, the radius is not positive and finite, or the transform cannot be inverted.
pub(super) fn swept(object_to_world: &Transform, radius: f32, phi_max_degrees: f32) -> Option<(Placed, f32)> {
    let placed = Placed::new(object_to_world)?;
    // As pbrt clamps what is outside (0°, 360°].
    let phi_max = phi_max_degrees.clamp(0.0, 360.0).to_radians();
    (radius > 0.0 && radius.is_finite() && phi_max > 0.0).then_some((placed, phi_max))
}
