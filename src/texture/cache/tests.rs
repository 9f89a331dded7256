//! The cache against sources that exist only here: their texels follow from their numbers.

use super::*;
use crate::error::Error;
use crate::stats::CacheCounts;
use crate::texture::tiled::TileScratch;
use std::sync::atomic::AtomicBool;

/// Tiles of `bytes` bytes in levels of 64, 16, 4 and 1 tiles.
struct Numbers {
    bytes: usize,
    reads: Arc<AtomicU64>,
    delay: Duration,
    broken: Option<u32>,
}

const FIRST: [u32; 4] = [0, 64, 80, 84];
const TILES: u32 = 85;

fn texel(tile: u32, at: usize) -> u8 {
    (tile as usize * 31 + at * 7) as u8
}

impl TileSource for Numbers {
    fn tile_count(&self) -> u32 {
        TILES
    }
    fn tile_bytes(&self) -> usize {
        self.bytes
    }
    fn first_tiles(&self) -> &[u32] {
        &FIRST
    }
    fn index_bytes(&self) -> usize {
        0
    }
    fn read_tile(&self, tile: u32, out: &mut [u8], _: &mut TileScratch) -> Result<u64> {
        std::thread::sleep(self.delay);
        self.reads.fetch_add(1, Ordering::Relaxed);
        if self.broken == Some(tile) {
            return Err(Error::Usage(format!("tile {tile} is broken")));
        }
        out.iter_mut().enumerate().for_each(|(at, b)| *b = texel(tile, at));
        Ok(out.len() as u64 / 2)
    }
    fn fill_unreadable(&self, out: &mut [u8]) {
        out.fill(0xee);
    }
}

fn numbers(bytes: usize) -> Numbers {
    Numbers { bytes, reads: Arc::default(), delay: Duration::ZERO, broken: None }
}

fn cache(files: Vec<Numbers>, budget: u64, threads: usize) -> TileCache {
    let files = files.into_iter().map(|f| Box::new(f) as Box<dyn TileSource>).collect();
    TileCache::new(files, CacheOptions { budget, threads, latency: Duration::ZERO, thread_tiles: 32 })
        .expect("enough")
}

/// What one tile of `bytes` takes.
fn one(bytes: usize) -> u64 {
    cost(lines_for(bytes))
}

/// Keys whose popularity differs, without order.
fn walk(seed: u64, length: usize, mut visit: impl FnMut(u32, u32)) {
    let mut state = seed;
    for _ in 0..length {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let u = (state >> 40) as f64 / (1u64 << 24) as f64;
        visit((state >> 33) as u32 % 3, (u * u * f64::from(TILES)) as u32);
    }
}

#[test]
fn every_texel_is_right_and_every_byte_counted_at_every_budget() {
    let sizes = [4096, 12_288, 10_000];
    for tiles in [4u64, 5, 9, 40, 300] {
        let budget = tiles * one(12_288);
        let cache = cache(sizes.map(numbers).into(), budget, 2);
        std::thread::scope(|scope| {
            for t in 0..2 {
                let cache = &cache;
                scope.spawn(move || {
                    let mut thread: ThreadCache = ThreadCache::new(cache);
                    walk(t, 4000, |file, tile| {
                        let got = thread.tile(cache, file, tile);
                        for at in [0, 4095, sizes[file as usize] - 1] {
                            assert_eq!(got[at], texel(tile, at));
                        }
                        assert!(cache.used.load(Ordering::Relaxed) <= budget);
                    });
                    thread.finish(cache);
                });
            }
        });
        assert!(cache.peak() <= budget && cache.peak() > 0, "{} of {budget}", cache.peak());
        let counts = cache.counts();
        let c = counts.total();
        assert_eq!(c.lookups, 8000);
        assert_eq!(c.lookups, c.micro_hits + c.hits + c.misses());
        let reads: u64 = c.misses_compulsory + c.misses_capacity;
        assert_eq!(c.bytes_read * 2, c.bytes_loaded);
        assert!(reads > 0 && c.footprint_bytes <= c.bytes_loaded);
        let mut by_depth = CacheCounts::default();
        counts.depths.iter().for_each(|d| by_depth.add(d));
        assert_eq!(by_depth, c);
        if tiles == 300 {
            assert_eq!(c.misses_capacity, 0, "everything fits");
        }
        // Nothing is left in anybody's hands.
        let resident: u64 = (0..cache.shards.len())
            .map(|i| {
                let shard = lock(&cache.shards[i].0);
                assert!(shard.tiles.iter().all(|(_, t)| Arc::strong_count(t) == 1));
                let tiles = shard.tiles.iter().map(|(_, t)| t).chain(shard.kept.values());
                tiles.map(|t| cost(t.lines.len())).sum::<u64>()
            })
            .sum();
        assert_eq!(resident, cache.used.load(Ordering::Relaxed));
    }
}

