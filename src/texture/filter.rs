//! Filters over levels: which level a footprint calls for, and what is averaged there. Rules and
//! conventions are pbrt-v4's (pbrt 4th ed., §10.4.3): v = 0 is the bottom row, texel centres are at
//! +½, point and bilinear use one level chosen by the footprint's larger extent, trilinear two, EWA
//! the shorter axis. Values are decoded before they are averaged. Never reads outside a level.

use super::texels::{Level, Memory, Texel};
use crate::math::Vec2;
use crate::scene::{Channels, TextureFilter, Wrap};
use glam::Vec4;
use std::sync::LazyLock;

/// How (u, v) changes to the next pixel in x and in y; zero asks for the finest level.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Footprint {
    /// ∂(u, v)/∂x.
    pub duv_dx: Vec2,
    /// ∂(u, v)/∂y.
    pub duv_dy: Vec2,
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

/// pbrt-v4's default bound on the ratio of an ellipse's axes.
const MAX_ANISOTROPY: f32 = 8.0;
const EWA_STEPS: usize = 128;

/// exp(−2r²) − exp(−2) over r² in 0..1 (Heckbert's Gaussian, truncated at the ellipse).
static EWA_WEIGHTS: LazyLock<[f32; EWA_STEPS]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let r2 = i as f64 / (EWA_STEPS - 1) as f64;
        ((-2.0 * r2).exp() - (-2f64).exp()) as f32
    })
});

/// What a lookup needs of an image.
pub(super) struct View<'a> {
    pub(super) memory: &'a Memory,
    pub(super) levels: &'a [Level],
    pub(super) table: &'a [f32; 256],
}

