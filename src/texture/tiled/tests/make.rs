//! Small texture files with texels that are known by level, place and channel.

use exr::math::RoundingMode;
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Encoding, FlatSamples, Image, Layer, LayerAttributes, Levels, LineOrder,
    Vec2, WritableImage,
};
use half::f16;
use std::io::{Cursor, Write};

/// A tiled TIFF to be.
#[derive(Clone)]
pub(super) struct Tiff {
    pub(super) sizes: Vec<(u32, u32)>,
    pub(super) tile: (u32, u32),
    pub(super) samples: u32,
    /// 8, 16 or 32.
    pub(super) bits: u32,
    /// 1 unsigned integers, 3 floats.
    pub(super) format: u32,
    /// 1 none, 5 LZW, 8 deflate.
    pub(super) compression: u32,
    pub(super) predictor: u32,
    pub(super) big_endian: bool,
    pub(super) big_tiff: bool,
    pub(super) description: &'static str,
}

impl Default for Tiff {
    fn default() -> Self {
        Self {
            sizes: chain(75, 37),
            tile: (32, 16),
            samples: 3,
            bits: 8,
            format: 1,
            compression: 8,
            predictor: 2,
            big_endian: false,
            big_tiff: false,
            description: "",
        }
    }
}

/// Sizes of all levels, rounded down.
pub(super) fn chain(width: u32, height: u32) -> Vec<(u32, u32)> {
    let mut sizes = vec![(width, height)];
    while let Some(&(w, h)) = sizes.last()
        && w.max(h) > 1
    {
        sizes.push(((w / 2).max(1), (h / 2).max(1)));
    }
    sizes
}

/// A number in 0..65536 that tells its place.
pub(super) fn known(level: usize, x: u32, y: u32, channel: u32) -> u32 {
    (level as u32 * 7919 + x * 131 + y * 1031 + channel * 257 + x * y % 5) % 65536
}

/// The bits of a texel's number as a file of this kind stores them.
pub(super) fn bits(bits: u32, format: u32, known: u32) -> u32 {
    match (bits, format) {
        (8, _) => known & 255,
        (16, 1) => known,
        (16, _) => u32::from(f16::from_f32(known as f32 - 300.0).to_bits()),
        _ => (known as f32 / 7.0 - 300.0).to_bits(),
    }
}

impl Tiff {
    fn number(&self, v: u64, bytes: usize) -> Vec<u8> {
        if self.big_endian {
            v.to_be_bytes()[8 - bytes..].to_vec()
        } else {
            v.to_le_bytes()[..bytes].to_vec()
        }
    }

