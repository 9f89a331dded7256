//! Images by id, inside a number of bytes: tiled files through the tile cache, plain images decoded
//! as a whole when all of them fit, and else through tiled copies of them.
//!
//! Whole images are loaded in parallel, 8-bit ones kept at 8 bits (four bytes a texel with colour,
//! one grey), floats as halves where that loses nothing, and mip levels only where asked.
//!
//! Invariant: after loading no table changes, so that look-ups in whole images need no lock; how an
//! image is kept changes no bit of what a look-up gives. Non-finite texels of float images become 0
//! (NaN) and ±65504 (infinities), so that one bad pixel of a file does not become a bad image.
//! Never decides what is needed.

mod copies;
mod find;
mod options;
mod survey;

pub use options::TextureOptions;
pub use survey::{Survey, image_size};

use super::attached::{self, Attached};
use super::cache::{CacheOptions, ThreadCache, TileCache, TileSource};
use super::convert::Watch;
use super::filter::{self, Footprint, Sampler};
use super::image_io::{ImageData, Pixels, read_image};
use super::pyramid;
use super::rules::{Build, Facts, Kind, Rules, Sample};
use super::texels::{Grey8, GreyFloat, GreyHalf, Level, Memory, Resident, Rgba8, RgbaFloat, RgbaHalf, Texel};
use super::tiles::{FileTiles, Probe, TiledImage};
use crate::color::Rgb;
use crate::error::{Error, Result};
use crate::math::Vec2;
use crate::prepare::ImageNeeds;
use crate::scene::{Channels, Encoding, ImageId, ImageSource};
use find::Found;
use glam::Vec4;
use rayon::prelude::*;
use std::path::PathBuf;

struct Stored {
    kind: Kind,
    has_alpha: bool,
    table: Box<[f32; 256]>,
    levels: Vec<Level>,
    memory: Memory,
}

impl Stored {
    #[inline(always)]
    fn lookup_any(&self, uv: Vec2, footprint: Footprint, sampler: Sampler) -> Vec4 {
        match self.kind {
            Kind::Rgba8 => self.lookup::<Rgba8>(uv, footprint, sampler),
            Kind::Grey8 => self.lookup::<Grey8>(uv, footprint, sampler),
            Kind::RgbaHalf => self.lookup::<RgbaHalf>(uv, footprint, sampler),
            Kind::GreyHalf => self.lookup::<GreyHalf>(uv, footprint, sampler),
            Kind::RgbaFloat => self.lookup::<RgbaFloat>(uv, footprint, sampler),
            Kind::GreyFloat => self.lookup::<GreyFloat>(uv, footprint, sampler),
        }
    }

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

/// Tiles that each thread holds for itself, at most. More would hide from the miss-ratio curve what
/// a cache of a few hundred tiles would have missed.
const THREAD_TILES: usize = 32;

/// One image, as it is kept.
enum Image {
    Whole(Stored),
    Tiled(TiledImage),
}

/// All images of a scene.
pub struct TextureStore {
    images: Vec<Option<Image>>,
    /// Boxed: threads know it by its address.
    cache: Option<Box<TileCache>>,
    /// The files of the cache.
    names: Vec<PathBuf>,
    /// What a person should know of tiled copies that were made.
    notes: Vec<String>,
}

impl TextureStore {
    /// Loads the images that are used, in parallel. `sources` and `needs` are parallel tables.
    /// `watch` is told of tiled copies that are made: bytes done, of how many.
    ///
    /// # Errors
    /// The first image, in the order of `sources`, that cannot be read: an input error at the place
    /// that asked for it. [`Error::Resource`] when memory or the disk for tiled copies runs out;
    /// [`Error::Usage`] for a budget that does not hold the images that are needed whole and two tiles a
    /// thread; [`Error::Interrupted`].
    ///
    /// # Panics
    /// If the tables differ in length.
    pub fn load(
        sources: &[ImageSource],
        needs: &[ImageNeeds],
        options: &TextureOptions,
        watch: Watch<'_>,
    ) -> Result<Self> {
        Self::load_found(Survey::new(sources, needs, options.caching)?, sources, needs, options, watch)
    }

