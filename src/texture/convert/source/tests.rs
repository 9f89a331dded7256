//! Rows read in parts against images read whole, for every format and layout that is read in parts.

use super::*;
use crate::texture::convert::tests::noise;
use std::fs::{self, File};

fn rows(path: &Path) -> (bool, ImageData) {
    let source = Source::open(path).unwrap_or_else(|e| panic!("{e}"));
    let Shape { width, height, channels, depth } = source.shape();
    // Twice: a second reading must not depend on the first.
    for _ in 0..2 {
        let mut all = empty(depth, 0);
        source
            .read(&mut |band| {
                match (&mut all, band) {
                    (Pixels::U8(to), Pixels::U8(from)) => to.extend(from),
                    (Pixels::U16(to), Pixels::U16(from)) => to.extend(from),
                    (Pixels::F16(to), Pixels::F16(from)) => to.extend(from),
                    (Pixels::F32(to), Pixels::F32(from)) => to.extend(from),
                    _ => panic!("a band of another kind"),
                }
                Ok(())
            })
            .unwrap_or_else(|e| panic!("{e:?}"));
        let data = ImageData { width, height, channels, pixels: all };
        assert!(same(&data, &read_image(path).expect("sound")), "{}", path.display());
    }
    (source.is_whole(), read_image(path).expect("sound"))
}

/// Equal bits, so that NaN equals itself.
fn same(a: &ImageData, b: &ImageData) -> bool {
    let floats = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    let halves = |v: &[f16]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    (a.width, a.height, a.channels) == (b.width, b.height, b.channels)
        && match (&a.pixels, &b.pixels) {
            (Pixels::F32(a), Pixels::F32(b)) => floats(a) == floats(b),
            (Pixels::F16(a), Pixels::F16(b)) => halves(a) == halves(b),
            (a, b) => a == b,
        }
}

fn error(path: &Path) -> String {
    let e = match Source::open(path) {
        Err(e) => e,
        Ok(source) => match source.read(&mut |_| Ok(())) {
            Err(Failure::Source(e)) => e,
            other => panic!("{}: {other:?}", path.display()),
        },
    };
    let text = e.to_string();
    assert!(!text.contains('\n') && e.exit_code() == 2, "{text}");
    text
}

#[test]
fn exr_of_every_layout_is_what_it_is_as_a_whole() {
    use ::exr::prelude::*;
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("a.exr");
    let (w, h) = (150usize, 101usize);
    let numbers = noise(5, w * h);
    let mut seen = 0;
    let blocks = [Blocks::ScanLines, Blocks::Tiles(Vec2(32, 16)), Blocks::Tiles(Vec2(200, 200))];
    for blocks in blocks {
        for compression in
            [Compression::Uncompressed, Compression::ZIP1, Compression::ZIP16, Compression::PIZ]
        {
            for line_order in [LineOrder::Increasing, LineOrder::Decreasing] {
                for position in [Vec2(0, 0), Vec2(-20, 30), Vec2(40, -50), Vec2(-1000, 5)] {
                    let values = numbers.iter().map(|&x| x as f32 * 1e-9).collect();
                    let channels = AnyChannels::sort(
                        [AnyChannel::new("Y", FlatSamples::F32(values))].into_iter().collect(),
                    );
                    let attributes = LayerAttributes { layer_position: position, ..Default::default() };
                    let encoding = Encoding { compression, blocks, line_order };
                    let layer = Layer::new((w, h), attributes, encoding, channels);
                    let mut image = Image::from_layer(layer);
                    image.attributes.display_window = IntegerBounds::new((3, -4), (140, 90));
                    image.write().to_file(&path).expect("write");
                    let (whole, _) = rows(&path);
                    assert!(!whole);
                    seen += 1;
                }
            }
        }
    }
    assert_eq!(seen, 96);
}

#[test]
fn pfm_and_hdr_are_what_they_are_as_a_whole() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("a.pfm");
    for (kind, n, scale) in [("PF", 3, "-1"), ("Pf", 1, "2.5")] {
        let mut file = format!("{kind}\n 77 130\n{scale}\n").into_bytes();
        file.extend(noise(1, 77 * 130 * n).iter().flat_map(|x| (x & 0xbfff_ffff).to_le_bytes()));
        fs::write(&path, &file).expect("write");
        assert!(!rows(&path).0);
        fs::write(&path, &file[..file.len() - 1]).expect("write");
        error(&path);
    }
    let path = directory.path().join("a.hdr");
    // Flat pixels, one of each exponent; then runs of the old kind; then the new kind.
    let mut file = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2\n\n-Y 3 +X 300\n".to_vec();
    file.extend((0..300u32).flat_map(|i| [7, (i % 251) as u8, 200, (i % 256) as u8]));
    file.extend([9, 8, 7, 130, 1, 1, 1, 43, 1, 1, 1, 1]);
    file.extend([2, 2, 1, 44]);
    for channel in 0..4u8 {
        file.extend([128 + 100, channel * 3 + 120, 100]);
        file.extend((0..100).map(|i| i + channel));
        file.extend([128 + 100, 130]);
    }
    fs::write(&path, &file).expect("write");
    let (whole, data) = rows(&path);
    assert!(!whole && data.width == 300 && data.height == 3);
    for cut in [file.len() - 1, file.len() - 150, 70] {
        fs::write(&path, &file[..cut]).expect("write");
        assert!(error(&path).contains("cut short"));
    }
    let mut wrong = file.clone();
    wrong[file.len() - 2] = 128 + 101;
    fs::write(&path, wrong).expect("write");
    assert!(error(&path).contains("longer than its line"));
}

