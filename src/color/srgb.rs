//! The sRGB transfer function, both ways. Never changes primaries, never tone-maps.

use std::sync::LazyLock;

/// Linear value of an sRGB-encoded one in [0, 1] (IEC 61966-2-1); negative input mirrors.
#[inline]
#[must_use]
pub fn to_linear(encoded: f32) -> f32 {
    let a = encoded.abs();
    let linear = if a <= 0.04045 { a / 12.92 } else { ((a + 0.055) / 1.055).powf(2.4) };
    linear.copysign(encoded)
}

/// sRGB-encoded value of a linear one (IEC 61966-2-1); negative input mirrors.
#[inline]
#[must_use]
pub fn from_linear(linear: f32) -> f32 {
    let a = linear.abs();
    let encoded = if a <= 0.003_130_8 { a * 12.92 } else { 1.055 * a.powf(1.0 / 2.4) - 0.055 };
    encoded.copysign(linear)
}

/// The linear values of the 256 byte codes.
#[must_use]
pub fn byte_table() -> &'static [f32; 256] {
    static TABLE: LazyLock<[f32; 256]> =
        LazyLock::new(|| std::array::from_fn(|i| to_linear(i as f32 / 255.0)));
    &TABLE
}

/// Linear value of a byte code.
#[inline]
#[must_use]
pub fn byte_to_linear(code: u8) -> f32 {
    byte_table()[usize::from(code)]
}

/// Nearest byte code of a linear value; values outside [0, 1] clamp, NaN becomes 0.
#[inline]
#[must_use]
pub fn linear_to_byte(linear: f32) -> u8 {
    // The cast saturates and sends NaN to 0.
    (from_linear(linear) * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        assert!((to_linear(0.5) - 0.214_041).abs() < 1e-6);
        assert!((from_linear(0.18) - 0.461_356).abs() < 1e-6);
        assert_eq!((to_linear(0.0), to_linear(1.0), from_linear(0.0)), (0.0, 1.0, 0.0));
        assert!((from_linear(1.0) - 1.0).abs() < 1e-6);
        assert_eq!(from_linear(-0.18), -from_linear(0.18));
    }

    #[test]
    fn bytes_survive_the_round_trip() {
        for code in 0..=255u8 {
            assert_eq!(linear_to_byte(byte_to_linear(code)), code);
        }
        assert_eq!((linear_to_byte(f32::NAN), linear_to_byte(-1.0), linear_to_byte(9.0)), (0, 0, 255));
    }
}
