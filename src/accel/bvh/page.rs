//! Pages: triangles that lie close together, with a tree of their own, as bytes that are traversed where they lie.
//!
//! A page begins with a header of 64 bytes; wide nodes and blocks of triangles follow, and whatever its maker adds
//! after [`PageView::end`]. All numbers are little-endian.
//!
//! Invariant: a page depends on its triangles and their order alone.

use super::build::{BuildSettings, build};
use super::collapse::{into_blocks, widen};
use super::outline::Outline;
use super::primitives::Reference;
use super::tree::{Block, LANES, Wide};
use crate::accel::{Geometry, NONE};
use bytemuck::{Pod, Zeroable};

/// Slots for triangles in a page, so that a hit can say in 32 bits where it was.
const SLOT_BITS: u32 = 12;
/// Most triangles of a page: blocks may be a quarter full.
pub const MAX_TRIANGLES: usize = 1 << (SLOT_BITS - 2);

/// Where a triangle lies: the page, and its slot there.
pub(super) fn place(page: u32, slot: usize) -> u32 {
    page << SLOT_BITS | slot as u32
}

/// The head of a page.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
struct Header {
    nodes: u32,
    blocks: u32,
    /// For the maker of the page.
    free: [u32; 14],
}

const _: () = assert!(size_of::<Header>() == 64, "nodes begin on a cache line");

/// A page's triangles and their tree.
#[derive(Clone, Copy)]
pub struct PageView<'p> {
    pub(super) nodes: &'p [Wide],
    pub(super) blocks: &'p [Block],
    /// What the maker of the page has put into its head.
    pub free: &'p [u32; 14],
}

impl<'p> PageView<'p> {
    /// Of a page's bytes, which begin on a cache line.
    ///
    /// # Panics
    /// When they are no page.
    #[inline]
    #[must_use]
    pub fn new(bytes: &'p [u8]) -> Self {
        let header: &Header = bytemuck::from_bytes(&bytes[..size_of::<Header>()]);
        let nodes = size_of::<Header>();
        let blocks = nodes + header.nodes as usize * size_of::<Wide>();
        let end = blocks + header.blocks as usize * size_of::<Block>();
        Self {
            nodes: bytemuck::cast_slice(&bytes[nodes..blocks]),
            blocks: bytemuck::cast_slice(&bytes[blocks..end]),
            free: &header.free,
        }
    }

    /// Bytes up to where triangles end.
    #[must_use]
    pub fn end(&self) -> usize {
        size_of::<Header>() + size_of_val(self.nodes) + size_of_val(self.blocks)
    }

    /// The page that a hit's place names.
    #[must_use]
    pub fn page_of(place: u32) -> u32 {
        place >> SLOT_BITS
    }

    /// The slot that a hit's place names, below [`Self::slots`].
    #[must_use]
    pub fn slot_of(place: u32) -> usize {
        (place & ((1 << SLOT_BITS) - 1)) as usize
    }

    /// Pages that places can name.
    pub const MAX_PAGES: u32 = (u32::MAX >> SLOT_BITS) - 1;

    /// Slots for triangles, used or not.
    #[must_use]
    pub fn slots(&self) -> usize {
        self.blocks.len() * LANES
    }

    /// The corners of the triangle in `slot`.
    #[inline]
    #[must_use]
    pub fn triangle(&self, slot: usize) -> [[f32; 3]; 3] {
        self.blocks[slot / LANES].triangle(slot % LANES)
    }

    /// What the triangle in `slot` is called in its mesh; [`NONE`](crate::accel::NONE) where there is none.
    #[must_use]
    pub fn primitive(&self, slot: usize) -> u32 {
        self.blocks[slot / LANES].primitive[slot % LANES]
    }
}

/// A page in the making.
pub struct PageTree {
    nodes: Vec<Wide>,
    blocks: Vec<Block>,
    /// Where its triangles are, as trees of pages know it.
    pub outline: Outline,
}

impl PageTree {
    /// Over the triangles `names` of a mesh.
    ///
    /// # Panics
    /// When there are more than a page can name, or none.
    #[must_use]
    pub fn new(positions: &[[f32; 3]], indices: &[[u32; 3]], names: &[u32]) -> Self {
        assert!((1..=MAX_TRIANGLES).contains(&names.len()), "a page of {} triangles", names.len());
        let corners = |name: u32| indices[name as usize].map(|c| positions[c as usize]);
        let mut references: Vec<Reference> =
            names.iter().filter_map(|&n| Reference::triangle(corners(n), 0, n)).collect();
        let mut nodes = build(&mut references, BuildSettings::TRIANGLES);
        let geometry = [Geometry::Triangles { positions, indices, alpha: None }];
        let blocks = into_blocks(&mut nodes, &references, &geometry).elements().to_vec();
        Self { nodes: widen(&nodes), blocks, outline: Outline::new(&nodes) }
    }

    /// Its bytes, with `free` in its head.
    #[must_use]
    pub fn bytes(&self, free: [u32; 14]) -> Vec<u8> {
        let header = Header { nodes: self.nodes.len() as u32, blocks: self.blocks.len() as u32, free };
        let parts = [
            bytemuck::bytes_of(&header),
            bytemuck::cast_slice(&self.nodes),
            bytemuck::cast_slice(&self.blocks),
        ];
        parts.concat()
    }

    /// Calls the triangle `n` of the mesh that it was made of `called(n)`.
    pub fn rename(&mut self, called: impl Fn(u32) -> u32) {
        for name in self.blocks.iter_mut().flat_map(|b| &mut b.primitive).filter(|name| **name != NONE) {
            *name = called(*name);
        }
    }

    /// What the triangle in each slot is called.
    pub fn primitives(&self) -> impl Iterator<Item = u32> {
        self.blocks.iter().flat_map(|b| b.primitive)
    }
}
