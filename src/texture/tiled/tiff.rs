//! Tiled TIFF, classic and big, both byte orders: one directory a mip level, as OpenImageIO's
//! maketx writes it. TIFF 6.0 (Adobe 1992), its supplement 2 (deflate) and technical note 3
//! (floating point predictor).
//!
//! The directories are read here and not by a library: `tiff` 0.11 reads the offsets of the first
//! image while it opens a file, refuses more than 1 MiB of them, and takes 32 bytes for each.
//!
//! Colour stays as it is stored, whatever the file says of alpha (ExtraSamples 1 or 2), as it does in
//! images that are read whole and in EXR.
//!
//! Invariant: a table is read only after its length was held against the file's.

use super::decode::{self, Compression, Numbers, Predictor, Table16};
use super::files::{Cause, PooledFile};
use super::ifd::{Directory, Entry, Reader, kind_bytes};
use super::shape::{self, Shape};
use super::window::Window;
use super::{Component, Extent, Layout, TileScratch};
use crate::scene::Encoding;

type Result<T> = std::result::Result<T, Cause>;

/// Where the file tells the curve of its numbers, in its description: `weir:encoding=srgb`,
/// `weir:encoding=linear` or `weir:encoding=2.2`.
const ENCODING_KEY: &str = "weir:encoding=";
/// Longest description that is searched for it.
const MAX_DESCRIPTION: u64 = 4096;

mod tag {
    pub(super) const NEW_SUBFILE_TYPE: u16 = 254;
    pub(super) const WIDTH: u16 = 256;
    pub(super) const HEIGHT: u16 = 257;
    pub(super) const BITS_PER_SAMPLE: u16 = 258;
    pub(super) const COMPRESSION: u16 = 259;
    pub(super) const PHOTOMETRIC: u16 = 262;
    pub(super) const FILL_ORDER: u16 = 266;
    pub(super) const DESCRIPTION: u16 = 270;
    pub(super) const ORIENTATION: u16 = 274;
    pub(super) const SAMPLES_PER_PIXEL: u16 = 277;
    pub(super) const PLANAR: u16 = 284;
    pub(super) const PREDICTOR: u16 = 317;
    pub(super) const TILE_WIDTH: u16 = 322;
    pub(super) const TILE_HEIGHT: u16 = 323;
    pub(super) const TILE_OFFSETS: u16 = 324;
    pub(super) const TILE_BYTES: u16 = 325;
    pub(super) const SAMPLE_FORMAT: u16 = 339;
}

/// How the tiles of a file are stored.
pub(super) struct Codec {
    /// By level: maketx compresses the smaller ones whatever it was told for the finest.
    ways: Vec<Way>,
    numbers: Numbers,
    /// Numbers a pixel in the file, 1 to 4.
    samples: usize,
    /// The file's byte order is not the machine's.
    swap: bool,
    /// Linear halves of 16-bit integers.
    table: Option<Table16>,
}

/// How a level's tiles are compressed.
#[derive(Clone, Copy)]
struct Way {
    compression: Compression,
    predictor: Predictor,
}

/// What all levels must share.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Form {
    tile: (u64, u64),
    samples: u64,
    bits: u64,
    format: u64,
    photometric: u64,
    planar: u64,
    fill_order: u64,
    orientation: u64,
}

impl Reader<'_, '_> {
    /// `None` when the directory is of a form that is not read here.
    fn form(&mut self, dir: &Directory) -> Result<Option<Form>> {
        let mut uniform = true;
        let mut get = |tag, default| {
            let value = self.uniform(dir, tag, default)?;
            uniform &= value.is_some();
            Ok::<_, Cause>(value.unwrap_or(default))
        };
        let form = Form {
            tile: (get(tag::TILE_WIDTH, 0)?, get(tag::TILE_HEIGHT, 0)?),
            samples: get(tag::SAMPLES_PER_PIXEL, 1)?,
            bits: get(tag::BITS_PER_SAMPLE, 1)?,
            format: get(tag::SAMPLE_FORMAT, 1)?,
            photometric: get(tag::PHOTOMETRIC, u64::MAX)?,
            planar: get(tag::PLANAR, 1)?,
            fill_order: get(tag::FILL_ORDER, 1)?,
            orientation: get(tag::ORIENTATION, 1)?,
        };
        Ok(uniform.then_some(form))
    }

