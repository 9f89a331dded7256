//! Scattering functions at one point, in the local shading frame (z is the shading normal), for
//! radiance carried from the camera. Invariant: `sample` and `eval` describe one density, so that
//! multiple importance sampling may mix them. Never allocates, never reads a texture.
//!
//! The models are pbrt-v4's (Pharr, Jakob and Humphreys, 4th ed., chapter 9), so that its scenes
//! look here as they do there. `Diffuse`, `DiffuseTransmission`, `ThinDielectric` and the smooth
//! `Dielectric` and `Conductor` conserve energy exactly; rough ones lose what single scattering
//! between microfacets misses, and `CoatedDiffuse` also what its layer absorbs.

mod coated;
mod coated_table;
mod conductor;
mod dielectric;
mod diffuse;
pub mod fresnel;
mod ggx;
#[cfg(test)]
mod tests;

pub use coated::CoatedDiffuse;
pub use coated_table::{CoatedTable, CoatedTables};
pub use conductor::Conductor;
pub use dielectric::{Dielectric, ThinDielectric};
pub use diffuse::{Diffuse, DiffuseTransmission};
pub use ggx::Ggx;

use crate::color::Rgb;
use crate::math::warp::cosine_hemisphere;
use crate::math::{Vec2, Vec3};

/// One sampled direction, local frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BsdfSample {
    /// Where light comes from, unit length.
    pub wi: Vec3,
    /// f·|cosθi|/pdf.
    pub weight: Rgb,
    /// Density in solid angle [1/sr]; for a delta lobe its discrete probability.
    pub pdf: f32,
    /// Whether the direction was the lobe's only one: no density, no multiple importance sampling.
    pub delta: bool,
    /// Whether `wi` lies on the other side of the surface.
    pub transmission: bool,
    /// Index of refraction behind the surface over the one in front of it, as crossed; 1 where
    /// the ray does not enter another medium.
    pub eta: f32,
}

impl BsdfSample {
    #[inline(always)]
    fn reflection(wi: Vec3, weight: Rgb, pdf: f32) -> Self {
        Self { wi, weight, pdf, delta: false, transmission: false, eta: 1.0 }
    }
}

/// A scattering function at one point, its parameters already evaluated.
#[derive(Clone, Copy, Debug)]
pub enum Bsdf<'a> {
    /// Lambertian reflection.
    Diffuse(Diffuse),
    /// Dielectric layer over a Lambertian base.
    CoatedDiffuse(CoatedDiffuse<'a>),
    /// Metal.
    Conductor(Conductor),
    /// Interface between two transparent media.
    Dielectric(Dielectric),
    /// A pane: both of its interfaces at once.
    ThinDielectric(ThinDielectric),
    /// Lambertian reflection and transmission.
    DiffuseTransmission(DiffuseTransmission),
    /// Absorbs all.
    Black,
}

impl Bsdf<'_> {
    /// f(wo, wi)·|cosθi| and the solid-angle density [1/sr] with which [`Self::sample`] draws
    /// `wi`. Delta lobes add nothing to either. `wo` points to the camera's side, both are unit.
    #[inline(always)]
    #[must_use]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        match self {
            Self::Diffuse(b) => b.eval(wo, wi),
            Self::CoatedDiffuse(b) => b.eval(wo, wi),
            Self::Conductor(b) => b.eval(wo, wi),
            Self::Dielectric(b) => b.eval(wo, wi),
            Self::DiffuseTransmission(b) => b.eval(wo, wi),
            Self::ThinDielectric(_) | Self::Black => ZERO,
        }
    }

    /// Draws `wi`: `uc` chooses the lobe, `u` the direction in it, all in [0, 1). `None` where
    /// the draw carries nothing.
    #[inline(always)]
    #[must_use]
    pub fn sample(&self, wo: Vec3, uc: f32, u: Vec2) -> Option<BsdfSample> {
        match self {
            Self::Diffuse(b) => b.sample_towards(wo, cosine_hemisphere(u)),
            Self::CoatedDiffuse(b) => b.sample(wo, uc, u),
            Self::Conductor(b) => b.sample(wo, u),
            Self::Dielectric(b) => b.sample(wo, uc, u),
            Self::ThinDielectric(b) => b.sample(wo, uc),
            Self::DiffuseTransmission(b) => b.sample(wo, uc, u),
            Self::Black => None,
        }
    }

    /// Whether there are delta lobes only, so that sampling lights is in vain.
    #[inline(always)]
    #[must_use]
    pub fn is_delta(&self) -> bool {
        match self {
            Self::Conductor(b) => b.is_delta(),
            Self::Dielectric(b) => b.is_delta(),
            Self::ThinDielectric(_) => true,
            Self::Diffuse(_) | Self::CoatedDiffuse(_) | Self::DiffuseTransmission(_) | Self::Black => false,
        }
    }
}

/// What shading asks of a scattering function. Implemented by [`Bsdf`] and by its commonest kind, for
/// which shading is compiled apart.
pub trait Scatter {
    /// See [`Bsdf::eval`].
    fn eval(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32);
    /// See [`Bsdf::sample`]. `cosine` is what [`cosine_hemisphere`] makes of `u`.
    fn sample(&self, wo: Vec3, uc: f32, u: Vec2, cosine: Vec3) -> Option<BsdfSample>;
    /// See [`Bsdf::is_delta`].
    fn is_delta(&self) -> bool;
}

impl Scatter for Bsdf<'_> {
    #[inline(always)]
    fn eval(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        self.eval(wo, wi)
    }

    #[inline(always)]
    fn sample(&self, wo: Vec3, uc: f32, u: Vec2, _: Vec3) -> Option<BsdfSample> {
        self.sample(wo, uc, u)
    }

    #[inline(always)]
    fn is_delta(&self) -> bool {
        self.is_delta()
    }
}

impl Scatter for Diffuse {
    #[inline(always)]
    fn eval(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        self.eval(wo, wi)
    }

    #[inline(always)]
    fn sample(&self, wo: Vec3, _: f32, _: Vec2, cosine: Vec3) -> Option<BsdfSample> {
        self.sample_towards(wo, cosine)
    }

    #[inline(always)]
    fn is_delta(&self) -> bool {
        false
    }
}

/// pbrt-v4's `remaproughness`: α = √roughness.
#[inline]
#[must_use]
pub fn roughness_to_alpha(roughness: f32) -> f32 {
    crate::math::safe_sqrt(roughness)
}

const ZERO: (Rgb, f32) = (Rgb::ZERO, 0.0);

/// Whether both directions are strictly on one side of the surface.
#[inline(always)]
fn same_side(a: Vec3, b: Vec3) -> bool {
    a.z * b.z > 0.0
}

/// `w` mirrored at the normal.
#[inline(always)]
fn mirror(w: Vec3) -> Vec3 {
    Vec3::new(-w.x, -w.y, w.z)
}

/// The index ratio as a positive number; what no medium has becomes 1, as pbrt-v4 does with 0.
#[inline]
fn valid_eta(eta: f32) -> f32 {
    if eta > 0.0 && eta.is_finite() { eta } else { 1.0 }
}
