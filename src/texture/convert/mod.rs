//! Any image that Weir reads into a tiled, mip-mapped one, row by row: the image is never in memory
//! as a whole where its format can be decoded in parts (`source` says which).
//!
//! Invariant: texels are those of [`TextureStore`](super::TextureStore), bit for bit and at every
//! level, for TIFF; EXR has no 8-bit kind and takes 8-bit images as linear halves. The bytes written
//! do not depend on the number of threads. Never decides where a file goes: `cache_dir` and the
//! command line do.

mod exr_out;
pub mod fingerprint;
mod made;
mod source;
mod stream;
mod tiff_out;

use super::image_io::Pixels;
use super::rules::{Build, Depth, Facts, Kind, Rules, Sample, non_finite};
use super::texels::Texel;
use crate::error::Error;
use crate::scene::Encoding;
use glam::Vec4;
pub use made::write_rgb8;
use source::Source;
pub(super) use source::read_float_tiff;
use std::io::{self, Seek, Write};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use stream::Pyramid;

/// Texels along a tile's side.
pub const TILE: u32 = 64;

/// A file to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Container {
    /// `.tx`, `.tif`: TIFF, BigTIFF beyond 4 GB.
    Tiff,
    /// `.exr`: OpenEXR.
    Exr,
}

/// How tiles are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compression {
    /// As they are, each at a multiple of 4096 bytes in a TIFF.
    None,
    /// Deflate over differences.
    Zip,
}

/// What a texture is outside 0..1, for programs that take a file's word for it. Weir's scenes say so
/// themselves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WrapMode {
    /// Repeats.
    #[default]
    Periodic,
    /// Black.
    Black,
    /// The edge goes on.
    Clamp,
    /// Repeats, every other time mirrored.
    Mirror,
}

impl WrapMode {
    /// As Pixar's tag and OpenEXR's attribute spell it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Periodic => "periodic",
            Self::Black => "black",
            Self::Clamp => "clamp",
            Self::Mirror => "mirror",
        }
    }
}

/// What to make of an image.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Container to write.
    pub container: Container,
    /// Of tiles.
    pub compression: Compression,
    /// Recorded only.
    pub wrap: WrapMode,
    /// Of integer numbers; `None`: sRGB for 8 bits, linear for 16.
    pub encoding: Option<Encoding>,
}

/// What was made of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Width and height of the finest level.
    pub size: (u32, u32),
    /// Mip levels.
    pub levels: usize,
    /// Numbers kept of each texel: 1 grey, 3 RGB, 4 RGBA.
    pub channels: u8,
    /// Bits of each: 8 unsigned, 16 half, 32 float.
    pub bits: u8,
    /// How integers were read; linear for floats.
    pub encoding: Encoding,
    /// Length of the file.
    pub bytes: u64,
    /// Texels that were infinite or not a number, and are not any more.
    pub replaced: u64,
    /// Whether the source was decoded as a whole, because its format or layout allows no less.
    pub whole: bool,
}

/// How a caller watches and stops a conversion.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Set to give up: nothing is left then.
    pub cancel: &'a AtomicBool,
    /// Told of what is done, of how much, from any thread.
    pub progress: &'a (dyn Fn(u64, u64) + Sync),
}

impl Watch<'static> {
    /// Nobody watches.
    #[must_use]
    pub fn nobody() -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Self { cancel: &NEVER, progress: &|_, _| {} }
    }
}

impl Watch<'_> {
    /// # Errors
    /// [`Error::Interrupted`] once it is to be given up.
    pub(super) fn check(&self) -> crate::error::Result<()> {
        if self.cancel.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
    }
}

/// Whose fault a failure is.
#[derive(Debug)]
pub enum Failure {
    /// The source's; or it changed while it was read; or nobody's, when a person gave up.
    Source(Error),
    /// The destination's.
    Write(io::Error),
}

impl From<io::Error> for Failure {
    fn from(e: io::Error) -> Self {
        Self::Write(e)
    }
}

impl From<Error> for Failure {
    fn from(e: Error) -> Self {
        Self::Source(e)
    }
}

/// Rows of texels that make one row of tiles, or less of it at the bottom.
struct TileRow<'a> {
    /// Texels as bytes, rows after each other.
    texels: &'a [u8],
    /// Bytes from texel to texel.
    stride: usize,
    width: u32,
}

impl TileRow<'_> {
    fn height(&self) -> usize {
        self.texels.len() / (self.width as usize * self.stride)
    }

    /// The texels of tile `x`, row by row, without padding.
    fn rows(&self, x: u32) -> impl Iterator<Item = &[u8]> {
        let first = (x * TILE) as usize * self.stride;
        let last = (x * TILE + TILE).min(self.width) as usize * self.stride;
        self.texels.chunks_exact(self.width as usize * self.stride).map(move |row| &row[first..last])
    }

    /// Tile `x` as 64×64 texels of `keep` bytes; past the image its last column and row go on, which
    /// compresses well.
    fn padded_tile(&self, x: u32, keep: usize) -> Vec<u8> {
        let side = TILE as usize;
        let mut tile = Vec::with_capacity(side * side * keep);
        for row in self.rows(x) {
            let start = tile.len();
            if keep == self.stride {
                tile.extend_from_slice(row);
            } else {
                row.chunks_exact(self.stride).for_each(|texel| tile.extend_from_slice(&texel[..keep]));
            }
            while tile.len() < start + side * keep {
                tile.extend_from_within(tile.len() - keep..);
            }
        }
        while tile.len() < side * side * keep {
            tile.extend_from_within(tile.len() - side * keep..);
        }
        tile
    }
}

