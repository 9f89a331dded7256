//! Open files: how many, what they count, and what happens when one changes.

use super::super::{Caching, FilePool, TileScratch, TiledFile};
use super::make::Tiff;
use super::{check, open, tiff_texel, written};
use crate::scene::Encoding;
use rustix::fs::Advice;
use std::path::Path;
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
    for caching in [Caching::Direct, Caching::Borrow, Caching::System] {
        let pool = Arc::new(FilePool::new(1, caching));
        let file = TiledFile::open(&path, Encoding::Linear, &pool).expect("readable").expect("tiled");
        check(&file, |level, x, y, c| tiff_texel(&spec, level, x, y, c));
        let mut scratch = TileScratch::default();
        let mut out = vec![0; file.tile_bytes()];
        let read = file.read_tile(3, &mut out, &mut scratch).expect("read");
        match caching {
            Caching::System => assert_eq!((read, out.len()), (12288, 12288)),
            // Where the filesystem has no direct reads, the plain one reads no more than it must.
            Caching::Direct | Caching::Borrow => {
                assert!((12288..=16384).contains(&read) && read.is_multiple_of(4096), "{read}")
            }
        }
    }
}

/// Pages of a file that the system has in memory; `None` where nothing tells.
fn pages_in_memory(path: &Path) -> Option<u64> {
    let mut fincore = std::process::Command::new("fincore");
    let said = fincore.args(["--noheadings", "--output", "PAGES"]).arg(path).output().ok()?;
    String::from_utf8(said.stdout).ok()?.trim().parse().ok()
}

#[test]
fn reads_leave_no_second_copy_with_the_system() {
    // Some tiles deflated, which begin anywhere in a block, and some not.
    for compression in [1, 8] {
        let spec = Tiff { tile: (64, 64), sizes: super::chain(900, 700), compression, ..Tiff::default() };
        // Not where temporary files are: those may live in memory anyway.
        let program = std::env::current_exe().expect("a program");
        let folder = tempfile::tempdir_in(program.parent().expect("a folder")).expect("folder");
        let path = folder.path().join("t.tx");
        std::fs::write(&path, spec.build()).expect("written");
        let on_disk = std::fs::File::open(&path).expect("there");
        on_disk.sync_all().expect("on the disk");
        let left = |caching, forget: bool| {
            if forget {
                rustix::fs::fadvise(&on_disk, 0, None, Advice::DontNeed).expect("taken");
            }
            let before = pages_in_memory(&path)?;
            let pool = Arc::new(FilePool::new(1, caching));
            let file = TiledFile::open(&path, Encoding::Linear, &pool).expect("readable").expect("tiled");
            // Threads turn the way of reading under each other.
            std::thread::scope(|threads| {
                for k in 0..3 {
                    let file = &file;
                    threads.spawn(move || {
                        let (mut scratch, mut out) = (TileScratch::default(), vec![0; file.tile_bytes()]);
                        for i in 0..4 * file.tile_count() {
                            let tile = i * (2 * k + 1) % file.tile_count();
                            file.read_tile(tile, &mut out, &mut scratch).expect("read");
                        }
                    });
                }
            });
            Some((before, pages_in_memory(&path)?))
        };
        let Some((0, kept)) = left(Caching::System, true) else { return };
        assert!(kept > 0, "the page cache keeps what is read through it");
        assert_eq!(left(Caching::Direct, true), Some((0, 0)));
        assert_eq!(left(Caching::Borrow, true), Some((0, 0)));
        // What others have brought there stays, and is used.
        std::fs::read(&path).expect("read");
        let (before, after) = left(Caching::Borrow, false).expect("told before");
        assert!(before > 0 && after == before, "{before} {after}");
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
