//! Open files: how many, what they count, and what happens when one changes.

use super::super::{Caching, FilePool, TileScratch, TiledFile};
use super::make::Tiff;
use super::{check, open, tiff_texel, written};
use crate::scene::Encoding;
use std::sync::Arc;

#[test]
fn many_files_and_threads_share_few_open_ones() {
    let folder = tempfile::tempdir().expect("folder");
    let pool = Arc::new(FilePool::new(2, Caching::Direct));
    let files: Vec<(Tiff, TiledFile)> = (0..6)
        .map(|i| {
            let spec = Tiff { samples: 1 + i % 4, compression: [1, 5, 8][i as usize % 3], ..Tiff::default() };
            let path = folder.path().join(format!("{i}.tx"));
            std::fs::write(&path, spec.build()).expect("written");
            (spec, TiledFile::open(&path, Encoding::Linear, &pool).expect("readable").expect("tiled"))
        })
        .collect();
    assert_eq!((pool.opens(), pool.open_peak()), (6, 2), "a file stays open until its place is wanted");
    std::thread::scope(|threads| {
        for k in 0..3 {
            let files = &files;
            threads.spawn(move || {
                for i in 0..12 {
                    let (spec, file) = &files[(i * (k + 1)) % files.len()];
                    check(file, |level, x, y, c| tiff_texel(spec, level, x, y, c));
                }
            });
        }
    });
    assert!(pool.opens() > 12, "{}", pool.opens());
    // Each of three threads may hold one more than the pool keeps.
    assert!(pool.open_peak() <= 5, "{}", pool.open_peak());
}

#[test]
fn both_ways_of_reading_agree_and_count_their_bytes() {
    let spec = Tiff { tile: (64, 64), sizes: super::chain(300, 200), compression: 1, ..Tiff::default() };
    let (_folder, path) = written(&spec.build());
    for caching in [Caching::Direct, Caching::System] {
        let pool = Arc::new(FilePool::new(1, caching));
        let file = TiledFile::open(&path, Encoding::Linear, &pool).expect("readable").expect("tiled");
        check(&file, |level, x, y, c| tiff_texel(&spec, level, x, y, c));
        let mut scratch = TileScratch::default();
        let mut out = vec![0; file.tile_bytes()];
        let read = file.read_tile(3, &mut out, &mut scratch).expect("read");
        match caching {
            Caching::System => assert_eq!((read, out.len()), (12288, 12288)),
            // Where the filesystem has no direct reads, the plain one reads no more than it must.
            Caching::Direct => {
                assert!((12288..=16384).contains(&read) && read.is_multiple_of(4096), "{read}")
            }
        }
    }
}

#[test]
fn a_file_that_changes_is_an_error_that_says_so() {
    let read = |file: &TiledFile| {
        let mut out = vec![0; file.tile_bytes()];
        file.read_tile(10, &mut out, &mut TileScratch::default()).map_err(|e| e.to_string())
    };
    let bytes = Tiff::default().build();
    let changed = |change: &dyn Fn(&std::path::Path), word: &str| {
        let (_folder, path) = written(&bytes);
        let file = open(&path);
        read(&file).expect("before");
        change(&path);
        let message = read(&file).expect_err("after");
        assert!(message.contains(word), "{message}");
        assert!(message.starts_with(&path.display().to_string()), "{message}");
        assert!(message.contains("the tile at column 1, row 0 of level 1"), "{message}");
        assert!(!message.contains('\n'));
    };
    let append = |path: &std::path::Path| {
        let mut longer = bytes.clone();
        longer.push(0);
        std::fs::write(path, longer).expect("rewritten");
    };
    changed(&append, "changed while rendering");
    let touch = |path: &std::path::Path| {
        let file = std::fs::File::options().write(true).open(path).expect("open");
        file.set_modified(std::time::UNIX_EPOCH).expect("touched");
    };
    changed(&touch, "changed while rendering");

    // Replaced by another of the same length and time: seen when it is opened again.
    let (folder, path) = written(&bytes);
    let pool = Arc::new(FilePool::new(1, Caching::Direct));
    let file = TiledFile::open(&path, Encoding::Linear, &pool).expect("readable").expect("tiled");
    let other = folder.path().join("other.tx");
    std::fs::write(&other, &bytes).expect("written");
    let time = std::fs::metadata(&path).and_then(|m| m.modified()).expect("time");
    std::fs::File::options().write(true).open(&other).and_then(|f| f.set_modified(time)).expect("touched");
    std::fs::rename(&other, &path).expect("replaced");
    read(&file).expect("the old file is still open");
    std::fs::write(&other, &bytes).expect("written");
    let _second = TiledFile::open(&other, Encoding::Linear, &pool).expect("readable").expect("tiled");
    assert!(read(&file).expect_err("reopened").contains("changed while rendering"));
    std::fs::remove_file(&path).expect("removed");
    let _third = TiledFile::open(&other, Encoding::Linear, &pool).expect("readable").expect("tiled");
    assert!(read(&file).expect_err("gone").contains("cannot be opened again"));
}
