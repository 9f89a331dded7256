//! One resident tile: its texels in whole memory pages, so that direct I/O can read straight into
//! them. Never written after it has been shared.

use std::sync::atomic::AtomicU64;

/// What a tile costs beside its texels: its record, the cache's list node and hash-table slots.
/// Measured as the growth of the heap over 100,000 tiles of one block, rounded up.
const BOOKKEEPING: usize = 256;

/// A memory page.
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(4096))]
pub(crate) struct Block([u8; 4096]);

/// Room for texels.
pub(super) type Blocks = Box<[Block]>;

/// Blocks that hold `bytes`.
pub(super) fn blocks_for(bytes: usize) -> usize {
    bytes.div_ceil(size_of::<Block>())
}

/// Zeroed room of `count` blocks.
pub(super) fn allocate(count: usize) -> Blocks {
    vec![<Block as bytemuck::Zeroable>::zeroed(); count].into_boxed_slice()
}

/// What a tile of `blocks` blocks takes of the budget.
pub(super) fn cost(blocks: usize) -> u64 {
    (blocks * size_of::<Block>() + BOOKKEEPING) as u64
}

/// A resident tile.
pub(super) struct Tile {
    /// Which mip level of its file it belongs to.
    pub(super) level: u32,
    /// When it was last asked for, in the cache's time.
    pub(super) used: AtomicU64,
    pub(super) blocks: Blocks,
}

impl Tile {
    /// The tile that no key names.
    pub(super) fn none() -> Self {
        Self { level: 0, used: AtomicU64::new(0), blocks: Box::new([]) }
    }

    /// Its bytes, to the end of the last block.
    #[inline(always)]
    pub(super) fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.blocks)
    }
}
