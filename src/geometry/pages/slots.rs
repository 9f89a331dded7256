//! Memory for pages: slots of one size, each a map of its own, so that one that is given back is the system's again at
//! once, and so that it begins where direct reads can go to. They are mapped many together, side by side, so that large
//! pages of the system, which it is asked for, cover them: rays jump about in them.
//!
//! Invariant: never more slots than the limit, but while some that are in use are still too many.

use memmap2::MmapMut;
use std::alloc::{Layout, handle_alloc_error};
use std::io;

/// Maps of a process that may be torn apart: the system allows some 65,000 in all. Neighbours count as one until one in
/// between is given back.
const MOST_TORN: usize = 1 << 15;

/// Bytes and slots that are mapped together, at most: of large pages of 2 MiB one at either end is lost, and a lock is held.
const TOGETHER: usize = 16 << 20;
const MOST_TOGETHER: usize = 512;

/// Room for a page.
pub(super) type Slot = MmapMut;

/// How many slots there are, and may be.
pub(super) struct Slots {
    /// Mapped, and nobody's yet.
    free: Vec<Slot>,
    made: usize,
    limit: usize,
    bytes: usize,
}

impl Slots {
    /// At most `limit` slots of `bytes` each.
    pub(super) fn new(limit: usize, bytes: usize) -> Self {
        Self { free: Vec::new(), made: 0, limit, bytes }
    }

    /// One that has not been used before, zeroed; `None` where there are as many as may be.
    pub(super) fn take(&mut self) -> Option<Slot> {
        if self.made >= self.limit {
            return None;
        }
        if self.free.is_empty() && self.map().is_err() {
            if self.made == 0 {
                handle_alloc_error(Layout::array::<u8>(self.bytes).unwrap_or(Layout::new::<u8>()));
            }
            // What the system refuses cannot be used.
            self.limit = self.made;
            return None;
        }
        self.made += 1;
        self.free.pop()
    }

    /// Maps some slots; an error only where there is not one.
    fn map(&mut self) -> io::Result<()> {
        let together = (TOGETHER / self.bytes).clamp(1, MOST_TOGETHER).min(self.limit - self.made);
        while self.free.len() < together {
            match MmapMut::map_anon(self.bytes) {
                Ok(slot) => {
                    #[cfg(target_os = "linux")]
                    // A hint: a system without large pages refuses, and nothing is lost.
                    let _ = slot.advise(memmap2::Advice::HugePage);
                    self.free.push(slot);
                }
                Err(e) if self.free.is_empty() => return Err(e),
                Err(_) => break,
            }
        }
        Ok(())
    }

    /// Gives `slot` back to the system.
    pub(super) fn drop(&mut self, slot: Slot) {
        self.made -= 1;
        drop(slot);
    }

    /// Slots that there are.
    pub(super) fn made(&self) -> usize {
        self.made
    }

    /// Slots that there may be.
    pub(super) fn limit(&self) -> usize {
        self.limit
    }

    /// Allows so many from now on.
    pub(super) fn allow(&mut self, limit: usize) {
        self.limit = limit;
        self.free.truncate(limit.saturating_sub(self.made));
    }

    /// Whether there are more than there may be.
    pub(super) fn too_many(&self) -> bool {
        self.made > self.limit
    }

    /// Whether slots can be given back in any order.
    pub(super) fn can_shrink(&self) -> bool {
        self.made <= MOST_TORN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_are_aligned_their_own_and_not_too_many() {
        for (limit, bytes) in [(1, 4096), (7, 1 << 20), (300, 4096), (40, 65536), (3, 3 << 20)] {
            let mut slots = Slots::new(limit, bytes);
            let mut all = Vec::new();
            while let Some(mut slot) = slots.take() {
                assert_eq!((slot.len(), slot.as_ptr().addr() % 4096), (bytes, 0));
                assert!(slot.iter().all(|b| *b == 0), "somebody else has written here");
                slot.fill(1);
                all.push(slot);
            }
            assert_eq!(all.len(), limit);
            let fewer = limit / 2;
            slots.allow(fewer);
            assert!(slots.take().is_none());
            for slot in all.drain(fewer..) {
                assert!(slots.too_many());
                slots.drop(slot);
            }
            assert!(!slots.too_many() && slots.take().is_none() && slots.made() == fewer);
            slots.allow(limit);
            assert!(slots.take().is_some());
        }
    }
}
