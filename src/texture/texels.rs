//! Texels in small square blocks, in huge-page-friendly memory. A block of 8-bit RGBA is one cache
//! line, so that most bilinear lookups touch one or two lines, where rows would touch two or four.
//!
//! Invariant: one anonymous map holds all levels of an image; blocks are in row order; texels that
//! pad the last blocks are zero and never read. Never converts colours; `store` does on the way in.

use super::filter::TexelSource;
use glam::Vec4;
use memmap2::MmapMut;
use rayon::prelude::*;
use std::marker::PhantomData;
use std::ops::Range;

const HUGE_PAGE_BYTES: usize = 2 << 20;

/// How one texel is stored and read.
pub(super) trait Texel: bytemuck::Pod + Send + Sync {
    /// log₂ of a block's side.
    const BLOCK_LOG2: u32;
    /// Linear red, green, blue, and alpha (a grey texel repeats itself and is opaque).
    fn decode(self, table: &[f32; 256]) -> Vec4;
    /// The same, where alpha may be anything.
    #[inline(always)]
    fn decode_rgb(self, table: &[f32; 256]) -> Vec4 {
        self.decode(table)
    }
}

/// 8-bit RGBA: a block of 4×4 is a cache line.
pub(super) type Rgba8 = [u8; 4];
/// 8-bit grey: a block of 8×8 is a cache line.
pub(super) type Grey8 = u8;
/// Linear half RGBA, finite.
pub(super) type RgbaHalf = [u16; 4];
/// Linear half grey, finite.
pub(super) type GreyHalf = u16;
/// Linear float RGBA.
pub(super) type RgbaFloat = [f32; 4];
/// 8-bit RGB, as tiles have it.
pub(super) type Rgb8 = [u8; 3];
/// Linear half RGB, finite, as tiles have it.
pub(super) type RgbHalf = [u16; 3];
/// Linear float RGB, as tiles have it.
pub(super) type RgbFloat = [f32; 3];
/// Linear float grey.
pub(super) type GreyFloat = f32;

impl Texel for Rgba8 {
    const BLOCK_LOG2: u32 = 2;
    #[inline(always)]
    fn decode(self, table: &[f32; 256]) -> Vec4 {
        let [r, g, b, a] = self.map(usize::from);
        Vec4::new(table[r], table[g], table[b], a as f32 * (1.0 / 255.0))
    }
    #[inline(always)]
    fn decode_rgb(self, table: &[f32; 256]) -> Vec4 {
        let [r, g, b, _] = self.map(usize::from);
        Vec4::new(table[r], table[g], table[b], 0.0)
    }
}

impl Texel for Grey8 {
    const BLOCK_LOG2: u32 = 3;
    #[inline(always)]
    fn decode(self, table: &[f32; 256]) -> Vec4 {
        Vec4::splat(table[self as usize]).with_w(1.0)
    }
}

/// A finite half to float by shifting its bits into place and scaling the exponent; exact for
/// subnormals too, and inlined where the library's conversion is a call.
#[inline(always)]
fn half_to_f32(h: u16) -> f32 {
    // 2^112: the difference of the two formats' exponent biases.
    const SCALE: f32 = f32::from_bits((112 + 127) << 23);
    let magnitude = f32::from_bits(u32::from(h & 0x7fff) << 13) * SCALE;
    f32::from_bits(magnitude.to_bits() | (u32::from(h & 0x8000) << 16))
}

impl Texel for RgbaHalf {
    const BLOCK_LOG2: u32 = 2;
    #[inline(always)]
    fn decode(self, _: &[f32; 256]) -> Vec4 {
        Vec4::from_array(self.map(half_to_f32))
    }
}

impl Texel for GreyHalf {
    const BLOCK_LOG2: u32 = 3;
    #[inline(always)]
    fn decode(self, _: &[f32; 256]) -> Vec4 {
        Vec4::splat(half_to_f32(self)).with_w(1.0)
    }
}

impl Texel for RgbaFloat {
    const BLOCK_LOG2: u32 = 2;
    #[inline(always)]
    fn decode(self, _: &[f32; 256]) -> Vec4 {
        Vec4::from_array(self)
    }
}

impl Texel for GreyFloat {
    const BLOCK_LOG2: u32 = 2;
    #[inline(always)]
    fn decode(self, _: &[f32; 256]) -> Vec4 {
        Vec4::splat(self).with_w(1.0)
    }
}

impl Texel for Rgb8 {
    const BLOCK_LOG2: u32 = 2;
    #[inline(always)]
    fn decode(self, table: &[f32; 256]) -> Vec4 {
        let [r, g, b] = self.map(usize::from);
        Vec4::new(table[r], table[g], table[b], 1.0)
    }
}

