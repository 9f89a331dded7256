//! Cuts triangles into groups that lie close together, by the centres of their boxes alone.
//!
//! Invariant: which triangles are a group, and which group comes first, depends on the triangles and the size of groups
//! alone: not on the order in which they are given, and not on where they are kept while they are divided.

use super::primitives::{Reference, longest_axis};
use bytemuck::{Pod, Zeroable};
use glam::Vec4;

/// Where a triangle or a few lie, and what they are called: of a triangle the centre of its box, doubled.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Centre {
    at: [f32; 3],
    /// In its mesh, or among those that are cut with it.
    pub name: u32,
}

impl Centre {
    /// Of the triangle with these corners; `None` when no ray can hit it.
    #[must_use]
    pub fn of(corners: [[f32; 3]; 3], name: u32) -> Option<Self> {
        let centre = Reference::triangle(corners, 0, name)?.centre();
        Some(Self::at(centre.truncate().to_array(), name))
    }

    /// Of what is called `name` and lies about `at`.
    #[must_use]
    pub fn at(at: [f32; 3], name: u32) -> Self {
        // Zero has one sign, so that order is the order of numbers.
        Self { at: at.map(|c| c + 0.0), name }
    }

    /// Rises with the coordinate along `axis`, and then with the name. No two triangles of a mesh share one.
    #[inline(always)]
    #[must_use]
    pub fn key(&self, axis: usize) -> u64 {
        key(self.at[axis], self.name)
    }
}

#[inline(always)]
fn key(coordinate: f32, name: u32) -> u64 {
    let bits = coordinate.to_bits();
    let rising = if bits >> 31 == 0 { bits | 1 << 31 } else { !bits };
    u64::from(rising) << 32 | u64::from(name)
}

/// Where centres are.
#[derive(Clone, Copy, Debug)]
pub struct Spread {
    lo: Vec4,
    hi: Vec4,
}

impl Spread {
    /// Of no centre.
    pub const NONE: Self = Self { lo: Vec4::INFINITY, hi: Vec4::NEG_INFINITY };

    /// Of one more.
    #[inline(always)]
    pub fn add(&mut self, centre: &Centre) {
        let [x, y, z] = centre.at;
        let at = Vec4::new(x, y, z, 0.0);
        self.lo = self.lo.min(at);
        self.hi = self.hi.max(at);
    }

    /// The axis that they are divided by.
    #[must_use]
    pub fn axis(&self) -> usize {
        longest_axis(self.hi - self.lo)
    }

    /// The least and the largest key that a centre may have.
    #[must_use]
    pub fn keys(&self, axis: usize) -> (u64, u64) {
        (key(self.lo[axis], 0), key(self.hi[axis], u32::MAX))
    }
}

/// Of `count` centres, how many of those with the smallest keys go to the left, so that groups of `most` are full; `None`
/// when all of them are one group.
#[must_use]
pub fn left_of(count: u64, most: usize) -> Option<u64> {
    (count > most as u64).then(|| count.div_ceil(most as u64) / 2 * most as u64)
}

/// Centres from which on both halves are divided at the same time.
const PARALLEL: usize = 1 << 15;

/// Sorts `centres` into groups of at most `most`, all but a few full, one after the other: where each ends.
///
/// # Panics
/// When `most` is 0.
pub fn cut(centres: &mut [Centre], most: usize) -> Vec<usize> {
    assert!(most > 0, "groups of no triangles");
    halve(centres, most, 0)
}

/// `first`: how many come before.
fn halve(centres: &mut [Centre], most: usize, first: usize) -> Vec<usize> {
    let Some(middle) = left_of(centres.len() as u64, most) else {
        return if centres.is_empty() { Vec::new() } else { vec![first + centres.len()] };
    };
    let middle = middle as usize;
    let mut spread = Spread::NONE;
    centres.iter().for_each(|c| spread.add(c));
    let axis = spread.axis();
    centres.select_nth_unstable_by_key(middle, |c| c.key(axis));
    let parallel = centres.len() >= PARALLEL;
    let (left, right) = centres.split_at_mut(middle);
    let mut left = || halve(left, most, first);
    let mut right = || halve(right, most, first + middle);
    let (mut ends, more) = if parallel { rayon::join(left, right) } else { (left(), right()) };
    ends.extend(more);
    ends
}
