//! References to a cache as they are sampled while it works, and what caches of other sizes would have read.
//!
//! Invariant: costs a comparison for a reference that is not sampled; a lock only for some dozens that are.

use super::{Knee, StackDistances, sample_hash};
use crate::permits::lock;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

/// Sampled references that a thread hands over together.
pub const SAMPLES: usize = 64;

/// Of all threads.
pub struct References {
    requests: AtomicU64,
    threshold: AtomicU32,
    distances: Mutex<StackDistances>,
}

impl Default for References {
    fn default() -> Self {
        Self {
            requests: AtomicU64::new(0),
            threshold: AtomicU32::new(u32::MAX),
            distances: Mutex::new(StackDistances::new(StackDistances::MAX_KEYS)),
        }
    }
}

impl References {
    /// Whether references to `key` are followed.
    #[inline(always)]
    #[must_use]
    pub fn follow(&self, key: u64) -> bool {
        sample_hash(key) <= self.threshold.load(Ordering::Relaxed)
    }

    /// Takes a thread's sampled references, keys and their bytes, of `requests` references in all.
    pub fn record(&self, sampled: &mut Vec<(u64, u32)>, requests: u64) {
        self.requests.fetch_add(requests, Ordering::Relaxed);
        let mut distances = lock(&self.distances);
        for (key, bytes) in sampled.drain(..) {
            distances.record(key, bytes);
        }
        self.threshold.store(distances.threshold(), Ordering::Relaxed);
    }

    /// What a cache of `bytes` would have read, `first` of it for the first time.
    #[must_use]
    pub fn misses(&self, bytes: u64, first: u64) -> f64 {
        lock(&self.distances).misses(bytes, self.requests.load(Ordering::Relaxed), first)
    }

    /// How often caches of so many bytes would have read again what they had read before, so far.
    #[must_use]
    pub fn again(&self, sizes: &[u64]) -> Vec<f64> {
        let requests = self.requests.load(Ordering::Relaxed);
        let distances = lock(&self.distances);
        sizes.iter().map(|&bytes| distances.misses(bytes, requests, 0)).collect()
    }

    /// Where a larger cache stops paying, where `misses` says what one reads and `first` it reads in any case.
    #[must_use]
    pub fn knee(&self, first: u64, misses: impl Fn(u64) -> f64) -> Option<Knee> {
        // What has several sizes is read in their proportion.
        let pressure = |bytes| misses(bytes) / first.max(1) as f64;
        let sizes = lock(&self.distances).sizes();
        let bytes = sizes.into_iter().find(|&bytes| pressure(bytes) <= 1.1)?;
        Some(Knee { bytes, pressure: pressure(bytes), pressure_at_half: pressure(bytes / 2) })
    }

    /// Predicted misses over `lookups` for caches of other sizes, in rising order of bytes.
    #[must_use]
    pub fn curve(&self, lookups: u64, misses: impl Fn(u64) -> f64) -> Vec<(u64, f64)> {
        let sizes = lock(&self.distances).sizes();
        // Steps of 6 %: a curve to draw.
        let steps = sizes.into_iter().rev().step_by(4);
        let mut curve: Vec<_> = steps.map(|bytes| (bytes, misses(bytes) / lookups.max(1) as f64)).collect();
        curve.reverse();
        curve
    }
}
