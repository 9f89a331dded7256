//! Tiled textures whose pixels are made and not read: by whoever gives their rows. Memory is that
//! of a conversion. Never asks for a row twice.

use super::stream::Pyramid;
use super::{Compression, Settings, TileSink, WrapMode, tiff_out};
use crate::scene::Encoding;
use crate::texture::rules::{Build, Facts, Kind, Rules, Sample};
use crate::texture::{
    convert::Container, convert::fingerprint, image_io::Pixels, rules::Depth, texels::Texel,
};
use glam::Vec4;
use std::io::{self, Seek, Write};

/// Rows that are made before they are filtered.
const ROWS: u32 = 16;

/// Writes an 8-bit sRGB image of `size` as a tiled, mip-mapped TIFF to `out`, which stands at its
/// beginning: `row(y, bytes)` fills row `y` from the top, three bytes a pixel. `name` stands for the
/// source's fingerprint. Returns the file's length.
///
/// # Errors
/// Those of `out`.
pub fn write_rgb8<W: Write + Seek>(
    out: &mut W,
    size: (u32, u32),
    compression: Compression,
    name: &str,
    row: &mut dyn FnMut(u32, &mut [u8]),
) -> io::Result<u64> {
    let settings = Settings {
        container: Container::Tiff,
        compression,
        wrap: WrapMode::Periodic,
        encoding: Some(Encoding::Srgb),
    };
    let rules = Rules {
        channels: 3,
        depth: Depth::U8,
        facts: Facts::NONE,
        encoding: Encoding::Srgb,
        linear_halves: false,
    };
    rules.build(Rows { out, size, settings, name, row })
}

struct Rows<'a, W> {
    out: &'a mut W,
    size: (u32, u32),
    settings: Settings,
    name: &'a str,
    row: &'a mut dyn FnMut(u32, &mut [u8]),
}

impl<W: Write + Seek> Build for Rows<'_, W> {
    type Out = io::Result<u64>;

    fn build<S: Sample, T: Texel>(
        self,
        _: Kind,
        rules: &Rules,
        table: Box<[f32; 256]>,
        convert: impl Fn(&[S]) -> T + Sync,
        encode: impl Fn(Vec4) -> T + Sync,
    ) -> Self::Out {
        let (width, height) = self.size;
        let layout = tiff_out::Layout {
            width,
            height,
            channels: 3,
            sample_bytes: 1,
            compression: self.settings.compression,
            wrap: self.settings.wrap,
            associated_alpha: false,
            description: fingerprint::description(self.name, rules.encoding, rules.encoding),
        };
        let mut sink = tiff_out::TiffSink::new(self.out, layout)?;
        let mut pyramid = Pyramid::new(width, height, &table, &encode, &mut sink as &mut dyn TileSink);
        let line = width as usize * 3;
        let mut pixels = Pixels::U8(vec![0; line * ROWS as usize]);
        for first in (0..height).step_by(ROWS as usize) {
            let count = ROWS.min(height - first);
            if let Pixels::U8(bytes) = &mut pixels {
                bytes.truncate(line * count as usize);
                for (y, row) in (first..).zip(bytes.chunks_exact_mut(line)) {
                    (self.row)(y, row);
                }
            }
            pyramid.push(S::of(&pixels), 3, &convert)?;
        }
        debug_assert!(pyramid.complete(), "every row was given");
        sink.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texture::convert::Watch;
    use std::io::Cursor;

    #[test]
    fn rows_become_the_texels_that_an_image_of_them_has() {
        let (w, h) = (150u32, 71u32);
        let value = |x: u32, y: u32, c: u32| (x * 7 + y * 31 + c * 101 + x * y) as u8;
        let mut fill = |y: u32, row: &mut [u8]| {
            for (i, b) in row.iter_mut().enumerate() {
                *b = value(i as u32 / 3, y, i as u32 % 3);
            }
        };
        let mut made = Cursor::new(Vec::new());
        let bytes = write_rgb8(&mut made, (w, h), Compression::None, "name", &mut fill).expect("memory");
        assert_eq!(bytes, made.get_ref().len() as u64);
        let dir = tempfile::tempdir().expect("a directory");
        let png = dir.path().join("a.png");
        let mut image = image::RgbImage::new(w, h);
        image.enumerate_pixels_mut().for_each(|(x, y, p)| p.0 = [0, 1, 2].map(|c| value(x, y, c)));
        image.save(&png).expect("written");
        let settings = Settings {
            container: Container::Tiff,
            compression: Compression::None,
            wrap: WrapMode::Periodic,
            encoding: Some(Encoding::Srgb),
        };
        let mut converted = Cursor::new(Vec::new());
        super::super::convert(&png, &settings, "name", &mut converted, Watch::nobody())
            .map_err(|_| ())
            .expect("read");
        assert!(made.into_inner() == converted.into_inner(), "the files differ");
    }
}
