//! Filters beyond the image's edges and with footprints beyond all measure: known answers, and the
//! integrals of `integrals` where edges clamp or end in black.

use super::integrals::{Draw, SIDE, ellipse_mean, numbered, sampler, white};
use super::tests::Image;
use super::*;
use crate::math::Vec3;
use crate::texture::texels::GreyFloat;

const WRAPS: [Wrap; 2] = [Wrap::Clamp, Wrap::Black];

#[test]
fn off_the_image_is_its_edge_or_black() {
    // The right half white: so is the right half of every level but the last.
    let image = Image::<GreyFloat>::new((SIDE, SIDE), |x, _| f32::from(x >= SIDE / 2), |c| c.x);
    let mut draw = Draw(21);
    let odd = [f32::INFINITY, 1e30, 1e9, 3e7, 65.0];
    for case in 0..4000u32 {
        let turn = Vec2::from_angle(draw.next() as f32 * 7.0);
        // From 0.1 to 15 texels; no ellipse longer than half of the image.
        let short = 0.0016 * 150f32.powf(draw.next() as f32);
        let long = (short * 32f32.powf(draw.next() as f32)).min(0.5);
        let random = random_bits(case, Vec3::ZERO, 0);
        let f = Footprint { duv_dx: turn * long, duv_dy: turn.perp() * short, random };
        let off = odd.get(case as usize % 8).copied().unwrap_or(1.0 + 2.0 * draw.next() as f32);
        let v = draw.next() as f32 * 6.0 - 3.0;
        for (u, edge) in [(1.0 + off, 1.0), (-off, 0.0)] {
            for filter in FILTERS {
                // Point and bilinear go by twice the larger extent, so that they reach the last level.
                let f = if matches!(filter, TextureFilter::Ewa | TextureFilter::Stochastic) {
                    f
                } else {
                    Footprint { duv_dx: f.duv_dx * 0.4, ..f }
                };
                let get =
                    |uv, wrap| lookup(&mut image.source(), uv, f, Sampler { wrap, ..sampler(filter) }).x;
                let got = get(Vec2::new(u, v), Wrap::Clamp);
                assert!((got - edge).abs() < 1e-6, "{filter:?} {u} {v} {f:?}: {got}");
                assert_eq!(get(Vec2::new(u, v), Wrap::Black), 0.0, "{filter:?} {u} {v} {f:?}");
                assert_eq!(get(Vec2::new(v, u), Wrap::Black), 0.0, "{filter:?} {v} {u} {f:?}");
                for wrap in WRAPS {
                    assert!(get(Vec2::new(f32::NAN, u), wrap).is_finite());
                }
            }
        }
    }
}

/// A place on the image or off it, and half-axes that may reach it from there: the shorter 0.3 to
/// 18 texels, levels down to 2 × 2.
fn case(draw: &mut Draw) -> [Vec2; 3] {
    let turn = Vec2::from_angle((draw.next() * std::f64::consts::TAU) as f32);
    let short = 0.3 * 60f64.powf(draw.next()) / f64::from(SIDE);
    let long = short * 31.9f64.powf(draw.next());
    let (long, short) = (turn * long as f32, turn.perp() * short as f32);
    let reach = (long * long + short * short).powf(0.5);
    let mut uv = draw.uv() * (1.0 + 2.4 * reach) - 1.2 * reach;
    if draw.next() < 0.1 {
        uv.y *= 1e9;
    }
    [uv, long, short]
}

#[test]
fn ewa_is_near_its_integral_over_edges() {
    let image = white(14);
    let mut draw = Draw(12);
    for wrap in WRAPS {
        let (n, mut square, mut worst) = (1000, 0.0, 0.0f64);
        for _ in 0..n {
            let [uv, long, short] = case(&mut draw);
            let f = Footprint { duv_dx: long, duv_dy: short, random: 0 };
            let got = lookup(&mut image.source(), uv, f, Sampler { wrap, ..sampler(TextureFilter::Ewa) }).x;
            let error = f64::from(got) - ellipse_mean(&image, wrap, uv, long, short);
            square += error * error / f64::from(n);
            worst = worst.max(error.abs());
        }
        println!("EWA over edges, {wrap:?}: rms {:.4}, worst {worst:.4}", square.sqrt());
        assert!(square.sqrt() < 0.02 && worst < 0.1, "{wrap:?}: rms {}, worst {worst}", square.sqrt());
    }
}

#[test]
fn the_stochastic_filter_is_its_integral_over_edges() {
    let image = white(15);
    let mut draw = Draw(13);
    let n = 10_000u32;
    for (index, wrap) in (0..200).flat_map(|i| WRAPS.map(|wrap| (i, wrap))) {
        let [uv, long, short] = case(&mut draw);
        let want = ellipse_mean(&image, wrap, uv, long, short);
        let mut mean = 0.0;
        for key in 0..n {
            let random = random_bits(key, Vec3::new(uv.x, 0.5, uv.y), index);
            let f = Footprint { duv_dx: long, duv_dy: short, random };
            let s = Sampler { wrap, ..sampler(TextureFilter::Stochastic) };
            mean += f64::from(lookup(&mut image.source(), uv, f, s).x) / f64::from(n);
        }
        // Bernstein's inequality for numbers in 0..1, whose variance is at most want (1 − want):
        // 2 exp(−18) a case, 1.2e-5 for all 400. Quadrature, where an edge cuts the ellipse: 1e-3.
        let (l, n) = (18.0, f64::from(n));
        let bound = (l / 3.0 + (l * l / 9.0 + 2.0 * l * n * want * (1.0 - want)).sqrt()) / n + 1e-3;
        assert!((mean - want).abs() < bound, "{wrap:?} {uv} {long} {short}: {mean}, integral {want}");
    }
}

#[test]
fn footprints_beyond_all_measure_are_the_coarsest_level() {
    let image = numbered();
    let big = [f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1e30, -2e19];
    let all = [0.0, 1e-30, -1e-4, 0.3, 7.0, 1e18].into_iter().chain(big);
    let rest: Vec<_> = all.clone().flat_map(|a| all.clone().map(move |b| Vec2::new(a, b))).collect();
    for (a, &b) in big.into_iter().flat_map(|a| rest.iter().map(move |b| (a, b))) {
        for along in [Vec2::new(a, 0.0), Vec2::new(0.3, a), Vec2::new(a, -a)] {
            for [duv_dx, duv_dy] in [[along, b], [b, along]] {
                for filter in FILTERS {
                    let f = Footprint { duv_dx, duv_dy, random: random_bits(3, b.extend(a), 1) };
                    let got = lookup(&mut image.source(), Vec2::new(0.3, 0.8), f, sampler(filter)).x;
                    assert_eq!(got, 9.0, "{filter:?} {f:?}");
                }
            }
        }
    }
}
