//! The matrices behind pbrt's transform directives, in f64. Never touches the graphics state.

use crate::math::Transform;
use glam::{DMat3, DMat4, DVec3};

/// `Translate`.
pub(super) fn translate(v: DVec3) -> Transform {
    Transform { m: DMat4::from_translation(v), inv: DMat4::from_translation(-v) }
}

/// `Scale`; `None` where a factor is zero.
pub(super) fn scale(v: DVec3) -> Option<Transform> {
    Transform::from_matrix(DMat4::from_scale(v))
}

/// `Rotate`: degrees around an axis of any length; `None` for the zero axis.
pub(super) fn rotate(degrees: f64, axis: DVec3) -> Option<Transform> {
    let m = DMat4::from_axis_angle(axis.try_normalize()?, degrees.to_radians());
    Some(Transform { m, inv: m.transpose() })
}

/// `LookAt`: world to camera, which looks along +z with +y up, x to the right as pbrt has it (left-handed);
/// `None` where the direction vanishes or `up` is along it.
pub(super) fn look_at(eye: DVec3, look: DVec3, up: DVec3) -> Option<Transform> {
    let z = (look - eye).try_normalize()?;
    let x = up.try_normalize()?.cross(z).try_normalize()?;
    let y = z.cross(x);
    let camera_to_world = DMat4::from_translation(eye) * DMat4::from_mat3(DMat3::from_cols(x, y, z));
    Transform::from_matrix(camera_to_world).map(|t| t.inverse())
}

/// `Transform` and `ConcatTransform`: sixteen numbers, column after column; `None` when singular.
pub(super) fn matrix(columns: &[f64; 16]) -> Option<Transform> {
    Transform::from_matrix(DMat4::from_cols_array(columns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn near(a: Vec3, b: [f32; 3]) {
        assert!((a - Vec3::from(b)).length() < 1e-6, "{a} is not {b:?}");
    }

    #[test]
    fn known_transforms() {
        near(translate(DVec3::new(1.0, 2.0, 3.0)).point(Vec3::ONE), [2.0, 3.0, 4.0]);
        near(scale(DVec3::new(1.0, 2.0, 3.0)).expect("regular").point(Vec3::ONE), [1.0, 2.0, 3.0]);
        // A right-handed turn by 90 degrees around z takes x to y.
        near(rotate(90.0, DVec3::Z * 3.0).expect("axis").vector(Vec3::X), [0.0, 1.0, 0.0]);
        let t = matrix(&[1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 5., 6., 7., 1.]).expect("regular");
        near(t.point(Vec3::ZERO), [5.0, 6.0, 7.0]);
    }

    #[test]
    fn look_at_puts_the_target_on_the_z_axis() {
        let t = look_at(DVec3::new(0.0, 1.0, -5.0), DVec3::new(0.0, 1.0, 0.0), DVec3::Y).expect("regular");
        near(t.point(Vec3::new(0.0, 1.0, 0.0)), [0.0, 0.0, 5.0]);
        near(t.point(Vec3::new(2.0, 2.0, 0.0)), [2.0, 1.0, 5.0]);
        near(t.inverse().point(Vec3::ZERO), [0.0, 1.0, -5.0]);
    }

    #[test]
    fn what_has_no_inverse() {
        assert!(scale(DVec3::new(1.0, 0.0, 1.0)).is_none());
        assert!(rotate(30.0, DVec3::ZERO).is_none());
        assert!(look_at(DVec3::ZERO, DVec3::ZERO, DVec3::Y).is_none());
        assert!(look_at(DVec3::ZERO, DVec3::Y, DVec3::Y).is_none());
        assert!(matrix(&[0.0; 16]).is_none());
    }
}
