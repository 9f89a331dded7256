//! Textures and sky images, streamed row by row. Invariant: a row is written before the next is
//! asked for, so memory is a row and the encoder's window. Never holds an image.

use crate::error::Result;
use crate::replace::replace_file_unsynced;
use crate::texture::convert::{Compression, write_rgb8};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// How textures are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextureFormat {
    /// Tiled and mip-mapped TIFF, uncompressed, which is read at the tile and written once.
    Tx,
    /// 8-bit PNG, which every renderer reads.
    Png,
}

impl TextureFormat {
    /// Of file names, with its point.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Tx => ".tx",
            Self::Png => ".png",
        }
    }
}

/// Writes an 8-bit RGB image, whole or not at all: `row(y, bytes)` fills row `y` from the top.
///
/// # Errors
/// [`Error::Io`](crate::error::Error::Io) with `path`.
pub(super) fn write_texture(
    path: &Path,
    format: TextureFormat,
    (width, height): (u32, u32),
    mut row: impl FnMut(u32, &mut [u8]),
) -> Result<()> {
    match format {
        TextureFormat::Tx => replace_file_unsynced(path, |out| {
            write_rgb8(out, (width, height), Compression::None, "generated", &mut row).map(drop)
        }),
        TextureFormat::Png => replace_file_unsynced(path, |out| write_png(out, (width, height), row)),
    }
}

fn write_png(
    out: &mut BufWriter<File>,
    (width, height): (u32, u32),
    mut row: impl FnMut(u32, &mut [u8]),
) -> io::Result<()> {
    let mut encoder = png::Encoder::new(BufWriter::with_capacity(1 << 18, out), width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_filter(png::Filter::Sub);
    let mut writer = encoder.write_header().map_err(plain)?;
    let mut stream = writer.stream_writer_with_size(1 << 17).map_err(plain)?;
    let mut bytes = vec![0; width as usize * 3];
    for y in 0..height {
        row(y, &mut bytes);
        stream.write_all(&bytes)?;
    }
    stream.finish().map_err(plain)?;
    writer.finish().map_err(plain)
}

fn plain(e: png::EncodingError) -> io::Error {
    match e {
        png::EncodingError::IoError(e) => e,
        other => io::Error::other(other.to_string()),
    }
}

/// Writes linear floats as a portable float map: `row(y, texels)` fills row `y` from the top.
///
/// # Errors
/// [`Error::Io`](crate::error::Error::Io) with `path`.
pub(super) fn write_float_map(
    path: &Path,
    (width, height): (u32, u32),
    mut row: impl FnMut(u32, &mut [[f32; 3]]),
) -> Result<()> {
    replace_file_unsynced(path, |out| {
        write!(out, "PF\n{width} {height}\n-1.0\n")?;
        let mut texels = vec![[0.0; 3]; width as usize];
        // The format goes from the bottom up.
        for y in (0..height).rev() {
            row(y, &mut texels);
            for t in &texels {
                t.iter().try_for_each(|c| out.write_all(&c.to_le_bytes()))?;
            }
        }
        Ok(())
    })
}

/// Bytes of an 8-bit RGB texture with all its mip levels, decoded: 3 a texel, and a third for the
/// smaller levels.
#[must_use]
pub(super) fn texture_bytes((width, height): (u32, u32)) -> u64 {
    u64::from(width) * u64::from(height) * 4
}