#[test]
fn a_budget_below_two_tiles_a_thread_is_refused_with_the_number_that_would_do() {
    let make = |budget, threads| {
        let options = CacheOptions { budget, threads, latency: Duration::ZERO, thread_tiles: 32 };
        TileCache::new(vec![Box::new(numbers(12_288)) as Box<dyn TileSource>], options)
    };
    let least = 2 * 3 * one(12_288);
    let error = make(least - 1, 3).err().expect("too small").to_string();
    assert!(error.contains(&least.to_string()), "{error}");
    assert!(make(least, 3).is_ok());
}

#[test]
fn one_thread_reads_and_the_others_wait() {
    let source = Numbers { delay: Duration::from_millis(100), ..numbers(4096) };
    let reads = Arc::clone(&source.reads);
    let cache = cache(vec![source], 100 * one(4096), 8);
    let barrier = std::sync::Barrier::new(8);
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| {
                let mut thread: ThreadCache = ThreadCache::new(&cache);
                barrier.wait();
                assert_eq!(thread.tile(&cache, 0, 3)[5], texel(3, 5));
                thread.finish(&cache);
            });
        }
    });
    assert_eq!(reads.load(Ordering::Relaxed), 1);
    let c = cache.counts().total();
    assert_eq!((c.misses_compulsory, c.misses_capacity), (1, 0));
    // A thread that the system started late may have found it there.
    assert_eq!(c.misses_duplicate + c.hits, 7);
    assert!(c.misses_duplicate == 0 || c.stall_ns > 0);
    assert_eq!(c.bytes_read, 2048);
}

#[test]
fn a_tile_that_cannot_be_read_is_one_line_and_a_colour() {
    let source = Numbers { broken: Some(7), ..numbers(4096) };
    let cache = cache(vec![source], 3 * one(4096), 1);
    let mut thread: ThreadCache = ThreadCache::new(&cache);
    for _ in 0..3 {
        for tile in [7, 8, 9, 10, 11] {
            let want = if tile == 7 { 0xee } else { texel(tile, 9) };
            assert_eq!(thread.tile(&cache, 0, tile)[9], want);
        }
    }
    thread.finish(&cache);
    assert_eq!(cache.failures(), ["tile 7 is broken"]);
    assert_eq!(cache.counts().total().failed, 3);
}

#[test]
fn levels_of_one_tile_stay() {
    let cache = cache(vec![numbers(4096)], 40 * one(4096), 1);
    let mut thread: ThreadCache = ThreadCache::new(&cache);
    thread.tile(&cache, 0, 84);
    walk(3, 3000, |_, tile| {
        thread.tile(&cache, 0, tile % 84);
    });
    thread.tile(&cache, 0, 84);
    thread.finish(&cache);
    let counts = cache.counts();
    assert_eq!((counts.files[0][3].misses(), counts.files[0][3].hits), (1, 1));
    assert!(counts.files[0][0].misses_capacity > 0);
}

#[test]
fn depths_are_counted_apart() {
    let cache = cache(vec![numbers(4096)], 40 * one(4096), 1);
    let mut thread: ThreadCache = ThreadCache::new(&cache);
    thread.tile(&cache, 0, 1);
    thread.set_depth(2);
    (0..5).for_each(|_| {
        thread.tile(&cache, 0, 1);
    });
    thread.set_depth(99);
    thread.tile(&cache, 0, 2);
    thread.finish(&cache);
    let d = cache.counts().depths;
    assert_eq!((d[0].lookups, d[0].misses()), (1, 1));
    assert_eq!((d[2].lookups, d[2].micro_hits), (5, 5));
    assert_eq!((d[DEEPEST].lookups, d[DEEPEST].misses_compulsory), (1, 1));
}

const DEEPEST: usize = 15;

#[test]
fn one_run_predicts_the_misses_of_other_sizes() {
    // 30 files of 85 tiles, a million look-ups; the cache that predicts holds a third of them.
    let files = || (0..30).map(|_| numbers(4096)).collect();
    let trace = |visit: &mut dyn FnMut(u32, u32)| {
        let mut state = 5u64;
        walk(11, 300_000, |_, tile| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            visit((state >> 40) as u32 % 30, tile);
        });
    };
    let run = |tiles: u64| {
        let cache = cache(files(), tiles * one(4096), 1);
        let mut thread: ThreadCache = ThreadCache::new(&cache);
        trace(&mut |file, tile| {
            thread.tile(&cache, file, tile);
        });
        thread.finish(&cache);
        cache
    };
    let predicting = run(800);
    for tiles in [100u64, 200, 400, 1200, 2000] {
        let cache = run(tiles);
        let c = cache.counts().total();
        let measured = (c.misses_compulsory + c.misses_capacity) as f64 / c.lookups as f64;
        let predicted = predicting.predicted_misses(cache.budget()) / c.lookups as f64;
        println!("{tiles} tiles: predicted {predicted:.4}, measured {measured:.4}");
        assert!((predicted - measured).abs() < 0.01, "{tiles} tiles: {predicted} against {measured}");
    }
}

