//! What one thread keeps for itself: the tiles it used last, found without a lock, and its counts.
//!
//! Invariant: before it asks the shared cache for a tile it lets go of the one whose place the new
//! one takes, so that what threads hold stays within their share of the budget.

use super::counters::{DEPTHS, FileCounts};
use super::tile::Tile;
use super::{TileCache, key};
use crate::permits::lock;
use crate::stats::{CacheCounts, SAMPLES, spread};
use crate::texture::tiled::TileScratch;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// A place for a tile.
struct Place {
    key: u64,
    /// Look-ups that ended here since it came.
    uses: u64,
    tile: Arc<Tile>,
}

/// The tiles one thread holds, and what its look-ups cost. Give it back with
/// [`ThreadCache::finish`], or what it counted is lost.
pub struct ThreadCache<const PLACES: usize = 32> {
    /// More than it may use at small budgets; always so many, so that no index is held against it.
    places: Box<[Place; PLACES]>,
    /// Which of the hash's bits choose a place.
    mask: usize,
    /// Look-ups so far at this depth.
    lookups: u64,
    nobody: Arc<Tile>,
    ledger: Ledger,
}

/// The counting part, which is written while a tile is borrowed.
pub(super) struct Ledger {
    pub(super) scratch: TileScratch,
    counts: FileCounts,
    depth: usize,
    sampled: Vec<(u64, u32)>,
    requests: u64,
}

impl Ledger {
    /// Adds to the counts of `key`'s level and of the present depth.
    pub(super) fn book(&mut self, key: u64, level: u32, add: impl Fn(&mut CacheCounts)) {
        add(self.counts.level((key >> 32) as usize, level as usize));
        add(&mut self.counts.depths[self.depth]);
    }
}

impl<const PLACES: usize> ThreadCache<PLACES> {
    /// For a thread that looks up in `cache` now and then: holds no tile once
    /// [`ThreadCache::release`] is called.
    #[must_use]
    pub fn new(cache: &TileCache) -> Self {
        let nobody = Arc::new(Tile::none());
        let place = || Place { key: u64::MAX, uses: 0, tile: Arc::clone(&nobody) };
        Self {
            places: Box::new(std::array::from_fn(|_| place())),
            mask: cache.thread_tiles - 1,
            lookups: 0,
            ledger: Ledger {
                scratch: TileScratch::default(),
                counts: FileCounts::new(cache.files.len()),
                depth: 0,
                sampled: Vec::with_capacity(SAMPLES),
                requests: 0,
            },
            nobody,
        }
    }

    /// The texels of `tile` of `file`, as its source lays them
    /// out; there may be more bytes after them.
    #[inline(always)]
    pub fn tile(&mut self, cache: &TileCache, file: u32, tile: u32) -> &[u8] {
        let key = key(file, tile);
        let at = spread(key) as usize & self.mask & (PLACES - 1);
        self.lookups += 1;
        if self.places[at].key != key {
            self.replace(cache, key, at);
        }
        let place = &mut self.places[at];
        place.uses += 1;
        place.tile.bytes()
    }

    #[cold]
    #[inline(never)]
    fn replace(&mut self, cache: &TileCache, key: u64, at: usize) {
        self.let_go(at);
        let ledger = &mut self.ledger;
        ledger.requests += 1;
        if cache.is_sampled(key) {
            let bytes = super::cost(cache.files[(key >> 32) as usize].lines);
            ledger.sampled.push((key, u32::try_from(bytes).unwrap_or(u32::MAX)));
            if ledger.sampled.len() == SAMPLES {
                cache.references.record(&mut ledger.sampled, std::mem::take(&mut ledger.requests));
            }
        }
        let tile = cache.fetch(key, ledger);
        // The first use is the request itself, which is booked; the others are hits.
        self.places[at] = Place { key, uses: 0, tile };
    }

    /// Empties a place, and books its uses.
    fn let_go(&mut self, at: usize) {
        let place = std::mem::replace(
            &mut self.places[at],
            Place { key: u64::MAX, uses: 0, tile: Arc::clone(&self.nobody) },
        );
        if place.key != u64::MAX {
            let counts = self.ledger.counts.level((place.key >> 32) as usize, place.tile.level as usize);
            counts.lookups += place.uses;
            counts.micro_hits += place.uses.saturating_sub(1);
        }
    }

    /// Look-ups from now on belong to rays of this depth (0: from the camera).
    #[inline]
    pub fn set_depth(&mut self, depth: u32) {
        let counts = &mut self.ledger.counts.depths[self.ledger.depth];
        counts.lookups += std::mem::take(&mut self.lookups);
        self.ledger.depth = (depth as usize).min(DEPTHS - 1);
    }

    /// Lets go of all tiles.
    pub fn release(&mut self) {
        (0..self.places.len()).for_each(|at| self.let_go(at));
    }

    /// Lets go of all tiles and adds what was counted to the cache's totals.
    pub fn finish(mut self, cache: &TileCache) {
        self.release();
        self.set_depth(0);
        for depth in &mut self.ledger.counts.depths {
            // Whatever was not booked on the way was found in the thread's own tiles.
            depth.micro_hits = depth.lookups - depth.hits - depth.misses();
        }
        cache.references.record(&mut self.ledger.sampled, self.ledger.requests);
        lock(&cache.totals).merge(&self.ledger.counts);
        cache.scratch.fetch_max(self.ledger.scratch.bytes() as u64, Ordering::Relaxed);
    }
}
