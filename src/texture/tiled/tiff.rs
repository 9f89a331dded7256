//! Tiled TIFF, classic and big, both byte orders: one directory a mip level, as OpenImageIO's
//! maketx writes it. TIFF 6.0 (Adobe 1992), its supplement 2 (deflate) and technical note 3
//! (floating point predictor).
//!
//! The directories are read here and not by a library: `tiff` 0.11 reads the offsets of the first
//! image while it opens a file, refuses more than 1 MiB of them, and takes 32 bytes for each.
//!
//! Invariant: a table is read only after its length was held against the file's.

use super::decode::{self, Compression, Numbers, Predictor, Table16};
use super::files::{Cause, PooledFile, Window};
use super::shape::{self, Shape};
use super::{Component, Layout, TileScratch};
use crate::scene::Encoding;
use std::collections::BTreeMap;

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
    compression: Compression,
    predictor: Predictor,
    numbers: Numbers,
    /// Numbers a pixel in the file, 1 to 4.
    samples: usize,
    /// The file's byte order is not the machine's.
    swap: bool,
    /// Linear halves of 16-bit integers.
    table: Option<Table16>,
}

#[derive(Clone, Copy)]
struct Entry {
    kind: u16,
    count: u64,
    /// Where its values are in the file.
    at: u64,
}

struct Directory {
    entries: BTreeMap<u16, Entry>,
    next: u64,
}

/// What all levels must share.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Form {
    tile: (u64, u64),
    samples: u64,
    bits: u64,
    format: u64,
    compression: u64,
    predictor: u64,
    photometric: u64,
    planar: u64,
    fill_order: u64,
    orientation: u64,
}

struct Reader<'w, 'f> {
    window: &'w mut Window<'f>,
    big_endian: bool,
    big_tiff: bool,
}

impl Reader<'_, '_> {
    fn number(&self, bytes: &[u8]) -> u64 {
        let fold = |v: u64, &b: &u8| v << 8 | u64::from(b);
        if self.big_endian { bytes.iter().fold(0, fold) } else { bytes.iter().rev().fold(0, fold) }
    }

    fn number_at(&mut self, at: u64, len: usize) -> Result<u64> {
        let mut bytes = [0; 8];
        bytes[..len].copy_from_slice(self.window.bytes(at, len)?);
        Ok(self.number(&bytes[..len]))
    }

    fn directory(&mut self, at: u64) -> Result<Directory> {
        let (count_len, entry_len, word) = if self.big_tiff { (8, 20, 8) } else { (2, 12, 4) };
        let count = self.number_at(at, count_len)?;
        if count > 4096 {
            return Err(format!("a directory of {count} entries; damaged"));
        }
        let mut entries = BTreeMap::new();
        let start = at + count_len as u64;
        for i in 0..count {
            let entry_at = start + i * entry_len as u64;
            let mut bytes = [0; 20];
            bytes[..entry_len].copy_from_slice(self.window.bytes(entry_at, entry_len)?);
            let kind = self.number(&bytes[2..4]) as u16;
            let count = self.number(&bytes[4..4 + word]);
            let fits = count.saturating_mul(kind_bytes(kind) as u64) <= word as u64;
            let at =
                if fits { entry_at + 4 + word as u64 } else { self.number(&bytes[4 + word..4 + 2 * word]) };
            entries.insert(self.number(&bytes[..2]) as u16, Entry { kind, count, at });
        }
        let next = self.number_at(start + count * entry_len as u64, word)?;
        Ok(Directory { entries, next })
    }

    /// Calls `each` with the index and value of every number of `entry`.
    fn numbers(&mut self, entry: Entry, mut each: impl FnMut(usize, u64)) -> Result<()> {
        let size = kind_bytes(entry.kind);
        if !matches!(entry.kind, 1 | 3 | 4 | 13 | 16 | 18) {
            return Err(format!("a table of numbers has type {}; damaged", entry.kind));
        }
        let mut i = 0;
        while i < entry.count {
            let n = (entry.count - i).min(8192);
            let at = entry.at.saturating_add(i * size as u64);
            let big_endian = self.big_endian;
            let bytes = self.window.bytes(at, n as usize * size)?;
            for (k, b) in bytes.chunks_exact(size).enumerate() {
                let fold = |v: u64, &b: &u8| v << 8 | u64::from(b);
                let v = if big_endian { b.iter().fold(0, fold) } else { b.iter().rev().fold(0, fold) };
                each(i as usize + k, v);
            }
            i += n;
        }
        Ok(())
    }

