//! Image files into pixels as they are stored: PNG, JPEG, TGA, BMP, TIFF and HDR through `image`,
//! EXR through `exr`, PFM by ourselves. The kind follows from the bytes, the extension only helps
//! where a format has no signature (TGA).
//!
//! Invariant: an image is refused before it is decoded when its pixels would take more than
//! [`MAX_DECODED_BYTES`]; decoders may use about as much again while they run. Never applies a
//! transfer curve.

use super::encoding;
use super::open::open_regular;
use super::texels::Memory;
use super::{contain, convert, exr_in, pfm, pyramid};
use crate::error::{Error, Result};
use crate::scene::Encoding;
use half::f16;
use image::{ColorType, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits};
use rayon::prelude::*;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

/// Most bytes that one decoded image may take: 4 GiB.
pub const MAX_DECODED_BYTES: u64 = 4 << 30;
/// Most pixels along a side.
pub const MAX_SIDE: u32 = 1 << 17;
/// Deflate expands at most 1032-fold; a PNG that claims more pixels is damaged or hostile.
pub(super) const MAX_DEFLATE_RATIO: u64 = 1032;

/// Numbers as the file stores them.
#[derive(Clone, Debug, PartialEq)]
pub enum Pixels {
    /// 8-bit, encoded.
    U8(Vec<u8>),
    /// 16-bit, encoded.
    U16(Vec<u16>),
    /// Half floats, linear.
    F16(Vec<f16>),
    /// Floats, linear.
    F32(Vec<f32>),
}

/// A decoded image: rows from the top, channels interleaved.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageData {
    /// Pixels a row, at least 1.
    pub width: u32,
    /// Rows, at least 1.
    pub height: u32,
    /// 1 grey, 2 grey and alpha, 3 RGB, 4 RGBA.
    pub channels: u8,
    /// width × height × channels numbers.
    pub pixels: Pixels,
}

impl ImageData {
    /// Whether the last channel is opacity.
    #[must_use]
    pub fn has_alpha(&self) -> bool {
        self.channels == 2 || self.channels == 4
    }

    /// Linear RGB of every pixel, rows from the top, alpha dropped. `encoding` concerns integer
    /// images only.
    #[must_use]
    pub fn linear_rgb(&self, encoding: Encoding) -> Vec<[f32; 3]> {
        let n = self.channels as usize;
        fn pick<T: Copy + Sync>(v: &[T], n: usize, f: impl Fn(T) -> f32 + Sync) -> Vec<[f32; 3]> {
            let (g, b) = if n < 3 { (0, 0) } else { (1, 2) };
            v.par_chunks_exact(n).map(|p| [f(p[0]), f(p[g]), f(p[b])]).collect()
        }
        match &self.pixels {
            Pixels::U8(v) => {
                let table = encoding::table8(encoding);
                pick(v, n, |x| table[x as usize])
            }
            Pixels::U16(v) => {
                let table = encoding::table16(encoding);
                pick(v, n, |x| table[x as usize])
            }
            Pixels::F16(v) => pick(v, n, f16::to_f32),
            Pixels::F32(v) => pick(v, n, |x| x),
        }
    }
}

/// Refuses an image that is empty, too wide, or too large for its bytes a pixel.
pub(super) fn check_size(path: &Path, width: u32, height: u32, pixel_bytes: usize) -> Result<()> {
    if width == 0 || height == 0 {
        return Err(Error::file(path, format!("an image of {width}×{height} pixels")));
    }
    let bytes = (u64::from(width) * u64::from(height)).saturating_mul(pixel_bytes as u64);
    if width.max(height) > MAX_SIDE || bytes > MAX_DECODED_BYTES {
        return Err(Error::file(
            path,
            format!(
                "an image of {width}×{height} pixels, {bytes} bytes decoded; at most {MAX_SIDE} a side and \
                 {MAX_DECODED_BYTES} bytes are read"
            ),
        ));
    }
    Ok(())
}