impl View<'_> {
    /// Filtered linear RGBA at `uv`.
    #[inline(always)]
    pub(super) fn lookup<T: Texel>(&self, uv: Vec2, footprint: Footprint, sampler: Sampler) -> Vec4 {
        let st = Vec2::new(uv.x, 1.0 - uv.y);
        if self.levels.len() == 1 {
            return match sampler.filter {
                TextureFilter::Point => self.point::<T>(0, st, sampler.wrap),
                _ if sampler.channels == Channels::Alpha => self.bilinear::<T>(0, st, sampler.wrap),
                _ => self.bilinear_of::<T>(0, st, sampler.wrap, T::decode_rgb),
            };
        }
        self.filtered::<T>(st, footprint, sampler)
    }

    #[inline(never)]
    fn filtered<T: Texel>(&self, st: Vec2, footprint: Footprint, sampler: Sampler) -> Vec4 {
        let Footprint { duv_dx: a, duv_dy: b } = footprint;
        let top = self.levels.len() - 1;
        let wrap = sampler.wrap;
        // log₂ of the finest level's texels per unit; equals the number of levels less one where
        // sides are powers of two, as pbrt's always are.
        let finest = self.levels[0].width.max(self.levels[0].height) as f32;
        if sampler.filter == TextureFilter::Ewa {
            return self.ewa::<T>(st, a, b, finest, wrap);
        }
        let width = 2.0 * a.abs().max(b.abs()).max_element();
        let level = (finest * width.max(1e-8)).log2();
        if level >= top as f32 {
            return self.texel::<T>(top, 0, 0);
        }
        let i = level.max(0.0) as usize;
        match sampler.filter {
            TextureFilter::Point => self.point::<T>(i, st, wrap),
            TextureFilter::Trilinear if i > 0 => {
                let t = level - i as f32;
                self.bilinear::<T>(i, st, wrap).lerp(self.bilinear::<T>(i + 1, st, wrap), t)
            }
            _ => self.bilinear::<T>(i, st, wrap),
        }
    }

    #[inline(always)]
    fn texel<T: Texel>(&self, level: usize, x: u32, y: u32) -> Vec4 {
        let l = &self.levels[level];
        l.texels::<T>(self.memory)[l.index::<T>(x, y)].decode(self.table)
    }

    fn wrapped_texel<T: Texel>(&self, level: usize, x: i32, y: i32, wrap: Wrap) -> Vec4 {
        let l = &self.levels[level];
        wrap_texel(x, y, l.width, l.height, wrap).map_or(Vec4::ZERO, |(x, y)| self.texel::<T>(level, x, y))
    }

    fn point<T: Texel>(&self, level: usize, st: Vec2, wrap: Wrap) -> Vec4 {
        let l = &self.levels[level];
        let st = into_range(st, wrap) * Vec2::new(l.width as f32, l.height as f32);
        self.wrapped_texel::<T>(level, st.x.floor() as i32, st.y.floor() as i32, wrap)
    }

    #[inline(always)]
    fn bilinear<T: Texel>(&self, level: usize, st: Vec2, wrap: Wrap) -> Vec4 {
        self.bilinear_of::<T>(level, st, wrap, T::decode)
    }

    #[inline(always)]
    fn bilinear_of<T: Texel>(
        &self,
        level: usize,
        st: Vec2,
        wrap: Wrap,
        decode: impl Fn(T, &[f32; 256]) -> Vec4,
    ) -> Vec4 {
        let l = &self.levels[level];
        let p = into_range(st, wrap) * Vec2::new(l.width as f32, l.height as f32) - 0.5;
        let ((x, tx), (y, ty)) = (split(p.x), split(p.y));
        let t = Vec2::new(tx, ty);
        let (w, h) = (l.width as i32, l.height as i32);
        // After `into_range`, only the first and the last texel's halves are outside.
        let (x0, x1, y0, y1) = match wrap {
            Wrap::Repeat => (
                if x < 0 { w - 1 } else { x.min(w - 1) },
                if x >= w - 1 { 0 } else { x + 1 },
                if y < 0 { h - 1 } else { y.min(h - 1) },
                if y >= h - 1 { 0 } else { y + 1 },
            ),
            Wrap::Clamp => (x.max(0), (x + 1).min(w - 1), y.max(0), (y + 1).min(h - 1)),
            _ => return self.bilinear_rare::<T>(level, x, y, t, wrap),
        };
        let texels = l.texels::<T>(self.memory);
        // Written out: as a map over an array this becomes calls.
        let (c0, c1) = (l.column::<T>(x0 as u32), l.column::<T>(x1 as u32));
        let (r0, r1) = (l.row::<T>(y0 as u32), l.row::<T>(y1 as u32));
        let v00 = decode(texels[r0 + c0], self.table);
        let v10 = decode(texels[r0 + c1], self.table);
        let v01 = decode(texels[r1 + c0], self.table);
        let v11 = decode(texels[r1 + c1], self.table);
        let top = v00 + (v10 - v00) * t.x;
        let bottom = v01 + (v11 - v01) * t.x;
        top + (bottom - top) * t.y
    }

    #[inline(never)]
    fn bilinear_rare<T: Texel>(&self, level: usize, x: i32, y: i32, t: Vec2, wrap: Wrap) -> Vec4 {
        let at = |x, y| self.wrapped_texel::<T>(level, x, y, wrap);
        at(x, y).lerp(at(x + 1, y), t.x).lerp(at(x, y + 1).lerp(at(x + 1, y + 1), t.x), t.y)
    }

    fn ewa<T: Texel>(&self, st: Vec2, a: Vec2, b: Vec2, finest: f32, wrap: Wrap) -> Vec4 {
        // v runs up and rows run down.
        let flip = Vec2::new(1.0, -1.0);
        let (a, b) = (a * flip, b * flip);
        let (long, mut short) = if a.length_squared() < b.length_squared() { (b, a) } else { (a, b) };
        let (long_length, mut short_length) = (long.length(), short.length());
        if short_length * MAX_ANISOTROPY < long_length && short_length > 0.0 {
            let scale = long_length / (short_length * MAX_ANISOTROPY);
            short *= scale;
            short_length *= scale;
        }
        // Also when either is NaN: no footprint is the finest level.
        if !(short_length > 0.0 && long_length.is_finite()) {
            return self.bilinear::<T>(0, st, wrap);
        }
        let level = (finest * short_length).log2().max(0.0);
        let i = (level as usize).min(self.levels.len());
        let [v0, v1] = [i, i + 1].map(|i| self.ewa_level::<T>(i, st, long, short, wrap));
        v0.lerp(v1, (level - i as f32).clamp(0.0, 1.0))
    }

    fn ewa_level<T: Texel>(&self, level: usize, st: Vec2, long: Vec2, short: Vec2, wrap: Wrap) -> Vec4 {
        let Some(l) = self.levels.get(level) else {
            // Beyond the last level only one texel is left.
            return self.texel::<T>(self.levels.len() - 1, 0, 0);
        };
        let size = Vec2::new(l.width as f32, l.height as f32);
        let p = into_range(st, wrap) * size - 0.5;
        let (long, short) = (long * size, short * size);
        // The ellipse A s² + B s t + C t² < 1, at least a texel wide (the + 1).
        let mut c = (
            long.y * long.y + short.y * short.y + 1.0,
            -2.0 * (long.x * long.y + short.x * short.y),
            long.x * long.x + short.x * short.x + 1.0,
        );
        let inv_f = 1.0 / (c.0 * c.2 - 0.25 * c.1 * c.1);
        c = (c.0 * inv_f, c.1 * inv_f, c.2 * inv_f);
        let det = 4.0 * c.0 * c.2 - c.1 * c.1;
        let reach = 2.0 / det * Vec2::new((det * c.2).max(0.0).sqrt(), (det * c.0).max(0.0).sqrt());
        // The level bounds the short axis to two texels and the anisotropy the long one to sixteen;
        // only where rounding has run wild is there more.
        let reach = reach.min(Vec2::splat(64.0));
        let (lo, hi) = ((p - reach).ceil(), (p + reach).floor());
        let (mut sum, mut weights) = (Vec4::ZERO, 0.0);
        for y in lo.y as i32..=hi.y as i32 {
            let t = y as f32 - p.y;
            for x in lo.x as i32..=hi.x as i32 {
                let s = x as f32 - p.x;
                let r2 = c.0 * s * s + c.1 * s * t + c.2 * t * t;
                if r2 < 1.0 {
                    let weight = EWA_WEIGHTS[((r2 * EWA_STEPS as f32) as usize).min(EWA_STEPS - 1)];
                    sum += weight * self.wrapped_texel::<T>(level, x, y, wrap);
                    weights += weight;
                }
            }
        }
        if weights > 0.0 { sum / weights } else { self.bilinear::<T>(level, st, wrap) }
    }
}

