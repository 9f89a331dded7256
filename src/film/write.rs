//! Images out: EXR (32-bit float, linear, exact), PNG (8-bit sRGB, clipped) and PFM (float, linear),
//! chosen by extension. Invariant: a file of that name is always whole. Never changes a float on its
//! way into EXR or PFM, infinities and NaN included.

use crate::color::srgb::linear_to_byte;
use crate::error::{Error, Result};
use crate::film::Image;
use crate::film::replace::{check_replaceable, replace_file};
use exr::prelude::{
    AttributeValue, Compression, Encoding, IntegerBounds, Layer, LayerAttributes, LineOrder,
    SpecificChannels, Text, Vec2, WritableImage,
};
use image::ImageEncoder;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Formats that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// OpenEXR, ZIP compression, attributes.
    Exr,
    /// 8-bit sRGB.
    Png,
    /// Portable float map.
    Pfm,
}

/// What an image can carry beside its pixels.
#[derive(Clone, Debug, PartialEq)]
pub enum Attribute {
    /// A line of text.
    Text(String),
    /// A number.
    Number(f64),
}

impl Format {
    /// By the extension of `path`, in either case.
    ///
    /// # Errors
    /// [`Error::Usage`] naming the extensions that work.
    pub fn of(path: &Path) -> Result<Self> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("exr") => Ok(Self::Exr),
            Some("png") => Ok(Self::Png),
            Some("pfm") => Ok(Self::Pfm),
            _ => Err(Error::Usage(format!(
                "{}: cannot write an image of this kind; name it .exr, .png or .pfm",
                path.display()
            ))),
        }
    }
}

/// Whether [`write_image`] could write `path` now.
///
/// # Errors
/// [`Error::Usage`] for an extension that cannot be written, else as [`check_replaceable`].
pub fn check_writable(path: &Path) -> Result<()> {
    Format::of(path)?;
    check_replaceable(path)
}

/// Writes `image` in the format of `path`'s extension, whole or not at all. `attributes` go into EXR;
/// the other formats have no place for them.
///
/// # Errors
/// [`Error::Usage`] for an extension that cannot be written, [`Error::Io`] with `path`.
pub fn write_image(path: &Path, image: &Image, attributes: &[(String, Attribute)]) -> Result<()> {
    match Format::of(path)? {
        Format::Exr => replace_file(path, |out| write_exr(out, image, attributes)),
        Format::Png => replace_file(path, |out| encode_png(out, image)),
        Format::Pfm => replace_file(path, |out| write_pfm(out, image)),
    }
}

fn write_exr(out: &mut BufWriter<File>, image: &Image, attributes: &[(String, Attribute)]) -> io::Result<()> {
    let channels = SpecificChannels::rgb(|Vec2(x, y): Vec2<usize>| {
        let [r, g, b] = image.pixels[y * image.width as usize + x];
        (r, g, b)
    });
    // OpenEXR keeps windows as i32; a frame beyond that could not have been allocated.
    let signed = |n: u32| i32::try_from(n).map_err(|_| io::Error::other("image too large for EXR"));
    let mut own = LayerAttributes {
        layer_position: Vec2(signed(image.origin.0)?, signed(image.origin.1)?),
        software_name: Some(Text::new_or_panic(concat!("weir ", env!("CARGO_PKG_VERSION")))),
        ..LayerAttributes::default()
    };
    for (name, value) in attributes {
        let value = match value {
            // UTF-8, as OpenEXR has it; the library's own conversion would write Latin-1.
            Attribute::Text(text) => AttributeValue::Text(Text::from_slice_unchecked(text.as_bytes())),
            Attribute::Number(number) => AttributeValue::F64(*number),
        };
        own.other.insert(Text::from_slice_unchecked(name.as_bytes()), value);
    }
    let encoding = Encoding {
        compression: Compression::ZIP16,
        line_order: LineOrder::Increasing,
        ..Encoding::default()
    };
    let layer = Layer::new((image.width as usize, image.height as usize), own, encoding, channels);
    let mut file = exr::prelude::Image::from_layer(layer);
    let size = (image.full_size.0 as usize, image.full_size.1 as usize);
    file.attributes.display_window = IntegerBounds::new((0, 0), size);
    file.write().to_buffered(out).map_err(|e| match e {
        exr::error::Error::Io(e) => e,
        other => io::Error::other(other.to_string()),
    })
}

/// `image` as a PNG: 8-bit sRGB, clipped.
///
/// # Errors
/// Those of `out`.
pub fn encode_png(mut out: impl Write, image: &Image) -> io::Result<()> {
    let bytes: Vec<u8> = image.pixels.iter().flatten().map(|&c| linear_to_byte(c)).collect();
    // In memory first: why something could not be written the encoder tells in words alone.
    let mut png = Vec::new();
    image::codecs::png::PngEncoder::new(&mut png)
        .write_image(&bytes, image.width, image.height, image::ExtendedColorType::Rgb8)
        .map_err(|e| match e {
            image::ImageError::IoError(e) => e,
            other => io::Error::other(other.to_string()),
        })?;
    out.write_all(&png)
}

