//! OpenEXR: scan lines and tiles of the finest level, half, float and uint, one part. The result
//! has the display window's pixels, black outside the data window. Deep and subsampled images are
//! refused.
//!
//! Invariant: every size of the header is held against the file's length and our bound before a
//! pixel is decoded; a damaged header once asked for 85 GB. Never reads a part or level twice.

use super::contain;
use super::image_io::{ImageData, Kept, MAX_DECODED_BYTES, Pixels, check_size, one_line};
use crate::error::{Error, Result};
use exr::block::UncompressedBlock;
use exr::block::reader::{ChunksReader, Reader};
use exr::meta::attribute::{ChannelDescription, SampleType};
use exr::meta::header::Header;
use half::f16;
use half::vec::HalfBitsVecExt;
use rayon::prelude::*;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Most bytes in one scan line block or tile.
const MAX_BLOCK_BYTES: u64 = 512 << 20;
/// Chunks that are decompressed at a time, by all threads.
const BATCH: usize = 32;

/// What the texels are at most, from the header alone; `None` for what [`read`] refuses.
pub(super) fn kept(path: &Path, file: File) -> Result<Option<Kept>> {
    let bad = |e: exr::error::Error| Error::file(path, format!("EXR: {}", one_line(&e.to_string())));
    let reader = Reader::read_from_buffered(BufReader::with_capacity(1 << 16, file), false).map_err(bad)?;
    let texel = reader.headers().iter().find_map(|h| Some((h, color_channels(h)?)));
    Ok(texel.and_then(|(h, slots)| {
        let window = h.shared_attributes.display_window.size;
        let half = slots.iter().all(|&s| h.channels.list[s].sample_type == SampleType::F16);
        Some(Kept {
            width: u32::try_from(window.0).ok()?,
            height: u32::try_from(window.1).ok()?,
            grey: slots.len() == 1,
            number: if half { 2 } else { 4 },
        })
    }))
}

/// Reads `file`, which is `file_bytes` long and has the signature of an EXR.
pub(super) fn read(path: &Path, file: File, file_bytes: u64) -> Result<ImageData> {
    let bad = |e: exr::error::Error| Error::file(path, format!("EXR: {}", one_line(&e.to_string())));
    let gave_up = || Error::file(path, "EXR: damaged: its decoder gave up");
    let reader = Reader::read_from_buffered(BufReader::with_capacity(1 << 16, file), false).map_err(bad)?;
    let headers = reader.headers();
    let mut chunks = 0u64;
    for h in headers {
        check_header(path, h)?;
        chunks = chunks.saturating_add(h.chunk_count as u64);
    }
    if chunks.saturating_mul(8) > file_bytes {
        let message = format!("EXR: {chunks} chunks cannot be in {file_bytes} bytes; damaged or cut short");
        return Err(Error::file(path, message));
    }
    let (part, slots) = choose(path, headers)?;
    let header = headers[part].clone();
    let window = header.shared_attributes.display_window;
    let (Ok(width), Ok(height)) = (u32::try_from(window.size.0), u32::try_from(window.size.1)) else {
        return Err(Error::file(path, "EXR: the display window is too large"));
    };
    let half = slots.iter().all(|&s| header.channels.list[s].sample_type == SampleType::F16);
    check_size(path, width, height, slots.len() * if half { 2 } else { 4 })?;

    let mut chunks = reader
        .filter_chunks(false, |_, _, block| block.layer == part && block.level == exr::math::Vec2(0, 0))
        .map_err(bad)?;
    let meta = chunks.meta_data().clone();
    let count = width as usize * height as usize * slots.len();
    let mut target = Target {
        // From the data window's pixels to the display window's.
        shift: [
            i64::from(header.own_attributes.layer_position.0) - i64::from(window.position.0),
            i64::from(header.own_attributes.layer_position.1) - i64::from(window.position.1),
        ],
        size: [i64::from(width), i64::from(height)],
        header: &header,
        slots: &slots,
    };
    let mut decode = |sink: &mut dyn FnMut(&mut Target, &UncompressedBlock) -> Result<()>| -> Result<()> {
        loop {
            let mut batch = Vec::with_capacity(BATCH);
            for chunk in chunks.by_ref().take(BATCH) {
                batch.push(chunk.map_err(bad)?);
            }
            if batch.is_empty() {
                return Ok(());
            }
            let blocks: Vec<_> = batch
                .into_par_iter()
                .map(|chunk| contain::panics(|| UncompressedBlock::decompress_chunk(chunk, &meta, false)))
                .collect();
            for block in blocks {
                let block = block.ok_or_else(gave_up)?.map_err(bad)?;
                sink(&mut target, &block)?;
            }
        }
    };
    let short = || Error::file(path, "EXR: a block is smaller than its pixels; damaged");
    let pixels = if half {
        // As u16: only those come zeroed from the system without being touched.
        let mut out = vec![0u16; count];
        decode(&mut |t, block| {
            t.copy(block, &mut out, |b, _| u16::from_ne_bytes([b[0], b[1]])).ok_or_else(short)
        })?;
        Pixels::F16(out.reinterpret_into())
    } else {
        let mut out = vec![0f32; count];
        decode(&mut |t, block| t.copy(block, &mut out, sample).ok_or_else(short))?;
        Pixels::F32(out)
    };
    Ok(ImageData { width, height, channels: slots.len() as u8, pixels })
}

