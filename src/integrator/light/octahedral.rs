//! The equal-area map between the unit square and the sphere (Clarberg 2008): the centre of the
//! square is +z, its corners are −z. Every direction has one square point, and back to rounding.

use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_2_PI, FRAC_PI_4};

/// The direction of a point of [0, 1]²; unit length. Density 1/(4π) for a uniform point.
#[inline]
#[must_use]
pub fn square_to_sphere(uv: Vec2) -> Vec3 {
    let c = uv * 2.0 - Vec2::ONE;
    let a = c.abs();
    // Positive in the inner diamond, the upper hemisphere.
    let distance = 1.0 - (a.x + a.y);
    let r = 1.0 - distance.abs();
    let phi = if r == 0.0 { FRAC_PI_4 } else { ((a.y - a.x) / r + 1.0) * FRAC_PI_4 };
    let (sin, cos) = phi.sin_cos();
    let xy = r * (2.0 - r * r).max(0.0).sqrt();
    Vec3::new((xy * cos).copysign(c.x), (xy * sin).copysign(c.y), (1.0 - r * r).copysign(distance))
}

/// The point of [0, 1]² of a unit direction.
#[inline]
#[must_use]
pub fn sphere_to_square(w: Vec3) -> Vec2 {
    let a = w.abs();
    // √(1 − |z|) without its cancellation near the poles.
    let r = ((a.x * a.x + a.y * a.y) / (1.0 + a.z)).sqrt().min(1.0);
    let (low, high) = (a.x.min(a.y), a.x.max(a.y));
    let ratio = if high == 0.0 { 0.0 } else { low / high };
    let turn = ratio.atan() * FRAC_2_PI;
    let turn = if a.x < a.y { 1.0 - turn } else { turn };
    let v = turn * r;
    let mut c = Vec2::new(r - v, v);
    if w.z < 0.0 {
        c = Vec2::new(1.0 - c.y, 1.0 - c.x);
    }
    (Vec2::new(c.x.copysign(w.x), c.y.copysign(w.y)) + Vec2::ONE) * 0.5
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Rng, check_directions};
    use super::*;

    #[test]
    fn landmarks() {
        let at = |x: f32, y: f32| square_to_sphere(Vec2::new(x, y));
        assert_eq!(at(0.5, 0.5), Vec3::Z);
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            assert!((at(x, y) - Vec3::NEG_Z).length() < 1e-6);
        }
        assert!((at(1.0, 0.5) - Vec3::X).length() < 1e-6);
        assert!((at(0.5, 1.0) - Vec3::Y).length() < 1e-6);
        assert!((at(0.0, 0.5) - Vec3::NEG_X).length() < 1e-6);
        // Edges fold onto themselves.
        assert!((at(0.0, 0.2) - at(0.0, 0.8)).length() < 1e-6);
        assert!((at(0.3, 1.0) - at(0.7, 1.0)).length() < 1e-6);
    }

    #[test]
    fn round_trips_everywhere_and_at_poles_and_seams() {
        let mut rng = Rng::new(2);
        for i in 0..300_000 {
            let mut w = rng.direction();
            match i % 4 {
                0 => w.z = if i % 8 == 0 { 0.0 } else { w.z * 1e-5 },
                1 => (w.x, w.y) = (w.x * 1e-4, w.y * 1e-4),
                2 => w.x = if i % 8 == 2 { 0.0 } else { -0.0 },
                _ => {}
            }
            let w = w.normalize();
            let uv = sphere_to_square(w);
            assert!(uv.cmpge(Vec2::ZERO).all() && uv.cmple(Vec2::ONE).all(), "{w} {uv}");
            let back = square_to_sphere(uv);
            // An ulp of uv at 1 is 6e-8, that of 2 uv − 1 twice it, and z = 1 − r² doubles both's sum.
            assert!((back - w).length() < 1e-6 && (back.length() - 1.0).abs() < 4e-7, "{w} {uv} {back}");
        }
        for _ in 0..100_000 {
            let uv = rng.vec2();
            let again = sphere_to_square(square_to_sphere(uv));
            assert!((again - uv).length() < 2e-6, "{uv} {again}");
        }
    }

    #[test]
    fn areas_are_equal() {
        let pdf = 1.0 / (4.0 * std::f32::consts::PI);
        check_directions("octahedral", Vec3::new(0.3, 0.5, 0.8), |u| Some(square_to_sphere(u)), |_| pdf);
    }
}