    /// `None` when the tiles are compressed in a way that is not read here.
    fn way(&mut self, dir: &Directory) -> Result<Option<Way>> {
        let compression = match self.uniform(dir, tag::COMPRESSION, 1)? {
            Some(1) => Compression::None,
            Some(5) => Compression::Lzw,
            Some(8 | 32946) => Compression::Deflate,
            _ => return Ok(None),
        };
        let predictor = match self.uniform(dir, tag::PREDICTOR, 1)? {
            // Without compression there is nothing to predict for, whatever the tag says.
            _ if compression == Compression::None => Predictor::None,
            Some(1) => Predictor::None,
            Some(2) => Predictor::Horizontal,
            Some(3) => Predictor::Float,
            _ => return Ok(None),
        };
        Ok(Some(Way { compression, predictor }))
    }

    fn size(&mut self, dir: &Directory) -> Result<(u32, u32)> {
        let mut side = |tag| {
            let v = self.uniform(dir, tag, 0)?.and_then(|v| u32::try_from(v).ok());
            v.ok_or_else(|| format!("tag {tag} is no size in pixels; damaged"))
        };
        Ok((side(tag::WIDTH)?, side(tag::HEIGHT)?))
    }

    /// The curve that the file names, if it names one.
    fn encoding(&mut self, dir: &Directory) -> Result<Option<Encoding>> {
        let Some(entry) = dir.entries.get(&tag::DESCRIPTION).filter(|e| e.kind == 2) else { return Ok(None) };
        let bytes = self.window.bytes(entry.at, entry.count.min(MAX_DESCRIPTION) as usize)?;
        let text = String::from_utf8_lossy(bytes);
        let Some((_, value)) = text.split_once(ENCODING_KEY) else { return Ok(None) };
        let value = value.split(|c: char| c.is_whitespace() || c == '\0').next().unwrap_or_default();
        match value {
            "srgb" => Ok(Some(Encoding::Srgb)),
            "linear" => Ok(Some(Encoding::Linear)),
            gamma => match gamma.parse::<f32>() {
                Ok(g) if g.is_finite() && g > 0.0 => Ok(Some(Encoding::Gamma(g))),
                _ => Err(format!(
                    "its description says {ENCODING_KEY} and no curve; srgb, linear or a power is needed"
                )),
            },
        }
    }
}

/// The file's layout; `None` when it is not tiled and mip-mapped in a form that is read here.
pub(super) fn open(window: &mut Window, encoding: Encoding) -> Result<Option<Layout>> {
    open_tiff(window, encoding).map_err(|e| format!("TIFF: {e}"))
}

fn open_tiff(window: &mut Window, encoding: Encoding) -> Result<Option<Layout>> {
    let head = window.bytes(0, 4)?;
    let (big_endian, big_tiff) = (head[0] == b'M', head[2] == 43 || head[3] == 43);
    let mut r = Reader { window, big_endian, big_tiff };
    let Some((form, chain)) = chain(&mut r)? else { return Ok(None) };
    let mut ways = Vec::with_capacity(chain.len());
    for (_, dir) in &chain {
        let Some(way) = r.way(dir)? else { return Ok(None) };
        ways.push(way);
    }
    let Some((tile_log2, mut codec)) = codec(form, ways, big_endian) else { return Ok(None) };
    let sizes: Vec<(u32, u32)> = chain.iter().map(|&(size, _)| size).collect();
    if sizes.len() == 1 && (sizes[0].0 > 1 << tile_log2.0 || sizes[0].1 > 1 << tile_log2.1) {
        // Tiles without levels.
        return Ok(None);
    }
    let levels = shape::levels(&sizes, tile_log2)?;
    let component = codec.numbers.component();
    let channels = if codec.samples == 2 { 4 } else { codec.samples as u32 };
    let shape = Shape { levels, tile_log2, component, channels };

    let named = r.encoding(&chain[0].1)?;
    if codec.numbers == Numbers::U16 {
        codec.table = Some(decode::table16(named.unwrap_or(encoding)));
    }
    let (offsets, sizes) = index(&mut r, &chain, &shape, &codec)?;
    let encoding = if component == Component::U8 { named } else { Some(Encoding::Linear) };
    let integers = matches!(codec.numbers, Numbers::U8 | Numbers::U16);
    let ours = named.is_some();
    let named = named.filter(|_| integers);
    Ok(Some(Layout { shape, encoding, named, ours, offsets, sizes, codec: super::Codec::Tiff(codec) }))
}

