//! Memory for pages: slots of one size, each on a boundary that direct reads can go to, made some at a time and used
//! again and again.
//!
//! Invariant: never more slots than the limit; none is freed before the end.

use bytes::BytesMut;

/// Bytes that are taken from the system at once, about.
const CHUNK: usize = 1 << 20;
/// What direct reads go to.
pub(super) const ALIGNMENT: usize = 4096;

/// Room for a page.
pub(super) type Slot = BytesMut;

/// Slots that nobody has, and how many more there may be.
pub(super) struct Slots {
    free: Vec<Slot>,
    left: usize,
    bytes: usize,
}

impl Slots {
    /// At most `limit` slots of `bytes` each, whole blocks of [`ALIGNMENT`].
    pub(super) fn new(limit: usize, bytes: usize) -> Self {
        Self { free: Vec::new(), left: limit, bytes }
    }

    /// One that has not been used before.
    pub(super) fn take(&mut self) -> Option<Slot> {
        if self.free.is_empty() {
            self.grow();
        }
        self.free.pop()
    }

    fn grow(&mut self) {
        let count = (CHUNK / self.bytes).clamp(1, self.left.max(1)).min(self.left);
        if count == 0 {
            return;
        }
        self.left -= count;
        let mut chunk = BytesMut::zeroed(count * self.bytes + ALIGNMENT);
        let skip = chunk.as_ptr().align_offset(ALIGNMENT);
        drop(chunk.split_to(skip));
        self.free.extend((0..count).map(|_| chunk.split_to(self.bytes)));
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
                assert_eq!((slot.len(), slot.as_ptr().addr() % ALIGNMENT), (bytes, 0));
                assert!(slot.iter().all(|b| *b == 0), "somebody else has written here");
                slot.fill(1);
                all.push(slot);
            }
            assert_eq!(all.len(), limit);
        }
    }
}
