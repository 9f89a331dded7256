use super::*;
use crate::texture::texels::{Grey8, Level, Memory, Resident, Rgba8, RgbaFloat, Texel};
use crate::texture::{encoding, pyramid};

/// Deterministic bytes.
pub(super) fn noise(n: usize, mut seed: u32) -> Vec<u8> {
    let mut next = || {
        seed ^= seed << 13;
        seed ^= seed >> 17;
        seed ^= seed << 5;
        (seed >> 24) as u8
    };
    (0..n).map(|_| next()).collect()
}

/// An image in memory with all its levels.
pub(super) struct Image<T> {
    memory: Memory,
    levels: Vec<Level>,
    table: Box<[f32; 256]>,
    texel: std::marker::PhantomData<T>,
}

impl<T: Texel> Image<T> {
    pub(super) fn new(
        (width, height): (u32, u32),
        texel: impl Fn(u32, u32) -> T + Sync,
        encode: impl Fn(Vec4) -> T + Sync,
    ) -> Self {
        let (mut memory, levels) = Memory::new::<T>(&pyramid::sizes(width, height)).expect("memory");
        let table = encoding::table8(crate::scene::Encoding::Linear);
        levels[0].fill_rows(&mut memory, |y, row| row.extend((0..width).map(|x| texel(x, y))));
        pyramid::build::<T>(&mut memory, &levels, &table, encode);
        Self { memory, levels, table, texel: std::marker::PhantomData }
    }

    /// Levels that are of one value each.
    pub(super) fn by_level((width, height): (u32, u32), texel: impl Fn(usize) -> T + Sync) -> Self {
        let (mut memory, levels) = Memory::new::<T>(&pyramid::sizes(width, height)).expect("memory");
        for (i, level) in levels.iter().enumerate() {
            let row = |_, row: &mut Vec<T>| row.extend((0..level.width).map(|_| texel(i)));
            level.fill_rows(&mut memory, row);
        }
        let table = encoding::table8(crate::scene::Encoding::Linear);
        Self { memory, levels, table, texel: std::marker::PhantomData }
    }

    pub(super) fn source(&self) -> Resident<'_, T> {
        Resident::new(&self.memory, &self.levels, &self.table)
    }
}

/// The same texels in tiles of 8×8, `quad` with one tile where all four are in it.
struct Tiled {
    sizes: Vec<(u32, u32)>,
    tiles: Vec<Vec<[Vec4; 64]>>,
}

impl Tiled {
    fn new(mut from: impl TexelSource) -> Self {
        let sizes: Vec<_> = (0..from.levels()).map(|l| from.size(l)).collect();
        let tiles = sizes.iter().enumerate().map(|(level, &(w, h))| {
            let tiles = (0..h.div_ceil(8)).flat_map(|ty| (0..w.div_ceil(8)).map(move |tx| (tx, ty)));
            let mut fill = |(tx, ty)| {
                std::array::from_fn(|i| {
                    let (x, y) = (tx * 8 + i as u32 % 8, ty * 8 + i as u32 / 8);
                    if x < w && y < h { from.texel(level, x, y) } else { Vec4::NAN }
                })
            };
            tiles.map(&mut fill).collect()
        });
        Self { tiles: tiles.collect(), sizes: sizes.clone() }
    }

    fn tile(&self, level: usize, x: u32, y: u32) -> &[Vec4; 64] {
        &self.tiles[level][(y / 8 * self.sizes[level].0.div_ceil(8) + x / 8) as usize]
    }
}

fn inside(x: u32, y: u32) -> usize {
    (y % 8 * 8 + x % 8) as usize
}

impl TexelSource for Tiled {
    fn levels(&self) -> usize {
        self.sizes.len()
    }

    fn size(&self, level: usize) -> (u32, u32) {
        self.sizes[level]
    }

    fn texel(&mut self, level: usize, x: u32, y: u32) -> Vec4 {
        let (w, h) = self.sizes[level];
        assert!(x < w && y < h, "a filter reads outside level {level}: {x}, {y}");
        self.tile(level, x, y)[inside(x, y)]
    }

    fn quad(&mut self, level: usize, x: [u32; 2], y: [u32; 2]) -> [Vec4; 4] {
        let at = [(x[0], y[0]), (x[1], y[0]), (x[0], y[1]), (x[1], y[1])];
        if x[0] / 8 == x[1] / 8 && y[0] / 8 == y[1] / 8 {
            let tile = self.tile(level, x[0], y[0]);
            return at.map(|(x, y)| tile[inside(x, y)]);
        }
        at.map(|(x, y)| self.texel(level, x, y))
    }
}

#[test]
fn tiles_and_whole_images_give_the_same_bits() {
    fn check<T: Texel>(image: &Image<T>) {
        let mut tiled = Tiled::new(image.source());
        for i in 0..4000u32 {
            let turn = Vec2::from_angle(i as f32 * 0.7);
            let short = 2f32.powi((i % 13) as i32 - 12);
            let long = short * (1 << (i / 13 % 6)) as f32;
            let footprint =
                Footprint { duv_dx: turn * long, duv_dy: turn.perp() * short, random: u64::from(i) };
            let uv = Vec2::new(i as f32 * 0.372 - 700.0, 1.3 - 0.0613 * i as f32);
            for filter in FILTERS {
                for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Black, Wrap::OctahedralSphere] {
                    for channels in [Channels::Rgb, Channels::Alpha] {
                        let sampler = Sampler { filter, wrap, channels };
                        let bits = |v: Vec4| {
                            // Alpha that is not asked for may be anything.
                            let v = if channels == Channels::Alpha { v } else { v.with_w(0.0) };
                            v.to_array().map(f32::to_bits)
                        };
                        let whole = lookup(&mut image.source(), uv, footprint, sampler);
                        let tiles = lookup(&mut tiled, uv, footprint, sampler);
                        assert_eq!(bits(whole), bits(tiles));
                    }
                }
            }
        }
    }
    let bytes = noise(130 * 67 * 4, 1);
    let byte = |x: u32, y: u32, c: u32| bytes[((y * 130 + x) * 4 + c) as usize];
    let to_byte = |v: f32| (v * 255.0 + 0.5) as u8;
    check::<Rgba8>(&Image::new(
        (130, 67),
        |x, y| [0, 1, 2, 3].map(|c| byte(x, y, c)),
        |c| c.to_array().map(to_byte),
    ));
    check::<Grey8>(&Image::new((130, 67), |x, y| byte(x, y, 0), |c| to_byte(c.x)));
    check::<RgbaFloat>(&Image::new(
        (130, 67),
        |x, y| [0, 1, 2, 3].map(|c| f32::from(byte(x, y, c))),
        |c| c.to_array(),
    ));
}

#[test]
fn levels_are_logarithms_and_never_jump() {
    for i in 0..=2_000_000u32 {
        let x = 1.0 + i as f32 * 0.005;
        let (n, t) = log2(x);
        let want = f64::from(x).log2();
        assert!((0.0..=1.0).contains(&t) && (n as f64 + f64::from(t) - want).abs() < 8e-6, "{x}: {n} {t}");
    }
    for n in 0..31 {
        assert_eq!(log2((1u64 << n) as f32), (n, 0.0));
        let (below, t) = log2(((1u64 << (n + 1)) as f32).next_down());
        assert!(below == n && t > 0.999_999);
    }
    assert!(log2(f32::INFINITY).0 > 31);
}
