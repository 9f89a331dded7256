//! The error of a tile as its own samples tell it: how far the means of its passes differ from each other.
//!
//! The passes of a pixel are parts of one sequence that fill each other's gaps, so their mean is at least as good as that
//! of passes that know nothing of each other, which is what the variance between them would say: an estimate that is
//! rather too large. Errors are relMSE as `weir diff` has it: squares, relative to the square of the value and a floor,
//! the mean of three channels. The value is a mean over the pixel's neighbours in the tile, so that a pixel that is dark by
//! chance is not held to be exact, nor a bright one forgiven.
//!
//! Invariant: an estimate depends on the tile's sums alone.

use super::FilmBuffer;
use super::buffer::{TILE, Tile};

/// ε of relMSE, in squared linear units: keeps black pixels of the reference from ruling the mean.
pub const REL_MSE_EPSILON: f64 = 0.01;

/// Passes that have a spread.
pub const LEAST_PASSES: u32 = 2;

/// Side of the parts of a tile, of which the worst speaks for it: an edge leaves half of a tile without noise.
const PART: usize = 4;

/// Estimated squares of relative errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TileError {
    /// Of the worst part.
    pub worst: f64,
    /// Summed over the pixels.
    pub sum: f64,
    /// How many those are.
    pub pixels: u32,
}

impl FilmBuffer {
    /// The estimated error of tile `i`; `None` before [`LEAST_PASSES`], or where no squares are kept.
    #[must_use]
    pub fn error(&self, i: u32) -> Option<TileError> {
        let [x0, y0, x1, y1] = self.rectangle(i);
        let errors = errors(&self.tile(i), (x1 - x0) as usize)?;
        let mut parts = [[(0.0, 0u32); TILE as usize / PART]; TILE as usize / PART];
        for (k, error) in errors.iter().enumerate() {
            let (x, y) = (k % (x1 - x0) as usize, k / (x1 - x0) as usize);
            let part = &mut parts[y / PART][x / PART];
            *part = (part.0 + error, part.1 + 1);
        }
        let means = parts.iter().flatten().filter(|part| part.1 > 0).map(|part| part.0 / f64::from(part.1));
        let (worst, sum) = (means.fold(0.0, f64::max), errors.iter().sum());
        Some(TileError { worst, sum, pixels: (x1 - x0) * (y1 - y0) })
    }

    /// The estimated relMSE of the picture; `None` where some tile tells nothing.
    #[must_use]
    pub fn estimated_relmse(&self) -> Option<f64> {
        let mut all = (0.0, 0u64);
        for i in 0..self.tile_count() {
            let error = self.error(i)?;
            all = (all.0 + error.sum, all.1 + u64::from(error.pixels));
        }
        Some(all.0 / all.1 as f64)
    }
}

/// Of each pixel of a tile that is `width` wide.
fn errors(tile: &Tile, width: usize) -> Option<Vec<f64>> {
    let kept = tile.kept.as_ref().filter(|kept| !kept.squares.is_empty())?;
    if tile.passes < LEAST_PASSES {
        return None;
    }
    let passes = f64::from(tile.passes);
    let mean = |sum: &[f32; 4], c: usize| {
        let weight = f64::from(sum[3]);
        if weight > 0.0 { f64::from(sum[c]) / weight } else { 0.0 }
    };
    let height = tile.sums.len() / width;
    let local = |x: usize, y: usize, c: usize| {
        let (mut total, mut count) = (0.0, 0.0);
        for v in y.saturating_sub(1)..(y + 2).min(height) {
            for u in x.saturating_sub(1)..(x + 2).min(width) {
                total += mean(&tile.sums[v * width + u], c);
                count += 1.0;
            }
        }
        total / count
    };
    let of_pixel = |(i, (sum, squares)): (usize, (&[f32; 4], &[f32; 3]))| -> f64 {
        let weight = f64::from(sum[3]);
        if weight <= 0.0 {
            return 0.0;
        }
        // The weighted variance of the passes' means about theirs, over their number: the expectation of the square is
        // (passes − 1) times the variance of a sample.
        let of = |c: usize| {
            let s = f64::from(sum[c]);
            let spread = (f64::from(squares[c]) - s * s / weight).max(0.0);
            let value = local(i % width, i / width, c);
            spread / ((passes - 1.0) * weight) / (3.0 * (value * value + REL_MSE_EPSILON))
        };
        of(0) + of(1) + of(2)
    };
    Some(tile.sums.iter().zip(&kept.squares).enumerate().map(of_pixel).collect())
}

#[cfg(test)]
mod tests {
    use super::super::Keeps;
    use super::*;

    /// Uniform in [0, 1), from a counter.
    fn uniform(i: u64) -> f64 {
        let mut x = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ x >> 31) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A tile of `passes` passes of 16 samples around 1, of a noise that `deviation` tells by column.
    fn film(passes: u32, deviation: impl Fn(usize) -> f64) -> FilmBuffer {
        let film = FilmBuffer::keeping([0, 0, 8, 8], Keeps { cut: false, squares: true });
        for pass in 0..passes {
            let sum = |pixel: usize| {
                let u = uniform(u64::from(pass) << 8 | pixel as u64) - 0.5;
                // A mean of 16 has a quarter of a sample's deviation.
                let value = 16.0 * (1.0 + deviation(pixel % 8) / 4.0 * u * 12f64.sqrt());
                [value as f32, value as f32, value as f32, 16.0]
            };
            let sums: Vec<[f32; 4]> = (0..64).map(sum).collect();
            assert!(film.add(0, pass, None, &sums));
        }
        film
    }

    #[test]
    fn the_error_of_noise_that_is_known_is_found() {
        for (passes, deviation) in [(64, 0.5), (16, 0.1), (256, 2.0)] {
            let error = film(passes, |_| deviation).error(0).expect("enough passes");
            let right = deviation * deviation / f64::from(passes * 16) / (1.0 + REL_MSE_EPSILON);
            // The variance of n uniform numbers is known to √(0.8/n): 64 pixels of 15 passes at least make 3 %, and
            // these are five; the local mean adds its own, some √(deviation²/(9·16·passes)).
            let found = error.sum / 64.0;
            assert!((found / right - 1.0).abs() < 0.15, "{found} is not {right}");
            assert!(error.worst >= found);
        }
    }

    #[test]
    fn half_a_tile_speaks_for_it() {
        let error = film(64, |x| if x < 4 { 0.0 } else { 1.0 }).error(0).expect("enough passes");
        assert!((error.worst / (error.sum / 64.0) / 2.0 - 1.0).abs() < 0.1, "{error:?}");
    }

    #[test]
    fn one_pass_tells_nothing() {
        assert!(film(1, |_| 1.0).error(0).is_none() && film(1, |_| 1.0).estimated_relmse().is_none());
        assert!(film(2, |_| 1.0).error(0).is_some());
        assert!(FilmBuffer::new([0, 0, 8, 8]).error(0).is_none());
    }
}