#[test]
fn tiff_of_every_layout_is_what_it_is_as_a_whole() {
    use ::tiff::encoder::{Compression, Predictor, TiffEncoder, colortype};
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("a.tif");
    let (w, h) = (75u32, 93u32);
    let wide: Vec<u16> = noise(3, (w * h * 4) as usize).iter().map(|x| (x >> 16) as u16).collect();
    let bytes: Vec<u8> = wide.iter().map(|x| (x >> 8) as u8).collect();
    let floats: Vec<f32> = wide.iter().map(|&x| f32::from(x) * 0.1).collect();
    for compression in [Compression::Uncompressed, Compression::Lzw, Compression::Packbits] {
        for kind in 0..6 {
            let file = File::create(&path).expect("create");
            let mut encoder = TiffEncoder::new(file).expect("write").with_compression(compression);
            if kind < 4 && compression == Compression::Lzw {
                encoder = encoder.with_predictor(Predictor::Horizontal);
            }
            macro_rules! write {
                ($kind:ty, $n:expr, $values:expr) => {{
                    let mut image = encoder.new_image::<$kind>(w, h).expect("write");
                    image.rows_per_strip(10).expect("rows");
                    image.write_data(&$values[..(w * h * $n) as usize]).expect("write");
                }};
            }
            match kind {
                0 => write!(colortype::Gray8, 1, bytes),
                1 => write!(colortype::RGB8, 3, bytes),
                2 => write!(colortype::RGBA8, 4, bytes),
                3 => write!(colortype::RGBA16, 4, wide),
                4 => write!(colortype::RGB32Float, 3, floats),
                _ => write!(colortype::RGBA32Float, 4, floats),
            }
            assert!(!rows(&path).0);
            let file = fs::read(&path).expect("there");
            fs::write(&path, &file[..file.len() / 2]).expect("write");
            error(&path);
        }
    }
}

#[test]
fn interlaced_png_and_jpeg_are_read_whole_and_others_in_parts() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let jpeg = directory.path().join("a.jpg");
    image::RgbImage::from_fn(70, 80, |x, y| image::Rgb([x as u8, y as u8, 9])).save(&jpeg).expect("write");
    assert!(rows(&jpeg).0);
    let bmp = directory.path().join("a.bmp");
    image::RgbImage::from_fn(70, 80, |x, y| image::Rgb([x as u8, y as u8, 9])).save(&bmp).expect("write");
    assert!(rows(&bmp).0);
    let path = directory.path().join("a.png");
    for (kind, depth, bits) in [
        (::png::ColorType::Indexed, ::png::BitDepth::Two, 2),
        (::png::ColorType::Grayscale, ::png::BitDepth::One, 1),
        (::png::ColorType::Rgb, ::png::BitDepth::Eight, 24),
    ] {
        let mut encoder = ::png::Encoder::new(File::create(&path).expect("create"), 37, 70);
        encoder.set_color(kind);
        encoder.set_depth(depth);
        if kind == ::png::ColorType::Indexed {
            encoder.set_palette(vec![1, 2, 3, 40, 50, 60, 7, 8, 9, 200, 210, 220]);
            encoder.set_trns(vec![255, 0, 128, 4]);
        }
        let row: usize = (37 * bits as usize).div_ceil(8);
        let mut writer = encoder.write_header().expect("write");
        let data: Vec<u8> = noise(8, row * 70).iter().map(|x| (x >> 24) as u8).collect();
        writer.write_image_data(&data).expect("write");
        writer.finish().expect("write");
        assert!(!rows(&path).0);
        let file = fs::read(&path).expect("there");
        fs::write(&path, &file[..file.len() / 2]).expect("write");
        assert!(error(&path).contains("cut short"));
        let mut flipped = file.clone();
        flipped[file.len() / 2] ^= 0x10;
        fs::write(&path, flipped).expect("write");
        error(&path);
    }
}

#[test]
fn a_change_between_two_readings_is_noticed() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("a.pfm");
    let mut file = b"Pf\n4 4\n-1\n".to_vec();
    file.resize(file.len() + 64, 0);
    fs::write(&path, &file).expect("write");
    let source = Source::open(&path).expect("sound");
    source.read(&mut |_| Ok(())).expect("sound");
    file.push(0);
    fs::write(&path, &file).expect("write");
    match source.read(&mut |_| Ok(())) {
        Err(Failure::Source(e)) => assert!(e.to_string().contains("changed while"), "{e}"),
        other => panic!("{other:?}"),
    }
}

/// The suites that `tests/weir` reads as well, where they are there.
#[test]
fn pngsuite_and_valid_exr_read_in_parts_as_they_do_whole() {
    let house = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut bases: Vec<PathBuf> = std::env::var_os("WEIR_SHARED").map(PathBuf::from).into_iter().collect();
    bases.extend([house.join("../shared"), house.join("../../shared")]);
    let mut seen = 0;
    let scenes = bases.iter().map(|b| b.join("scenes")).find(|s| s.is_dir()).unwrap_or_default();
    let mut folders = vec![scenes.join("hard-pngsuite"), scenes.join("exr-valid")];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = fs::read_dir(&folder) else {
            eprintln!("left out: no {}", folder.display());
            continue;
        };
        for path in entries.map(|e| e.expect("readable").path()) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "png" || e == "exr") {
                match read_image(&path) {
                    Ok(_) => drop(rows(&path)),
                    Err(_) => drop(error(&path)),
                }
                seen += 1;
            }
        }
    }
    eprintln!("{seen} files");
}
