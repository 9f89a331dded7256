//! Builds the plain form: top down, by the surface area heuristic over bins (Wald 2007), subtrees in parallel.
//!
//! Invariant: the tree depends on the primitives alone, not on the number of threads. No path is deeper than
//! [`MAX_DEPTH`].

use super::bins::{Bounds, Extent, Split};
use super::plain::MAX_DEPTH;
use super::primitives::{Reference, longest_axis};
use super::tree::{MAX_LEAF, Node};
use rayon::prelude::*;

/// How to build.
#[derive(Clone, Copy, Debug)]
pub struct BuildSettings {
    /// Primitives that are tested together, and so cost as much as one.
    pub together: u32,
    /// What a visit to a node costs, in tests of primitives.
    pub node_cost: f32,
}

impl BuildSettings {
    /// For blocks of four triangles.
    pub const TRIANGLES: Self = Self { together: 4, node_cost: 2.0 };
    /// For primitives that are tested one by one, at some cost.
    pub const SINGLE: Self = Self { together: 1, node_cost: 0.5 };

    /// Tests that `count` primitives take.
    #[inline(always)]
    pub(super) fn tests(&self, count: u32) -> f32 {
        count.div_ceil(self.together) as f32
    }

    /// Most primitives of a leaf, in tests.
    const MOST_TESTS: u32 = 4;
}

const _: () = assert!(BuildSettings::MOST_TESTS <= MAX_LEAF, "references to leaves can count that far");

/// Primitives from which on a node's children are built, and its bins filled, in parallel.
pub(super) const PARALLEL: usize = 1 << 13;
/// Depth from which on nodes are halved by count, so that what is left takes no more than its logarithm.
const BALANCE_FROM: usize = MAX_DEPTH - 34;

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
