//! A dielectric layer over a Lambertian base: pbrt-v4's `coateddiffuse` without its random walk.
//! Invariant: `eval` is the expectation of that walk, so it has no noise of its own. Never
//! transmits: the base is opaque, and light from below meets the same layer (two-sided).
//!
//! f = f_interface + (ρ/π)·t(θo)·t(θi)/η²·Σ_{k<n} (ρ·r)^k, with t and r from [`CoatedTable`].
//! n counts bounces off the base. In the walk of pbrt's `LayeredBxDF::f`, step d = 0, 2, 4, … of
//! `maxdepth` is at the base, where light sampling adds the term k = d/2, and odd steps are
//! internal reflections; so n = ⌈maxdepth/2⌉, for smooth and rough interfaces alike. (pbrt's
//! `Sample_f` leaves at odd steps and has ⌊maxdepth/2⌋: the same for even depths.)
//!
//! pbrt's own images of *rough* coats are brighter: its `f` combines two ways out of the layer
//! with weights that do not sum to 1 (`tests/walk.rs` has the reason and the figures: the base is
//! 1 to 7 % brighter at α = 0.05, 5 to 14 % at 0.3), and so disagrees with its `Sample_f`
//! (mmp/pbrt-v4, issues 58 and 187). The expectation is what we keep.

use super::conductor::{reflection, sample_reflection};
use super::diffuse::unit;
use super::{BsdfSample, CoatedTable, Ggx, ZERO, fresnel, mirror, same_side};
use crate::color::Rgb;
use crate::math::warp::cosine_hemisphere;
use crate::math::{INV_PI, Vec2, Vec3, lerp};

/// A coated Lambertian surface at one point.
#[derive(Clone, Copy, Debug)]
pub struct CoatedDiffuse<'a> {
    low: &'a CoatedTable,
    high: &'a CoatedTable,
    /// Between the two tables.
    blend: f32,
    ggx: Ggx,
    smooth: bool,
    /// ρ/η²·Σ(ρ·r)^k: the base's f·π but for the two transmittances.
    base: Rgb,
    /// Largest component of the base's directional albedo but for t(θo).
    base_albedo: f32,
}

/// What one outgoing direction decides.
struct Outgoing {
    transmittance: f32,
    /// Probability of sampling the interface's reflection.
    interface: f32,
}

impl<'a> CoatedDiffuse<'a> {
    /// Over one table; see [`CoatedTables`](super::CoatedTables) for textured roughness.
    /// `ggx` is the interface's roughness that the table was made for.
    #[inline]
    #[must_use]
    pub fn with_table(table: &'a CoatedTable, reflectance: Rgb, ggx: Ggx) -> Self {
        Self::new(table, table, 0.0, reflectance, ggx)
    }

    #[inline]
    pub(super) fn new(
        low: &'a CoatedTable,
        high: &'a CoatedTable,
        blend: f32,
        reflectance: Rgb,
        ggx: Ggx,
    ) -> Self {
        let rho = unit(reflectance);
        // Below 1 whatever the index: the escape cone never closes. The bound keeps 1/(1−x) finite.
        let x = (rho * lerp(blend, low.internal, high.internal)).min(Rgb::splat(0.9999));
        let series = (Rgb::ONE - power(x, low.bounces)) / (Rgb::ONE - x);
        let base = rho * series / (low.eta * low.eta);
        let mean = lerp(blend, low.mean_transmittance, high.mean_transmittance);
        Self { low, high, blend, ggx, smooth: ggx.is_smooth(), base, base_albedo: base.max_element() * mean }
    }

    #[inline(always)]
    fn table(&self, cos: f32) -> [f32; 2] {
        let [t, r] = self.low.at(cos);
        if self.blend == 0.0 {
            return [t, r];
        }
        let [t1, r1] = self.high.at(cos);
        [lerp(self.blend, t, t1), lerp(self.blend, r, r1)]
    }

    /// The lobes are chosen by their directional albedos, so no weight exceeds the total albedo
    /// by more than the lobes' own spread.
    #[inline(always)]
    fn outgoing(&self, wo: Vec3) -> Outgoing {
        let [transmittance, reflectance] = self.table(wo.z.abs());
        let total = reflectance + self.base_albedo * transmittance;
        let interface = if total > 0.0 { reflectance / total } else { 1.0 };
        Outgoing { transmittance, interface }
    }

    /// Both lobes' f·cosθ and density; the smooth interface's delta lobe is left out.
    #[inline(always)]
    fn eval_from(&self, from: &Outgoing, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        let zi = wi.z.abs();
        let cosine = zi * INV_PI;
        let f = self.base * (from.transmittance * self.table(zi)[0] * cosine);
        let pdf = (1.0 - from.interface) * cosine;
        if self.smooth {
            return (f, pdf);
        }
        let Some((cos_d, reflected, lobe_pdf)) = reflection(&self.ggx, wo, wi) else { return (f, pdf) };
        let fresnel = fresnel::dielectric(cos_d, self.low.eta).0;
        (f + Rgb::splat(fresnel * reflected), pdf + from.interface * lobe_pdf)
    }

    #[inline(always)]
    pub(super) fn eval(&self, wo: Vec3, wi: Vec3) -> (Rgb, f32) {
        if !same_side(wo, wi) {
            return ZERO;
        }
        self.eval_from(&self.outgoing(wo), wo, wi)
    }

    #[inline(always)]
    pub(super) fn sample(&self, wo: Vec3, uc: f32, u: Vec2) -> Option<BsdfSample> {
        if wo.z == 0.0 {
            return None;
        }
        let from = self.outgoing(wo);
        let wi = if uc < from.interface {
            if self.smooth {
                let f = fresnel::dielectric(wo.z.abs(), self.low.eta).0;
                let weight = Rgb::splat(f / from.interface);
                let sample = BsdfSample::reflection(mirror(wo), weight, from.interface);
                return (f > 0.0).then_some(BsdfSample { delta: true, ..sample });
            }
            sample_reflection(&self.ggx, wo, u)?.0
        } else {
            let wi = cosine_hemisphere(u);
            Vec3::new(wi.x, wi.y, wi.z.copysign(wo.z))
        };
        if !same_side(wo, wi) {
            return None;
        }
        let (f, pdf) = self.eval_from(&from, wo, wi);
        (pdf > 0.0).then(|| BsdfSample::reflection(wi, f / pdf, pdf))
    }
}

/// xⁿ by repeated squaring.
#[inline(always)]
fn power(x: Rgb, n: u32) -> Rgb {
    let (mut result, mut square, mut n) = (Rgb::ONE, x, n);
    while n > 0 {
        if n & 1 == 1 {
            result *= square;
        }
        square *= square;
        n >>= 1;
    }
    result
}
