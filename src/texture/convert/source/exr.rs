//! EXR by rows of its blocks, whatever their order in the file: the offset table says where each is.
//! Several rows of blocks are decompressed at a time, on all threads.

use super::{BAND_BYTES, MOST_BAND_BYTES, Shape, black, cut_short, gave_up};
use crate::error::{Error, Result};
use crate::texture::contain;
use crate::texture::convert::Failure;
use crate::texture::exr_in::{Target, check_blocks, choose, sample};
use crate::texture::image_io::{MAX_SIDE, Pixels, one_line};
use crate::texture::open::open_regular;
use crate::texture::rules::Depth;
use exr::block::UncompressedBlock;
use exr::block::chunk::Chunk;
use exr::math::Vec2;
use exr::meta::attribute::SampleType;
use exr::meta::{BlockDescription, MetaData};
use half::f16;
use rayon::prelude::*;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;

/// What is to be read, and where it is.
pub(super) struct Plan {
    meta: MetaData,
    part: usize,
    slots: Vec<usize>,
    /// Width and height of the finest level's blocks.
    block: [usize; 2],
    /// Offsets of the finest level's blocks in the file, from the top.
    offsets: Vec<u64>,
    /// From the data window's pixels to the display window's.
    shift: [i64; 2],
}

/// `None`: its blocks are so large, or its header so unlikely, that it is read whole or refused there.
pub(super) fn open(path: &Path, mut file: BufReader<File>, file_bytes: u64) -> Result<Option<(Shape, Plan)>> {
    let bad = |e: exr::error::Error| Error::file(path, format!("EXR: {}", one_line(&e.to_string())));
    let meta = MetaData::read_from_buffered(&mut file, false).map_err(bad)?;
    let mut chunks = 0u64;
    for header in &meta.headers {
        chunks = chunks.saturating_add(header.chunk_count as u64);
    }
    if chunks.saturating_mul(8) > file_bytes {
        let message = format!("EXR: {chunks} chunks cannot be in {file_bytes} bytes; damaged or cut short");
        return Err(Error::file(path, message));
    }
    let (part, slots) = choose(path, &meta.headers)?;
    let header = &meta.headers[part];
    check_blocks(path, header)?;
    let window = header.shared_attributes.display_window;
    let sides = [window.size.0, window.size.1].map(|n| u32::try_from(n).unwrap_or(u32::MAX));
    let data = [header.layer_size.0, header.layer_size.1];
    if sides.iter().any(|&n| n == 0 || n > MAX_SIDE) || data.iter().any(|&n| n > MAX_SIDE as usize) {
        return Ok(None);
    }
    let half = slots.iter().all(|&s| header.channels.list[s].sample_type == SampleType::F16);
    let shape = Shape {
        width: sides[0],
        height: sides[1],
        channels: slots.len() as u8,
        depth: if half { Depth::F16 } else { Depth::F32 },
    };
    let block = match header.blocks {
        BlockDescription::Tiles(t) => [t.tile_size.0.min(data[0]), t.tile_size.1],
        BlockDescription::ScanLines => [data[0], header.compression.scan_lines_per_block()],
    };
    let band = block[1].min(data[1]) as u64
        * (shape.row_numbers() * shape.depth.bytes() + data[0] * header.channels.bytes_per_pixel) as u64;
    if block.contains(&0) || band > MOST_BAND_BYTES {
        return Ok(None);
    }
    // The finest level's blocks come first in their part's table, whose rows are from the top.
    let tile = match header.blocks {
        BlockDescription::Tiles(t) => t.tile_size.0,
        BlockDescription::ScanLines => data[0],
    };
    let count = data[0].div_ceil(tile) * data[1].div_ceil(block[1]);
    let before: usize = meta.headers[..part].iter().map(|h| h.chunk_count).sum();
    let io = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::UnexpectedEof => cut_short(path),
        _ => Error::io(path, e),
    };
    if count > header.chunk_count {
        return Ok(None);
    }
    file.seek_relative(before as i64 * 8).map_err(io)?;
    let mut bytes = vec![0; count * 8];
    file.read_exact(&mut bytes).map_err(io)?;
    let offsets = bytes.as_chunks().0.iter().map(|b| u64::from_le_bytes(*b)).collect();
    let layer = header.own_attributes.layer_position;
    let shift = [
        i64::from(layer.0) - i64::from(window.position.0),
        i64::from(layer.1) - i64::from(window.position.1),
    ];
    Ok(Some((shape, Plan { block: [tile, block[1]], meta, part, slots, offsets, shift })))
}

