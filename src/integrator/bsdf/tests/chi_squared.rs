//! Does every sampler draw from the density it states? Pearson's χ² over the whole sphere.

use super::*;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

const ROWS: usize = 40;
const COLUMNS: usize = 80;
const DRAWS: usize = 200_000;

/// Upper tail of the χ² distribution: the regularised incomplete Γ by series or continued
/// fraction (Press et al., Numerical Recipes, §6.2).
fn chi_squared_tail(chi2: f64, degrees: f64) -> f64 {
    let (a, x) = (0.5 * degrees, 0.5 * chi2);
    let scale = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        while term > sum * 1e-15 {
            n += 1.0;
            term *= x / n;
            sum += term;
        }
        return 1.0 - sum * scale;
    }
    let mut b = x + 1.0 - a;
    let (mut c, mut d) = (1e300, 1.0 / b);
    let mut h = d;
    for i in 1..10_000 {
        let an = -f64::from(i) * (f64::from(i) - a);
        b += 2.0;
        d = 1.0 / (an * d + b);
        c = b + an / c;
        h *= d * c;
        if (d * c - 1.0).abs() < 1e-14 {
            break;
        }
    }
    h * scale
}

/// Stirling's series, after raising the argument to where it converges to 1e-12.
fn ln_gamma(mut x: f64) -> f64 {
    let mut shift = 0.0;
    while x < 15.0 {
        shift -= x.ln();
        x += 1.0;
    }
    let i = 1.0 / (x * x);
    shift + (x - 0.5) * x.ln() - x
        + 0.5 * TAU.ln()
        + (1.0 / 12.0 - i * (1.0 / 360.0 - i * (1.0 / 1260.0 - i / 1680.0))) / x
}

#[test]
fn tail_of_chi_squared_has_its_tabulated_values() {
    for (chi2, degrees, tail) in [(3.841, 1.0, 0.05), (18.307, 10.0, 0.05), (124.342, 100.0, 0.05)] {
        assert!((chi_squared_tail(chi2, degrees) - tail).abs() < 1e-4);
    }
    assert!((chi_squared_tail(149.449, 100.0) - 0.001).abs() < 1e-5);
}

/// 4-point Gauss–Legendre on [0, 1]: nodes and weights.
const GAUSS: [(f64, f64); 4] = [
    (0.069_431_844_202_973_7, 0.173_927_422_568_726_9),
    (0.330_009_478_207_571_9, 0.326_072_577_431_273_1),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_1),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_9),
];

/// ∫ pdf over a rectangle in (cosθ, φ), halved in both until the parts agree with the whole.
fn integral(pdf: &impl Fn(f64, f64) -> f64, lo: [f64; 2], hi: [f64; 2], depth: u32) -> f64 {
    let size = [hi[0] - lo[0], hi[1] - lo[1]];
    let rule = |lo: [f64; 2], size: [f64; 2]| {
        let mut sum = 0.0;
        for (x, wx) in GAUSS {
            for (y, wy) in GAUSS {
                sum += wx * wy * pdf(lo[0] + x * size[0], lo[1] + y * size[1]);
            }
        }
        sum * size[0] * size[1]
    };
    let half = [0.5 * size[0], 0.5 * size[1]];
    let corners = [[0, 0], [0, 1], [1, 0], [1, 1]]
        .map(|[i, j]| [lo[0] + f64::from(i) * half[0], lo[1] + f64::from(j) * half[1]]);
    let parts: f64 = corners.iter().map(|&c| rule(c, half)).sum();
    // Well below the counting noise of a cell (√5/DRAWS at its smallest, 1e-5).
    if depth == 0 || (parts - rule(lo, size)).abs() < 1e-7 + 1e-4 * parts {
        return parts;
    }
    corners.iter().map(|&c| integral(pdf, c, [c[0] + half[0], c[1] + half[1]], depth - 1)).sum()
}

