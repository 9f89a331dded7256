//! Transfer curves of integer images: stored number to linear value, and back to the nearest
//! stored number for mip levels. Alpha never goes through a curve.

use crate::scene::Encoding;

/// Linear value of an encoded one, both in 0..1 (sRGB: IEC 61966-2-1).
pub(super) fn decode(encoding: Encoding, v: f64) -> f64 {
    match encoding {
        Encoding::Srgb if v <= 0.04045 => v / 12.92,
        Encoding::Srgb => ((v + 0.055) / 1.055).powf(2.4),
        Encoding::Linear => v,
        Encoding::Gamma(g) => v.powf(f64::from(g)),
    }
}

/// Decoded value of every 8-bit number.
pub(super) fn table8(encoding: Encoding) -> Box<[f32; 256]> {
    Box::new(std::array::from_fn(|i| decode(encoding, i as f64 / 255.0) as f32))
}

/// Decoded value of every 16-bit number.
pub(super) fn table16(encoding: Encoding) -> Vec<f32> {
    (0..=u16::MAX).map(|i| decode(encoding, f64::from(i) / 65535.0) as f32).collect()
}

/// The nearest 8-bit number of a linear value, by a table in place of a power.
pub(super) struct Encoder {
    /// `edges[i]` separates `i` from `i + 1`, in linear space.
    edges: [f32; 255],
    /// Lower bound of the answer for each of 1024 equal steps of the linear value.
    starts: Box<[u8; 1025]>,
}

impl Encoder {
    pub(super) fn new(encoding: Encoding) -> Self {
        // Halfway between numbers as stored: the error is even in the space that was quantised.
        let edges: [f32; 255] = std::array::from_fn(|i| decode(encoding, (i as f64 + 0.5) / 255.0) as f32);
        let starts = std::array::from_fn(|s| {
            let v = s as f32 / 1024.0;
            edges.iter().take_while(|&&e| e <= v).count() as u8
        });
        Self { edges, starts: Box::new(starts) }
    }

    pub(super) fn encode(&self, v: f32) -> u8 {
        let v = v.clamp(0.0, 1.0);
        let mut i = self.starts[(v * 1024.0) as usize] as usize;
        while i < 255 && self.edges[i] <= v {
            i += 1;
        }
        i as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_have_their_known_values() {
        let t = table8(Encoding::Srgb);
        assert_eq!((t[0], t[255]), (0.0, 1.0));
        assert!((t[188] - 0.502_886_5).abs() < 1e-6, "{}", t[188]);
        assert!((t[10] - 10.0 / 255.0 / 12.92).abs() < 1e-9);
        assert!((table8(Encoding::Gamma(2.0))[51] - 0.04).abs() < 1e-7);
        assert!((table16(Encoding::Linear)[257] - 1.0 / 255.0).abs() < 1e-9);
    }

    #[test]
    fn encoding_inverts_decoding_and_rounds_to_the_nearest() {
        for encoding in [Encoding::Srgb, Encoding::Linear, Encoding::Gamma(2.2), Encoding::Gamma(0.4)] {
            let (t, e) = (table8(encoding), Encoder::new(encoding));
            for i in 0..=255u8 {
                assert_eq!(e.encode(t[i as usize]), i, "{encoding:?}");
            }
            assert_eq!((e.encode(-1.0), e.encode(7.0), e.encode(f32::NAN)), (0, 255, 0));
        }
        let e = Encoder::new(Encoding::Linear);
        assert_eq!((e.encode(0.499 / 255.0), e.encode(0.501 / 255.0)), (0, 1));
    }
}