/// Offsets and sizes of all tiles.
type Index = (Box<[u64]>, Box<[u32]>);
type Chain = Vec<((u32, u32), Directory)>;

/// The levels' directories; `None` when they are no levels, or of a form that is not read here.
fn chain(r: &mut Reader) -> Result<Option<(Form, Chain)>> {
    let word = if r.big_tiff { (8, 8) } else { (4, 4) };
    let first = r.number_at(word.0, word.1)?;
    let dir = r.directory(first)?;
    if !dir.entries.contains_key(&tag::TILE_OFFSETS) {
        return Ok(None);
    }
    let (mut last, mut next) = (r.size(&dir)?, dir.next);
    let Some(form) = r.form(&dir)? else { return Ok(None) };
    let mut chain = vec![(last, dir)];
    // Sides of 32 bits halve at most 32 times, so a chain that comes back to itself ends too.
    while next != 0 && last != (1, 1) && chain.len() <= 32 {
        let dir = r.directory(next)?;
        let (level, size) = (chain.len(), r.size(&dir)?);
        // maketx does not say of its levels that they are levels.
        let said = r.uniform(&dir, tag::NEW_SUBFILE_TYPE, 0)?.is_some_and(|v| v & 1 == 1);
        let (halved, same) = (shape::halve(last, size), r.form(&dir)? == Some(form));
        if !said && level == 1 && !(halved && same) {
            // Pages.
            return Ok(None);
        }
        if !said && !halved {
            break;
        }
        if !same {
            return Err(format!("level {level} is stored in another way than level 0; damaged"));
        }
        (last, next) = (size, dir.next);
        chain.push((size, dir));
    }
    Ok(Some((form, chain)))
}

/// Where each tile's bytes begin, and how many they are; 0 for a tile that is not in the file.
fn index(r: &mut Reader, chain: &Chain, shape: &Shape, codec: &Codec) -> Result<Index> {
    let file_bytes = r.window.file_bytes();
    let stored = codec.stored_bytes(shape);
    let mut offsets = Vec::new();
    let mut sizes = Vec::new();
    for (i, ((_, dir), level)) in chain.iter().zip(&shape.levels).enumerate() {
        let tiles = u64::from(level.tiles_x) * u64::from(level.tiles_y);
        let find = |tag| {
            let inside = |e: &&Entry| {
                let bytes = tiles * kind_bytes(e.kind) as u64;
                e.count == tiles && e.at.checked_add(bytes).is_some_and(|end| end <= file_bytes)
            };
            dir.entries.get(&tag).filter(inside).copied().ok_or_else(|| {
                format!(
                    "tag {tag} of level {i} has no number for each of {tiles} tiles; damaged or cut short"
                )
            })
        };
        let (places, counts) = (find(tag::TILE_OFFSETS)?, find(tag::TILE_BYTES)?);
        let longest = decode::longest(codec.ways[i].compression, stored);
        let first = offsets.len();
        offsets.reserve_exact(tiles as usize);
        sizes.reserve_exact(tiles as usize);
        r.numbers(places, |_, offset| offsets.push(offset))?;
        r.numbers(counts, |k, count| {
            let offset: u64 = offsets[first + k];
            let inside = offset >= 8 && offset.checked_add(count).is_some_and(|end| end <= file_bytes);
            sizes.push(if inside && count <= longest { count as u32 } else { 0 });
        })?;
    }
    if sizes.iter().all(|&size| size == 0) {
        return Err("no tile is inside of the file; damaged or cut short".into());
    }
    Ok((offsets.into_boxed_slice(), sizes.into_boxed_slice()))
}

