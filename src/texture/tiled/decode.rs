//! From a TIFF tile's bytes to numbers: expansion, predictors, byte order, 16-bit integers to linear
//! halves. Loops over whole rows; nothing is allocated once the scratch has grown.
//!
//! Invariant: every output byte is written or the result is an error. Foreign decoders run
//! contained.

use super::Component;
use super::files::Cause;
use crate::scene::Encoding;
use crate::texture::{contain, encoding};
use half::f16;
use std::sync::{Arc, OnceLock};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    Lzw,
    Deflate,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Predictor {
    None,
    Horizontal,
    Float,
}

/// Numbers as the file has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Numbers {
    U8,
    U16,
    F16,
    F32,
}

impl Numbers {
    pub(super) fn bytes(self) -> usize {
        self.component().bytes()
    }

    /// What they are once decoded.
    pub(super) fn component(self) -> Component {
        match self {
            Self::U8 => Component::U8,
            Self::U16 | Self::F16 => Component::F16,
            Self::F32 => Component::F32,
        }
    }
}

/// Longest form of a tile that a sane writer makes of `stored` bytes: what does not compress costs
/// LZW half as much again (codes of 12 bits) and deflate 5 bytes a block.
pub(super) fn longest(compression: Compression, stored: usize) -> u64 {
    match compression {
        // More than is read, so it costs nothing.
        Compression::None => u64::from(u32::MAX),
        Compression::Lzw | Compression::Deflate => stored as u64 * 2 + 4096,
    }
}

/// Expanders and a row, reused.
#[derive(Default)]
pub(super) struct Decoders {
    lzw: Option<weezl::decode::Decoder>,
    row: Vec<u8>,
}

impl Decoders {
    pub(super) fn bytes(&self) -> usize {
        // The library does not tell; it keeps tables of about this size.
        const LZW_TABLES: usize = 48 << 10;
        self.row.capacity() + self.lzw.as_ref().map_or(0, |_| LZW_TABLES)
    }

    /// Fills `out` from `bytes`.
    pub(super) fn expand(
        &mut self,
        compression: Compression,
        bytes: &[u8],
        out: &mut [u8],
    ) -> Result<(), Cause> {
        let gave_up = || Cause::from("damaged: its decoder gave up");
        match compression {
            Compression::None => {
                let bytes = bytes.get(..out.len()).ok_or("shorter than its pixels; damaged")?;
                out.copy_from_slice(bytes);
                Ok(())
            }
            Compression::Deflate => {
                contain::panics(|| inflate(bytes, out)).ok_or_else(gave_up)?.map_err(String::from)
            }
            Compression::Lzw => {
                use weezl::{BitOrder, LzwStatus, decode::Decoder};
                let new = || Decoder::with_tiff_size_switch(BitOrder::Msb, 8);
                let mut decoder = self.lzw.take().unwrap_or_else(new);
                decoder.reset();
                let (decoder, filled) = contain::panics(|| {
                    let (mut used, mut filled) = (0, 0);
                    loop {
                        let step = decoder.decode_bytes(&bytes[used..], &mut out[filled..]);
                        used += step.consumed_in;
                        filled += step.consumed_out;
                        let go_on = matches!(step.status, Ok(LzwStatus::Ok));
                        let moved = step.consumed_in + step.consumed_out > 0;
                        if !go_on || !moved || filled == out.len() {
                            return (decoder, filled);
                        }
                    }
                })
                .ok_or_else(gave_up)?;
                self.lzw = Some(decoder);
                if filled == out.len() {
                    Ok(())
                } else {
                    Err(format!("{filled} bytes where {} are needed; damaged", out.len()))
                }
            }
        }
    }
}

/// Fills `out` from a zlib stream. `fdeflate` has no reset: 18 KiB are allocated for each stream,
/// which costs less than the time by which it is faster than inflaters that have one.
fn inflate(bytes: &[u8], out: &mut [u8]) -> Result<(), &'static str> {
    use fdeflate::DecompressionError::WrongChecksum;
    let flaw =
        |e| if e == WrongChecksum { "damaged: its checksum differs" } else { "damaged: no deflate stream" };
    let mut stream = fdeflate::Decompressor::new();
    let (used, filled) = stream.read(bytes, out, 0, true).map_err(flaw)?;
    if filled < out.len() {
        return Err("damaged: its deflate stream has fewer bytes than the tile");
    }
    if !stream.is_done() {
        // The output was full before the end was seen.
        stream.read(&bytes[used..], out, filled, true).map_err(flaw)?;
    }
    if stream.is_done() { Ok(()) } else { Err("damaged: its deflate stream has more bytes than the tile") }
}

