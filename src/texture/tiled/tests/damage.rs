//! Damaged files: an error, or texels that nobody promised, and never a panic or memory beyond what
//! the file's length allows.

use super::super::{Caching, FilePool, TileScratch, TiledFile};
use super::make::{self, Tiff};
use super::written;
use crate::scene::Encoding;
use exr::compression::Compression as Exr;
use exr::math::RoundingMode;
use std::path::Path;
use std::sync::Arc;

/// Opens and reads everything; how many tiles failed, or `None` when the file was not opened.
fn read_all(path: &Path) -> Option<usize> {
    let pool = Arc::new(FilePool::new(2, Caching::System));
    let length = std::fs::metadata(path).expect("written").len() as usize;
    let file = match TiledFile::open(path, Encoding::Linear, &pool) {
        Ok(file) => file?,
        Err(e) => {
            assert!(!e.to_string().contains('\n'), "{e}");
            return None;
        }
    };
    // Twelve bytes a tile of at least six in the file, and what does not depend on it.
    assert!(file.index_bytes() < 8192 + 2 * length, "{}", file.index_bytes());
    let mut scratch = TileScratch::default();
    let mut out = vec![0; file.tile_bytes()];
    let mut failed = 0;
    for tile in 0..file.tile_count() {
        if let Err(e) = file.read_tile(tile, &mut out, &mut scratch) {
            let message = e.to_string();
            assert!(message.contains("the tile at column") && !message.contains('\n'), "{message}");
            failed += 1;
        }
    }
    let bound = 256 * 1024 + 8 * file.tile_bytes() + length;
    assert!(scratch.bytes() < bound, "{} bytes of scratch", scratch.bytes());
    Some(failed)
}

/// Mutates every byte of `at` to several values in turn, and cuts the file at many lengths.
fn mutate(bytes: &[u8], seed: u64, rounds: usize) -> (usize, usize) {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("damaged.tx");
    let mut state = seed;
    let mut next = |n: usize| {
        // Knuth's MMIX generator; its upper bits.
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize % n
    };
    let (mut unopened, mut damaged) = (0, 0);
    for round in 0..rounds {
        let mut copy = bytes.to_vec();
        if round % 8 == 0 {
            copy.truncate(next(bytes.len()));
        } else {
            let at = next(bytes.len());
            copy[at] = [next(256) as u8, 0, 255, 128, 1][next(5)];
        }
        std::fs::write(&path, copy).expect("written");
        match read_all(&path) {
            None => unopened += 1,
            Some(failed) => damaged += usize::from(failed > 0),
        }
    }
    (unopened, damaged)
}

#[test]
fn damaged_tiffs_are_errors() {
    let tiny = Tiff { sizes: make::chain(40, 20), tile: (16, 16), ..Tiff::default() };
    let mut seen = (0, 0);
    for (i, spec) in [
        tiny.clone(),
        Tiff { compression: 5, big_tiff: true, ..tiny.clone() },
        Tiff { compression: 1, big_endian: true, bits: 16, samples: 2, ..tiny.clone() },
        Tiff { bits: 32, format: 3, predictor: 3, samples: 4, ..tiny.clone() },
    ]
    .iter()
    .enumerate()
    {
        let (unopened, damaged) = mutate(&spec.build(), i as u64 + 1, 1000);
        seen = (seen.0 + unopened, seen.1 + damaged);
    }
    // Most bytes of these small files are directories; both kinds of damage must have been met.
    assert!(seen.0 > 300 && seen.1 > 300, "{seen:?}");
}

#[test]
fn damaged_exrs_are_errors() {
    let mut seen = (0, 0);
    for (i, compression) in
        [Exr::Uncompressed, Exr::ZIP16, Exr::PIZ, Exr::RLE, Exr::PXR24, Exr::B44].into_iter().enumerate()
    {
        let bytes = make::exr((40, 20), 16, &["R", "G", "B"], &["G"], compression, RoundingMode::Up);
        let (unopened, damaged) = mutate(&bytes, i as u64 + 1, 500);
        seen = (seen.0 + unopened, seen.1 + damaged);
    }
    assert!(seen.0 > 50 && seen.1 > 500, "{seen:?}");
}

#[test]
fn a_damaged_tile_leaves_the_others_and_a_huge_window_is_refused() {
    let spec = Tiff { compression: 8, ..Tiff::default() };
    let mut bytes = spec.build();
    // The first tile follows the header at once: a zlib stream.
    bytes[8 + 40] ^= 0x10;
    let (_folder, path) = written(&bytes);
    assert_eq!(read_all(&path), Some(1));
    // An EXR that claims more tiles than bytes is refused before its table is made room for.
    let exr = make::exr((64, 64), 16, &["Y"], &[], Exr::ZIP16, RoundingMode::Down);
    let at = exr.windows(10).position(|w| w == b"dataWindow").expect("an attribute");
    let mut huge = exr;
    let value = at + b"dataWindow\0box2i\0".len() + 4;
    huge[value + 8..value + 16].fill(0x7f);
    let window = huge.windows(13).position(|w| w == b"displayWindow").expect("an attribute");
    let value = window + b"displayWindow\0box2i\0".len() + 4;
    huge[value + 8..value + 16].fill(0x7f);
    let message = super::refusal(&huge);
    assert!(message.contains("EXR: "), "a side of two thousand million: {message}");
}
