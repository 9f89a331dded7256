//! Floats and error bounds, frames, transforms, sampling warps. Knows no scene.

mod frame;
mod prefetch;
mod transform;
pub mod warp;

pub use frame::Frame;
pub use glam::{DMat4, DVec3, Vec2, Vec3};
pub use prefetch::prefetch;
pub use transform::Transform;

/// 1/π.
pub const INV_PI: f32 = std::f32::consts::FRAC_1_PI;
/// 1/(4π).
pub const INV_4PI: f32 = 0.25 * std::f32::consts::FRAC_1_PI;

/// Bound on the relative error of `n` rounded f32 operations in turn, γₙ = nε/(1−nε)
/// (Higham 2002, §3.1; pbrt 4th ed., §6.8.1).
#[must_use]
pub const fn gamma(n: u32) -> f32 {
    let ne = n as f32 * (f32::EPSILON * 0.5);
    ne / (1.0 - ne)
}

/// The square.
#[inline(always)]
#[must_use]
pub fn sqr(x: f32) -> f32 {
    x * x
}

/// √max(x, 0): for arguments that only rounding makes negative.
#[inline(always)]
#[must_use]
pub fn safe_sqrt(x: f32) -> f32 {
    x.max(0.0).sqrt()
}

/// Linear interpolation.
#[inline(always)]
#[must_use]
pub fn lerp(t: f32, a: f32, b: f32) -> f32 {
    (1.0 - t) * a + t * b
}

/// The next f32 towards +∞ (pbrt 4th ed., §6.8.1); infinities and NaN stay.
#[inline(always)]
#[must_use]
pub fn next_float_up(v: f32) -> f32 {
    v.next_up()
}

/// The next f32 towards −∞.
#[inline(always)]
#[must_use]
pub fn next_float_down(v: f32) -> f32 {
    v.next_down()
}
