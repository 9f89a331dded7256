//! How far one image is from another: means, relative error, perceived difference, and whether two
//! noisy renders agree. `b` is the reference throughout. A pixel that is infinite or not a number
//! in either image is counted and left out of means and errors; it never counts as agreement.
//! Never reads files and never prints.

use crate::color::luminance;
use crate::color::srgb::linear_to_byte;
use crate::error::{Error, Result};
use crate::film::Image;
pub use crate::film::REL_MSE_EPSILON;
use crate::math::Vec3;
use serde::Serialize;

/// Share of the pixels, largest errors first, that the trimmed relMSE leaves out.
pub const TRIMMED_SHARE: f64 = 0.001;
/// More pixels than this, and FLIP is left out: its library counts bytes in 32 bits.
const MAX_FLIP_PIXELS: u64 = 1 << 28;

/// The rule by which two renders agree (scenes' `references/README.md`).
const BLOCK: usize = 16;
const CLIP: f64 = 50.0;
const MEAN_TOLERANCE: f64 = 0.02;
const BLOCK_SHARE: f64 = 0.95;

/// A value a channel, and of the luminance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PerChannel {
    /// Red.
    pub r: f64,
    /// Green.
    pub g: f64,
    /// Blue.
    pub b: f64,
    /// 0.2126 R + 0.7152 G + 0.0722 B.
    pub luminance: f64,
}

/// What [`diff`] finds; also the JSON of `weir diff --json`. A value that is infinite or undefined
/// becomes `null` there.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diff {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Every float is the same, bit for bit.
    pub identical: bool,
    /// Means of the first image.
    pub mean_a: PerChannel,
    /// Means of the reference.
    pub mean_b: PerChannel,
    /// `mean_a` over `mean_b`; 1 where both are zero.
    pub mean_ratio: PerChannel,
    /// Mean over pixels of the mean over channels of (a−b)²/(b²+ε).
    pub relmse: f64,
    /// The same without the pixels of largest error.
    pub relmse_trimmed: f64,
    /// How many pixels `relmse_trimmed` leaves out.
    pub trimmed_pixels: u64,
    /// [`REL_MSE_EPSILON`].
    pub relmse_epsilon: f64,
    /// Perceived difference; `None` for an image too large for the library.
    pub flip: Option<Flip>,
    /// Pixels that are infinite or not a number in the first image.
    pub non_finite_a: u64,
    /// The same in the reference.
    pub non_finite_b: u64,
    /// Whether two noisy renders are of one picture.
    pub agreement: Agreement,
}

/// LDR-FLIP (Andersson et al. 2020) of both images clipped to [0, 1] and encoded as 8-bit sRGB.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Flip {
    /// Mean of the error map, 0 to 1.
    pub mean: f64,
    /// Viewing condition.
    pub pixels_per_degree: f64,
}

/// Whether two noisy renders are of one picture: the ratio of the mean luminances, clipped at 50,
/// is within 2 %, and 95 % of the 16×16 blocks agree. A block agrees when its mean differs by at most
/// 5 % of the reference, plus three standard errors of the difference in that block, plus 0.002.
/// Pixels beyond the last whole block count in the ratio only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Agreement {
    /// Both conditions hold.
    pub agree: bool,
    /// Ratio of the mean clipped luminances.
    pub luminance_ratio: f64,
    /// Blocks in all. An image smaller than a block is one block.
    pub blocks: u64,
    /// Blocks that agree.
    pub agreeing: u64,
    /// `agreeing` over `blocks`.
    pub share: f64,
}

