//! Samples an emitting open cylinder by area. Never intersects.

use super::ShapeSample;
use super::placed::{Placed, swept};
use crate::math::Transform;
use glam::{Vec2, Vec3};

/// An open cylinder around z, pbrt's parameters.
#[derive(Clone, Copy, Debug)]
pub struct Cylinder {
    placed: Placed,
    radius: f32,
    z_min: f32,
    z_max: f32,
    phi_max: f32,
}

impl Cylinder {
    /// `None` where it has no area, or the transform cannot be inverted.
    #[must_use]
    pub fn new(
        object_to_world: &Transform,
        radius: f32,
        z_min: f32,
        z_max: f32,
        phi_max_degrees: f32,
    ) -> Option<Self> {
        let (placed, phi_max) = swept(object_to_world, radius, phi_max_degrees)?;
        let (z_min, z_max) = (z_min.min(z_max), z_min.max(z_max));
        (z_max > z_min && (z_max - z_min).is_finite()).then_some(Self {
            placed,
            radius,
            z_min,
            z_max,
            phi_max,
        })
    }

    fn pdf_area(&self) -> f32 {
        1.0 / (self.phi_max * self.radius * (self.z_max - self.z_min))
    }

    /// Area; the growth around the circumference by the midpoint rule, to about 1e-4.
    #[must_use]
    pub fn area(&self) -> f32 {
        const N: usize = 256;
        let growth = |i: usize| {
            let phi = (i as f32 + 0.5) / N as f32 * self.phi_max;
            self.placed.area_scale(Vec3::new(phi.cos(), phi.sin(), 0.0))
        };
        (0..N).map(growth).sum::<f32>() / N as f32 / self.pdf_area()
    }

    /// A point of the wall as seen from `p`, normal outwards; `b0` is φ/φ_max, `b1` runs from
    /// `z_min` to `z_max`. `None` where it is seen edge-on.
    #[inline]
    #[must_use]
    pub fn sample(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        let (sin, cos) = (u.x * self.phi_max).sin_cos();
        let n = Vec3::new(cos, sin, 0.0);
        let z = self.z_min + u.y * (self.z_max - self.z_min);
        self.placed.sample(p, n * self.radius + Vec3::Z * z, n, self.pdf_area(), u)
    }

    /// Density [1/sr] with which [`Cylinder::sample`] chooses, from `p`, the surface point `hit`.
    #[inline]
    #[must_use]
    pub fn pdf(&self, p: Vec3, hit: Vec3) -> f32 {
        let o = self.placed.point_to_object(hit);
        let n = Vec3::new(o.x, o.y, 0.0).normalize_or_zero();
        self.placed.pdf(p, hit, n, self.pdf_area())
    }
}

#[cfg(test)]
mod tests {
    use super::super::analytic::cylinder_wall_irradiance;
    use super::super::testing::{check_directions, check_irradiance};
    use super::*;
    use glam::{DMat4, DVec3};
    use std::f32::consts::TAU;

    #[test]
    fn irradiance_within_is_known() {
        let c = Cylinder::new(&Transform::IDENTITY, 1.5, 0.0, 2.0, 360.0).expect("area");
        assert!((c.area() - TAU * 3.0).abs() < 1e-3);
        let known = cylinder_wall_irradiance(1.5, 2.0);
        check_irradiance("cylinder", Vec3::ZERO, Vec3::Z, known, |u| c.sample(Vec3::ZERO, u));
    }

    #[test]
    fn directions_follow_the_density() {
        let m = DMat4::from_rotation_x(1.2) * DMat4::from_scale(DVec3::new(1.0, -2.0, 0.7));
        let t = Transform::from_matrix(m).expect("invertible");
        let c = Cylinder::new(&t, 1.0, -1.0, 2.0, 300.0).expect("area");
        let p = Vec3::new(4.0, 3.0, 1.0);
        let pdf = |w: Vec3| {
            let (o, d) = (t.inv.transform_point3(p.as_dvec3()), t.inv.transform_vector3(w.as_dvec3()));
            let (a, b) = (d.x * d.x + d.y * d.y, o.x * d.x + o.y * d.y);
            let disc = b * b - a * (o.x * o.x + o.y * o.y - 1.0);
            if disc < 0.0 {
                return 0.0;
            }
            let both = [(-b - disc.sqrt()) / a, (-b + disc.sqrt()) / a];
            both.into_iter()
                .map(|s| {
                    let h = o + d * s;
                    let phi = h.y.atan2(h.x).to_degrees().rem_euclid(360.0);
                    let on = s > 0.0 && (-1.0..=2.0).contains(&h.z) && phi <= 300.0;
                    if on { c.pdf(p, t.m.transform_point3(h).as_vec3()) } else { 0.0 }
                })
                .sum()
        };
        let axis = t.m.transform_point3(DVec3::Z * 0.5).as_vec3() - p;
        check_directions("cylinder", axis, |u| c.sample(p, u).map(|s| (s.point - p).normalize()), pdf);
        let s = c.sample(p, Vec2::new(0.3, 0.6)).expect("a point");
        assert!((c.pdf(p, s.point) / s.pdf_solid_angle - 1.0).abs() < 1e-4);
    }
}
