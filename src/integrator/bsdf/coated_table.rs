//! What a dielectric layer over a Lambertian base lets through, tabulated once per material.
//! Invariant: deterministic, no random numbers; entries lie in [0, 1]. Never sees the base's
//! colour: one table serves every texel.
//!
//! pbrt-v4 estimates its `LayeredBxDF` by a random walk. Over a Lambertian base the walk's
//! expectation factors: light enters (t), bounces between base and interface (r, once per further
//! bounce), and leaves (t again, by reciprocity).

use super::{CoatedDiffuse, Ggx, fresnel, valid_eta};
use crate::color::Rgb;
use crate::math::{Vec2, Vec3, sqr};

/// Intervals over √cosθ; roughness moves the grazing end most, so it gets most of the entries.
const INTERVALS: usize = 127;
/// Quadrature points of visible normals: polar by half the azimuth (both halves are mirrored).
const FACETS: [usize; 2] = [20, 12];
/// For the internal reflection: facets have critical angles too, whose kinks want more azimuths.
const FACETS_INSIDE: [usize; 2] = [16, 20];
/// Quadrature points on either side of the critical angle for the internal reflection, rough
/// and smooth: the smooth ones are cheap, having one facet.
const INTERNAL: [usize; 2] = [24, 512];
/// Alphas of a table for textured roughness, equidistant in √α over [0, 1].
const ALPHAS: usize = 16;

/// One interface of one roughness over a layer, as functions of the outside cosine.
#[derive(Clone, Debug)]
pub struct CoatedTable {
    pub(super) eta: f32,
    /// Bounces off the base that count.
    pub(super) bounces: u32,
    /// Of the light that leaves the base, what comes back to it: through the layer, reflected by
    /// the interface, through the layer.
    pub(super) internal: f32,
    /// Cosine-weighted average of the transmittance below.
    pub(super) mean_transmittance: f32,
    /// At cosθ = (i/INTERVALS)²: energy that enters and reaches the base; energy reflected by the
    /// interface outwards.
    entries: [[f32; 2]; INTERVALS + 1],
}

impl CoatedTable {
    /// `eta` is the layer's index over the outside's, α along x and y, `thickness` in mean free
    /// paths (pbrt's σt = 1; it absorbs, as pbrt's does with albedo 0), `max_depth` pbrt's
    /// `maxdepth`. Where α_x ≠ α_y the table is that of the isotropic √(α_x·α_y): only what
    /// passes through the interface is approximated so, its reflection stays anisotropic.
    /// For eta < 1 the table smears the kink at the outer critical angle over one interval.
    /// Takes about 3 ms, a smooth interface far less.
    #[must_use]
    pub fn new(eta: f32, alpha_x: f32, alpha_y: f32, thickness: f32, max_depth: u32) -> Self {
        let given = Ggx::new(alpha_x, alpha_y);
        let ggx = if given.is_smooth() {
            Ggx::new(0.0, 0.0)
        } else {
            // Not below what is smooth: the given one is not.
            let mean = (alpha_x.max(0.0) * alpha_y.max(0.0)).sqrt().max(1e-3);
            Ggx::new(mean, mean)
        };
        let (eta, thickness) = (valid_eta(eta), thickness.max(0.0));
        let entries = std::array::from_fn(|i| {
            let cos = sqr(i as f32 / INTERVALS as f32);
            let passed = Interface { ggx, eta, thickness }.integrate(cos, FACETS);
            [passed.transmitted, passed.reflected]
        });
        let mut table =
            Self { eta, bounces: max_depth.div_ceil(2), internal: 0.0, mean_transmittance: 0.0, entries };
        table.mean_transmittance = table.average_transmittance();
        let points = INTERNAL[usize::from(ggx.is_smooth())];
        let inside = Interface { ggx, eta: 1.0 / eta, thickness };
        table.internal = internal_reflectance(inside, points, FACETS_INSIDE);
        table
    }

    /// (transmittance to the base, interface reflectance) for light from outside at `cos` ≥ 0.
    #[inline(always)]
    pub(super) fn at(&self, cos: f32) -> [f32; 2] {
        let x = cos.min(1.0).sqrt() * INTERVALS as f32;
        let i = (x as usize).min(INTERVALS - 1);
        let f = x - i as f32;
        let ([t0, r0], [t1, r1]) = (self.entries[i], self.entries[i + 1]);
        [t0 + f * (t1 - t0), r0 + f * (r1 - r0)]
    }

    /// ∫ 2cosθ t d(cosθ) by Simpson's rule on the entries' intervals.
    fn average_transmittance(&self) -> f32 {
        let density = |x: f32| f64::from(4.0 * x * x * x * self.at(x * x)[0]);
        let h = 1.0 / INTERVALS as f32;
        let sum: f64 = (0..INTERVALS)
            .map(|i| {
                let x = i as f32 * h;
                density(x) + 4.0 * density(x + 0.5 * h) + density(x + h)
            })
            .sum();
        (sum / (6.0 * INTERVALS as f64)) as f32
    }
}

