//! Filters over levels: which level a footprint calls for, and what is averaged there. Rules and
//! conventions are pbrt-v4's (pbrt 4th ed., §10.4.3): v = 0 is the bottom row, texel centres are at
//! +½, point and bilinear use one level chosen by the footprint's larger extent, trilinear two,
//! EWA and the stochastic filter two by the shorter axis. Values are decoded before they are
//! averaged. Never reads outside a level, and never knows where texels are: [`TexelSource`] gives
//! them.

mod ellipse;
mod ewa;
mod stochastic;
mod wrap;

use crate::math::Vec2;
use crate::scene::{Channels, TextureFilter, Wrap};
use ellipse::Ellipse;
use glam::Vec4;
use std::ops::Range;
pub use stochastic::random_bits;
use wrap::{into_range, split, wrap_texel};

/// What a lookup averages over: how (u, v) changes to the next pixel in x and in y. Zero asks for
/// the finest level.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Footprint {
    /// ∂(u, v)/∂x.
    pub duv_dx: Vec2,
    /// ∂(u, v)/∂y.
    pub duv_dy: Vec2,
    /// By which the stochastic filter chooses; see [`random_bits`]. The others do not look at it.
    pub random: u64,
}

/// How a texture reads its image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sampler {
    /// Filter between texels and levels.
    pub filter: TextureFilter,
    /// What is outside the image.
    pub wrap: Wrap,
    /// Which numbers.
    pub channels: Channels,
}

/// Where filters get texels from: whole images in memory, or tiles. Same texels, same bits out of
/// every filter.
///
/// Arguments are inside their level; values are linear red, green, blue, and alpha.
pub(super) trait TexelSource {
    /// Number of levels: one, or all down to a single texel.
    fn levels(&self) -> usize;

    /// Width and height of a level in texels.
    fn size(&self, level: usize) -> (u32, u32);

    /// One texel.
    fn texel(&mut self, level: usize, x: u32, y: u32) -> Vec4;

    /// The texels (x₀, y₀), (x₁, y₀), (x₀, y₁), (x₁, y₁).
    fn quad(&mut self, level: usize, x: [u32; 2], y: [u32; 2]) -> [Vec4; 4];

    /// The same, where alpha may be anything.
    #[inline(always)]
    fn quad_rgb(&mut self, level: usize, x: [u32; 2], y: [u32; 2]) -> [Vec4; 4] {
        self.quad(level, x, y)
    }

    /// Some texels of a row to `each`, from left to right.
    #[inline(always)]
    fn run(&mut self, level: usize, x: Range<u32>, y: u32, mut each: impl FnMut(Vec4)) {
        for x in x {
            each(self.texel(level, x, y));
        }
    }
}

/// Filtered linear RGBA at `uv`; alpha may be anything unless `sampler` asks for it.
#[inline(always)]
pub(super) fn lookup<S: TexelSource>(s: &mut S, uv: Vec2, footprint: Footprint, sampler: Sampler) -> Vec4 {
    let st = Vec2::new(uv.x, 1.0 - uv.y);
    match sampler.filter {
        TextureFilter::Ewa | TextureFilter::Stochastic => anisotropic(s, st, footprint, sampler),
        _ if sampler.channels == Channels::Alpha => isotropic_alpha(s, st, footprint, sampler),
        _ => isotropic::<S, false>(s, st, footprint, sampler),
    }
}

#[inline(never)]
fn isotropic_alpha<S: TexelSource>(s: &mut S, st: Vec2, footprint: Footprint, sampler: Sampler) -> Vec4 {
    isotropic::<S, true>(s, st, footprint, sampler)
}

/// The longer side of the finest level in texels, whose log₂ counts levels; it equals their number
/// less one where sides are powers of two, as pbrt's always are.
#[inline(always)]
fn finest(s: &impl TexelSource) -> f32 {
    let (width, height) = s.size(0);
    // Signed conversion is one instruction, and sides are less than 2³¹.
    width.max(height) as i32 as f32
}

#[inline(always)]
fn isotropic<S: TexelSource, const ALPHA: bool>(
    s: &mut S,
    st: Vec2,
    footprint: Footprint,
    sampler: Sampler,
) -> Vec4 {
    let wrap = sampler.wrap;
    let (a, b) = (footprint.duv_dx.abs(), footprint.duv_dy.abs());
    let larger = |a: f32, b: f32| if a > b { a } else { b };
    let texels = 2.0 * finest(s) * larger(larger(a.x, a.y), larger(b.x, b.y));
    let (mut level, mut t) = (0, 0.0);
    // False for NaN. Between the finest two levels pbrt-v4 reads the finest alone, whatever the filter.
    if texels >= 2.0 {
        let top = s.levels() - 1;
        let i;
        (i, t) = log2(texels);
        level = i.min(top);
        if level == top {
            if top > 0 {
                return s.texel(top, 0, 0);
            }
            t = 0.0;
        }
    }
    if sampler.filter == TextureFilter::Point {
        return point(s, level, st, wrap);
    }
    let fine = bilinear_of::<S, ALPHA>(s, level, st, wrap);
    if t > 0.0 && sampler.filter == TextureFilter::Trilinear {
        return fine.lerp(bilinear_of::<S, ALPHA>(s, level + 1, st, wrap), t);
    }
    fine
}