    /// [`Self::load`] of images that have been looked at: `survey` is of the same tables.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_found(
        survey: Survey,
        sources: &[ImageSource],
        needs: &[ImageNeeds],
        options: &TextureOptions,
        watch: Watch<'_>,
    ) -> Result<Self> {
        let Survey { found, said, files } = survey;
        let whole = find::whole_bytes(&found);
        // Files that are tiled already need room beside them.
        let room = |found: &[Found]| find::tile_room(found, options.threads);
        let fits = whole.saturating_add(room(&found)) <= options.budget;
        let copies: Vec<bool> =
            found.iter().map(|f| !fits && matches!(f, Found::Plain { may_tile: true, .. })).collect();
        let (found, made) = copies::convert(found, &copies, sources, &files, options, watch)?;
        let notes = said.into_iter().flatten().chain(made).collect();
        // Before any of them is decoded: a budget is kept while images load, too.
        let whole = find::whole_bytes(&found);
        let room = room(&found);
        if options.budget < whole.saturating_add(room) {
            return Err(find::too_small(options.budget, options.threads, whole, room));
        }

        let mut tiled: Vec<Box<dyn TileSource>> = Vec::new();
        let mut names = Vec::new();
        let mut images: Vec<Option<Image>> = Vec::with_capacity(found.len());
        let mut plain = Vec::new();
        for (i, (found, source)) in found.into_iter().zip(sources).enumerate() {
            images.push(match found {
                Found::Unused => None,
                Found::Plain { encoding, .. } => {
                    plain.push((i, encoding));
                    None
                }
                Found::Tiled { file, opaque } => {
                    let index = u32::try_from(tiled.len()).expect("images are counted in u32");
                    let image = TiledImage::new(index, &file, source.encoding, opaque);
                    tiled.push(Box::new(FileTiles::new(*file)));
                    names.push(source.path.clone());
                    Some(Image::Tiled(image))
                }
            });
        }
        let decode = |&(i, encoding): &(usize, Encoding)| decode(&sources[i], encoding, needs[i]);
        let decoded: Vec<Result<Stored>> = plain.par_iter().map(decode).collect();
        for ((i, _), stored) in plain.into_iter().zip(decoded) {
            images[i] = Some(Image::Whole(stored?));
        }
        let mut store = Self { images, cache: None, names, notes };
        if !tiled.is_empty() {
            let budget = options.budget - store.bytes();
            let (threads, latency) = (options.threads, options.latency);
            let options = CacheOptions { budget, threads, latency, thread_tiles: THREAD_TILES };
            store.cache = Some(Box::new(TileCache::new(tiled, options)?));
        }
        Ok(store)
    }

    /// A store of one image that is already decoded.
    ///
    /// # Errors
    /// [`Error::Resource`] when memory runs out.
    pub fn from_data(data: ImageData, encoding: Encoding, mip_levels: bool) -> Result<Self> {
        let stored = store(data, encoding, mip_levels)
            .map_err(|e| Error::Resource(format!("no memory for an image's texels: {e}")))?;
        Ok(Self {
            images: vec![Some(Image::Whole(stored))],
            cache: None,
            names: Vec::new(),
            notes: Vec::new(),
        })
    }

    /// Filtered linear value at `uv` (v = 0 is the bottom edge) over `footprint`; black for an
    /// image that was not loaded. Every uv is allowed, non-finite ones too.
    #[inline(always)]
    #[must_use]
    pub fn lookup(&self, id: ImageId, uv: Vec2, footprint: Footprint, sampler: Sampler) -> Rgb {
        let (value, has_alpha) = match self.images.get(id.index()) {
            Some(Some(Image::Whole(image))) => (image.lookup_any(uv, footprint, sampler), image.has_alpha),
            Some(Some(Image::Tiled(image))) => {
                (self.lookup_tiled(image, uv, footprint, sampler), image.has_alpha())
            }
            _ => return Rgb::ZERO,
        };
        match sampler.channels {
            Channels::Rgb => value.truncate(),
            Channels::Alpha if has_alpha => Rgb::splat(value.w),
            Channels::Average | Channels::Alpha => Rgb::splat((value.x + value.y + value.z) * (1.0 / 3.0)),
        }
    }