impl Texel for RgbHalf {
    const BLOCK_LOG2: u32 = 2;
    #[inline(always)]
    fn decode(self, _: &[f32; 256]) -> Vec4 {
        let [r, g, b] = self.map(half_to_f32);
        Vec4::new(r, g, b, 1.0)
    }
}

impl Texel for RgbFloat {
    const BLOCK_LOG2: u32 = 2;
    #[inline(always)]
    fn decode(self, _: &[f32; 256]) -> Vec4 {
        let [r, g, b] = self;
        Vec4::new(r, g, b, 1.0)
    }
}

/// One mip level inside an image's memory.
#[derive(Clone, Copy, Debug)]
pub(super) struct Level {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Texels in a row of blocks.
    row_texels: usize,
    /// Where its bytes begin in the map.
    start: usize,
    bytes: usize,
}

impl Level {
    /// The level's texels.
    #[inline(always)]
    pub(super) fn texels<'a, T: Texel>(&self, memory: &'a Memory) -> &'a [T] {
        bytemuck::cast_slice(&memory.map[self.start..self.start + self.bytes])
    }

    /// Where texel (x, y) stands, x and y inside the level.
    #[inline(always)]
    pub(super) fn index<T: Texel>(&self, x: u32, y: u32) -> usize {
        self.row::<T>(y) + self.column::<T>(x)
    }

    /// The part of [`Level::index`] that x gives.
    #[inline(always)]
    pub(super) fn column<T: Texel>(&self, x: u32) -> usize {
        let (l, mask) = (T::BLOCK_LOG2, (1 << T::BLOCK_LOG2) - 1);
        (((x & !mask) << l) | (x & mask)) as usize
    }

    /// The part of [`Level::index`] that y gives.
    #[inline(always)]
    pub(super) fn row<T: Texel>(&self, y: u32) -> usize {
        let (l, mask) = (T::BLOCK_LOG2, (1 << T::BLOCK_LOG2) - 1);
        (y >> l) as usize * self.row_texels + ((y & mask) << l) as usize
    }

    /// Fills the level with the rows that `f(y, row)` appends to an empty `row`; rows of blocks in parallel.
    pub(super) fn fill_rows<T: Texel>(&self, memory: &mut Memory, f: impl Fn(u32, &mut Vec<T>) + Sync) {
        let side = 1u32 << T::BLOCK_LOG2;
        let texels: &mut [T] = bytemuck::cast_slice_mut(&mut memory.map[self.start..self.start + self.bytes]);
        texels.par_chunks_mut(self.row_texels).enumerate().for_each_init(Vec::new, |row, (by, blocks)| {
            for y in 0..side.min(self.height - by as u32 * side) {
                row.clear();
                f(by as u32 * side + y, row);
                let line = row.chunks(side as usize).zip(blocks.chunks_exact_mut((side * side) as usize));
                for (from, block) in line {
                    block[(y * side) as usize..][..from.len()].copy_from_slice(from);
                }
            }
        });
    }
}

/// An image's levels, finest first, in one map.
pub(super) struct Memory {
    map: MmapMut,
    /// What the levels take; the map has a little more, untouched.
    pub(super) bytes: usize,
}

impl Memory {
    /// What levels of these sizes take, in blocks of 2^`block_log2` texels a side and of `texel` bytes each.
    pub(super) fn taken(sizes: &[(u32, u32)], block_log2: u32, texel: u64) -> u64 {
        let side = |n: u32| u64::from(n).next_multiple_of(1 << block_log2);
        sizes.iter().map(|&(w, h)| (side(w) * side(h) * texel).next_multiple_of(64)).sum()
    }

    /// Room for levels of these sizes.
    pub(super) fn new<T: Texel>(sizes: &[(u32, u32)]) -> std::io::Result<(Self, Vec<Level>)> {
        let side = 1u32 << T::BLOCK_LOG2;
        let mut bytes = 0;
        let mut levels: Vec<Level> = sizes
            .iter()
            .map(|&(width, height)| {
                let row_texels = (width.div_ceil(side) * side * side) as usize;
                let level_bytes = row_texels * height.div_ceil(side) as usize * size_of::<T>();
                let level = Level { width, height, row_texels, start: bytes, bytes: level_bytes };
                // Blocks of every level begin on a cache line.
                bytes += level_bytes.next_multiple_of(64);
                level
            })
            .collect();
        let huge = bytes >= HUGE_PAGE_BYTES;
        let map = MmapMut::map_anon(bytes + if huge { HUGE_PAGE_BYTES } else { 0 })?;
        if huge {
            // Random lookups in a large image miss the TLB with 4 KiB pages. Advice only: without
            // huge pages everything works, slower.
            #[cfg(target_os = "linux")]
            let _ = map.advise(memmap2::Advice::HugePage);
            let shift = map.as_ptr().align_offset(HUGE_PAGE_BYTES);
            levels.iter_mut().for_each(|l| l.start += shift);
        }
        Ok((Self { map, bytes }, levels))
    }
}

