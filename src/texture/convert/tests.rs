//! Converted files against `TextureStore`, bit for bit, read back by other people's readers.

use super::*;
use crate::scene::ImageId;
use crate::texture::store::{KeptLevel, TextureStore};
use crate::texture::{ImageData, read_image};
use half::f16;
use std::fs::File;
use std::io::{BufWriter, Cursor};
use std::path::PathBuf;
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;

const SIZES: [(u32, u32); 9] =
    [(1, 1), (1, 7), (2, 3), (64, 64), (65, 64), (63, 129), (1000, 37), (130, 200), (200, 131)];

pub(super) fn noise(seed: u32, n: usize) -> Vec<u32> {
    let mut s = 0x9e37_79b9 ^ seed.wrapping_mul(0x85eb_ca6b);
    (0..n)
        .map(|_| {
            s ^= s << 13;
            s ^= s >> 17;
            s ^= s << 5;
            s
        })
        .collect()
}

fn settings(container: Container, compression: Compression, encoding: Option<Encoding>) -> Settings {
    Settings { container, compression, wrap: WrapMode::Black, encoding }
}

fn converted(path: &Path, settings: &Settings) -> (Summary, Vec<u8>) {
    let mut out = Cursor::new(Vec::new());
    let summary = convert(path, settings, "00ff", &mut out, Watch::nobody()).expect("a sound image");
    assert_eq!(summary.bytes, out.get_ref().len() as u64);
    (summary, out.into_inner())
}

/// All levels of a TIFF, in the form of `TextureStore::kept`, with `stride` bytes a texel.
fn tiff_levels(file: &[u8], stride: usize) -> Vec<KeptLevel> {
    let mut decoder = Decoder::new(Cursor::new(file)).expect("a TIFF");
    let mut levels = Vec::new();
    loop {
        let (w, h) = decoder.dimensions().expect("a size");
        assert_eq!(decoder.chunk_dimensions(), (64, 64));
        let reduced: u32 = decoder.get_tag_unsigned(Tag::NewSubfileType).expect("a tag");
        assert_eq!(reduced, u32::from(!levels.is_empty()));
        let bytes: Vec<u8> = match decoder.read_image().expect("pixels") {
            DecodingResult::U8(v) => v,
            DecodingResult::F16(v) => v.iter().flat_map(|x| x.to_bits().to_ne_bytes()).collect(),
            DecodingResult::F32(v) => v.iter().flat_map(|x| x.to_ne_bytes()).collect(),
            _ => panic!("a kind that is never written"),
        };
        // RGB in a file is RGBA in memory; what stands for alpha there says nothing.
        let kept = bytes.len() / (w as usize * h as usize);
        let pad = if kept == stride { 0 } else { stride / 4 };
        assert_eq!(kept + pad, stride);
        let wide = bytes.chunks_exact(kept).flat_map(|t| t.iter().copied().chain(vec![0; pad])).collect();
        levels.push((w, h, wide));
        if !decoder.more_images() {
            return levels;
        }
        decoder.next_image().expect("another level");
    }
}

/// Bytes a texel of `TextureStore`, and its levels, alpha zeroed where it says nothing.
fn memory_levels(data: ImageData, encoding: Encoding) -> (usize, Vec<KeptLevel>) {
    let channels = data.channels;
    let store = TextureStore::from_data(data, encoding, true).expect("memory");
    let (stride, alpha, mut levels) = store.kept(ImageId(0)).expect("loaded");
    if !alpha && channels > 2 {
        let texels = levels.iter_mut().flat_map(|level| level.2.chunks_exact_mut(stride));
        texels.for_each(|texel| texel[stride / 4 * 3..].fill(0));
    }
    (stride, levels)
}

/// Converts `path` both ways and holds every level against memory.
#[track_caller]
fn check(path: &Path, encoding: Encoding) -> Summary {
    let (stride, expected) = memory_levels(read_image(path).expect("a sound image"), encoding);
    let mut last = None;
    for compression in [Compression::None, Compression::Zip] {
        let (summary, file) = converted(path, &settings(Container::Tiff, compression, Some(encoding)));
        assert_eq!(summary.levels, expected.len());
        let ours = tiff_levels(&file, stride);
        assert_eq!(ours.len(), expected.len());
        for (l, (ours, theirs)) in ours.iter().zip(&expected).enumerate() {
            assert_eq!((ours.0, ours.1), (theirs.0, theirs.1));
            let at = ours.2.iter().zip(&theirs.2).position(|(a, b)| a != b);
            assert_eq!(at, None, "{}: level {l} of {}x{}", path.display(), ours.0, ours.1);
            assert_eq!(ours.2.len(), theirs.2.len());
        }
        last = Some(summary);
    }
    last.expect("two of them")
}

