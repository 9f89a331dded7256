//! Pieces of memory of one size that go from hand to hand: what waits lies in them.
//!
//! Invariant: never more pieces than the limit, unless they are taken by force when none is in use. None is freed before
//! the end: what one thread allocates and another frees is not used again by either, and the process would grow.

use crate::permits::lock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard};

/// Words of a piece.
pub const WORDS: usize = 1024;

/// Bytes of a piece.
pub const PIECE_BYTES: usize = 4 * WORDS;

/// A piece of memory.
pub type Piece = Box<[u32; WORDS]>;

/// All pieces of a render.
#[derive(Debug)]
pub struct Meter {
    limit: usize,
    made: AtomicUsize,
    unused: Mutex<Vec<Piece>>,
}

impl Meter {
    /// Of `bytes` bytes at most.
    #[must_use]
    pub fn new(bytes: usize) -> Self {
        Self { limit: bytes / PIECE_BYTES, made: AtomicUsize::new(0), unused: Mutex::default() }
    }

    /// So many pieces that no meter counts.
    pub(super) fn apart(count: usize) -> Vec<Piece> {
        (0..count).map(|_| Box::new([0; WORDS])).collect()
    }

    /// Pieces, at most.
    pub(super) fn limit(&self) -> usize {
        self.limit
    }

    fn unused(&self) -> MutexGuard<'_, Vec<Piece>> {
        lock(&self.unused)
    }

    /// Whether `count` pieces could be had, or none is in use. Under the lock of `unused`, which holds still what it says.
    fn can_give(&self, unused: &[Piece], count: usize) -> bool {
        let in_use = self.made.load(Ordering::Relaxed).saturating_sub(unused.len());
        in_use == 0 || in_use + count <= self.limit
    }

    /// Whether [`Self::several`] is worth a try.
    pub(super) fn has_room(&self, room: usize) -> bool {
        self.can_give(&self.unused(), room)
    }

    /// `count` pieces, if there is room for `room`, which is no less, or if none is in use.
    pub(super) fn several(&self, count: usize, room: usize) -> Option<Vec<Piece>> {
        let mut unused = self.unused();
        if !self.can_give(&unused, room) {
            return None;
        }
        let kept = unused.len().saturating_sub(count);
        let mut pieces = unused.split_off(kept);
        self.made.fetch_add(count - pieces.len(), Ordering::Relaxed);
        pieces.resize_with(count, || Box::new([0; WORDS]));
        Some(pieces)
    }

    /// A piece, if there is room for it.
    #[inline]
    pub(super) fn piece(&self) -> Option<Piece> {
        let mut unused = self.unused();
        let piece = unused.pop();
        if piece.is_none() && self.made.load(Ordering::Relaxed) < self.limit {
            // Under the lock, as everywhere.
            self.made.fetch_add(1, Ordering::Relaxed);
            drop(unused);
            return Some(Box::new([0; WORDS]));
        }
        piece
    }

    /// Takes pieces back.
    pub fn give(&self, pieces: impl IntoIterator<Item = Piece>) {
        self.unused().extend(pieces);
    }

    /// Bytes of all pieces.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.made.load(Ordering::Relaxed) * PIECE_BYTES
    }
}