#[test]
fn what_no_tile_takes_can_be_taken_and_given() {
    let cache = cache(vec![numbers(4096)], 20 * one(4096), 1);
    let mut thread: ThreadCache = ThreadCache::new(&cache);
    (0..10).for_each(|tile| assert!(!thread.tile(&cache, 0, tile).is_empty()));
    assert_eq!((cache.left(), cache.take(4 * one(4096))), (10 * one(4096), 4 * one(4096)));
    assert_eq!(cache.budget(), 16 * one(4096));
    assert_eq!(cache.take(u64::MAX), 6 * one(4096), "what tiles take stays theirs");
    (10..20).for_each(|tile| assert!(!thread.tile(&cache, 0, tile).is_empty()));
    assert_eq!((cache.budget(), cache.left(), cache.peak()), (10 * one(4096), 0, 10 * one(4096)));
    cache.give(5 * one(4096));
    (20..40).for_each(|tile| assert!(!thread.tile(&cache, 0, tile).is_empty()));
    assert_eq!((cache.budget(), cache.left(), cache.peak()), (15 * one(4096), 0, 15 * one(4096)));
    thread.finish(&cache);
    assert_eq!(cache.read().0, 40);
}

/// Whatever is taken before any tile is read, threads can read all of them afterwards.
#[test]
fn what_threads_need_is_never_taken() {
    for (tiles, threads) in [(40u64, 2), (9, 3), (300, 2)] {
        let cache = cache((0..3).map(|_| numbers(4096)).collect(), tiles * one(4096), threads);
        // Levels that stay have grown in a larger budget.
        cache.give(100 * one(4096));
        let mut thread: ThreadCache = ThreadCache::new(&cache);
        (0..3).for_each(|file| assert!(!thread.tile(&cache, file, 84).is_empty()));
        thread.finish(&cache);
        assert!(cache.take(u64::MAX) > 0);
        assert_eq!(cache.take(u64::MAX), 0, "nothing is left to take");
        std::thread::scope(|scope| {
            for t in 0..threads as u64 {
                let cache = &cache;
                scope.spawn(move || {
                    let mut thread: ThreadCache = ThreadCache::new(cache);
                    walk(t, 3000, |file, tile| assert_eq!(thread.tile(cache, file, tile)[7], texel(tile, 7)));
                    thread.finish(cache);
                });
            }
        });
        assert!(cache.peak() <= (tiles + 100) * one(4096));
    }
}

#[test]
fn a_reader_that_panics_leaves_nobody_waiting() {
    struct Panics(AtomicBool);
    impl TileSource for Panics {
        fn tile_count(&self) -> u32 {
            TILES
        }
        fn tile_bytes(&self) -> usize {
            4096
        }
        fn first_tiles(&self) -> &[u32] {
            &FIRST
        }
        fn index_bytes(&self) -> usize {
            0
        }
        fn read_tile(&self, _: u32, out: &mut [u8], _: &mut TileScratch) -> Result<u64> {
            assert!(!self.0.swap(false, Ordering::SeqCst), "the first reader panics, as this test wants");
            out.fill(1);
            Ok(0)
        }
        fn fill_unreadable(&self, _: &mut [u8]) {}
    }
    let source: Box<dyn TileSource> = Box::new(Panics(AtomicBool::new(true)));
    let options =
        CacheOptions { budget: 8 * one(4096), threads: 2, latency: Duration::ZERO, thread_tiles: 32 };
    let cache = TileCache::new(vec![source], options).expect("enough");
    std::thread::scope(|scope| {
        let first = scope.spawn(|| <ThreadCache>::new(&cache).tile(&cache, 0, 0).len());
        assert!(first.join().is_err());
        assert_eq!(<ThreadCache>::new(&cache).tile(&cache, 0, 0)[0], 1);
    });
}

/// Bytes that this process holds.
fn resident_bytes() -> Option<u64> {
    let pages: u64 = std::fs::read_to_string("/proc/self/statm").ok()?.split(' ').nth(1)?.parse().ok()?;
    Some(pages * 4096)
}

#[test]
#[ignore = "run in a process of its own by the next"]
fn resident_memory_of_many_tiles() {
    let Some(before) = resident_bytes() else { return };
    let (tiles, bytes) = (8000u64, 12_288);
    let files = (0..tiles.div_ceil(u64::from(TILES))).map(|_| numbers(bytes)).collect();
    let cache = cache(files, tiles * one(bytes), 1);
    let mut thread: ThreadCache = ThreadCache::new(&cache);
    for file in 0..cache.files.len() as u32 {
        (0..TILES).for_each(|tile| assert_eq!(thread.tile(&cache, file, tile)[0], texel(tile, 0)));
    }
    thread.finish(&cache);
    let grown = resident_bytes().expect("it was there before") - before;
    let counted = cache.used.load(Ordering::Relaxed);
    assert!(counted > (tiles - 10) * one(bytes), "{counted}");
    // Beside the tiles: the curve's tables and what the process touched for the first time.
    assert!(grown < counted + (2 << 20), "{grown} bytes for {counted} that were counted");
}

#[test]
fn tiles_take_no_more_memory_than_is_counted() {
    let program = std::env::current_exe().expect("this program's own file");
    let name = "texture::cache::tests::resident_memory_of_many_tiles";
    let run = std::process::Command::new(program).args(["--exact", name, "--ignored"]).output();
    let run = run.expect("it started once");
    let text = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success() && text.contains("1 passed"), "{text}");
}