    #[inline(always)]
    fn lookup_tiled(&self, image: &TiledImage, uv: Vec2, footprint: Footprint, sampler: Sampler) -> Vec4 {
        let cache = self.cache.as_deref().expect("a store with tiled images has a cache");
        attached::with(
            cache,
            #[inline(always)]
            |thread| image.lookup(cache, thread, uv, footprint, sampler),
        )
    }

    /// Weighted sum of bilinear look-ups in one level of a tiled image, linear RGBA; for filters that
    /// are not ours. Black for an image that is not tiled.
    #[inline]
    #[must_use]
    pub fn probes(&self, id: ImageId, thread: &mut ThreadCache, level: usize, probes: &[Probe]) -> Vec4 {
        match (self.images.get(id.index()), self.cache.as_deref()) {
            (Some(Some(Image::Tiled(image))), Some(cache)) => image.probes(cache, thread, level, probes),
            _ => Vec4::ZERO,
        }
    }

    /// Lets the calling thread keep tiles for itself until the result is dropped.
    #[must_use]
    pub fn attach(&self) -> Attached<'_> {
        Attached::new(self.cache.as_deref())
    }

    /// Look-ups of the calling thread from now on belong to rays of this depth (0: from the camera).
    #[inline(always)]
    pub fn set_depth(&self, depth: u32) {
        if self.cache.is_some() {
            attached::set_depth(depth);
        }
    }

    /// The tile cache, if any image goes through one, and its files' names.
    #[must_use]
    pub fn cache(&self) -> Option<(&TileCache, &[PathBuf])> {
        self.cache.as_deref().map(|cache| (cache, &self.names[..]))
    }

    /// One line each: tiled copies that were damaged and were made again, texels that were replaced.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Width and height in texels of the finest level; `None` for an image that was not loaded.
    #[must_use]
    pub fn size(&self, id: ImageId) -> Option<(u32, u32)> {
        Some(match self.images.get(id.index())?.as_ref()? {
            Image::Whole(image) => (image.levels[0].width, image.levels[0].height),
            Image::Tiled(image) => image.size(),
        })
    }

    /// Bytes of all images in memory as a whole, padding of blocks included; and the most that tiles took.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let whole = |i: &Image| if let Image::Whole(i) = i { i.memory.bytes as u64 } else { 0 };
        self.images.iter().flatten().map(whole).sum::<u64>() + self.cache.as_ref().map_or(0, |c| c.peak())
    }

    /// Whether no tile ever has to go to make room for another.
    #[must_use]
    pub fn all_tiles_fit(&self) -> bool {
        self.cache.as_ref().is_none_or(|cache| cache.fits_all())
    }

    /// Bytes that the texels of all levels would take, were all of them in memory.
    #[must_use]
    pub fn all_bytes(&self) -> u64 {
        let bytes = |i: &Image| match i {
            Image::Whole(i) => i.memory.bytes as u64,
            Image::Tiled(i) => i.all_bytes(),
        };
        self.images.iter().flatten().map(bytes).sum()
    }
}

fn decode(source: &ImageSource, encoding: Encoding, need: ImageNeeds) -> Result<Stored> {
    let data = read_image(&source.path).map_err(find::placed(source))?;
    store(data, encoding, need.mip_levels)
        .map_err(|e| Error::Resource(format!("{}: no memory for its texels: {e}", source.path.display())))
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
        let Some(Some(Image::Whole(image))) = self.images.get(id.index()) else { return None };
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
mod file_tests;
#[cfg(test)]
mod tests;
