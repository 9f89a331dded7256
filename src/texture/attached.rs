//! The tiles and counts that the calling thread keeps for a cache. Look-ups come from many places,
//! masks that the traversal asks for among them, so a thread keeps them beside its stack.
//!
//! Invariant: what a thread has attached it gives back when the [`Attached`] is dropped; other
//! threads look up too, but keep nothing from one look-up to the next.

use super::cache::{ThreadCache, TileCache};
use std::cell::Cell;
use std::marker::PhantomData;
use std::mem::ManuallyDrop;

struct Held {
    /// The cache's name.
    of: usize,
    /// Belongs to one look-up alone.
    once: bool,
    thread: ThreadCache,
}

thread_local! {
    /// Taken out while it is used: a pointer moves, and what uses it is compiled into its caller.
    /// Never dropped by the thread's end, since the [`Attached`] has taken it away by then, so that
    /// a look-up need not ask whether it is still there.
    static CURRENT: Cell<Option<ManuallyDrop<Box<Held>>>> = const { Cell::new(None) };
}

/// What tells one cache from another while both live.
#[inline(always)]
fn name(cache: &TileCache) -> usize {
    std::ptr::from_ref(cache).addr()
}

/// While it lives, this thread holds tiles of a cache.
pub struct Attached<'a> {
    cache: Option<&'a TileCache>,
    /// It belongs to the thread that made it.
    here: PhantomData<*const ()>,
}

impl<'a> Attached<'a> {
    pub(super) fn new(cache: Option<&'a TileCache>) -> Self {
        let current = CURRENT.take();
        let cache = cache.filter(|_| current.is_none());
        let new = |cache| {
            ManuallyDrop::new(Box::new(Held {
                of: name(cache),
                once: false,
                thread: ThreadCache::new(cache),
            }))
        };
        CURRENT.set(current.or_else(|| cache.map(new)));
        Self { cache, here: PhantomData }
    }
}

impl Drop for Attached<'_> {
    fn drop(&mut self) {
        if let Some(cache) = self.cache
            && let Some(held) = CURRENT.take()
        {
            ManuallyDrop::into_inner(held).thread.finish(cache);
        }
    }
}

/// Look-ups of this thread from now on belong to rays of this depth (0: from the camera).
#[inline(never)]
pub(super) fn set_depth(depth: u32) {
    if let Some(mut held) = CURRENT.take() {
        held.thread.set_depth(depth);
        CURRENT.set(Some(held));
    }
}

/// Runs `f` with what this thread keeps for `cache`, or with something that is empty and forgotten.
#[inline(always)]
pub(super) fn with<R>(cache: &TileCache, f: impl FnOnce(&mut ThreadCache) -> R) -> R {
    let mut held = match CURRENT.take() {
        Some(held) if held.of == name(cache) => held,
        other => for_once(cache, other),
    };
    let result = f(&mut held.thread);
    if held.once {
        forget(cache, held);
    } else {
        CURRENT.set(Some(held));
    }
    result
}

#[cold]
#[inline(never)]
fn for_once(cache: &TileCache, other: Option<ManuallyDrop<Box<Held>>>) -> ManuallyDrop<Box<Held>> {
    CURRENT.set(other);
    ManuallyDrop::new(Box::new(Held { of: name(cache), once: true, thread: ThreadCache::new(cache) }))
}

#[cold]
#[inline(never)]
fn forget(cache: &TileCache, held: ManuallyDrop<Box<Held>>) {
    ManuallyDrop::into_inner(held).thread.finish(cache);
}
