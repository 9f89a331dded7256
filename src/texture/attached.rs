//! The tiles and counts that the calling thread keeps for a cache. Look-ups come from many places,
//! masks that the traversal asks for among them, so a thread keeps them beside its stack.
//!
//! Invariant: what a thread has attached it gives back when the [`Attached`] is dropped; other
//! threads look up too, but keep nothing from one look-up to the next.

use super::cache::{ThreadCache, TileCache};
use std::cell::RefCell;
use std::marker::PhantomData;

thread_local! {
    static CURRENT: RefCell<Option<(usize, ThreadCache)>> = const { RefCell::new(None) };
}

/// What tells one cache from another while both live.
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
        let cache = cache.filter(|cache| {
            CURRENT.with_borrow_mut(|current| {
                let free = current.is_none();
                if free {
                    *current = Some((name(cache), ThreadCache::new(cache)));
                }
                free
            })
        });
        Self { cache, here: PhantomData }
    }
}

impl Drop for Attached<'_> {
    fn drop(&mut self) {
        if let Some(cache) = self.cache
            && let Some((_, thread)) = CURRENT.with_borrow_mut(Option::take)
        {
            thread.finish(cache);
        }
    }
}

/// Look-ups of this thread from now on belong to rays of this depth (0: from the camera).
#[inline(never)]
pub(super) fn set_depth(depth: u32) {
    CURRENT.with_borrow_mut(|current| {
        if let Some((_, thread)) = current {
            thread.set_depth(depth);
        }
    });
}

/// Runs `f` with what this thread keeps for `cache`, or with something that is empty and forgotten.
#[inline(always)]
pub(super) fn with<R>(cache: &TileCache, f: impl FnOnce(&mut ThreadCache) -> R) -> R {
    CURRENT.with_borrow_mut(|current| match current {
        Some((of, thread)) if *of == name(cache) => f(thread),
        _ => for_once(cache, f),
    })
}

#[cold]
#[inline(never)]
fn for_once<R>(cache: &TileCache, f: impl FnOnce(&mut ThreadCache) -> R) -> R {
    let mut thread = ThreadCache::new(cache);
    let result = f(&mut thread);
    thread.finish(cache);
    result
}
