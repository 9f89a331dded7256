//! Files made on the fly against the texels that were put into them, refusals, and damage.

mod damage;
mod make;
mod pool;

use super::{Caching, Component, FilePool, TileScratch, TiledFile};
use crate::scene::Encoding;
use exr::compression::Compression as Exr;
use exr::math::RoundingMode;
use half::f16;
use make::{Tiff, bits, chain, exr_value, known};
use std::path::{Path, PathBuf};
use std::sync::Arc;

fn pool() -> Arc<FilePool> {
    Arc::new(FilePool::new(4, Caching::Direct))
}

/// Writes `bytes` to a file of a folder that goes with the first of the pair.
fn written(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("t.tx");
    std::fs::write(&path, bytes).expect("written");
    (folder, path)
}

fn open(path: &Path) -> TiledFile {
    TiledFile::open(path, Encoding::Linear, &pool()).expect("readable").expect("tiled")
}

fn refusal(bytes: &[u8]) -> String {
    let (_folder, path) = written(bytes);
    match TiledFile::open(&path, Encoding::Linear, &pool()) {
        Ok(Some(_)) => panic!("opened"),
        Ok(None) => "none".into(),
        Err(e) => {
            let message = e.to_string();
            assert!(message.starts_with(&path.display().to_string()) && !message.contains('\n'), "{message}");
            message
        }
    }
}

/// Reads every tile and compares every texel's bytes, zeros beyond the edges included.
fn check(file: &TiledFile, texel: impl Fn(usize, u32, u32, u32) -> Vec<u8>) {
    let mut out = vec![0xaa; file.tile_bytes()];
    let mut scratch = TileScratch::default();
    let (tw, th) = (1 << file.tile_log2().0, 1 << file.tile_log2().1);
    let mut tile = 0;
    for (i, l) in file.levels().iter().enumerate() {
        assert_eq!(l.first, tile);
        for ty in 0..l.tiles_y {
            for tx in 0..l.tiles_x {
                out.fill(0xaa);
                assert!(file.read_tile(tile, &mut out, &mut scratch).expect("read") > 0);
                tile += 1;
                let size = file.component().bytes();
                for (k, number) in out.chunks_exact(size).enumerate() {
                    let (at, c) = (k as u32 / file.channels(), k as u32 % file.channels());
                    let (x, y) = (tx * tw + at % tw, ty * th + at / tw);
                    if x < l.width && y < l.height {
                        assert_eq!(number, texel(i, x, y, c), "level {i}, {x},{y}, channel {c}");
                    } else {
                        assert!(number.iter().all(|&b| b == 0), "padding of level {i} at {x},{y}");
                    }
                }
            }
        }
    }
    assert_eq!(tile, file.tile_count());
}

fn tiff_texel(spec: &Tiff, level: usize, x: u32, y: u32, c: u32) -> Vec<u8> {
    // Grey and alpha are widened to grey, grey, grey, alpha.
    let c = if spec.samples == 2 { u32::from(c == 3) } else { c };
    let number = bits(spec.bits, spec.format, known(level, x, y, c));
    match (spec.bits, spec.format) {
        (8, _) => vec![number as u8],
        (16, 1) => f16::from_f32(number as f32 / 65535.0).to_ne_bytes().to_vec(),
        (16, _) => (number as u16).to_ne_bytes().to_vec(),
        _ => number.to_ne_bytes().to_vec(),
    }
}

#[test]
fn every_texel_of_every_kind_of_tiff_is_read() {
    for (bits, format) in [(8, 1), (16, 1), (16, 3), (32, 3)] {
        for samples in 1..=4 {
            for (compression, predictor) in [(1, 1), (1, 2), (5, 1), (5, 2), (8, 1), (8, 2), (8, 3), (5, 3)] {
                if predictor == 3 && format == 1 {
                    continue;
                }
                for (big_endian, big_tiff) in [(false, false), (true, false), (false, true), (true, true)] {
                    let base = Tiff { samples, bits, format, compression, predictor, ..Tiff::default() };
                    let spec = Tiff { big_endian, big_tiff, ..base };
                    let (_folder, path) = written(&spec.build());
                    let file = open(&path);
                    assert_eq!(file.levels().len(), spec.sizes.len());
                    assert_eq!(file.tile_log2(), (5, 4));
                    check(&file, |level, x, y, c| tiff_texel(&spec, level, x, y, c));
                }
            }
        }
    }
}

