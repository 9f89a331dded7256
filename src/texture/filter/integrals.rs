//! Each filter against the area integral that it stands for, in f64 and by brute force.

use super::tests::{Image, noise};
use super::*;
use crate::math::Vec3;
use crate::texture::texels::GreyFloat;

pub(super) const SIDE: u32 = 64;

/// White noise in 0..1, with the levels that filters see.
pub(super) fn white(seed: u32) -> Image<GreyFloat> {
    let bytes = noise((SIDE * SIDE) as usize, seed);
    Image::new((SIDE, SIDE), |x, y| f32::from(bytes[(y * SIDE + x) as usize]) / 255.0, |c| c.x)
}

/// Numbers in 0..1, one after the other.
pub(super) struct Draw(pub(super) u64);

impl Draw {
    pub(super) fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }

    pub(super) fn uv(&mut self) -> Vec2 {
        Vec2::new(self.next() as f32, self.next() as f32)
    }
}

/// A texel of a level that repeats, ends in its edge or ends in black.
fn texel(image: &Image<GreyFloat>, wrap: Wrap, level: usize, x: i64, y: i64) -> f64 {
    let side = i64::from(SIDE >> level);
    let inside = match wrap {
        Wrap::Black if x != x.clamp(0, side - 1) || y != y.clamp(0, side - 1) => return 0.0,
        Wrap::Repeat => [x, y].map(|x| x.rem_euclid(side) as u32),
        _ => [x, y].map(|x| x.clamp(0, side - 1) as u32),
    };
    f64::from(image.source().texel(level, inside[0], inside[1]).x)
}

/// The mean of a level over a square of texel size about `uv`, its texels uniform squares.
fn box_mean(image: &Image<GreyFloat>, wrap: Wrap, level: usize, uv: [f64; 2]) -> f64 {
    let side = f64::from(SIDE >> level);
    let (x, y) = (uv[0] * side, (1.0 - uv[1]) * side);
    let overlap = |a: f64, i: i64| ((a + 0.5).min(i as f64 + 1.0) - (a - 0.5).max(i as f64)).max(0.0);
    let mut sum = 0.0;
    for j in y.floor() as i64 - 2..y.floor() as i64 + 3 {
        for i in x.floor() as i64 - 2..x.floor() as i64 + 3 {
            sum += overlap(x, i) * overlap(y, j) * texel(image, wrap, level, i, j);
        }
    }
    sum
}

/// The mean of the bilinear interpolant over the ellipse with half-axes `a`, `b` in uv, weighted by
/// exp(−2r²) − exp(−2): rings of equal weight, evenly turned.
fn gaussian_mean(
    image: &Image<GreyFloat>,
    wrap: Wrap,
    level: usize,
    uv: [f64; 2],
    [a, b]: [[f64; 2]; 2],
) -> f64 {
    const RINGS: u32 = 64;
    const TURNS: u32 = 96;
    let e2 = (-2f64).exp();
    let within = |q: f64| ((1.0 - (-2.0 * q).exp()) / 2.0 - e2 * q) / ((1.0 - e2) / 2.0 - e2);
    let mut sum = 0.0;
    for ring in 0..RINGS {
        let u = (f64::from(ring) + 0.5) / f64::from(RINGS);
        let (mut lo, mut hi) = (0.0, 1.0);
        for _ in 0..50 {
            let mid = 0.5 * (lo + hi);
            if within(mid) < u { lo = mid } else { hi = mid }
        }
        for turn in 0..TURNS {
            // Each ring turned a little against the last, so that no direction is preferred.
            let phi = (f64::from(turn) + f64::from(ring) * 0.618) / f64::from(TURNS) * std::f64::consts::TAU;
            let (c, s) = (phi.cos() * lo.sqrt(), phi.sin() * lo.sqrt());
            sum += box_mean(image, wrap, level, [uv[0] + a[0] * c + b[0] * s, uv[1] + a[1] * c + b[1] * s]);
        }
    }
    sum / f64::from(RINGS * TURNS)
}

