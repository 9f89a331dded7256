//! Records in pieces of one size: lists that grow without being copied, and give their memory back piece by piece to a
//! [`Meter`] that all lists share.
//!
//! Invariant: a list holds what it says it holds, but for the table of pieces.

use super::Meter;
use super::meter::{Piece, WORDS};
use bytemuck::Pod;
use std::marker::PhantomData;

/// Pairs of records, in no order.
pub(super) struct Bag<T, E> {
    /// All but the last are full.
    pieces: Vec<Piece>,
    /// Pairs in the last.
    last: usize,
    of: PhantomData<(T, E)>,
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

    pub(super) const fn new() -> Self {
        Self { pieces: Vec::new(), last: 0, of: PhantomData }
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
        self.pieces.len().saturating_sub(1) * Self::IN_A_PIECE + self.last
    }

    /// Moves pieces to `out` until that has got `most` pairs or more, or nothing is left; how many pairs it has got.
    pub(super) fn take(&mut self, most: usize, out: &mut Vec<Taken<T, E>>) -> usize {
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
        count
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

    /// Gives its memory back.
    pub(super) fn give(self, meter: &Meter) {
        meter.give([self.piece]);
    }
}
