//! Tiled, mip-mapped OpenEXR of one part: the header by the `exr` crate, the offset table and the
//! tiles' bytes by ourselves. What is stored as it is or by ZIP is decoded here without a new
//! allocation; other compressions go through the crate, which allocates for each tile.
//! Layout: "OpenEXR File Layout", openexr.com; ZIP's byte order and differences: its
//! `ImfZip.cpp` as documented there.
//!
//! Invariant: the offset table is read only after its length, and a tile's pixels only after their
//! size, were held against the file's length and a bound.

use super::decode::{self, Compression, Decoders};
use super::files::{Cause, PooledFile};
use super::shape::{self, Place, Shape};
use super::window::Window;
use super::{Component, Extent, Layout, TileScratch};
use crate::scene::Encoding;
use crate::texture::exr_in::color_channels;
use crate::texture::image_io::one_line;
use crate::texture::{MAX_SIDE, contain};
use exr::block::UncompressedBlock;
use exr::block::chunk::{Chunk, CompressedBlock, CompressedTileBlock, TileCoordinates};
use exr::math::Vec2;
use exr::meta::attribute::{LevelMode, SampleType};
use exr::meta::header::{Header, LayerAttributes};
use exr::meta::{BlockDescription, MetaData, compute_level_count, compute_level_size};
use half::f16;
use std::io::Read;

type Result<T> = std::result::Result<T, Cause>;

/// Most bytes of one tile with all channels of the file, those that nobody asks for included.
const MAX_BLOCK_BYTES: usize = 64 << 20;
/// A tile's place and length stand before its pixels.
const CHUNK_HEADER: usize = 20;

/// A channel that is read.
#[derive(Clone, Copy)]
struct Slot {
    kind: SampleType,
    /// Bytes a pixel of the channels before it; rows hold them channel after channel.
    before: usize,
}

/// How the tiles of a file are stored.
pub(super) struct Codec {
    meta: Box<MetaData>,
    /// Red, green, blue or grey, then alpha.
    slots: Vec<Slot>,
    pixel_bytes: usize,
    way: Way,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Way {
    Stored,
    Zip,
    Crate,
}

/// Reads on from a place of the file.
struct Stream<'w, 'f> {
    window: &'w mut Window<'f>,
    at: u64,
}

impl Read for Stream<'_, '_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let left = self.window.file_bytes().saturating_sub(self.at);
        let n = left.min(out.len() as u64).min(32 << 10) as usize;
        out[..n].copy_from_slice(self.window.bytes(self.at, n).map_err(std::io::Error::other)?);
        self.at += n as u64;
        Ok(n)
    }
}

/// The file's layout; `None` when it is not tiled and mip-mapped in a form that is read here.
pub(super) fn open(window: &mut Window) -> Result<Option<Layout>> {
    open_exr(window).map_err(|e| format!("EXR: {e}"))
}