/// The part to read and its channels in the order of the result.
pub(super) fn choose(path: &Path, headers: &[Header]) -> Result<(usize, Vec<usize>)> {
    let Some((part, slots)) = headers.iter().enumerate().find_map(|(i, h)| Some((i, color_channels(h)?)))
    else {
        let message = if headers.iter().all(|h| h.deep) {
            "EXR: deep pixels are not supported; a flat image is needed"
        } else {
            "EXR: no part has channels R, G, B or Y (or a single channel)"
        };
        return Err(Error::file(path, message));
    };
    if slots.iter().any(|&s| headers[part].channels.list[s].sampling != exr::math::Vec2(1, 1)) {
        let message = "EXR: subsampled channels are not supported; one sample a pixel is needed";
        return Err(Error::file(path, message));
    }
    Ok((part, slots))
}

pub(super) fn sample(b: &[u8], kind: SampleType) -> f32 {
    match kind {
        SampleType::F16 => f16::from_ne_bytes([b[0], b[1]]).to_f32(),
        SampleType::F32 => f32::from_ne_bytes([b[0], b[1], b[2], b[3]]),
        SampleType::U32 => u32::from_ne_bytes([b[0], b[1], b[2], b[3]]) as f32,
    }
}

/// Bounds what decoding this part may allocate.
fn check_header(path: &Path, h: &Header) -> Result<()> {
    let bad = |message: &str| Err(Error::file(path, format!("EXR: {message}")));
    let area = (h.layer_size.0 as u64).checked_mul(h.layer_size.1 as u64);
    let bytes = area.and_then(|a| a.checked_mul(h.channels.bytes_per_pixel.max(1) as u64));
    if bytes.is_none_or(|b| b > MAX_DECODED_BYTES) {
        let message = format!("the data window has {}×{} pixels, too many", h.layer_size.0, h.layer_size.1);
        return bad(&message);
    }
    check_blocks(path, h)
}

/// Bounds what decoding one block may allocate.
pub(super) fn check_blocks(path: &Path, h: &Header) -> Result<()> {
    if h.deep {
        return Ok(());
    }
    let block = match h.blocks {
        exr::meta::BlockDescription::Tiles(t) => (t.tile_size.0 as u64).saturating_mul(t.tile_size.1 as u64),
        exr::meta::BlockDescription::ScanLines => {
            (h.layer_size.0 as u64).saturating_mul(h.compression.scan_lines_per_block() as u64)
        }
    };
    if block.saturating_mul(h.channels.bytes_per_pixel as u64) > MAX_BLOCK_BYTES {
        return Err(Error::file(path, "EXR: a tile or block is larger than any that is read"));
    }
    Ok(())
}

/// The channels to read, in the order of the result; `None` when this part has no colour.
pub(super) fn color_channels(h: &Header) -> Option<Vec<usize>> {
    if h.deep {
        return None;
    }
    let list: &[ChannelDescription] = &h.channels.list;
    let find = |prefix: &str, name: &str| {
        list.iter().position(|c| {
            let c = c.name.to_string();
            c.strip_prefix(prefix).is_some_and(|c| c.eq_ignore_ascii_case(name))
        })
    };
    // Bare names first, then the first layer ("ViewLayer.Combined.R") that has colour.
    let mut prefixes = vec![String::new()];
    for c in list {
        let name = c.name.to_string();
        if let Some(dot) = name.rfind('.') {
            prefixes.push(name[..=dot].to_string());
        }
    }
    for p in &prefixes {
        let color = match (find(p, "R"), find(p, "G"), find(p, "B"), find(p, "Y")) {
            (Some(r), Some(g), Some(b), _) => Some(vec![r, g, b]),
            (_, _, _, Some(y)) => Some(vec![y]),
            (Some(r), None, None, None) => Some(vec![r]),
            _ => None,
        };
        if let Some(mut color) = color {
            color.extend(find(p, "A"));
            return Some(color);
        }
    }
    (list.len() == 1).then(|| vec![0])
}

/// Where blocks go.
pub(super) struct Target<'a> {
    pub(super) shift: [i64; 2],
    pub(super) size: [i64; 2],
    pub(super) header: &'a Header,
    pub(super) slots: &'a [usize],
}

impl Target<'_> {
    /// Copies the wanted channels of a block into the window; `None` when the block is too short.
    pub(super) fn copy<T>(
        &self,
        block: &UncompressedBlock,
        out: &mut [T],
        read: impl Fn(&[u8], SampleType) -> T,
    ) -> Option<()> {
        let n = self.slots.len();
        let (w, h) = (block.index.pixel_size.0, block.index.pixel_size.1);
        let list = &self.header.channels.list;
        let mut starts = Vec::with_capacity(list.len());
        let mut row_bytes = 0;
        for c in list {
            starts.push(row_bytes);
            row_bytes += w * c.sample_type.bytes_per_sample();
        }
        let x0 = self.shift[0] + block.index.pixel_position.0 as i64;
        // Columns of the block that fall into the window.
        let first = (-x0).clamp(0, w as i64);
        let last = (self.size[0] - x0).clamp(first, w as i64);
        if first == last {
            return Some(());
        }
        for y in 0..h {
            let to_y = self.shift[1] + (block.index.pixel_position.1 + y) as i64;
            if to_y < 0 || to_y >= self.size[1] {
                continue;
            }
            let row = block.data.get(y * row_bytes..(y + 1) * row_bytes)?;
            let to = (to_y * self.size[0] + x0 + first) as usize * n;
            for (k, &slot) in self.slots.iter().enumerate() {
                let kind = list[slot].sample_type;
                let size = kind.bytes_per_sample();
                let line = &row[starts[slot] + first as usize * size..starts[slot] + last as usize * size];
                for (sample, out) in line.chunks_exact(size).zip(out[to + k..].iter_mut().step_by(n)) {
                    *out = read(sample, kind);
                }
            }
        }
        Some(())
    }
}
