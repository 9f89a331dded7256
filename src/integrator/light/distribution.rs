//! A piecewise constant density over the unit square, sampled by inverting its distribution: the
//! order of samples survives, which an alias table would destroy.
//!
//! Cumulated weights are 32-bit integers: they resolve what an f32 near 1 cannot, every cell of
//! positive weight keeps a positive width, and `sample` and `pdf` read the very same widths. A row
//! is cut into blocks of a cache line, and a guide says for equal parts of [0, 1) in which block
//! each begins (Chen and Asau 1974), so that a sample touches two cache lines of a row, or three.

use crate::math::prefetch;
use bytemuck::{Pod, Zeroable};
use glam::Vec2;

/// The end of every cumulated row; below 2³², so that it is an entry like others.
const TOTAL: u32 = u32::MAX - 255;
/// Entries of a block.
const BLOCK: usize = 16;
/// Blocks that are tried one after the other; among more, halves are.
const FEW: usize = 4;

/// Entries that lie in one cache line.
#[repr(C, align(64))]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Block([u32; BLOCK]);

/// Rows of cumulated weights.
struct Rows {
    blocks: Vec<Block>,
    /// By row for each of as many equal parts as there are blocks the block that it begins in, and the last one that
    /// holds anything.
    guide: Vec<u32>,
    stride: usize,
}

impl Rows {
    fn new(width: usize, count: usize) -> Self {
        // One entry more than cells, so that a cell's end is the next one's start.
        let stride = (width + 1).next_multiple_of(BLOCK);
        Self {
            blocks: vec![Block([TOTAL; BLOCK]); stride / BLOCK * count],
            guide: vec![0; (stride / BLOCK + 1) * count],
            stride,
        }
    }

    fn bytes(&self) -> u64 {
        (size_of_val(&self.blocks[..]) + size_of_val(&self.guide[..])) as u64
    }

    fn bytes_for(width: u64, count: u64) -> u64 {
        let stride = (width + 1).next_multiple_of(BLOCK as u64);
        size_of::<u32>() as u64 * count * (stride + stride / BLOCK as u64 + 1)
    }

    /// A row's entries.
    #[inline]
    fn starts(&self, row: usize) -> &[u32] {
        &bytemuck::cast_slice(&self.blocks)[row * self.stride..][..self.stride]
    }

    /// Stores a row of non-negative finite weights; returns their sum.
    fn fill(&mut self, row: usize, weights: &[f32]) -> f64 {
        let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
        if total > 0.0 {
            let positive = weights.iter().filter(|&&w| w > 0.0).count();
            // One unit for each positive cell, the rest by weight.
            let scale = (f64::from(TOTAL) - positive as f64) / total;
            let starts: &mut [u32] = bytemuck::cast_slice_mut(&mut self.blocks);
            let starts = &mut starts[row * self.stride..][..self.stride];
            let (mut sum, mut before) = (0.0, 0u32);
            for (start, &w) in starts.iter_mut().zip(weights) {
                *start = (sum * scale) as u32 + before;
                sum += f64::from(w);
                before += u32::from(w > 0.0);
            }
            let blocks = self.stride / BLOCK;
            let mut block = 0;
            for (part, guide) in self.guide[row * (blocks + 1)..][..=blocks].iter_mut().enumerate() {
                let from = ((part as u64) << 32).div_ceil(blocks as u64).min(u64::from(TOTAL) - 1) as u32;
                while block + 1 < blocks && starts[(block + 1) * BLOCK] <= from {
                    block += 1;
                }
                *guide = block as u32;
            }
        }
        total
    }

    /// The first and the last block that may hold `key`.
    #[inline]
    fn blocks(&self, row: usize, key: u32) -> (usize, usize) {
        let blocks = self.stride / BLOCK;
        let part = ((u64::from(key) * blocks as u64) >> 32) as usize;
        let guide = &self.guide[row * (blocks + 1) + part..][..2];
        (guide[0] as usize, guide[1] as usize)
    }

    /// Where `u` is in units of 1/TOTAL.
    #[inline]
    fn scaled(u: f32) -> f64 {
        f64::from(u) * f64::from(TOTAL)
    }

    /// A hint that `u` will be found in `row`.
    #[inline]
    fn soon(&self, row: usize, u: f32) {
        let (block, _) = self.blocks(row, Self::scaled(u) as u32);
        prefetch(self.blocks.as_ptr().wrapping_add(row * (self.stride / BLOCK) + block), 1);
    }