/// Tiles of this form and how they are decoded; `None` when they are not.
fn codec(form: Form, ways: Vec<Way>, big_endian: bool) -> Option<((u32, u32), Codec)> {
    let numbers = match (form.format, form.bits) {
        (1, 8) => Numbers::U8,
        (1, 16) => Numbers::U16,
        (3, 16) => Numbers::F16,
        (3, 32) => Numbers::F32,
        _ => return None,
    };
    let floats = matches!(numbers, Numbers::F16 | Numbers::F32);
    if !floats && ways.iter().any(|way| way.predictor == Predictor::Float) {
        return None;
    }
    // Grey from black, with or without alpha; RGB, with or without.
    let known = matches!((form.photometric, form.samples), (1, 1 | 2) | (2, 3 | 4));
    let plain = form.planar == 1 || form.samples == 1;
    if !known || !plain || form.fill_order != 1 || form.orientation != 1 {
        return None;
    }
    let tile_log2 = shape::tile_log2(u32::try_from(form.tile.0).ok()?, u32::try_from(form.tile.1).ok()?)?;
    let swap = big_endian != cfg!(target_endian = "big");
    Some((tile_log2, Codec { ways, numbers, samples: form.samples as usize, swap, table: None }))
}

impl Codec {
    /// Reads 16-bit integers by `encoding`.
    pub(super) fn impose(&mut self, encoding: Encoding) {
        if self.numbers == Numbers::U16 {
            self.table = Some(decode::table16(encoding));
        }
    }

    /// Memory beyond its own size.
    pub(super) fn bytes(&self) -> usize {
        self.ways.len() * size_of::<Way>() + self.table.as_ref().map_or(0, Table16::own_bytes)
    }

    /// Size of a tile before it was compressed.
    fn stored_bytes(&self, shape: &Shape) -> usize {
        shape.tile_width() * shape.tile_height() * self.samples * self.numbers.bytes()
    }

    /// Decodes the tile whose bytes are `bytes`; returns how many were read.
    pub(super) fn read(
        &self,
        file: &PooledFile,
        shape: &Shape,
        level: usize,
        bytes: Extent,
        out: &mut [u8],
        scratch: &mut TileScratch,
    ) -> Result<u64> {
        let TileScratch { raw, plain, decoders } = scratch;
        let Way { compression, predictor } = self.ways[level];
        let stored = self.stored_bytes(shape);
        // Grey and alpha take less room in the file than what they become.
        let apart = self.samples == 2;
        let target: &mut [u8] = if apart {
            plain.resize(stored.max(plain.len()), 0);
            &mut plain[..stored]
        } else {
            &mut *out
        };
        let read = if compression == Compression::None {
            if bytes.len < stored {
                return Err(format!("{} bytes where {stored} are needed; damaged", bytes.len));
            }
            file.read_into(bytes.offset, target, raw)?
        } else {
            let (bytes, read) = file.read(bytes.offset, bytes.len, raw)?;
            decoders.expand(compression, bytes, target)?;
            read
        };
        let row = decode::Row { numbers: self.numbers, samples: self.samples, width: shape.tile_width() };
        decode::to_native(target, row, predictor, self.swap, decoders);
        if let Some(table) = &self.table {
            table.apply(target, self.samples);
        }
        if apart {
            decode::widen_grey_alpha(&plain[..stored], out, shape.component.bytes());
        }
        if matches!(self.numbers, Numbers::F16 | Numbers::F32) {
            decode::make_finite(out, shape.component);
        }
        Ok(read)
    }
}
