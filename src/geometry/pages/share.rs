//! A page cache's budget while it changes: what is given to it and taken from it.
//!
//! Invariant: what was taken is nobody's any more, and the system's again.

use super::cache::{PageCache, unit_of};
use super::files::PageFiles;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Pages that go under one lock when the cache shrinks.
const GO_TOGETHER: usize = 32;
/// Looks at whether a page that must go is nobody's yet, some 50 ms in all; then what is in use stays.
const PATIENCE: u32 = 1000;

impl PageCache {
    /// Bytes that pages have taken at most.
    pub(super) fn peak(&self) -> u64 {
        self.peak.load(Ordering::Relaxed)
    }

    /// Whether a page that comes makes another go.
    pub(super) fn is_full(&self, files: &PageFiles) -> bool {
        let slots = &self.comings().slots;
        slots.limit() < files.pages() && slots.made() == slots.limit()
    }

    /// Pages that have come, and the seconds that threads spent reading them.
    pub(super) fn read(&self) -> (u64, f64) {
        (self.comings().reads, self.read_ns.load(Ordering::Relaxed) as f64 * 1e-9)
    }

    /// Pages that caches of so many bytes would have read again, so far.
    pub(super) fn again(&self, sizes: &[u64]) -> Vec<f64> {
        self.references.again(sizes)
    }

    /// Lets pages take `bytes` more.
    pub(super) fn give(&self, bytes: u64, files: &PageFiles) {
        let mut comings = self.comings();
        let budget = self.budget() + bytes;
        self.budget.store(budget, Ordering::Relaxed);
        let room = Self::room_in(budget, files);
        comings.slots.allow(room);
        comings.unit = unit_of(room);
    }

    /// Takes up to `bytes` from pages, but leaves them `least`; how many bytes it were, which nobody uses any more.
    pub(super) fn take(&self, bytes: u64, least: u64, files: &PageFiles) -> u64 {
        let before = self.budget();
        let mut comings = self.comings();
        if !comings.slots.can_shrink() {
            return 0;
        }
        let budget = before.saturating_sub(bytes).max(least.min(before));
        comings.slots.allow(Self::room_in(budget, files));
        for _ in 0..PATIENCE {
            for _ in 0..GO_TOGETHER {
                if !comings.slots.too_many() {
                    break;
                }
                let Some(slot) = self.evict(&mut comings, files) else { break };
                comings.slots.drop(slot);
                self.used.fetch_sub(files.cost(), Ordering::Relaxed);
            }
            if !comings.slots.too_many() {
                break;
            }
            // Others may look and read meanwhile.
            drop(comings);
            std::thread::sleep(Duration::from_micros(50));
            comings = self.comings();
        }
        // What could not go stays allowed.
        let made = comings.slots.made();
        let budget = budget.max((made as u64 * files.cost()).min(before));
        let room = Self::room_in(budget, files);
        comings.slots.allow(room);
        comings.unit = unit_of(room);
        self.budget.store(budget, Ordering::Relaxed);
        before - budget
    }
}