fn open_exr(window: &mut Window) -> Result<Option<Layout>> {
    let mut stream = Stream { window, at: 0 };
    let parsed = contain::panics(|| {
        let meta = MetaData::read_from_buffered(&mut stream, false)?;
        if !meta.headers.iter().any(|h| h.deep) {
            MetaData::validate(&meta.headers, false)?;
        }
        Ok::<_, exr::error::Error>(meta)
    });
    let table_at = stream.at;
    let mut meta = match parsed {
        Some(Ok(meta)) => meta,
        Some(Err(e)) => return Err(one_line(&e.to_string())),
        None => return Err("damaged: its decoder gave up".into()),
    };
    let [header] = &mut meta.headers[..] else { return Ok(None) };
    // Previews and what writers note about themselves may be large, and nobody reads them.
    let comments = header.own_attributes.comments.as_ref();
    let ours = comments.is_some_and(|text| text.to_string().contains("weir:source="));
    let position = header.own_attributes.layer_position;
    header.own_attributes = LayerAttributes { layer_position: position, ..LayerAttributes::default() };
    header.shared_attributes.other.clear();
    let Some((shape, slots)) = form(header)? else { return Ok(None) };

    let last = shape.levels[shape.levels.len() - 1];
    let tiles = last.first as usize + 1;
    if header.chunk_count != tiles {
        return Err(format!("{} tiles where its size needs {tiles}; damaged", header.chunk_count));
    }
    let table_bytes = tiles as u64 * 8;
    let pixels_at = table_at.checked_add(table_bytes).filter(|&end| end <= window.file_bytes());
    let pixels_at = pixels_at.ok_or("its table of tiles is longer than the file; damaged or cut short")?;
    let mut offsets = Vec::with_capacity(tiles);
    let mut at = table_at;
    while offsets.len() < tiles {
        let n = (tiles - offsets.len()).min(4096);
        let bytes = window.bytes(at, n * 8)?;
        offsets.extend(bytes.as_chunks::<8>().0.iter().map(|b| u64::from_le_bytes(*b)));
        at += n as u64 * 8;
    }
    let pixel_bytes = header.channels.bytes_per_pixel;
    let longest = CHUNK_HEADER + (pixel_bytes << (shape.tile_log2.0 + shape.tile_log2.1));
    let sizes = sizes(&offsets, pixels_at, window.file_bytes(), longest as u64);
    if sizes.iter().all(|&s| s == 0) {
        return Err("no tile is inside of the file; damaged or cut short".into());
    }
    let way = match header.compression {
        exr::compression::Compression::Uncompressed => Way::Stored,
        exr::compression::Compression::ZIP1 | exr::compression::Compression::ZIP16 => Way::Zip,
        _ => Way::Crate,
    };
    Ok(Some(Layout {
        shape,
        encoding: Some(Encoding::Linear),
        named: None,
        ours,
        offsets: offsets.into_boxed_slice(),
        sizes,
        codec: super::Codec::Exr(Codec { meta: Box::new(meta), slots, pixel_bytes, way }),
    }))
}

/// What the tiles are; `None` when they are not read here.
fn form(header: &Header) -> Result<Option<(Shape, Vec<Slot>)>> {
    let BlockDescription::Tiles(tiles) = header.blocks else { return Ok(None) };
    if tiles.level_mode != LevelMode::MipMap || header.deep {
        return Ok(None);
    }
    let Some(picked) = color_channels(header) else { return Ok(None) };
    let list = &header.channels.list;
    let window = header.shared_attributes.display_window;
    if list.iter().any(|c| c.sampling != Vec2(1, 1))
        || window.size != header.layer_size
        || window.position != header.own_attributes.layer_position
    {
        return Ok(None);
    }
    let small = |v: usize| u32::try_from(v).unwrap_or(u32::MAX);
    let side = |s: Vec2<usize>| (small(s.0), small(s.1));
    let (tile_width, tile_height) = side(tiles.tile_size);
    let Some(tile_log2) = shape::tile_log2(tile_width, tile_height) else { return Ok(None) };
    let (width, height) = side(header.layer_size);
    if width.max(height) > MAX_SIDE || width.min(height) == 0 {
        return Err(format!("{width}×{height} pixels; 1 to {MAX_SIDE} a side are read"));
    }
    let area = 1usize << (tile_log2.0 + tile_log2.1);
    if header.channels.bytes_per_pixel.saturating_mul(area) > MAX_BLOCK_BYTES {
        return Err("a tile is larger than any that is read".into());
    }
    let round = tiles.rounding_mode;
    let count = compute_level_count(round, width.max(height) as usize);
    let sizes: Vec<(u32, u32)> = (0..count)
        .map(|i| {
            let side = |s: u32| small(compute_level_size(round, s as usize, i));
            (side(width), side(height))
        })
        .collect();
    let levels = shape::levels(&sizes, tile_log2)?;
    let slots: Vec<Slot> = picked
        .iter()
        .map(|&i| Slot {
            kind: list[i].sample_type,
            before: list[..i].iter().map(|c| c.sample_type.bytes_per_sample()).sum(),
        })
        .collect();
    let half = slots.iter().all(|s| s.kind == SampleType::F16);
    let component = if half { Component::F16 } else { Component::F32 };
    let channels = if slots.len() == 2 { 4 } else { slots.len() as u32 };
    Ok(Some((Shape { levels, tile_log2, component, channels }, slots)))
}

