//! Records in pieces of one size: lists that grow without being copied, and give their memory back piece by piece to a
//! [`Meter`] that all lists share. Some of their records may lie in a file instead ([`Spill`]).
//!
//! Invariant: a list holds what it says it holds, but for the table of pieces.

use super::Meter;
use super::meter::{Piece, WORDS};
use super::spill::{NO_RUN, Run, Spill};
use bytemuck::Pod;
use std::marker::PhantomData;

/// Pairs of records, in no order.
pub(super) struct Bag<T, E> {
    /// All but the last are full.
    pieces: Vec<Piece>,
    /// Pairs in the last.
    last: usize,
    /// The last run in the file, and pairs in all of them.
    run: u32,
    spilled: usize,
    of: PhantomData<(T, E)>,
}

/// A list of any records, as far as it lies in memory or not.
pub(super) trait Shelf {
    /// Bytes of a pair, and pairs in a full piece.
    fn sizes(&self) -> (usize, usize);
    /// Pieces in memory.
    fn pieces(&self) -> usize;
    /// Takes at most so many pieces, to be put elsewhere: the first may not be full. The pairs in them.
    fn lift(&mut self, most: usize) -> (Vec<Piece>, usize);
    /// Takes back what was lifted; a piece that is left over.
    fn lower(&mut self, pieces: Vec<Piece>, pairs: usize) -> Option<Piece>;
    /// Adds what was lifted and lies in `spill` now.
    fn add(&mut self, run: Run, spill: &Spill);
}

/// A piece that was taken, and the pairs in it.
pub(super) struct Taken<T, E> {
    piece: Piece,
    len: usize,
    of: PhantomData<(T, E)>,
}

/// Words of a pair: those of the first, and all.
const fn words<T, E>() -> (usize, usize) {
    assert!(align_of::<T>() <= 4 && align_of::<E>() <= 4, "records are made of words");
    (size_of::<T>() / 4, size_of::<T>() / 4 + size_of::<E>() / 4)
}

impl<T: Pod, E: Pod> Bag<T, E> {
    const SIZE: (usize, usize) = words::<T, E>();
    const IN_A_PIECE: usize = WORDS / Self::SIZE.1;
    const PAIR_BYTES: usize = 4 * Self::SIZE.1;

    pub(super) const fn new() -> Self {
        Self { pieces: Vec::new(), last: 0, run: NO_RUN, spilled: 0, of: PhantomData }
    }

    /// Adds a pair, if there is room for the piece that it may need. Whether it was added.
    #[inline]
    pub(super) fn push(&mut self, first: &T, second: &E, meter: &Meter) -> bool {
        if self.pieces.is_empty() || self.last == Self::IN_A_PIECE {
            let Some(piece) = meter.piece() else { return false };
            self.pieces.push(piece);
            self.last = 0;
        }
        let piece = self.pieces.last_mut().expect("there is one");
        let (split, all) = Self::SIZE;
        let (a, b) = piece[self.last * all..][..all].split_at_mut(split);
        // By bytes: records need not be aligned as words are.
        bytemuck::cast_slice_mut::<u32, u8>(a).copy_from_slice(bytemuck::bytes_of(first));
        bytemuck::cast_slice_mut::<u32, u8>(b).copy_from_slice(bytemuck::bytes_of(second));
        self.last += 1;
        true
    }

    pub(super) fn len(&self) -> usize {
        self.in_memory() + self.spilled
    }

    fn in_memory(&self) -> usize {
        self.pieces.len().saturating_sub(1) * Self::IN_A_PIECE + self.last
    }

