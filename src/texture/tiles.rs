//! Texels out of tiles that come and go: what the filters see of a tiled file, through the tiles
//! that the calling thread holds.
//!
//! Invariant: a texel is the same number, to the bit, that a whole image in memory would give.
//! Never decides what stays in memory.

use super::cache::{ThreadCache, TileCache, TileSource};
use super::encoding;
use super::filter::{self, Footprint, Sampler, TexelSource};
use super::texels::{Rgb8, RgbFloat, RgbHalf, Rgba8, RgbaFloat, RgbaHalf, Texel};
use super::tiled::{Component, TileLevel, TileScratch, TiledFile};
use crate::error::Result;
use crate::math::Vec2;
use crate::scene::{Encoding, Wrap};
use glam::Vec4;
use half::f16;
use std::marker::PhantomData;
use std::ops::Range;

/// What a tile's texels are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Grey8,
    Rgb8,
    Rgba8,
    GreyHalf,
    RgbHalf,
    RgbaHalf,
    GreyFloat,
    RgbFloat,
    RgbaFloat,
}

/// `$body` with `$texel` for the type of a kind's texels.
macro_rules! with_texel {
    ($kind:expr, $texel:ident => $body:expr) => {
        with_texel!($kind, $texel => $body; Grey8: u8, Rgb8: Rgb8, Rgba8: Rgba8, GreyHalf: u16,
            RgbHalf: RgbHalf, RgbaHalf: RgbaHalf, GreyFloat: f32, RgbFloat: RgbFloat, RgbaFloat: RgbaFloat)
    };
    ($kind:expr, $texel:ident => $body:expr; $($name:ident: $of:ident),*) => {
        match $kind {
            $(Kind::$name => {
                type $texel = $of;
                $body
            })*
        }
    };
}

/// What a look-up needs to know of a tiled file.
pub(super) struct TiledImage {
    /// Its number in the cache.
    file: u32,
    kind: Kind,
    tile_log2: (u32, u32),
    levels: Box<[TileLevel]>,
    table: Box<[f32; 256]>,
    /// Alpha says nothing, and counts as none.
    opaque: bool,
}

impl TiledImage {
    /// Bytes of all texels of `file`.
    pub(super) fn bytes_of(file: &TiledFile) -> u64 {
        let texels: u64 = file.levels().iter().map(|l| u64::from(l.width) * u64::from(l.height)).sum();
        texels * with_texel!(Self::kind_of(file), T => size_of::<T>() as u64)
    }

    fn kind_of(file: &TiledFile) -> Kind {
        match (file.component(), file.channels()) {
            (Component::U8, 1) => Kind::Grey8,
            (Component::U8, 3) => Kind::Rgb8,
            (Component::U8, _) => Kind::Rgba8,
            (Component::F16, 1) => Kind::GreyHalf,
            (Component::F16, 3) => Kind::RgbHalf,
            (Component::F16, _) => Kind::RgbaHalf,
            (Component::F32, 1) => Kind::GreyFloat,
            (Component::F32, 3) => Kind::RgbFloat,
            (Component::F32, _) => Kind::RgbaFloat,
        }
    }

    /// The image of `file`, which is number `index` in the cache. `encoding` is that of 8-bit
    /// numbers unless the file names its own. `opaque` files have an alpha that says nothing.
    pub(super) fn new(index: u32, file: &TiledFile, encoding: Encoding, opaque: bool) -> Self {
        Self {
            file: index,
            kind: Self::kind_of(file),
            tile_log2: file.tile_log2(),
            levels: file.levels().into(),
            table: encoding::table8(file.encoding().unwrap_or(encoding)),
            opaque,
        }
    }

    /// Whether the levels go down to a single texel, as filters want them.
    pub(super) fn is_complete(file: &TiledFile) -> bool {
        file.levels().last().is_some_and(|l| (l.width, l.height) == (1, 1))
    }

    /// Bytes of all its texels.
    pub(super) fn all_bytes(&self) -> u64 {
        let texels: u64 = self.levels.iter().map(|l| u64::from(l.width) * u64::from(l.height)).sum();
        texels * with_texel!(self.kind, T => size_of::<T>() as u64)
    }

    /// Whether there is an alpha channel that says something.
    pub(super) fn has_alpha(&self) -> bool {
        !self.opaque && matches!(self.kind, Kind::Rgba8 | Kind::RgbaHalf | Kind::RgbaFloat)
    }

    /// Width and height in texels.
    pub(super) fn size(&self) -> (u32, u32) {
        (self.levels[0].width, self.levels[0].height)
    }

