//! Miss-ratio curves from one run: stack distances (Mattson et al. 1970) of a spatially hashed sample
//! of the keys (SHARDS: Waldspurger et al., FAST 2015, the fixed-size form with its correction of
//! the counts), so that one run at any cache size predicts the misses of a least-recently-used
//! cache of every other size.
//!
//! Invariant: at most [`StackDistances::MAX_KEYS`] keys are followed, whatever the run touches; a
//! key is followed for as long as its hash is below the threshold, which only ever falls.

use super::KeyBuildHasher;
use std::collections::{BinaryHeap, HashMap};

/// Parts of an octave of sizes that are told apart: sizes are known to 1.5 %.
const PARTS: f64 = 48.0;
/// Octaves of bytes, from 1 to 2⁴⁸.
const OCTAVES: usize = 48;
/// A key that is not at any time.
const EMPTY: u64 = u64::MAX;

/// Follows references to keys and counts their distances in bytes.
pub struct StackDistances {
    max_keys: usize,
    threshold: u32,
    /// By key: when it was last used, in slots.
    last: HashMap<u64, u32, KeyBuildHasher>,
    /// Followed keys by hash, the largest first: the first to be given up.
    by_hash: BinaryHeap<(u32, u64)>,
    /// What was used at each time; [`EMPTY`] where it has been used again or given up since.
    slots: Vec<(u64, u32)>,
    /// Sums of `slots`' sizes (Fenwick 1994).
    sums: Vec<u64>,
    /// Weight of references by distance.
    histogram: Vec<f64>,
}

impl StackDistances {
    /// Keys that are followed at once: an error of less than a percentage point of the references
    /// (½/√4096 is its standard deviation where keys are used alike), and some 300 KB.
    pub const MAX_KEYS: usize = 4096;

    /// Follows every key until there are more than `max_keys`.
    #[must_use]
    pub fn new(max_keys: usize) -> Self {
        let max_keys = max_keys.max(1);
        Self {
            max_keys,
            threshold: u32::MAX,
            last: HashMap::with_capacity_and_hasher(max_keys + 1, KeyBuildHasher::default()),
            by_hash: BinaryHeap::with_capacity(max_keys + 1),
            slots: Vec::with_capacity(max_keys * 4),
            sums: vec![0; max_keys * 4 + 1],
            histogram: vec![0.0; OCTAVES * PARTS as usize],
        }
    }

    /// Keys whose [`sample_hash`] is not below this need not be recorded.
    #[must_use]
    pub fn threshold(&self) -> u32 {
        self.threshold
    }

    /// The share of keys that is followed.
    #[must_use]
    pub fn rate(&self) -> f64 {
        f64::from(self.threshold) / f64::from(u32::MAX)
    }

    /// A reference to `key` (not `u64::MAX`), which takes `bytes` in the cache.
    pub fn record(&mut self, key: u64, bytes: u32) {
        let hash = sample_hash(key);
        if hash >= self.threshold && self.threshold != u32::MAX {
            return;
        }
        if self.slots.len() == self.max_keys * 4 {
            self.compact();
        }
        let now = self.slots.len() as u32;
        if let Some(then) = self.last.insert(key, now) {
            // Everything used since `then`, and itself, must have fitted.
            let since = self.sum_after(then);
            let distance = since as f64 / self.rate() + f64::from(bytes);
            self.histogram[bucket(distance)] += 1.0;
            let old = std::mem::replace(&mut self.slots[then as usize], (EMPTY, 0));
            self.add(then, u64::from(old.1).wrapping_neg());
        } else {
            self.by_hash.push((hash, key));
        }
        self.slots.push((key, bytes));
        self.add(now, u64::from(bytes));
        while self.last.len() > self.max_keys {
            self.lower();
        }
    }

    /// Misses of a least-recently-used cache of `bytes` after `references` references of which
    /// `first` were to keys never seen before (both counted exactly, elsewhere).
    #[must_use]
    pub fn misses(&self, bytes: u64, references: u64, first: u64) -> f64 {
        let rate = self.rate();
        // Counted by the rate, not by the sample's own number of references: where the sample has
        // more or fewer than its share, the difference belongs to few much-used keys, so to the
        // shortest distances, which hit in any case (Waldspurger et al. §4.4).
        let far: f64 = self.histogram[(bucket(bytes as f64) + 1).min(self.histogram.len())..].iter().sum();
        (first as f64 + far / rate).min(references as f64)
    }

    /// Sizes of caches at which something changes, in bytes, rising, and a little beyond the largest:
    /// where a curve is worth drawing.
    #[must_use]
    pub fn sizes(&self) -> Vec<u64> {
        let first = self.histogram.iter().position(|w| *w > 0.0);
        let last = self.histogram.iter().rposition(|w| *w > 0.0);
        let (Some(first), Some(last)) = (first, last) else { return Vec::new() };
        (first..=last + PARTS as usize / 2).map(|i| ((i as f64 + 1.0) / PARTS).exp2() as u64).collect()
    }

