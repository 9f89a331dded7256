//! Builds the plain form: top down, by the surface area heuristic over bins (Wald 2007), subtrees in parallel.
//!
//! Invariant: the tree depends on the primitives alone, not on the number of threads. No path is deeper than
//! [`MAX_DEPTH`].

use super::plain::MAX_DEPTH;
use super::primitives::{Reference, longest_axis};
use super::tree::{MAX_LEAF, Node};
use glam::Vec4;
use rayon::prelude::*;

/// How a node's primitives may be divided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SplitRule {
    /// Each goes to one side.
    #[default]
    Objects,
}

/// How to build.
#[derive(Clone, Copy, Debug)]
pub struct BuildSettings {
    /// How primitives are divided.
    pub split: SplitRule,
    /// Primitives that are tested together, and so cost as much as one.
    pub together: u32,
    /// What a visit to a node costs, in tests of primitives.
    pub node_cost: f32,
}

impl BuildSettings {
    /// For blocks of four triangles.
    pub const TRIANGLES: Self = Self { split: SplitRule::Objects, together: 4, node_cost: 2.0 };
    /// For primitives that are tested one by one, at some cost.
    pub const SINGLE: Self = Self { split: SplitRule::Objects, together: 1, node_cost: 0.5 };

    /// Tests that `count` primitives take.
    #[inline(always)]
    fn tests(&self, count: u32) -> f32 {
        count.div_ceil(self.together) as f32
    }

    /// Most primitives of a leaf, in tests.
    const MOST_TESTS: u32 = 4;
}

const _: () = assert!(BuildSettings::MOST_TESTS <= MAX_LEAF, "references to leaves can count that far");

/// Bins an axis at most.
const BINS: usize = 32;
/// Primitives from which on a node's children are built, and its bins filled, in parallel.
const PARALLEL: usize = 1 << 13;
/// Depth from which on nodes are halved by count, so that what is left takes no more than its logarithm.
const BALANCE_FROM: usize = MAX_DEPTH - 34;

/// A box as the builder computes with it.
#[derive(Clone, Copy)]
struct Bounds {
    lo: Vec4,
    hi: Vec4,
}

impl Bounds {
    const EMPTY: Self = Self { lo: Vec4::INFINITY, hi: Vec4::NEG_INFINITY };

    #[inline(always)]
    fn add(&mut self, lo: Vec4, hi: Vec4) {
        self.lo = lo.min(self.lo);
        self.hi = hi.max(self.hi);
    }

    #[inline(always)]
    fn half_area(&self) -> f32 {
        let e = (self.hi - self.lo).max(Vec4::ZERO);
        e.x * e.y + e.y * e.z + e.z * e.x
    }
}

/// Boxes of a node's primitives and of their (doubled) centres.
#[derive(Clone, Copy)]
struct Extent {
    boxes: Bounds,
    centres: Bounds,
}

impl Extent {
    const EMPTY: Self = Self { boxes: Bounds::EMPTY, centres: Bounds::EMPTY };

    #[inline(always)]
    fn add(&mut self, reference: &Reference) {
        let [lo, hi] = reference.bounds();
        self.boxes.add(lo, hi);
        let centre = lo + hi;
        self.centres.add(centre, centre);
    }

    fn join(mut self, other: Self) -> Self {
        self.boxes.add(other.boxes.lo, other.boxes.hi);
        self.centres.add(other.centres.lo, other.centres.hi);
        self
    }
}

/// A finished part of the tree.
enum Part {
    /// Depth first, indices relative to the first.
    Nodes(Vec<Node>),
    Split(Node, Box<(Part, Part)>),
}

/// Builds the tree over `references`, which it sorts: leaves are runs of them, in order.
pub(super) fn build(references: &mut [Reference], settings: BuildSettings) -> Vec<Node> {
    if references.is_empty() {
        return Vec::new();
    }
    let extent = references
        .par_chunks(PARALLEL)
        .map(|part| {
            let mut extent = Extent::EMPTY;
            part.iter().for_each(|r| extent.add(r));
            extent
        })
        .reduce(|| Extent::EMPTY, Extent::join);
    let part = subtree(references, 0, extent, 0, settings);
    let mut nodes = Vec::new();
    flatten(part, &mut nodes);
    nodes
}

