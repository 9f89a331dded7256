//! TIFF by rows of its strips or tiles: grey or RGB, with alpha or without, interleaved; 8 and 16 bits,
//! half and float. Whatever else `read_image` knows is read whole.

use super::{Decode, Give, MOST_BAND_BYTES, Shape, black, check_sides, cut_short, empty};
use crate::error::{Error, Result};
use crate::texture::image_io::{Pixels, one_line};
use crate::texture::open::open_regular;
use crate::texture::rules::Depth;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;
use tiff::{ColorType, TiffError};

/// Sizes of the file's strips or tiles.
struct Chunks {
    width: u32,
    height: u32,
}

pub(super) fn open(path: &Path, file: BufReader<File>) -> Result<Option<(Shape, Box<dyn Decode>)>> {
    // What this cannot open may still be one that is read whole, or is refused there.
    let Ok(mut decoder) = decoder(path, file) else { return Ok(None) };
    let Some(shape) = shape(&mut decoder) else { return Ok(None) };
    let (width, height) = decoder.chunk_dimensions();
    let chunks = Chunks { width, height: height.min(shape.height) };
    let band = u64::from(chunks.height) * (shape.row_numbers() * shape.depth.bytes()) as u64;
    let tile = u64::from(width) * u64::from(height) * shape.channels as u64 * shape.depth.bytes() as u64;
    if width == 0 || height == 0 || band > MOST_BAND_BYTES || tile > MOST_BAND_BYTES {
        return Ok(None);
    }
    check_sides(path, shape.width, shape.height)?;
    Ok(Some((shape, Box::new(chunks))))
}

fn decoder(path: &Path, file: BufReader<File>) -> Result<Decoder<BufReader<File>>> {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MOST_BAND_BYTES as usize;
    limits.intermediate_buffer_size = MOST_BAND_BYTES as usize;
    limits.ifd_value_size = MOST_BAND_BYTES as usize;
    Ok(Decoder::new(file).map_err(|e| bad(path, e))?.with_limits(limits))
}

fn bad(path: &Path, e: TiffError) -> Error {
    match e {
        TiffError::IoError(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => cut_short(path),
        TiffError::IoError(e) => Error::io(path, e),
        e => Error::file(path, one_line(&e.to_string())),
    }
}

/// `None` for what is read whole.
fn shape(decoder: &mut Decoder<BufReader<File>>) -> Option<Shape> {
    let (width, height) = decoder.dimensions().ok()?;
    let planar: Option<u16> = decoder.find_tag_unsigned(Tag::PlanarConfiguration).ok()?;
    if planar.is_some_and(|p| p != 1) {
        return None;
    }
    let formats: Option<Vec<u16>> = decoder.find_tag_unsigned_vec(Tag::SampleFormat).ok()?;
    let formats = formats.unwrap_or_else(|| vec![1]);
    let format = *formats.first()?;
    if formats.iter().any(|&f| f != format) {
        return None;
    }
    let (channels, bits) = match decoder.colortype().ok()? {
        ColorType::Gray(bits) => (1, bits),
        ColorType::GrayA(bits) => (2, bits),
        ColorType::RGB(bits) => (3, bits),
        ColorType::RGBA(bits) => (4, bits),
        _ => return None,
    };
    let depth = match (format, bits) {
        (1, 8) => Depth::U8,
        (1, 16) => Depth::U16,
        (3, 16) => Depth::F16,
        (3, 32) => Depth::F32,
        _ => return None,
    };
    (width > 0 && height > 0).then_some(Shape { width, height, channels, depth })
}

impl Decode for Chunks {
    fn decode(&self, path: &Path, shape: &Shape, give: Give<'_>) -> Result<()> {
        let file = open_regular(path)?;
        let mut decoder = decoder(path, BufReader::with_capacity(1 << 16, file))?;
        let across = shape.width.div_ceil(self.width);
        let n = shape.channels as usize;
        for row in 0..shape.height.div_ceil(self.height) {
            let rows = self.height.min(shape.height - row * self.height) as usize;
            let row_numbers = shape.row_numbers();
            let mut band = if across > 1 {
                black(shape.depth, row_numbers * rows)
            } else {
                empty(shape.depth, row_numbers * rows)
            };
            for x in 0..across {
                let part = decoder.read_chunk(row * across + x).map_err(|e| bad(path, e))?;
                let first = (x * self.width) as usize * n;
                let numbers = (self.width as usize * n).min(row_numbers - first);
                if !place(&mut band, &part, row_numbers, first, numbers, rows) {
                    return Err(Error::file(path, "a strip or tile is smaller than its pixels; damaged"));
                }
            }
            if !give(band) {
                return Ok(());
            }
        }
        Ok(())
    }
}

/// Puts a chunk's rows of `numbers` into the band's rows of `row_numbers` at `first`; false when the
/// chunk is short or of another kind.
fn place(
    band: &mut Pixels,
    part: &DecodingResult,
    row_numbers: usize,
    first: usize,
    numbers: usize,
    rows: usize,
) -> bool {
    fn copy<T: Copy>(to: &mut Vec<T>, from: &[T], at: [usize; 4]) -> bool {
        let [row_numbers, first, numbers, rows] = at;
        if from.len() < numbers * rows {
            return false;
        }
        if numbers == row_numbers {
            to.clear();
            to.extend_from_slice(&from[..numbers * rows]);
            return true;
        }
        for (to, from) in to.chunks_exact_mut(row_numbers).zip(from.chunks_exact(numbers)) {
            to[first..first + numbers].copy_from_slice(from);
        }
        true
    }
    let at = [row_numbers, first, numbers, rows];
    match (band, part) {
        (Pixels::U8(to), DecodingResult::U8(from)) => copy(to, from, at),
        (Pixels::U16(to), DecodingResult::U16(from)) => copy(to, from, at),
        (Pixels::F16(to), DecodingResult::F16(from)) => copy(to, from, at),
        (Pixels::F32(to), DecodingResult::F32(from)) => copy(to, from, at),
        _ => false,
    }
}