/// What an image's texels are at most: in doubt the larger of two kinds.
pub(super) struct Kept {
    pub(super) width: u32,
    pub(super) height: u32,
    /// One number a texel; else four.
    pub(super) grey: bool,
    /// Bytes of a number.
    pub(super) number: u64,
}

impl Kept {
    /// Bytes of a texel.
    pub(super) fn texel_bytes(&self) -> u64 {
        if self.grey { self.number } else { 4 * self.number }
    }

    pub(super) fn bytes(&self, mip_levels: bool) -> u64 {
        if self.width.min(self.height) == 0 {
            return 0;
        }
        let mut sizes = pyramid::sizes(self.width, self.height);
        if !mip_levels {
            sizes.truncate(1);
        }
        // Grey texels stand in blocks of 8×8 or less, others in 4×4.
        Memory::taken(&sizes, if self.grey { 3 } else { 2 }, self.texel_bytes())
    }
}

/// Bytes that the image's texels will take in memory, from its header alone; more rather than less.
/// What decoders need while they run is not in it.
///
/// # Errors
/// As [`read_image`], for what the header shows.
#[cfg(test)]
pub(super) fn decoded_bytes(path: &Path, mip_levels: bool) -> Result<u64> {
    Ok(kept(path)?.map_or(0, |kept| kept.bytes(mip_levels)))
}

/// What the image's texels are at most, from its header alone; `None` where that is not readable.
///
/// # Errors
/// As [`read_image`], for what the header shows.
pub(super) fn kept(path: &Path) -> Result<Option<Kept>> {
    let io = |e| Error::io(path, e);
    let mut file = open_regular(path)?;
    let mut magic = Vec::with_capacity(4);
    file.by_ref().take(4).read_to_end(&mut magic).map_err(io)?;
    file.rewind().map_err(io)?;
    let kept = contain::panics(|| match magic[..] {
        [0x76, 0x2f, 0x31, 0x01] => exr_in::kept(path, file),
        [b'P', b'F' | b'f', b, ..] if b.is_ascii_whitespace() => {
            let mut head = Vec::new();
            file.take(1 << 16).read_to_end(&mut head).map_err(io)?;
            let kept =
                |h: pfm::Header| Kept { width: h.width, height: h.height, grey: h.channels == 1, number: 4 };
            Ok(pfm::header(path, &head).ok().map(kept))
        }
        [b'I', b'I', 42 | 43, 0] | [b'M', b'M', 0, 42 | 43] => Ok(kept_tiff(file)),
        _ => {
            let mut reader = ImageReader::new(BufReader::new(file));
            if let Ok(format) = ImageFormat::from_path(path) {
                reader.set_format(format);
            }
            let reader = reader.with_guessed_format().map_err(io)?;
            // What is wrong with it is said by whoever reads it.
            let Ok(decoder) = reader.into_decoder() else { return Ok(None) };
            let (width, height) = decoder.dimensions();
            let color = decoder.color_type();
            let number = match color {
                ColorType::L8 | ColorType::La8 | ColorType::Rgb8 | ColorType::Rgba8 => 1,
                ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16 => 2,
                _ => 4,
            };
            Ok(Some(Kept { width, height, grey: color.channel_count() == 1, number }))
        }
    });
    kept.unwrap_or(Ok(None))
}

/// `image` refuses halves and grey floats, which [`read_image`] knows.
fn kept_tiff(file: File) -> Option<Kept> {
    let mut decoder = tiff::decoder::Decoder::new(BufReader::new(file)).ok()?;
    let (width, height) = decoder.dimensions().ok()?;
    let color = decoder.colortype().ok()?;
    let number = match color.bit_depth() {
        0..=8 => 1,
        9..=16 => 2,
        _ => 4,
    };
    Some(Kept { width, height, grey: matches!(color, tiff::ColorType::Gray(_)), number })
}