/// Compares `a` with the reference `b`.
///
/// # Errors
/// [`Error::Usage`] when the sizes differ.
pub fn diff(a: &Image, b: &Image) -> Result<Diff> {
    if (a.width, a.height) != (b.width, b.height) {
        return Err(Error::Usage(format!(
            "cannot compare an image of {}×{} with one of {}×{}; both must have one size",
            a.width, a.height, b.width, b.height
        )));
    }
    let finite = |p: &[f32; 3]| p.iter().all(|c| c.is_finite());
    let pairs = || a.pixels.iter().zip(&b.pixels).filter(move |(a, b)| finite(a) && finite(b));
    let mut errors: Vec<f64> = pairs().map(|(a, b)| pixel_error(*a, *b)).collect();
    let (mean_a, mean_b) = (mean(pairs().map(|(a, _)| *a)), mean(pairs().map(|(_, b)| *b)));
    let relmse = average(&errors);
    let trimmed_pixels = (errors.len() as f64 * TRIMMED_SHARE) as usize;
    let kept = errors.len() - trimmed_pixels;
    if kept < errors.len() {
        errors.select_nth_unstable_by(kept, f64::total_cmp);
    }
    Ok(Diff {
        width: a.width,
        height: a.height,
        identical: a.pixels.iter().flatten().map(|c| c.to_bits()).eq(b
            .pixels
            .iter()
            .flatten()
            .map(|c| c.to_bits())),
        mean_a,
        mean_b,
        mean_ratio: PerChannel {
            r: ratio(mean_a.r, mean_b.r),
            g: ratio(mean_a.g, mean_b.g),
            b: ratio(mean_a.b, mean_b.b),
            luminance: ratio(mean_a.luminance, mean_b.luminance),
        },
        relmse,
        relmse_trimmed: average(&errors[..kept]),
        trimmed_pixels: trimmed_pixels as u64,
        relmse_epsilon: REL_MSE_EPSILON,
        flip: flip(a, b),
        non_finite_a: a.non_finite_pixels(),
        non_finite_b: b.non_finite_pixels(),
        agreement: agreement(a, b),
    })
}

impl Diff {
    /// Whether `a` is further from the reference than `limit` on relMSE. Pixels of `a` that are no
    /// numbers are: nothing bounds their error.
    #[must_use]
    pub fn exceeds(&self, limit: f64) -> bool {
        // Undefined (no finite pixel at all) exceeds every limit.
        !matches!(self.relmse.partial_cmp(&limit), Some(std::cmp::Ordering::Less | std::cmp::Ordering::Equal))
            || self.non_finite_a > 0
    }
}

fn pixel_error(a: [f32; 3], b: [f32; 3]) -> f64 {
    let channel = |i: usize| {
        let (a, b) = (f64::from(a[i]), f64::from(b[i]));
        (a - b).powi(2) / (b * b + REL_MSE_EPSILON)
    };
    (channel(0) + channel(1) + channel(2)) / 3.0
}

