//! What a tree is made of: plain nodes, wide nodes and blocks of triangles, as they lie in memory and on disk.
//!
//! Invariant: references are indices, never addresses, so that the bytes mean the same wherever they lie.

use bytemuck::{Pod, Zeroable};

/// Children of a wide node.
pub(super) const WIDTH: usize = 8;
/// Triangles in a block.
pub(super) const LANES: usize = 4;

/// A node of the plain form: depth first, the left child follows its parent.
#[repr(C, align(32))]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct Node {
    pub(super) lo: [f32; 3],
    /// Index of the right child; of a leaf the first of its primitives (blocks, where they are triangles).
    pub(super) next: u32,
    pub(super) hi: [f32; 3],
    /// Primitives (blocks) of a leaf in the upper 30 bits, 0 for an inner node; below them the axis along which an
    /// inner node's children lie.
    pub(super) count_axis: u32,
}

const _: () = assert!(size_of::<Node>() == 32, "two nodes a cache line");

impl Node {
    #[inline(always)]
    pub(super) fn count(&self) -> u32 {
        self.count_axis >> 2
    }

    #[inline(always)]
    pub(super) fn axis(&self) -> usize {
        (self.count_axis & 3) as usize
    }
}

/// Where a child of a wide node leads: to a wide node, or to a run of primitives (blocks).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(transparent)]
pub(super) struct Child(pub(super) u32);

const LEAF: u32 = 1 << 31;
const COUNT_BITS: u32 = 4;
const START_BITS: u32 = 31 - COUNT_BITS;

/// Most primitives (blocks) in a leaf.
pub(super) const MAX_LEAF: u32 = 1 << COUNT_BITS;
/// Primitives (blocks) that references can reach.
pub(super) const MAX_STARTS: usize = 1 << START_BITS;

impl Child {
    pub(super) fn inner(node: usize) -> Self {
        Self(u32::try_from(node).ok().filter(|n| n & LEAF == 0).expect("a tree has fewer than 2^31 nodes"))
    }

    pub(super) fn leaf(start: u32, count: u32) -> Self {
        assert!(
            (1..=MAX_LEAF).contains(&count) && (start as usize) < MAX_STARTS,
            "the builder keeps to the limits"
        );
        Self(LEAF | (count - 1) << START_BITS | start)
    }

    #[inline(always)]
    pub(super) fn is_leaf(self) -> bool {
        self.0 & LEAF != 0
    }

    /// Of an inner node: which.
    #[inline(always)]
    pub(super) fn node(self) -> usize {
        self.0 as usize
    }

    /// Of a leaf: its first primitive (block) and how many.
    #[inline(always)]
    pub(super) fn run(self) -> (usize, usize) {
        ((self.0 & ((1 << START_BITS) - 1)) as usize, ((self.0 >> START_BITS & (MAX_LEAF - 1)) + 1) as usize)
    }
}

/// A node of the wide form. An unused child is an empty box, which no ray enters.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct Wide {
    /// Planes: lower x, upper x, lower y, upper y, lower z, upper z; of eight children each.
    pub(super) planes: [[f32; WIDTH]; 6],
    pub(super) children: [Child; WIDTH],
    unused: [u32; 8],
}

const _: () = assert!(size_of::<Wide>() == 256, "four cache lines");

impl Wide {
    /// Without children.
    pub(super) fn empty() -> Self {
        let mut planes = [[f32::INFINITY; WIDTH]; 6];
        for upper in [1, 3, 5] {
            planes[upper] = [f32::NEG_INFINITY; WIDTH];
        }
        Self { planes, children: [Child(0); WIDTH], unused: [0; 8] }
    }

    pub(super) fn set(&mut self, slot: usize, lo: [f32; 3], hi: [f32; 3], child: Child) {
        for axis in 0..3 {
            self.planes[2 * axis][slot] = lo[axis];
            self.planes[2 * axis + 1][slot] = hi[axis];
        }
        self.children[slot] = child;
    }
}

/// Four triangles, corner by corner, axis by axis. Unused lanes are points at NaN, which nothing hits.
#[repr(C, align(16))]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct Block {
    /// `[corner][axis][lane]`.
    pub(super) corners: [[[f32; LANES]; 3]; 3],
    pub(super) geometry: [u32; LANES],
    pub(super) primitive: [u32; LANES],
}

const _: () = assert!(size_of::<Block>() == 176, "44 bytes a triangle");

impl Block {
    /// Without triangles.
    pub(super) fn empty() -> Self {
        Self {
            corners: [[[f32::NAN; LANES]; 3]; 3],
            geometry: [super::super::NONE; LANES],
            primitive: [super::super::NONE; LANES],
        }
    }

    pub(super) fn set(&mut self, lane: usize, triangle: [[f32; 3]; 3], geometry: u32, primitive: u32) {
        for (corner, position) in self.corners.iter_mut().zip(triangle) {
            for (axis, coordinate) in corner.iter_mut().zip(position) {
                axis[lane] = coordinate;
            }
        }
        self.geometry[lane] = geometry;
        self.primitive[lane] = primitive;
    }

    /// The corners of one triangle.
    #[inline(always)]
    pub(super) fn triangle(&self, lane: usize) -> [[f32; 3]; 3] {
        self.corners.map(|corner| corner.map(|axis| axis[lane]))
    }
}
