//! The sRGB transfer curve (IEC 61966-2-1), for 8-bit images out. Never tone maps: what is above
//! one is clipped.

/// sRGB-encoded value of linear `x`, both in [0, 1]; outside, `x` is clipped, and NaN becomes 0.
#[must_use]
pub fn srgb_from_linear(x: f32) -> f32 {
    // `max` returns its other argument for NaN.
    let x = x.max(0.0).min(1.0);
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// Linear value of the sRGB-encoded `x`, both in [0, 1].
#[must_use]
pub fn linear_from_srgb(x: f32) -> f32 {
    if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

/// Nearest 8-bit sRGB code of linear `x`; clips, and NaN becomes 0.
#[must_use]
pub fn srgb8_from_linear(x: f32) -> u8 {
    (255.0 * srgb_from_linear(x) + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_codes() {
        // Middle grey 0.18 is code 118; 0.5 is 188; 0.214 is 127.5 within rounding (sRGB tables).
        for (linear, code) in [
            (0.0, 0),
            (1.0, 255),
            (0.18, 118),
            (0.5, 188),
            (0.003_130_8, 10),
            (1.0 / 255.0 / 12.92, 1),
            (0.49 / 255.0 / 12.92, 0),
            (0.51 / 255.0 / 12.92, 1),
            (7.0, 255),
            (-1.0, 0),
            (f32::INFINITY, 255),
            (f32::NEG_INFINITY, 0),
            (f32::NAN, 0),
        ] {
            assert_eq!(srgb8_from_linear(linear), code, "of {linear}");
        }
    }

    #[test]
    fn every_code_survives_a_round_trip() {
        for code in 0..=255u8 {
            assert_eq!(srgb8_from_linear(linear_from_srgb(f32::from(code) / 255.0)), code);
        }
    }
}
