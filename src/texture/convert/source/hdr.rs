//! Radiance HDR scan line by scan line (Ward, "Real Pixels", Graphics Gems II), both ways of coding
//! runs. The header is left to `image`, so that what it refuses is refused here too.

use super::{Decode, Give, Shape, check_sides, cut_short};
use crate::error::{Error, Result};
use crate::texture::image_io::{Pixels, one_line};
use crate::texture::open::open_regular;
use crate::texture::rules::Depth;
use image::codecs::hdr::HdrDecoder;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

struct ScanLines;

/// `None`: not one that `image` reads either, which will say so.
pub(super) fn open(file: BufReader<File>) -> Option<(Shape, Box<dyn Decode>)> {
    let header = HdrDecoder::new(file).ok()?.metadata();
    let (width, height) = (header.width, header.height);
    check_sides(Path::new(""), width, height).ok()?;
    Some((Shape { width, height, channels: 3, depth: Depth::F32 }, Box::new(ScanLines)))
}

impl Decode for ScanLines {
    fn decode(&self, path: &Path, shape: &Shape, give: Give<'_>) -> Result<()> {
        let file = open_regular(path)?;
        let mut file = BufReader::with_capacity(1 << 18, file);
        // Leaves the file where the pixels begin.
        let header = HdrDecoder::new(&mut file);
        let header = header.map_err(|e| Error::file(path, one_line(&e.to_string())))?.metadata();
        if (header.width, header.height) != (shape.width, shape.height) {
            return Err(Error::file(path, "the file changed while it was read"));
        }
        let mut line = vec![[0; 4]; shape.width as usize];
        let mut left = shape.height;
        while left > 0 {
            let rows = left.min(shape.band_rows());
            left -= rows;
            let mut pixels = Vec::with_capacity(rows as usize * shape.row_numbers());
            for _ in 0..rows {
                scan_line(&mut file, &mut line).map_err(|e| match e.kind() {
                    io::ErrorKind::UnexpectedEof => cut_short(path),
                    io::ErrorKind::InvalidData => Error::file(path, e.to_string()),
                    _ => Error::io(path, e),
                })?;
                pixels.extend(line.iter().flat_map(|&rgbe| linear(rgbe)));
            }
            if !give(Pixels::F32(pixels)) {
                return Ok(());
            }
        }
        Ok(())
    }
}

/// Mantissas of 8 bits and a common exponent: c·2^(e−136).
fn linear([r, g, b, e]: [u8; 4]) -> [f32; 3] {
    // 2^(e−128) is below the normal floats for e = 1, and an exponent of 0 is black.
    let power = if e > 1 { u32::from(e - 1) << 23 } else { u32::from(e) << 22 };
    let scale = f32::from_bits(power) * (1.0 / 256.0);
    [r, g, b].map(|c| scale * f32::from(c))
}

fn damaged(what: &'static str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

fn scan_line(file: &mut impl Read, line: &mut [[u8; 4]]) -> io::Result<()> {
    let mut first = [0; 4];
    file.read_exact(&mut first)?;
    if first[0] == 2 && first[1] == 2 && first[2] < 128 {
        (0..4).try_for_each(|channel| runs(file, line, channel))
    } else {
        old_runs(file, first, line)
    }
}

/// One channel of a line: literals of up to 128 numbers, and runs.
fn runs(file: &mut impl Read, line: &mut [[u8; 4]], channel: usize) -> io::Result<()> {
    const TOO_LONG: &str = "a run of pixels is longer than its line; damaged";
    let mut rest = line;
    let mut literals = [0; 128];
    while !rest.is_empty() {
        let mut byte = [0];
        file.read_exact(&mut byte)?;
        let (count, literal) = if byte[0] > 128 { (byte[0] - 128, false) } else { (byte[0], true) };
        let (now, later) = rest.split_at_mut_checked(count as usize).ok_or_else(|| damaged(TOO_LONG))?;
        if literal {
            let literals = &mut literals[..count as usize];
            file.read_exact(literals)?;
            now.iter_mut().zip(literals).for_each(|(pixel, value)| pixel[channel] = *value);
        } else {
            file.read_exact(&mut byte)?;
            now.iter_mut().for_each(|pixel| pixel[channel] = byte[0]);
        }
        rest = later;
    }
    Ok(())
}

/// Whole pixels; one of 1, 1, 1, n repeats the last one, and such repeats in a row count in base 256.
fn old_runs(file: &mut impl Read, first: [u8; 4], line: &mut [[u8; 4]]) -> io::Result<()> {
    if first[..3] == [1, 1, 1] {
        return Err(damaged("a line of pixels begins with a repeat; damaged"));
    }
    line[0] = first;
    let (mut x, mut place, mut last) = (1, 1usize, first);
    while x < line.len() {
        let mut pixel = [0; 4];
        file.read_exact(&mut pixel)?;
        let count = if pixel[..3] == [1, 1, 1] {
            let count = usize::from(pixel[3]).saturating_mul(place);
            place = place.saturating_mul(256);
            count
        } else {
            place = 1;
            last = pixel;
            1
        };
        let end = x.saturating_add(count);
        let run = line.get_mut(x..end);
        run.ok_or_else(|| damaged("a run of pixels is longer than its line; damaged"))?.fill(last);
        x = end;
    }
    Ok(())
}
