//! The elliptical weighted average (Heckbert 1989; pbrt 4th ed., §10.4.4): a Gaussian over the
//! footprint's ellipse, on the two levels about its shorter axis. Never reads a texel outside the
//! ellipse, and the number of texels is bounded for every footprint.

use super::wrap::into_range;
use super::{Footprint, TexelSource, bilinear, wrapped_texel};
use crate::math::Vec2;
use crate::scene::Wrap;
use glam::Vec4;
use std::sync::LazyLock;

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

/// Average over the footprint; `finest` is the finest level's longer side in texels.
pub(super) fn ewa<S: TexelSource>(
    s: &mut S,
    st: Vec2,
    footprint: Footprint,
    finest: f32,
    wrap: Wrap,
) -> Vec4 {
    // v runs up and rows run down.
    let flip = Vec2::new(1.0, -1.0);
    let (a, b) = (footprint.duv_dx * flip, footprint.duv_dy * flip);
    let (long, mut short) = if a.length_squared() < b.length_squared() { (b, a) } else { (a, b) };
    let (long_length, mut short_length) = (long.length(), short.length());
    if short_length * MAX_ANISOTROPY < long_length && short_length > 0.0 {
        let scale = long_length / (short_length * MAX_ANISOTROPY);
        short *= scale;
        short_length *= scale;
    }
    // Also when either is NaN: no footprint is the finest level.
    if !(short_length > 0.0 && long_length.is_finite()) {
        return bilinear(s, 0, st, wrap);
    }
    let level = (finest * short_length).log2().max(0.0);
    let i = (level as usize).min(s.levels());
    let [v0, v1] = [i, i + 1].map(|i| ewa_level(s, i, st, long, short, wrap));
    v0.lerp(v1, (level - i as f32).clamp(0.0, 1.0))
}

fn ewa_level<S: TexelSource>(s: &mut S, level: usize, st: Vec2, long: Vec2, short: Vec2, wrap: Wrap) -> Vec4 {
    if level >= s.levels() {
        // Beyond the last level only one texel is left.
        return s.texel(s.levels() - 1, 0, 0);
    }
    let (width, height) = s.size(level);
    let size = Vec2::new(width as f32, height as f32);
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
        let dy = y as f32 - p.y;
        for x in lo.x as i32..=hi.x as i32 {
            let dx = x as f32 - p.x;
            let r2 = c.0 * dx * dx + c.1 * dx * dy + c.2 * dy * dy;
            if r2 < 1.0 {
                let weight = EWA_WEIGHTS[((r2 * EWA_STEPS as f32) as usize).min(EWA_STEPS - 1)];
                sum += weight * wrapped_texel(s, level, x, y, wrap);
                weights += weight;
            }
        }
    }
    if weights > 0.0 { sum / weights } else { bilinear(s, level, st, wrap) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ewa_weights_end_at_zero() {
        assert!((EWA_WEIGHTS[0] - 0.864_664_7).abs() < 1e-6);
        assert!(EWA_WEIGHTS[EWA_STEPS - 1].abs() < 1e-7);
        assert!(EWA_WEIGHTS.windows(2).all(|w| w[0] > w[1]));
    }
}
