//! Portable float maps, grey and colour, both byte orders, rows from the bottom up
//! (Debevec's PFM). The counts of the header are held against the file before any allocation.

use super::image_io::{ImageData, Pixels, check_size};
use crate::error::{Error, Result};
use std::path::Path;

/// What stands before the pixels.
pub(super) struct Header {
    pub(super) width: u32,
    pub(super) height: u32,
    /// 1 or 3.
    pub(super) channels: usize,
    /// Negative for little-endian numbers.
    scale: f32,
    /// Where the pixels begin.
    pub(super) start: usize,
}

fn bad(path: &Path, message: &str) -> Error {
    Error::file(path, format!("not a whole PFM image: {message}"))
}

/// Reads the header at the beginning of `bytes`.
pub(super) fn header(path: &Path, bytes: &[u8]) -> Result<Header> {
    let bad = |message: &str| Err(bad(path, message));
    let mut at = 0;
    let mut word = || {
        let blank = bytes[at..].iter().take_while(|b| b.is_ascii_whitespace()).count();
        let start = at + blank;
        let len = bytes[start..].iter().take(64).take_while(|b| !b.is_ascii_whitespace()).count();
        at = start + len;
        (std::str::from_utf8(&bytes[start..at]).unwrap_or(""), at)
    };
    let channels = match word().0 {
        "PF" => 3,
        "Pf" => 1,
        _ => return bad("it does not begin with PF or Pf"),
    };
    let (Ok(width), Ok(height)) = (word().0.parse::<u32>(), word().0.parse::<u32>()) else {
        return bad("width and height are needed after PF");
    };
    let (scale, end) = word();
    let Some(scale) = scale.parse::<f32>().ok().filter(|s| s.is_finite() && *s != 0.0) else {
        return bad("a scale that is not zero is needed after the size");
    };
    // One blank ends the header; what follows it may look like blanks.
    Ok(Header { width, height, channels, scale, start: end + 1 })
}

impl Header {
    /// Refuses a file of `file_bytes` that is too short for the pixels.
    pub(super) fn check_length(&self, path: &Path, file_bytes: u64) -> Result<()> {
        let pixels = u64::from(self.width) * u64::from(self.height);
        let needed = pixels.saturating_mul(self.channels as u64 * 4);
        let there = file_bytes.saturating_sub(self.start as u64);
        if there < needed {
            return Err(bad(path, &format!("{there} bytes of pixels, {needed} needed")));
        }
        Ok(())
    }

    /// The numbers in the bytes of one row.
    pub(super) fn numbers(&self, line: &[u8]) -> impl Iterator<Item = f32> {
        let (factor, little) = (self.scale.abs(), self.scale < 0.0);
        line.chunks_exact(4).map(move |b| {
            let b = [b[0], b[1], b[2], b[3]];
            factor * if little { f32::from_le_bytes(b) } else { f32::from_be_bytes(b) }
        })
    }
}

/// Reads a whole PFM file that has been loaded as `bytes`.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<ImageData> {
    let header = header(path, bytes)?;
    let Header { width, height, channels, start, .. } = header;
    check_size(path, width, height, channels * 4)?;
    header.check_length(path, bytes.len() as u64)?;
    let row = width as usize * channels;
    let mut pixels = Vec::with_capacity(row * height as usize);
    for line in bytes[start..].chunks_exact(row * 4).take(height as usize).rev() {
        pixels.extend(header.numbers(line));
    }
    Ok(ImageData { width, height, channels: channels as u8, pixels: Pixels::F32(pixels) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str, values: &[f32], little: bool) -> Vec<u8> {
        let mut f = header.as_bytes().to_vec();
        for v in values {
            f.extend(if little { v.to_le_bytes() } else { v.to_be_bytes() });
        }
        f
    }

    #[test]
    fn both_orders_and_kinds_come_out_top_row_first() {
        let grey = [1.0, 2.0, 3.0, 4.0];
        for (header, little) in [("Pf\n2 2\n-1.0\n", true), ("Pf 2 2 1\n", false)] {
            let image = read(Path::new("a.pfm"), &file(header, &grey, little)).expect("valid");
            assert_eq!((image.width, image.height, image.channels), (2, 2, 1));
            assert_eq!(image.pixels, Pixels::F32(vec![3.0, 4.0, 1.0, 2.0]));
        }
        let image = read(Path::new("a.pfm"), &file("PF\n1 1\n-2\n", &[1., 2., 3.], true)).expect("valid");
        assert_eq!(image.pixels, Pixels::F32(vec![2., 4., 6.]));
    }

    #[test]
    fn damage_is_one_error() {
        for (header, n) in [
            ("", 0),
            ("PF", 0),
            ("PG\n1 1\n-1\n", 3),
            ("PF\n1 1\n0\n", 3),
            ("PF\n1 1\n-1\n", 2),
            ("PF\n4000000000 4000000000\n-1\n", 2),
            ("PF\n0 1\n-1\n", 2),
            ("PF\n-1 1\n-1\n", 3),
        ] {
            let e = read(Path::new("a.pfm"), &file(header, &vec![0.0; n], true)).expect_err(header);
            assert!(!e.to_string().contains('\n'));
        }
    }
}