    /// Filtered linear RGBA at `uv`. The commonest texels are compiled into the caller, so that they
    /// are looked up by the instructions that it may use.
    #[inline(always)]
    pub(super) fn lookup(
        &self,
        cache: &TileCache,
        thread: &mut ThreadCache,
        uv: Vec2,
        footprint: Footprint,
        sampler: Sampler,
    ) -> Vec4 {
        match self.kind {
            Kind::Rgb8 => self.lookup_as::<Rgb8>(cache, thread, uv, footprint, sampler),
            Kind::Grey8 => self.lookup_as::<u8>(cache, thread, uv, footprint, sampler),
            Kind::Rgba8 => self.lookup_as::<Rgba8>(cache, thread, uv, footprint, sampler),
            _ => self.lookup_rare(cache, thread, uv, footprint, sampler),
        }
    }

    #[inline(never)]
    fn lookup_rare(
        &self,
        cache: &TileCache,
        thread: &mut ThreadCache,
        uv: Vec2,
        footprint: Footprint,
        sampler: Sampler,
    ) -> Vec4 {
        with_texel!(self.kind, T => self.lookup_as::<T>(cache, thread, uv, footprint, sampler))
    }

    #[inline(always)]
    fn lookup_as<T: Texel>(
        &self,
        cache: &TileCache,
        thread: &mut ThreadCache,
        uv: Vec2,
        footprint: Footprint,
        sampler: Sampler,
    ) -> Vec4 {
        filter::lookup(
            &mut Tiles::<T> { image: self, cache, thread, texel: PhantomData },
            uv,
            footprint,
            sampler,
        )
    }
}

/// One bilinear look-up of several that are summed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probe {
    /// Where, in 0..1 over the image from its top left corner; wraps around.
    pub st: Vec2,
    /// Its share of the sum.
    pub weight: f32,
}

impl TiledImage {
    /// Weighted sum of bilinear look-ups in one level, linear RGBA.
    pub(super) fn probes(
        &self,
        cache: &TileCache,
        thread: &mut ThreadCache,
        level: usize,
        probes: &[Probe],
    ) -> Vec4 {
        with_texel!(self.kind, T => self.probes_as::<T>(cache, thread, level, probes))
    }

    #[inline]
    fn probes_as<T: Texel>(
        &self,
        cache: &TileCache,
        thread: &mut ThreadCache,
        level: usize,
        probes: &[Probe],
    ) -> Vec4 {
        let mut tiles = Tiles::<T> { image: self, cache, thread, texel: PhantomData };
        probes.iter().fold(Vec4::ZERO, |sum, p| {
            sum + filter::bilinear_rgb(&mut tiles, level, p.st, Wrap::Repeat) * p.weight
        })
    }
}

/// A tiled file as the filters see it.
struct Tiles<'a, T> {
    image: &'a TiledImage,
    cache: &'a TileCache,
    thread: &'a mut ThreadCache,
    texel: PhantomData<T>,
}

impl<T: Texel> Tiles<'_, T> {
    /// The texel at (x, y) of a tile's bytes; only the low bits of x and y count.
    #[inline(always)]
    fn read(tile: &[u8], (w, h): (u32, u32), x: u32, y: u32) -> T {
        let at = (((y & ((1 << h) - 1)) << w) | (x & ((1 << w) - 1))) as usize * size_of::<T>();
        bytemuck::pod_read_unaligned(&tile[at..at + size_of::<T>()])
    }

    #[inline(always)]
    fn tile(&mut self, level: usize, x: u32, y: u32) -> &[u8] {
        let l = &self.image.levels[level];
        self.thread.tile(self.cache, self.image.file, l.first + y * l.tiles_x + x)
    }

    #[inline(always)]
    fn quad_of(
        &mut self,
        level: usize,
        [x0, x1]: [u32; 2],
        [y0, y1]: [u32; 2],
        decode: impl Fn(T, &[f32; 256]) -> Vec4,
    ) -> [Vec4; 4] {
        let log2 = self.image.tile_log2;
        let (w, h) = log2;
        if (x0 ^ x1) >> w | (y0 ^ y1) >> h != 0 {
            return self.quad_across(level, [x0, x1], [y0, y1]).map(|t| decode(t, &self.image.table));
        }
        let table = &self.image.table;
        let tile = {
            let l = &self.image.levels[level];
            self.thread.tile(self.cache, self.image.file, l.first + (y0 >> h) * l.tiles_x + (x0 >> w))
        };
        [
            decode(Self::read(tile, log2, x0, y0), table),
            decode(Self::read(tile, log2, x1, y0), table),
            decode(Self::read(tile, log2, x0, y1), table),
            decode(Self::read(tile, log2, x1, y1), table),
        ]
    }

    /// Texels of different tiles, one tile at a time: a thread may be allowed to hold no more.
    #[inline(never)]
    fn quad_across(&mut self, level: usize, [x0, x1]: [u32; 2], [y0, y1]: [u32; 2]) -> [T; 4] {
        let log2 = self.image.tile_log2;
        let (w, h) = log2;
        let mut pair = |y: u32| {
            let left = self.tile(level, x0 >> w, y >> h);
            let a = Self::read(left, log2, x0, y);
            let b = if (x0 ^ x1) >> w == 0 {
                Self::read(left, log2, x1, y)
            } else {
                Self::read(self.tile(level, x1 >> w, y >> h), log2, x1, y)
            };
            [a, b]
        };
        let [a, b] = pair(y0);
        let [c, d] = pair(y1);
        [a, b, c, d]
    }
}

