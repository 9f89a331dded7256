//! What becomes of a file's numbers: how many channels are kept, at which precision, and which
//! value each texel gets. Images in memory and converted files both go through here, so that a
//! picture does not depend on which of them a texture came from.
//!
//! Invariant: what is kept depends on the pixels and the encoding alone. Never opens a file, never
//! lays out memory.

use super::encoding::{self, Encoder};
use super::image_io::Pixels;
use super::texels::Texel;
use crate::scene::Encoding;
use glam::Vec4;
use half::f16;
use rayon::prelude::*;

/// How the texels of an image are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Rgba8,
    Grey8,
    RgbaHalf,
    GreyHalf,
    RgbaFloat,
    GreyFloat,
}

/// Numbers as a file stores them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Depth {
    U8,
    U16,
    F16,
    F32,
}

impl Depth {
    /// Bytes of one number.
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 | Self::F16 => 2,
            Self::F32 => 4,
        }
    }
}

/// A number as a file stores it.
pub(super) trait Sample: Copy + Send + Sync + 'static {
    /// The numbers of `pixels`, none if they are of another kind.
    fn of(pixels: &Pixels) -> &[Self];
}

macro_rules! sample {
    ($t:ty, $kind:ident) => {
        impl Sample for $t {
            fn of(pixels: &Pixels) -> &[Self] {
                if let Pixels::$kind(v) = pixels { v } else { &[] }
            }
        }
    };
}
sample!(u8, U8);
sample!(u16, U16);
sample!(f16, F16);
sample!(f32, F32);

impl Pixels {
    pub(super) fn depth(&self) -> Depth {
        match self {
            Self::U8(_) => Depth::U8,
            Self::U16(_) => Depth::U16,
            Self::F16(_) => Depth::F16,
            Self::F32(_) => Depth::F32,
        }
    }
}

/// What only a look at all pixels tells. Parts of an image are looked at apart and merged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Facts {
    /// Alpha says something: like pbrt, an image that is opaque throughout has none.
    pub(super) translucent: bool,
    /// Every finite float is a half: Radiance HDR and many EXR files carry no more.
    pub(super) halves: bool,
}

impl Facts {
    /// Of no pixel at all.
    pub(super) const NONE: Self = Self { translucent: false, halves: true };

    /// Of whole pixels of `channels` numbers.
    pub(super) fn of(pixels: &Pixels, channels: u8) -> Self {
        fn any<T: Sync>(v: &[T], n: usize, below: impl Fn(&T) -> bool + Sync) -> bool {
            v.par_chunks_exact(n).with_min_len(4096).any(|p| below(&p[n - 1]))
        }
        let n = channels as usize;
        let translucent = n.is_multiple_of(2)
            && match pixels {
                Pixels::U8(v) => any(v, n, |&a| a < 255),
                Pixels::U16(v) => any(v, n, |&a| a < u16::MAX),
                Pixels::F16(v) => any(v, n, |a| a.to_f32() != 1.0),
                Pixels::F32(v) => any(v, n, |&a| a != 1.0),
            };
        let exact = |x: &f32| !x.is_finite() || f16::from_f32(*x).to_f32() == *x;
        let halves = match pixels {
            Pixels::F32(v) => v.par_iter().with_min_len(4096).all(exact),
            _ => true,
        };
        Self { translucent, halves }
    }

    /// Of two parts together.
    pub(super) fn and(self, other: Self) -> Self {
        let Self { translucent, halves } = other;
        Self { translucent: self.translucent || translucent, halves: self.halves && halves }
    }
}

/// Pixels that have an infinite number or none at all in them.
pub(super) fn non_finite(pixels: &Pixels, channels: u8) -> u64 {
    let n = channels as usize;
    let count = match pixels {
        Pixels::U8(_) | Pixels::U16(_) => 0,
        Pixels::F16(v) => {
            v.par_chunks_exact(n).with_min_len(4096).filter(|p| !p.iter().all(|x| x.is_finite())).count()
        }
        Pixels::F32(v) => {
            v.par_chunks_exact(n).with_min_len(4096).filter(|p| !p.iter().all(|x| x.is_finite())).count()
        }
    };
    count as u64
}

