//! One resident tile: its texels in whole cache lines. Never written after it has been shared.
//!
//! Lines and not memory pages, which direct reads would go straight into: a page-aligned allocation
//! leaves a hole of up to a page before it, a third of a tile; copying a tile costs half a
//! microsecond, reading it twenty.

use std::sync::atomic::AtomicU64;

/// What a tile costs beside its texels: its record, the cache's list node and hash-table slots, and
/// what the allocator adds.
const BOOKKEEPING: usize = 256;

/// A cache line.
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(super) struct Line([u8; 64]);

/// Room for texels.
pub(super) type Lines = Box<[Line]>;

/// Lines that hold `bytes`.
pub(super) fn lines_for(bytes: usize) -> usize {
    bytes.div_ceil(size_of::<Line>())
}

/// Zeroed room of `count` lines.
pub(super) fn allocate(count: usize) -> Lines {
    vec![<Line as bytemuck::Zeroable>::zeroed(); count].into_boxed_slice()
}

/// What a tile of `lines` lines takes of the budget.
pub(super) fn cost(lines: usize) -> u64 {
    (lines * size_of::<Line>() + BOOKKEEPING) as u64
}

/// Least budget for tiles of `tile_bytes` and `threads` threads: two tiles a thread, one that is in
/// use and one that is being read.
#[must_use]
pub fn least_budget(tile_bytes: usize, threads: usize) -> u64 {
    2 * threads.max(1) as u64 * cost(lines_for(tile_bytes))
}

/// A resident tile.
pub(super) struct Tile {
    /// Which mip level of its file it belongs to.
    pub(super) level: u32,
    /// When it was last moved up, in the cache's time.
    pub(super) used: AtomicU64,
    pub(super) lines: Lines,
}

impl Tile {
    /// The tile that no key names.
    pub(super) fn none() -> Self {
        Self { level: 0, used: AtomicU64::new(0), lines: Box::new([]) }
    }

    /// Its bytes, to the end of the last line.
    #[inline(always)]
    pub(super) fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.lines)
    }
}