/// An interface as seen from one side, with the layer behind it.
#[derive(Clone, Copy)]
struct Interface {
    ggx: Ggx,
    /// Far index over near one.
    eta: f32,
    thickness: f32,
}

/// Fractions of the incident energy.
#[derive(Clone, Copy, Default)]
struct Passed {
    /// Refracted and through the far side's layer.
    transmitted: f32,
    /// Reflected.
    reflected: f32,
    /// Reflected and through the layer on the near side.
    reflected_through_layer: f32,
}

impl Interface {
    fn transmittance(&self, cos: f32) -> f32 {
        // Beer's law with σt = 1; a zero cosine and a zero thickness leave 0/0.
        if self.thickness == 0.0 { 1.0 } else { (-self.thickness / cos).exp() }
    }

    /// Midpoint rule over the square that visible normals are sampled from, quadratically denser
    /// towards normals at the horizon, where the weights have a root singularity.
    fn integrate(&self, cos: f32, [polar, azimuth]: [usize; 2]) -> Passed {
        if self.ggx.is_smooth() {
            let (f, cos_t) = fresnel::dielectric(cos, self.eta);
            return Passed {
                transmitted: (1.0 - f) * self.transmittance(cos_t),
                reflected: f,
                reflected_through_layer: f * self.transmittance(cos),
            };
        }
        // Directions in the plane itself have no visible normals; the limit does.
        let z = cos.max(1e-6);
        let wo = Vec3::new((1.0 - z * z).max(0.0).sqrt(), 0.0, z);
        let so = self.ggx.stretch(wo);
        let masked = |zi: f32, wi: Vec3| zi * (z + so) / (so * zi + self.ggx.stretch(wi) * z);
        let mut sums = [0f64; 3];
        for i in 0..polar {
            let s = 1.0 - (i as f32 + 0.5) / polar as f32;
            for j in 0..azimuth {
                let u = Vec2::new((j as f32 + 0.5) / (2 * azimuth) as f32, 1.0 - s * s);
                let Some(m) = self.ggx.sample_visible(wo, u) else { continue };
                let om = wo.dot(m);
                if om <= 0.0 {
                    continue;
                }
                let (f, cos_t) = fresnel::dielectric(om, self.eta);
                let wi = m * (2.0 * om) - wo;
                if wi.z > 0.0 {
                    let reflected = 2.0 * s * f * masked(wi.z, wi);
                    sums[1] += f64::from(reflected);
                    sums[2] += f64::from(reflected * self.transmittance(wi.z));
                }
                let wi = m * (om / self.eta - cos_t) - wo / self.eta;
                if f < 1.0 && wi.z < 0.0 {
                    let transmitted = 2.0 * s * (1.0 - f) * masked(-wi.z, wi);
                    sums[0] += f64::from(transmitted * self.transmittance(-wi.z));
                }
            }
        }
        let [transmitted, reflected, reflected_through_layer] =
            sums.map(|s| (s / (polar * azimuth) as f64) as f32);
        Passed { transmitted, reflected, reflected_through_layer }
    }
}

/// Average over the base's cosine-weighted hemisphere, in μ = cos²θ, which is uniform. The
/// smooth interface's reflectance has a root singularity at the critical angle μ = 1 − η², and
/// absorption one at the horizon: each side of the critical angle is integrated apart, its
/// variable slowed quadratically at both ends (3s² − 2s³), so that the integrand stays smooth.
fn internal_reflectance(inside: Interface, points: usize, facets: [usize; 2]) -> f32 {
    let critical = (1.0 - inside.eta * inside.eta).max(0.0);
    let mut sum = 0f64;
    for i in 0..points {
        let s = (i as f32 + 0.5) / points as f32;
        let (share, jacobian) = (s * s * (3.0 - 2.0 * s), 6.0 * s * (1.0 - s) / points as f32);
        for (from, to) in [(critical, 1.0), (critical, 0.0)] {
            let cos = (from + (to - from) * share).max(0.0).sqrt();
            let fraction = inside.integrate(cos, facets).reflected_through_layer * inside.transmittance(cos);
            sum += f64::from(fraction * jacobian * (to - from).abs());
        }
    }
    sum as f32
}

/// The tables of one material: one where its roughness is constant, a grid where it is textured.
#[derive(Clone, Debug)]
pub struct CoatedTables {
    tables: Box<[CoatedTable]>,
}

impl CoatedTables {
    /// For a constant roughness; the arguments are [`CoatedTable::new`]'s.
    #[must_use]
    pub fn constant(eta: f32, alpha_x: f32, alpha_y: f32, thickness: f32, max_depth: u32) -> Self {
        Self { tables: Box::new([CoatedTable::new(eta, alpha_x, alpha_y, thickness, max_depth)]) }
    }

    /// For any roughness: a grid over √α in [0, 1], interpolated; above 1 it stays at 1.
    #[must_use]
    pub fn textured(eta: f32, thickness: f32, max_depth: u32) -> Self {
        let at = |i: usize| sqr(i as f32 / (ALPHAS - 1) as f32);
        Self {
            tables: (0..ALPHAS).map(|i| CoatedTable::new(eta, at(i), at(i), thickness, max_depth)).collect(),
        }
    }

