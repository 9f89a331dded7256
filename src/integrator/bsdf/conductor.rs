//! Metals: GGX microfacets with complex Fresnel reflectance per RGB channel, or a perfect mirror.
//! Invariant: a weight never exceeds the Fresnel reflectance. Never transmits; both sides reflect.

use super::diffuse::unit;
use super::{BsdfSample, Ggx, ZERO, fresnel, mirror, same_side};
use crate::color::Rgb;
use crate::math::{Vec2, Vec3};

/// A metal's surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conductor {
    eta: Rgb,
    k: Rgb,
    ggx: Ggx,
}

impl Conductor {
    /// From the complex index eta − i·k relative to the medium outside.
    #[inline]
    #[must_use]
    pub fn new(eta: Rgb, k: Rgb, ggx: Ggx) -> Self {
        Self { eta, k, ggx }
    }

    /// From the reflectance at normal incidence as pbrt-v4 does it: eta = 1 and
    /// k = 2√r/√(1−r), with r clamped to [0, 0.9999].
    #[inline]
    #[must_use]
    pub fn from_reflectance(reflectance: Rgb, ggx: Ggx) -> Self {
        let r = unit(reflectance).min(Rgb::splat(0.9999));
        let k = r.map(|r| 2.0 * (r / (1.0 - r)).sqrt());
        Self { eta: Rgb::ONE, k, ggx }
    }

    #[inline(always)]
    pub(super) fn is_delta(&self) -> bool {
        self.ggx.is_smooth()
    }

    #[inline(always)]
    pub(super) fn eval(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        if !same_side(wo, wi) || self.ggx.is_smooth() {
            return ZERO;
        }
        let Some((cos_d, reflected, pdf)) = reflection(&self.ggx, wo, wi) else { return ZERO };
        (fresnel::conductor(cos_d, self.eta, self.k) * reflected, pdf)
    }

    #[inline(always)]
    pub(super) fn sample(&self, wo: Vec3, u: Vec2) -> Option<BsdfSample> {
        if wo.z == 0.0 {
            return None;
        }
        if self.ggx.is_smooth() {
            let weight = fresnel::conductor(wo.z.abs(), self.eta, self.k);
            return Some(BsdfSample { delta: true, ..BsdfSample::reflection(mirror(wo), weight, 1.0) });
        }
        let (wi, cos_d, masked, pdf) = sample_reflection(&self.ggx, wo, u)?;
        let weight = fresnel::conductor(cos_d, self.eta, self.k) * masked;
        Some(BsdfSample::reflection(wi, weight, pdf))
    }
}

/// Microfacet reflection between two directions on one side, without Fresnel factor: the cosine
/// between facet and direction, f·cosθi = D·G2/(4 zo), and the visible-normal density
/// D·G1(o)/(4 zo) [1/sr] (pbrt 4th ed., eqs. 9.33 and 9.28 with the Jacobian of reflection).
#[inline(always)]
pub(super) fn reflection(ggx: &Ggx, wo: Vec3, wi: Vec3) -> Option<(f32, f32, f32)> {
    let h = wo + wi;
    let h2 = h.length_squared();
    // Below this the half vector of two unit vectors is rounding alone: |h| < 1e-7.
    if h2 < 1e-14 {
        return None;
    }
    let (zo, zi) = (wo.z.abs(), wi.z.abs());
    let (so, si) = (ggx.stretch(wo), ggx.stretch(wi));
    let half_d = 0.5 * ggx.d_scaled(h, 1.0 / h2);
    let pdf = half_d / (zo + so);
    // Of unit vectors, the cosine to their half vector is half the sum's length.
    Some((0.5 * h2.sqrt(), half_d * zi / (so * zi + si * zo), pdf))
}

/// Draws a reflected direction by its visible facet: `wi`, the cosine to the facet, the weight
/// G2/G1(o) and the density [1/sr]. `None` where it leaves through the surface.
#[inline(always)]
pub(super) fn sample_reflection(ggx: &Ggx, wo: Vec3, u: Vec2) -> Option<(Vec3, f32, f32, f32)> {
    let up = if wo.z < 0.0 { -wo } else { wo };
    let so = ggx.stretch(up);
    let m = ggx.sample_visible_from(up, so, u)?;
    let cos_d = up.dot(m);
    let wi = m * (2.0 * cos_d) - up;
    if !(wi.z > 0.0 && cos_d > 0.0) {
        return None;
    }
    let si = ggx.stretch(wi);
    let masked = wi.z * (up.z + so) / (so * wi.z + si * up.z);
    let pdf = 0.5 * ggx.d(m) / (up.z + so);
    Some((if wo.z < 0.0 { -wi } else { wi }, cos_d, masked, pdf))
}
