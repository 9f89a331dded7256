//! Samples an emitting sphere seen from a point. A whole sphere that stayed a sphere is sampled
//! uniformly within the cone it fills, or over its area from inside; a clipped or stretched one over
//! its area. Never intersects.

use super::placed::{Placed, swept};
use super::{ShapeSample, per_solid_angle};
use crate::math::{Frame, Transform, safe_sqrt};
use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// A sphere, pbrt's parameters.
#[derive(Clone, Copy, Debug)]
pub enum Sphere {
    /// Whole and round in the world.
    Whole {
        /// Centre, world space.
        center: Vec3,
        /// Radius, world space.
        radius: f32,
    },
    /// Clipped, or stretched by its transform.
    Partial(PartialSphere),
}

/// A clipped or stretched sphere.
#[derive(Clone, Copy, Debug)]
pub struct PartialSphere {
    placed: Placed,
    radius: f32,
    z_min: f32,
    z_max: f32,
    phi_max: f32,
}

impl Sphere {
    /// `None` where nothing of the sphere is left, or the transform cannot be inverted.
    #[must_use]
    pub fn new(
        object_to_world: &Transform,
        radius: f32,
        z_min: f32,
        z_max: f32,
        phi_max_degrees: f32,
    ) -> Option<Self> {
        let (placed, phi_max) = swept(object_to_world, radius, phi_max_degrees)?;
        let (low, high) = (z_min.min(z_max).clamp(-radius, radius), z_min.max(z_max).clamp(-radius, radius));
        let whole = low <= -radius && high >= radius && phi_max_degrees >= 360.0;
        if let (true, Some(scale)) = (whole, placed.uniform_scale()) {
            return Some(Self::Whole { center: placed.origin(), radius: radius * scale });
        }
        let partial = PartialSphere { placed, radius, z_min: low, z_max: high, phi_max };
        (high > low).then_some(Self::Partial(partial))
    }

    /// A point of the sphere as seen from `p`, normal outwards. For a clipped or stretched sphere
    /// `b0` is φ/φ_max and `b1` (z − z_min)/(z_max − z_min); for a whole one both are 0. `None`
    /// where the point is seen edge-on.
    #[inline]
    #[must_use]
    pub fn sample(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        match self {
            Self::Whole { center, radius } => sample_whole(*center, *radius, p, u),
            Self::Partial(s) => {
                let z = s.z_min + u.y * (s.z_max - s.z_min);
                let r = safe_sqrt(s.radius * s.radius - z * z);
                let (sin, cos) = (u.x * s.phi_max).sin_cos();
                let point = Vec3::new(r * cos, r * sin, z);
                s.placed.sample(p, point, point / s.radius, s.pdf_area(), u)
            }
        }
    }

    /// Density [1/sr] with which [`Sphere::sample`] chooses, from `p`, the surface point `hit`.
    #[inline]
    #[must_use]
    pub fn pdf(&self, p: Vec3, hit: Vec3) -> f32 {
        match self {
            Self::Whole { center, radius } => {
                let to = *center - p;
                match cone(to.length_squared(), *radius) {
                    Some(height) => 1.0 / (TAU * height),
                    None => {
                        let n = (hit - *center).normalize_or_zero();
                        per_solid_angle(1.0 / (2.0 * TAU * radius * radius), hit - p, n).unwrap_or(0.0)
                    }
                }
            }
            Self::Partial(s) => {
                let n = s.placed.point_to_object(hit).normalize_or_zero();
                s.placed.pdf(p, hit, n, s.pdf_area())
            }
        }
    }

    /// Area; over a stretched sphere by the midpoint rule, to about 1e-3.
    #[must_use]
    pub fn area(&self) -> f32 {
        match self {
            Self::Whole { radius, .. } => 4.0 * PI * radius * radius,
            Self::Partial(s) => {
                const N: usize = 64;
                let mut sum = 0.0;
                for i in 0..N * N {
                    let u = Vec2::new((i % N) as f32 + 0.5, (i / N) as f32 + 0.5) / N as f32;
                    let z = (s.z_min + u.y * (s.z_max - s.z_min)) / s.radius;
                    let (sin, cos) = (u.x * s.phi_max).sin_cos();
                    let r = safe_sqrt(1.0 - z * z);
                    sum += s.placed.area_scale(Vec3::new(r * cos, r * sin, z));
                }
                sum / (N * N) as f32 / s.pdf_area()
            }
        }
    }
}