    /// The scattering function at one point. For constant roughness α must be the tables' own.
    #[inline]
    #[must_use]
    pub fn bsdf(&self, reflectance: Rgb, alpha_x: f32, alpha_y: f32) -> CoatedDiffuse<'_> {
        let ggx = Ggx::new(alpha_x, alpha_y);
        let [table] = &*self.tables else {
            // √√(α_x·α_y): the grid is equidistant in the root of the isotropic α.
            let root =
                if ggx.is_smooth() { 0.0 } else { (alpha_x.max(0.0) * alpha_y.max(0.0)).sqrt().sqrt() };
            let x = root.min(1.0) * (ALPHAS - 1) as f32;
            let i = (x as usize).min(ALPHAS - 2);
            return CoatedDiffuse::new(&self.tables[i], &self.tables[i + 1], x - i as f32, reflectance, ggx);
        };
        CoatedDiffuse::new(table, table, 0.0, reflectance, ggx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the same integrals with many times the points, in the middle between entries, for
    /// smooth to very rough and thin to thick. What the model's value depends on, transmittance and
    /// internal reflectance, keeps to 1e-3; the reflectance only shares out samples between the lobes, and
    /// at α = 0.001 dips more steeply than the entries lie.
    #[test]
    fn interpolation_error_is_small() {
        let fine = [128, 64];
        for (eta, thickness) in [(1.5, 0.01), (1.2, 0.0), (2.0, 0.5)] {
            for alpha in [0.0, 1e-3, 0.01, 0.05, 0.2, 0.5, 1.0] {
                let table = CoatedTable::new(eta, alpha, alpha, thickness, 10);
                let ggx = Ggx::new(alpha, alpha);
                let outside = Interface { ggx, eta, thickness };
                let (mut transmitted, mut reflected) = (0f32, 0f32);
                for i in 0..INTERVALS {
                    let cos = sqr((i as f32 + 0.5) / INTERVALS as f32);
                    let exact = outside.integrate(cos, fine);
                    let [t, r] = table.at(cos);
                    transmitted = transmitted.max((t - exact.transmitted).abs());
                    reflected = reflected.max((r - exact.reflected).abs());
                }
                let points = if ggx.is_smooth() { 4096 } else { 96 };
                let inside = Interface { eta: 1.0 / eta, ..outside };
                let internal = (table.internal - internal_reflectance(inside, points, fine)).abs();
                println!(
                    "eta {eta} thickness {thickness} alpha {alpha}: {transmitted:.5} {reflected:.5} {internal:.5}"
                );
                assert!(transmitted < 1e-3 && internal < 1e-3 && reflected < 4e-3);
            }
        }
    }

    /// The internal reflectance of a smooth, clear layer has a closed form: by Duntley's
    /// symmetry of both sides, 1 − (1 − R_outside)/η², with R_outside the diffuse Fresnel
    /// reflectance, 0.0918 at η = 1.5 (Egan and Hilgeman 1979: internal 0.5963).
    #[test]
    fn clear_smooth_layer_has_its_known_reflectance() {
        let table = CoatedTable::new(1.5, 0.0, 0.0, 0.0, 10);
        assert!((table.mean_transmittance - (1.0 - 0.0918)).abs() < 1e-4, "{}", table.mean_transmittance);
        assert!((table.internal - 0.5963).abs() < 2e-4, "{}", table.internal);
        assert!((1.0 - table.internal - table.mean_transmittance / 2.25).abs() < 2e-4);
    }

    /// Interpolating over roughness costs more than over angle; here is how much.
    #[test]
    fn textured_roughness_is_close_to_its_own_table() {
        let tables = CoatedTables::textured(1.5, 0.01, 10);
        let mut worst = 0f32;
        for alpha in [5e-4, 2e-3, 0.01, 0.07, 0.15, 0.33, 0.6, 0.95] {
            let own = CoatedTable::new(1.5, alpha, alpha, 0.01, 10);
            let own = CoatedDiffuse::with_table(&own, Rgb::splat(0.8), Ggx::new(alpha, alpha));
            let blended = tables.bsdf(Rgb::splat(0.8), alpha, alpha);
            for i in 1..=50 {
                for j in 1..=50 {
                    let at = |i: i32| {
                        let z = i as f32 / 50.0;
                        Vec3::new((1.0 - z * z).sqrt(), 0.0, z)
                    };
                    let (wo, wi) = (at(i), at(j));
                    let (a, b) = (own.eval(wo, wi).0.x, blended.eval(wo, wi).0.x);
                    // As a reflectance factor, where a white Lambertian surface is 1.
                    worst = worst.max((a - b).abs() * std::f32::consts::PI / wi.z);
                }
            }
        }
        println!("largest difference in reflectance factor {worst:.5}");
        assert!(worst < 0.02, "{worst}");
    }

    #[test]
    fn depth_counts_bounces_off_the_base() {
        let bounces = |depth| CoatedTable::new(1.5, 0.0, 0.0, 0.0, depth).bounces;
        assert_eq!([0, 1, 2, 3, 10].map(bounces), [0, 1, 1, 2, 5]);
    }
}
