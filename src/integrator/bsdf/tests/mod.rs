//! Tests of the scattering functions: known answers, then statistics. Random numbers have fixed
//! seeds, so a passing build stays so; the stated false-alarm rates are over seeds.

mod chi_squared;
mod consistency;
mod energy;
mod speed;
mod walk;

use super::*;

/// SplitMix64 (Steele, Lea and Flood 2014): plain, and shares nothing with the renderer.
pub(super) struct Rng(pub(super) u64);

impl Rng {
    pub(super) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1), 24 bits.
    pub(super) fn f32(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1u32 << 24) as f32
    }

    /// Uniform in [0, 1), 53 bits.
    pub(super) fn f64(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(super) fn vec2(&mut self) -> Vec2 {
        Vec2::new(self.f32(), self.f32())
    }
}

/// Unit vector by cosine and azimuth.
pub(super) fn direction(cos: f32, phi: f32) -> Vec3 {
    let c = f64::from(cos);
    let s = (1.0 - c * c).max(0.0).sqrt();
    let (y, x) = f64::from(phi).sin_cos();
    glam::DVec3::new(s * x, s * y, c).as_vec3()
}

/// Roughnesses from nearly a mirror to very rough, two of them anisotropic.
pub(super) const ALPHAS: [(f32, f32); 6] =
    [(0.02, 0.02), (0.1, 0.1), (0.3, 0.3), (0.8, 0.8), (0.05, 0.4), (0.6, 0.15)];

/// From above to grazing, then from below.
pub(super) const COSINES: [f32; 6] = [1.0, 0.7, 0.3, 0.04, -0.9, -0.2];

pub(super) fn gold(alpha: (f32, f32)) -> Conductor {
    // Gold at about 630, 550 and 450 nm.
    Conductor::new(Rgb::new(0.18, 0.42, 1.37), Rgb::new(3.4, 2.35, 1.77), Ggx::new(alpha.0, alpha.1))
}

/// Every model with non-delta lobes, at every roughness, with a name for messages.
pub(super) fn with_density(tables: &[CoatedTable]) -> Vec<(String, Bsdf<'_>)> {
    let mut all = vec![
        ("diffuse".into(), Bsdf::Diffuse(Diffuse::new(Rgb::new(0.2, 0.5, 0.9)))),
        (
            "diffuse transmission".into(),
            Bsdf::DiffuseTransmission(DiffuseTransmission::new(
                Rgb::new(0.1, 0.2, 0.3),
                Rgb::new(0.5, 0.4, 0.3),
            )),
        ),
    ];
    let colour = Rgb::new(0.2, 0.5, 0.8);
    for (i, alpha) in ALPHAS.into_iter().enumerate() {
        let ggx = Ggx::new(alpha.0, alpha.1);
        all.push((format!("conductor {alpha:?}"), Bsdf::Conductor(gold(alpha))));
        all.push((format!("dielectric {alpha:?}"), Bsdf::Dielectric(Dielectric::new(1.5, ggx))));
        let coated = CoatedDiffuse::with_table(&tables[i], colour, ggx);
        all.push((format!("coated {alpha:?}"), Bsdf::CoatedDiffuse(coated)));
    }
    let smooth = CoatedDiffuse::with_table(&tables[ALPHAS.len()], colour, Ggx::new(0.0, 0.0));
    all.push(("coated smooth".into(), Bsdf::CoatedDiffuse(smooth)));
    all
}

/// The tables that [`with_density`] needs: one for each of [`ALPHAS`], and the smooth one.
pub(super) fn coated_tables() -> Vec<CoatedTable> {
    ALPHAS.iter().chain([&(0.0, 0.0)]).map(|a| CoatedTable::new(1.5, a.0, a.1, 0.01, 10)).collect()
}
