//! Decoded images by id. Loads in parallel, keeps 8-bit images at 8 bits (four bytes a texel with
//! colour, one grey), floats as halves where that loses nothing, and mip levels only where asked.
//!
//! Invariant: after loading nothing changes, so that lookups need no lock. Non-finite texels of
//! float images become 0 (NaN) and ±65504 (infinities), so that one bad pixel of a file does not
//! become a bad image. Never decides what is needed, never opens a file after loading.

use super::encoding::{self, Encoder};
use super::filter::{self, Footprint, Sampler};
use super::image_io::{ImageData, Pixels, read_image};
use super::pyramid;
use super::texels::{Grey8, GreyFloat, GreyHalf, Level, Memory, Resident, Rgba8, RgbaFloat, RgbaHalf, Texel};
use crate::color::Rgb;
use crate::error::{Error, Result};
use crate::math::Vec2;
use crate::prepare::ImageNeeds;
use crate::scene::{Channels, Encoding, ImageId, ImageSource};
use glam::Vec4;
use half::f16;
use rayon::prelude::*;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Rgba8,
    Grey8,
    RgbaHalf,
    GreyHalf,
    RgbaFloat,
    GreyFloat,
}

struct Stored {
    kind: Kind,
    has_alpha: bool,
    table: Box<[f32; 256]>,
    levels: Vec<Level>,
    memory: Memory,
}

impl Stored {
    #[inline(always)]
    fn lookup<T: Texel>(&self, uv: Vec2, footprint: Footprint, sampler: Sampler) -> Vec4 {
        filter::lookup(
            &mut Resident::<T>::new(&self.memory, &self.levels, &self.table),
            uv,
            footprint,
            sampler,
        )
    }
}

/// All images of a scene.
pub struct TextureStore {
    images: Vec<Option<Stored>>,
}

impl TextureStore {
    /// Loads the images that are used, in parallel. `sources` and `needs` are parallel tables.
    ///
    /// # Errors
    /// The first image, in the order of `sources`, that cannot be read: an input error at the place
    /// that asked for it. [`Error::Resource`] when memory runs out.
    ///
    /// # Panics
    /// If the tables differ in length.
    pub fn load(sources: &[ImageSource], needs: &[ImageNeeds]) -> Result<Self> {
        assert_eq!(sources.len(), needs.len(), "one need per image");
        let images: Vec<Result<Option<Stored>>> = sources
            .par_iter()
            .zip(needs)
            .map(|(source, need)| {
                if !need.used {
                    return Ok(None);
                }
                let data = read_image(&source.path).map_err(|e| match e {
                    Error::Resource(_) => e,
                    e => Error::at(&source.at, format!("image {e}")),
                })?;
                store(data, source.encoding, need.mip_levels).map(Some).map_err(|e| {
                    Error::Resource(format!("{}: no memory for its texels: {e}", source.path.display()))
                })
            })
            .collect();
        Ok(Self { images: images.into_iter().collect::<Result<_>>()? })
    }

    /// A store of one image that is already decoded.
    ///
    /// # Errors
    /// [`Error::Resource`] when memory runs out.
    pub fn from_data(data: ImageData, encoding: Encoding, mip_levels: bool) -> Result<Self> {
        let stored = store(data, encoding, mip_levels)
            .map_err(|e| Error::Resource(format!("no memory for an image's texels: {e}")))?;
        Ok(Self { images: vec![Some(stored)] })
    }

    /// Filtered linear value at `uv` (v = 0 is the bottom edge) over `footprint`; black for an
    /// image that was not loaded. Every uv is allowed, non-finite ones too.
    #[inline]
    #[must_use]
    pub fn lookup(&self, id: ImageId, uv: Vec2, footprint: Footprint, sampler: Sampler) -> Rgb {
        let Some(Some(image)) = self.images.get(id.index()) else { return Rgb::ZERO };
        let value = match image.kind {
            Kind::Rgba8 => image.lookup::<Rgba8>(uv, footprint, sampler),
            Kind::Grey8 => image.lookup::<Grey8>(uv, footprint, sampler),
            Kind::RgbaHalf => image.lookup::<RgbaHalf>(uv, footprint, sampler),
            Kind::GreyHalf => image.lookup::<GreyHalf>(uv, footprint, sampler),
            Kind::RgbaFloat => image.lookup::<RgbaFloat>(uv, footprint, sampler),
            Kind::GreyFloat => image.lookup::<GreyFloat>(uv, footprint, sampler),
        };
        match sampler.channels {
            Channels::Rgb => value.truncate(),
            Channels::Alpha if image.has_alpha => Rgb::splat(value.w),
            Channels::Average | Channels::Alpha => Rgb::splat((value.x + value.y + value.z) * (1.0 / 3.0)),
        }
    }

    /// Width and height in texels of the finest level; `None` for an image that was not loaded.
    #[must_use]
    pub fn size(&self, id: ImageId) -> Option<(u32, u32)> {
        let level = self.images.get(id.index())?.as_ref()?.levels[0];
        Some((level.width, level.height))
    }

    /// Bytes of all texels, padding of blocks included.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.images.iter().flatten().map(|i| i.memory.bytes).sum()
    }
}

/// Whether the last channel says anything: like pbrt, an image that is opaque throughout has none.
fn translucent(data: &ImageData) -> bool {
    fn any<T: Sync>(v: &[T], n: usize, below: impl Fn(&T) -> bool + Sync) -> bool {
        v.par_chunks_exact(n).any(|p| below(&p[n - 1]))
    }
    let n = data.channels as usize;
    data.has_alpha()
        && match &data.pixels {
            Pixels::U8(v) => any(v, n, |&a| a < 255),
            Pixels::U16(v) => any(v, n, |&a| a < u16::MAX),
            Pixels::F16(v) => any(v, n, |a| a.to_f32() != 1.0),
            Pixels::F32(v) => any(v, n, |&a| a != 1.0),
        }
}

