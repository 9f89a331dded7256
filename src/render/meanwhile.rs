//! A thread that looks now and then while others work.
//!
//! Invariant: it has ended when the work has. Where the system refuses the thread, nobody looks.

use crate::permits::lock;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Set when the work has ended, also where it panics.
struct Ended<'a>(&'a Mutex<bool>, &'a Condvar);

impl Drop for Ended<'_> {
    fn drop(&mut self) {
        *lock(self.0) = true;
        self.1.notify_all();
    }
}

/// Calls `work`, and `look` again and again meanwhile on a thread called `name`, each time after as long as `wait` says.
pub(super) fn meanwhile<R>(
    name: &str,
    wait: impl Fn() -> Duration + Sync,
    mut look: impl FnMut() + Send,
    work: impl FnOnce() -> R,
) -> R {
    let (ended, end) = (Mutex::new(false), Condvar::new());
    let watch = || {
        loop {
            let waited = end.wait_timeout_while(lock(&ended), wait(), |ended| !*ended);
            let (guard, time) = waited.unwrap_or_else(PoisonError::into_inner);
            drop(guard);
            if !time.timed_out() {
                return;
            }
            look();
        }
    };
    std::thread::scope(|scope| {
        let _ended = Ended(&ended, &end);
        let _ = std::thread::Builder::new().name(name.to_owned()).spawn_scoped(scope, watch);
        work()
    })
}
