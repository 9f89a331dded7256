//! `sample` against `eval`, reciprocity, Fresnel's known values, and extreme inputs.

use super::*;
use std::f32::consts::TAU;

/// weight·pdf is f·cosθ and both densities agree, for all models, at 2,000 draws each.
#[test]
fn sample_agrees_with_eval() {
    let tables = coated_tables();
    let mut rng = Rng(1);
    for (name, bsdf) in with_density(&tables) {
        for cos in COSINES {
            let wo = direction(cos, 1.1);
            for _ in 0..2000 {
                let Some(s) = bsdf.sample(wo, rng.f32(), rng.vec2()) else { continue };
                if s.delta {
                    continue;
                }
                let (f, pdf) = bsdf.eval(wo, s.wi);
                // sample knows the facet exactly, eval finds it from wi: wi's rounding, 1e-7,
                // turns it by up to 1e-7/|h|, which a lobe of width α sees as 4·1e-7/(|h|·α); at
                // α = 0.02 and |h| = 0.04 that is 5e-4. Refraction: |h| is down to 0.5·α, likewise.
                let close = |a: f32, b: f32| (a - b).abs() <= 2e-3 * a.abs().max(b.abs());
                assert!(close(pdf, s.pdf), "{name} {cos}: pdf {} against {pdf}, wi {}", s.pdf, s.wi);
                for c in 0..3 {
                    assert!(
                        close(s.weight[c] * s.pdf, f[c]),
                        "{name} {cos}: {} against {f}",
                        s.weight * s.pdf
                    );
                }
            }
        }
    }
}

/// f(wo, wi) = f(wi, wo) on one side; across an interface radiance scales with η²:
/// f(wo, wi)·η_i² = f(wi, wo)·η_o².
#[test]
fn scattering_is_reciprocal() {
    let tables = coated_tables();
    let mut rng = Rng(2);
    for (name, bsdf) in with_density(&tables) {
        let mut compared = 0;
        for _ in 0..20_000 {
            let wo = direction(2.0 * rng.f32() - 1.0, TAU * rng.f32());
            let wi = direction(2.0 * rng.f32() - 1.0, TAU * rng.f32());
            if wo.z.abs().min(wi.z.abs()) < 0.01 {
                continue;
            }
            let (forward, _) = bsdf.eval(wo, wi);
            let (backward, _) = bsdf.eval(wi, wo);
            let (mut a, mut b) = (forward / wi.z.abs(), backward / wo.z.abs());
            if wo.z * wi.z < 0.0 && matches!(bsdf, Bsdf::Dielectric(_)) {
                let index2 = |w: Vec3| if w.z > 0.0 { 1.0 } else { 1.5 * 1.5 };
                a *= index2(wi);
                b *= index2(wo);
            }
            compared += usize::from(a != Rgb::ZERO);
            for c in 0..3 {
                // Rounding as above; here most directions lie far from the lobe.
                assert!((a[c] - b[c]).abs() <= 1e-3 * a[c].max(b[c]) + 1e-6, "{name} {wo} {wi}: {a} {b}");
            }
        }
        assert!(compared > 1000, "{name}: only {compared} pairs scattered");
    }
}

#[test]
fn fresnel_has_its_known_values() {
    let r = |cos| fresnel::dielectric(cos, 1.5).0;
    assert!((r(1.0) - 0.04).abs() < 1e-7);
    assert_eq!(r(0.0), 1.0);
    // At Brewster's angle, tanθ = η, only s-polarised light returns: ½((1−η²)/(1+η²))².
    let brewster = 1.0 / (1.0f32 + 1.5 * 1.5).sqrt();
    let s = (1.0 - 2.25f32) / (1.0 + 2.25);
    assert!((r(brewster) - 0.5 * s * s).abs() < 1e-7);
    // Inside: total reflection begins at sinθ = 1/1.5.
    let critical = (1.0f32 - 1.0 / 2.25).sqrt();
    assert_eq!(fresnel::dielectric(critical - 1e-4, 1.0 / 1.5), (1.0, 0.0));
    assert!(fresnel::dielectric(critical + 1e-3, 1.0 / 1.5).0 < 0.9);
    // Both sides of the interface reflect alike along one refracted path.
    let (outside, cos_t) = fresnel::dielectric(0.4, 1.5);
    let (inside, back) = fresnel::dielectric(cos_t, 1.0 / 1.5);
    assert!((outside - inside).abs() < 1e-6 && (back - 0.4).abs() < 1e-6);

    let (eta, k) = (Rgb::new(0.2, 1.5, 1.0), Rgb::new(3.0, 0.0, 2.0));
    let normal = fresnel::conductor(1.0, eta, k);
    for c in 0..3 {
        let expected = ((eta[c] - 1.0).powi(2) + k[c].powi(2)) / ((eta[c] + 1.0).powi(2) + k[c].powi(2));
        assert!((normal[c] - expected).abs() < 1e-6);
    }
    // Without absorption a metal is a dielectric.
    for i in 0..=20 {
        let cos = i as f32 / 20.0;
        let metal = fresnel::conductor(cos, Rgb::splat(1.5), Rgb::ZERO).x;
        assert!((metal - r(cos)).abs() < 2e-6, "{cos}: {metal} {}", r(cos));
    }
    for reflectance in [0.0f32, 0.1, 0.5, 0.99] {
        let metal = Conductor::from_reflectance(Rgb::splat(reflectance), Ggx::new(0.0, 0.0));
        let sample = metal.sample(Vec3::Z, Vec2::ZERO).expect("a mirror reflects");
        assert!((sample.weight.x - reflectance).abs() < 1e-6 && sample.delta);
    }
}