    /// Moves pieces to `out`, and then runs to `runs`, until they have got `most` pairs or more, or nothing is left; how
    /// many pairs they have got.
    pub(super) fn take(
        &mut self,
        most: usize,
        out: &mut Vec<Taken<T, E>>,
        runs: &mut Vec<Run>,
        spill: Option<&Spill>,
    ) -> usize {
        let mut count = 0;
        while count < most
            && let Some(piece) = self.pieces.pop()
        {
            out.push(Taken { piece, len: self.last, of: PhantomData });
            count += self.last;
            self.last = if self.pieces.is_empty() { 0 } else { Self::IN_A_PIECE };
        }
        if self.pieces.is_empty() {
            self.pieces = Vec::new();
        }
        while count < most
            && let Some(spill) = spill.filter(|_| self.run != NO_RUN)
        {
            let (run, before) = spill.unlink(self.run);
            self.run = before;
            self.spilled -= run.pairs as usize;
            count += run.pairs as usize;
            runs.push(run);
        }
        count
    }

    /// Asks for `runs`, to be fetched later.
    pub(super) fn expect(runs: &[Run], spill: &Spill) {
        runs.iter().for_each(|run| spill.expect(run, run.pairs as usize * Self::PAIR_BYTES));
    }

    /// Reads `run` into pieces of `hand`; `None` when it has too few, and what was read, or nothing where it is lost.
    pub(super) fn fetch(run: &Run, hand: &mut Vec<Piece>, spill: &Spill) -> Option<Vec<Taken<T, E>>> {
        let pairs = run.pairs as usize;
        let kept = hand.len().checked_sub(pairs.div_ceil(Self::IN_A_PIECE))?;
        let mut pieces = hand.split_off(kept);
        let last = pairs - (pieces.len() - 1) * Self::IN_A_PIECE;
        let (last_bytes, full_bytes) = (last * Self::PAIR_BYTES, Self::IN_A_PIECE * Self::PAIR_BYTES);
        if !spill.read(run, &mut pieces, last_bytes, full_bytes) {
            hand.extend(pieces);
            return Some(Vec::new());
        }
        let count = pieces.len();
        let len = |i: usize| if i + 1 == count { last } else { Self::IN_A_PIECE };
        let taken = |(i, piece)| Taken { piece, len: len(i), of: PhantomData };
        Some(pieces.into_iter().enumerate().map(taken).collect())
    }
}

impl<T: Pod, E: Pod> Shelf for Bag<T, E> {
    fn sizes(&self) -> (usize, usize) {
        (Self::PAIR_BYTES, Self::IN_A_PIECE)
    }

    fn pieces(&self) -> usize {
        self.pieces.len()
    }

    fn lift(&mut self, most: usize) -> (Vec<Piece>, usize) {
        let before = self.in_memory();
        let mut pieces = self.pieces.split_off(self.pieces.len().saturating_sub(most));
        pieces.reverse();
        self.last = if self.pieces.is_empty() { 0 } else { Self::IN_A_PIECE };
        (pieces, before - self.in_memory())
    }

    fn lower(&mut self, pieces: Vec<Piece>, pairs: usize) -> Option<Piece> {
        let mut full = pieces;
        let first = full.remove(0);
        let mut left = pairs - full.len() * Self::IN_A_PIECE;
        if let Some(last) = self.pieces.last_mut() {
            let (all, moved) = (Self::SIZE.1, left.min(Self::IN_A_PIECE - self.last));
            left -= moved;
            last[self.last * all..][..moved * all].copy_from_slice(&first[left * all..][..moved * all]);
            self.last += moved;
        }
        self.pieces.splice(0..0, full);
        if left == 0 {
            return Some(first);
        }
        self.pieces.push(first);
        self.last = left;
        None
    }

    fn add(&mut self, run: Run, spill: &Spill) {
        self.spilled += run.pairs as usize;
        self.run = spill.link(run, self.run);
    }
}

impl<T: Pod, E: Pod> Taken<T, E> {
    /// Pairs in it.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Pair `i`.
    #[inline(always)]
    pub(super) fn get(&self, i: usize) -> (T, E) {
        let (split, all) = Bag::<T, E>::SIZE;
        let (a, b) = self.piece[i * all..][..all].split_at(split);
        (*bytemuck::from_bytes(bytemuck::cast_slice(a)), *bytemuck::from_bytes(bytemuck::cast_slice(b)))
    }

    /// Its memory.
    pub(super) fn into_piece(self) -> Piece {
        self.piece
    }
}
