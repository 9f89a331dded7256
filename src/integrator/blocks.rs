//! Records in blocks of one size, so that a long list grows without being copied and several threads can fill it.
//!
//! Invariant: a record keeps its name.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Records of a block.
pub(super) const BLOCK: usize = 1 << 12;

/// A list.
pub(super) struct Blocks<T> {
    blocks: Vec<Vec<T>>,
}

impl<T: Copy> Blocks<T> {
    /// The record called `name`.
    #[inline(always)]
    pub(super) fn get(&self, name: u32) -> &T {
        &self.blocks[name as usize / BLOCK][name as usize % BLOCK]
    }

    /// The names of all records, block by block, each raised by `flag`.
    pub(super) fn names(&self, flag: u32) -> impl Iterator<Item = Range<u32>> {
        self.blocks.iter().enumerate().map(move |(i, block)| {
            let first = (i * BLOCK) as u32 | flag;
            first..first + block.len() as u32
        })
    }

    pub(super) fn is_empty(&self) -> bool {
        self.blocks.is_empty()
    }

    pub(super) fn len(&self) -> usize {
        self.blocks.iter().map(Vec::len).sum()
    }

    pub(super) fn bytes(&self) -> usize {
        self.blocks.len() * BLOCK * size_of::<T>()
    }
}

/// A list that threads fill together.
pub(super) struct Filling<T>(Mutex<Vec<Vec<T>>>);

impl<T: Copy> Filling<T> {
    pub(super) fn new() -> Self {
        Self(Mutex::new(Vec::new()))
    }

    fn add(&self, block: Vec<T>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(block);
    }

    /// All of them; the order of blocks is that in which they came.
    pub(super) fn finish(self) -> Blocks<T> {
        Blocks { blocks: self.0.into_inner().unwrap_or_else(PoisonError::into_inner) }
    }
}

/// What one thread adds to a list.
pub(super) struct Writer<'f, T: Copy> {
    list: &'f Filling<T>,
    block: Vec<T>,
}

impl<'f, T: Copy> Writer<'f, T> {
    pub(super) fn new(list: &'f Filling<T>) -> Self {
        Self { list, block: Vec::new() }
    }

    #[inline(always)]
    pub(super) fn push(&mut self, record: T) {
        if self.block.len() == self.block.capacity() {
            self.turn_over();
        }
        self.block.push(record);
    }

    #[cold]
    #[inline(never)]
    fn turn_over(&mut self) {
        let full = std::mem::replace(&mut self.block, Vec::with_capacity(BLOCK));
        if !full.is_empty() {
            self.list.add(full);
        }
    }
}

impl<T: Copy> Drop for Writer<'_, T> {
    fn drop(&mut self) {
        if !self.block.is_empty() {
            self.list.add(std::mem::take(&mut self.block));
        }
    }
}
