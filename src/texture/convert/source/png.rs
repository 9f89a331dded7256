//! PNG row by row, without interlacing; palettes and fewer than 8 bits become 8-bit numbers, as in
//! `read_image`.

use super::{Decode, Give, Shape, append, check_sides, cut_short, empty};
use crate::error::{Error, Result};
use crate::texture::image_io::{MAX_DEFLATE_RATIO, one_line};
use crate::texture::open::open_regular;
use crate::texture::rules::Depth;
use png::{BitDepth, ColorType, Decoder, DecodingError, Limits, Reader, Transformations};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// What the decoder may take beside a row: profiles and texts.
const LIMIT_BYTES: usize = 64 << 20;

struct Rows;

pub(super) fn open(
    path: &Path,
    file: BufReader<File>,
    file_bytes: u64,
) -> Result<Option<(Shape, Box<dyn Decode>)>> {
    let reader = reader(path, file)?;
    let info = reader.info();
    let (width, height) = info.size();
    check_sides(path, width, height)?;
    if info.interlaced {
        return Ok(None);
    }
    let bits = info.bits_per_pixel() as u64;
    if u64::from(width) * u64::from(height) * bits / 8 / MAX_DEFLATE_RATIO > file_bytes {
        let message = format!("{width}×{height} pixels cannot be in {file_bytes} bytes; damaged");
        return Err(Error::file(path, message));
    }
    let (color, bits) = reader.output_color_type();
    let channels = match color {
        ColorType::Grayscale => 1,
        ColorType::GrayscaleAlpha => 2,
        ColorType::Rgb => 3,
        ColorType::Rgba => 4,
        // Never after expansion; whoever reads it whole will say so.
        ColorType::Indexed => return Ok(None),
    };
    let depth = match bits {
        BitDepth::Eight => Depth::U8,
        BitDepth::Sixteen => Depth::U16,
        _ => return Ok(None),
    };
    Ok(Some((Shape { width, height, channels, depth }, Box::new(Rows))))
}

fn reader(path: &Path, file: BufReader<File>) -> Result<Reader<BufReader<File>>> {
    let mut decoder = Decoder::new_with_limits(file, Limits { bytes: LIMIT_BYTES });
    decoder.set_transformations(Transformations::EXPAND);
    decoder.read_info().map_err(|e| bad(path, e))
}

fn bad(path: &Path, e: DecodingError) -> Error {
    match e {
        DecodingError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => cut_short(path),
        DecodingError::IoError(e) => Error::io(path, e),
        e => Error::file(path, one_line(&e.to_string())),
    }
}

impl Decode for Rows {
    fn decode(&self, path: &Path, shape: &Shape, give: Give<'_>) -> Result<()> {
        let file = open_regular(path)?;
        let mut reader = reader(path, BufReader::with_capacity(1 << 18, file))?;
        let row_bytes = shape.row_numbers() * shape.depth.bytes();
        if reader.output_line_size(shape.width) != Some(row_bytes) {
            return Err(Error::file(path, "the file changed while it was read"));
        }
        let mut row = vec![0; row_bytes];
        let mut left = shape.height;
        while left > 0 {
            let rows = left.min(shape.band_rows());
            let mut pixels = empty(shape.depth, shape.row_numbers() * rows as usize);
            for _ in 0..rows {
                if reader.read_row(&mut row).map_err(|e| bad(path, e))?.is_none() {
                    return Err(cut_short(path));
                }
                if shape.depth == Depth::U16 {
                    row.as_chunks_mut().0.iter_mut().for_each(|b| *b = u16::from_be_bytes(*b).to_ne_bytes());
                }
                append(&mut pixels, &row);
            }
            if !give(pixels) {
                return Ok(());
            }
            left -= rows;
        }
        // The checksum that follows the last row.
        reader.read_row(&mut row).map(|_| ()).map_err(|e| bad(path, e))
    }
}