impl<T: Texel> TexelSource for Tiles<'_, T> {
    #[inline(always)]
    fn levels(&self) -> usize {
        self.image.levels.len()
    }

    #[inline(always)]
    fn size(&self, level: usize) -> (u32, u32) {
        (self.image.levels[level].width, self.image.levels[level].height)
    }

    #[inline(always)]
    fn texel(&mut self, level: usize, x: u32, y: u32) -> Vec4 {
        let (w, h) = self.image.tile_log2;
        let image = self.image;
        Self::read(self.tile(level, x >> w, y >> h), (w, h), x, y).decode(&image.table)
    }

    #[inline(always)]
    fn quad(&mut self, level: usize, x: [u32; 2], y: [u32; 2]) -> [Vec4; 4] {
        self.quad_of(level, x, y, T::decode)
    }

    #[inline(always)]
    fn quad_rgb(&mut self, level: usize, x: [u32; 2], y: [u32; 2]) -> [Vec4; 4] {
        self.quad_of(level, x, y, T::decode_rgb)
    }

    /// A tile is found once for its part of the row.
    #[inline(always)]
    fn run(&mut self, level: usize, x: Range<u32>, y: u32, mut each: impl FnMut(Vec4)) {
        let image = self.image;
        let (w, h) = image.tile_log2;
        let mut start = x.start;
        while start < x.end {
            let end = x.end.min(((start >> w) + 1) << w);
            let tile = self.tile(level, start >> w, y >> h);
            for x in start..end {
                each(Self::read(tile, (w, h), x, y).decode(&image.table));
            }
            start = end;
        }
    }
}

/// A tiled file as the cache sees it.
pub(super) struct FileTiles {
    file: TiledFile,
    first: Box<[u32]>,
}

impl FileTiles {
    pub(super) fn new(file: TiledFile) -> Self {
        Self { first: file.levels().iter().map(|l| l.first).collect(), file }
    }
}

impl TileSource for FileTiles {
    fn tile_count(&self) -> u32 {
        self.file.tile_count()
    }
    fn tile_bytes(&self) -> usize {
        self.file.tile_bytes()
    }
    fn first_tiles(&self) -> &[u32] {
        &self.first
    }
    fn index_bytes(&self) -> usize {
        self.file.index_bytes() + self.first.len() * 4
    }
    fn read_tile(&self, tile: u32, out: &mut [u8], scratch: &mut TileScratch) -> Result<u64> {
        self.file.read_tile(tile, out, scratch)
    }

    /// Magenta, opaque: the colour that says that a texture is missing.
    fn fill_unreadable(&self, out: &mut [u8]) {
        const MAGENTA: [f32; 4] = [1.0, 0.0, 1.0, 1.0];
        let channels = self.file.channels() as usize;
        // Grey has no magenta; a half is far from black and white.
        let value = |i: usize| if channels == 1 { 0.5 } else { MAGENTA[i % channels] };
        match self.file.component() {
            Component::U8 => out.iter_mut().enumerate().for_each(|(i, o)| *o = (value(i) * 255.0) as u8),
            Component::F16 => {
                for (i, o) in out.chunks_exact_mut(2).enumerate() {
                    o.copy_from_slice(&f16::from_f32(value(i)).to_ne_bytes());
                }
            }
            Component::F32 => {
                for (i, o) in out.chunks_exact_mut(4).enumerate() {
                    o.copy_from_slice(&value(i).to_ne_bytes());
                }
            }
        }
    }
}
