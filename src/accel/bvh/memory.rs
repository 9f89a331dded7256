//! Arrays that are written once and then read at random, on large pages where the system has them.
//!
//! Why: rays jump about in tens of megabytes; with pages of 4 KiB most jumps also miss the processor's table of pages.

use bytemuck::Pod;
use memmap2::{Advice, MmapMut};
use std::marker::PhantomData;

/// From here on an array has a mapping of its own: large pages are 2 MiB, and half of the last is lost on average.
const LARGE: usize = 16 << 20;

/// An array of `T`.
pub(super) struct Frozen<T> {
    memory: Memory<T>,
    length: usize,
}

enum Memory<T> {
    Small(Vec<T>),
    Large(MmapMut, PhantomData<T>),
}

impl<T: Pod> Frozen<T> {
    /// Of `length` zeros, which `fill` overwrites.
    pub(super) fn filled(length: usize, fill: impl FnOnce(&mut [T])) -> Self {
        let bytes = length * size_of::<T>();
        let mut memory = match MmapMut::map_anon(bytes) {
            Ok(map) if bytes >= LARGE && map.as_ptr().cast::<T>().is_aligned() => {
                #[cfg(target_os = "linux")]
                // A hint: a system without large pages refuses, and nothing is lost.
                let _ = map.advise(Advice::HugePage);
                Memory::Large(map, PhantomData)
            }
            _ => Memory::Small(vec![T::zeroed(); length]),
        };
        fill(match &mut memory {
            Memory::Small(elements) => elements,
            Memory::Large(map, _) => bytemuck::cast_slice_mut(map),
        });
        Self { memory, length }
    }

    /// Of `elements`.
    pub(super) fn new(elements: Vec<T>) -> Self {
        if size_of_val(&elements[..]) < LARGE {
            return Self { length: elements.len(), memory: Memory::Small(elements) };
        }
        Self::filled(elements.len(), |out| out.copy_from_slice(&elements))
    }

    /// Its elements.
    #[inline(always)]
    pub(super) fn elements(&self) -> &[T] {
        match &self.memory {
            Memory::Small(elements) => elements,
            Memory::Large(map, _) => bytemuck::cast_slice(map),
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Bytes of the elements.
    pub(super) fn bytes(&self) -> usize {
        self.length * size_of::<T>()
    }
}
