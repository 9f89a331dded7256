//! What one thread's looks at pages cost: its counts, and the pages it looked at last, so that a page that is looked at
//! again and again counts as one reference.
//!
//! Invariant: holds no page. A look-up is booked once, as what it was.

use super::files::PageFiles;
use crate::stats::{CacheCounts, References, SAMPLES, spread};
use crate::texture::TileScratch;
use crate::texture::cache::FileCounts;

/// Pages that are remembered; 4 KB.
const RECENT: usize = 512;
/// Bits that count the looks at a page, below its name.
const USES: u32 = 44;
/// The name of no page.
const NOBODY: u64 = ((1 << (64 - USES)) - 1) << USES;

/// A thread's.
pub(super) struct Looks {
    recent: Box<[u64; RECENT]>,
    counts: FileCounts,
    pub(super) scratch: TileScratch,
    sampled: Vec<(u64, u32)>,
    requests: u64,
}

impl Looks {
    pub(super) fn new(files: usize) -> Self {
        Self {
            recent: Box::new([NOBODY; RECENT]),
            counts: FileCounts::new(files),
            scratch: TileScratch::default(),
            sampled: Vec::with_capacity(SAMPLES),
            requests: 0,
        }
    }

    /// Counts a look at `page`. False when it has not been looked at lately, and must be [`Self::refer`]red to first.
    #[inline(always)]
    pub(super) fn again(&mut self, page: u32) -> bool {
        let place = &mut self.recent[spread(page.into()) as usize % RECENT];
        let same = *place >> USES == u64::from(page);
        *place += u64::from(same);
        same
    }

    /// A reference to `page`, which counts as a look, and as a hit or a miss by what is booked next.
    pub(super) fn refer(&mut self, page: u32, files: &PageFiles, references: &References) {
        let at = spread(page.into()) as usize % RECENT;
        let last = std::mem::replace(&mut self.recent[at], u64::from(page) << USES | 1);
        // A page that has left since: the look that `again` has counted is the reference.
        let last = if last != NOBODY && last >> USES == u64::from(page) { last - 1 } else { last };
        self.book_uses(last, files);
        self.requests += 1;
        if references.follow(page.into()) {
            self.sampled.push((page.into(), files.cost() as u32));
            if self.sampled.len() == SAMPLES {
                references.record(&mut self.sampled, std::mem::take(&mut self.requests));
            }
        }
    }

    /// The first look was a reference; what followed was found without one.
    fn book_uses(&mut self, place: u64, files: &PageFiles) {
        let (page, uses) = ((place >> USES) as u32, place & ((1 << USES) - 1));
        if place != NOBODY {
            let counts = self.counts.level(files.file_of(page), 0);
            counts.lookups += uses;
            counts.micro_hits += uses - 1;
        }
    }

    /// Adds to the counts of the file of `page`.
    pub(super) fn book(&mut self, page: u32, files: &PageFiles, add: impl Fn(&mut CacheCounts)) {
        add(self.counts.level(files.file_of(page), 0));
    }

    /// What was counted, when this thread is done.
    pub(super) fn finish(mut self, files: &PageFiles, references: &References) -> FileCounts {
        for at in 0..RECENT {
            self.book_uses(self.recent[at], files);
        }
        references.record(&mut self.sampled, self.requests);
        self.counts
    }
}
