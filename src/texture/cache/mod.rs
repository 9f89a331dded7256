//! Tiles of textures inside a number of bytes: a sharded least-recently-used cache shared by
//! all threads, and before it a few tiles that each thread holds for itself ([`ThreadCache`]).
//!
//! Invariants: the bytes of all tiles, those being read and those that a thread still holds included,
//! never exceed the budget, not for a moment: room is reserved before it is allocated. No lock is held while
//! a file is read. Of threads that miss one tile together one reads and the others wait. Never interprets a texel.

mod counters;
mod curve;
mod shard;
mod share;
mod source;
mod thread;
mod tile;

pub use counters::FileCounts;
pub use source::TileSource;
pub use thread::ThreadCache;
pub use tile::least_budget;

use crate::clock::Room;
use crate::error::{Error, Result};
use crate::permits::{self, lock};
use crate::stats::{Gauge, KeyBuildHasher, References, nanoseconds, spread};
use lru::LruCache;
use shard::{Abandon, Padded, Shard};
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use tile::{Lines, Tile, allocate, cost, lines_for};

/// Tails that an eviction compares: the oldest of several random ones is nearly the oldest of all.
const TAILS: usize = 4;
/// Shards hold at least so many tiles: below, chance makes their loads too unequal.
const TILES_PER_SHARD: u64 = 64;
const MAX_SHARDS: usize = 64;

/// How a cache is made.
#[derive(Clone, Copy, Debug)]
pub struct CacheOptions {
    /// Bytes of all tiles.
    pub budget: u64,
    /// Threads that look up at the same time, at most.
    pub threads: usize,
    /// A read takes at least so long: slow storage, simulated.
    pub latency: Duration,
    /// Tiles that each thread holds for itself, at most.
    pub thread_tiles: usize,
}

/// One file's part of the cache.
struct CachedFile {
    file: Box<dyn TileSource>,
    /// A bit for every tile: whether it has ever been read.
    seen: Box<[AtomicU64]>,
    /// Lines of one tile.
    lines: usize,
    /// The first tile that is the only one of its level; all after it are too.
    alone: u32,
    failed: AtomicU64,
}

/// The tiles of all tiled files of a scene.
pub struct TileCache {
    /// Bytes that tiles may take, and what of them nobody has.
    budget: AtomicU64,
    left: AtomicU64,
    /// Two tiles a thread: what must be free of levels that stay.
    least: u64,
    /// What threads hold at most, with what each reads.
    hands: u64,
    thread_tiles: usize,
    latency: Duration,
    files: Vec<CachedFile>,
    shards: Box<[Padded<Mutex<Shard>>]>,
    used: Gauge,
    peak: AtomicU64,
    kept: AtomicU64,
    /// Reads so far: the cache's time.
    clock: AtomicU64,
    /// Time spent reading, of all threads.
    read_ns: AtomicU64,
    /// A tile that was used so short a time ago need not be moved up again: a sixteenth of what
    /// the cache held at first. Moving it touches four cache lines of other tiles.
    fresh: u64,
    hand: AtomicUsize,
    /// Requests that reached the shared cache.
    references: References,
    totals: Mutex<FileCounts>,
    failures: Mutex<Vec<String>>,
    /// Largest read buffer of a thread.
    scratch: AtomicU64,
}

/// Names a tile: the file in the upper half, the tile in the lower.
#[inline(always)]
fn key(file: u32, tile: u32) -> u64 {
    u64::from(file) << 32 | u64::from(tile)
}

impl TileCache {
    /// A cache over `files`.
    ///
    /// # Errors
    /// [`Error::Usage`] when the budget is below two of the largest tiles a thread: one that is in
    /// use and one that is being read.
    pub fn new(files: Vec<Box<dyn TileSource>>, options: CacheOptions) -> Result<Self> {
        let files: Vec<CachedFile> = files
            .into_iter()
            .map(|file| CachedFile {
                seen: (0..file.tile_count().div_ceil(64)).map(|_| AtomicU64::new(0)).collect(),
                lines: lines_for(file.tile_bytes()),
                alone: file
                    .first_tiles()
                    .iter()
                    .copied()
                    .find(|&tile| file.is_alone(tile))
                    .unwrap_or(u32::MAX),
                failed: AtomicU64::new(0),
                file,
            })
            .collect();
        let largest_bytes = files.iter().map(|f| f.file.tile_bytes()).max().unwrap_or(0);
        let largest = cost(lines_for(largest_bytes));
        let threads = options.threads.max(1) as u64;
        let least = least_budget(largest_bytes, options.threads);
        if options.budget < least {
            return Err(Error::Usage(format!(
                "a texture memory of {} bytes is too small: {threads} threads need at least {least} (--texture-memory {least}), two tiles of {largest} each",
                options.budget
            )));
        }
        let shards = (options.budget / (largest * TILES_PER_SHARD)).clamp(1, MAX_SHARDS as u64) as usize;
        let shards = 1usize << shards.ilog2();
        // A quarter of what there is at first at most is in threads' hands, a sixteenth in levels that stay; what
        // threads hold and read always fits beside that, and `take` leaves it.
        let thread_tiles = (options.budget / (4 * threads * largest))
            .saturating_sub(1)
            .clamp(1, options.thread_tiles.max(1) as u64);
        let thread_tiles = 1 << thread_tiles.ilog2();
        Ok(Self {
            budget: AtomicU64::new(options.budget),
            left: AtomicU64::new(options.budget),
            least,
            hands: threads * (thread_tiles as u64 + 1) * largest,
            thread_tiles,
            latency: options.latency,
            totals: Mutex::new(FileCounts::new(files.len())),
            files,
            shards: (0..shards)
                .map(|_| {
                    Padded(Mutex::new(Shard {
                        tiles: LruCache::unbounded_with_hasher(KeyBuildHasher::default()),
                        kept: HashMap::default(),
                        loading: HashMap::default(),
                    }))
                })
                .collect(),
            used: Gauge::default(),
            peak: AtomicU64::new(0),
            kept: AtomicU64::new(0),
            clock: AtomicU64::new(0),
            read_ns: AtomicU64::new(0),
            fresh: options.budget / largest / 16,
            hand: AtomicUsize::new(0),
            references: References::default(),
            failures: Mutex::new(Vec::new()),
            scratch: AtomicU64::new(0),
        })
    }

