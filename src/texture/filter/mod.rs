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
    if s.levels() == 1 {
        return match sampler.filter {
            TextureFilter::Point => point(s, 0, st, sampler.wrap),
            _ if sampler.channels == Channels::Alpha => bilinear(s, 0, st, sampler.wrap),
            _ => bilinear_of::<S, false>(s, 0, st, sampler.wrap),
        };
    }
    filtered(s, st, footprint, sampler)
}

#[inline(never)]
fn filtered<S: TexelSource>(s: &mut S, st: Vec2, footprint: Footprint, sampler: Sampler) -> Vec4 {
    let Footprint { duv_dx: a, duv_dy: b, .. } = footprint;
    let top = s.levels() - 1;
    let wrap = sampler.wrap;
    // log₂ of the finest level's texels per unit; equals the number of levels less one where
    // sides are powers of two, as pbrt's always are.
    let (width, height) = s.size(0);
    let finest = width.max(height) as f32;
    if let TextureFilter::Ewa | TextureFilter::Stochastic = sampler.filter {
        let Some(ellipse) = Ellipse::new(footprint, finest) else { return bilinear(s, 0, st, wrap) };
        return match sampler.filter {
            TextureFilter::Ewa => ewa::ewa(s, st, &ellipse, wrap),
            _ => stochastic::stochastic(s, st, &ellipse, wrap, footprint.random),
        };
    }
    let width = 2.0 * a.abs().max(b.abs()).max_element();
    let level = (finest * width.max(1e-8)).log2();
    if level >= top as f32 {
        return s.texel(top, 0, 0);
    }
    let i = level.max(0.0) as usize;
    match sampler.filter {
        TextureFilter::Point => point(s, i, st, wrap),
        TextureFilter::Trilinear if i > 0 => {
            let t = level - i as f32;
            bilinear(s, i, st, wrap).lerp(bilinear(s, i + 1, st, wrap), t)
        }
        _ => bilinear(s, i, st, wrap),
    }
}

#[inline]
fn wrapped_texel<S: TexelSource>(s: &mut S, level: usize, x: i32, y: i32, wrap: Wrap) -> Vec4 {
    let (width, height) = s.size(level);
    wrap_texel(x, y, width, height, wrap).map_or(Vec4::ZERO, |(x, y)| s.texel(level, x, y))
}

fn point<S: TexelSource>(s: &mut S, level: usize, st: Vec2, wrap: Wrap) -> Vec4 {
    let (width, height) = s.size(level);
    let st = into_range(st, wrap) * Vec2::new(width as f32, height as f32);
    wrapped_texel(s, level, st.x.floor() as i32, st.y.floor() as i32, wrap)
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
    let p = into_range(st, wrap) * Vec2::new(width as f32, height as f32) - 0.5;
    let ((x, tx), (y, ty)) = (split(p.x), split(p.y));
    let t = Vec2::new(tx, ty);
    let (w, h) = (width as i32, height as i32);
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
mod tests;