/// What a tile's rows are.
#[derive(Clone, Copy)]
pub(super) struct Row {
    pub(super) numbers: Numbers,
    /// Numbers a pixel.
    pub(super) samples: usize,
    /// Pixels.
    pub(super) width: usize,
}

/// Undoes the predictor and the byte order of a tile.
pub(super) fn to_native(
    tile: &mut [u8],
    row: Row,
    predictor: Predictor,
    swap: bool,
    decoders: &mut Decoders,
) {
    let Row { numbers, samples, width } = row;
    let row_numbers = width * samples;
    let size = numbers.bytes();
    if predictor == Predictor::Float {
        for row in tile.chunks_exact_mut(row_numbers * size) {
            undo_float(row, size, samples, &mut decoders.row);
        }
        return;
    }
    if swap && size > 1 {
        tile.chunks_exact_mut(size).for_each(<[u8]>::reverse);
    }
    if predictor == Predictor::Horizontal {
        for row in tile.chunks_exact_mut(row_numbers * size) {
            match (size, samples) {
                (1, 1) => sum8::<1>(row),
                (1, 2) => sum8::<2>(row),
                (1, 3) => sum8::<3>(row),
                (1, _) => sum8::<4>(row),
                (2, 1) => sum16::<1>(row),
                (2, 2) => sum16::<2>(row),
                (2, 3) => sum16::<3>(row),
                (2, _) => sum16::<4>(row),
                (_, 1) => sum32::<1>(row),
                (_, 2) => sum32::<2>(row),
                (_, 3) => sum32::<3>(row),
                (_, _) => sum32::<4>(row),
            }
        }
    }
}

/// Running sums of each of `N` channels: N chains of additions that do not wait for each other.
fn sum8<const N: usize>(row: &mut [u8]) {
    let mut sum = [0u8; N];
    let (pixels, _) = row.as_chunks_mut::<N>();
    for pixel in pixels {
        for (s, v) in sum.iter_mut().zip(pixel) {
            *s = s.wrapping_add(*v);
            *v = *s;
        }
    }
}

/// Running sums of all bytes.
pub(super) fn running_sums(bytes: &mut [u8]) {
    sum8::<1>(bytes);
}

fn sum16<const N: usize>(row: &mut [u8]) {
    let mut sum = [0u16; N];
    let (numbers, _) = row.as_chunks_mut::<2>();
    for pixel in numbers.chunks_exact_mut(N) {
        for (s, v) in sum.iter_mut().zip(pixel) {
            *s = s.wrapping_add(u16::from_ne_bytes(*v));
            *v = s.to_ne_bytes();
        }
    }
}

fn sum32<const N: usize>(row: &mut [u8]) {
    let mut sum = [0u32; N];
    let (numbers, _) = row.as_chunks_mut::<4>();
    for pixel in numbers.chunks_exact_mut(N) {
        for (s, v) in sum.iter_mut().zip(pixel) {
            *s = s.wrapping_add(u32::from_ne_bytes(*v));
            *v = s.to_ne_bytes();
        }
    }
}

/// Undoes the floating point predictor: differences of bytes, `samples` apart, over the whole row;
/// the numbers' first bytes (the most significant, whatever the file's byte order) stand before all
/// their second ones.
fn undo_float(row: &mut [u8], size: usize, samples: usize, copy: &mut Vec<u8>) {
    match samples {
        1 => sum8::<1>(row),
        2 => sum8::<2>(row),
        3 => sum8::<3>(row),
        _ => sum8::<4>(row),
    }
    copy.clear();
    copy.extend_from_slice(row);
    let n = row.len() / size;
    if size == 2 {
        let (high, low) = copy.split_at(n);
        for ((out, &h), &l) in row.as_chunks_mut::<2>().0.iter_mut().zip(high).zip(low) {
            *out = u16::from_be_bytes([h, l]).to_ne_bytes();
        }
    } else {
        let (ab, cd) = copy.split_at(2 * n);
        let ((a, b), (c, d)) = (ab.split_at(n), cd.split_at(n));
        let planes = a.iter().zip(b).zip(c.iter().zip(d));
        for (out, ((&a, &b), (&c, &d))) in row.as_chunks_mut::<4>().0.iter_mut().zip(planes) {
            *out = u32::from_be_bytes([a, b, c, d]).to_ne_bytes();
        }
    }
}