/// Everything that decides what is kept.
pub(super) struct Rules {
    /// Numbers a pixel: 1 grey, 2 grey and alpha, 3 RGB, 4 RGBA.
    pub(super) channels: u8,
    pub(super) depth: Depth,
    pub(super) facts: Facts,
    /// Of integer numbers.
    pub(super) encoding: Encoding,
    /// 8-bit numbers become linear halves, for files that have no 8-bit kind.
    pub(super) linear_halves: bool,
}

/// Whoever makes something of an image's texels.
pub(super) trait Build {
    type Out;
    /// `convert` makes a texel of one pixel's numbers, `encode` of a filtered linear value; `table`
    /// decodes 8-bit texels.
    fn build<S: Sample, T: Texel>(
        self,
        kind: Kind,
        rules: &Rules,
        table: Box<[f32; 256]>,
        convert: impl Fn(&[S]) -> T + Sync,
        encode: impl Fn(Vec4) -> T + Sync,
    ) -> Self::Out;
}

impl Rules {
    /// Calls `b` with the texels that these rules choose.
    pub(super) fn build<B: Build>(&self, b: B) -> B::Out {
        // An opaque alpha beside grey is not worth three more numbers.
        let grey = self.channels == 1 || (self.channels == 2 && !self.facts.translucent);
        match self.depth {
            Depth::U8 if self.linear_halves => {
                let t = encoding::table8(self.encoding);
                let color = |x: u8| f16::from_f32(t[x as usize]).to_bits();
                if grey {
                    return b.build(Kind::GreyHalf, self, no_table(), |p| color(p[0]), half_grey);
                }
                let convert = |p: &[u8]| {
                    let [r, g, b, a] = rgba(p, u8::MAX);
                    [color(r), color(g), color(b), f16::from_f32(f32::from(a) * (1.0 / 255.0)).to_bits()]
                };
                b.build(Kind::RgbaHalf, self, no_table(), convert, half_rgba)
            }
            Depth::U8 => {
                let table = encoding::table8(self.encoding);
                let e = Encoder::new(self.encoding);
                if grey {
                    return b.build(Kind::Grey8, self, table, |p: &[u8]| p[0], |c| e.encode(c.x));
                }
                let alpha = |a: f32| (a * 255.0 + 0.5) as u8;
                let encode = |c: Vec4| [e.encode(c.x), e.encode(c.y), e.encode(c.z), alpha(c.w)];
                b.build(Kind::Rgba8, self, table, |p| rgba(p, u8::MAX), encode)
            }
            Depth::U16 => {
                let t = encoding::table16(self.encoding);
                let color = |x: u16| f16::from_f32(t[x as usize]).to_bits();
                if grey {
                    return b.build(Kind::GreyHalf, self, no_table(), |p| color(p[0]), half_grey);
                }
                let convert = |p: &[u16]| {
                    let [r, g, b, a] = rgba(p, u16::MAX);
                    [color(r), color(g), color(b), f16::from_f32(f32::from(a) / 65535.0).to_bits()]
                };
                b.build(Kind::RgbaHalf, self, no_table(), convert, half_rgba)
            }
            Depth::F16 => {
                let clean = |x: f16| if x.is_finite() { x.to_bits() } else { finite_half(x.to_f32()) };
                if grey {
                    return b.build(Kind::GreyHalf, self, no_table(), |p| clean(p[0]), half_grey);
                }
                b.build(Kind::RgbaHalf, self, no_table(), |p| rgba(p, f16::ONE).map(clean), half_rgba)
            }
            Depth::F32 => match (self.facts.halves, grey) {
                (true, true) => b.build(Kind::GreyHalf, self, no_table(), |p| finite_half(p[0]), half_grey),
                (true, false) => {
                    let convert = |p: &[f32]| rgba(p, 1.0).map(finite_half);
                    b.build(Kind::RgbaHalf, self, no_table(), convert, half_rgba)
                }
                (false, true) => b.build(Kind::GreyFloat, self, no_table(), |p| finite(p[0]), |c| c.x),
                (false, false) => {
                    let convert = |p: &[f32]| rgba(p, 1.0).map(finite);
                    b.build(Kind::RgbaFloat, self, no_table(), convert, |c| c.to_array())
                }
            },
        }
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