/// What EWA and the stochastic filter approximate and estimate.
pub(super) fn ellipse_mean(image: &Image<GreyFloat>, wrap: Wrap, uv: Vec2, long: Vec2, short: Vec2) -> f64 {
    let [uv, long, short] = [uv, long, short].map(wide);
    let level = (short[0].hypot(short[1]) * f64::from(SIDE)).log2().max(0.0);
    let i = level.floor() as usize;
    let [fine, coarse] = [i, i + 1].map(|i| gaussian_mean(image, wrap, i, uv, [long, short]));
    fine + (coarse - fine) * (level - i as f64)
}

fn wide(v: Vec2) -> [f64; 2] {
    [v.x.into(), v.y.into()]
}

pub(super) fn sampler(filter: TextureFilter) -> Sampler {
    Sampler { filter, wrap: Wrap::Repeat, channels: Channels::Rgb }
}

#[test]
fn point_bilinear_and_trilinear_are_their_integrals() {
    let image = white(3);
    let mut draw = Draw(1);
    for case in 0..30_000 {
        let wrap = [Wrap::Repeat, Wrap::Clamp, Wrap::Black][case % 3];
        let mut uv = draw.uv() * 4.0 - 2.0;
        if wrap != Wrap::Repeat && case % 8 == 0 {
            uv.x *= 1e9;
        }
        let width = 2f64.powf(draw.next() * 5.5 - 7.0) as f32;
        let footprint =
            Footprint { duv_dx: Vec2::new(width, 0.0), duv_dy: Vec2::new(0.0, -0.5 * width), random: 0 };
        let level = (2.0 * f64::from(width) * f64::from(SIDE)).log2().max(0.0);
        let i = level.floor() as usize;
        let get = |filter| {
            let sampler = Sampler { wrap, ..sampler(filter) };
            f64::from(lookup(&mut image.source(), uv, footprint, sampler).x)
        };
        let (fine, coarse) = (box_mean(&image, wrap, i, wide(uv)), box_mean(&image, wrap, i + 1, wide(uv)));
        // Only rounding of uv (2 · 64 texels · 2⁻²⁴, slopes up to 1 in each direction) and of the level.
        let tolerance = 3e-5;
        assert!((get(TextureFilter::Bilinear) - fine).abs() < tolerance, "{uv} {width}");
        let blend = if i > 0 { fine + (coarse - fine) * (level - i as f64) } else { fine };
        assert!((get(TextureFilter::Trilinear) - blend).abs() < tolerance, "{uv} {width}");
        let side = f64::from(SIDE >> i);
        let (x, y) = (wide(uv)[0] * side, (1.0 - wide(uv)[1]) * side);
        // Not within rounding of an edge between texels.
        if (x - x.round()).abs() > 1e-4 && (y - y.round()).abs() > 1e-4 {
            let nearest = texel(&image, wrap, i, x.floor() as i64, y.floor() as i64);
            assert_eq!(get(TextureFilter::Point), nearest, "{uv} {width}");
        }
    }
}

/// Half-axes for a test: the shorter 0.3 to 6 texels, the ratio 1 to 32.
fn axes(draw: &mut Draw) -> (Vec2, Vec2) {
    let turn = Vec2::from_angle((draw.next() * std::f64::consts::TAU) as f32);
    let short = 0.3 * 20f64.powf(draw.next()) / f64::from(SIDE);
    let long = short * 31.9f64.powf(draw.next());
    (turn * long as f32, turn.perp() * short as f32)
}

#[test]
fn ewa_is_near_the_integral_over_its_ellipse() {
    let image = white(4);
    let mut draw = Draw(2);
    let (n, mut square, mut worst) = (1500, 0.0, 0.0f64);
    for _ in 0..n {
        let (uv, (long, short)) = (draw.uv(), axes(&mut draw));
        let footprint = Footprint { duv_dx: long, duv_dy: short, random: 0 };
        let got = f64::from(lookup(&mut image.source(), uv, footprint, sampler(TextureFilter::Ewa)).x);
        let error = got - ellipse_mean(&image, Wrap::Repeat, uv, long, short);
        square += error * error / f64::from(n);
        worst = worst.max(error.abs());
    }
    println!("EWA against its integral on white noise: rms {:.4}, worst {worst:.4}", square.sqrt());
    assert!(square.sqrt() < 0.02 && worst < 0.1, "rms {}, worst {worst}", square.sqrt());
}