fn flatten(part: Part, out: &mut Vec<Node>) {
    match part {
        Part::Nodes(nodes) => {
            let base = out.len() as u32;
            out.extend(nodes.into_iter().map(|mut node| {
                if node.count() == 0 {
                    node.next += base;
                }
                node
            }));
        }
        Part::Split(mut node, children) => {
            let (left, right) = *children;
            let at = out.len();
            out.push(node);
            flatten(left, out);
            node.next = out.len() as u32;
            out[at] = node;
            flatten(right, out);
        }
    }
}

/// A node without its children.
fn node(bounds: &Bounds, axis: usize) -> Node {
    Node {
        lo: bounds.lo.truncate().to_array(),
        next: 0,
        hi: bounds.hi.truncate().to_array(),
        count_axis: axis as u32,
    }
}

fn subtree(
    references: &mut [Reference],
    first: u32,
    extent: Extent,
    depth: usize,
    settings: BuildSettings,
) -> Part {
    if references.len() < PARALLEL {
        let mut nodes = Vec::with_capacity(references.len());
        grow(references, first, extent, depth, settings, &mut nodes);
        return Part::Nodes(nodes);
    }
    let (axis, middle, sides) = divide(references, extent, depth, settings)
        .expect("more primitives than a leaf may have are always divided");
    let (left, right) = references.split_at_mut(middle);
    let children = rayon::join(
        || subtree(left, first, sides[0], depth + 1, settings),
        || subtree(right, first + middle as u32, sides[1], depth + 1, settings),
    );
    Part::Split(node(&extent.boxes, axis), Box::new(children))
}

/// As [`subtree`], on this thread, to the end of `nodes`.
fn grow(
    references: &mut [Reference],
    first: u32,
    extent: Extent,
    depth: usize,
    settings: BuildSettings,
    nodes: &mut Vec<Node>,
) {
    let at = nodes.len();
    match divide(references, extent, depth, settings) {
        None => {
            let mut leaf = node(&extent.boxes, 0);
            leaf.next = first;
            leaf.count_axis = (references.len() as u32) << 2;
            nodes.push(leaf);
        }
        Some((axis, middle, sides)) => {
            nodes.push(node(&extent.boxes, axis));
            let (left, right) = references.split_at_mut(middle);
            grow(left, first, sides[0], depth + 1, settings, nodes);
            nodes[at].next = nodes.len() as u32;
            grow(right, first + middle as u32, sides[1], depth + 1, settings, nodes);
        }
    }
}

/// Brings the primitives of the left child before those of the right: axis, how many are left, extents. `None` where
/// a leaf is as good.
fn divide(
    references: &mut [Reference],
    extent: Extent,
    depth: usize,
    settings: BuildSettings,
) -> Option<(usize, usize, [Extent; 2])> {
    let count = references.len() as u32;
    // What a node would cost alone.
    if count == 1 || settings.tests(count) <= settings.node_cost {
        return None;
    }
    let may_be_leaf = settings.tests(count) <= BuildSettings::MOST_TESTS as f32;
    if depth < BALANCE_FROM
        && let Some(split) = Split::find(references, &extent, settings)
    {
        let area = extent.boxes.half_area();
        if may_be_leaf && settings.tests(count) * area <= settings.node_cost * area + split.cost {
            return None;
        }
        let (middle, sides) = split.partition(references);
        return Some((split.axis, middle, sides));
    }
    if may_be_leaf {
        return None;
    }
    // Centres all in one place, or too deep: halves by the order along the longest axis.
    let axis = longest_axis(extent.centres.hi - extent.centres.lo);
    let middle = references.len() / 2;
    references.select_nth_unstable_by(middle, |a, b| {
        let centre = |r: &Reference| r.centre()[axis];
        // Names last, so that the order is total.
        let key = |r: &Reference| (r.geometry, r.primitive);
        centre(a).total_cmp(&centre(b)).then_with(|| key(a).cmp(&key(b)))
    });
    let sides = [&references[..middle], &references[middle..]].map(|side| {
        let mut extent = Extent::EMPTY;
        side.iter().for_each(|r| extent.add(r));
        extent
    });
    Some((axis, middle, sides))
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
struct Split {
    axis: usize,
    /// First bin on the right.
    bin: usize,
    grid: Grid,
    /// Tests of the children's primitives, weighted by the children's areas.
    cost: f32,
}

impl Split {
    fn find(references: &[Reference], extent: &Extent, settings: BuildSettings) -> Option<Self> {
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
    fn partition(&self, references: &mut [Reference]) -> (usize, [Extent; 2]) {
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
