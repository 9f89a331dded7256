//! Images as rows from the top, as often as one asks, without the whole in memory where the format
//! allows: PNG (not interlaced), TIFF (interleaved; strips or tiles of bounded size), EXR (flat, its
//! finest level), HDR and PFM. JPEG, TGA, BMP, interlaced PNG and what is unusual about the others are
//! decoded whole, up to [`MAX_DECODED_BYTES`](crate::texture::MAX_DECODED_BYTES).
//!
//! Invariant: the numbers are those of [`read_image`], whichever way they are read. A source that is
//! read in parts holds at most [`MOST_BAND_BYTES`] of it. Never converts a number.

mod exr;
mod hdr;
mod pfm;
mod png;
mod tiff;

use super::Failure;
use super::fingerprint::Stamp;
use crate::error::{Error, Result};
use crate::texture::contain;
use crate::texture::image_io::{ImageData, MAX_SIDE, Pixels, check_size, read_image};
use crate::texture::open::open_regular;
use crate::texture::rules::Depth;
use half::f16;
use std::io::{BufReader, Read, Seek};
use std::path::{Path, PathBuf};
use std::sync::mpsc;

/// A format whose parts are larger is decoded whole.
const MOST_BAND_BYTES: u64 = 256 << 20;
/// Bytes of rows that are worth handing on together.
const BAND_BYTES: usize = 4 << 20;

/// Size and kind of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    pub(super) width: u32,
    pub(super) height: u32,
    /// 1 grey, 2 grey and alpha, 3 RGB, 4 RGBA.
    pub(super) channels: u8,
    pub(super) depth: Depth,
}

impl Shape {
    fn row_numbers(&self) -> usize {
        self.width as usize * self.channels as usize
    }

    /// Rows that make a good band.
    fn band_rows(&self) -> u32 {
        (BAND_BYTES / (self.row_numbers() * self.depth.bytes())).clamp(1, 64) as u32
    }
}

/// Where rows go; false: no more are wanted.
type Give<'a> = &'a mut dyn FnMut(Pixels) -> bool;

/// A format that is decoded in parts, by one thread.
trait Decode: Send + Sync {
    /// All rows from the top.
    fn decode(&self, path: &Path, shape: &Shape, give: Give<'_>) -> Result<()>;
}

enum Form {
    Whole(ImageData),
    Parts(Box<dyn Decode>),
    /// Decompresses on all threads itself.
    Exr(Box<exr::Plan>),
}

/// An image file that can be read from the top, several times.
pub(super) struct Source {
    path: PathBuf,
    stamp: Stamp,
    shape: Shape,
    form: Form,
}

impl Source {
    /// Reads what is needed to know size and kind; a format that is decoded whole is decoded now.
    ///
    /// # Errors
    /// As [`read_image`], but that formats read in parts may be of any size up to [`MAX_SIDE`].
    pub(super) fn open(path: &Path) -> Result<Self> {
        let stamp = Stamp::of(path)?;
        let parts = contain::panics(|| open_parts(path)).unwrap_or_else(|| Err(gave_up(path)))?;
        let (shape, form) = match parts {
            Some(opened) => opened,
            None => {
                let data = read_image(path)?;
                let ImageData { width, height, channels, ref pixels } = data;
                (Shape { width, height, channels, depth: pixels.depth() }, Form::Whole(data))
            }
        };
        Ok(Self { path: path.to_path_buf(), stamp, shape, form })
    }

    pub(super) fn shape(&self) -> Shape {
        self.shape
    }

    /// Whether the image is in memory as a whole.
    pub(super) fn is_whole(&self) -> bool {
        matches!(self.form, Form::Whole(_))
    }

    /// Gives all rows to `take`, a few at a time.
    pub(super) fn read(
        &self,
        take: &mut dyn FnMut(&Pixels) -> std::result::Result<(), Failure>,
    ) -> std::result::Result<(), Failure> {
        match &self.form {
            Form::Whole(data) => {
                let numbers = self.shape.row_numbers() * self.shape.band_rows() as usize;
                fn bands<'a, T: Clone>(v: &'a [T], n: usize, f: fn(Vec<T>) -> Pixels) -> Bands<'a> {
                    Box::new(v.chunks(n).map(move |band| f(band.to_vec())))
                }
                type Bands<'a> = Box<dyn Iterator<Item = Pixels> + 'a>;
                let mut bands = match &data.pixels {
                    Pixels::U8(v) => bands(v, numbers, Pixels::U8),
                    Pixels::U16(v) => bands(v, numbers, Pixels::U16),
                    Pixels::F16(v) => bands(v, numbers, Pixels::F16),
                    Pixels::F32(v) => bands(v, numbers, Pixels::F32),
                };
                bands.try_for_each(|band| take(&band))
            }
            Form::Exr(plan) => plan.read(&self.path, &self.shape, take).and_then(|()| self.unchanged()),
            Form::Parts(decode) => self.read_beside(&**decode, take).and_then(|()| self.unchanged()),
        }
    }

    /// Decodes on a thread of its own: inflating is serial, and everything after it is not.
    fn read_beside(
        &self,
        decode: &dyn Decode,
        take: &mut dyn FnMut(&Pixels) -> std::result::Result<(), Failure>,
    ) -> std::result::Result<(), Failure> {
        let (sender, receiver) = mpsc::sync_channel::<Pixels>(1);
        std::thread::scope(|scope| {
            let thread = scope.spawn(move || {
                let mut give = |pixels| sender.send(pixels).is_ok();
                contain::panics(|| decode.decode(&self.path, &self.shape, &mut give))
                    .unwrap_or_else(|| Err(gave_up(&self.path)))
            });
            let mut taken = Ok(());
            for pixels in &receiver {
                taken = take(&pixels);
                if taken.is_err() {
                    break;
                }
            }
            // So that the decoder does not wait for room.
            drop(receiver);
            let decoded = thread.join().expect("the decoder's panics are caught on its thread");
            taken.and(decoded.map_err(Failure::Source))
        })
    }

    fn unchanged(&self) -> std::result::Result<(), Failure> {
        Ok(self.stamp.check(&self.path)?)
    }

    /// For a decoder that ended before the image did.
    pub(super) fn short(&self) -> Error {
        cut_short(&self.path)
    }
}

