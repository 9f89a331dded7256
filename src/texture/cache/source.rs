//! What the cache asks of a file. Decides nothing about memory.

use crate::error::Result;
use crate::texture::tiled::TileScratch;

/// A file of tiles, all of one size, numbered level by level from the finest.
pub trait TileSource: Send + Sync {
    /// Tiles of all levels.
    fn tile_count(&self) -> u32;
    /// Bytes of a decoded tile.
    fn tile_bytes(&self) -> usize;
    /// The first tile of every level, rising from 0.
    fn first_tiles(&self) -> &[u32];
    /// Bytes of the tables that finding a tile needs.
    fn index_bytes(&self) -> usize;
    /// Decodes a tile into `out`, which has [`Self::tile_bytes`] bytes; the bytes that were read.
    ///
    /// # Errors
    /// One line that names the file, the tile and the cause.
    fn read_tile(&self, tile: u32, out: &mut [u8], scratch: &mut TileScratch) -> Result<u64>;
    /// Fills `out` with what stands for a tile that cannot be read.
    fn fill_unreadable(&self, out: &mut [u8]);

    /// Told that a tile is in memory now.
    fn came(&self, _tile: u32) {}
    /// Told that a tile has left memory.
    fn went(&self, _tile: u32) {}

    /// The level that a tile belongs to.
    fn level_of(&self, tile: u32) -> usize {
        self.first_tiles().partition_point(|&first| first <= tile).saturating_sub(1)
    }

    /// Whether `tile` is the only one of its level.
    fn is_alone(&self, tile: u32) -> bool {
        let level = self.level_of(tile);
        let end = self.first_tiles().get(level + 1).copied().unwrap_or(self.tile_count());
        end - self.first_tiles()[level] == 1
    }
}