/// A negative scale says little-endian; rows from the bottom (Debevec's format).
fn write_pfm(out: &mut BufWriter<File>, image: &Image) -> io::Result<()> {
    write!(out, "PF\n{} {}\n-1.0\n", image.width, image.height)?;
    for row in image.pixels.chunks_exact(image.width.max(1) as usize).rev() {
        for component in row.iter().flatten() {
            out.write_all(&component.to_le_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{MetaData, ReadChannels, ReadLayers};

    /// Values that show a lost bit: subnormals, signed zero, one ulp off one, the largest float.
    fn awkward() -> Image {
        let mut image = Image::cropped((40, 30), [3, 5, 36, 24]);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let x = i as f32;
            *pixel = [x.sin() * 1e-3, (x * 0.37).exp2() % 1000.0, 1.0 / (x + 1.0)];
        }
        image.pixels[0] = [f32::MIN_POSITIVE / 8.0, -0.0, 1.0 + f32::EPSILON];
        image.pixels[1] = [f32::MAX, -1.0, 65_505.0];
        image.pixels[2] = [f32::INFINITY, f32::NEG_INFINITY, f32::NAN];
        image
    }

    fn read_exr(path: &Path) -> (Vec<[u32; 3]>, exr::prelude::ImageAttributes, LayerAttributes) {
        let file = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .rgb_channels(
                |size, _| (vec![[0u32; 3]; size.area()], size.width()),
                |(pixels, width), at, (r, g, b): (f32, f32, f32)| {
                    pixels[at.y() * *width + at.x()] = [r.to_bits(), g.to_bits(), b.to_bits()];
                },
            )
            .first_valid_layer()
            .all_attributes()
            .from_file(path)
            .expect("our own file");
        (file.layer_data.channel_data.pixels.0, file.attributes, file.layer_data.attributes)
    }

    #[test]
    fn exr_keeps_every_bit_the_windows_and_the_attributes() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let path = directory.path().join("a.exr");
        let image = awkward();
        let attributes = [
            ("weir.scene".to_owned(), Attribute::Text("Küche/日本.pbrt".to_owned())),
            ("weir.samples_per_pixel".to_owned(), Attribute::Number(64.0)),
        ];
        write_image(&path, &image, &attributes).expect("writable");
        let (pixels, shared, own) = read_exr(&path);
        let expected: Vec<[u32; 3]> = image.pixels.iter().map(|p| p.map(f32::to_bits)).collect();
        assert_eq!(pixels, expected);
        assert_eq!(shared.display_window, IntegerBounds::new((0, 0), (40, 30)));
        assert_eq!(own.layer_position, Vec2(3, 5));
        let find = |name: &str| own.other.get(&Text::from(name)).cloned();
        let text = Text::from_slice_unchecked("Küche/日本.pbrt".as_bytes());
        assert_eq!(find("weir.scene"), Some(AttributeValue::Text(text)));
        assert_eq!(find("weir.samples_per_pixel"), Some(AttributeValue::F64(64.0)));
        let meta = MetaData::read_from_file(&path, true).expect("strictly valid");
        assert_eq!(meta.headers[0].compression, Compression::ZIP16);
    }

    #[test]
    fn png_has_the_srgb_codes() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let path = directory.path().join("a.PNG");
        let mut image = Image::new(3, 2);
        image.pixels[0] = [0.18, 0.5, 1.0];
        image.pixels[5] = [f32::NAN, f32::INFINITY, -4.0];
        write_image(&path, &image, &[]).expect("writable");
        let bytes = std::fs::read(&path).expect("written");
        let back = image::load_from_memory(&bytes).expect("a PNG").into_rgb8();
        assert_eq!(back.dimensions(), (3, 2));
        assert_eq!(back.get_pixel(0, 0).0, [118, 188, 255]);
        assert_eq!(back.get_pixel(2, 1).0, [0, 255, 0]);
    }

    #[test]
    fn pfm_is_bottom_up_little_endian() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let path = directory.path().join("a.pfm");
        let mut image = Image::new(1, 2);
        image.pixels = vec![[1.0, 2.0, 3.0], [4.0, 5.0, f32::NAN]];
        write_image(&path, &image, &[]).expect("writable");
        let bytes = std::fs::read(&path).expect("written");
        let (head, body) = bytes.split_at(b"PF\n1 2\n-1.0\n".len());
        assert_eq!(head, b"PF\n1 2\n-1.0\n");
        let expected: Vec<u8> =
            [4.0, 5.0, f32::NAN, 1.0, 2.0, 3.0].iter().flat_map(|c: &f32| c.to_le_bytes()).collect();
        assert_eq!(body, expected);
    }

    #[test]
    fn unknown_extensions_are_the_users_fault() {
        for name in ["a.tga", "a", "a.exr.gz", ".exr"] {
            let error = check_writable(Path::new(name)).expect_err("cannot be written");
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains(".exr, .png or .pfm"), "{error}");
        }
        let gone = write_image(Path::new("/no/such/directory/a.exr"), &Image::new(1, 1), &[]);
        assert!(gone.expect_err("no directory").to_string().starts_with("/no/such/directory/a.exr: "));
    }
}