#[test]
fn the_stochastic_filter_is_the_integral_in_the_mean() {
    let image = white(5);
    let mut draw = Draw(3);
    let (cases, n) = (200, 20_000u32);
    let mut sum_z2 = 0.0;
    for case in 0..cases {
        let (uv, (long, short)) = (draw.uv() * 8.0 - 4.0, axes(&mut draw));
        let want = ellipse_mean(&image, Wrap::Repeat, uv, long, short);
        let (mut mean, mut square) = (0.0, 0.0);
        for key in 0..n {
            let random = random_bits(key, Vec3::new(uv.x, 0.5, uv.y), case);
            let footprint = Footprint { duv_dx: long, duv_dy: short, random };
            let v = lookup(&mut image.source(), uv, footprint, sampler(TextureFilter::Stochastic)).x;
            mean += f64::from(v) / f64::from(n);
            square += f64::from(v) * f64::from(v) / f64::from(n);
        }
        let z = (mean - want) / ((square - mean * mean) / f64::from(n)).sqrt();
        // |z| ≥ 4.7 happens once in 380,000 times, so with 200 cases the false alarm is 5e-4.
        assert!(z.abs() < 4.7, "case {case}: mean {mean}, integral {want}, z {z}");
        sum_z2 += z * z;
    }
    // χ² with 200 degrees of freedom exceeds 272 once in 2000 times.
    assert!(sum_z2 < 272.0, "sum of z² over {cases} cases: {sum_z2}");
}

/// Levels that each have one value, their number.
pub(super) fn numbered() -> Image<GreyFloat> {
    Image::by_level((512, 512), |level| level as f32)
}

fn turned(short: f32, ratio: f32, angle: f32, random: u64) -> Footprint {
    let turn = Vec2::from_angle(angle);
    Footprint { duv_dx: turn * (short * ratio / 512.0), duv_dy: turn.perp() * (short / 512.0), random }
}

#[test]
fn a_fixed_shorter_axis_is_one_colour_at_any_ratio_and_angle() {
    let image = numbered();
    let mut draw = Draw(4);
    for short in [0.3f32, 1.0, 1.3, 2.0, 3.7, 6.0] {
        let want = short.log2().max(0.0);
        for ratio in 1..=32u8 {
            for step in 0..90u8 {
                let angle = f32::from(step) * (std::f32::consts::PI / 90.0);
                let f = turned(short, ratio.into(), angle, 0);
                let got = lookup(&mut image.source(), draw.uv(), f, sampler(TextureFilter::Ewa)).x;
                // Rounding of lengths and weights, in units of a whole level.
                assert!((got - want).abs() < 1e-5, "{short} {ratio} {angle}: {got}, not {want}");
            }
        }
        // Beyond the bound the ellipse is widened, as documented.
        let f = turned(short, 64.0, 0.4, 0);
        let got = lookup(&mut image.source(), draw.uv(), f, sampler(TextureFilter::Ewa)).x;
        assert!((got - (2.0 * short).log2().max(0.0)).abs() < 1e-5);
    }
}

#[test]
fn the_stochastic_filter_chooses_between_the_same_two_levels() {
    let image = numbered();
    let mut draw = Draw(5);
    for short in [0.3f32, 1.3, 3.7, 6.0] {
        let want = f64::from(short.log2().max(0.0));
        let (mut n, mut sum) = (0u32, 0.0);
        for ratio in 1..=32u8 {
            for step in 0..90u8 {
                let angle = f32::from(step) * (std::f32::consts::PI / 90.0);
                let f = turned(short, ratio.into(), angle, random_bits(n, Vec3::ZERO, 0));
                let s = sampler(TextureFilter::Stochastic);
                let got = f64::from(lookup(&mut image.source(), draw.uv(), f, s).x);
                assert!(got == want.floor() || got == want.floor() + 1.0, "{short}: {got}");
                sum += got;
                n += 1;
            }
        }
        let t = want - want.floor();
        // Binomial: five standard deviations, 6e-7 a case.
        let error = (sum / f64::from(n) - want).abs();
        assert!(error <= 5.0 * (t * (1.0 - t) / f64::from(n)).sqrt(), "{short}: {error}");
    }
}