impl PartialSphere {
    fn pdf_area(&self) -> f32 {
        1.0 / (self.phi_max * self.radius * (self.z_max - self.z_min))
    }
}

/// 1 − cosθ of the cone that a sphere fills at squared distance `d2`, without cancellation at any
/// distance; `None` inside and on the sphere.
#[inline]
fn cone(d2: f32, radius: f32) -> Option<f32> {
    let r2 = radius * radius;
    (d2 > r2).then(|| {
        let sin2 = r2 / d2;
        sin2 / (1.0 + safe_sqrt(1.0 - sin2))
    })
}

#[inline]
fn sample_whole(center: Vec3, radius: f32, p: Vec3, u: Vec2) -> Option<ShapeSample> {
    let to = center - p;
    let d2 = to.length_squared();
    let Some(height) = cone(d2, radius) else {
        let n = crate::math::warp::uniform_sphere(u);
        let point = center + n * radius;
        let pdf_solid_angle = per_solid_angle(1.0 / (2.0 * TAU * radius * radius), point - p, n)?;
        return Some(ShapeSample { point, n, pdf_solid_angle, b0: 0.0, b1: 0.0 });
    };
    let d = d2.sqrt();
    let frame = Frame::from_z(to / d);
    let x = u.x * height;
    let sin2 = x * (2.0 - x);
    let cos_theta = 1.0 - x;
    let sin2_max = radius * radius / d2;
    let sin_max = sin2_max.sqrt();
    let root = safe_sqrt(sin2_max - sin2);
    // α, the angle at the centre between the axis and the point, from the near root of the
    // quadratic (pbrt 4th ed., §6.2.4); its sine by the product of both roots, since the
    // difference would cancel right above the surface.
    let cos_alpha = (sin2 + cos_theta * root) / sin_max;
    let cos2_max = (d - radius) * (d + radius) / d2;
    let sin_alpha = sin2.sqrt() * cos2_max / (sin_max * (cos_theta + root));
    let (sin, cos) = (TAU * u.y).sin_cos();
    let n = frame.to_world(Vec3::new(sin_alpha * cos, sin_alpha * sin, -cos_alpha));
    let pdf_solid_angle = 1.0 / (TAU * height);
    (pdf_solid_angle.is_finite()).then_some(ShapeSample {
        point: center + n * radius,
        n,
        pdf_solid_angle,
        b0: 0.0,
        b1: 0.0,
    })
}

#[cfg(test)]
mod tests {
    use super::super::analytic::sphere_irradiance;
    use super::super::testing::{check_directions, check_irradiance, check_shape};
    use super::*;
    use glam::{DMat4, DVec3};

    fn transform(m: DMat4) -> Transform {
        Transform::from_matrix(m).expect("invertible")
    }

    /// Nearest hit of a unit-radius-like sphere in object space, in f64, as a world point.
    fn hits(t: &Transform, radius: f64, p: Vec3, w: Vec3) -> Vec<Vec3> {
        let o = t.inv.transform_point3(p.as_dvec3());
        let d = t.inv.transform_vector3(w.as_dvec3());
        let (a, b, c) = (d.dot(d), o.dot(d), o.dot(o) - radius * radius);
        let disc = b * b - a * c;
        if disc < 0.0 {
            return Vec::new();
        }
        [(-b - disc.sqrt()) / a, (-b + disc.sqrt()) / a]
            .into_iter()
            .filter(|&s| s > 0.0)
            .map(|s| t.m.transform_point3(o + d * s).as_vec3())
            .collect()
    }