/// An image that is in memory as a whole, for filters.
pub(super) struct Resident<'a, T> {
    memory: &'a Memory,
    levels: &'a [Level],
    table: &'a [f32; 256],
    texel: PhantomData<T>,
}

impl<'a, T: Texel> Resident<'a, T> {
    #[inline(always)]
    pub(super) fn new(memory: &'a Memory, levels: &'a [Level], table: &'a [f32; 256]) -> Self {
        Self { memory, levels, table, texel: PhantomData }
    }

    #[inline(always)]
    fn quad_of(
        &self,
        level: usize,
        x: [u32; 2],
        y: [u32; 2],
        decode: impl Fn(T, &[f32; 256]) -> Vec4,
    ) -> [Vec4; 4] {
        let l = &self.levels[level];
        let texels = l.texels::<T>(self.memory);
        // Written out: as a map over an array this becomes calls.
        let (c0, c1) = (l.column::<T>(x[0]), l.column::<T>(x[1]));
        let (r0, r1) = (l.row::<T>(y[0]), l.row::<T>(y[1]));
        [
            decode(texels[r0 + c0], self.table),
            decode(texels[r0 + c1], self.table),
            decode(texels[r1 + c0], self.table),
            decode(texels[r1 + c1], self.table),
        ]
    }
}

impl<T: Texel> TexelSource for Resident<'_, T> {
    #[inline(always)]
    fn levels(&self) -> usize {
        self.levels.len()
    }

    #[inline(always)]
    fn size(&self, level: usize) -> (u32, u32) {
        (self.levels[level].width, self.levels[level].height)
    }

    #[inline(always)]
    fn texel(&mut self, level: usize, x: u32, y: u32) -> Vec4 {
        let l = &self.levels[level];
        l.texels::<T>(self.memory)[l.index::<T>(x, y)].decode(self.table)
    }

    #[inline(always)]
    fn quad(&mut self, level: usize, x: [u32; 2], y: [u32; 2]) -> [Vec4; 4] {
        self.quad_of(level, x, y, T::decode)
    }

    #[inline(always)]
    fn quad_rgb(&mut self, level: usize, x: [u32; 2], y: [u32; 2]) -> [Vec4; 4] {
        self.quad_of(level, x, y, T::decode_rgb)
    }

    #[inline(always)]
    fn run(&mut self, level: usize, x: Range<u32>, y: u32, mut each: impl FnMut(Vec4)) {
        let l = &self.levels[level];
        let (texels, row) = (l.texels::<T>(self.memory), l.row::<T>(y));
        for x in x {
            each(texels[row + l.column::<T>(x)].decode(self.table));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use half::f16;

    #[test]
    fn finite_halves_convert_exactly() {
        for h in (0..=u16::MAX).filter(|&h| f16::from_bits(h).is_finite()) {
            assert_eq!(half_to_f32(h).to_bits(), f16::from_bits(h).to_f32().to_bits(), "{h:#x}");
        }
    }

    #[test]
    fn every_texel_has_its_own_place_at_odd_sizes_and_levels() {
        fn check<T: Texel + PartialEq + std::fmt::Debug>(make: impl Fn(u32, u32) -> T + Sync) {
            let sizes = [(13, 7), (6, 3), (1, 1), (1100, 701)];
            let (mut memory, levels) = Memory::new::<T>(&sizes).expect("memory");
            for level in &levels {
                let row = |y, out: &mut Vec<T>| out.extend((0..level.width).map(|x| make(x, y)));
                level.fill_rows(&mut memory, row);
            }
            for level in &levels {
                let texels = level.texels::<T>(&memory);
                assert_eq!(texels.as_ptr() as usize % 64, 0);
                for y in 0..level.height {
                    for x in 0..level.width {
                        assert_eq!(texels[level.index::<T>(x, y)], make(x, y));
                    }
                }
            }
        }
        check::<Rgba8>(|x, y| [x as u8, (x >> 8) as u8, y as u8, (y >> 8) as u8]);
        check::<GreyFloat>(|x, y| (x * 4096 + y) as f32);
        check::<Grey8>(|x, y| (x * 31 + y * 7) as u8);
        check::<RgbaHalf>(|x, y| [x as u16, y as u16, 0, 1]);
    }
}