    /// (cell, position within it in [0, 1), width in units of 1/TOTAL).
    #[inline]
    fn find(&self, row: usize, u: f32) -> (usize, f32, u32) {
        let x = Self::scaled(u);
        let key = x as u32;
        let starts = self.starts(row);
        let (mut block, last) = self.blocks(row, key);
        if last - block > FEW {
            let (mut low, mut high) = (block + 1, last + 1);
            while low < high {
                let middle = low.midpoint(high);
                if starts[middle * BLOCK] <= key { low = middle + 1 } else { high = middle }
            }
            block = low - 1;
        }
        let below = |block: usize| {
            let entries = &starts[block * BLOCK..][..BLOCK];
            entries.iter().map(|&s| usize::from(s <= key)).sum::<usize>()
        };
        let mut within = below(block);
        while within == BLOCK && block < last {
            block += 1;
            within = below(block);
        }
        let cell = (block * BLOCK + within).max(1) - 1;
        let (start, width) = self.cell(row, cell);
        let offset = ((x - f64::from(start)) / f64::from(width)) as f32;
        (cell, offset.clamp(0.0, 1.0 - f32::EPSILON / 2.0), width)
    }

    /// (start, width) of a cell.
    #[inline]
    fn cell(&self, row: usize, cell: usize) -> (u32, u32) {
        let starts = self.starts(row);
        (starts[cell], starts[cell + 1] - starts[cell])
    }
}

/// A piecewise constant density over a grid of cells.
pub struct Distribution2d {
    width: usize,
    height: usize,
    rows: Rows,
    marginal: Rows,
}

/// A cell chosen by weight.
#[derive(Clone, Copy, Debug)]
pub struct CellSample {
    /// Column.
    pub x: usize,
    /// Row.
    pub y: usize,
    /// Position within the cell, [0, 1)².
    pub offset: Vec2,
    /// Probability of the cell.
    pub probability: f32,
}

impl Distribution2d {
    /// From non-negative finite weights, row by row. `None` where they sum to nothing, or do not
    /// fill a grid of at most 2³¹ cells a side.
    #[must_use]
    pub fn new(weights: &[f32], width: usize, height: usize) -> Option<Self> {
        let fits = (1..=1 << 31).contains(&width) && (1..=1 << 31).contains(&height);
        if !fits || width.checked_mul(height) != Some(weights.len()) {
            return None;
        }
        let (mut rows, mut marginal) = (Rows::new(width, height), Rows::new(height, 1));
        let sums: Vec<f64> =
            weights.chunks_exact(width).enumerate().map(|(y, row)| rows.fill(y, row)).collect();
        // Scaled to the largest row, so that the marginal's f32 never overflows.
        let top = sums.iter().fold(0f64, |m, &s| m.max(s));
        let share = |s: f64| if s > 0.0 { ((s / top) as f32).max(f32::MIN_POSITIVE) } else { 0.0 };
        let sums: Vec<f32> = sums.into_iter().map(share).collect();
        (top > 0.0 && top.is_finite()).then(|| {
            marginal.fill(0, &sums);
            Self { width, height, rows, marginal }
        })
    }

    /// Memory held.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.rows.bytes() + self.marginal.bytes()
    }

    /// Memory that one of this size holds.
    #[must_use]
    pub fn bytes_for(width: u64, height: u64) -> u64 {
        Rows::bytes_for(width, height) + Rows::bytes_for(height, 1)
    }

    /// A cell by its weight, and a uniform position within it.
    #[inline]
    #[must_use]
    pub fn sample(&self, u: Vec2) -> CellSample {
        let (y, oy, row_width) = self.marginal.find(0, u.y);
        let (x, ox, cell_width) = self.rows.find(y, u.x);
        CellSample { x, y, offset: Vec2::new(ox, oy), probability: product(row_width, cell_width) }
    }

    /// A hint that `u` will be sampled.
    #[inline]
    pub fn soon(&self, u: Vec2) {
        let (y, ..) = self.marginal.find(0, u.y);
        self.rows.soon(y, u.x);
    }

    /// A hint that the probability of a cell will be asked for.
    #[inline]
    pub fn soon_at(&self, x: usize, y: usize) {
        prefetch(self.rows.blocks.as_ptr().wrapping_add((y * self.rows.stride + x) / BLOCK), 1);
    }

    /// The probability of a cell.
    #[inline]
    #[must_use]
    pub fn probability(&self, x: usize, y: usize) -> f32 {
        debug_assert!(x < self.width && y < self.height);
        let row = self.marginal.cell(0, y).1;
        // A row of no weight holds no widths either.
        if row == 0 { 0.0 } else { product(row, self.rows.cell(y, x).1) }
    }
}

