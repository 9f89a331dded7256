//! Renders of one setting under different seeds, and what they say of its error: what is noise, what is bias, and how
//! sure that is (Celarek et al. 2019: many short renders in place of a long one).
//!
//! The pixels of largest error are left out of an error, a share of them as `weir diff` has it: of few samples a few
//! pixels would rule every mean.
//!
//! Invariant: a bias is estimated without one, so that it may come out below zero by chance.

use crate::film::Image;
use crate::study::diff::{REL_MSE_EPSILON, TRIMMED_SHARE};

/// Pixels across and down of a block whose mean counts as one value, for the spread of a bias.
const BLOCK: u32 = 8;

/// Blocks whose spread means something.
const FEWEST_BLOCKS: usize = 16;

/// A value for each channel.
type Rgb = [f64; 3];

/// Sums over renders, pixel by pixel (Welford 1962).
#[derive(Clone)]
pub(super) struct Sums {
    pub(super) width: u32,
    count: f64,
    mean: Vec<Rgb>,
    squares: Vec<Rgb>,
}

/// What errors are held against.
pub(super) struct Truth {
    mean: Vec<Rgb>,
    /// Variance of the mean.
    variance: Vec<Rgb>,
    /// relMSE of the mean itself.
    pub(super) relmse: f64,
}

/// The square of a bias, as relMSE, and the standard deviation of this estimate.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Bias {
    pub(super) square: f64,
    pub(super) deviation: f64,
}

/// What is left out of `pixels` for each render.
fn trimmed(pixels: usize) -> usize {
    (pixels as f64 * TRIMMED_SHARE) as usize
}

/// Mean of `errors` without the `out` largest, over the number of all that are left.
fn mean_without(errors: &mut [f64], out: usize) -> f64 {
    let kept = errors.len().saturating_sub(out);
    if kept == 0 {
        return 0.0;
    }
    if kept < errors.len() {
        errors.select_nth_unstable_by(kept, f64::total_cmp);
    }
    errors[..kept].iter().sum::<f64>() / kept as f64
}

fn weight(reference: f64) -> f64 {
    1.0 / (3.0 * (reference * reference + REL_MSE_EPSILON))
}

impl Sums {
    pub(super) fn new(width: u32, height: u32) -> Self {
        let zero = || vec![[0.0; 3]; width as usize * height as usize];
        Self { width, count: 0.0, mean: zero(), squares: zero() }
    }

    pub(super) fn add(&mut self, image: &Image) {
        self.count += 1.0;
        let columns = self.mean.iter_mut().zip(&mut self.squares).zip(&image.pixels);
        for ((mean, squares), pixel) in columns {
            for c in 0..3 {
                // A pixel that is no number is one that was lost; black is what stands there.
                let value = if pixel[c].is_finite() { f64::from(pixel[c]) } else { 0.0 };
                let before = value - mean[c];
                mean[c] += before / self.count;
                squares[c] += before * (value - mean[c]);
            }
        }
    }

    /// Variance of one render, in channel `c` of pixel `i`; 0 of a single one.
    fn variance(&self, i: usize, c: usize) -> f64 {
        if self.count > 1.0 { self.squares[i][c] / (self.count - 1.0) } else { 0.0 }
    }

    /// Their mean, as what others are held against.
    pub(super) fn into_truth(self) -> Truth {
        let variance: Vec<Rgb> =
            (0..self.mean.len()).map(|i| [0, 1, 2].map(|c| self.variance(i, c) / self.count)).collect();
        let all = self.mean.iter().zip(&variance);
        let mut errors: Vec<f64> = all.map(|(m, v)| (0..3).map(|c| weight(m[c]) * v[c]).sum()).collect();
        let out = trimmed(errors.len());
        let relmse = mean_without(&mut errors, out);
        Truth { mean: self.mean, variance, relmse }
    }

    /// Their bias against `truth`.
    pub(super) fn bias(&self, truth: &Truth) -> Bias {
        let height = self.mean.len() as u32 / self.width.max(1);
        let (across, down) = (self.width.div_ceil(BLOCK), height.div_ceil(BLOCK));
        let mut blocks = vec![(0.0, 0.0); (across * down) as usize];
        for (i, (mean, right)) in self.mean.iter().zip(&truth.mean).enumerate() {
            // Of all pixels: what is off in one render alone cancels here, and to leave out what varies most would leave
            // more of the square than of the variance.
            let of = |c: usize| {
                let chance = self.variance(i, c) / self.count + truth.variance[i][c];
                weight(right[c]) * ((mean[c] - right[c]).powi(2) - chance)
            };
            let (x, y) = (i as u32 % self.width, i as u32 / self.width);
            let block = &mut blocks[(y / BLOCK * across + x / BLOCK) as usize];
            *block = (block.0 + of(0) + of(1) + of(2), block.1 + 1.0);
        }
        let kept = self.mean.len();
        // Blocks of a few pixels tell no spread.
        if blocks.len() < FEWEST_BLOCKS {
            let square = blocks.iter().map(|b| b.0).sum::<f64>() / kept.max(1) as f64;
            return Bias { square, deviation: square.abs() };
        }
        let square = blocks.iter().map(|b| b.0).sum::<f64>() / kept.max(1) as f64;
        // Of a ratio of sums over blocks, which have not equally many pixels.
        let spread: f64 = blocks.iter().map(|b| (b.0 - square * b.1).powi(2)).sum();
        Bias { square, deviation: spread.sqrt() / kept.max(1) as f64 }
    }
}