impl Plan {
    pub(super) fn read(
        &self,
        path: &Path,
        shape: &Shape,
        take: &mut dyn FnMut(&Pixels) -> std::result::Result<(), Failure>,
    ) -> std::result::Result<(), Failure> {
        let header = &self.meta.headers[self.part];
        let (data_width, data_height) = (header.layer_size.0, header.layer_size.1 as i64);
        let across = data_width.div_ceil(self.block[0]);
        let height = i64::from(shape.height);
        let row_bytes = shape.row_numbers() * shape.depth.bytes();
        let rows = self.block[1] as i64;
        // Enough blocks for all threads, in no more than a band's bytes.
        let group = (BAND_BYTES / (row_bytes * rows as usize)).clamp(1, 64) as i64;
        let mut file = BufReader::with_capacity(1 << 16, open_regular(path)?);
        // The part of the display window that the data window covers, and what is black around it.
        let top = self.shift[1].clamp(0, height);
        let bottom = (self.shift[1] + data_height).clamp(top, height);
        blank(shape, 0..top, take)?;
        let mut y = top;
        while y < bottom {
            let first = (y - self.shift[1]) / rows;
            let last = (first + group).min(data_height.div_euclid(rows) + 1);
            let end = (self.shift[1] + last * rows).min(bottom);
            let wanted = (first as usize * across)..((last as usize * across).min(self.offsets.len()));
            let chunks = self.chunks(path, &mut file, wanted)?;
            let blocks: Vec<_> = chunks
                .into_par_iter()
                .map(|chunk| {
                    contain::panics(|| UncompressedBlock::decompress_chunk(chunk, &self.meta, false))
                })
                .collect();
            let mut band = black(shape.depth, shape.row_numbers() * (end - y) as usize);
            let target = Target {
                shift: [self.shift[0], self.shift[1] - y],
                size: [i64::from(shape.width), end - y],
                header,
                slots: &self.slots,
            };
            for block in blocks {
                let block = block.ok_or_else(|| gave_up(path))?.map_err(|e| bad(path, &e))?;
                let place = block.index.pixel_position.1 as i64 / rows;
                if block.index.layer != self.part
                    || block.index.level != Vec2(0, 0)
                    || !(first..last).contains(&place)
                {
                    return Err(damaged(path, "its offset table names the wrong blocks").into());
                }
                let copied = match &mut band {
                    Pixels::F16(v) => {
                        target.copy(&block, v, |b, _| f16::from_bits(u16::from_ne_bytes([b[0], b[1]])))
                    }
                    Pixels::F32(v) => target.copy(&block, v, sample),
                    Pixels::U8(_) | Pixels::U16(_) => None,
                };
                copied.ok_or_else(|| damaged(path, "a block is smaller than its pixels"))?;
            }
            take(&band)?;
            y = end;
        }
        blank(shape, bottom..height, take)
    }

    fn chunks(&self, path: &Path, file: &mut BufReader<File>, wanted: Range<usize>) -> Result<Vec<Chunk>> {
        let mut position = file.stream_position().map_err(|e| Error::io(path, e))?;
        let mut chunks = Vec::with_capacity(wanted.len());
        for &offset in &self.offsets[wanted] {
            if offset != position {
                file.seek(SeekFrom::Start(offset)).map_err(|e| Error::io(path, e))?;
            }
            let chunk = contain::panics(|| Chunk::read(file, &self.meta));
            chunks.push(chunk.ok_or_else(|| gave_up(path))?.map_err(|e| bad(path, &e))?);
            position = file.stream_position().map_err(|e| Error::io(path, e))?;
        }
        Ok(chunks)
    }
}

fn bad(path: &Path, e: &exr::error::Error) -> Error {
    Error::file(path, format!("EXR: {}", one_line(&e.to_string())))
}

fn damaged(path: &Path, what: &str) -> Error {
    Error::file(path, format!("EXR: {what}; damaged"))
}

/// Black rows.
fn blank(
    shape: &Shape,
    rows: Range<i64>,
    take: &mut dyn FnMut(&Pixels) -> std::result::Result<(), Failure>,
) -> std::result::Result<(), Failure> {
    let mut left = rows.end - rows.start;
    while left > 0 {
        let now = left.min(i64::from(shape.band_rows()));
        take(&black(shape.depth, shape.row_numbers() * now as usize))?;
        left -= now;
    }
    Ok(())
}
