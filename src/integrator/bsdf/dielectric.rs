//! Interfaces between transparent media, smooth or with GGX microfacets, and thin panes.
//! Invariant: for a smooth interface reflection plus transmission is all the light there is.
//! Never absorbs, never tints. Transmitted radiance is scaled by 1/η², for rays from the camera.

use super::conductor::reflection;
use super::{BsdfSample, Ggx, ZERO, fresnel, mirror, valid_eta};
use crate::color::Rgb;
use crate::math::{Vec2, Vec3, sqr};

/// An interface; the outside is where the normal points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dielectric {
    eta: f32,
    inv_eta: f32,
    ggx: Ggx,
    delta: bool,
}

impl Dielectric {
    /// `eta` is the index inside over the index outside. With eta = 1 light passes straight,
    /// whatever the roughness (pbrt-v4).
    #[inline]
    #[must_use]
    pub fn new(eta: f32, ggx: Ggx) -> Self {
        let eta = valid_eta(eta);
        Self { eta, inv_eta: 1.0 / eta, ggx, delta: ggx.is_smooth() || eta == 1.0 }
    }

    #[inline(always)]
    pub(super) fn is_delta(&self) -> bool {
        self.delta
    }

    /// (far index over near one, its inverse) as seen from the side of z.
    #[inline(always)]
    fn relative(&self, z: f32) -> (f32, f32) {
        if z < 0.0 { (self.inv_eta, self.eta) } else { (self.eta, self.inv_eta) }
    }

    #[inline(always)]
    pub(super) fn eval(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        let side = wo.z * wi.z;
        if self.delta || side == 0.0 {
            return ZERO;
        }
        let (eta, inv_eta) = self.relative(wo.z);
        if side > 0.0 {
            let Some((cos_d, reflected, pdf)) = reflection(&self.ggx, wo, wi) else { return ZERO };
            let f = fresnel::dielectric(cos_d, eta).0;
            return (Rgb::splat(f * reflected), f * pdf);
        }
        // The facet that refracts wo into wi (Walter et al. 2007, eq. 16), turned to wo's side.
        let h = wo + wi * eta;
        let h2 = h.length_squared();
        if h2 < 1e-14 {
            return ZERO;
        }
        let m = h * (1.0f32.copysign(h.z * wo.z) / h2.sqrt());
        let (om, im) = (wo.dot(m), wi.dot(m));
        if !(om > 0.0 && im < 0.0) {
            return ZERO;
        }
        // Both sides give one F; by the thinner medium's cosine it is well conditioned, where the
        // denser one's loses all digits near the critical angle.
        let f = if eta > 1.0 { fresnel::dielectric(om, eta).0 } else { fresnel::dielectric(-im, inv_eta).0 };
        let (zo, zi) = (wo.z.abs(), wi.z.abs());
        let (so, si) = (self.ggx.stretch(wo), self.ggx.stretch(wi));
        let common = (1.0 - f) * 2.0 * self.ggx.d(m) * om * -im / sqr(im + om * inv_eta);
        // Equal to wi's sample: D·G2 and D·G1 with the Jacobian of refraction (pbrt eqs. 9.37, 9.40).
        let value = common * sqr(inv_eta) * zi / (so * zi + si * zo);
        (Rgb::splat(value), common / (zo + so))
    }

    #[inline(always)]
    pub(super) fn sample(&self, wo: Vec3, uc: f32, u: Vec2) -> Option<BsdfSample> {
        if wo.z == 0.0 {
            return None;
        }
        let (eta, inv_eta) = self.relative(wo.z);
        let scale = sqr(inv_eta);
        if self.delta {
            let (f, cos_t) = fresnel::dielectric(wo.z.abs(), eta);
            return Some(if uc < f {
                BsdfSample { delta: true, ..BsdfSample::reflection(mirror(wo), Rgb::ONE, f) }
            } else if f < 1.0 {
                let wi = Vec3::new(-wo.x * inv_eta, -wo.y * inv_eta, -cos_t.copysign(wo.z));
                BsdfSample {
                    wi,
                    weight: Rgb::splat(scale),
                    pdf: 1.0 - f,
                    delta: true,
                    transmission: true,
                    eta,
                }
            } else {
                return None;
            });
        }
        let up = if wo.z < 0.0 { -wo } else { wo };
        let so = self.ggx.stretch(up);
        let m = self.ggx.sample_visible_from(up, so, u)?;
        let om = up.dot(m);
        if om <= 0.0 {
            return None;
        }
        let (f, cos_t) = fresnel::dielectric(om, eta);
        let transmission = uc >= f;
        let wi = if transmission { m * (om * inv_eta - cos_t) - up * inv_eta } else { m * (2.0 * om) - up };
        // A facet may send light to the side that its lobe does not belong to: lost (pbrt-v4).
        if wi.z == 0.0 || transmission != (wi.z < 0.0) || (transmission && f >= 1.0) {
            return None;
        }
        let (zi, si) = (wi.z.abs(), self.ggx.stretch(wi));
        let masked = zi * (up.z + so) / (so * zi + si * up.z);
        let d = self.ggx.d(m) / (up.z + so);
        let wi_out = if wo.z < 0.0 { -wi } else { wi };
        if !transmission {
            return Some(BsdfSample::reflection(wi_out, Rgb::splat(masked), 0.5 * d * f));
        }
        let im = wi.dot(m);
        let pdf = (1.0 - f) * 2.0 * d * om * -im / sqr(im + om * inv_eta);
        if !(pdf > 0.0 && pdf.is_finite()) {
            return None;
        }
        let weight = Rgb::splat(masked * scale);
        Some(BsdfSample { wi: wi_out, weight, pdf, delta: false, transmission, eta })
    }
}

/// A pane so thin that light leaves it where it came in, with all reflections between its faces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThinDielectric {
    eta: f32,
}

impl ThinDielectric {
    /// `eta` is the pane's index over its surroundings'.
    #[inline]
    #[must_use]
    pub fn new(eta: f32) -> Self {
        Self { eta: valid_eta(eta) }
    }

    #[inline(always)]
    pub(super) fn sample(&self, wo: Vec3, uc: f32) -> Option<BsdfSample> {
        if wo.z == 0.0 {
            return None;
        }
        let single = fresnel::dielectric(wo.z.abs(), self.eta).0;
        // R + T²R/(1 − R²) with T = 1 − R (pbrt 4th ed., eq. 9.11), reduced: finite at R = 1.
        let f = 2.0 * single / (1.0 + single);
        if uc < f {
            Some(BsdfSample { delta: true, ..BsdfSample::reflection(mirror(wo), Rgb::ONE, f) })
        } else if f < 1.0 {
            let (wi, pdf) = (-wo, 1.0 - f);
            Some(BsdfSample { wi, weight: Rgb::ONE, pdf, delta: true, transmission: true, eta: 1.0 })
        } else {
            None
        }
    }
}