/// Widens one pixel to RGBA; `opaque` is the format's one.
#[inline(always)]
fn rgba<T: Copy>(pixel: &[T], opaque: T) -> [T; 4] {
    match *pixel {
        [v] => [v, v, v, opaque],
        [v, a] => [v, v, v, a],
        [r, g, b] => [r, g, b, opaque],
        [r, g, b, a, ..] => [r, g, b, a],
        [] => [opaque; 4],
    }
}

fn finite(v: f32) -> f32 {
    const LARGEST_HALF: f32 = 65504.0;
    if v.is_finite() {
        v
    } else if v.is_nan() {
        0.0
    } else {
        LARGEST_HALF.copysign(v)
    }
}

fn finite_half(v: f32) -> u16 {
    f16::from_f32(finite(v).clamp(-65504.0, 65504.0)).to_bits()
}

fn store(data: ImageData, encoding: Encoding, mip_levels: bool) -> std::io::Result<Stored> {
    let has_alpha = translucent(&data);
    let ImageData { width, height, channels, pixels } = data;
    let n = channels as usize;
    // An opaque alpha beside grey is not worth three more numbers.
    let grey = n == 1 || (n == 2 && !has_alpha);
    let base = Base { width, height, n, has_alpha, mip_levels };
    match pixels {
        Pixels::U8(v) => {
            let table = encoding::table8(encoding);
            let e = Encoder::new(encoding);
            if grey {
                return base.build(Kind::Grey8, table, v, |p| p[0], |c| e.encode(c.x));
            }
            let alpha = |a: f32| (a * 255.0 + 0.5) as u8;
            let encode = |c: Vec4| [e.encode(c.x), e.encode(c.y), e.encode(c.z), alpha(c.w)];
            base.build(Kind::Rgba8, table, v, |p| rgba(p, 255), encode)
        }
        Pixels::U16(v) => {
            let t = encoding::table16(encoding);
            let color = |x: u16| f16::from_f32(t[x as usize]).to_bits();
            if grey {
                return base.build(Kind::GreyHalf, no_table(), v, |p| color(p[0]), half_grey);
            }
            let convert = |p: &[u16]| {
                let [r, g, b, a] = rgba(p, u16::MAX);
                [color(r), color(g), color(b), f16::from_f32(f32::from(a) / 65535.0).to_bits()]
            };
            base.build(Kind::RgbaHalf, no_table(), v, convert, half_rgba)
        }
        Pixels::F16(v) => {
            let clean = |x: f16| if x.is_finite() { x.to_bits() } else { finite_half(x.to_f32()) };
            if grey {
                return base.build(Kind::GreyHalf, no_table(), v, |p| clean(p[0]), half_grey);
            }
            base.build(Kind::RgbaHalf, no_table(), v, |p| rgba(p, f16::ONE).map(clean), half_rgba)
        }
        Pixels::F32(v) => {
            // Radiance HDR and many EXR files carry no more than a half holds.
            let exact = v.par_iter().all(|&x| !x.is_finite() || f16::from_f32(x).to_f32() == x);
            match (exact, grey) {
                (true, true) => base.build(Kind::GreyHalf, no_table(), v, |p| finite_half(p[0]), half_grey),
                (true, false) => {
                    base.build(Kind::RgbaHalf, no_table(), v, |p| rgba(p, 1.0).map(finite_half), half_rgba)
                }
                (false, true) => base.build(Kind::GreyFloat, no_table(), v, |p| finite(p[0]), |c| c.x),
                (false, false) => {
                    base.build(Kind::RgbaFloat, no_table(), v, |p| rgba(p, 1.0).map(finite), |c| c.to_array())
                }
            }
        }
    }
}

/// Float kinds have their values as they are.
fn no_table() -> Box<[f32; 256]> {
    Box::new([0.0; 256])
}

fn half_grey(c: Vec4) -> u16 {
    finite_half(c.x)
}

fn half_rgba(c: Vec4) -> [u16; 4] {
    c.to_array().map(finite_half)
}

struct Base {
    width: u32,
    height: u32,
    n: usize,
    has_alpha: bool,
    mip_levels: bool,
}

impl Base {
    fn build<S: Copy + Sync, T: Texel>(
        self,
        kind: Kind,
        table: Box<[f32; 256]>,
        pixels: Vec<S>,
        convert: impl Fn(&[S]) -> T + Sync,
        encode: impl Fn(Vec4) -> T + Sync,
    ) -> std::io::Result<Stored> {
        let mut sizes = pyramid::sizes(self.width, self.height);
        if !self.mip_levels {
            sizes.truncate(1);
        }
        let (mut memory, levels) = Memory::new::<T>(&sizes)?;
        let row = self.width as usize * self.n;
        levels[0].fill_rows(&mut memory, |y, out: &mut Vec<T>| {
            out.extend(pixels[y as usize * row..][..row].chunks_exact(self.n).map(&convert));
        });
        // The decoder's buffer goes before the levels come.
        drop(pixels);
        pyramid::build::<T>(&mut memory, &levels, &table, encode);
        Ok(Stored { kind, has_alpha: self.has_alpha, table, levels, memory })
    }
}

#[cfg(test)]
mod tests;