/// A TIFF of halves, or of grey floats, which `image` does not read; `None` for any other.
pub(in crate::texture) fn read_float_tiff(path: &Path) -> Result<Option<ImageData>> {
    let file = open_regular(path)?;
    let Some((shape, decode)) = tiff::open(path, BufReader::with_capacity(1 << 16, file))? else {
        return Ok(None);
    };
    let Shape { width, height, channels, depth } = shape;
    if depth != Depth::F16 && (depth != Depth::F32 || channels > 2) {
        return Ok(None);
    }
    check_size(path, width, height, channels as usize * depth.bytes())?;
    let mut all = empty(depth, shape.row_numbers() * height as usize);
    decode.decode(path, &shape, &mut |band| {
        match (&mut all, &band) {
            (Pixels::F16(to), Pixels::F16(from)) => to.extend_from_slice(from),
            (Pixels::F32(to), Pixels::F32(from)) => to.extend_from_slice(from),
            _ => return false,
        }
        true
    })?;
    Ok(Some(ImageData { width, height, channels, pixels: all }))
}

fn gave_up(path: &Path) -> Error {
    Error::file(path, "damaged: its decoder gave up")
}

fn cut_short(path: &Path) -> Error {
    Error::file(path, "the image is cut short")
}

/// Refuses an image that is empty or too wide or high for any of its rows to be held.
fn check_sides(path: &Path, width: u32, height: u32) -> Result<()> {
    if width == 0 || height == 0 || width.max(height) > MAX_SIDE {
        let message = format!("an image of {width}×{height} pixels; 1 to {MAX_SIDE} a side are read");
        return Err(Error::file(path, message));
    }
    Ok(())
}

/// `None`: a format, or a variety of one, that is read whole.
fn open_parts(path: &Path) -> Result<Option<(Shape, Form)>> {
    let io = |e| Error::io(path, e);
    let mut file = open_regular(path)?;
    let file_bytes = file.metadata().map_err(io)?.len();
    let mut magic = Vec::with_capacity(10);
    file.by_ref().take(10).read_to_end(&mut magic).map_err(io)?;
    file.rewind().map_err(io)?;
    let file = BufReader::with_capacity(1 << 18, file);
    let parts = match magic[..] {
        [0x89, b'P', b'N', b'G', ..] => png::open(path, file, file_bytes)?,
        [0x76, 0x2f, 0x31, 0x01, ..] => {
            return Ok(
                exr::open(path, file, file_bytes)?.map(|(shape, plan)| (shape, Form::Exr(Box::new(plan))))
            );
        }
        [b'I', b'I', 0x2a | 0x2b, 0, ..] | [b'M', b'M', 0, 0x2a | 0x2b, ..] => tiff::open(path, file)?,
        [b'P', b'F' | b'f', b, ..] if b.is_ascii_whitespace() => Some(pfm::open(path, file, file_bytes)?),
        _ if magic == b"#?RADIANCE" => hdr::open(file),
        _ => None,
    };
    Ok(parts.map(|(shape, decode)| (shape, Form::Parts(decode))))
}

/// Numbers in the bytes of one row, appended.
fn append(pixels: &mut Pixels, bytes: &[u8]) {
    match pixels {
        Pixels::U8(v) => v.extend_from_slice(bytes),
        Pixels::U16(v) => v.extend(bytes.chunks_exact(2).map(|b| u16::from_ne_bytes([b[0], b[1]]))),
        Pixels::F16(v) => v.extend(bytes.chunks_exact(2).map(|b| f16::from_ne_bytes([b[0], b[1]]))),
        Pixels::F32(v) => {
            v.extend(bytes.chunks_exact(4).map(|b| f32::from_ne_bytes([b[0], b[1], b[2], b[3]])));
        }
    }
}

/// Nothing yet, with room for `numbers`.
fn empty(depth: Depth, numbers: usize) -> Pixels {
    match depth {
        Depth::U8 => Pixels::U8(Vec::with_capacity(numbers)),
        Depth::U16 => Pixels::U16(Vec::with_capacity(numbers)),
        Depth::F16 => Pixels::F16(Vec::with_capacity(numbers)),
        Depth::F32 => Pixels::F32(Vec::with_capacity(numbers)),
    }
}

/// `numbers` zeros.
fn black(depth: Depth, numbers: usize) -> Pixels {
    match depth {
        Depth::U8 => Pixels::U8(vec![0; numbers]),
        Depth::U16 => Pixels::U16(vec![0; numbers]),
        Depth::F16 => Pixels::F16(vec![f16::ZERO; numbers]),
        Depth::F32 => Pixels::F32(vec![0.0; numbers]),
    }
}

#[cfg(test)]
mod tests;
