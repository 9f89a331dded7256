//! The plane between bins that divides a node's primitives best.
//!
//! Invariant: the plane depends on the primitives alone, not on the number of threads that fill the bins.

use super::build::{BuildSettings, PARALLEL};
use super::primitives::Reference;
use glam::Vec4;
use rayon::prelude::*;

/// Bins an axis at most.
const BINS: usize = 32;

/// A box as the builder computes with it.
#[derive(Clone, Copy)]
pub(super) struct Bounds {
    pub(super) lo: Vec4,
    pub(super) hi: Vec4,
}

impl Bounds {
    const EMPTY: Self = Self { lo: Vec4::INFINITY, hi: Vec4::NEG_INFINITY };

    #[inline(always)]
    fn add(&mut self, lo: Vec4, hi: Vec4) {
        self.lo = lo.min(self.lo);
        self.hi = hi.max(self.hi);
    }

    #[inline(always)]
    pub(super) fn half_area(&self) -> f32 {
        let e = (self.hi - self.lo).max(Vec4::ZERO);
        e.x * e.y + e.y * e.z + e.z * e.x
    }
}

/// Boxes of a node's primitives and of their (doubled) centres.
#[derive(Clone, Copy)]
pub(super) struct Extent {
    pub(super) boxes: Bounds,
    pub(super) centres: Bounds,
}

impl Extent {
    pub(super) const EMPTY: Self = Self { boxes: Bounds::EMPTY, centres: Bounds::EMPTY };

    #[inline(always)]
    pub(super) fn add(&mut self, reference: &Reference) {
        let [lo, hi] = reference.bounds();
        self.boxes.add(lo, hi);
        let centre = reference.centre();
        self.centres.add(centre, centre);
    }

    pub(super) fn join(mut self, other: Self) -> Self {
        self.boxes.add(other.boxes.lo, other.boxes.hi);
        self.centres.add(other.centres.lo, other.centres.hi);
        self
    }
}

#[derive(Clone, Copy)]
struct Bin {
    bounds: Bounds,
    count: u32,
}

type Bins<const N: usize> = [[Bin; N]; 3];

/// Which bin a centre is in.
#[derive(Clone, Copy)]
struct Grid {
    origin: Vec4,
    scale: Vec4,
    last: f32,
}

/// Added to a small number that is not negative, leaves it rounded in the lowest bits.
const ROUND: f32 = (1u32 << 23) as f32;

impl Grid {
    fn new(centres: &Bounds, bins: usize) -> Self {
        let size = centres.hi - centres.lo;
        let axis = |s: f32| {
            let scale = bins as f32 / s;
            // An axis without extent has one bin, which no plane divides.
            if scale.is_finite() { scale } else { 0.0 }
        };
        let scale = Vec4::new(axis(size.x), axis(size.y), axis(size.z), 0.0);
        Self { origin: centres.lo, scale, last: (bins - 1) as f32 }
    }

    #[inline(always)]
    fn cells(&self, lo: Vec4, hi: Vec4) -> [usize; 3] {
        let at = ((lo + hi - self.origin) * self.scale - 0.5).max(Vec4::ZERO).min(Vec4::splat(self.last));
        let bits: [u32; 4] = bytemuck::cast(at + ROUND);
        [0, 1, 2].map(|k| (bits[k] & (BINS as u32 - 1)) as usize)
    }

    /// The same of one axis.
    #[inline(always)]
    fn cell(&self, reference: &Reference, axis: usize) -> usize {
        let [lo, hi] = reference.bounds().map(|v| v.to_array()[axis]);
        let at = ((lo + hi - self.origin[axis]) * self.scale[axis] - 0.5).max(0.0).min(self.last);
        ((at + ROUND).to_bits() & (BINS as u32 - 1)) as usize
    }
}

/// A plane between bins.
pub(super) struct Split {
    pub(super) axis: usize,
    /// First bin on the right.
    bin: usize,
    grid: Grid,
    /// Tests of the children's primitives, weighted by the children's areas.
    pub(super) cost: f32,
}