/// How many bytes each tile has at most: those to where the next one begins. 0 for one that is not
/// inside of the file.
fn sizes(offsets: &[u64], pixels_at: u64, file_bytes: u64, longest: u64) -> Box<[u32]> {
    let mut sorted = offsets.to_vec();
    sorted.sort_unstable();
    let size = |&offset: &u64| {
        if offset < pixels_at || offset.saturating_add(CHUNK_HEADER as u64) > file_bytes {
            return 0;
        }
        let next = sorted.get(sorted.partition_point(|&o| o <= offset)).copied();
        let end = next.unwrap_or(file_bytes).min(file_bytes);
        (end - offset).min(longest) as u32
    };
    offsets.iter().map(size).collect()
}

impl Codec {
    /// Memory beyond its own size, about.
    pub(super) fn bytes(&self) -> usize {
        size_of::<MetaData>() + self.slots.len() * size_of::<Slot>()
    }

    /// Decodes the tile whose bytes begin where `bytes` does; returns how many were read.
    pub(super) fn read(
        &self,
        file: &PooledFile,
        shape: &Shape,
        at: Place,
        bytes: Extent,
        out: &mut [u8],
        scratch: &mut TileScratch,
    ) -> Result<u64> {
        let TileScratch { raw, plain, decoders } = scratch;
        let (bytes, read) = file.read(bytes.offset, bytes.len, raw)?;
        let (head, bytes) = bytes.split_at_checked(CHUNK_HEADER).ok_or("cut short")?;
        let (words, _) = head.as_chunks::<4>();
        let [x, y, level_x, level_y, len] = [0, 1, 2, 3, 4].map(|i| i32::from_le_bytes(words[i]));
        let wanted = [at.x as i32, at.y as i32, at.level as i32, at.level as i32];
        if [x, y, level_x, level_y] != wanted {
            return Err("the file has another tile in its place; damaged".into());
        }
        let bytes = usize::try_from(len).ok().and_then(|len| bytes.get(..len));
        let bytes = bytes.ok_or("its length reaches into the next tile; damaged")?;
        let pixels = Pixels { codec: self, shape, at };
        let stored = at.width as usize * at.height as usize * self.pixel_bytes;
        // Pixels that would not compress are stored as they are, by every method.
        if bytes.len() == stored {
            pixels.pick(&Straight(bytes), out);
        } else if self.way == Way::Zip {
            if plain.len() < stored {
                plain.resize(stored, 0);
            }
            let plain = &mut plain[..stored];
            unzip(bytes, plain, decoders)?;
            let (even, odd) = plain.split_at(stored.div_ceil(2));
            pixels.pick(&Split { even, odd }, out);
        } else if self.way == Way::Stored {
            return Err(format!("{} bytes where {stored} are needed; damaged", bytes.len()));
        } else {
            let coordinates = TileCoordinates {
                tile_index: Vec2(at.x as usize, at.y as usize),
                level_index: Vec2(at.level, at.level),
            };
            let tile = CompressedTileBlock { coordinates, compressed_pixels_le: bytes.to_vec() };
            let chunk = Chunk { layer_index: 0, compressed_block: CompressedBlock::Tile(tile) };
            let block = contain::panics(|| UncompressedBlock::decompress_chunk(chunk, &self.meta, false));
            let mut block =
                block.ok_or("damaged: its decoder gave up")?.map_err(|e| one_line(&e.to_string()))?;
            if block.data.len() != stored {
                return Err(format!("{} bytes where {stored} are needed; damaged", block.data.len()));
            }
            if cfg!(target_endian = "big") {
                self.to_little_endian(at.width as usize, &mut block.data);
            }
            pixels.pick(&Straight(&block.data), out);
        }
        decode::make_finite(out, shape.component);
        Ok(read)
    }

    /// The crate gives the machine's byte order, the file has the other.
    fn to_little_endian(&self, width: usize, data: &mut [u8]) {
        let list = &self.meta.headers[0].channels.list;
        for row in data.chunks_exact_mut(width * self.pixel_bytes) {
            let mut rest = row;
            for channel in list {
                let size = channel.sample_type.bytes_per_sample();
                let (line, after) = rest.split_at_mut(width * size);
                line.chunks_exact_mut(size).for_each(<[u8]>::reverse);
                rest = after;
            }
        }
    }
}

