//! Mip levels by an exact box filter: level n+1 has half the texels, rounded down, and each of its
//! texels is the mean of the area it covers, which at odd sizes includes parts of texels. So
//! nothing shifts and the mean is kept. Never widens a kernel, never looks across an edge.

use super::texels::{Level, Memory, Texel};
use glam::Vec4;

/// Sizes of all levels from `width`×`height` down to 1×1.
pub(super) fn sizes(width: u32, height: u32) -> Vec<(u32, u32)> {
    let levels = width.max(height).ilog2() + 1;
    (0..levels).map(|l| ((width >> l).max(1), (height >> l).max(1))).collect()
}

/// Source texels and weights of one target texel: n = 2n' or 2n'+1 source texels become n', so
/// that at most three contribute.
#[derive(Clone, Copy)]
pub(super) struct Taps {
    pub(super) first: u32,
    pub(super) weights: [f32; 3],
}

impl Taps {
    /// One past the last source texel that contributes.
    pub(super) fn end(&self) -> u32 {
        self.first + self.weights.iter().rposition(|&w| w > 0.0).map_or(0, |last| last as u32 + 1)
    }
}

/// Taps of all target texels where `from` texels become `to`.
pub(super) fn taps(from: u32, to: u32) -> Vec<Taps> {
    (0..to)
        .map(|i| match (from, to) {
            (n, m) if n == m => Taps { first: i, weights: [1.0, 0.0, 0.0] },
            (n, _) if n % 2 == 0 => Taps { first: 2 * i, weights: [0.5, 0.5, 0.0] },
            (n, m) => {
                // Target texel i covers [i n/m, (i+1) n/m) = [2i + i/m, 2i + 2 + (i+1)/m).
                let (n, m, k) = (n as f32, m as f32, i as f32);
                Taps { first: 2 * i, weights: [(m - k) / n, m / n, (k + 1.0) / n] }
            }
        })
        .collect()
}

/// Fills `levels[1..]` from `levels[0]`.
pub(super) fn build<T: Texel>(
    memory: &mut Memory,
    levels: &[Level],
    table: &[f32; 256],
    encode: impl Fn(Vec4) -> T + Sync,
) {
    for pair in levels.windows(2) {
        let [fine, coarse] = pair else { continue };
        // A finer level is read while a coarser one is written in the same map: rows go through a
        // copy, which is small beside the level above it.
        let columns = taps(fine.width, coarse.width);
        let rows = taps(fine.height, coarse.height);
        let shared: &Memory = memory;
        let filtered = filter_level::<T>(shared, fine, coarse, &columns, &rows, table, &encode);
        let width = coarse.width as usize;
        coarse.fill_rows(memory, |y, row| row.extend_from_slice(&filtered[y as usize * width..][..width]));
    }
}

fn filter_level<T: Texel>(
    memory: &Memory,
    fine: &Level,
    coarse: &Level,
    columns: &[Taps],
    rows: &[Taps],
    table: &[f32; 256],
    encode: &(impl Fn(Vec4) -> T + Sync),
) -> Vec<T> {
    use rayon::prelude::*;
    let texels = fine.texels::<T>(memory);
    let mut out = vec![T::zeroed(); coarse.width as usize * coarse.height as usize];
    out.par_chunks_mut(coarse.width as usize).zip(rows).for_each(|(line, row)| {
        let texel = |x: u32, dy: u32| texels[fine.index::<T>(x, row.first + dy)];
        filter_row(line, columns, row, texel, table, encode);
    });
    out
}

/// One coarse row. `texel(x, dy)` gives the source texel in column `x`, `dy` rows below
/// `row.first`. Whoever builds a level goes through here, so that the order of sums is one.
#[inline(always)]
pub(super) fn filter_row<T: Texel>(
    line: &mut [T],
    columns: &[Taps],
    row: &Taps,
    texel: impl Fn(u32, u32) -> T,
    table: &[f32; 256],
    encode: &impl Fn(Vec4) -> T,
) {
    for (out, column) in line.iter_mut().zip(columns) {
        let mut sum = Vec4::ZERO;
        for (dy, &wy) in row.weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
            for (dx, &wx) in column.weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                sum += texel(column.first + dx as u32, dy as u32).decode(table) * (wx * wy);
            }
        }
        *out = encode(sum);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_cover_every_texel_evenly_and_stay_inside() {
        for n in 1..200u32 {
            let m = (n / 2).max(1);
            let mut covered = vec![0.0; n as usize];
            for t in taps(n, m) {
                let sum: f32 = t.weights.iter().sum();
                assert!((sum - 1.0).abs() < 1e-6);
                for (k, w) in t.weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                    covered[t.first as usize + k] += w;
                }
            }
            let each = m as f32 / n as f32;
            assert!(covered.iter().all(|c| (c - each).abs() < 1e-5), "{n}: {covered:?}");
        }
    }

    #[test]
    fn levels_end_at_one_texel() {
        assert_eq!(sizes(1, 1), [(1, 1)]);
        assert_eq!(sizes(5, 2), [(5, 2), (2, 1), (1, 1)]);
        assert_eq!(sizes(4096, 4096).len(), 13);
    }
}