/// p-value of the draws against the density; what no direction carries is a cell of its own.
fn p_value(bsdf: &Bsdf, wo: Vec3, seed: u64) -> f64 {
    let mut counts = vec![0u32; ROWS * COLUMNS];
    let mut rng = Rng(seed);
    for _ in 0..DRAWS {
        let Some(s) = bsdf.sample(wo, rng.f32(), rng.vec2()) else { continue };
        if s.delta {
            continue;
        }
        assert_eq!(s.transmission, s.wi.z * wo.z < 0.0);
        let row = ((f64::from(s.wi.z) + 1.0) * 0.5 * ROWS as f64) as usize;
        let phi = f64::from(s.wi.y).atan2(f64::from(s.wi.x)).rem_euclid(TAU);
        let column = (phi / TAU * COLUMNS as f64) as usize;
        counts[row.min(ROWS - 1) * COLUMNS + column.min(COLUMNS - 1)] += 1;
    }
    let pdf = |cos: f64, phi: f64| f64::from(bsdf.eval(wo, direction(cos as f32, phi as f32)).1);
    let (mut chi2, mut cells) = (0.0, 0);
    let (mut expected_all, mut counted_all) = (0.0, 0);
    let (mut expected_few, mut counted_few) = (0.0, 0);
    let mut add = |expected: f64, counted: u32| {
        chi2 += (f64::from(counted) - expected).powi(2) / expected;
        cells += 1;
    };
    for (cell, &counted) in counts.iter().enumerate() {
        let lo = [
            -1.0 + 2.0 * (cell / COLUMNS) as f64 / ROWS as f64,
            TAU * (cell % COLUMNS) as f64 / COLUMNS as f64,
        ];
        let hi = [lo[0] + 2.0 / ROWS as f64, lo[1] + TAU / COLUMNS as f64];
        let expected = DRAWS as f64 * integral(&pdf, lo, hi, 14);
        expected_all += expected;
        counted_all += counted;
        if expected < 5.0 {
            expected_few += expected;
            counted_few += counted;
        } else {
            add(expected, counted);
        }
    }
    let nothing = DRAWS as f64 - expected_all;
    assert!(nothing > -1e-3 * DRAWS as f64, "density integrates to more than 1: {expected_all}");
    for (expected, counted) in [(expected_few, counted_few), (nothing, DRAWS as u32 - counted_all)] {
        if expected >= 5.0 {
            add(expected, counted);
        } else {
            // Too few for χ²: a Poisson bound, for which 30 is beyond 1e-12.
            assert!(counted < 30, "{counted} draws where {expected} were expected");
        }
    }
    chi_squared_tail(chi2, f64::from(cells - 1))
}

/// False-alarm rate 1e-3 for all cases together, each at its Šidák share.
#[test]
fn samples_follow_the_stated_density() {
    let tables = coated_tables();
    let all = with_density(&tables);
    let threshold = 1.0 - (1.0f64 - 1e-3).powf(1.0 / (all.len() * COSINES.len()) as f64);
    let mut failures = Vec::new();
    for (i, (name, bsdf)) in all.iter().enumerate() {
        for (j, cos) in COSINES.into_iter().enumerate() {
            let p = p_value(bsdf, direction(cos, 0.7), (i * 100 + j) as u64);
            if p < threshold {
                failures.push(format!("{name} cos {cos}: p = {p:e}"));
            }
        }
    }
    assert!(failures.is_empty(), "{failures:#?}");
}

/// A test that cannot fail is none: a density wrong by 3 % over half the hemisphere is noticed.
#[test]
fn a_tilted_density_is_noticed() {
    let bsdf = Bsdf::Diffuse(Diffuse::new(Rgb::ONE));
    let mut counts = [0f64; 2];
    let mut rng = Rng(9);
    for _ in 0..DRAWS {
        let s = bsdf.sample(Vec3::Z, rng.f32(), rng.vec2()).expect("white reflects");
        counts[usize::from(s.wi.x > 0.0)] += 1.0;
    }
    let chi2 =
        |expected: [f64; 2]| (0..2).map(|i| (counts[i] - expected[i]).powi(2) / expected[i]).sum::<f64>();
    let half = DRAWS as f64 * 0.5;
    assert!(chi_squared_tail(chi2([half, half]), 1.0) > 1e-3);
    assert!(chi_squared_tail(chi2([half * 0.97, half * 1.03]), 1.0) < 1e-6);
}

/// ∫ G1(o)·(o·m)₊·D(m)/zo dm = 1: every ray meets exactly one visible facet.
#[test]
fn visible_normals_integrate_to_one() {
    for alpha in ALPHAS {
        let ggx = Ggx::new(alpha.0, alpha.1);
        for cos in [1.0, 0.7, 0.3, 0.04] {
            let wo = direction(cos, 0.7);
            // tanθm = α·tanψ spreads the lobe evenly and leaves no singularity at the horizon.
            let a = f64::from(alpha.0.max(alpha.1));
            let density = |x: f64, phi: f64| {
                let (s, c) = (x * FRAC_PI_2).sin_cos();
                let tan = a * s / c;
                let cos = (1.0 + tan * tan).powf(-0.5);
                let m = direction(cos as f32, phi as f32);
                // −d(cosθ)/dx of the substitution.
                let jacobian = cos.powi(3) * tan * a / (c * c) * FRAC_PI_2;
                f64::from(ggx.g1(wo) * wo.dot(m).max(0.0) * ggx.d(m) / wo.z) * jacobian
            };
            let mut sum = 0.0;
            for i in 0..8 {
                let (lo, hi) = (f64::from(i) / 8.0, (f64::from(i) + 1.0) / 8.0);
                sum +=
                    integral(&density, [lo, 0.0], [hi, PI], 7) + integral(&density, [lo, PI], [hi, TAU], 7);
            }
            // f32 directions limit the narrow lobes; measured 3e-4 at α = 0.02.
            assert!((sum - 1.0).abs() < 1e-3, "{alpha:?} cos {cos}: {sum}");
        }
    }
}
