//! Levels, tiles and their numbers, the same for every format.
//!
//! Invariant: levels halve, rounded down or up, until one is a single tile; tiles are counted level
//! by level, row by row.

use super::Component;
use super::files::Cause;
use crate::texture::MAX_SIDE;

/// One mip level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileLevel {
    /// In texels.
    pub width: u32,
    /// In texels.
    pub height: u32,
    /// Tiles a row.
    pub tiles_x: u32,
    /// Rows of tiles.
    pub tiles_y: u32,
    /// Index of its first tile among all levels' tiles.
    pub first: u32,
}

/// Where a tile stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) level: usize,
    pub(super) x: u32,
    pub(super) y: u32,
    /// Texels of the tile that the level has.
    pub(super) width: u32,
    pub(super) height: u32,
}

/// What all tiles have in common, and the levels.
pub(super) struct Shape {
    pub(super) levels: Box<[TileLevel]>,
    pub(super) tile_log2: (u32, u32),
    pub(super) component: Component,
    pub(super) channels: u32,
}

/// log₂ of a tile's sides, if it is one that is read.
pub(super) fn tile_log2(width: u32, height: u32) -> Option<(u32, u32)> {
    let log2 = |side: u32| (side.is_power_of_two() && (16..=1024).contains(&side)).then(|| side.ilog2());
    Some((log2(width)?, log2(height)?))
}

/// Levels of these sizes in tiles.
pub(super) fn levels(
    sizes: &[(u32, u32)],
    tile_log2: (u32, u32),
) -> std::result::Result<Box<[TileLevel]>, Cause> {
    let mut first = 0u32;
    let mut levels = Vec::with_capacity(sizes.len());
    for (i, &(width, height)) in sizes.iter().enumerate() {
        if width == 0 || height == 0 || width.max(height) > MAX_SIDE {
            return Err(format!("level {i} has {width}×{height} texels; 1 to {MAX_SIDE} a side are read"));
        }
        if i > 0 {
            let (w, h) = sizes[i - 1];
            if !halve((w, h), (width, height)) {
                return Err(format!("level {i} has {width}×{height} texels; half of {w}×{h} is needed"));
            }
        }
        let (tiles_x, tiles_y) = (width.div_ceil(1 << tile_log2.0), height.div_ceil(1 << tile_log2.1));
        levels.push(TileLevel { width, height, tiles_x, tiles_y, first });
        // At most 2^26 tiles of 16×16, and a third more.
        first += tiles_x * tiles_y;
    }
    match levels.last() {
        Some(last) if last.tiles_x * last.tiles_y == 1 => Ok(levels.into_boxed_slice()),
        Some(last) => Err(format!(
            "its mip levels end at {}×{} texels; they must go on to a level of one tile",
            last.width, last.height
        )),
        None => Err("it has no levels".into()),
    }
}

/// Whether both sides of `half` are half of `whole`'s, rounded down or up, at least 1.
pub(super) fn halve(whole: (u32, u32), half: (u32, u32)) -> bool {
    let side = |whole: u32, half: u32| half == (whole / 2).max(1) || half == whole.div_ceil(2);
    side(whole.0, half.0) && side(whole.1, half.1)
}

impl Shape {
    pub(super) fn tile_width(&self) -> usize {
        1 << self.tile_log2.0
    }

    pub(super) fn tile_height(&self) -> usize {
        1 << self.tile_log2.1
    }

    pub(super) fn texel_bytes(&self) -> usize {
        self.channels as usize * self.component.bytes()
    }

    pub(super) fn tile_bytes(&self) -> usize {
        (self.tile_width() * self.tile_height()) * self.texel_bytes()
    }

    /// Where tile `tile` stands.
    pub(super) fn locate(&self, tile: u32) -> Place {
        let level = self.levels.partition_point(|l| l.first <= tile) - 1;
        let l = self.levels[level];
        let (x, y) = ((tile - l.first) % l.tiles_x, (tile - l.first) / l.tiles_x);
        assert!(y < l.tiles_y, "a tile of the file");
        Place {
            level,
            x,
            y,
            width: (l.width - (x << self.tile_log2.0)).min(1 << self.tile_log2.0),
            height: (l.height - (y << self.tile_log2.1)).min(1 << self.tile_log2.1),
        }
    }

    /// Zeros what is beyond the level's edges.
    pub(super) fn clear_padding(&self, at: Place, tile: &mut [u8]) {
        let row_bytes = self.tile_width() * self.texel_bytes();
        let used = at.width as usize * self.texel_bytes();
        if used < row_bytes {
            for row in tile.chunks_exact_mut(row_bytes).take(at.height as usize) {
                row[used..].fill(0);
            }
        }
        tile[at.height as usize * row_bytes..].fill(0);
    }
}
