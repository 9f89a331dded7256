//! Decoded images by id. Loads in parallel, keeps 8-bit images at 8 bits (four bytes a texel with
//! colour, one grey), floats as halves where that loses nothing, and mip levels only where asked.
//!
//! Invariant: after loading nothing changes, so that lookups need no lock. Non-finite texels of
//! float images become 0 (NaN) and ±65504 (infinities), so that one bad pixel of a file does not
//! become a bad image. Never decides what is needed, never opens a file after loading.

use super::filter::{Footprint, Sampler, View};
use super::image_io::{ImageData, Pixels, read_image};
use super::pyramid;
use super::rules::{Build, Facts, Kind, Rules, Sample};
use super::texels::{Grey8, GreyFloat, GreyHalf, Level, Memory, Rgba8, RgbaFloat, RgbaHalf, Texel};
use crate::color::Rgb;
use crate::error::{Error, Result};
use crate::math::Vec2;
use crate::prepare::ImageNeeds;
use crate::scene::{Channels, Encoding, ImageId, ImageSource};
use glam::Vec4;
use rayon::prelude::*;

struct Stored {
    kind: Kind,
    has_alpha: bool,
    table: Box<[f32; 256]>,
    levels: Vec<Level>,
    memory: Memory,
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
        let view = View { memory: &image.memory, levels: &image.levels, table: &image.table };
        let value = match image.kind {
            Kind::Rgba8 => view.lookup::<Rgba8>(uv, footprint, sampler),
            Kind::Grey8 => view.lookup::<Grey8>(uv, footprint, sampler),
            Kind::RgbaHalf => view.lookup::<RgbaHalf>(uv, footprint, sampler),
            Kind::GreyHalf => view.lookup::<GreyHalf>(uv, footprint, sampler),
            Kind::RgbaFloat => view.lookup::<RgbaFloat>(uv, footprint, sampler),
            Kind::GreyFloat => view.lookup::<GreyFloat>(uv, footprint, sampler),
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

fn store(data: ImageData, encoding: Encoding, mip_levels: bool) -> std::io::Result<Stored> {
    let facts = Facts::of(&data.pixels, data.channels);
    let ImageData { width, height, channels, pixels } = data;
    let rules = Rules { channels, depth: pixels.depth(), facts, encoding, linear_halves: false };
    rules.build(InMemory { width, height, mip_levels, pixels })
}

/// Builds all levels in memory.
struct InMemory {
    width: u32,
    height: u32,
    mip_levels: bool,
    pixels: Pixels,
}

impl Build for InMemory {
    type Out = std::io::Result<Stored>;

    fn build<S: Sample, T: Texel>(
        self,
        kind: Kind,
        rules: &Rules,
        table: Box<[f32; 256]>,
        convert: impl Fn(&[S]) -> T + Sync,
        encode: impl Fn(Vec4) -> T + Sync,
    ) -> Self::Out {
        let mut sizes = pyramid::sizes(self.width, self.height);
        if !self.mip_levels {
            sizes.truncate(1);
        }
        let (mut memory, levels) = Memory::new::<T>(&sizes)?;
        let n = rules.channels as usize;
        let row = self.width as usize * n;
        let pixels = S::of(&self.pixels);
        levels[0].fill_rows(&mut memory, |y, out: &mut Vec<T>| {
            out.extend(pixels[y as usize * row..][..row].chunks_exact(n).map(&convert));
        });
        // The decoder's buffer goes before the levels come.
        drop(self.pixels);
        pyramid::build::<T>(&mut memory, &levels, &table, encode);
        Ok(Stored { kind, has_alpha: rules.facts.translucent, table, levels, memory })
    }
}

/// A level as it is kept: width, height, and the bytes of its texels, rows from the top.
#[cfg(test)]
pub(super) type KeptLevel = (u32, u32, Vec<u8>);

#[cfg(test)]
impl TextureStore {
    /// Bytes a texel, whether alpha counts, and all levels of image `id`.
    pub(super) fn kept(&self, id: ImageId) -> Option<(usize, bool, Vec<KeptLevel>)> {
        fn levels<T: Texel>(image: &Stored) -> Vec<KeptLevel> {
            let level = |level: &Level| {
                let texels = level.texels::<T>(&image.memory);
                let places = (0..level.height).flat_map(|y| (0..level.width).map(move |x| (x, y)));
                let bytes =
                    places.flat_map(|(x, y)| bytemuck::bytes_of(&texels[level.index::<T>(x, y)]).to_vec());
                (level.width, level.height, bytes.collect())
            };
            image.levels.iter().map(level).collect()
        }
        let image = self.images.get(id.index())?.as_ref()?;
        let (bytes, levels) = match image.kind {
            Kind::Rgba8 => (4, levels::<Rgba8>(image)),
            Kind::Grey8 => (1, levels::<Grey8>(image)),
            Kind::RgbaHalf => (8, levels::<RgbaHalf>(image)),
            Kind::GreyHalf => (2, levels::<GreyHalf>(image)),
            Kind::RgbaFloat => (16, levels::<RgbaFloat>(image)),
            Kind::GreyFloat => (4, levels::<GreyFloat>(image)),
        };
        Some((bytes, image.has_alpha, levels))
    }
}

#[cfg(test)]
mod tests;