fn write_png(path: &Path, (w, h): (u32, u32), channels: usize, wide: bool, opaque: bool) {
    use image::{ExtendedColorType as E, ImageEncoder};
    let n = w as usize * h as usize * channels;
    let mut numbers = noise(w * 31 + h + channels as u32, n);
    if opaque && channels.is_multiple_of(2) {
        numbers.chunks_exact_mut(channels).for_each(|p| p[channels - 1] = u32::MAX);
    }
    let kind = match (channels, wide) {
        (1, false) => E::L8,
        (2, false) => E::La8,
        (3, false) => E::Rgb8,
        (_, false) => E::Rgba8,
        (1, true) => E::L16,
        (2, true) => E::La16,
        (3, true) => E::Rgb16,
        (_, true) => E::Rgba16,
    };
    let bytes: Vec<u8> = if wide {
        numbers.iter().flat_map(|x| ((x >> 16) as u16).to_ne_bytes()).collect()
    } else {
        numbers.iter().map(|x| (x >> 24) as u8).collect()
    };
    let out = BufWriter::new(File::create(path).expect("create"));
    image::codecs::png::PngEncoder::new(out).write_image(&bytes, w, h, kind).expect("write");
}

#[test]
fn integers_are_those_in_memory_at_every_level_size_and_encoding() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("a.png");
    for size in SIZES {
        for channels in 1..=4 {
            for wide in [false, true] {
                for opaque in [false, true] {
                    write_png(&path, size, channels, wide, opaque);
                    for encoding in [Encoding::Srgb, Encoding::Linear, Encoding::Gamma(2.2)] {
                        let summary = check(&path, encoding);
                        assert_eq!(summary.bits, if wide { 16 } else { 8 });
                        let kept = match (channels, opaque) {
                            (1, _) | (2, true) => 1,
                            (3, _) | (4, true) => 3,
                            _ if size == (1, 1) => summary.channels,
                            _ => 4,
                        };
                        assert_eq!(summary.channels, kept);
                        assert!(!summary.whole && summary.replaced == 0);
                        if !channels.is_multiple_of(2) && opaque {
                            break;
                        }
                    }
                }
            }
        }
    }
}

/// An EXR of scan lines with these channels.
fn write_exr(path: &Path, (w, h): (u32, u32), names: &[&str], half: bool, value: impl Fn(usize) -> f32) {
    use exr::prelude::*;
    let area = w as usize * h as usize;
    let list = names.iter().enumerate().map(|(c, &name)| {
        let values = (0..area).map(|i| value(i * names.len() + c));
        let samples = if half {
            FlatSamples::F16(values.map(f16::from_f32).collect())
        } else {
            FlatSamples::F32(values.collect())
        };
        AnyChannel::new(name, samples)
    });
    let channels = AnyChannels::sort(list.collect());
    let layer =
        Layer::new((w as usize, h as usize), LayerAttributes::default(), Encoding::SMALL_LOSSLESS, channels);
    Image::from_layer(layer).write().to_file(path).expect("write");
}

#[test]
fn floats_are_those_in_memory_at_every_level_and_size() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("a.exr");
    for size in SIZES {
        let numbers = noise(size.0 + 7 * size.1, size.0 as usize * size.1 as usize * 4);
        let float = |i: usize| numbers[i] as f32 / 1e9 - 0.5;
        let exact = |i: usize| f16::from_f32(float(i)).to_f32();
        for names in [&["Y"][..], &["Y", "A"], &["R", "G", "B"], &["R", "G", "B", "A"]] {
            write_exr(&path, size, names, true, float);
            assert_eq!(check(&path, Encoding::Srgb).bits, 16);
            write_exr(&path, size, names, false, exact);
            assert_eq!(check(&path, Encoding::Linear).bits, 16);
            write_exr(&path, size, names, false, float);
            let summary = check(&path, Encoding::Linear);
            assert!(summary.bits == 32 || size == (1, 1), "{size:?} {names:?}");
            assert!(!summary.whole);
        }
    }
}

