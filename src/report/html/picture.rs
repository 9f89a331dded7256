//! The image inside the page: as our PNG files are, made smaller where it is wide.

use crate::film::Image;
use crate::film::write::encode_png;
use std::borrow::Cow;

/// Pixels across, at most.
pub(super) const WIDEST: u32 = 1280;

/// `image` as a PNG in a URI, and its size there.
pub(in crate::report) fn data_uri(image: &Image) -> (String, (u32, u32)) {
    let image = if image.width > WIDEST { Cow::Owned(narrower(image)) } else { Cow::Borrowed(image) };
    let mut png = Vec::new();
    encode_png(&mut png, &image).expect("memory takes every write");
    (format!("data:image/png;base64,{}", base64(&png)), (image.width, image.height))
}

/// The mean over the area of each new pixel of what the old ones show: clipped first, since light above white
/// would fill whole pixels.
fn narrower(image: &Image) -> Image {
    let width = WIDEST;
    let height = (u64::from(image.height) * u64::from(width) / u64::from(image.width)).max(1) as u32;
    let mut small = Image::new(width, height);
    let columns: Vec<Vec<(u32, f32)>> = (0..width).map(|x| overlaps(x, width, image.width)).collect();
    for y in 0..height {
        let rows = overlaps(y, height, image.height);
        for (x, columns) in (0..width).zip(&columns) {
            let mut mean = [0.0f32; 3];
            for (row, down) in &rows {
                for (column, across) in columns {
                    let from = image.pixels[image.index(*column, *row)];
                    for (sum, c) in mean.iter_mut().zip(from) {
                        let shown = if c > 0.0 { c.min(1.0) } else { 0.0 };
                        *sum += shown * down * across;
                    }
                }
            }
            let at = small.index(x, y);
            small.pixels[at] = mean;
        }
    }
    small
}

/// Old places that lie in the new place `i` of `new`, and their shares of it.
fn overlaps(i: u32, new: u32, old: u32) -> Vec<(u32, f32)> {
    let scale = f64::from(old) / f64::from(new);
    let (from, to) = (f64::from(i) * scale, (f64::from(i) + 1.0) * scale);
    let last = (to.ceil() as u32).min(old);
    (from as u32..last)
        .map(|k| {
            let common = to.min(f64::from(k) + 1.0) - from.max(f64::from(k));
            (k, (common / scale).max(0.0) as f32)
        })
        .collect()
}

/// RFC 4648, §4.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let byte = |i: usize| u32::from(three.get(i).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for i in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * i)) as usize & 63];
            out.push(if i <= three.len() { char::from(digit) } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_standard() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
        assert_eq!(base64(&[0xff, 0xef, 0xbe]), "/+++");
    }

    #[test]
    fn a_wide_image_keeps_its_mean_and_shape() {
        let mut image = Image::new(WIDEST + 700, 33);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [(i % 7) as f32 / 7.0, 0.25, 7.0];
        }
        image.pixels[5] = [f32::NAN, 0.25, f32::INFINITY];
        let small = narrower(&image);
        assert_eq!((small.width, small.height), (WIDEST, 21));
        let mean = |image: &Image, c: usize| {
            let shown = image.pixels.iter().map(|p| if p[c] > 0.0 { f64::from(p[c].min(1.0)) } else { 0.0 });
            shown.sum::<f64>() / image.pixels.len() as f64
        };
        // Sums of f32 shares that add up to one within rounding.
        assert!((mean(&small, 0) - mean(&image, 0)).abs() < 1e-4);
        assert!(small.pixels.iter().all(|p| (p[1] - 0.25).abs() < 1e-6 && (p[2] - 1.0).abs() < 1e-5));
        assert_eq!(data_uri(&image).1, (WIDEST, 21));
    }

    #[test]
    fn a_narrow_image_is_the_png_itself() {
        let mut image = Image::new(3, 2);
        image.pixels[0] = [0.18, 0.5, 1.0];
        let (uri, size) = data_uri(&image);
        let mut png = Vec::new();
        encode_png(&mut png, &image).expect("memory");
        assert_eq!((uri, size), (format!("data:image/png;base64,{}", base64(&png)), (3, 2)));
    }
}
