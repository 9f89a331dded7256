//! What threads do, by room of the code: a thread that is clocked is in one room at a time, and says so when it enters
//! another.
//!
//! Invariant: every nanosecond between a thread's [`start`] and its [`stop`] counts in one room, and in no other.
//! Never reads the system's clock for a thread that is not clocked, nor for one that stays where it is. Whoever enters rooms
//! does so for many rays at once: a look at the clock takes as long as a short ray.

use std::cell::Cell;
use std::time::Instant;

/// Where a thread's time goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Room {
    /// Finding the nearest hits of rays.
    TraceClosest,
    /// Finding out whether anything is in the way of rays.
    TraceOcclusion,
    /// Surfaces, materials, textures in memory, lights, and where paths go on.
    Shade,
    /// Starting camera paths.
    Camera,
    /// Summing samples into the film.
    Film,
    /// Reading and decoding tiles of textures.
    ReadTextures,
    /// Reading and checking pages of geometry.
    ReadGeometry,
    /// Making pages of geometry that is made.
    MakeGeometry,
    /// Putting rays into queues, taking them out, sorting them, and writing down what came of them.
    Queues,
    /// Waiting for a permit: another thread computes instead.
    Turn,
    /// Waiting for what another thread reads, for room, for work, or for the others to end.
    Idle,
    /// None of these.
    Other,
}

impl Room {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 12] = [
        Self::TraceClosest,
        Self::TraceOcclusion,
        Self::Shade,
        Self::Camera,
        Self::Film,
        Self::ReadTextures,
        Self::ReadGeometry,
        Self::MakeGeometry,
        Self::Queues,
        Self::Turn,
        Self::Idle,
        Self::Other,
    ];
}

/// Nanoseconds by room, by [`Room`]'s numbers.
pub type Nanoseconds = [u64; Room::ALL.len()];

struct Clock {
    room: Cell<Room>,
    /// Since when it is there; `None` where the thread is not clocked.
    since: Cell<Option<Instant>>,
    spent: [Cell<u64>; Room::ALL.len()],
}

thread_local! {
    static CLOCK: Clock = const {
        Clock {
            room: Cell::new(Room::Other),
            since: Cell::new(None),
            spent: [const { Cell::new(0) }; Room::ALL.len()],
        }
    };
}

/// Clocks this thread from `since` on, in [`Room::Other`].
pub fn start(since: Instant) {
    CLOCK.with(|clock| {
        clock.room.set(Room::Other);
        clock.since.set(Some(since));
        clock.spent.iter().for_each(|spent| spent.set(0));
    });
}

/// What this thread did since [`start`], and when that ended; it is not clocked any more.
#[must_use]
pub fn stop() -> (Nanoseconds, Option<Instant>) {
    CLOCK.with(|clock| {
        let end = clock.since.get().map(|since| clock.book(since));
        clock.since.set(None);
        (std::array::from_fn(|i| clock.spent[i].take()), end)
    })
}

/// From now on this thread is in `room`; where it was before.
#[inline]
pub fn enter(room: Room) -> Room {
    CLOCK.with(|clock| {
        let before = clock.room.get();
        if before != room
            && let Some(since) = clock.since.get()
        {
            clock.since.set(Some(clock.book(since)));
            clock.room.set(room);
        }
        before
    })
}

/// Runs `work` in `room`, and is where it was before afterwards.
#[inline]
pub fn within<R>(room: Room, work: impl FnOnce() -> R) -> R {
    let before = enter(room);
    let result = work();
    enter(before);
    result
}

impl Clock {
    /// Books the time from `since` to now, which it returns.
    #[inline(never)]
    fn book(&self, since: Instant) -> Instant {
        let now = Instant::now();
        let time = now.saturating_duration_since(since);
        let spent = &self.spent[self.room.get() as usize];
        // In 64 bits, which last for hundreds of years; `as_nanos` takes 128.
        spent.set(spent.get() + time.as_secs() * 1_000_000_000 + u64::from(time.subsec_nanos()));
        now
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const NAP: Duration = Duration::from_millis(2);

    #[test]
    fn rooms_have_their_numbers() {
        assert!(Room::ALL.iter().enumerate().all(|(i, room)| *room as usize == i));
    }

    #[test]
    fn all_time_counts_once_and_where_it_was_spent() {
        let from = Instant::now();
        start(from);
        assert_eq!(enter(Room::Shade), Room::Other);
        std::thread::sleep(NAP);
        let before = enter(Room::ReadTextures);
        std::thread::sleep(2 * NAP);
        assert_eq!(enter(before), Room::ReadTextures);
        // Where it is already.
        assert_eq!(enter(Room::Shade), Room::Shade);
        std::thread::sleep(NAP);
        let (spent, end) = stop();
        let all = end.expect("it was clocked").duration_since(from).as_nanos() as u64;
        assert_eq!(spent.iter().sum::<u64>(), all);
        let of = |room: Room| spent[room as usize];
        let nap = NAP.as_nanos() as u64;
        assert!(of(Room::Shade) >= 2 * nap && of(Room::ReadTextures) >= 2 * nap, "{spent:?}");
        assert_eq!(of(Room::Shade) + of(Room::ReadTextures) + of(Room::Other), all);
        assert_eq!(stop(), ([0; Room::ALL.len()], None), "it has stopped");
    }

    #[test]
    fn a_thread_that_is_not_clocked_spends_nothing() {
        std::thread::spawn(|| {
            enter(Room::Shade);
            std::thread::sleep(NAP);
            assert_eq!(stop(), ([0; Room::ALL.len()], None));
        })
        .join()
        .expect("it holds");
    }
}