#[test]
fn infinities_and_nan_are_replaced_and_counted() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("a.pfm");
    let (w, h) = (70u32, 66u32);
    for spoil in [1.0f32, 0.1] {
        let mut numbers: Vec<f32> = (0..w * h * 3).map(|i| (i % 128) as f32 * spoil).collect();
        numbers[0] = f32::NAN;
        numbers[2] = f32::INFINITY;
        numbers[300] = f32::NEG_INFINITY;
        numbers[9000] = f32::INFINITY;
        let mut file = format!("PF\n{w} {h}\n-1\n").into_bytes();
        file.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
        std::fs::write(&path, file).expect("write");
        let summary = check(&path, Encoding::Linear);
        assert_eq!((summary.replaced, summary.bits), (3, if spoil == 1.0 { 16 } else { 32 }));
        let (summary, _) = converted(&path, &settings(Container::Exr, Compression::Zip, None));
        assert_eq!(summary.replaced, 3);
    }
}

/// All levels of an EXR by the library's own reader, texels interleaved.
fn exr_levels(file: &[u8], names: &[&str]) -> Vec<(usize, usize, Vec<f32>)> {
    use exr::prelude::*;
    let image = read()
        .no_deep_data()
        .all_resolution_levels()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(file))
        .expect("an EXR");
    let list = &image.layer_data.channel_data.list;
    let find = |name: &str| list.iter().find(|c| c.name == *name).expect("a channel");
    let Levels::Mip { ref level_data, rounding_mode } = find(names[0]).sample_data else {
        panic!("no mip levels")
    };
    assert_eq!(rounding_mode, ::exr::math::RoundingMode::Down);
    let size = image.layer_data.size;
    (0..level_data.len())
        .map(|l| {
            let (w, h) = ((size.0 >> l).max(1), (size.1 >> l).max(1));
            let columns: Vec<Vec<f32>> = names
                .iter()
                .map(|name| {
                    let Levels::Mip { level_data, .. } = &find(name).sample_data else { panic!("no levels") };
                    level_data[l].values_as_f32().collect()
                })
                .collect();
            assert_eq!(columns[0].len(), w * h);
            let texels = (0..w * h).flat_map(|i| columns.iter().map(move |c| c[i]));
            (w, h, texels.collect())
        })
        .collect()
}

#[test]
fn exr_files_have_the_levels_in_memory() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("a.exr");
    for size in SIZES {
        let numbers = noise(size.0 + 7 * size.1, size.0 as usize * size.1 as usize * 4);
        let float = |i: usize| numbers[i] as f32 / 1e9 - 0.5;
        for half in [true, false] {
            for names in [&["Y"][..], &["R", "G", "B"], &["R", "G", "B", "A"]] {
                write_exr(&path, size, names, half, float);
                let store =
                    TextureStore::from_data(read_image(&path).expect("sound"), Encoding::Linear, true)
                        .expect("memory");
                let (stride, _, expected) = store.kept(ImageId(0)).expect("loaded");
                for compression in [Compression::None, Compression::Zip] {
                    let (_, file) = converted(&path, &settings(Container::Exr, compression, None));
                    let ours = exr_levels(&file, names);
                    assert_eq!(ours.len(), expected.len());
                    for (ours, theirs) in ours.iter().zip(&expected) {
                        let number =
                            if half || size == (1, 1) && stride != names.len().next_power_of_two() * 4 {
                                2
                            } else {
                                4
                            };
                        let values: Vec<f32> = theirs
                            .2
                            .chunks_exact(stride)
                            .flat_map(|texel| texel.chunks_exact(number).take(names.len()))
                            .map(|b| match b {
                                [a, b] => f16::from_bits(u16::from_ne_bytes([*a, *b])).to_f32(),
                                b => f32::from_ne_bytes([b[0], b[1], b[2], b[3]]),
                            })
                            .collect();
                        assert!(ours.2 == values, "{size:?} {names:?} half {half}");
                    }
                }
            }
        }
    }
}

