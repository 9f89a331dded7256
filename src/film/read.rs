//! Images back in, to be compared: any kind that textures may be. Integer files are taken as sRGB,
//! float files as linear. A crop window comes back in its whole frame, black around it. Never keeps
//! alpha.

use crate::error::Result;
use crate::film::Image;
use crate::scene::Encoding;
use crate::texture::read_image as decode;
use std::path::Path;

/// Reads the image in `path` as linear RGB.
///
/// # Errors
/// As [`crate::texture::read_image`].
pub fn read_image(path: &Path) -> Result<Image> {
    let data = decode(path)?;
    Ok(Image { pixels: data.linear_rgb(Encoding::Srgb), ..Image::empty(data.width, data.height) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::write::write_image;

    #[test]
    fn what_is_written_is_read_back() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let mut image = Image::new(5, 3);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [i as f32 / 14.0, 1.0 / (1.0 + i as f32), 0.5];
        }
        for (name, tolerance) in [("a.exr", 0.0), ("a.pfm", 0.0), ("a.png", 0.005)] {
            let path = directory.path().join(name);
            write_image(&path, &image, &[]).expect("writable");
            let back = read_image(&path).expect("readable");
            assert_eq!((back.width, back.height), (5, 3), "{name}");
            for (a, b) in back.pixels.iter().flatten().zip(image.pixels.iter().flatten()) {
                assert!((a - b).abs() <= tolerance, "{name}: {a} is not {b}");
            }
        }
    }
}
