//! Linear RGB (Rec. 709 primaries, D65 white), spectra reduced to it, and transfer curves.

use glam::Vec3;

pub mod conductor;
mod data;
mod named;
pub mod spectrum;
pub mod srgb;

/// Linear RGB; also any per-channel factor.
pub type Rgb = Vec3;

/// Luminance of linear Rec. 709 RGB.
#[inline(always)]
#[must_use]
pub fn luminance(c: Rgb) -> f32 {
    0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z
}