    /// Gives up the key with the largest hash, and scales what was counted under the old threshold.
    fn lower(&mut self) {
        let Some((hash, key)) = self.by_hash.pop() else { return };
        if let Some(slot) = self.last.remove(&key) {
            let old = std::mem::replace(&mut self.slots[slot as usize], (EMPTY, 0));
            self.add(slot, u64::from(old.1).wrapping_neg());
        }
        if hash < self.threshold {
            let scale = f64::from(hash) / f64::from(self.threshold);
            self.histogram.iter_mut().for_each(|w| *w *= scale);
            self.threshold = hash.max(1);
        }
    }

    /// Sum of sizes in slots after `slot`.
    fn sum_after(&self, slot: u32) -> u64 {
        let up_to = |n: usize| {
            let (mut i, mut sum) = (n, 0u64);
            while i > 0 {
                sum = sum.wrapping_add(self.sums[i]);
                i &= i - 1;
            }
            sum
        };
        up_to(self.slots.len()).wrapping_sub(up_to(slot as usize + 1))
    }

    fn add(&mut self, slot: u32, difference: u64) {
        let mut i = slot as usize + 1;
        while i < self.sums.len() {
            self.sums[i] = self.sums[i].wrapping_add(difference);
            i += i & i.wrapping_neg();
        }
    }

    /// Closes the gaps between times.
    fn compact(&mut self) {
        let kept: Vec<(u64, u32)> = self.slots.iter().copied().filter(|s| s.0 != EMPTY).collect();
        self.sums.fill(0);
        self.slots.clear();
        for (key, bytes) in kept {
            let now = self.slots.len() as u32;
            self.slots.push((key, bytes));
            self.add(now, u64::from(bytes));
            self.last.insert(key, now);
        }
    }
}

/// The hash by which keys are sampled: all its bits depend on all of the key's (splitmix64's
/// finaliser, Steele et al. 2014).
#[inline(always)]
#[must_use]
pub fn sample_hash(key: u64) -> u32 {
    let mut z = key.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (z >> 32) as u32
}

/// Where a distance of `bytes` is counted; a cache of `bytes` holds all that is counted there or before.
fn bucket(bytes: f64) -> usize {
    ((bytes.max(1.0).log2() * PARTS).ceil() as usize).saturating_sub(1).min(OCTAVES * PARTS as usize - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A least-recently-used cache written as plainly as it can be.
    fn simulate(trace: &[(u64, u32)], bytes: u64) -> u64 {
        let mut stack: Vec<(u64, u32)> = Vec::new();
        let mut misses = 0;
        for &(key, size) in trace {
            match stack.iter().position(|s| s.0 == key) {
                Some(i) => drop(stack.remove(i)),
                None => misses += 1,
            }
            stack.push((key, size));
            while stack.iter().map(|s| u64::from(s.1)).sum::<u64>() > bytes {
                stack.remove(0);
            }
        }
        misses
    }

    /// Keys with very different popularity, of two sizes.
    fn trace(keys: u64, length: usize) -> Vec<(u64, u32)> {
        let mut state = 1u64;
        (0..length)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let u = (state >> 40) as f64 / (1u64 << 24) as f64;
                let key = (u * u * keys as f64) as u64;
                (key, if key.is_multiple_of(3) { 4096 } else { 12_288 })
            })
            .collect()
    }

    #[test]
    fn unsampled_distances_count_the_misses_of_every_size_exactly() {
        let trace = trace(300, 20_000);
        let mut distances = StackDistances::new(1000);
        trace.iter().for_each(|&(key, size)| distances.record(key, size));
        let first = simulate(&trace, u64::MAX);
        for tiles in [1, 2, 5, 20, 50, 100, 150, 250] {
            // A quarter of a tile away from where anything changes.
            let bytes = tiles * 4096 + 1024;
            let got = distances.misses(bytes, trace.len() as u64, first);
            let want = simulate(&trace, bytes);
            // Buckets are 1.5 % wide: what a slightly smaller or larger cache would miss.
            let (most, least) = (simulate(&trace, bytes * 98 / 100), simulate(&trace, bytes * 102 / 100));
            assert!(got >= least as f64 && got <= most as f64, "{bytes}: {got} against {want}");
        }
    }

    #[test]
    fn a_sample_of_a_quarter_predicts_within_two_percentage_points() {
        let trace = trace(6000, 60_000);
        let mut distances = StackDistances::new(1500);
        trace.iter().for_each(|&(key, size)| distances.record(key, size));
        assert!(distances.rate() < 0.3 && distances.last.len() <= 1500);
        let first = simulate(&trace, u64::MAX);
        for bytes in [1u64 << 18, 1 << 20, 1 << 22, 1 << 24] {
            let got = distances.misses(bytes, trace.len() as u64, first) / trace.len() as f64;
            let want = simulate(&trace, bytes) as f64 / trace.len() as f64;
            assert!((got - want).abs() < 0.02, "{bytes}: {got} against {want}");
        }
    }

    #[test]
    fn one_key_again_and_again_is_at_its_own_size() {
        let mut distances = StackDistances::new(10);
        (0..1000).for_each(|_| distances.record(7, 100));
        assert_eq!(distances.misses(97, 1000, 1) as u64, 1000);
        assert_eq!(distances.misses(102, 1000, 1) as u64, 1);
        assert_eq!(distances.sizes().len(), 1 + PARTS as usize / 2);
    }
}