    fn tile(&self, level: usize, tx: u32, ty: u32) -> Vec<u8> {
        let (tw, th) = self.tile;
        let (width, height) = self.sizes[level];
        let size = self.bits as usize / 8;
        let n = self.samples as usize;
        let mut out = Vec::new();
        for y in 0..th {
            let numbers: Vec<u32> = (0..tw * self.samples)
                .map(|i| {
                    let (x, c) = (tx * tw + i / self.samples, i % self.samples);
                    let inside = x < width && ty * th + y < height;
                    // What pads a file's tiles is anything.
                    if inside { bits(self.bits, self.format, known(level, x, ty * th + y, c)) } else { 0x55 }
                })
                .collect();
            let difference = |i: usize| numbers[i].wrapping_sub(if i < n { 0 } else { numbers[i - n] });
            match if self.compression == 1 { 1 } else { self.predictor } {
                2 => (0..numbers.len()).for_each(|i| out.extend(self.number(difference(i).into(), size))),
                3 => {
                    let plane = |k: usize| numbers.iter().map(move |v| v.to_be_bytes()[4 - size + k]);
                    let bytes: Vec<u8> = (0..size).flat_map(plane).collect();
                    let before = |i: usize| if i < n { 0 } else { bytes[i - n] };
                    out.extend((0..bytes.len()).map(|i| bytes[i].wrapping_sub(before(i))));
                }
                _ => numbers.iter().for_each(|&v| out.extend(self.number(v.into(), size))),
            }
        }
        match self.compression {
            5 => weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8)
                .encode(&out)
                .expect("memory"),
            8 => {
                let mut z = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
                z.write_all(&out).expect("memory");
                z.finish().expect("memory")
            }
            _ => out,
        }
    }

    /// The file.
    pub(super) fn build(&self) -> Vec<u8> {
        let word = if self.big_tiff { 8 } else { 4 };
        let mut file = if self.big_endian { b"MM".to_vec() } else { b"II".to_vec() };
        if self.big_tiff {
            file.extend([self.number(43, 2), self.number(8, 2), self.number(0, 2)].concat());
        } else {
            file.extend(self.number(42, 2));
        }
        let mut link = file.len();
        file.extend(self.number(0, word));
        for (level, &(width, height)) in self.sizes.iter().enumerate() {
            let (tiles_x, tiles_y) = (width.div_ceil(self.tile.0), height.div_ceil(self.tile.1));
            let (mut offsets, mut counts) = (Vec::new(), Vec::new());
            for i in 0..tiles_x * tiles_y {
                let bytes = self.tile(level, i % tiles_x, i / tiles_x);
                offsets.push(file.len() as u64);
                counts.push(bytes.len() as u64);
                file.extend(bytes);
            }
            let long = if self.big_tiff { 16 } else { 4 };
            let repeat = |v: u32| vec![u64::from(v); self.samples as usize];
            let photometric = if self.samples < 3 { 1 } else { 2 };
            let one = |v: u32| vec![u64::from(v)];
            let mut tags: Vec<(u16, u16, Vec<u64>)> = vec![
                (256, 3, one(width)),
                (257, 4, one(height)),
                (258, 3, repeat(self.bits)),
                (259, 3, one(self.compression)),
                (262, 3, one(photometric)),
                (277, 3, one(self.samples)),
                (284, 3, one(1)),
                (317, 3, one(self.predictor)),
                (322, 3, one(self.tile.0)),
                (323, 3, one(self.tile.1)),
                (324, long, offsets),
                (325, 4, counts),
                (339, 3, repeat(self.format)),
            ];
            if !self.description.is_empty() {
                let text = self.description.bytes().chain([0]).map(u64::from).collect();
                tags.insert(5, (270, 2, text));
            }
            let mut entries = Vec::new();
            for (tag, kind, values) in tags {
                let size = match kind {
                    2 => 1,
                    3 => 2,
                    4 => 4,
                    _ => 8,
                };
                let mut bytes: Vec<u8> = values.iter().flat_map(|&v| self.number(v, size)).collect();
                entries.extend([self.number(tag.into(), 2), self.number(kind.into(), 2)].concat());
                entries.extend(self.number(values.len() as u64, word));
                if bytes.len() <= word {
                    bytes.resize(word, 0);
                    entries.extend(bytes);
                } else {
                    entries.extend(self.number(file.len() as u64, word));
                    file.extend(bytes);
                }
            }
            let at = self.number(file.len() as u64, word);
            file[link..link + word].copy_from_slice(&at);
            let count = entries.len() / (4 + 2 * word);
            file.extend(self.number(count as u64, if self.big_tiff { 8 } else { 2 }));
            file.extend(entries);
            link = file.len();
            file.extend(self.number(0, word));
        }
        file
    }
}

/// A tiled, mip-mapped EXR of these channels; those named in `floats` are floats, the rest halves.
pub(super) fn exr(
    size: (u32, u32),
    tile: usize,
    names: &[&str],
    floats: &[&str],
    compression: exr::compression::Compression,
    rounding_mode: RoundingMode,
) -> Vec<u8> {
    let (width, height) = size;
    let count = exr::meta::compute_level_count(rounding_mode, width.max(height) as usize);
    let side = |s: u32, level| exr::meta::compute_level_size(rounding_mode, s as usize, level) as u32;
    let channels = names.iter().enumerate().map(|(c, &name)| {
        let level_data = (0..count)
            .map(|level| {
                let (w, h) = (side(width, level), side(height, level));
                let texels = (0..w * h).map(|i| exr_value(level, i % w, i / w, c as u32));
                if floats.contains(&name) {
                    FlatSamples::F32(texels.collect())
                } else {
                    FlatSamples::F16(texels.map(f16::from_f32).collect())
                }
            })
            .collect();
        AnyChannel::new(name, Levels::Mip { rounding_mode, level_data })
    });
    let encoding =
        Encoding { compression, blocks: Blocks::Tiles(Vec2(tile, tile)), line_order: LineOrder::Increasing };
    let size = (width as usize, height as usize);
    let channels = AnyChannels::sort(channels.collect());
    let layer = Layer::new(size, LayerAttributes::named("texture"), encoding, channels);
    let mut file = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut file).expect("memory");
    file.into_inner()
}

/// What a channel (in the order they were named) of such a file has; halves hold it exactly.
pub(super) fn exr_value(level: usize, x: u32, y: u32, channel: u32) -> f32 {
    (known(level, x, y, channel) % 2048) as f32 / 8.0 - 40.0
}
