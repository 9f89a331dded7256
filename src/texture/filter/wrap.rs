//! Texture coordinates to texels: what is outside the image, and arithmetic that holds for any
//! number. Every result is inside the image; never divides by a size, never reads a texel.

use crate::math::Vec2;
use crate::scene::Wrap;

/// Adding this rounds a number below 2²² to an integer and leaves the integer in the low bits.
/// Conversions and floors cost several instructions each where the processor may be any x86-64.
const ROUND: f32 = 12_582_912.0;

/// An integer and the rest in 0..=1, for numbers within ±2²². Where x is an integer it may come as
/// x − 1 and 1, which interpolates to the same.
#[inline(always)]
pub(super) fn split(x: f32) -> (i32, f32) {
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
/// and it makes the texel arithmetic free of division. For a look-up at a point only: what is beyond a
/// clamped edge is one colour, but not all that an ellipse about it covers.
#[inline(always)]
pub(super) fn into_range(st: Vec2, wrap: Wrap) -> Vec2 {
    let (lo, hi) = match wrap {
        Wrap::Repeat => return Vec2::new(fraction(st.x), fraction(st.y)),
        Wrap::Clamp => (0.0, 1.0),
        Wrap::Black | Wrap::OctahedralSphere => (-4.0, 4.0),
    };
    // `f32::max` and `min` prefer the number to the NaN.
    Vec2::new(st.x.max(lo).min(hi), st.y.max(lo).min(hi))
}

/// `st` in texels of a level of `size`, centres at integers, for what reads texels up to `reach`
/// away from there. Moved, and NaN too, only where all of those are off the image.
#[inline(always)]
pub(super) fn centre(st: Vec2, size: Vec2, reach: Vec2, wrap: Wrap) -> Vec2 {
    if matches!(wrap, Wrap::Repeat | Wrap::OctahedralSphere) {
        return into_range(st, wrap) * size - 0.5;
    }
    let (p, lo, hi) = (st * size - 0.5, -1.0 - reach, size + reach);
    Vec2::new(p.x.max(lo.x).min(hi.x), p.y.max(lo.y).min(hi.y))
}

pub(super) fn wrap_texel(x: i32, y: i32, width: u32, height: u32, wrap: Wrap) -> Option<(u32, u32)> {
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
}