/// Adding this rounds a number below 2²² to an integer and leaves the integer in the low bits.
/// Conversions and floors cost several instructions each where the processor may be any x86-64.
const ROUND: f32 = 12_582_912.0;

/// An integer and the rest in 0..=1, for numbers within ±2²². Where x is an integer it may come as
/// x − 1 and 1, which interpolates to the same.
#[inline(always)]
fn split(x: f32) -> (i32, f32) {
    let rounded = (x - 0.5) + ROUND;
    (rounded.to_bits().wrapping_sub(ROUND.to_bits()) as i32, x - (rounded - ROUND))
}

/// The fraction in 0..=1; 0 for NaN, and an end of that range where a number has no fraction left.
#[inline(always)]
#[allow(clippy::manual_clamp, reason = "`clamp` keeps NaN; `max` and `min` prefer the number")]
fn fraction(x: f32) -> f32 {
    let f = x - ((x + ROUND) - ROUND);
    (if f < 0.0 { f + 1.0 } else { f }).max(0.0).min(1.0)
}

/// Brings coordinates near the image, and NaN to 0, where that changes nothing: exact for large uv
/// and it makes the texel arithmetic free of division.
#[inline(always)]
fn into_range(st: Vec2, wrap: Wrap) -> Vec2 {
    let (lo, hi) = match wrap {
        Wrap::Repeat => return Vec2::new(fraction(st.x), fraction(st.y)),
        Wrap::Clamp => (0.0, 1.0),
        Wrap::Black | Wrap::OctahedralSphere => (-4.0, 4.0),
    };
    // `f32::max` and `min` prefer the number to the NaN.
    Vec2::new(st.x.max(lo).min(hi), st.y.max(lo).min(hi))
}

fn wrap_texel(x: i32, y: i32, width: u32, height: u32, wrap: Wrap) -> Option<(u32, u32)> {
    let (w, h) = (width as i32, height as i32);
    let (x, y) = match wrap {
        Wrap::Repeat => (x.rem_euclid(w), y.rem_euclid(h)),
        Wrap::Clamp => (x.clamp(0, w - 1), y.clamp(0, h - 1)),
        Wrap::Black if x < 0 || y < 0 || x >= w || y >= h => return None,
        Wrap::Black => (x, y),
        Wrap::OctahedralSphere => {
            // Over an edge one comes back through the same edge, mirrored along it (Clarberg 2008).
            let fold = |a: i32, n: i32| {
                if a < 0 {
                    (-a - 1, true)
                } else if a >= n {
                    (2 * n - 1 - a, true)
                } else {
                    (a, false)
                }
            };
            let ((fx, over_x), (fy, over_y)) = (fold(x, w), fold(y, h));
            let x = if over_y { w - 1 - fx } else { fx };
            let y = if over_x { h - 1 - fy } else { fy };
            (x.clamp(0, w - 1), y.clamp(0, h - 1))
        }
    };
    Some((x as u32, y as u32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wraps_of_single_texels() {
        let at = |x, y, wrap| wrap_texel(x, y, 8, 4, wrap);
        assert_eq!(at(-1, 4, Wrap::Repeat), Some((7, 0)));
        assert_eq!(at(-1, 4, Wrap::Clamp), Some((0, 3)));
        assert_eq!(at(-1, 2, Wrap::Black), None);
        assert_eq!(at(7, 3, Wrap::Black), Some((7, 3)));
        // Across the top edge the sphere continues mirrored about its middle.
        assert_eq!(at(2, -1, Wrap::OctahedralSphere), Some((5, 0)));
        assert_eq!(at(-1, 1, Wrap::OctahedralSphere), Some((0, 2)));
        assert_eq!(at(-1, -1, Wrap::OctahedralSphere), Some((7, 3)));
    }

    #[test]
    fn numbers_split_into_integer_and_rest() {
        for i in -40_000..40_000 {
            let x = i as f32 * 0.125;
            let (n, t) = split(x);
            assert!((0.0..=1.0).contains(&t) && n as f32 + t == x, "{x}: {n} {t}");
            let f = fraction(x);
            assert!((f - (x - x.floor())).abs() % 1.0 == 0.0, "{x}: {f}");
        }
        for x in [f32::NAN, f32::INFINITY, 1e9, -1e9, 1e38, -3e7, 12_582_913.0, 9e6, -1e-30] {
            assert!((0.0..=1.0).contains(&fraction(x)), "{x}");
        }
    }

    #[test]
    fn ewa_weights_end_at_zero() {
        assert!((EWA_WEIGHTS[0] - 0.864_664_7).abs() < 1e-6);
        assert!(EWA_WEIGHTS[EWA_STEPS - 1].abs() < 1e-7);
        assert!(EWA_WEIGHTS.windows(2).all(|w| w[0] > w[1]));
    }
}
