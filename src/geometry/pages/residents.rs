//! Which pages are in memory, counted by the regions that a scheduler has asked about.
//!
//! Invariant: a region's counts are those of its pages, but for what changes while they are read.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// What is known of all pages of a scene.
pub(super) struct Residents {
    /// By page: whether it has ever been in memory.
    seen: Vec<AtomicBool>,
    watch: OnceLock<Watch>,
}

struct Watch {
    /// Where the regions of each page begin in `regions`, and where the last one's end.
    starts: Vec<u32>,
    regions: Vec<u32>,
    /// Pages of each region that are in memory, and that have ever been.
    present: Vec<AtomicU32>,
    seen: Vec<AtomicU32>,
}

impl Residents {
    pub(super) fn new(pages: usize) -> Self {
        Self { seen: (0..pages).map(|_| AtomicBool::new(false)).collect(), watch: OnceLock::new() }
    }

    /// Counts by region from now on: `pairs` of page and region, `regions` of the latter. Once, before any page is read.
    pub(super) fn watch(&self, mut pairs: Vec<(u32, u32)>, regions: usize) {
        pairs.sort_unstable();
        pairs.dedup();
        let mut starts = vec![0; self.seen.len() + 1];
        for &(page, _) in &pairs {
            starts[page as usize + 1] += 1;
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += *start;
            *start = sum;
        }
        let count = || (0..regions).map(|_| AtomicU32::new(0)).collect();
        let regions = pairs.into_iter().map(|(_, region)| region).collect();
        let _ = self.watch.set(Watch { starts, regions, present: count(), seen: count() });
    }

    /// Bytes of these tables.
    pub(super) fn bytes(&self) -> usize {
        let watch = |w: &Watch| 4 * (w.starts.len() + w.regions.len() + 2 * w.seen.len());
        self.seen.len() + self.watch.get().map_or(0, watch)
    }

    /// Pages of `region` that have been in memory and are not; `None` where nobody counts.
    pub(super) fn gone(&self, region: u32) -> Option<u32> {
        let watch = self.watch.get()?;
        let count = |list: &[AtomicU32]| list[region as usize].load(Ordering::Relaxed);
        Some(count(&watch.seen).saturating_sub(count(&watch.present)))
    }

    /// `page` has come; whether for the first time.
    pub(super) fn came(&self, page: u32) -> bool {
        let first = !self.seen[page as usize].swap(true, Ordering::Relaxed);
        self.count(page, |watch, region| {
            watch.present[region].fetch_add(1, Ordering::Relaxed);
            if first {
                watch.seen[region].fetch_add(1, Ordering::Relaxed);
            }
        });
        first
    }

    pub(super) fn went(&self, page: u32) {
        self.count(page, |watch, region| {
            watch.present[region].fetch_sub(1, Ordering::Relaxed);
        });
    }

    fn count(&self, page: u32, each: impl Fn(&Watch, usize)) {
        let Some(watch) = self.watch.get() else { return };
        let range = watch.starts[page as usize] as usize..watch.starts[page as usize + 1] as usize;
        watch.regions[range].iter().for_each(|&region| each(watch, region as usize));
    }
}
