//! Tiled, mip-mapped texture files, read one tile at a time, at random, by many threads: the `.tx`
//! files that OpenImageIO's maketx writes (tiled TIFF, a directory a level) and tiled mip-mapped
//! OpenEXR.
//!
//! Invariant: an open [`TiledFile`] holds sizes and offsets only, and nothing of it changes; a tile
//! is decoded into memory that the caller owns. Memory follows the file's length, never what a
//! header claims. Never caches a tile, never filters, never applies a transfer curve to 8-bit
//! numbers.

mod blocks;
mod decode;
mod exr;
mod files;
mod ifd;
mod reading;
mod shape;
mod tiff;
mod window;

pub use files::{Caching, DEFAULT_OPEN_FILES, FilePool, open_file_limit};
pub use shape::TileLevel;

use crate::error::{Error, Result};
use crate::scene::Encoding;
use blocks::Blocks;
use decode::Decoders;
use files::{Cause, PooledFile};
use half::f16;
use shape::Shape;
use std::path::Path;
use std::sync::Arc;

/// One number of a decoded tile, in the machine's byte order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Component {
    /// 8 bits as stored, encoded.
    U8,
    /// A finite half, linear.
    F16,
    /// A finite float, linear.
    F32,
}

impl Component {
    /// Its size.
    #[must_use]
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::F16 => 2,
            Self::F32 => 4,
        }
    }
}

/// What a level's tiles are and where they stand, whatever the format.
struct Layout {
    shape: Shape,
    encoding: Option<Encoding>,
    /// The curve of integers that the file names.
    named: Option<Encoding>,
    /// Weir made it: alpha is there only where it says something.
    ours: bool,
    /// Where each tile's bytes begin in the file, by tile.
    offsets: Box<[u64]>,
    /// How many bytes (for EXR: at most) each tile has in the file; 0 where the file's index makes
    /// no sense.
    sizes: Box<[u32]>,
    codec: Codec,
}

/// A tile's bytes in its file.
#[derive(Clone, Copy)]
struct Extent {
    offset: u64,
    len: usize,
}

enum Codec {
    Tiff(tiff::Codec),
    Exr(exr::Codec),
}

/// A texture file's sizes and offsets, ready to be read at any tile.
pub struct TiledFile {
    file: PooledFile,
    layout: Layout,
}

impl TiledFile {
    /// Opens `path` if it is tiled and mip-mapped in a form that is read tile by tile: a TIFF or
    /// EXR file with square-cornered tiles of 16 to 1024 pixels a side (powers of two) and 1 to 4
    /// channels. `Ok(None)` says that it is not, and that other readers may know it. `encoding` is
    /// the transfer curve of 16-bit integers (they become linear halves when a tile is read) unless
    /// the file names its own.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be read; [`Error::Input`] when it is damaged, or its levels do
    /// not halve down to one tile.
    pub fn open(path: &Path, encoding: Encoding, files: &Arc<FilePool>) -> Result<Option<Self>> {
        let file = files.open(path)?;
        let mut window = window::Window::new(&file);
        let magic = window.bytes(0, file.bytes().min(4) as usize).map_err(|e| Error::file(path, e))?;
        let layout = match *magic {
            [b'I', b'I', 42 | 43, 0] | [b'M', b'M', 0, 42 | 43] => tiff::open(&mut window, encoding),
            [0x76, 0x2f, 0x31, 0x01] => exr::open(&mut window),
            _ => return Ok(None),
        };
        let layout = layout.map_err(|e| Error::file(path, e))?;
        Ok(layout.map(|layout| Self { file, layout }))
    }

    /// Its levels, finest first; the last is one tile.
    #[must_use]
    pub fn levels(&self) -> &[TileLevel] {
        &self.layout.shape.levels
    }

    /// Tiles of all levels.
    #[must_use]
    pub fn tile_count(&self) -> u32 {
        self.layout.offsets.len() as u32
    }

    /// What a decoded tile is made of.
    #[must_use]
    pub fn component(&self) -> Component {
        self.layout.shape.component
    }

    /// Numbers a texel of a decoded tile: 1 grey, 3 RGB, 4 RGBA.
    #[must_use]
    pub fn channels(&self) -> u32 {
        self.layout.shape.channels
    }

    /// log₂ of a tile's width and height in texels.
    #[must_use]
    pub fn tile_log2(&self) -> (u32, u32) {
        self.layout.shape.tile_log2
    }

    /// Size of a decoded tile: texels in rows, channels interleaved, zeros beyond the level's edge.
    #[must_use]
    pub fn tile_bytes(&self) -> usize {
        self.layout.shape.tile_bytes()
    }

    /// What the file itself says about the curve of its numbers.
    #[must_use]
    pub fn encoding(&self) -> Option<Encoding> {
        self.layout.encoding
    }

    /// The curve that the file names for its integers.
    #[must_use]
    pub(super) fn named(&self) -> Option<Encoding> {
        self.layout.named
    }

    /// Reads integers by `encoding`, whatever the file says. Floats stay what they are.
    pub(super) fn impose(&mut self, encoding: Encoding) {
        if self.layout.shape.component == Component::U8 {
            self.layout.encoding = Some(encoding);
        } else if let Codec::Tiff(codec) = &mut self.layout.codec {
            codec.impose(encoding);
        }
    }