#[test]
fn eight_bits_in_exr_are_linear_halves() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("a.png");
    write_png(&path, (65, 3), 4, false, false);
    let data = read_image(&path).expect("sound");
    let (summary, file) = converted(&path, &settings(Container::Exr, Compression::Zip, None));
    assert_eq!((summary.bits, summary.channels, summary.encoding), (16, 4, Encoding::Srgb));
    let levels = exr_levels(&file, &["R", "G", "B", "A"]);
    let Pixels::U8(bytes) = &data.pixels else { panic!("8 bits") };
    let linear = data.linear_rgb(Encoding::Srgb);
    for (i, texel) in levels[0].2.chunks_exact(4).enumerate() {
        let half = |x: f32| f16::from_f32(x).to_f32();
        assert_eq!(texel[..3], linear[i].map(half));
        assert_eq!(texel[3], half(f32::from(bytes[i * 4 + 3]) / 255.0));
    }
}

#[test]
fn uncompressed_tiles_begin_on_pages_and_the_text_says_what_the_file_is() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("a.png");
    write_png(&path, (300, 100), 3, false, true);
    for compression in [Compression::None, Compression::Zip] {
        let (_, file) = converted(&path, &settings(Container::Tiff, compression, Some(Encoding::Gamma(2.2))));
        let mut decoder = Decoder::new(Cursor::new(&file)).expect("a TIFF");
        loop {
            let offsets = decoder.get_tag_u64_vec(Tag::TileOffsets).expect("offsets");
            if compression == Compression::None {
                assert!(offsets.iter().all(|o| o % 4096 == 0), "{offsets:?}");
            }
            let text = decoder.get_tag_ascii_string(Tag::ImageDescription).expect("a text");
            assert_eq!(fingerprint::value(&text, "weir:encoding"), Some("2.2"));
            assert_eq!(fingerprint::value(&text, "weir:source"), Some("00ff"));
            let bytes = fingerprint::value(&text, "weir:bytes").expect("a length");
            assert_eq!(u64::from_str_radix(bytes, 16), Ok(file.len() as u64));
            let wrap = decoder.get_tag_ascii_string(Tag::Unknown(33303)).expect("wrap modes");
            assert_eq!(wrap, "black,black");
            if !decoder.more_images() {
                break;
            }
            decoder.next_image().expect("another level");
        }
    }
}

#[test]
fn large_layouts_are_bigtiff() {
    // Header and directories alone, no tile: which kind it is follows from the size.
    let layout = tiff_out::Layout {
        width: 1 << 17,
        height: 1 << 17,
        channels: 1,
        sample_bytes: 1,
        compression: Compression::None,
        wrap: WrapMode::Periodic,
        associated_alpha: false,
        description: String::new(),
    };
    let mut out = Cursor::new(Vec::new());
    let end = tiff_out::TiffSink::new(&mut out, layout).expect("memory").finish().expect("memory");
    assert_eq!(end, out.get_ref().len() as u64);
    assert_eq!(out.get_ref()[..4], *b"II\x2b\0");
}

#[test]
fn bytes_do_not_depend_on_the_number_of_threads() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("a.png");
    write_png(&path, (501, 333), 4, false, false);
    for container in [Container::Tiff, Container::Exr] {
        let files = [1, 2, 5].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| converted(&path, &settings(container, Compression::Zip, None)).1)
        });
        assert!(files[0] == files[1] && files[1] == files[2]);
    }
}

#[test]
fn a_level_is_what_its_reader_sees_as_a_plain_image() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let (from, to): (PathBuf, PathBuf) = (directory.path().join("a.png"), directory.path().join("b.tx"));
    write_png(&from, (100, 70), 3, false, true);
    let (_, file) = converted(&from, &settings(Container::Tiff, Compression::Zip, None));
    std::fs::write(&to, file).expect("write");
    assert_eq!(read_image(&to).expect("a TIFF"), read_image(&from).expect("a PNG"));
    // Halves, and grey floats, in TIFF and EXR.
    let from = directory.path().join("a.exr");
    for (names, half) in [(&["R", "G", "B"][..], true), (&["Y"], true), (&["Y"], false)] {
        write_exr(&from, (100, 70), names, half, |i| i as f32 * 0.37);
        for (container, name) in [(Container::Tiff, "b.tx"), (Container::Exr, "b.exr")] {
            let to = directory.path().join(name);
            std::fs::write(&to, converted(&from, &settings(container, Compression::Zip, None)).1)
                .expect("write");
            assert_eq!(read_image(&to).expect("sound"), read_image(&from).expect("sound"), "{name}");
        }
    }
}