impl Truth {
    /// An image whose own error is not known.
    pub(super) fn given(image: &Image) -> Self {
        let mean: Vec<Rgb> = image.pixels.iter().map(|p| p.map(f64::from)).collect();
        Self { variance: vec![[0.0; 3]; mean.len()], mean, relmse: 0.0 }
    }

    /// relMSE of `image`, less what the noise of this adds.
    pub(super) fn relmse_of(&self, image: &Image) -> f64 {
        let error = |(pixel, right): (&[f32; 3], &Rgb)| -> f64 {
            let off = |c: usize| {
                let value = if pixel[c].is_finite() { f64::from(pixel[c]) } else { 0.0 };
                weight(right[c]) * (value - right[c]).powi(2)
            };
            off(0) + off(1) + off(2)
        };
        let mut errors: Vec<f64> = image.pixels.iter().zip(&self.mean).map(error).collect();
        let out = trimmed(errors.len());
        mean_without(&mut errors, out) - self.relmse
    }

    /// As an image, of the width of `like`.
    pub(super) fn image(&self, like: &Image) -> Image {
        Image { pixels: self.mean.iter().map(|p| p.map(|c| c as f32)).collect(), ..like.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Uniform in [0, 1), from a counter.
    fn uniform(i: u64) -> f64 {
        let mut x = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ x >> 31) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// An image of `value(x)` and uniform noise of standard deviation `noise` around it.
    fn image(seed: u64, value: impl Fn(u32) -> f64, noise: f64) -> Image {
        let mut image = Image::new(96, 64);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [0, 1, 2].map(|c| {
                let u = uniform(seed << 32 | (i as u64 * 3 + c));
                (value(i as u32 % 96) + noise * (u - 0.5) * 12f64.sqrt()) as f32
            });
        }
        image
    }

    fn sums(seeds: std::ops::Range<u64>, value: impl Fn(u32) -> f64 + Copy, noise: f64) -> Sums {
        let mut sums = Sums::new(96, 64);
        seeds.for_each(|seed| sums.add(&image(seed, value, noise)));
        sums
    }

    #[test]
    fn noise_and_bias_are_told_apart() {
        let right = |x: u32| 0.5 + f64::from(x) / 96.0;
        let truth = sums(0..8, right, 0.05).into_truth();
        // relMSE of a deviation d at value v, over the values of a row.
        let of = |d: f64| (0..96).map(|x| d * d / (right(x).powi(2) + REL_MSE_EPSILON)).sum::<f64>() / 96.0;
        // 18432 values of uniform noise: the variance is known to 0.7 % at one standard deviation, and these are four.
        let close =
            |a: f64, b: f64, what: &str| assert!((a / b - 1.0).abs() < 0.03, "{what}: {a} is not {b}");
        close(truth.relmse, of(0.05) / 8.0, "the reference's own");
        for (bias, noise, renders) in [(0.0, 0.2, 4), (0.1, 0.2, 4), (0.3, 0.05, 2)] {
            let sums = sums(100..100 + renders, |x| right(x) + bias, noise);
            let found = sums.bias(&truth);
            // Four standard deviations: false alarms 6e-5 for each of the three.
            let off = (found.square - of(bias)).abs();
            assert!(off < 4.0 * found.deviation, "{found:?}, {}", of(bias));
            assert!(found.deviation < 0.1 * of(noise.max(bias)), "{found:?}");
            let one = truth.relmse_of(&image(7, |x| right(x) + bias, noise));
            assert!((one / (of(noise) + of(bias)) - 1.0).abs() < 0.08, "{one}");
        }
    }

    #[test]
    fn a_few_pixels_do_not_rule() {
        let truth = sums(0..8, |_| 1.0, 0.05).into_truth();
        let clean = truth.relmse_of(&image(9, |_| 1.0, 0.1));
        let mut lit = image(9, |_| 1.0, 0.1);
        // As many as are left out: 6 of 6144.
        for i in 0..6 {
            lit.pixels[i * 1000] = [1e6, 1e6, f32::NAN];
        }
        assert!((truth.relmse_of(&lit) / clean - 1.0).abs() < 0.02);
        let mut sums = sums(100..103, |_| 1.0, 0.1);
        sums.add(&lit);
        let bias = sums.bias(&truth);
        assert!(bias.square.abs() < 4.0 * bias.deviation, "what one render has is no bias: {bias:?}");
    }

    #[test]
    fn a_bias_in_a_corner_is_found_and_its_spread_is_larger() {
        let truth = Truth::given(&image(0, |_| 1.0, 0.0));
        let everywhere = sums(0..4, |_| 1.1, 0.01).bias(&truth);
        let corner = sums(0..4, |x| if x < 8 { 1.346 } else { 1.0 }, 0.01).bias(&truth);
        assert!((everywhere.square / corner.square - 1.0).abs() < 0.03, "{everywhere:?} {corner:?}");
        assert!(corner.deviation > 10.0 * everywhere.deviation, "{everywhere:?} {corner:?}");
    }
}
