//! Images out of files: what they are counted for, and that a picture does not depend on which
//! kind of file a texture came from.

use super::*;
use crate::error::Location;
use crate::texture::cache::least_budget;
use crate::texture::convert::{self, Compression, Container, Settings, WrapMode};
use crate::texture::image_io::decoded_bytes;
use std::path::Path;

fn source(path: &Path, encoding: Encoding, named: bool) -> ImageSource {
    ImageSource { path: path.to_path_buf(), encoding, named, at: Location::whole("scene.pbrt") }
}

const USED: ImageNeeds = ImageNeeds { used: true, mip_levels: true, whole: false };
const WHOLE: ImageNeeds = ImageNeeds { used: true, mip_levels: true, whole: true };

fn load(sources: &[ImageSource], needs: &[ImageNeeds], budget: u64, cache: &Path) -> Result<TextureStore> {
    let cache_dir = Some(cache.to_path_buf());
    let options = TextureOptions { budget, cache_dir, ..TextureOptions::default() };
    TextureStore::load(sources, needs, &options, convert::Watch::nobody())
}

fn one(source: ImageSource, need: ImageNeeds) -> TextureStore {
    load(&[source], &[need], 1 << 30, Path::new("/nowhere")).unwrap_or_else(|e| panic!("{e}"))
}

/// The colour and what a float texture reads, in the finest level.
fn seen(store: &TextureStore) -> (Rgb, f32) {
    let at = |channels| {
        let sampler = Sampler { channels, ..Sampler::default() };
        store.lookup(ImageId(0), Vec2::splat(0.4), Footprint::default(), sampler)
    };
    (at(Channels::Rgb), at(Channels::Alpha).x)
}

fn tiled(from: &Path, to: &Path, encoding: Option<Encoding>) {
    let settings = Settings {
        container: Container::Tiff,
        compression: Compression::None,
        wrap: WrapMode::Periodic,
        encoding,
    };
    let mut out = std::fs::File::create(to).expect("a file");
    convert::convert(from, &settings, "hash", &mut out, convert::Watch::nobody()).expect("converted");
}

fn replaced(path: &Path, from: &[u8], to: &[u8]) {
    assert_eq!(from.len(), to.len());
    let mut bytes = std::fs::read(path).expect("read");
    let places: Vec<usize> = (0..bytes.len()).filter(|&i| bytes[i..].starts_with(from)).collect();
    assert!(!places.is_empty(), "nothing to replace");
    places.into_iter().for_each(|i| bytes[i..i + to.len()].copy_from_slice(to));
    std::fs::write(path, bytes).expect("written");
}

#[test]
fn no_image_takes_more_than_it_is_counted_for() {
    use tiff::encoder::{TiffEncoder, colortype as c};
    let dir = tempfile::tempdir().expect("a directory");
    let file = |name: &str| dir.path().join(name);
    let create = |name: &str| std::fs::File::create(file(name)).expect("a file");
    let mut names = Vec::new();
    for (w, h) in [(1u32, 1u32), (13, 70), (100, 3)] {
        let mut add = |kind: &str| {
            names.push(format!("{w}x{h}{kind}"));
            names[names.len() - 1].clone()
        };
        let n = (w * h) as usize;
        // No halves.
        let floats: Vec<f32> = (0..n * 4).map(|i| 1.0 / (i + 3) as f32).collect();
        let encoder = |name: &str| TiffEncoder::new(create(name)).expect("a file");
        encoder(&add("grey.tif")).write_image::<c::Gray32Float>(w, h, &floats[..n]).expect("written");
        encoder(&add("rgb.tif")).write_image::<c::RGB32Float>(w, h, &floats[..3 * n]).expect("written");
        encoder(&add("rgba.tif")).write_image::<c::RGBA32Float>(w, h, &floats).expect("written");
        encoder(&add("grey16.tif")).write_image::<c::Gray16>(w, h, &vec![7; n]).expect("written");
        image::GrayImage::new(w, h).save(file(&add("grey.png"))).expect("written");
        image::RgbaImage::new(w, h).save(file(&add("rgba.png"))).expect("written");
        let hdr = image::Rgb32FImage::from_pixel(w, h, image::Rgb([1e9, 1e-9, 0.3]));
        hdr.save(file(&add("rgb.hdr"))).expect("written");
        for (kind, channels) in [("PF", 3), ("Pf", 1)] {
            let mut bytes = format!("{kind}\n{w} {h}\n-1.0\n").into_bytes();
            floats[..n * channels].iter().for_each(|f| bytes.extend(f.to_le_bytes()));
            std::fs::write(file(&add(&format!("{kind}.pfm"))), bytes).expect("written");
        }
    }
    for name in names {
        for mip_levels in [true, false] {
            let need = ImageNeeds { mip_levels, ..USED };
            let taken = one(source(&file(&name), Encoding::Srgb, false), need).bytes();
            let counted = decoded_bytes(&file(&name), mip_levels).expect("read");
            assert!(taken <= counted, "{name}: {taken} bytes, {counted} counted");
            // Blocks of small images aside, not much more either.
            assert!(counted <= 4 * taken + 128, "{name}: {taken} bytes, {counted} counted");
        }
    }
}

