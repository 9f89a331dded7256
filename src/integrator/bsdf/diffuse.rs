//! Lambertian reflection, and reflection with transmission. Invariant: exact importance sampling,
//! so weights do not depend on direction. Never refracts: transmission leaves the medium's index.

use super::{BsdfSample, ZERO, same_side};
use crate::color::Rgb;
use crate::math::warp::{cosine_hemisphere, cosine_hemisphere_pdf};
use crate::math::{INV_PI, Vec2, Vec3};

/// Lambertian reflection on both sides of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Diffuse {
    reflectance: Rgb,
}

impl Diffuse {
    /// From the albedo, clamped to [0, 1].
    #[inline]
    #[must_use]
    pub fn new(reflectance: Rgb) -> Self {
        Self { reflectance: unit(reflectance) }
    }

    #[inline(always)]
    pub(super) fn eval(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        if !same_side(wo, wi) {
            return ZERO;
        }
        let pdf = cosine_hemisphere_pdf(wi.z.abs());
        (self.reflectance * pdf, pdf)
    }

    /// `wi` is drawn from the cosine-weighted hemisphere.
    #[inline(always)]
    pub(super) fn sample_towards(&self, wo: Vec3, mut wi: Vec3) -> Option<BsdfSample> {
        let pdf = wi.z * INV_PI;
        if !(pdf > 0.0 && wo.z != 0.0 && self.reflectance != Rgb::ZERO) {
            return None;
        }
        wi.z = wi.z.copysign(wo.z);
        Some(BsdfSample::reflection(wi, self.reflectance, pdf))
    }
}

/// Lambertian reflection on the near side, Lambertian transmission to the far side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiffuseTransmission {
    reflectance: Rgb,
    transmittance: Rgb,
    /// Probability of reflection, by largest component (pbrt-v4); NaN-free: 0 where both are 0.
    reflect: f32,
}

impl DiffuseTransmission {
    /// From the two albedos, each clamped to [0, 1]. Their sum is the caller's: above 1 the
    /// surface creates energy, as it does in pbrt-v4.
    #[inline]
    #[must_use]
    pub fn new(reflectance: Rgb, transmittance: Rgb) -> Self {
        let (reflectance, transmittance) = (unit(reflectance), unit(transmittance));
        let (r, t) = (reflectance.max_element(), transmittance.max_element());
        let reflect = if r > 0.0 { r / (r + t) } else { 0.0 };
        Self { reflectance, transmittance, reflect }
    }

    #[inline(always)]
    pub(super) fn eval(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        let pdf = cosine_hemisphere_pdf(wi.z.abs());
        let side = wo.z * wi.z;
        if side > 0.0 {
            (self.reflectance * pdf, self.reflect * pdf)
        } else if side < 0.0 && self.transmittance != Rgb::ZERO {
            (self.transmittance * pdf, (1.0 - self.reflect) * pdf)
        } else {
            ZERO
        }
    }

    #[inline(always)]
    pub(super) fn sample(&self, wo: Vec3, uc: f32, u: Vec2) -> Option<BsdfSample> {
        let mut wi = cosine_hemisphere(u);
        let transmission = uc >= self.reflect;
        let (albedo, probability) = if transmission {
            (self.transmittance, 1.0 - self.reflect)
        } else {
            (self.reflectance, self.reflect)
        };
        let pdf = wi.z * INV_PI * probability;
        if !(pdf > 0.0 && wo.z != 0.0 && albedo != Rgb::ZERO) {
            return None;
        }
        wi.z = wi.z.copysign(if transmission { -wo.z } else { wo.z });
        Some(BsdfSample { wi, weight: albedo / probability, pdf, delta: false, transmission, eta: 1.0 })
    }
}

/// Albedo clamped to [0, 1]; NaN becomes 0.
#[inline(always)]
pub(super) fn unit(albedo: Rgb) -> Rgb {
    albedo.max(Rgb::ZERO).min(Rgb::ONE)
}