/// Linear halves of all 16-bit integers.
pub(super) struct Table16 {
    color: Arc<[u16]>,
    alpha: Arc<[u16]>,
    /// Not shared with other files.
    own: bool,
}

/// The table of a curve; those of sRGB and linear files are shared by all.
pub(super) fn table16(curve: Encoding) -> Table16 {
    static SRGB: OnceLock<Arc<[u16]>> = OnceLock::new();
    static LINEAR: OnceLock<Arc<[u16]>> = OnceLock::new();
    let build = || encoding::table16(curve).iter().map(|&v| f16::from_f32(v).to_bits()).collect();
    let linear = || encoding::table16(Encoding::Linear).iter().map(|&v| f16::from_f32(v).to_bits()).collect();
    let alpha = Arc::clone(LINEAR.get_or_init(linear));
    let color = match curve {
        Encoding::Srgb => Arc::clone(SRGB.get_or_init(build)),
        Encoding::Linear => Arc::clone(&alpha),
        Encoding::Gamma(_) => build(),
    };
    Table16 { color, alpha, own: matches!(curve, Encoding::Gamma(_)) }
}

impl Table16 {
    pub(super) fn own_bytes(&self) -> usize {
        if self.own { self.color.len() * 2 } else { 0 }
    }

    /// Replaces integers by their linear halves; the last of 2 or 4 samples is opacity.
    pub(super) fn apply(&self, tile: &mut [u8], samples: usize) {
        let (numbers, _) = tile.as_chunks_mut::<2>();
        let look = |table: &[u16], v: &mut [u8; 2]| {
            *v = table[u16::from_ne_bytes(*v) as usize].to_ne_bytes();
        };
        if samples.is_multiple_of(2) {
            for pixel in numbers.chunks_exact_mut(samples) {
                if let [color @ .., alpha] = pixel {
                    color.iter_mut().for_each(|v| look(&self.color, v));
                    look(&self.alpha, alpha);
                }
            }
        } else {
            numbers.iter_mut().for_each(|v| look(&self.color, v));
        }
    }
}

/// Grey and alpha to RGBA.
pub(super) fn widen_grey_alpha(from: &[u8], to: &mut [u8], size: usize) {
    for (from, to) in from.chunks_exact(2 * size).zip(to.chunks_exact_mut(4 * size)) {
        let (grey, alpha) = from.split_at(size);
        to[..size].copy_from_slice(grey);
        to[size..2 * size].copy_from_slice(grey);
        to[2 * size..3 * size].copy_from_slice(grey);
        to[3 * size..].copy_from_slice(alpha);
    }
}

/// NaN becomes 0 and infinities ±65504, as in images that are read whole.
pub(super) fn make_finite(tile: &mut [u8], component: Component) {
    match component {
        Component::U8 => {}
        Component::F16 => {
            for v in tile.as_chunks_mut::<2>().0 {
                let bits = u16::from_ne_bytes(*v);
                let finite = match bits & 0x7fff {
                    0..0x7c00 => bits,
                    0x7c00 => bits & 0x8000 | 0x7bff,
                    _ => 0,
                };
                *v = finite.to_ne_bytes();
            }
        }
        Component::F32 => {
            const LARGEST_HALF: u32 = 65504f32.to_bits();
            for v in tile.as_chunks_mut::<4>().0 {
                let bits = u32::from_ne_bytes(*v);
                let finite = match bits & 0x7fff_ffff {
                    0..0x7f80_0000 => bits,
                    0x7f80_0000 => bits & 0x8000_0000 | LARGEST_HALF,
                    _ => 0,
                };
                *v = finite.to_ne_bytes();
            }
        }
    }
}
