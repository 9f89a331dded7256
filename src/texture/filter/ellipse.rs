//! The ellipse that a footprint stands for, and the level that fits its shorter axis; what the
//! anisotropic filters have in common. Always finite; never thinner than a bound, so that what a
//! filter reads is bounded for every footprint.

use super::{Footprint, log2};
use crate::math::Vec2;

/// Bound on the ratio of an ellipse's axes. Thinner ones are widened to it, as in pbrt-v4, whose
/// bound is 8; at 32 an average reads at most 1000 texels.
pub(super) const MAX_ANISOTROPY: f32 = 32.0;

/// A footprint in image coordinates: rows run down, the finest level is 1 × 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ellipse {
    /// Conjugate half-axes; where they are perpendicular, the axes themselves.
    pub(super) long: Vec2,
    pub(super) short: Vec2,
    /// Level whose texels are as wide as the shorter half-axis, or up to half of it; 0 or more.
    pub(super) level: f32,
}

impl Ellipse {
    /// `finest` is the finest level's longer side in texels. `None` where there is no footprint or
    /// it is not a number.
    #[inline(always)]
    pub(super) fn new(footprint: Footprint, finest: f32) -> Option<Self> {
        // v runs up and rows run down.
        let flip = Vec2::new(1.0, -1.0);
        let (a, b) = (footprint.duv_dx * flip, footprint.duv_dy * flip);
        let (a2, b2) = (a.length_squared(), b.length_squared());
        // Not by `max` and `min`, which would hide a NaN.
        let (long, long2, mut short, short2) = if a2 < b2 { (b, b2, a, a2) } else { (a, a2, b, b2) };
        // Also false where one is NaN.
        if !(long2 > 0.0 && short2 >= 0.0) {
            return None;
        }
        // Larger than any level, of whatever shape: the bound on that widens it.
        if long2 == f32::INFINITY {
            return Some(Self { long: Vec2::ZERO, short: Vec2::ZERO, level: f32::MAX });
        }
        let (long_length, mut short_length) = (long2.sqrt(), short2.sqrt());
        let least = long_length * (1.0 / MAX_ANISOTROPY);
        if short_length < least {
            short = if short_length > 0.0 {
                short * (least / short_length)
            } else {
                long.perp() * (1.0 / MAX_ANISOTROPY)
            };
            short_length = least;
        }
        let texels = finest * short_length;
        // False for NaN.
        let level = if texels > 1.0 {
            let (i, t) = log2(texels);
            i as f32 + t
        } else {
            0.0
        };
        Some(Self { long, short, level })
    }
}
