//! Bytes that are taken and given back.
//!
//! Invariant: never more than the limit, unless taken by force.

use std::sync::atomic::{AtomicUsize, Ordering};

/// A number of bytes, and how many of them are taken.
#[derive(Debug)]
pub struct Meter {
    limit: usize,
    taken: AtomicUsize,
    peak: AtomicUsize,
}

impl Meter {
    /// Of `limit` bytes.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self { limit, taken: AtomicUsize::new(0), peak: AtomicUsize::new(0) }
    }

    /// Takes `bytes` if there is room for `room`, which is no less. Whether it has.
    pub(super) fn take(&self, bytes: usize, room: usize) -> bool {
        let fits = |taken: usize| (taken + room <= self.limit).then_some(taken + bytes);
        let before = self.taken.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits);
        if let Ok(before) = before {
            self.peak.fetch_max(before + bytes, Ordering::Relaxed);
        }
        before.is_ok()
    }

    /// Takes `bytes` if nothing is taken, whatever the limit. Whether it has.
    pub(super) fn take_first(&self, bytes: usize) -> bool {
        let first = self.taken.compare_exchange(0, bytes, Ordering::Relaxed, Ordering::Relaxed).is_ok();
        if first {
            self.peak.fetch_max(bytes, Ordering::Relaxed);
        }
        first
    }

    pub(super) fn has_room(&self, bytes: usize) -> bool {
        self.taken.load(Ordering::Relaxed) + bytes <= self.limit
    }

    pub(super) fn is_free(&self) -> bool {
        self.taken.load(Ordering::Relaxed) == 0
    }

    /// Gives `bytes` back.
    pub fn give(&self, bytes: usize) {
        self.taken.fetch_sub(bytes, Ordering::Relaxed);
    }

    /// Most bytes that were taken at once.
    #[must_use]
    pub fn peak(&self) -> usize {
        self.peak.load(Ordering::Relaxed)
    }
}
