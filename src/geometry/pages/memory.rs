//! The memory in which meshes are cut, shared by all threads that do so at once.
//!
//! Invariant: what is lent out never exceeds the whole. Whoever waits here holds nothing that another waits for, but
//! for its lock, which is taken first.

use crate::error::{Error, Result};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How often somebody who waits looks whether to give up.
const PATIENCE: Duration = Duration::from_millis(20);

/// Bytes to cut meshes in.
pub(super) struct CutMemory {
    whole: u64,
    lent: Mutex<Lent>,
    returned: Condvar,
}

#[derive(Default)]
struct Lent {
    now: u64,
    most: u64,
}

/// Bytes that are lent until this goes.
pub(super) struct Share<'a> {
    of: &'a CutMemory,
    pub(super) bytes: u64,
}

impl CutMemory {
    pub(super) fn new(whole: u64) -> Self {
        Self { whole, lent: Mutex::default(), returned: Condvar::new() }
    }

    fn lent(&self) -> MutexGuard<'_, Lent> {
        // Every critical section leaves it whole.
        self.lent.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Most bytes that were lent at once.
    pub(super) fn most_lent(&self) -> u64 {
        self.lent().most
    }

    /// `bytes`, or all there are if that is less: waits until they are free.
    ///
    /// # Errors
    /// [`Error::Interrupted`] when `stop` says so meanwhile.
    pub(super) fn lend(&self, bytes: u64, stop: &(dyn Fn() -> bool + Sync)) -> Result<Share<'_>> {
        let bytes = bytes.min(self.whole);
        let mut lent = self.lent();
        while self.whole - lent.now < bytes {
            if stop() {
                return Err(Error::Interrupted);
            }
            lent = self.returned.wait_timeout(lent, PATIENCE).unwrap_or_else(PoisonError::into_inner).0;
        }
        lent.now += bytes;
        lent.most = lent.most.max(lent.now);
        Ok(Share { of: self, bytes })
    }
}

impl Drop for Share<'_> {
    fn drop(&mut self) {
        self.of.lent().now -= self.bytes;
        self.of.returned.notify_all();
    }
}
