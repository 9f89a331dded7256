//! A part of the tile cache under one lock: which tiles are there, which stay, which are being read.
//!
//! Invariant: a tile that no thread holds is handed out only under the lock of its shard, so that
//! who finds it unheld there may take it out.

use super::TileCache;
use super::tile::{Lines, Tile};
use crate::permits::Promise;
use crate::stats::KeyBuildHasher;
use lru::LruCache;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

pub(super) struct Shard {
    pub(super) tiles: LruCache<u64, Arc<Tile>, KeyBuildHasher>,
    /// Coarse levels, which stay.
    pub(super) kept: HashMap<u64, Arc<Tile>, KeyBuildHasher>,
    pub(super) loading: HashMap<u64, Arc<Pending>, KeyBuildHasher>,
}

/// A cache line's worth apart (and its prefetched pair), so that two shards' locks do not collide.
#[repr(align(128))]
pub(super) struct Padded<T>(pub(super) T);

/// A tile that is being read.
pub(super) type Pending = Promise<Arc<Tile>>;

impl Shard {
    /// When the oldest tile that nobody holds was used. Tiles that are held at the old end are in
    /// use, whatever their time says, and become the youngest.
    pub(super) fn oldest(&mut self) -> Option<u64> {
        for _ in 0..self.tiles.len() {
            let (&key, tile) = self.tiles.peek_lru()?;
            if Arc::strong_count(tile) == 1 {
                return Some(tile.used.load(Ordering::Relaxed));
            }
            self.tiles.promote(&key);
        }
        None
    }

    /// Takes the oldest tile out that nobody holds, with its name. Nobody can begin to hold it meanwhile: only
    /// under the shard's lock is a tile handed out that no thread holds.
    pub(super) fn pop(&mut self) -> Option<(u64, Lines)> {
        self.oldest()?;
        let (key, tile) = self.tiles.pop_lru()?;
        Arc::into_inner(tile).map(|tile| (key, tile.lines))
    }
}

/// Lets nobody wait for a thread that has panicked.
pub(super) struct Abandon<'a> {
    pub(super) cache: &'a TileCache,
    pub(super) key: u64,
    pub(super) reserved: u64,
}

impl Drop for Abandon<'_> {
    fn drop(&mut self) {
        // The lines themselves went before, as locals of the reader do.
        self.cache.free(self.reserved);
        let pending = self.cache.shard(self.key).loading.remove(&self.key);
        if let Some(pending) = pending {
            pending.keep(None);
        }
    }
}
