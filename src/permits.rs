//! How many threads compute at once, where more of them exist than processors are to be used: one that waits for a disk
//! lends its permit to another.
//!
//! Invariant: never more threads hold a permit than there are. A thread without one is not held up by this, as long as
//! nobody reads what may have to come from a disk while holding a lock: who lends gets its permit back only when another
//! gives one up, and that one may be waiting for the lock.

use crate::clock::{Room, enter, within};
use std::cell::RefCell;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

thread_local! {
    /// The permits that this thread has one of.
    static HELD: RefCell<Option<Arc<Permits>>> = const { RefCell::new(None) };
}

/// A number of permits.
#[derive(Debug)]
pub struct Permits {
    free: Mutex<usize>,
    returned: Condvar,
}

impl Permits {
    /// `count` of them.
    #[must_use]
    pub fn new(count: usize) -> Arc<Self> {
        Arc::new(Self { free: Mutex::new(count.max(1)), returned: Condvar::new() })
    }

    fn take(&self) {
        let free = lock(&self.free);
        let none = |free: &mut usize| *free == 0;
        *self.returned.wait_while(free, none).unwrap_or_else(PoisonError::into_inner) -= 1;
    }

    fn give(&self) {
        *lock(&self.free) += 1;
        self.returned.notify_one();
    }

    /// Runs `work` with a permit, which is waited for.
    pub fn hold<R>(self: &Arc<Self>, work: impl FnOnce() -> R) -> R {
        /// Gives it back in a panic too.
        struct Back;
        impl Drop for Back {
            fn drop(&mut self) {
                if let Some(permits) = HELD.take() {
                    permits.give();
                }
            }
        }
        within(Room::Turn, || self.take());
        HELD.set(Some(Arc::clone(self)));
        let _back = Back;
        work()
    }
}

/// Lends this thread's permit, if it has one, while `wait` runs, whose time counts in `room`.
#[inline]
pub fn lend<R>(room: Room, wait: impl FnOnce() -> R) -> R {
    within(room, || match HELD.take() {
        None => wait(),
        Some(permits) => {
            permits.give();
            let result = wait();
            enter(Room::Turn);
            permits.take();
            HELD.set(Some(permits));
            result
        }
    })
}

/// Locks `mutex`, whatever has become of who held it. For data that are whole before anything that may panic, and for those
/// that nobody uses after a panic.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What one thread makes while others wait for it.
pub struct Promise<T> {
    state: Mutex<State<T>>,
    done: Condvar,
}

enum State<T> {
    Open,
    /// `None` where its maker has come to grief.
    Kept(Option<T>),
}

impl<T> Default for Promise<T> {
    fn default() -> Self {
        Self { state: Mutex::new(State::Open), done: Condvar::new() }
    }
}

impl<T: Clone> Promise<T> {
    /// Gives it to all who wait; `None` when it will not come.
    pub fn keep(&self, made: Option<T>) {
        *lock(&self.state) = State::Kept(made);
        self.done.notify_all();
    }

    /// What was made, when it is there; `None` when its maker gave up. Lends this thread's permit meanwhile.
    pub fn wait(&self) -> Option<T> {
        lend(Room::Idle, || {
            let mut state = lock(&self.state);
            loop {
                if let State::Kept(made) = &*state {
                    return made.clone();
                }
                state = self.done.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    #[test]
    fn no_more_compute_than_there_are_permits_and_those_who_wait_make_room() {
        let permits = Permits::new(2);
        let (computing, waiting) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let (most, most_waiting) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let during = |count: &AtomicUsize, most: &AtomicUsize| {
            most.fetch_max(count.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(2));
            count.fetch_sub(1, Ordering::SeqCst);
        };
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    permits.hold(|| {
                        for _ in 0..10 {
                            during(&computing, &most);
                            lend(Room::Idle, || during(&waiting, &most_waiting));
                        }
                    });
                });
            }
        });
        assert!(most.into_inner() <= 2, "more computed than there are permits");
        assert!(most_waiting.into_inner() > 2, "no more waited than computed");
        assert_eq!(*permits.free.lock().expect("whole"), 2);
    }
}