/// Whoever takes rows of tiles: of one level from the top, levels interleaved.
trait TileSink {
    fn tile_row(&mut self, level: usize, row: u32, texels: &TileRow<'_>) -> io::Result<()>;
}

/// Writes `path` as a tiled, mip-mapped file to `out`, which stands at its beginning.
/// `fingerprint` is recorded as the source's. `watch` counts rows.
///
/// # Errors
/// [`Failure::Source`] when the image cannot be read, or with [`Error::Interrupted`] when `watch` gives up;
/// [`Failure::Write`] when `out` cannot take it.
pub fn convert<W: Write + Seek>(
    path: &Path,
    settings: &Settings,
    fingerprint: &str,
    out: &mut W,
    watch: Watch<'_>,
) -> Result<Summary, Failure> {
    watch.check()?;
    let source = Source::open(path)?;
    let shape = source.shape();
    let look = (shape.channels.is_multiple_of(2) || shape.depth == Depth::F32) as u64;
    let total = u64::from(shape.height) * (1 + look);
    let mut done = 0;
    let mut count = |pixels: &Pixels| {
        done += (len(pixels) / (shape.width as usize * shape.channels as usize)) as u64;
        (watch.progress)(done, total);
        watch.check()
    };
    let mut facts = Facts::NONE;
    if look > 0 {
        source.read(&mut |pixels| {
            facts = facts.and(Facts::of(pixels, shape.channels));
            Ok(count(pixels)?)
        })?;
    }
    let float = matches!(shape.depth, Depth::F16 | Depth::F32);
    let encoding = match settings.encoding {
        _ if float => Encoding::Linear,
        Some(encoding) => encoding,
        None if shape.depth == Depth::U8 => Encoding::Srgb,
        None => Encoding::Linear,
    };
    let linear_halves = settings.container == Container::Exr;
    let rules = Rules { channels: shape.channels, depth: shape.depth, facts, encoding, linear_halves };
    rules.build(Writing { source: &source, settings, fingerprint, out, count: &mut count })
}

fn len(pixels: &Pixels) -> usize {
    match pixels {
        Pixels::U8(v) => v.len(),
        Pixels::U16(v) => v.len(),
        Pixels::F16(v) => v.len(),
        Pixels::F32(v) => v.len(),
    }
}

/// The second pass: texels become tiles.
struct Writing<'a, W> {
    source: &'a Source,
    settings: &'a Settings,
    fingerprint: &'a str,
    out: &'a mut W,
    count: &'a mut dyn FnMut(&Pixels) -> crate::error::Result<()>,
}

impl<W: Write + Seek> Build for Writing<'_, W> {
    type Out = Result<Summary, Failure>;

    fn build<S: Sample, T: Texel>(
        self,
        kind: Kind,
        rules: &Rules,
        table: Box<[f32; 256]>,
        convert: impl Fn(&[S]) -> T + Sync,
        encode: impl Fn(Vec4) -> T + Sync,
    ) -> Self::Out {
        let Self { source, settings, fingerprint, out, count } = self;
        let shape = source.shape();
        let (width, height) = (shape.width, shape.height);
        let (grey, sample_bytes) = match kind {
            Kind::Grey8 => (true, 1),
            Kind::Rgba8 => (false, 1),
            Kind::GreyHalf => (true, 2),
            Kind::RgbaHalf => (false, 2),
            Kind::GreyFloat => (true, 4),
            Kind::RgbaFloat => (false, 4),
        };
        let channels = match (grey, rules.facts.translucent) {
            (true, _) => 1,
            (false, false) => 3,
            (false, true) => 4,
        };
        // Linear numbers need no note of how they were read, so that floats and converted 16-bit
        // numbers look alike.
        let kept = if sample_bytes == 1 { rules.encoding } else { Encoding::Linear };
        let asked = settings.encoding.unwrap_or(rules.encoding);
        let description = fingerprint::description(fingerprint, asked, kept);
        let mut replaced = 0;
        let mut stream = |sink: &mut dyn TileSink| -> Result<(), Failure> {
            let mut pyramid = Pyramid::new(width, height, &table, &encode, sink);
            source.read(&mut |pixels| {
                replaced += non_finite(pixels, shape.channels);
                pyramid.push(S::of(pixels), shape.channels as usize, &convert)?;
                Ok(count(pixels)?)
            })?;
            if pyramid.complete() { Ok(()) } else { Err(source.short().into()) }
        };
        let bytes = match settings.container {
            Container::Tiff => {
                let layout = tiff_out::Layout {
                    width,
                    height,
                    channels,
                    sample_bytes,
                    compression: settings.compression,
                    wrap: settings.wrap,
                    // Integer formats keep colour beside alpha, EXR and float TIFF under it.
                    associated_alpha: matches!(rules.depth, Depth::F16 | Depth::F32),
                    description,
                };
                let mut sink = tiff_out::TiffSink::new(out, layout)?;
                stream(&mut sink)?;
                sink.finish()?
            }
            Container::Exr => {
                let layout = exr_out::Layout {
                    width,
                    height,
                    channels,
                    float: sample_bytes == 4,
                    compression: settings.compression,
                    wrap: settings.wrap,
                    description,
                };
                exr_out::write(out, &layout, &mut stream)?
            }
        };
        Ok(Summary {
            size: (width, height),
            levels: super::pyramid::sizes(width, height).len(),
            channels,
            bits: sample_bytes * 8,
            encoding: rules.encoding,
            bytes,
            replaced,
            whole: source.is_whole(),
        })
    }
}

#[cfg(test)]
mod tests;
