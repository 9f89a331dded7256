//! A cache's budget while it changes: what is given to it and taken from it.
//!
//! Invariant: tiles never take more than the budget, whenever it changes; every thread can always have a tile. Never makes a
//! tile go.

use super::TileCache;
use std::sync::atomic::Ordering;

impl TileCache {
    /// Lets tiles take `bytes` more.
    pub fn give(&self, bytes: u64) {
        self.budget.fetch_add(bytes, Ordering::Relaxed);
        self.left.fetch_add(bytes, Ordering::Relaxed);
    }

    /// Takes up to `bytes` of what no tile takes, but leaves what threads may hold, read and keep; how many it were. Memory of
    /// tiles that go is not the system's again, only other tiles', so that none is made to go. One thread alone calls this.
    #[must_use]
    pub fn take(&self, bytes: u64) -> u64 {
        // Levels that stay may grow to a sixteenth of what is left.
        let stays = self.least + self.kept.load(Ordering::Relaxed) + self.hands + self.hands / 15;
        let bytes = bytes.min(self.budget().saturating_sub(stays));
        let less = |left: u64| Some(left - left.min(bytes));
        let taken = match self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, less) {
            Ok(before) | Err(before) => before.min(bytes),
        };
        self.budget.fetch_sub(taken, Ordering::Relaxed);
        taken
    }

    /// Bytes that no tile takes.
    #[must_use]
    pub fn left(&self) -> u64 {
        self.left.load(Ordering::Relaxed)
    }

    /// Tiles that have been read, and the seconds that threads spent on it.
    #[must_use]
    pub fn read(&self) -> (u64, f64) {
        (self.clock.load(Ordering::Relaxed), self.read_ns.load(Ordering::Relaxed) as f64 * 1e-9)
    }
}
