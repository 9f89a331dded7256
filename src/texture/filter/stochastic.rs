//! One texel a lookup, drawn so that its expectation is a filtered value: the Gaussian of the
//! elliptical average over the bilinear interpolant of two levels, blended as there (Fajardo et al.
//! 2023, "Stochastic Texture Filtering"; Pharr et al. 2024, "Filtering After Shading"). One
//! number chooses the level, two a place in the ellipse, and two a texel by its bilinear weight.
//!
//! Unbiased for what is linear in a texture. Never draws numbers in turn: they are keyed by the
//! path vertex and the texture, so that textures of one surface are independent of each other.

use super::ellipse::Ellipse;
use super::wrap::into_range;
use super::{TexelSource, wrapped_texel};
use crate::math::{Vec2, Vec3};
use crate::scene::Wrap;
use glam::Vec4;
use std::f32::consts::TAU;

/// Random bits of a texture at a path vertex: `key` names pixel and sample, `p` the vertex.
#[inline]
#[must_use]
pub fn random_bits(key: u32, p: Vec3, texture: u32) -> u64 {
    let [x, y, z] = p.to_array().map(|c| u64::from(c.to_bits()));
    let h = scatter(u64::from(key) << 32 | u64::from(texture));
    scatter(scatter(h ^ (x << 32 | y)) ^ z)
}

/// The finalizer of SplitMix64 (Steele et al. 2014) after a step of its sequence.
#[inline(always)]
fn scatter(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

/// Four numbers in [0, 1).
#[inline(always)]
fn numbers(random: u64) -> [f32; 4] {
    let (a, b) = (scatter(random), scatter(!random));
    // Signed conversion is one instruction, and 24 bits are never negative.
    [a >> 40, a & 0xff_ffff, b >> 40, b & 0xff_ffff].map(|n| n as i32 as f32 * (1.0 / (1 << 24) as f32))
}

/// Squared distance from the ellipse's centre, its edge at 1, whose density in the plane is
/// exp(−2r²) − exp(−2), from a uniform number: the inverse of the distribution as a polynomial in
/// √u, within 2e-7 of it in u.
#[inline(always)]
fn squared_radius(u: f32) -> f32 {
    let w = u.sqrt();
    let p = -0.481_396 + w * (0.250_224_26 + w * (-0.112_231_13 + w * (0.036_542_13 - w * 0.006_175_456)));
    (1.0 - w) * (1.0 + w * p)
}

/// A texel of the footprint.
#[inline(always)]
pub(super) fn stochastic<S: TexelSource>(
    s: &mut S,
    st: Vec2,
    ellipse: &Ellipse,
    wrap: Wrap,
    random: u64,
) -> Vec4 {
    let [u0, u1, u2, u3] = numbers(random);
    let i = (ellipse.level as usize).min(s.levels());
    let t = (ellipse.level - i as f32).clamp(0.0, 1.0);
    // What the choice leaves of its number is uniform again.
    let (level, u0) = if u0 < t { (i + 1, u0 / t) } else { (i, (u0 - t) / (1.0 - t)) };
    if level >= s.levels() {
        return s.texel(s.levels() - 1, 0, 0);
    }
    let (sin, cos) = (TAU * u2).sin_cos();
    let offset = (ellipse.long * cos + ellipse.short * sin) * squared_radius(u3).sqrt();
    let (width, height) = s.size(level);
    let st = match wrap {
        // The offset may lead back to the image; where it gets lost beside `st`, it does not.
        Wrap::Clamp | Wrap::Black => st,
        // Large coordinates would leave the offset no digits.
        Wrap::Repeat | Wrap::OctahedralSphere => into_range(st, wrap),
    };
    let place = into_range(st + offset, wrap) * Vec2::new(width as f32, height as f32);
    let texel = (place - 0.5 + Vec2::new(u0, u1)).floor();
    wrapped_texel(s, level, texel.x as i32, texel.y as i32, wrap)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radii_have_the_distribution_of_the_truncated_gaussian() {
        let e2 = (-2f64).exp();
        // The share of the Gaussian's volume within a radius.
        let within = |q: f64| ((1.0 - (-2.0 * q).exp()) / 2.0 - e2 * q) / ((1.0 - e2) / 2.0 - e2);
        for i in 0..=4096 {
            let u = i as f32 / 4096.0;
            let q = squared_radius(u);
            assert!((0.0..=1.0).contains(&q), "{u}: {q}");
            let error = within(f64::from(q)) - (1.0 - f64::from(u));
            assert!(error.abs() < 5e-7, "{u}: {error}");
        }
    }

    #[test]
    fn numbers_are_uniform_and_independent() {
        // 16 cells a number, 256 a pair, for keys that differ little. Under uniformity the sums of
        // squares are χ² with 255 degrees of freedom; 365 is exceeded once in 10⁵ cases, 6 pairs.
        let n = 1 << 18;
        let all: Vec<[f32; 4]> =
            (0..n).map(|i| numbers(random_bits(i, Vec3::new(1.0, 2.0, 3.0), 7))).collect();
        for (a, b) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            let mut cells = [0.0f64; 256];
            for u in &all {
                cells[(u[a] * 16.0) as usize * 16 + (u[b] * 16.0) as usize] += 1.0;
            }
            let each = f64::from(n) / 256.0;
            let chi2: f64 = cells.iter().map(|c| (c - each) * (c - each) / each).sum();
            assert!(chi2 < 365.0, "numbers {a} and {b}: {chi2}");
        }
        let base = random_bits(1, Vec3::ONE, 1);
        assert!(
            [(2, Vec3::ONE, 1), (1, Vec3::X, 1), (1, Vec3::ONE, 2)]
                .iter()
                .all(|&(k, p, t)| random_bits(k, p, t) != base)
        );
    }
}