    /// Bytes that tiles may take.
    #[must_use]
    pub fn budget(&self) -> u64 {
        self.budget.load(Ordering::Relaxed)
    }

    /// Whether no tile ever has to go to make room for another.
    #[must_use]
    pub fn fits_all(&self) -> bool {
        let all = |f: &CachedFile| u64::from(f.file.tile_count()).saturating_mul(cost(f.lines));
        self.files.iter().map(all).fold(0, u64::saturating_add) <= self.budget()
    }

    /// Bytes that tiles take now, for whoever watches.
    #[must_use]
    pub fn used(&self) -> Gauge {
        Gauge::clone(&self.used)
    }

    /// Most bytes that tiles have taken at once.
    #[must_use]
    pub fn peak(&self) -> u64 {
        self.peak.load(Ordering::Relaxed)
    }

    /// Bytes of tables beside the tiles: tiles' places in their files, and which have been read.
    #[must_use]
    pub fn index_bytes(&self) -> u64 {
        self.files.iter().map(|f| (f.file.index_bytes() + f.seen.len() * 8) as u64).sum()
    }

    /// The largest read buffer of a thread that is done \[bytes\]; beside the budget.
    #[must_use]
    pub fn scratch_bytes(&self) -> u64 {
        self.scratch.load(Ordering::Relaxed)
    }

    /// What the threads that are done have counted.
    #[must_use]
    pub fn counts(&self) -> FileCounts {
        lock(&self.totals).clone()
    }

    /// One line for each file of which a tile could not be read, in the order of the first time.
    #[must_use]
    pub fn failures(&self) -> Vec<String> {
        lock(&self.failures).clone()
    }

