//! Affine transforms with their inverse, composed in f64 and applied in f32 or f64.

use glam::{DMat4, DVec3, Vec3};

/// A transform and its inverse. Composed in f64, so that a deep stack of transforms loses
/// nothing an f32 vertex could notice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform {
    /// Forward.
    pub m: DMat4,
    /// Inverse.
    pub inv: DMat4,
}

impl Default for Transform {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Transform {
    /// The identity.
    pub const IDENTITY: Self = Self { m: DMat4::IDENTITY, inv: DMat4::IDENTITY };

    /// From a matrix; `None` where it has no finite inverse.
    #[must_use]
    pub fn from_matrix(m: DMat4) -> Option<Self> {
        let inv = m.inverse();
        (m.is_finite() && inv.is_finite() && m.determinant() != 0.0).then_some(Self { m, inv })
    }

    /// `self * other`: `other` is applied first.
    #[must_use]
    pub fn then_first(&self, other: &Self) -> Self {
        Self { m: self.m * other.m, inv: other.inv * self.inv }
    }

    /// The inverse transform.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self { m: self.inv, inv: self.m }
    }

    /// A point, rounded once at the end.
    #[must_use]
    pub fn point(&self, p: Vec3) -> Vec3 {
        self.m.project_point3(p.as_dvec3()).as_vec3()
    }

    /// A point in f64.
    #[must_use]
    pub fn point_f64(&self, p: DVec3) -> DVec3 {
        self.m.project_point3(p)
    }

    /// A direction (no translation).
    #[must_use]
    pub fn vector(&self, v: Vec3) -> Vec3 {
        self.m.transform_vector3(v.as_dvec3()).as_vec3()
    }

    /// A normal: by the transposed inverse; not normalised.
    #[must_use]
    pub fn normal(&self, n: Vec3) -> Vec3 {
        self.inv.transpose().transform_vector3(n.as_dvec3()).as_vec3()
    }

    /// Whether handedness changes, so that a cross product of transformed edges flips.
    #[must_use]
    pub fn swaps_handedness(&self) -> bool {
        self.m.determinant() < 0.0
    }
}