#[test]
fn every_texel_of_every_kind_of_exr_is_read() {
    let shapes: [(&[&str], &[&str], &[u32]); 7] = [
        (&["R", "G", "B"], &[], &[0, 1, 2]),
        (&["A", "R", "Z", "G", "B"], &["Z"], &[1, 3, 4, 0]),
        (&["Y"], &[], &[0]),
        (&["Y", "A"], &[], &[0, 0, 0, 1]),
        (&["height"], &["height"], &[0]),
        (&["R", "G", "B"], &["R", "G", "B"], &[0, 1, 2]),
        (&["R", "G", "B"], &["G"], &[0, 1, 2]),
    ];
    for (names, floats, order) in shapes {
        for compression in [Exr::Uncompressed, Exr::ZIP1, Exr::ZIP16, Exr::PIZ, Exr::RLE] {
            for round in [RoundingMode::Down, RoundingMode::Up] {
                let (_folder, path) = written(&make::exr((75, 37), 16, names, floats, compression, round));
                let file = open(&path);
                let half = order.iter().all(|&c| !floats.contains(&names[c as usize]));
                assert_eq!(file.component(), if half { Component::F16 } else { Component::F32 });
                assert_eq!(file.encoding(), Some(Encoding::Linear));
                check(&file, |level, x, y, c| {
                    let v = exr_value(level, x, y, order[c as usize]);
                    if half { f16::from_f32(v).to_ne_bytes().to_vec() } else { v.to_ne_bytes().to_vec() }
                });
            }
        }
    }
}

#[test]
fn levels_may_be_rounded_up_and_end_at_a_tile() {
    let up = Tiff { sizes: vec![(75, 37), (38, 19), (19, 10)], ..Tiff::default() };
    let (_folder, path) = written(&up.build());
    let file = open(&path);
    assert_eq!(file.levels().iter().map(|l| (l.width, l.height)).collect::<Vec<_>>(), up.sizes);
    let counts: Vec<_> = file.levels().iter().map(|l| (l.tiles_x, l.tiles_y, l.first)).collect();
    assert_eq!(counts, [(3, 3, 0), (2, 2, 9), (1, 1, 13)]);
    check(&file, |level, x, y, c| tiff_texel(&up, level, x, y, c));
}

#[test]
fn other_files_are_left_to_other_readers() {
    let spec = |change: &dyn Fn(&mut Tiff)| {
        let mut spec = Tiff::default();
        change(&mut spec);
        refusal(&spec.build())
    };
    assert_eq!(refusal(b""), "none");
    assert_eq!(refusal(b"\x89PNG\r\n\x1a\n"), "none");
    assert_eq!(spec(&|s| s.sizes.truncate(1)), "none", "no levels");
    assert_eq!(spec(&|s| s.sizes = vec![(75, 37), (75, 37)]), "none", "pages");
    assert_eq!(spec(&|s| s.tile = (48, 48)), "none", "not a power of two");
    assert_eq!(spec(&|s| s.tile = (8, 16)), "none", "tiny tiles");
    assert_eq!(spec(&|s| s.compression = 32773), "none", "PackBits");
    assert_eq!(spec(&|s| s.predictor = 3), "none", "floating point predictor of integers");
    assert_eq!(spec(&|s| (s.bits, s.format) = (16, 2)), "none", "signed");
    let two = make::exr((64, 64), 16, &["R", "G"], &[], Exr::ZIP16, RoundingMode::Down);
    assert_eq!(refusal(&two), "none", "no colour");
}

