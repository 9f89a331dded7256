//! The elliptical weighted average (Heckbert 1989; pbrt 4th ed., §10.4.4): a Gaussian over the
//! footprint's ellipse, on the two levels about its shorter axis. Never reads a texel outside the
//! ellipse, and the number of texels is bounded for every footprint.

use super::ellipse::{Ellipse, MAX_ANISOTROPY};
use super::wrap::centre;
use super::{TexelSource, bilinear, wrapped_texel};
use crate::math::Vec2;
use crate::scene::Wrap;
use glam::Vec4;

/// exp(−2r²) − exp(−2) over r² in 0..=1 within 7e-5 (Heckbert's Gaussian, truncated at the ellipse);
/// a polynomial fitted so that it ends at zero.
#[inline(always)]
fn weight(r2: f32) -> f32 {
    let q = r2.clamp(0.0, 1.0);
    (1.0 - q) * (0.864_598_2 + q * (-1.131_99 + q * (0.836_994_7 + q * (-0.385_335_6 + q * 0.086_452_94))))
}

/// Average over the footprint.
pub(super) fn ewa<S: TexelSource>(s: &mut S, st: Vec2, ellipse: &Ellipse, wrap: Wrap) -> Vec4 {
    let i = (ellipse.level as usize).min(s.levels());
    let t = (ellipse.level - i as f32).clamp(0.0, 1.0);
    let fine = one_level(s, i, st, ellipse, wrap);
    if t == 0.0 { fine } else { fine.lerp(one_level(s, i + 1, st, ellipse, wrap), t) }
}

#[inline(never)]
fn one_level<S: TexelSource>(s: &mut S, level: usize, st: Vec2, ellipse: &Ellipse, wrap: Wrap) -> Vec4 {
    if level >= s.levels() {
        // Beyond the last level only one texel is left.
        return s.texel(s.levels() - 1, 0, 0);
    }
    let (width, height) = s.size(level);
    let size = Vec2::new(width as f32, height as f32);
    let (long, short) = (ellipse.long * size, ellipse.short * size);
    // The ellipse a x² + b x y + c y² < 1, wider than the footprint by a texel's own extent (the + 1,
    // which also keeps it from falling between texels).
    let (a, c) = (long.y * long.y + short.y * short.y + 1.0, long.x * long.x + short.x * short.x + 1.0);
    let b = -2.0 * (long.x * long.y + short.x * short.y);
    let scale = 1.0 / (a * c - 0.25 * b * b);
    // The level bounds the short axis to two texels, and so the long one; there is more only where
    // rounding has run wild.
    let most = Vec2::splat(2.0 * MAX_ANISOTROPY + 2.0);
    let reach = Vec2::new(c.sqrt(), a.sqrt()).min(most);
    let p = centre(st, size, reach, wrap);
    let (a, b, c) = (a * scale, b * scale, c * scale);
    let half = 0.5 / a;
    let (mut sum, mut weights) = (Vec4::ZERO, 0.0);
    for y in (p.y - reach.y).ceil() as i32..=(p.y + reach.y).floor() as i32 {
        let dy = y as f32 - p.y;
        // Where the row enters and leaves the ellipse.
        let (b, c) = (b * dy, c * dy * dy);
        let root = (b * b - 4.0 * a * (c - 1.0)).max(0.0).sqrt() * half;
        let middle = p.x - b * half;
        let x0 = (middle - root).max(p.x - reach.x).ceil();
        let (x1, y1) = ((middle + root).min(p.x + reach.x).floor() as i32 + 1, y as u32);
        let mut dx = x0 - p.x;
        let mut add = |texel: Vec4| {
            let w = weight((a * dx + b) * dx + c);
            sum += w * texel;
            weights += w;
            dx += 1.0;
        };
        let x0 = x0 as i32;
        if x0 >= 0 && x1 <= width as i32 && y >= 0 && y < height as i32 {
            s.run(level, x0 as u32..x1 as u32, y1, add);
        } else {
            (x0..x1).for_each(|x| add(wrapped_texel(s, level, x, y, wrap)));
        }
    }
    // Where every texel lies on the ellipse's edge.
    if weights > 0.0 { sum / weights } else { bilinear(s, level, st, wrap) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_those_of_the_truncated_gaussian() {
        for i in 0..=1000 {
            let r2 = f64::from(i) / 1000.0;
            let want = (-2.0 * r2).exp() - (-2f64).exp();
            assert!((f64::from(weight(r2 as f32)) - want).abs() < 7e-5, "{r2}");
        }
        assert_eq!(weight(1.0), 0.0);
        assert_eq!(weight(1.1), 0.0);
    }
}