#[test]
fn smoothness_follows_the_larger_alpha() {
    assert!(Ggx::new(0.0, 9e-4).is_smooth());
    assert!(!Ggx::new(0.0, 1e-3).is_smooth());
    assert!(Bsdf::Dielectric(Dielectric::new(1.0, Ggx::new(0.5, 0.5))).is_delta());
    assert_eq!(roughness_to_alpha(0.25), 0.5);
    assert_eq!(roughness_to_alpha(-1.0), 0.0);
    let smooth = Conductor::new(Rgb::ONE, Rgb::ONE, Ggx::new(0.0, 0.0));
    assert_eq!(smooth.eval(Vec3::Z, Vec3::Z), ZERO);
}

#[test]
fn smooth_directions_obey_mirror_and_snell() {
    let glass = Bsdf::Dielectric(Dielectric::new(1.5, Ggx::new(0.0, 0.0)));
    let wo = direction(0.6, 0.3);
    let through = glass.sample(wo, 0.999, Vec2::ZERO).expect("light passes");
    assert!(through.delta && through.transmission && through.eta == 1.5);
    assert!((through.wi.x * 1.5 + wo.x).abs() < 1e-6 && (through.wi.length() - 1.0).abs() < 1e-6);
    assert!((through.weight.x - 1.0 / 2.25).abs() < 1e-7);
    let back = glass.sample(through.wi, 0.999, Vec2::ZERO).expect("light passes back");
    assert!((back.wi - wo).length() < 1e-6);
    assert!((back.eta * 1.5 - 1.0).abs() < 1e-7 && (back.weight.x - 2.25).abs() < 1e-6);
    let mirror = glass.sample(wo, 0.0, Vec2::ZERO).expect("light reflects");
    assert_eq!(mirror.wi, Vec3::new(-wo.x, -wo.y, wo.z));
    // Beyond the critical angle all is reflected, whatever chooses.
    let inside = glass.sample(direction(-0.3, 0.0), 0.999, Vec2::ZERO).expect("total reflection");
    assert!(!inside.transmission && inside.pdf == 1.0 && inside.weight == Rgb::ONE);
}

/// An angle, index or roughness no artist writes must still give numbers a film can add.
#[test]
fn extreme_inputs_give_finite_results() {
    let mut rng = Rng(3);
    let table = CoatedTable::new(1.5, 0.3, 0.3, 0.01, 10);
    let extreme = |rng: &mut Rng, tiny: f32| match (rng.f32() * 8.0) as u32 {
        0 => 0.0,
        1 => -0.0,
        2 => tiny,
        3 => -tiny,
        4 => 10f32.powf(-30.0 * rng.f32()),
        5 => -(10f32.powf(-30.0 * rng.f32())),
        _ => 2.0 * rng.f32() - 1.0,
    };
    for i in 0..1_000_000 {
        let wo = direction(extreme(&mut rng, f32::MIN_POSITIVE), TAU * rng.f32());
        let alpha = |rng: &mut Rng| 10f32.powf(-4.0 * rng.f32());
        let ggx = Ggx::new(alpha(&mut rng), alpha(&mut rng));
        let eta = 1.0 + extreme(&mut rng, 1e-7).abs() * 2.0;
        let bsdf = match i % 6 {
            0 => Bsdf::Dielectric(Dielectric::new(eta, ggx)),
            1 => Bsdf::Dielectric(Dielectric::new(1.0 / eta, ggx)),
            2 => Bsdf::Conductor(Conductor::new(Rgb::splat(eta), Rgb::splat(eta - 1.0), ggx)),
            3 => Bsdf::CoatedDiffuse(CoatedDiffuse::with_table(&table, Rgb::splat(rng.f32()), ggx)),
            4 => Bsdf::ThinDielectric(ThinDielectric::new(eta)),
            _ => Bsdf::Conductor(Conductor::from_reflectance(Rgb::ONE, ggx)),
        };
        let u = if i % 11 == 0 { Vec2::splat(1.0 - f32::EPSILON / 2.0) } else { rng.vec2() };
        let valid =
            |f: Rgb, pdf: f32| f.is_finite() && f.min_element() >= 0.0 && pdf.is_finite() && pdf >= 0.0;
        let wi = match bsdf.sample(wo, rng.f32(), u) {
            Some(s) => {
                assert!(valid(s.weight, s.pdf) && s.pdf > 0.0, "{bsdf:?} {wo} {u}: {s:?}");
                assert!((s.wi.length() - 1.0).abs() < 1e-4, "{bsdf:?} {wo} {u}: {s:?}");
                s.wi
            }
            None => direction(extreme(&mut rng, 1e-38), TAU * rng.f32()),
        };
        for wi in [wi, direction(extreme(&mut rng, 1e-30), TAU * rng.f32()), wo, -wo, mirror(wo)] {
            let (f, pdf) = bsdf.eval(wo, wi);
            assert!(valid(f, pdf), "{bsdf:?} {wo} {wi}: {f} {pdf}");
        }
    }
}