    /// Whether it has an alpha channel that says nothing: 1 throughout. Weir's own files have no such
    /// channel; others are looked at from the coarsest level on, up to the one that has a texel for
    /// each 8×8. There 8 bits show one transparent texel among opaque ones, at odd sizes too, as the
    /// coarsest level does not; what may escape is isolated texels that are more than half opaque. One
    /// tile tells for most masks; an opaque channel costs a 48th of the file.
    #[must_use]
    pub(super) fn is_opaque(&self) -> bool {
        const FINEST: usize = 3;
        if self.channels() != 4 || self.layout.ours {
            return false;
        }
        let levels = self.levels();
        let last = levels.len() - 1;
        let mut scratch = TileScratch::default();
        let mut tile = vec![0; self.tile_bytes()];
        levels[FINEST.min(last)..].iter().rev().all(|l| {
            (l.first..l.first + l.tiles_x * l.tiles_y).all(|i| {
                // Whoever needs a tile that cannot be read says so.
                self.read_tile(i, &mut tile, &mut scratch).is_ok() && self.tile_is_opaque(i, &tile)
            })
        })
    }

    fn tile_is_opaque(&self, index: u32, tile: &[u8]) -> bool {
        let at = self.layout.shape.locate(index);
        let texel = self.layout.shape.texel_bytes();
        let rows = tile.chunks_exact(self.layout.shape.tile_width() * texel).take(at.height as usize);
        let mut texels = rows.flat_map(|row| row.chunks_exact(texel).take(at.width as usize));
        texels.all(|t| match (self.component(), t) {
            (Component::U8, [.., a]) => *a == 255,
            (Component::F16, [.., a, b]) => f16::from_ne_bytes([*a, *b]) == f16::ONE,
            // Sums of weights that are 1 but for their last bits.
            (Component::F32, [.., a, b, c, d]) => (f32::from_ne_bytes([*a, *b, *c, *d]) - 1.0).abs() < 1e-6,
            _ => false,
        })
    }

    /// Memory that this takes, in bytes.
    #[must_use]
    pub fn index_bytes(&self) -> usize {
        let layout = &self.layout;
        size_of::<Self>()
            + self.file.path().as_os_str().len()
            + layout.shape.levels.len() * size_of::<TileLevel>()
            + layout.offsets.len() * (size_of::<u64>() + size_of::<u32>())
            + match &layout.codec {
                Codec::Tiff(codec) => codec.bytes(),
                Codec::Exr(codec) => codec.bytes(),
            }
    }

    /// Decodes tile `tile` (levels' tiles follow each other, rows from the top) into `out`, which
    /// has [`tile_bytes`](Self::tile_bytes). Returns how many bytes were read from the file.
    ///
    /// # Errors
    /// [`Error::Input`] when the tile is damaged, the file cannot be read or is not the same any
    /// more; `out` then holds anything.
    ///
    /// # Panics
    /// If there is no such tile, or `out` has another size.
    pub fn read_tile(&self, tile: u32, out: &mut [u8], scratch: &mut TileScratch) -> Result<u64> {
        assert_eq!(out.len(), self.tile_bytes(), "room for one tile");
        let at = self.layout.shape.locate(tile);
        self.read_at(tile, at, out, scratch).map_err(|cause| {
            let message = format!("the tile at column {}, row {} of level {}: {cause}", at.x, at.y, at.level);
            Error::file(self.file.path(), message)
        })
    }

    fn read_at(
        &self,
        tile: u32,
        at: shape::Place,
        out: &mut [u8],
        scratch: &mut TileScratch,
    ) -> std::result::Result<u64, Cause> {
        let layout = &self.layout;
        let (offset, size) = (layout.offsets[tile as usize], layout.sizes[tile as usize] as usize);
        if size == 0 {
            return Err("the file's index places it outside of the file; damaged or cut short".into());
        }
        let bytes = Extent { offset, len: size };
        let read = match &layout.codec {
            Codec::Tiff(codec) => codec.read(&self.file, &layout.shape, at.level, bytes, out, scratch)?,
            Codec::Exr(codec) => codec.read(&self.file, &layout.shape, at, bytes, out, scratch)?,
        };
        layout.shape.clear_padding(at, out);
        Ok(read)
    }
}

/// A file of somebody else's making that is read as tiles are: at positions, past the page cache, and an error
/// when it has changed.
pub(crate) struct RawFile(PooledFile);

impl RawFile {
    /// Opens `path` for the first time.
    pub(crate) fn open(path: &Path, files: &Arc<FilePool>) -> Result<Self> {
        files.open(path).map(Self)
    }

    /// Where it lies.
    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }

    /// Fills `out` from `offset` on; how many bytes were read for it.
    pub(crate) fn read(
        &self,
        offset: u64,
        out: &mut [u8],
        scratch: &mut TileScratch,
    ) -> std::result::Result<u64, Cause> {
        self.0.read_into(offset, out, &mut scratch.raw)
    }
}

/// One thread's buffers; grow to what the largest tile needs and stay.
#[derive(Default)]
pub struct TileScratch {
    /// The file's bytes.
    raw: Blocks,
    /// Decoded, before they become what the caller wants.
    plain: Vec<u8>,
    decoders: Decoders,
}

impl TileScratch {
    /// Memory that it holds.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.raw.bytes() + self.plain.capacity() + self.decoders.bytes()
    }
}

#[cfg(test)]
mod tests;