fn average(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn mean(pixels: impl Iterator<Item = [f32; 3]>) -> PerChannel {
    let (mut sum, mut count) = ([0.0f64; 3], 0u64);
    for pixel in pixels {
        for (sum, c) in sum.iter_mut().zip(pixel) {
            *sum += f64::from(c);
        }
        count += 1;
    }
    let [r, g, b] = sum.map(|s| s / count as f64);
    PerChannel { r, g, b, luminance: 0.2126 * r + 0.7152 * g + 0.0722 * b }
}

/// Two black images have one mean.
fn ratio(a: f64, b: f64) -> f64 {
    if a == 0.0 && b == 0.0 { 1.0 } else { a / b }
}

fn flip(a: &Image, b: &Image) -> Option<Flip> {
    if u64::from(a.width) * u64::from(a.height) > MAX_FLIP_PIXELS || a.pixels.is_empty() {
        return None;
    }
    let encode = |image: &Image| {
        let bytes: Vec<u8> = image.pixels.iter().flatten().map(|&c| linear_to_byte(c)).collect();
        nv_flip::FlipImageRgb8::with_data(image.width, image.height, &bytes)
    };
    let pixels_per_degree = nv_flip::DEFAULT_PIXELS_PER_DEGREE;
    let map = nv_flip::flip(encode(b), encode(a), pixels_per_degree).to_vec();
    let mean = map.iter().map(|&e| f64::from(e)).sum::<f64>() / map.len() as f64;
    Some(Flip { mean, pixels_per_degree: f64::from(pixels_per_degree) })
}

/// NaN stays NaN, so that no block which holds one can agree.
fn clipped_luminance(pixel: [f32; 3]) -> f64 {
    let l = f64::from(luminance(Vec3::from(pixel)));
    if l > CLIP { CLIP } else { l }
}

fn agreement(a: &Image, b: &Image) -> Agreement {
    let la: Vec<f64> = a.pixels.iter().map(|p| clipped_luminance(*p)).collect();
    let lb: Vec<f64> = b.pixels.iter().map(|p| clipped_luminance(*p)).collect();
    let luminance_ratio = ratio(average(&la), average(&lb));
    let (width, height) = (a.width as usize, a.height as usize);
    // Smaller than a block: one block of what there is.
    let (block_w, block_h) = (BLOCK.min(width), BLOCK.min(height));
    let (mut blocks, mut agreeing) = (0, 0);
    for y in (0..=height - block_h).step_by(block_h) {
        for x in (0..=width - block_w).step_by(block_w) {
            let rows = (y..y + block_h).map(|row| row * width + x);
            let indices = || rows.clone().flat_map(|start| start..start + block_w);
            blocks += 1;
            agreeing += u64::from(block_agrees(indices().map(|i| (la[i], lb[i])), block_w * block_h));
        }
    }
    let share = agreeing as f64 / blocks as f64;
    let agree = (luminance_ratio - 1.0).abs() <= MEAN_TOLERANCE && share >= BLOCK_SHARE;
    Agreement { agree, luminance_ratio, blocks, agreeing, share }
}

fn block_agrees(pairs: impl Iterator<Item = (f64, f64)> + Clone, count: usize) -> bool {
    let n = count as f64;
    let mean_a = pairs.clone().map(|(a, _)| a).sum::<f64>() / n;
    let mean_b = pairs.clone().map(|(_, b)| b).sum::<f64>() / n;
    let difference = mean_a - mean_b;
    let variance = pairs.map(|(a, b)| (a - b - difference).powi(2)).sum::<f64>() / n;
    let standard_error = (variance / n).sqrt();
    difference.abs() <= 0.05 * mean_b.abs() + 3.0 * standard_error + 0.002
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, height: u32, pixel: impl Fn(u32, u32) -> [f32; 3]) -> Image {
        let mut image = Image::new(width, height);
        for y in 0..height {
            for x in 0..width {
                let at = image.index(x, y);
                image.pixels[at] = pixel(x, y);
            }
        }
        image
    }

    fn grey(width: u32, height: u32, value: f32) -> Image {
        image(width, height, |_, _| [value; 3])
    }

    fn near(a: f64, b: f64) {
        assert!((a - b).abs() <= 1e-6 * b.abs().max(1.0), "{a} is not {b}");
    }

    #[test]
    fn identical_images_differ_by_nothing() {
        let a = image(48, 32, |x, y| [x as f32 * 0.1, y as f32 * 0.01, 60.0]);
        let d = diff(&a, &a).expect("one size");
        assert!(d.identical && d.agreement.agree && !d.exceeds(0.0));
        assert_eq!((d.relmse, d.relmse_trimmed, d.flip.expect("small").mean), (0.0, 0.0, 0.0));
        assert_eq!((d.agreement.blocks, d.agreement.agreeing), (6, 6));
        assert_eq!(d.mean_ratio, PerChannel { r: 1.0, g: 1.0, b: 1.0, luminance: 1.0 });
        let black = grey(16, 16, 0.0);
        assert_eq!(diff(&black, &black).expect("one size").mean_ratio.g, 1.0);
    }

    /// (1.1 − 1)²/(1 + 0.01), and with one channel off a third of it.
    #[test]
    fn scaled_images_have_the_known_error() {
        let b = grey(64, 64, 1.0);
        let d = diff(&grey(64, 64, 1.1), &b).expect("one size");
        near(d.relmse, 0.01 / 1.01);
        near(d.relmse_trimmed, 0.01 / 1.01);
        near(d.mean_ratio.luminance, 1.1);
        assert!(!d.identical && !d.agreement.agree && d.agreement.share == 0.0);
        assert!(d.exceeds(0.0099) && !d.exceeds(0.01));
        // Both are clipped to white.
        assert_eq!(d.flip.expect("small").mean, 0.0);
        let d = diff(&image(64, 64, |_, _| [1.0, 1.0, 1.1]), &b).expect("one size");
        near(d.relmse, 0.01 / 1.01 / 3.0);
        near(d.mean_ratio.r, 1.0);
        near(d.mean_ratio.b, 1.1);
        near(d.mean_ratio.luminance, 1.0 + 0.1 * 0.0722);
    }

    /// 2000 pixels of which two are off by 10: the trimmed error drops exactly those.
    #[test]
    fn trimming_drops_a_thousandth() {
        let b = grey(50, 40, 1.0);
        let a = image(50, 40, |x, y| if y == 7 && x < 2 { [11.0; 3] } else { [1.1; 3] });
        let d = diff(&a, &b).expect("one size");
        assert_eq!(d.trimmed_pixels, 2);
        near(d.relmse, (2.0 * 100.0 + 1998.0 * 0.01) / 1.01 / 2000.0);
        near(d.relmse_trimmed, 0.01 / 1.01);
    }

    #[test]
    fn black_and_white_are_far_apart_to_the_eye() {
        let d = diff(&grey(64, 64, 1.0), &grey(64, 64, 0.0)).expect("one size");
        let flip = d.flip.expect("small");
        // The metric's own extreme for LDR is black against white: near one.
        assert!(flip.mean > 0.9 && flip.mean <= 1.0, "{}", flip.mean);
        assert!((flip.pixels_per_degree - 67.0).abs() < 0.1);
        near(d.relmse, 100.0);
    }

    #[test]
    fn a_block_agrees_up_to_its_tolerance() {
        let agree =
            |a: f32, b: f32| diff(&grey(16, 16, a), &grey(16, 16, b)).expect("one size").agreement.agreeing;
        // 5 % of 1 and 0.002.
        assert_eq!((agree(1.0519, 1.0), agree(1.0521, 1.0)), (1, 0));
        assert_eq!((agree(0.9481, 1.0), agree(0.9479, 1.0)), (1, 0));
        assert_eq!((agree(0.0019, 0.0), agree(0.0021, 0.0)), (1, 0));
        // Both are clipped at 50.
        assert_eq!(agree(9000.0, 50.0), 1);
        // Half the pixels are off by 2d, so the mean is off by d and the difference's deviation is
        // d: three standard errors are 3d/16. With b = 0 the block agrees while 13d/16 ≤ 0.002.
        let half = |d: f32| {
            let a = image(16, 16, |x, _| if x % 2 == 0 { [2.0 * d; 3] } else { [0.0; 3] });
            diff(&a, &grey(16, 16, 0.0)).expect("one size").agreement.agreeing
        };
        let edge = 0.002 * 16.0 / 13.0;
        assert_eq!((half(edge * 0.999), half(edge * 1.001)), (1, 0));
    }

    #[test]
    fn agreement_needs_both_conditions() {
        let b = grey(160, 160, 1.0);
        // Blocks within 5 %, but the mean 3 % off.
        let d = diff(&grey(160, 160, 1.03), &b).expect("one size").agreement;
        assert!(d.share == 1.0 && !d.agree);
        // Mean exact, six blocks of a hundred off.
        let off = |blocks: u32| {
            let a = image(160, 160, |x, y| match (x / 16, y / 16) {
                (x, 0) if x < blocks => [1.1; 3],
                (x, 1) if x < blocks => [0.9; 3],
                _ => [1.0; 3],
            });
            diff(&a, &b).expect("one size").agreement
        };
        assert_eq!((off(3).agreeing, off(3).agree), (94, false));
        assert_eq!((off(2).agreeing, off(2).agree), (96, true));
    }

    #[test]
    fn pixels_beyond_the_last_block_count_in_the_ratio_only() {
        let b = grey(40, 16, 1.0);
        let a = image(40, 16, |x, _| if x >= 32 { [2.0; 3] } else { [1.0; 3] });
        let d = diff(&a, &b).expect("one size").agreement;
        assert_eq!((d.blocks, d.agreeing), (2, 2));
        near(d.luminance_ratio, 1.2);
        // Smaller than a block.
        assert_eq!(diff(&grey(5, 3, 1.0), &grey(5, 3, 1.0)).expect("one size").agreement.blocks, 1);
        assert_eq!(diff(&grey(1, 1, 1.0), &grey(1, 1, 1.0)).expect("one size").agreement.agreeing, 1);
    }

    #[test]
    fn what_is_no_number_is_counted_and_never_agrees() {
        let b = grey(32, 16, 1.0);
        let mut a = b.clone();
        a.pixels[0] = [f32::NAN, 1.0, 1.0];
        let d = diff(&a, &b).expect("one size");
        assert_eq!((d.non_finite_a, d.non_finite_b), (1, 0));
        assert_eq!((d.relmse, d.agreement.agreeing, d.agreement.agree), (0.0, 1, false));
        assert!(d.exceeds(1e9));
        assert!(serde_json::to_string(&d).expect("plain data").contains("\"luminance_ratio\":null"));
        let d = diff(&grey(4, 4, f32::NAN), &grey(4, 4, f32::NAN)).expect("one size");
        assert!(d.relmse.is_nan() && d.exceeds(f64::INFINITY) && !d.agreement.agree);
    }

    #[test]
    fn sizes_must_match() {
        let error = diff(&grey(2, 3, 1.0), &grey(3, 2, 1.0)).expect_err("other size");
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("2×3") && !error.to_string().contains('\n'));
    }
}