/// Inflates and undoes the differences: `plain` then has the even bytes, then the odd ones.
fn unzip(bytes: &[u8], plain: &mut [u8], decoders: &mut Decoders) -> Result<()> {
    decoders.expand(Compression::Deflate, bytes, plain)?;
    if let Some((_, rest)) = plain.split_first_mut() {
        // A difference d is stored as d + 128, which modulo 256 is the same as a flipped top bit.
        rest.iter_mut().for_each(|b| *b ^= 0x80);
    }
    decode::running_sums(plain);
    Ok(())
}

/// Little-endian numbers at even places of a tile's bytes.
trait Bytes {
    fn two(&self, at: usize) -> [u8; 2];
}

struct Straight<'a>(&'a [u8]);

impl Bytes for Straight<'_> {
    #[inline(always)]
    fn two(&self, at: usize) -> [u8; 2] {
        [self.0[at], self.0[at + 1]]
    }
}

/// Even bytes apart from the odd ones.
struct Split<'a> {
    even: &'a [u8],
    odd: &'a [u8],
}

impl Bytes for Split<'_> {
    #[inline(always)]
    fn two(&self, at: usize) -> [u8; 2] {
        [self.even[at / 2], self.odd[at / 2]]
    }
}

/// A tile of a file, whose bytes are known to be as many as its pixels need.
struct Pixels<'a> {
    codec: &'a Codec,
    shape: &'a Shape,
    at: Place,
}

impl Pixels<'_> {
    /// Interleaves the channels that are read.
    fn pick(&self, bytes: &impl Bytes, out: &mut [u8]) {
        let (width, n) = (self.at.width as usize, self.shape.channels as usize);
        let size = self.shape.component.bytes();
        let row_bytes = self.shape.tile_width() * n * size;
        let rows = out.chunks_exact_mut(row_bytes).take(self.at.height as usize);
        for (y, row) in rows.enumerate() {
            for (k, slot) in self.codec.slots.iter().enumerate() {
                let from = (y * self.codec.pixel_bytes + slot.before) * width;
                // Grey and alpha: grey three times, then alpha.
                let (first, last) = match (self.codec.slots.len(), k) {
                    (2, 0) => (0, 3),
                    (2, _) => (3, 4),
                    _ => (k, k + 1),
                };
                for to in first..last {
                    self.line(bytes, from, slot.kind, &mut row[to * size..]);
                }
            }
        }
    }

    /// One channel of a row.
    fn line(&self, bytes: &impl Bytes, from: usize, kind: SampleType, to: &mut [u8]) {
        let (width, n) = (self.at.width as usize, self.shape.channels as usize);
        let four = |x: usize| {
            let ([a, b], [c, d]) = (bytes.two(from + 4 * x), bytes.two(from + 4 * x + 2));
            [a, b, c, d]
        };
        let half = |x: usize| u16::from_le_bytes(bytes.two(from + 2 * x));
        match (self.shape.component, kind) {
            (Component::F16, _) => strided(to, n, width, |x| half(x).to_ne_bytes()),
            (_, SampleType::F16) => {
                strided(to, n, width, |x| f16::from_bits(half(x)).to_f32().to_ne_bytes());
            }
            (_, SampleType::F32) => {
                strided(to, n, width, |x| u32::from_le_bytes(four(x)).to_ne_bytes());
            }
            (_, SampleType::U32) => {
                strided(to, n, width, |x| (u32::from_le_bytes(four(x)) as f32).to_ne_bytes());
            }
        }
    }
}

/// Writes `width` numbers, `n` apart.
#[inline(always)]
fn strided<const S: usize>(to: &mut [u8], n: usize, width: usize, value: impl Fn(usize) -> [u8; S]) {
    let (numbers, _) = to.as_chunks_mut::<S>();
    for (x, v) in numbers.iter_mut().step_by(n).take(width).enumerate() {
        *v = value(x);
    }
}