    /// The one number of a tag, or of all its numbers when they are equal; `None` when they differ.
    fn uniform(&mut self, dir: &Directory, tag: u16, default: u64) -> Result<Option<u64>> {
        let Some(&entry) = dir.entries.get(&tag) else { return Ok(Some(default)) };
        if entry.count == 0 || entry.count > 64 {
            return Err(format!("tag {tag} has {} numbers; damaged", entry.count));
        }
        let (mut first, mut same) = (0, true);
        self.numbers(entry, |i, v| {
            first = if i == 0 { v } else { first };
            same &= v == first;
        })?;
        Ok(same.then_some(first))
    }

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
            compression: get(tag::COMPRESSION, 1)?,
            predictor: get(tag::PREDICTOR, 1)?,
            photometric: get(tag::PHOTOMETRIC, u64::MAX)?,
            planar: get(tag::PLANAR, 1)?,
            fill_order: get(tag::FILL_ORDER, 1)?,
            orientation: get(tag::ORIENTATION, 1)?,
        };
        Ok(uniform.then_some(form))
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

/// Size of a value of a TIFF type; 0 for one that is not known.
fn kind_bytes(kind: u16) -> usize {
    match kind {
        1 | 2 | 6 | 7 => 1,
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16..=18 => 8,
        _ => 0,
    }
}

/// The file's layout; `None` when it is not tiled and mip-mapped in a form that is read here.
pub(super) fn open(window: &mut Window, encoding: Encoding) -> Result<Option<Layout>> {
    let tiff = |e: Cause| format!("TIFF: {e}");
    open_tiff(window, encoding).map_err(tiff)
}

fn open_tiff(window: &mut Window, encoding: Encoding) -> Result<Option<Layout>> {
    let file_bytes = window.file_bytes();
    let head = window.bytes(0, 4)?;
    let (big_endian, big_tiff) = (head[0] == b'M', head[2] == 43 || head[3] == 43);
    let mut r = Reader { window, big_endian, big_tiff };
    let mut next = if big_tiff { r.number_at(8, 8)? } else { r.number_at(4, 4)? };

    let mut directories: Vec<Directory> = Vec::new();
    let mut sizes = Vec::new();
    let mut first: Option<Form> = None;
    // Not more than there can be levels: a chain that comes back to itself ends here too.
    while next != 0 && sizes.last() != Some(&(1, 1)) && sizes.len() < 32 {
        let dir = r.directory(next)?;
        next = dir.next;
        let level = sizes.len();
        if level == 0 && !dir.entries.contains_key(&tag::TILE_OFFSETS) {
            return Ok(None);
        }
        let size = r.size(&dir)?;
        let form = r.form(&dir)?;
        match (first, form) {
            (None, Some(form)) => first = Some(form),
            (None, None) => return Ok(None),
            (Some(first), form) => {
                // maketx does not say of its levels that they are levels.
                let reduced = r.uniform(&dir, tag::NEW_SUBFILE_TYPE, 0)?.is_some_and(|v| v & 1 == 1);
                let level_like = sizes.last().is_some_and(|&last| shape::halve(last, size));
                if !reduced && level == 1 && (!level_like || form != Some(first)) {
                    // Pages, not levels.
                    return Ok(None);
                }
                if !reduced && !level_like {
                    break;
                }
                if form != Some(first) {
                    return Err(format!("level {level} is stored in another way than level 0; damaged"));
                }
            }
        }
        sizes.push(size);
        directories.push(dir);
    }
    let Some(form) = first else { return Err("it has no image".into()) };
    let Some(codec) = codec(form, big_endian) else { return Ok(None) };
    let Some(tile_log2) = u32::try_from(form.tile.0)
        .ok()
        .zip(u32::try_from(form.tile.1).ok())
        .and_then(|(w, h)| shape::tile_log2(w, h))
    else {
        return Ok(None);
    };
    if sizes.len() == 1 && (u64::from(sizes[0].0) > form.tile.0 || u64::from(sizes[0].1) > form.tile.1) {
        return Ok(None);
    }
    let levels = shape::levels(&sizes, tile_log2)?;
    let component = codec.numbers.component();
    let channels = if codec.samples == 2 { 4 } else { codec.samples as u32 };
    let shape = Shape { levels, tile_log2, component, channels };

    let stored = shape.tile_width() * shape.tile_height() * codec.samples * codec.numbers.bytes();
    let longest = decode::longest(codec.compression, stored);
    let mut offsets = Vec::new();
    let mut counts = Vec::new();
    for (i, (dir, level)) in directories.iter().zip(&shape.levels).enumerate() {
        let tiles = u64::from(level.tiles_x) * u64::from(level.tiles_y);
        let mut table = |tag, values: &mut Vec<u64>| {
            let entry = dir.entries.get(&tag).copied();
            let entry = entry.filter(|e| e.count == tiles && kind_bytes(e.kind) > 0);
            let entry = entry.filter(|e| {
                let end = e.at.checked_add(tiles * kind_bytes(e.kind) as u64);
                end.is_some_and(|end| end <= file_bytes)
            });
            let entry = entry.ok_or_else(|| {
                format!("tag {tag} of level {i} does not have a number for each of {tiles} tiles; damaged or cut short")
            })?;
            values.reserve_exact(tiles as usize);
            r.numbers(entry, |_, v| values.push(v))
        };
        table(tag::TILE_OFFSETS, &mut offsets)?;
        table(tag::TILE_BYTES, &mut counts)?;
    }
    let inside = |offset: u64, count: u64| offset.checked_add(count).is_some_and(|end| end <= file_bytes);
    let sizes: Box<[u32]> = offsets
        .iter()
        .zip(&counts)
        .map(|(&offset, &count)| match u32::try_from(count) {
            Ok(size) if inside(offset, count) && offset >= 8 && count <= longest as u64 => size,
            _ => 0,
        })
        .collect();
    if sizes.iter().all(|&s| s == 0) {
        return Err("no tile is inside of the file; damaged or cut short".into());
    }
    let named = r.encoding(&directories[0])?;
    let table = (codec.numbers == Numbers::U16).then(|| decode::table16(named.unwrap_or(encoding)));
    let encoding = if component == Component::U8 { named } else { Some(Encoding::Linear) };
    let codec = super::Codec::Tiff(Codec { table, ..codec });
    Ok(Some(Layout { shape, encoding, offsets: offsets.into_boxed_slice(), sizes, codec }))
}