    #[inline(always)]
    fn shard(&self, key: u64) -> MutexGuard<'_, Shard> {
        let index = (spread(key) >> 40) as usize & (self.shards.len() - 1);
        lock(&self.shards[index].0)
    }

    /// The tile `key`, from memory or from its file. Books what it cost.
    fn fetch(&self, key: u64, thread: &mut thread::Ledger) -> Arc<Tile> {
        loop {
            let pending = {
                let mut guard = self.shard(key);
                let shard = &mut *guard;
                if let Some(tile) = shard.tiles.peek(&key).or_else(|| shard.kept.get(&key)) {
                    let tile = Arc::clone(tile);
                    let now = self.clock.load(Ordering::Relaxed);
                    if now - tile.used.load(Ordering::Relaxed) > self.fresh {
                        tile.used.store(now, Ordering::Relaxed);
                        shard.tiles.promote(&key);
                    }
                    drop(guard);
                    thread.book(key, tile.level, |c| c.hits += 1);
                    return tile;
                }
                if let Some(pending) = shard.loading.get(&key) {
                    Some(Arc::clone(pending))
                } else {
                    shard.loading.insert(key, Arc::default());
                    None
                }
            };
            match pending {
                None => return self.load(key, thread),
                Some(pending) => {
                    let start = Instant::now();
                    let tile = pending.wait();
                    let waited = nanoseconds(start);
                    if let Some(tile) = tile {
                        thread.book(key, tile.level, |c| {
                            c.misses_duplicate += 1;
                            c.stall_ns += waited;
                        });
                        return tile;
                    }
                }
            }
        }
    }

    /// Reads a tile whose [`Pending`] this thread has put down.
    fn load(&self, key: u64, thread: &mut thread::Ledger) -> Arc<Tile> {
        let mut abandon = Abandon { cache: self, key, reserved: 0 };
        let (file, index) = (&self.files[(key >> 32) as usize], key as u32);
        let start = Instant::now();
        let mut lines = self.room(file.lines);
        abandon.reserved = cost(file.lines);
        let ready = Instant::now();
        let size = file.file.tile_bytes();
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut lines);
        let read = permits::lend(Room::ReadTextures, || {
            let read = file.file.read_tile(index, &mut bytes[..size], &mut thread.scratch);
            if let Some(rest) = self.latency.checked_sub(ready.elapsed()) {
                std::thread::sleep(rest);
            }
            read
        });
        let (bytes_read, failed) = match read {
            Ok(bytes_read) => (bytes_read, 0),
            Err(error) => {
                file.file.fill_unreadable(&mut bytes[..size]);
                if file.failed.fetch_add(1, Ordering::Relaxed) == 0 {
                    lock(&self.failures).push(error.to_string());
                }
                (0, 1)
            }
        };
        let read_ns = nanoseconds(ready);
        self.read_ns.fetch_add(read_ns, Ordering::Relaxed);
        let bit = 1 << (index % 64);
        let first = file.seen[index as usize / 64].fetch_or(bit, Ordering::Relaxed) & bit == 0;
        let now = self.clock.fetch_add(1, Ordering::Relaxed);
        let level = file.file.level_of(index) as u32;
        let tile = Arc::new(Tile { level, used: AtomicU64::new(now), lines });
        let keep = self.keeps(file, index);
        // Before it can be found, and so before it can go.
        file.file.came(index);
        let pending = {
            let mut shard = self.shard(key);
            if keep {
                shard.kept.insert(key, Arc::clone(&tile));
            } else {
                shard.tiles.put(key, Arc::clone(&tile));
            }
            shard.loading.remove(&key)
        };
        std::mem::forget(abandon);
        if let Some(pending) = pending {
            pending.keep(Some(Arc::clone(&tile)));
        }
        thread.book(key, level, |c| {
            *(if first { &mut c.misses_compulsory } else { &mut c.misses_capacity }) += 1;
            c.bytes_read += bytes_read;
            c.bytes_loaded += size as u64;
            c.footprint_bytes += if first { size as u64 } else { 0 };
            c.stall_ns += ready.duration_since(start).as_nanos() as u64;
            c.read_ns += read_ns;
            c.failed += failed;
        });
        tile
    }

    /// Whether a tile that has just been read stays: levels of one tile do while there is room for
    /// them, because most look-ups from afar end there.
    fn keeps(&self, file: &CachedFile, tile: u32) -> bool {
        let bytes = cost(file.lines);
        let fits = |kept: u64| (kept + bytes <= self.kept_limit(self.budget())).then_some(kept + bytes);
        tile >= file.alone && self.kept.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits).is_ok()
    }

    /// Room for a tile of `lines`, taken from the budget before it is allocated; evicts what has
    /// not been used for longest.
    fn room(&self, lines: usize) -> Lines {
        let bytes = cost(lines);
        loop {
            let fits = |left: u64| left.checked_sub(bytes);
            if self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits).is_ok() {
                let before = self.used.fetch_add(bytes, Ordering::Relaxed);
                self.peak.fetch_max(before + bytes, Ordering::Relaxed);
                return allocate(lines);
            }
            match self.evict() {
                // The same room goes from hand to hand.
                Some(old) if old.len() == lines => return old,
                Some(old) => {
                    let freed = cost(old.len());
                    drop(old);
                    self.free(freed);
                }
                // All that is not in somebody's hands is being read; that ends, in the time of a read.
                None => permits::lend(Room::Idle, || std::thread::sleep(Duration::from_micros(20))),
            }
        }
    }

    /// Nobody has these bytes any more.
    fn free(&self, bytes: u64) {
        self.used.fetch_sub(bytes, Ordering::Relaxed);
        self.left.fetch_add(bytes, Ordering::Relaxed);
    }

    /// Takes the oldest of several shards' oldest tiles out; `None` when every tile is in use.
    fn evict(&self) -> Option<Lines> {
        let n = self.shards.len();
        let start = self.hand.fetch_add(1, Ordering::Relaxed).wrapping_mul(TAILS);
        let oldest = (0..TAILS.min(n))
            .map(|i| (start + i) & (n - 1))
            .filter_map(|i| lock(&self.shards[i].0).oldest().map(|used| (used, i)))
            .min();
        if let Some((_, i)) = oldest
            && let Some(tile) = lock(&self.shards[i].0).pop()
        {
            return Some(self.evicted(tile));
        }
        let tile = (0..n).find_map(|i| lock(&self.shards[(start + i) & (n - 1)].0).pop());
        tile.map(|tile| self.evicted(tile))
    }

    fn evicted(&self, (key, lines): (u64, Lines)) -> Lines {
        self.files[(key >> 32) as usize].file.went(key as u32);
        lines
    }

    #[inline(always)]
    fn is_sampled(&self, key: u64) -> bool {
        self.references.follow(key) && (key as u32) < self.files[(key >> 32) as usize].alone
    }
}

#[cfg(test)]
mod tests;