#[inline]
fn product(a: u32, b: u32) -> f32 {
    const UNIT: f64 = 1.0 / TOTAL as f64;
    ((f64::from(a) * UNIT) * (f64::from(b) * UNIT)) as f32
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Rng, Z_LIMIT, chi_squared_z};
    use super::*;

    #[test]
    fn cells_come_by_weight_and_position_is_uniform() {
        let mut rng = Rng::new(4);
        let (w, h) = (37, 19);
        let weight = |rng: &mut Rng| if rng.f32() < 0.4 { 0.0 } else { rng.f32().powi(6) };
        let mut weights: Vec<f32> = (0..w * h).map(|_| weight(&mut rng)).collect();
        weights[5 * w..6 * w].fill(0.0);
        weights[w - 1] = 0.0;
        let d = Distribution2d::new(&weights, w, h).expect("weight");
        let total: f32 = weights.iter().sum();
        const COUNT: usize = 500_000;
        let mut observed = vec![0.0; w * h];
        let mut offsets = vec![0.0; 64];
        for _ in 0..COUNT {
            let s = d.sample(rng.vec2());
            assert!(weights[s.y * w + s.x] > 0.0);
            assert_eq!(s.probability, d.probability(s.x, s.y));
            observed[s.y * w + s.x] += 1.0;
            offsets[(s.offset.y * 8.0) as usize * 8 + (s.offset.x * 8.0) as usize] += 1.0;
        }
        let expected: Vec<f64> = weights.iter().map(|&x| f64::from(x / total) * COUNT as f64).collect();
        assert!(chi_squared_z(&observed, &expected) < Z_LIMIT);
        assert!(chi_squared_z(&offsets, &[COUNT as f64 / 64.0; 64]) < Z_LIMIT);
        for (i, &x) in weights.iter().enumerate() {
            let p = d.probability(i % w, i / w);
            assert!((p - x / total).abs() < 1e-6 * (x / total) + 1e-9 && (p > 0.0) == (x > 0.0));
        }
    }

    /// What the guide leads to is what a look at every cell in turn finds.
    #[test]
    fn rows_of_any_shape_are_searched_right() {
        let mut rng = Rng::new(9);
        let sun = |at: usize| move |x: usize| if x == at { 1e6 } else { 1e-3 };
        let shapes: [&dyn Fn(usize) -> f32; 6] = [
            &|_| 1.0,
            &sun(0),
            &sun(1234),
            &sun(2999),
            &|x| if x / 500 % 2 == 0 { 0.0 } else { 1.0 },
            &|x| f32::from(x == 1600) + f32::from(x == 1615) + f32::from(x == 1616),
        ];
        for (shape, weight) in shapes.into_iter().enumerate() {
            for width in [1, 15, 16, 17, 300, 3000].into_iter().filter(|&w| (0..w).any(|x| weight(x) > 0.0)) {
                let mut rows = Rows::new(width, 2);
                let weights: Vec<f32> = (0..width).map(weight).collect();
                rows.fill(1, &weights);
                assert_eq!(Rows::bytes_for(width as u64, 2), rows.bytes());
                let ends = [0.0, 1.0 - f32::EPSILON / 2.0];
                let borders: Vec<f32> =
                    (0..width).map(|x| (f64::from(rows.cell(1, x).0) / f64::from(TOTAL)) as f32).collect();
                let some: Vec<f32> = (0..1000).map(|_| rng.f32()).collect();
                for u in ends.into_iter().chain(borders).chain(some).filter(|&u| u < 1.0) {
                    let key = Rows::scaled(u) as u32;
                    let right =
                        (0..width).rev().find(|&x| rows.cell(1, x).0 <= key).expect("the first begins at 0");
                    let (cell, _, size) = rows.find(1, u);
                    assert_eq!(
                        (cell, size),
                        (right, rows.cell(1, right).1),
                        "shape {shape}, width {width}, at {u}"
                    );
                    assert!(weights[cell] > 0.0, "shape {shape}, width {width}, at {u}");
                }
            }
        }
    }

    #[test]
    fn weights_of_any_range_keep_their_cells() {
        let weights = [1e-38, 0.0, 3e38, 1e-20];
        let d = Distribution2d::new(&weights, 2, 2).expect("weight");
        for (i, &w) in weights.iter().enumerate() {
            assert_eq!(d.probability(i % 2, i / 2) > 0.0, w > 0.0, "{i}");
        }
        assert!(Distribution2d::new(&[0.0; 4], 2, 2).is_none());
        assert!(Distribution2d::new(&[1.0; 4], 2, 3).is_none());
        assert!(Distribution2d::new(&[], 0, 0).is_none());
        let s =
            Distribution2d::new(&[2.0], 1, 1).expect("weight").sample(Vec2::splat(1.0 - f32::EPSILON / 2.0));
        assert!((s.x, s.y) == (0, 0) && s.offset.max_element() < 1.0 && (s.probability - 1.0).abs() < 1e-6);
    }
}