#[test]
fn means_are_kept() {
    let image = white(6);
    let mean = texel(&image, Wrap::Repeat, 6, 0, 0);
    for filter in FILTERS {
        let (n, mut sum) = (SIDE * 4, 0.0);
        for y in 0..n {
            for x in 0..n {
                let uv = (Vec2::new(x as f32, y as f32) + 0.5) / n as f32;
                let random = random_bits(x + y * n, Vec3::ZERO, 0);
                let f = Footprint { duv_dx: Vec2::new(0.03, 0.01), duv_dy: Vec2::new(-0.01, 0.04), random };
                sum += f64::from(lookup(&mut image.source(), uv, f, sampler(filter)).x);
            }
        }
        let error = (sum / f64::from(n * n) - mean).abs();
        // Evenly spaced places take every texel equally often; but the weights of the average are
        // made to sum to one at each place, which shifts it a little (measured: 4e-6), and drawn
        // texels of standard deviation 0.15 have five of 0.003.
        let tolerance = match filter {
            TextureFilter::Stochastic => 3e-3,
            TextureFilter::Ewa => 1e-4,
            _ => 1e-5,
        };
        assert!(error < tolerance, "{filter:?}: {error}");
    }
}

/// Counts what is read.
struct Counting<S>(S, usize);

impl<S: TexelSource> TexelSource for Counting<S> {
    fn levels(&self) -> usize {
        self.0.levels()
    }

    fn size(&self, level: usize) -> (u32, u32) {
        self.0.size(level)
    }

    fn texel(&mut self, level: usize, x: u32, y: u32) -> Vec4 {
        self.1 += 1;
        self.0.texel(level, x, y)
    }

    fn quad(&mut self, level: usize, x: [u32; 2], y: [u32; 2]) -> [Vec4; 4] {
        self.1 += 4;
        self.0.quad(level, x, y)
    }
}

#[test]
fn no_footprint_reads_more_than_its_filter_may() {
    let image = Image::<GreyFloat>::by_level((1024, 300), |level| level as f32);
    let odd = [0.0, f32::NAN, f32::INFINITY, -1e30, 1e-40, 1e-20, 1e-4, 0.003, 0.02, 0.3, 7.0, 1e6, f32::MAX];
    let mut most = [0; FILTERS.len()];
    for (&a, &b) in odd.iter().flat_map(|a| odd.iter().map(move |b| (a, b))) {
        for (&c, &d) in odd.iter().flat_map(|c| odd.iter().map(move |d| (c, d))) {
            let f = Footprint { duv_dx: Vec2::new(a, b), duv_dy: Vec2::new(c, -d), random: 9 };
            for (filter, most) in FILTERS.into_iter().zip(&mut most) {
                for uv in [Vec2::new(0.3, 0.7), Vec2::new(b, a)] {
                    let mut s = Counting(image.source(), 0);
                    let v = lookup(&mut s, uv, f, sampler(filter));
                    assert!(v.x.is_finite(), "{filter:?} {f:?} {uv}");
                    *most = s.1.max(*most);
                }
            }
        }
    }
    for turn in 0..360u16 {
        for ratio in [1.0, 2.0, 8.0, 31.9, 33.0, 1000.0] {
            for short in [0.1, 1.0, 1.9999, 3.9999] {
                let f = turned(short, ratio, f32::from(turn), 1);
                let mut s = Counting(image.source(), 0);
                lookup(&mut s, Vec2::new(0.2, 0.9), f, sampler(TextureFilter::Ewa));
                most[3] = most[3].max(s.1);
            }
        }
    }
    println!("most texels a lookup: {FILTERS:?} {most:?}");
    assert!(most[0] == 1 && most[1] == 4 && most[2] == 8 && most[4] <= 4, "{most:?}");
    assert!((300..1000).contains(&most[3]), "{most:?}");
}