#[test]
fn levels_that_do_not_halve_to_one_tile_are_refused() {
    let spec = |sizes: &[(u32, u32)]| refusal(&Tiff { sizes: sizes.to_vec(), ..Tiff::default() }.build());
    let short = spec(&[(300, 300), (150, 150)]);
    assert!(short.contains("end at 150×150") && short.contains("one tile"), "{short}");
    let odd = spec(&[(300, 300), (150, 150), (80, 75), (40, 37)]);
    assert!(odd.contains("end at 150×150"), "{odd}");
}

#[test]
fn a_file_may_name_its_curve_and_16_bit_integers_follow_it() {
    let read = |description, encoding| {
        let spec = Tiff { bits: 16, samples: 2, description, ..Tiff::default() };
        let (_folder, path) = written(&spec.build());
        let file = TiledFile::open(&path, encoding, &pool()).expect("readable").expect("tiled");
        let mut out = vec![0; file.tile_bytes()];
        file.read_tile(0, &mut out, &mut TileScratch::default()).expect("read");
        let at = |k: usize| f16::from_ne_bytes([out[2 * k], out[2 * k + 1]]).to_f64();
        // Texel 3, 0: grey and opacity.
        (at(12), at(15))
    };
    let (grey, alpha) = (f64::from(known(0, 3, 0, 0)) / 65535.0, f64::from(known(0, 3, 0, 1)) / 65535.0);
    let near = |(g, a): (f64, f64), power: f64| {
        // Half a unit of a half's last place.
        assert!((g / grey.powf(power) - 1.0).abs() < 1.0 / 2048.0, "{g} {power}");
        assert!((a / alpha - 1.0).abs() < 1.0 / 2048.0, "opacity has no curve");
    };
    near(read("", Encoding::Linear), 1.0);
    near(read("", Encoding::Gamma(0.5)), 0.5);
    near(read("made by hand weir:encoding=0.5 and more", Encoding::Srgb), 0.5);
    near(read("weir:encoding=linear", Encoding::Srgb), 1.0);

    let named = |description| {
        let (_folder, path) = written(&Tiff { description, ..Tiff::default() }.build());
        open(&path).encoding()
    };
    assert_eq!(named(""), None);
    assert_eq!(named("weir:encoding=srgb"), Some(Encoding::Srgb));
    assert_eq!(named("x weir:encoding=2.2"), Some(Encoding::Gamma(2.2)));
    let wrong = refusal(&Tiff { description: "weir:encoding=blue", ..Tiff::default() }.build());
    assert!(wrong.contains("srgb, linear or a power"), "{wrong}");
}

#[test]
fn texels_that_are_no_numbers_become_numbers() {
    let mut half = [0x7c00u16, 0xfc00, 0x7e01, 0x3c00].map(u16::to_ne_bytes).concat();
    super::decode::make_finite(&mut half, Component::F16);
    assert_eq!(half, [0x7bffu16, 0xfbff, 0, 0x3c00].map(u16::to_ne_bytes).concat());
    let mut float = [f32::INFINITY, f32::NEG_INFINITY, f32::NAN, -1e30].map(f32::to_ne_bytes).concat();
    super::decode::make_finite(&mut float, Component::F32);
    assert_eq!(float, [65504f32, -65504.0, 0.0, -1e30].map(f32::to_ne_bytes).concat());
}

#[test]
fn a_large_level_has_all_its_tiles() {
    // More offsets than one piece of a table.
    let spec = Tiff { sizes: chain(2100, 1100), tile: (16, 16), samples: 1, ..Tiff::default() };
    let (_folder, path) = written(&spec.build());
    let file = open(&path);
    assert!(file.tile_count() > 9000 && file.index_bytes() > 9000 * 12);
    check(&file, |level, x, y, c| tiff_texel(&spec, level, x, y, c));
}