/// Reads the image in `path`.
///
/// # Errors
/// [`Error::Io`] when it cannot be read; [`Error::Input`] when it is damaged, of a kind not
/// supported, or larger than [`MAX_DECODED_BYTES`].
pub fn read_image(path: &Path) -> Result<ImageData> {
    let io = |e| Error::io(path, e);
    let mut file = open_regular(path)?;
    let meta = file.metadata().map_err(io)?;
    let mut magic = Vec::with_capacity(4);
    file.by_ref().take(4).read_to_end(&mut magic).map_err(io)?;
    file.rewind().map_err(io)?;
    let decoded = contain::panics(|| match magic[..] {
        [] => Err(Error::file(path, "the file is empty; an image is needed")),
        [0x76, 0x2f, 0x31, 0x01] => exr_in::read(path, file, meta.len()),
        [b'P', b'F' | b'f', b, ..] if b.is_ascii_whitespace() => {
            if meta.len() > MAX_DECODED_BYTES {
                return Err(Error::file(path, "larger than any image that is read"));
            }
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes).map_err(io)?;
            pfm::read(path, &bytes)
        }
        [b'I' | b'M', b'I' | b'M', ..] => match convert::read_float_tiff(path)? {
            Some(data) => Ok(data),
            None => read_common(path, file, meta.len()),
        },
        _ => read_common(path, file, meta.len()),
    });
    decoded.unwrap_or_else(|| Err(Error::file(path, "damaged: its decoder gave up")))
}

fn read_common(path: &Path, file: File, file_bytes: u64) -> Result<ImageData> {
    let unsupported = "PNG, JPEG, TGA, BMP, TIFF, HDR, EXR or PFM is needed";
    let fail = |e: ImageError| match e {
        ImageError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => {
            Error::file(path, one_line(&e.to_string()))
        }
        ImageError::IoError(_) => Error::file(path, "the image is cut short"),
        ImageError::Unsupported(e) => {
            Error::file(path, format!("{}; {unsupported}", one_line(&e.to_string())))
        }
        e => Error::file(path, one_line(&e.to_string())),
    };
    let mut reader = ImageReader::new(BufReader::new(file));
    if let Ok(format) = ImageFormat::from_path(path) {
        reader.set_format(format);
    }
    let mut reader = reader.with_guessed_format().map_err(|e| Error::io(path, e))?;
    let Some(format) = reader.format() else {
        return Err(Error::file(path, format!("not an image of a known kind; {unsupported}")));
    };
    let mut limits = Limits::no_limits();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_DECODED_BYTES);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(fail)?;
    let (width, height) = decoder.dimensions();
    let color = decoder.color_type();
    check_size(path, width, height, color.bytes_per_pixel() as usize)?;
    let count = width as usize * height as usize * color.channel_count() as usize;
    if format == ImageFormat::Png && decoder.total_bytes() / 8 / MAX_DEFLATE_RATIO > file_bytes {
        // /8: a PNG may store one bit where we count a byte or more.
        let message = format!("{width}×{height} pixels cannot be in {file_bytes} bytes; damaged");
        return Err(Error::file(path, message));
    }
    let pixels = match color {
        ColorType::L8 | ColorType::La8 | ColorType::Rgb8 | ColorType::Rgba8 => {
            let mut v = vec![0u8; count];
            decoder.read_image(&mut v).map_err(fail)?;
            Pixels::U8(v)
        }
        ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16 => {
            let mut v = vec![0u16; count];
            decoder.read_image(bytemuck::cast_slice_mut(&mut v)).map_err(fail)?;
            Pixels::U16(v)
        }
        ColorType::Rgb32F | ColorType::Rgba32F => {
            let mut v = vec![0f32; count];
            decoder.read_image(bytemuck::cast_slice_mut(&mut v)).map_err(fail)?;
            Pixels::F32(v)
        }
        other => return Err(Error::file(path, format!("pixels of kind {other:?} are not supported"))),
    };
    Ok(ImageData { width, height, channels: color.channel_count(), pixels })
}

/// Decoders' messages may span lines or quote the file.
pub(super) fn one_line(message: &str) -> String {
    let mut line: String = message.chars().take(200).map(|c| if c.is_control() { ' ' } else { c }).collect();
    line.truncate(line.trim_end().len());
    line
}