#[test]
fn a_refused_budget_names_one_that_works_whatever_the_images_are() {
    let dir = tempfile::tempdir().expect("a directory");
    let (png, tx) = (dir.path().join("a.png"), dir.path().join("a.tx"));
    let grey = dir.path().join("grey.png");
    image::RgbImage::from_pixel(300, 200, image::Rgb([1, 2, 3])).save(&png).expect("written");
    image::GrayImage::new(500, 500).save(&grey).expect("written");
    tiled(&grey, &tx, None);
    let all = [&png, &tx, &grey].map(|path| source(path, Encoding::Srgb, false));
    let unused = ImageNeeds::default();
    for needs in [
        [WHOLE, unused, unused],
        [USED, USED, unused],
        [USED, unused, USED],
        [WHOLE, USED, USED],
        [USED, USED, WHOLE],
        [WHOLE, unused, WHOLE],
    ] {
        let tried = |budget| load(&all, &needs, budget, dir.path());
        let Err(e) = tried(1) else { panic!("{needs:?}: one byte was enough") };
        assert_eq!(e.exit_code(), 2, "{e}");
        let message = e.to_string();
        let (_, after) = message.split_once("--texture-memory ").unwrap_or_else(|| panic!("{message}"));
        let digits: String = after.chars().take_while(char::is_ascii_digit).collect();
        let least: u64 = digits.parse().expect("a number");
        assert!(tried(least - 1).is_err(), "{needs:?}: {least} was not the least");
        let store = tried(least).unwrap_or_else(|e| panic!("{needs:?}: {e}"));
        assert!(store.bytes() <= least);
    }
}

#[test]
fn a_tiled_file_stands_in_for_its_source_whole_or_not() {
    let dir = tempfile::tempdir().expect("a directory");
    let (png, tx) = (dir.path().join("a.png"), dir.path().join("a.tx"));
    image::RgbaImage::from_pixel(90, 70, image::Rgba([200, 90, 30, 120])).save(&png).expect("written");
    for curve in [Encoding::Srgb, Encoding::Linear, Encoding::Gamma(2.2)] {
        tiled(&png, &tx, Some(curve));
        let want = seen(&one(source(&png, curve, true), USED));
        for need in [USED, WHOLE] {
            // The scene does not say: the file does. The scene says the same: no word about it.
            for (asked, named) in [(Encoding::Srgb, false), (curve, true)] {
                let store = one(source(&tx, asked, named), need);
                assert_eq!(seen(&store), want, "{curve:?} {need:?} {named}");
                assert!(store.notes().is_empty(), "{:?}", store.notes());
            }
            // The scene says otherwise: it wins, and a person hears of it.
            let asked = Encoding::Gamma(1.5);
            let store = one(source(&tx, asked, true), need);
            assert_eq!(seen(&store), seen(&one(source(&png, asked, true), USED)));
            assert!(matches!(store.notes(), [note] if note.contains("--encoding gamma:1.5")));
        }
    }
}

#[test]
fn an_opaque_alpha_of_other_programs_counts_as_none_and_a_hole_in_it_as_one() {
    let dir = tempfile::tempdir().expect("a directory");
    let (png, tx) = (dir.path().join("a.png"), dir.path().join("a.tx"));
    let (own, foreign) = (b"weir:encoding", b"else:encoding");
    let texel = [10, 20, 30, 254];
    image::RgbaImage::from_pixel(300, 200, image::Rgba(texel)).save(&png).expect("written");
    tiled(&png, &tx, None);
    replaced(&tx, own, foreign);
    let load = || one(source(&tx, Encoding::Linear, false), USED);
    assert!((seen(&load()).1 - 254.0 / 255.0).abs() < 1e-6);
    replaced(&tx, &texel, &[10, 20, 30, 255]);
    assert!((seen(&load()).1 * 255.0 - 20.0).abs() < 1e-4);

    // The coarsest level shows nothing of one hole among 300 × 200 texels.
    let mut hole = image::RgbaImage::from_pixel(300, 200, image::Rgba([10, 20, 30, 255]));
    hole.put_pixel(200, 20, image::Rgba([10, 20, 30, 0]));
    hole.save(&png).expect("written");
    tiled(&png, &tx, None);
    assert_eq!(seen(&load()).1, 1.0);
    replaced(&tx, own, foreign);
    assert_eq!(seen(&load()).1, 1.0);
}

#[test]
fn tiles_fit_or_not_by_what_they_take_in_the_cache() {
    let dir = tempfile::tempdir().expect("a directory");
    let (png, tx, lamp) = (dir.path().join("a.png"), dir.path().join("a.tx"), dir.path().join("lamp.png"));
    image::RgbImage::from_pixel(256, 256, image::Rgb([1, 2, 3])).save(&png).expect("written");
    image::RgbImage::from_pixel(300, 300, image::Rgb([1, 2, 3])).save(&lamp).expect("written");
    tiled(&png, &tx, None);
    let sources = [&tx, &lamp].map(|path| source(path, Encoding::Srgb, false));
    let store = |budget| load(&sources, &[USED, WHOLE], budget, dir.path()).unwrap_or_else(|e| panic!("{e}"));
    let whole = store(1 << 30).images[1].as_ref().map_or(0, |i| match i {
        Image::Whole(i) => i.memory.bytes as u64,
        Image::Tiled(_) => panic!("tiled"),
    });
    // Levels of 256, 128, 64 and less: 16 + 4 + 7 tiles.
    let tiles = 27 * least_budget(64 * 64 * 3, 1) / 2;
    assert!(store(whole + tiles).all_tiles_fit());
    assert!(!store(whole + tiles - 1).all_tiles_fit());
}
