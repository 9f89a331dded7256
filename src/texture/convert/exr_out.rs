//! Tiled, mip-mapped EXR, halves or floats, sizes rounded down, tile by tile as they come (OpenEXR,
//! "Technical Introduction": the offset table names every tile, so their order is free).
//!
//! Invariant: at most one row of tiles is held. Never writes 8-bit numbers: EXR has none.

use super::{Compression, Failure, TILE, TileRow, TileSink, WrapMode};
use crate::texture::pyramid;
use exr::block::UncompressedBlock;
use exr::block::chunk::Chunk;
use exr::block::writer::{ChunkWriter, ChunksWriter};
use exr::math::RoundingMode;
use exr::meta::BlockDescription;
use exr::meta::attribute::{
    AttributeValue, ChannelDescription, Chromaticities, LevelMode, LineOrder, SampleType, Text,
    TileDescription,
};
use exr::meta::header::Header;
use exr::prelude::Vec2;
use rayon::prelude::*;
use std::io::{self, Seek, SeekFrom, Write};

/// What the header says.
pub(super) struct Layout {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Numbers kept of each texel: 1, 3 or 4.
    pub(super) channels: u8,
    /// Floats, otherwise halves.
    pub(super) float: bool,
    pub(super) compression: Compression,
    pub(super) wrap: WrapMode,
    pub(super) description: String,
}

/// Writes a file whose tiles `stream` hands to its sink; returns its length.
pub(super) fn write<W: Write + Seek>(
    out: &mut W,
    layout: &Layout,
    stream: &mut dyn FnMut(&mut dyn TileSink) -> Result<(), Failure>,
) -> Result<u64, Failure> {
    let headers: exr::meta::Headers = std::iter::once(header(layout)).collect();
    let mut first_tile = vec![0];
    for (w, h) in pyramid::sizes(layout.width, layout.height) {
        let tiles = w.div_ceil(TILE) as usize * h.div_ceil(TILE) as usize;
        first_tile.push(first_tile[first_tile.len() - 1] + tiles);
    }
    let mut failure = None;
    let written = exr::block::write(&mut *out, headers, false, |meta, chunks| {
        let mut sink = ExrSink { chunks, headers: &meta.headers, layout, first_tile: &first_tile };
        stream(&mut sink).map_err(|f| {
            failure = Some(f);
            exr::error::Error::Aborted
        })
    });
    match (failure, written) {
        (Some(failure), _) => Err(failure),
        (None, Err(e)) => Err(Failure::Write(plain(e))),
        (None, Ok(())) => Ok(out.seek(SeekFrom::End(0))?),
    }
}

fn plain(e: exr::error::Error) -> io::Error {
    match e {
        exr::error::Error::Io(e) => e,
        other => io::Error::other(other.to_string()),
    }
}

/// Where each channel of the file, in the alphabetical order that EXR wants, stands in a texel.
fn channels(n: u8) -> &'static [(&'static str, usize)] {
    match n {
        1 => &[("Y", 0)],
        3 => &[("B", 2), ("G", 1), ("R", 0)],
        _ => &[("A", 3), ("B", 2), ("G", 1), ("R", 0)],
    }
}

fn header(layout: &Layout) -> Header {
    let kind = if layout.float { SampleType::F32 } else { SampleType::F16 };
    let list = channels(layout.channels).iter().map(|(name, _)| ChannelDescription::named(*name, kind));
    let size = (layout.width as usize, layout.height as usize);
    let tiles = TileDescription {
        tile_size: Vec2(TILE as usize, TILE as usize),
        level_mode: LevelMode::MipMap,
        rounding_mode: RoundingMode::Down,
    };
    let compression = match layout.compression {
        Compression::None => exr::compression::Compression::Uncompressed,
        Compression::Zip => exr::compression::Compression::ZIP16,
    };
    let mut header = Header::new(Text::new_or_panic("texture"), size, list.collect()).with_encoding(
        compression,
        BlockDescription::Tiles(tiles),
        LineOrder::Unspecified,
    );
    // A name is for files of several parts.
    header.own_attributes.layer_name = None;
    header.own_attributes.wrap_mode_name = Some(Text::new_or_panic(format!("{0},{0}", layout.wrap.name())));
    header.own_attributes.software_name =
        Some(Text::new_or_panic(concat!("weir ", env!("CARGO_PKG_VERSION"))));
    header.own_attributes.comments = Some(Text::new_or_panic(&layout.description));
    header.own_attributes.other.insert(
        Text::new_or_panic("textureformat"),
        AttributeValue::Text(Text::new_or_panic("Plain Texture")),
    );
    // What Weir's linear colour is: Rec. 709 under D65.
    header.shared_attributes.chromaticities = Some(Chromaticities {
        red: Vec2(0.64, 0.33),
        green: Vec2(0.3, 0.6),
        blue: Vec2(0.15, 0.06),
        white: Vec2(0.3127, 0.329),
    });
    header
}

struct ExrSink<'a, W: Write + Seek> {
    chunks: &'a mut ChunkWriter<W>,
    headers: &'a [Header],
    layout: &'a Layout,
    /// Number of each level's first tile among all, as the offset table counts.
    first_tile: &'a [usize],
}

impl<W: Write + Seek> TileSink for ExrSink<'_, W> {
    fn tile_row(&mut self, level: usize, row: u32, texels: &TileRow<'_>) -> io::Result<()> {
        let across = texels.width.div_ceil(TILE);
        let (headers, layout) = (self.headers, self.layout);
        let tiles: Vec<exr::error::Result<Chunk>> = (0..across)
            .into_par_iter()
            .map(|x| block(layout, level, (x, row), texels).compress_to_chunk(headers))
            .collect();
        let first = self.first_tile[level] + (row * across) as usize;
        for (i, tile) in tiles.into_iter().enumerate() {
            tile.and_then(|tile| self.chunks.write_chunk(first + i, tile)).map_err(plain)?;
        }
        Ok(())
    }
}

/// One tile: for each of its rows, each channel's numbers together.
fn block(layout: &Layout, level: usize, (x, y): (u32, u32), texels: &TileRow<'_>) -> UncompressedBlock {
    let sample = if layout.float { 4 } else { 2 };
    let side = TILE as usize;
    let (left, top) = (x as usize * side, y as usize * side);
    let size = Vec2((texels.width as usize - left).min(side), texels.height());
    let mut data = Vec::with_capacity(size.0 * size.1 * layout.channels as usize * sample);
    for row in texels.rows(x) {
        for (_, slot) in channels(layout.channels) {
            let numbers = row.chunks_exact(texels.stride);
            numbers.for_each(|texel| data.extend_from_slice(&texel[slot * sample..][..sample]));
        }
    }
    let index = exr::block::BlockIndex {
        layer: 0,
        pixel_position: Vec2(left, top),
        pixel_size: size,
        level: Vec2(level, level),
    };
    UncompressedBlock { index, data }
}
