//! Samples an emitting disk or annulus by area, low distortion where it is a whole disk. Never
//! intersects.

use super::ShapeSample;
use super::placed::{Placed, swept};
use crate::math::Transform;
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

/// A disk or annulus, pbrt's parameters.
#[derive(Clone, Copy, Debug)]
pub struct Disk {
    placed: Placed,
    height: f32,
    radius: f32,
    inner_radius: f32,
    phi_max: f32,
}

/// The concentric map (Shirley and Chiu 1997) in polar coordinates, which `warp::concentric_disk`
/// would have to take an arctangent for: (r, φ in [0, 2π)).
#[inline]
fn concentric_polar(u: Vec2) -> (f32, f32) {
    let o = u * 2.0 - Vec2::ONE;
    let (r, phi) = if o.x.abs() > o.y.abs() {
        (o.x, FRAC_PI_4 * (o.y / o.x))
    } else if o.y != 0.0 {
        (o.y, FRAC_PI_2 - FRAC_PI_4 * (o.x / o.y))
    } else {
        (0.0, 0.0)
    };
    let phi = if r < 0.0 { phi + PI } else { phi };
    (r.abs(), if phi < 0.0 { phi + TAU } else { phi })
}

impl Disk {
    /// `None` where it has no area, or the transform cannot be inverted.
    #[must_use]
    pub fn new(
        object_to_world: &Transform,
        height: f32,
        radius: f32,
        inner_radius: f32,
        phi_max_degrees: f32,
    ) -> Option<Self> {
        let (placed, phi_max) = swept(object_to_world, radius, phi_max_degrees)?;
        let inner_radius = inner_radius.max(0.0);
        (radius > inner_radius && height.is_finite()).then_some(Self {
            placed,
            height,
            radius,
            inner_radius,
            phi_max,
        })
    }

    fn pdf_area(&self) -> f32 {
        2.0 / (self.phi_max * (self.radius * self.radius - self.inner_radius * self.inner_radius))
    }

    /// Area.
    #[must_use]
    pub fn area(&self) -> f32 {
        self.placed.area_scale(Vec3::Z) / self.pdf_area()
    }

    /// A point of the disk as seen from `p`; the normal is object +z, `b0` is φ/φ_max and `b1` runs
    /// from 0 at the rim to 1 at the inner radius, as pbrt's (u, v). `None` where it is seen edge-on.
    #[inline]
    #[must_use]
    pub fn sample(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        let (r, phi) = if self.inner_radius == 0.0 && self.phi_max >= TAU {
            let (r, phi) = concentric_polar(u);
            (r * self.radius, phi)
        } else {
            let (r0, r1) = (self.inner_radius * self.inner_radius, self.radius * self.radius);
            ((r0 + u.y * (r1 - r0)).sqrt(), u.x * self.phi_max)
        };
        let (sin, cos) = phi.sin_cos();
        let at = Vec2::new(cos, sin) * r;
        let v = (self.radius - r) / (self.radius - self.inner_radius);
        let parameters = Vec2::new(phi / self.phi_max, v);
        self.placed.sample(p, at.extend(self.height), Vec3::Z, self.pdf_area(), parameters)
    }

    /// Density [1/sr] with which [`Disk::sample`] chooses, from `p`, the surface point `hit`.
    #[inline]
    #[must_use]
    pub fn pdf(&self, p: Vec3, hit: Vec3) -> f32 {
        self.placed.pdf(p, hit, Vec3::Z, self.pdf_area())
    }
}

#[cfg(test)]
mod tests {
    use super::super::analytic::disk_irradiance;
    use super::super::testing::{check_irradiance, check_shape};
    use super::*;
    use glam::{DMat4, DVec3};

    #[test]
    fn irradiance_of_a_facing_disk_is_known() {
        let disk = Disk::new(&Transform::IDENTITY, 1.5, 0.8, 0.0, 360.0).expect("area");
        assert!((disk.area() - PI * 0.64).abs() < 1e-5);
        let known = disk_irradiance(0.8, 1.5);
        check_irradiance("disk", Vec3::ZERO, Vec3::Z, known, |u| disk.sample(Vec3::ZERO, u));
        let ring = Disk::new(&Transform::IDENTITY, 1.5, 0.8, 0.5, 90.0).expect("area");
        let known = 0.25 * (known - disk_irradiance(0.5, 1.5));
        check_irradiance("ring", Vec3::ZERO, Vec3::Z, known, |u| ring.sample(Vec3::ZERO, u));
    }

    #[test]
    fn directions_follow_the_density() {
        let m = DMat4::from_rotation_x(0.4) * DMat4::from_scale(DVec3::new(2.0, 1.0, -3.0));
        let t = Transform::from_matrix(m).expect("invertible");
        for (inner, sweep) in [(0.0, 360.0), (0.3, 200.0)] {
            let disk = Disk::new(&t, 0.2, 1.0, inner, sweep).expect("area");
            let p = Vec3::new(0.5, 1.0, 2.0);
            let pdf = |w: Vec3| {
                let (o, d) = (t.inv.transform_point3(p.as_dvec3()), t.inv.transform_vector3(w.as_dvec3()));
                let s = (f64::from(0.2f32) - o.z) / d.z;
                let h = o + d * s;
                let r = (h.x * h.x + h.y * h.y).sqrt();
                let phi = h.y.atan2(h.x).to_degrees().rem_euclid(360.0);
                let on = s > 0.0 && (f64::from(inner)..=1.0).contains(&r) && phi <= f64::from(sweep);
                if on { disk.pdf(p, t.m.transform_point3(h).as_vec3()) } else { 0.0 }
            };
            check_shape("disk", p, |u| disk.sample(p, u), pdf);
        }
    }

    #[test]
    fn parameters_are_pbrts() {
        let ring = Disk::new(&Transform::IDENTITY, 0.0, 2.0, 1.0, 180.0).expect("area");
        let s = ring.sample(Vec3::Z, Vec2::new(0.25, 0.999_999)).expect("a point");
        assert!((s.b0 - 0.25).abs() < 1e-6 && s.b1 < 1e-5);
        let whole = Disk::new(&Transform::IDENTITY, 0.0, 2.0, 0.0, 360.0).expect("area");
        let s = whole.sample(Vec3::Z, Vec2::new(0.5, 0.0)).expect("a point");
        assert!((s.b0 - 0.75).abs() < 1e-5 && s.b1.abs() < 1e-5, "{s:?}");
        assert!(Disk::new(&Transform::IDENTITY, 0.0, 1.0, 1.0, 360.0).is_none());
        assert!(Disk::new(&Transform::IDENTITY, 0.0, f32::NAN, 0.0, 360.0).is_none());
    }
}