/// How tiles of this form are decoded; `None` when they are not.
fn codec(form: Form, big_endian: bool) -> Option<Codec> {
    let numbers = match (form.format, form.bits) {
        (1, 8) => Numbers::U8,
        (1, 16) => Numbers::U16,
        (3, 16) => Numbers::F16,
        (3, 32) => Numbers::F32,
        _ => return None,
    };
    let compression = match form.compression {
        1 => Compression::None,
        5 => Compression::Lzw,
        8 | 32946 => Compression::Deflate,
        _ => return None,
    };
    let predictor = match form.predictor {
        // Without compression there is nothing to predict for, whatever the tag says.
        _ if compression == Compression::None => Predictor::None,
        1 => Predictor::None,
        2 => Predictor::Horizontal,
        3 if matches!(numbers, Numbers::F16 | Numbers::F32) => Predictor::Float,
        _ => return None,
    };
    // Grey from black, with or without alpha; RGB, with or without.
    let known = matches!((form.photometric, form.samples), (1, 1 | 2) | (2, 3 | 4));
    let plain = form.planar == 1 || form.samples == 1;
    if !known || !plain || form.fill_order != 1 || form.orientation != 1 {
        return None;
    }
    let swap = big_endian != cfg!(target_endian = "big");
    Some(Codec { compression, predictor, numbers, samples: form.samples as usize, swap, table: None })
}

impl Codec {
    /// Memory beyond its own size.
    pub(super) fn bytes(&self) -> usize {
        self.table.as_ref().map_or(0, Table16::own_bytes)
    }

    /// Decodes the tile whose `size` bytes begin at `offset`; returns how many bytes were read.
    pub(super) fn read(
        &self,
        file: &PooledFile,
        shape: &Shape,
        offset: u64,
        size: usize,
        out: &mut [u8],
        scratch: &mut TileScratch,
    ) -> Result<u64> {
        let TileScratch { raw, plain, decoders } = scratch;
        let row_numbers = shape.tile_width() * self.samples;
        let stored = shape.tile_height() * row_numbers * self.numbers.bytes();
        // Grey and alpha take less room in the file than what they become.
        let apart = self.samples == 2;
        let target: &mut [u8] = if apart {
            if plain.len() < stored {
                plain.resize(stored, 0);
            }
            &mut plain[..stored]
        } else {
            &mut *out
        };
        let read = if self.compression == Compression::None {
            if size < stored {
                return Err(format!("{size} bytes where {stored} are needed; damaged"));
            }
            file.read_into(offset, target, raw)?
        } else {
            let (bytes, read) = file.read(offset, size, raw)?;
            decoders.expand(self.compression, bytes, target)?;
            read
        };
        decode::to_native(
            target,
            self.numbers,
            self.predictor,
            row_numbers,
            self.samples,
            self.swap,
            decoders,
        );
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
