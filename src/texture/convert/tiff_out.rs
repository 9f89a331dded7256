//! Tiled, mip-mapped TIFF as OpenImageIO's `maketx` lays it out: one directory a level, finest
//! first, the coarser ones marked as reduced resolutions (Adobe, TIFF 6.0; Aldus TIFF technical
//! note 3 for the floating-point predictor; BigTIFF beyond 4 GB).
//!
//! Invariant: uncompressed tiles begin at multiples of [`ALIGNMENT`]; directories come last, so that
//! the file is written once from front to back, but for the pointer to the first. Never buffers
//! more than one row of tiles.

use super::{Compression, TILE, TileRow, TileSink, WrapMode};
use crate::texture::pyramid;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;
use std::io::{self, Seek, SeekFrom, Write};

/// Where uncompressed tiles may begin: a page, so that direct I/O reads them into place.
pub(super) const ALIGNMENT: u64 = 4096;
/// Above this many bytes offsets of 32 bits might not suffice; the rest is room for the directories.
const MOST_CLASSIC_BYTES: u64 = 4_000_000_000;
/// zlib's own default.
const DEFLATE_LEVEL: u32 = 6;

/// What the directories say beside sizes.
pub(super) struct Layout {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Numbers kept of each texel: 1, 3 or 4.
    pub(super) channels: u8,
    /// Bytes of each: 1 unsigned, 2 half, 4 float.
    pub(super) sample_bytes: u8,
    pub(super) compression: Compression,
    pub(super) wrap: WrapMode,
    /// Colour has been multiplied by alpha.
    pub(super) associated_alpha: bool,
    /// `ImageDescription`; the file's length in bytes follows it.
    pub(super) description: String,
}

/// Place and length of every tile of a level.
#[derive(Default)]
struct Tiles {
    offsets: Vec<u64>,
    lengths: Vec<u64>,
}

/// Writes tiles as they come.
pub(super) struct TiffSink<'a, W: Write + Seek> {
    out: &'a mut W,
    layout: Layout,
    big: bool,
    position: u64,
    levels: Vec<Tiles>,
}

impl<'a, W: Write + Seek> TiffSink<'a, W> {
    /// `out` stands at the file's beginning.
    pub(super) fn new(out: &'a mut W, layout: Layout) -> io::Result<Self> {
        let texel_bytes = u64::from(layout.channels) * u64::from(layout.sample_bytes);
        let sizes = pyramid::sizes(layout.width, layout.height);
        let tiles: u64 =
            sizes.iter().map(|&(w, h)| u64::from(w.div_ceil(TILE)) * u64::from(h.div_ceil(TILE))).sum();
        // Deflate adds five bytes a block to what it cannot shrink; directories take 16 a tile.
        let bytes = tiles * (u64::from(TILE * TILE) * texel_bytes + 64);
        let mut sink = Self {
            out,
            big: bytes > MOST_CLASSIC_BYTES,
            position: 0,
            levels: sizes.iter().map(|_| Tiles::default()).collect(),
            layout,
        };
        let header: &[u8] =
            if sink.big { b"II\x2b\0\x08\0\0\0\0\0\0\0\0\0\0\0" } else { b"II\x2a\0\0\0\0\0" };
        sink.put(header)?;
        if sink.layout.compression == Compression::None {
            sink.align(ALIGNMENT)?;
        }
        Ok(sink)
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    fn align(&mut self, to: u64) -> io::Result<()> {
        let padding = (self.position.next_multiple_of(to) - self.position) as usize;
        self.put(&[0; ALIGNMENT as usize][..padding])
    }

    /// Writes the directories and returns the file's length.
    pub(super) fn finish(mut self) -> io::Result<u64> {
        self.align(16)?;
        let first = self.position;
        let sizes = pyramid::sizes(self.layout.width, self.layout.height);
        let levels = std::mem::take(&mut self.levels);
        // The text has the file's length in it, at a fixed width: lay out once to learn it.
        let mut end = 0;
        let mut directories = Vec::new();
        for _ in 0..2 {
            directories.clear();
            for (l, (&size, tiles)) in sizes.iter().zip(&levels).enumerate() {
                let last = l + 1 == sizes.len();
                let entries = entries(&self.layout, l, size, tiles, end);
                append_directory(&mut directories, first, &entries, self.big, last);
            }
            end = first + directories.len() as u64;
        }
        self.put(&directories)?;
        if self.big {
            self.out.seek(SeekFrom::Start(8))?;
            self.out.write_all(&first.to_le_bytes())?;
        } else {
            self.out.seek(SeekFrom::Start(4))?;
            let first = u32::try_from(first).map_err(|_| io::Error::other("beyond 4 GB of a small TIFF"))?;
            self.out.write_all(&first.to_le_bytes())?;
        }
        self.out.seek(SeekFrom::Start(end))?;
        Ok(end)
    }
}

impl<W: Write + Seek> TileSink for TiffSink<'_, W> {
    fn tile_row(&mut self, level: usize, _row: u32, texels: &TileRow<'_>) -> io::Result<()> {
        let (n, size) = (self.layout.channels as usize, self.layout.sample_bytes as usize);
        let compression = self.layout.compression;
        let tiles: Vec<io::Result<Vec<u8>>> = (0..texels.width.div_ceil(TILE))
            .into_par_iter()
            .map(|x| {
                let tile = texels.padded_tile(x, n * size);
                match compression {
                    Compression::None => Ok(tile),
                    Compression::Zip => deflate(predict(tile, n, size)),
                }
            })
            .collect();
        for tile in tiles {
            let tile = tile?;
            self.levels[level].offsets.push(self.position);
            self.levels[level].lengths.push(tile.len() as u64);
            self.put(&tile)?;
        }
        Ok(())
    }
}

