//! Records in pieces of one size: a list that grows without being copied and gives its memory back piece by piece.
//!
//! Invariant: what it holds is what it says it holds, to the byte, but for the table of pieces.

/// Records of a piece.
const PIECE: usize = 64;

/// A list without order.
pub(super) struct Bag<T> {
    /// All but the last are full.
    pieces: Vec<Vec<T>>,
}

impl<T: Copy> Bag<T> {
    pub(super) const fn new() -> Self {
        Self { pieces: Vec::new() }
    }

    /// Bytes of a piece.
    pub(super) const PIECE_BYTES: usize = PIECE * size_of::<T>();

    /// Adds a record, if `reserve` has room for the bytes by which the list must grow. Whether it was added.
    pub(super) fn push(&mut self, record: T, reserve: impl FnOnce(usize) -> bool) -> bool {
        if let Some(last) = self.pieces.last_mut()
            && last.len() < PIECE
        {
            last.push(record);
            return true;
        }
        let room = reserve(Self::PIECE_BYTES);
        if room {
            let mut piece = Vec::with_capacity(PIECE);
            piece.push(record);
            self.pieces.push(piece);
        }
        room
    }

    pub(super) fn len(&self) -> usize {
        self.pieces.last().map_or(0, |last| (self.pieces.len() - 1) * PIECE + last.len())
    }

    /// Moves pieces to `out` until that has `most` records or more, or nothing is left.
    pub(super) fn take(&mut self, most: usize, out: &mut Vec<Vec<T>>) {
        let mut count = 0;
        while count < most
            && let Some(piece) = self.pieces.pop()
        {
            count += piece.len();
            out.push(piece);
        }
        if self.pieces.is_empty() {
            self.pieces = Vec::new();
        }
    }
}