    #[test]
    fn whole_spheres_from_outside_and_inside() {
        let m = DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0)) * DMat4::from_rotation_x(0.3);
        let t = transform(m * DMat4::from_scale(DVec3::splat(0.5)));
        let s = Sphere::new(&t, 2.0, -2.0, 2.0, 360.0).expect("whole");
        let (center, radius) = (Vec3::new(1.0, 2.0, 3.0), 1.0);
        assert!(matches!(s, Sphere::Whole { radius: r, .. } if (r - radius).abs() < 1e-6));
        assert!((s.area() - 4.0 * PI).abs() < 1e-4);
        for (i, distance) in [1.001, 1.2, 3.0, 100.0, 5000.0, 0.0, 0.7, 0.99].into_iter().enumerate() {
            let p = center + Vec3::new(0.6, -0.48, 0.64) * distance;
            let pdf = |w: Vec3| hits(&t, 2.0, p, w).first().map_or(0.0, |&h| s.pdf(p, h));
            if distance > 1.1 {
                let n = (center - p).normalize();
                let known = sphere_irradiance(p, n, center, radius);
                check_irradiance(&format!("sphere {i}"), p, n, known, |u| s.sample(p, u));
            }
            if distance < 1000.0 {
                check_shape(&format!("sphere {i}"), p, |u| s.sample(p, u), pdf);
            }
        }
    }

    #[test]
    fn clipped_and_stretched_spheres() {
        let t = transform(
            DMat4::from_translation(DVec3::new(0.0, 0.5, 0.0))
                * DMat4::from_rotation_y(0.7)
                * DMat4::from_scale(DVec3::new(1.0, 2.0, -0.4)),
        );
        let s = Sphere::new(&t, 1.5, -0.5, 1.2, 250.0).expect("partial");
        assert!(matches!(s, Sphere::Partial(_)));
        let p = Vec3::new(2.0, -4.0, 5.0);
        let inside = |h: Vec3| {
            let o = t.inv.transform_point3(h.as_dvec3());
            let phi = o.y.atan2(o.x).to_degrees().rem_euclid(360.0);
            (-0.5..=1.2).contains(&o.z) && phi <= 250.0
        };
        // Both walls may be seen through the clipped part: their densities add.
        let pdf = |w: Vec3| hits(&t, 1.5, p, w).into_iter().filter(|&h| inside(h)).map(|h| s.pdf(p, h)).sum();
        let axis = t.m.transform_point3(DVec3::ZERO).as_vec3() - p;
        check_directions("partial sphere", axis, |u| s.sample(p, u).map(|s| (s.point - p).normalize()), pdf);
        for u in [Vec2::new(0.2, 0.9), Vec2::new(0.7, 0.1)] {
            let x = s.sample(p, u).expect("a point");
            assert!((s.pdf(p, x.point) / x.pdf_solid_angle - 1.0).abs() < 1e-3);
        }
    }

    #[test]
    fn areas_and_refusals() {
        let id = Transform::IDENTITY;
        let half = Sphere::new(&id, 2.0, 0.0, 2.0, 180.0).expect("half");
        assert!((half.area() / (4.0 * PI) - 1.0).abs() < 1e-4);
        // Prolate spheroid 1, 1, 2: 2π (1 + 2 asin(e)/e), e = √3/2.
        let t = transform(DMat4::from_scale(DVec3::new(1.0, 1.0, 2.0)));
        let e = 3f64.sqrt() / 2.0;
        let known = std::f64::consts::TAU * (1.0 + 2.0 * e.asin() / e);
        let area = Sphere::new(&t, 1.0, -1.0, 1.0, 360.0).expect("stretched").area();
        assert!((f64::from(area) / known - 1.0).abs() < 1e-3, "{area} {known}");
        assert!(Sphere::new(&id, 0.0, -1.0, 1.0, 360.0).is_none());
        assert!(Sphere::new(&id, 1.0, 0.5, 0.5, 360.0).is_none());
        assert!(Sphere::new(&id, 1.0, -1.0, 1.0, 0.0).is_none());
        assert!(Sphere::new(&id, f32::NAN, -1.0, 1.0, 360.0).is_none());
    }
}