fn deflate(tile: Vec<u8>) -> io::Result<Vec<u8>> {
    let out = Vec::with_capacity(tile.len() / 2);
    let mut encoder = ZlibEncoder::new(out, flate2::Compression::new(DEFLATE_LEVEL));
    encoder.write_all(&tile)?;
    encoder.finish()
}

/// Differences along each row: of bytes (predictor 2), or of a float row's bytes sorted by
/// significance (predictor 3).
fn predict(mut tile: Vec<u8>, channels: usize, sample_bytes: usize) -> Vec<u8> {
    let row_bytes = TILE as usize * channels * sample_bytes;
    let mut planes = vec![0; if sample_bytes > 1 { row_bytes } else { 0 }];
    for row in tile.chunks_exact_mut(row_bytes) {
        if sample_bytes > 1 {
            let samples = row_bytes / sample_bytes;
            for (i, sample) in row.chunks_exact(sample_bytes).enumerate() {
                for (significance, &byte) in sample.iter().rev().enumerate() {
                    planes[significance * samples + i] = byte;
                }
            }
            row.copy_from_slice(&planes);
        }
        for i in (channels..row_bytes).rev() {
            row[i] = row[i].wrapping_sub(row[i - channels]);
        }
    }
    tile
}

/// A directory entry's values.
enum Values {
    Text(String),
    Shorts(Vec<u16>),
    Longs(Vec<u64>),
}

fn entries(
    layout: &Layout,
    level: usize,
    (width, height): (u32, u32),
    tiles: &Tiles,
    file_bytes: u64,
) -> Vec<(u16, Values)> {
    let n = layout.channels as usize;
    let short = |v: u16| Values::Shorts(vec![v]);
    let long = |v: u32| Values::Longs(vec![u64::from(v)]);
    let float = layout.sample_bytes > 1;
    let wrap = layout.wrap.name();
    let mut list = vec![
        (254, long(u32::from(level > 0))), // reduced resolution
        (256, long(width)),
        (257, long(height)),
        (258, Values::Shorts(vec![u16::from(layout.sample_bytes) * 8; n])),
        (259, short(if layout.compression == Compression::Zip { 8 } else { 1 })),
        (262, short(if n == 1 { 1 } else { 2 })), // black is zero; RGB
        (270, Values::Text(format!("{} weir:bytes={file_bytes:016x}", layout.description))),
        (277, short(n as u16)),
        (284, short(1)), // channels interleaved
        (305, Values::Text(concat!("weir ", env!("CARGO_PKG_VERSION")).to_owned())),
    ];
    if layout.compression == Compression::Zip {
        list.push((317, short(if float { 3 } else { 2 })));
    }
    list.extend([
        (322, long(TILE)),
        (323, long(TILE)),
        (324, Values::Longs(tiles.offsets.clone())),
        (325, Values::Longs(tiles.lengths.clone())),
    ]);
    if n == 4 {
        list.push((338, short(if layout.associated_alpha { 1 } else { 2 })));
    }
    list.push((339, Values::Shorts(vec![if float { 3 } else { 1 }; n])));
    // Pixar's, which OpenImageIO reads and writes.
    list.push((33302, Values::Text("Plain Texture".to_owned())));
    list.push((33303, Values::Text(format!("{wrap},{wrap}"))));
    debug_assert!(list.is_sorted_by_key(|e| e.0), "TIFF wants its tags sorted");
    list
}

/// Appends a directory, and what does not fit into its entries, to `out`, which will stand at
/// `start` of the file.
fn append_directory(out: &mut Vec<u8>, start: u64, entries: &[(u16, Values)], big: bool, last: bool) {
    let (count_bytes, entry_bytes, pointer_bytes) = if big { (8, 20, 8) } else { (2, 12, 4) };
    let put = |out: &mut Vec<u8>, v: u64, bytes: usize| out.extend(&v.to_le_bytes()[..bytes]);
    put(out, entries.len() as u64, count_bytes);
    let mut rest = Vec::new();
    let rest_start = start + (out.len() + entries.len() * entry_bytes + pointer_bytes) as u64;
    for (tag, values) in entries {
        let (kind, count, bytes): (u16, usize, Vec<u8>) = match values {
            Values::Text(t) => (2, t.len() + 1, t.bytes().chain([0]).collect()),
            Values::Shorts(v) => (3, v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Values::Longs(v) if big => (16, v.len(), v.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Values::Longs(v) => (4, v.len(), v.iter().flat_map(|&x| (x as u32).to_le_bytes()).collect()),
        };
        put(out, u64::from(*tag), 2);
        put(out, u64::from(kind), 2);
        put(out, count as u64, pointer_bytes);
        if bytes.len() <= pointer_bytes {
            out.extend(&bytes);
            out.resize(out.len() + pointer_bytes - bytes.len(), 0);
        } else {
            put(out, rest_start + rest.len() as u64, pointer_bytes);
            rest.extend(&bytes);
            rest.resize(rest.len().next_multiple_of(8), 0);
        }
    }
    // Where the next directory begins, which is on a multiple of 8 too.
    let end = rest_start + rest.len() as u64;
    let next = end.next_multiple_of(8);
    put(out, if last { 0 } else { next }, pointer_bytes);
    out.extend(&rest);
    out.resize(out.len() + (next - end) as usize, 0);
}
