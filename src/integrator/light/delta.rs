//! Lights of no extent: point, spot and distant. A shadow ray meets them by choice only, so their
//! samples carry no density. Never tests visibility.

use crate::color::Rgb;
use glam::Vec3;
use std::f32::consts::{PI, TAU};

/// Light arriving from one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeltaSample {
    /// Unit direction towards the light.
    pub wi: Vec3,
    /// Distance to the light; infinite for a distant one.
    pub distance: f32,
    /// What a surface facing `wi` receives: irradiance [W/m²], the weight of a unit pulse of
    /// radiance from `wi`.
    pub irradiance: Rgb,
}

/// Lights of no extent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DeltaLight {
    /// Isotropic point.
    Point {
        /// Radiant intensity [W/sr].
        intensity: Rgb,
        /// World space.
        position: Vec3,
    },
    /// Cone with a smooth edge (pbrt 4th ed., §12.2.1).
    Spot {
        /// Radiant intensity along the axis [W/sr].
        intensity: Rgb,
        /// World space.
        position: Vec3,
        /// Unit axis, world space.
        axis: Vec3,
        /// Cosine of the angle where falloff begins.
        cos_falloff_start: f32,
        /// Cosine of the angle where light ends; not above `cos_falloff_start`.
        cos_total_width: f32,
    },
    /// Parallel light.
    Distant {
        /// On a facing surface [W/m²].
        irradiance: Rgb,
        /// Unit vector towards the light.
        towards: Vec3,
    },
}

/// Cubic from 0 at `a` to 1 at `b`, level at both; a step where they meet.
#[inline]
fn smoothstep(a: f32, b: f32, x: f32) -> f32 {
    if a >= b {
        return f32::from(x >= b);
    }
    let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl DeltaLight {
    /// What arrives at `p`; `None` at the light itself and outside a spot's cone.
    #[inline]
    #[must_use]
    pub fn sample(&self, p: Vec3) -> Option<DeltaSample> {
        let from = |position: Vec3, intensity: Rgb| {
            let to = position - p;
            let d2 = to.length_squared();
            let distance = d2.sqrt();
            (d2 > 0.0).then(|| DeltaSample { wi: to / distance, distance, irradiance: intensity / d2 })
        };
        match *self {
            Self::Point { intensity, position } => from(position, intensity),
            Self::Spot { intensity, position, axis, cos_falloff_start, cos_total_width } => {
                let mut sample = from(position, intensity)?;
                let falloff = smoothstep(cos_total_width, cos_falloff_start, -axis.dot(sample.wi));
                sample.irradiance *= falloff;
                (falloff > 0.0).then_some(sample)
            }
            Self::Distant { irradiance, towards } => {
                Some(DeltaSample { wi: towards, distance: f32::INFINITY, irradiance })
            }
        }
    }

    /// Emitted power in watts into a scene of bounding radius `scene_radius`.
    #[must_use]
    pub fn power(&self, scene_radius: f32) -> Rgb {
        match *self {
            Self::Point { intensity, .. } => intensity * (4.0 * PI),
            // The smoothstep integrates to half of the falloff's width in cosine.
            Self::Spot { intensity, cos_falloff_start, cos_total_width, .. } => {
                intensity * (TAU * (1.0 - 0.5 * (cos_falloff_start + cos_total_width)))
            }
            Self::Distant { irradiance, .. } => irradiance * (PI * scene_radius * scene_radius),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::analytic::distant_irradiance;
    use super::super::testing::Rng;
    use super::*;

    #[test]
    fn a_point_falls_with_the_square() {
        let light = DeltaLight::Point { intensity: Rgb::new(8.0, 4.0, 0.0), position: Vec3::Z * 2.0 };
        let s = light.sample(Vec3::ZERO).expect("apart");
        assert_eq!((s.wi, s.distance, s.irradiance), (Vec3::Z, 2.0, Rgb::new(2.0, 1.0, 0.0)));
        assert_eq!(light.sample(Vec3::Z * 2.0), None);
        assert_eq!(light.power(1.0).x, 32.0 * PI);
    }

    #[test]
    fn a_spot_fades_between_its_angles_and_its_power_is_the_integral() {
        let (start, end) = (20f32.to_radians().cos(), 30f32.to_radians().cos());
        let spot = |cos_falloff_start, cos_total_width| DeltaLight::Spot {
            intensity: Rgb::splat(3.0),
            position: Vec3::Z,
            axis: Vec3::NEG_Z,
            cos_falloff_start,
            cos_total_width,
        };
        let light = spot(start, end);
        let at = |degrees: f32| {
            let w = Vec3::new(degrees.to_radians().sin(), 0.0, -degrees.to_radians().cos());
            light.sample(Vec3::Z + w).map_or(0.0, |s| s.irradiance.x)
        };
        assert!((at(0.0) - 3.0).abs() < 1e-5 && (at(19.9) - 3.0).abs() < 1e-5);
        assert_eq!((at(30.1), at(180.0)), (0.0, 0.0));
        assert!((at((0.5 * (start + end)).acos().to_degrees()) - 1.5).abs() < 1e-4);
        let mut rng = Rng::new(9);
        let count = 400_000;
        let sum: f64 = (0..count)
            .map(|_| f64::from(light.sample(Vec3::Z + rng.direction()).map_or(0.0, |s| s.irradiance.x)))
            .sum();
        let power = sum / f64::from(count) * 4.0 * std::f64::consts::PI;
        // About 5 % of directions count: 0.7 % relative deviation, five of them.
        assert!((power / f64::from(light.power(1.0).x) - 1.0).abs() < 0.035, "{power}");
        assert!(spot(end, end).sample(Vec3::ZERO).is_some());
    }

    #[test]
    fn a_distant_light_is_the_same_everywhere() {
        let towards = Vec3::new(0.6, 0.0, 0.8);
        let light = DeltaLight::Distant { irradiance: Rgb::splat(2.0), towards };
        let s = light.sample(Vec3::splat(1e6)).expect("everywhere");
        assert!(s.distance.is_infinite());
        let floor = f64::from(s.irradiance.x * s.wi.z);
        assert!((floor - distant_irradiance(2.0, 0.8)).abs() < 1e-6);
        assert_eq!(light.power(2.0).x, 8.0 * PI);
    }
}