impl Split {
    pub(super) fn find(references: &[Reference], extent: &Extent, settings: BuildSettings) -> Option<Self> {
        // Few primitives need few bins, which are cheaper to clear and to look through.
        match references.len() {
            ..64 => Self::among::<8>(references, extent, settings),
            64..256 => Self::among::<16>(references, extent, settings),
            _ => Self::among::<BINS>(references, extent, settings),
        }
    }

    fn among<const N: usize>(
        references: &[Reference],
        extent: &Extent,
        settings: BuildSettings,
    ) -> Option<Self> {
        let grid = Grid::new(&extent.centres, N);
        let empty = [[Bin { bounds: Bounds::EMPTY, count: 0 }; N]; 3];
        let mut bins = empty;
        if references.len() < 4 * PARALLEL {
            fill(references, &grid, &mut bins);
        } else {
            let part = |mut bins: Box<Bins<N>>, part: &[Reference]| {
                fill(part, &grid, &mut bins);
                bins
            };
            let both = |mut a: Box<Bins<N>>, b: Box<Bins<N>>| {
                join(&mut a, &b);
                a
            };
            bins = *references
                .par_chunks(PARALLEL)
                .fold(|| Box::new(empty), part)
                .reduce(|| Box::new(empty), both);
        }
        let mut best: Option<Self> = None;
        for (axis, row) in bins.iter().enumerate() {
            if grid.scale[axis] == 0.0 {
                continue;
            }
            let mut right_cost = [0.0f32; N];
            let (mut bounds, mut count) = (Bounds::EMPTY, 0);
            for i in (1..N).rev() {
                bounds.add(row[i].bounds.lo, row[i].bounds.hi);
                count += row[i].count;
                right_cost[i] =
                    if count == 0 { f32::INFINITY } else { bounds.half_area() * settings.tests(count) };
            }
            let (mut bounds, mut count) = (Bounds::EMPTY, 0);
            for i in 1..N {
                bounds.add(row[i - 1].bounds.lo, row[i - 1].bounds.hi);
                count += row[i - 1].count;
                if count == 0 {
                    continue;
                }
                let cost = bounds.half_area() * settings.tests(count) + right_cost[i];
                if cost < best.as_ref().map_or(f32::INFINITY, |b| b.cost) {
                    best = Some(Self { axis, bin: i, grid, cost });
                }
            }
        }
        best
    }

    /// Swaps the primitives of the left child to the front; how many, and both extents.
    pub(super) fn partition(&self, references: &mut [Reference]) -> (usize, [Extent; 2]) {
        let is_left = |r: &Reference| self.grid.cell(r, self.axis) < self.bin;
        let mut sides = [Extent::EMPTY; 2];
        let (mut front, mut back) = (0, references.len());
        loop {
            while front < back && is_left(&references[front]) {
                sides[0].add(&references[front]);
                front += 1;
            }
            while front < back && !is_left(&references[back - 1]) {
                back -= 1;
                sides[1].add(&references[back]);
            }
            if front >= back {
                return (front, sides);
            }
            references.swap(front, back - 1);
        }
    }
}

fn fill<const N: usize>(references: &[Reference], grid: &Grid, bins: &mut Bins<N>) {
    for reference in references {
        let [lo, hi] = reference.bounds();
        let cells = grid.cells(lo, hi);
        for axis in 0..3 {
            // Never at or beyond `last`; the remainder of a power of two saves the check.
            let bin = &mut bins[axis][cells[axis] % N];
            bin.bounds.add(lo, hi);
            bin.count += 1;
        }
    }
}

fn join<const N: usize>(a: &mut Bins<N>, b: &Bins<N>) {
    for (a, b) in a.iter_mut().flatten().zip(b.iter().flatten()) {
        a.bounds.add(b.bounds.lo, b.bounds.hi);
        a.count += b.count;
    }
}
