//! An orthonormal frame around a normal. Local z is the normal; local cosines are components.

use glam::Vec3;

/// Right-handed orthonormal basis, world coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// Local x in world space.
    pub x: Vec3,
    /// Local y in world space.
    pub y: Vec3,
    /// Local z in world space.
    pub z: Vec3,
}

impl Frame {
    /// Branchless basis from a unit `z` (Duff et al. 2017, listing 3).
    #[inline(always)]
    #[must_use]
    pub fn from_z(z: Vec3) -> Self {
        let sign = 1f32.copysign(z.z);
        let a = -1.0 / (sign + z.z);
        let b = z.x * z.y * a;
        Self {
            x: Vec3::new(1.0 + sign * z.x * z.x * a, sign * b, -sign * z.x),
            y: Vec3::new(b, sign + z.y * z.y * a, -z.y),
            z,
        }
    }

    /// Basis with `z`, and x as near to `x` as orthogonality allows; falls back to
    /// [`Frame::from_z`] where `x` is parallel to `z` or zero.
    #[inline]
    #[must_use]
    pub fn from_z_x(z: Vec3, x: Vec3) -> Self {
        let t = x - z * z.dot(x);
        let l = t.length_squared();
        // Relative, so that a tangent of any length serves; below it the direction is rounding.
        if l > 1e-12 * x.length_squared() && l.is_finite() {
            let x = t / l.sqrt();
            Self { x, y: z.cross(x), z }
        } else {
            Self::from_z(z)
        }
    }

    /// World to local.
    #[inline(always)]
    #[must_use]
    pub fn to_local(&self, v: Vec3) -> Vec3 {
        Vec3::new(self.x.dot(v), self.y.dot(v), self.z.dot(v))
    }

    /// Local to world.
    #[inline(always)]
    #[must_use]
    pub fn to_world(&self, v: Vec3) -> Vec3 {
        self.x * v.x + self.y * v.y + self.z * v.z
    }
}