/// log₂ of a number not less than 1, as an integer and a rest in 0..=1: by the exponent's bits, and a
/// polynomial that is exact at both ends and within 8e-6 between. The same bits on every machine.
#[inline(always)]
fn log2(x: f32) -> (usize, f32) {
    let bits = x.to_bits();
    let f = f32::from_bits(bits & 0x7f_ffff | 0x3f80_0000) - 1.0;
    let p = 0.442_654_07 + f * (-0.276_569_5 + f * (0.184_100_83 + f * (-0.097_201_83 + f * 0.025_691_263)));
    ((bits >> 23) as usize - 127, f + f * (1.0 - f) * p)
}

#[inline(never)]
fn anisotropic<S: TexelSource>(s: &mut S, st: Vec2, footprint: Footprint, sampler: Sampler) -> Vec4 {
    let wrap = sampler.wrap;
    if s.levels() == 1 {
        return bilinear(s, 0, st, wrap);
    }
    let Some(ellipse) = Ellipse::new(footprint, finest(s)) else { return bilinear(s, 0, st, wrap) };
    match sampler.filter {
        TextureFilter::Ewa => ewa::ewa(s, st, &ellipse, wrap),
        _ => stochastic::stochastic(s, st, &ellipse, wrap, footprint.random),
    }
}

#[inline(always)]
fn wrapped_texel<S: TexelSource>(s: &mut S, level: usize, x: i32, y: i32, wrap: Wrap) -> Vec4 {
    let (width, height) = s.size(level);
    wrap_texel(x, y, width, height, wrap).map_or(Vec4::ZERO, |(x, y)| s.texel(level, x, y))
}

#[inline(always)]
fn point<S: TexelSource>(s: &mut S, level: usize, st: Vec2, wrap: Wrap) -> Vec4 {
    let (width, height) = s.size(level);
    let (w, h) = (width as i32, height as i32);
    let st = into_range(st, wrap) * Vec2::new(w as f32, h as f32);
    match wrap {
        // Not negative, so that what conversion cuts off is the fraction.
        Wrap::Repeat | Wrap::Clamp => {
            let (x, y) = (st.x as i32, st.y as i32);
            // One where the fraction rounds to 1.
            let beyond = if wrap == Wrap::Repeat { (0, 0) } else { (w - 1, h - 1) };
            let x = if x >= w { beyond.0 } else { x };
            let y = if y >= h { beyond.1 } else { y };
            s.texel(level, x as u32, y as u32)
        }
        _ => wrapped_texel(s, level, st.x.floor() as i32, st.y.floor() as i32, wrap),
    }
}

#[inline(always)]
fn bilinear<S: TexelSource>(s: &mut S, level: usize, st: Vec2, wrap: Wrap) -> Vec4 {
    bilinear_of::<S, true>(s, level, st, wrap)
}

/// Bilinear in one level; alpha may be anything.
#[inline(always)]
pub(super) fn bilinear_rgb<S: TexelSource>(s: &mut S, level: usize, st: Vec2, wrap: Wrap) -> Vec4 {
    bilinear_of::<S, false>(s, level, st, wrap)
}

#[inline(always)]
fn bilinear_of<S: TexelSource, const ALPHA: bool>(s: &mut S, level: usize, st: Vec2, wrap: Wrap) -> Vec4 {
    let (width, height) = s.size(level);
    let (w, h) = (width as i32, height as i32);
    let p = into_range(st, wrap) * Vec2::new(w as f32, h as f32) - 0.5;
    let ((x, tx), (y, ty)) = (split(p.x), split(p.y));
    let t = Vec2::new(tx, ty);
    // After `into_range`, only the first and the last texel's halves are outside.
    let (x0, x1, y0, y1) = match wrap {
        Wrap::Repeat => (
            if x < 0 { w - 1 } else { x.min(w - 1) },
            if x >= w - 1 { 0 } else { x + 1 },
            if y < 0 { h - 1 } else { y.min(h - 1) },
            if y >= h - 1 { 0 } else { y + 1 },
        ),
        Wrap::Clamp => (x.max(0), (x + 1).min(w - 1), y.max(0), (y + 1).min(h - 1)),
        _ => return bilinear_rare(s, level, x, y, t, wrap),
    };
    let (x, y) = ([x0 as u32, x1 as u32], [y0 as u32, y1 as u32]);
    let [v00, v10, v01, v11] = if ALPHA { s.quad(level, x, y) } else { s.quad_rgb(level, x, y) };
    let top = v00 + (v10 - v00) * t.x;
    let bottom = v01 + (v11 - v01) * t.x;
    top + (bottom - top) * t.y
}

#[inline(never)]
fn bilinear_rare<S: TexelSource>(s: &mut S, level: usize, x: i32, y: i32, t: Vec2, wrap: Wrap) -> Vec4 {
    let mut at = |x, y| wrapped_texel(s, level, x, y, wrap);
    let (top, bottom) = ([at(x, y), at(x + 1, y)], [at(x, y + 1), at(x + 1, y + 1)]);
    top[0].lerp(top[1], t.x).lerp(bottom[0].lerp(bottom[1], t.x), t.y)
}

/// Every filter, for tests that hold for all of them.
#[cfg(test)]
pub(super) const FILTERS: [TextureFilter; 5] = [
    TextureFilter::Point,
    TextureFilter::Bilinear,
    TextureFilter::Trilinear,
    TextureFilter::Ewa,
    TextureFilter::Stochastic,
];

#[cfg(test)]
mod integrals;
#[cfg(test)]
mod outside;
#[cfg(test)]
mod tests;
