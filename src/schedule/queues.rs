//! The queues of all voxels, and what a thread does with them.
//!
//! A ray is traced in one voxel only against what it enters there, then goes on to the queue of the next voxel with
//! pages on its way. When there is no room in memory some of those that wait go to a file (`spilling.rs`); when there is none
//! there either it is traced to its end where it is: slower, but never more memory and never a standstill.
//!
//! Invariant: bytes of queues stay below their limit, but for what threads have in their hands; no lock is held while a
//! ray is traced.

use super::bag::{Bag, Taken};
use super::spill::{Run, Spill};
use super::worker::{Key, Worker};
use super::{Grid, Ledger, Meter, Order, Piece, Sink, Traveller};
use crate::accel::{Accel, Hit};
use crate::clock::{Room, enter};
use crate::permits::{self, lock};
use bytemuck::{Pod, Zeroable};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};

/// How much may wait, and how much runs together.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Pieces that [`Sink::begin`] keeps until its last ray has been answered.
    pub begun: usize,
    /// Pieces that there must be room for before it is called: its rays too.
    pub begin: usize,
    /// Rays of a queue that a thread takes at once, at most.
    pub taken: usize,
    /// Threads that share a queue: how many of them its rays are worth.
    pub shares: usize,
    /// Voxels that are run at once.
    pub voxels: usize,
}

/// Where what waits lies.
#[derive(Clone, Copy, Debug)]
pub struct Space<'g> {
    /// Rays.
    pub rays: &'g Meter,
    /// What [`Sink::begin`] keeps; the same where there is no file, so that each has what the other leaves.
    pub begun: &'g Meter,
    /// Rays without room in memory.
    pub spill: Option<&'g Spill>,
}

/// Rays that are worth being taken.
const LEAST_TAKEN: usize = 64;

/// Rays that wait: those that have met nothing so far, with where they go on; those that have met something, before
/// which something else may lie; and tests.
pub(super) struct Queue<P, T> {
    pub(super) open: Bag<P, f32>,
    pub(super) met: Bag<P, Met>,
    pub(super) tests: Bag<T, f32>,
}

impl<P: Traveller, T: Traveller> Queue<P, T> {
    const fn new() -> Self {
        Self { open: Bag::new(), met: Bag::new(), tests: Bag::new() }
    }

    pub(super) fn len(&self) -> usize {
        self.open.len() + self.met.len() + self.tests.len()
    }
}

/// Where a ray that has met something goes on, and what it has met.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(super) struct Met {
    pub(super) from: f32,
    pub(super) hit: Hit,
}

/// What a thread has taken from a queue.
pub(super) struct Load<P, T> {
    pub(super) open: Vec<Taken<P, f32>>,
    pub(super) met: Vec<Taken<P, Met>>,
    pub(super) tests: Vec<Taken<T, f32>>,
    /// What of each lies in the file.
    pub(super) runs: Runs,
    /// Rays in all.
    pub(super) len: usize,
}

/// Open, met and tests.
#[derive(Default)]
pub(super) struct Runs {
    pub(super) open: Vec<Run>,
    pub(super) met: Vec<Run>,
    pub(super) tests: Vec<Run>,
}

impl<P, T> Default for Load<P, T> {
    fn default() -> Self {
        Self { open: Vec::new(), met: Vec::new(), tests: Vec::new(), runs: Runs::default(), len: 0 }
    }
}

/// The queues of a render.
pub struct Queues<'g, P, T> {
    pub(super) grid: &'g Grid,
    pub(super) order: Order,
    pub(super) limits: Limits,
    /// By voxel; the last one for rays that come past none.
    pub(super) queues: Vec<Mutex<Queue<P, T>>>,
    /// How many rays each has.
    pub(super) lengths: Vec<AtomicUsize>,
    pub(super) room: Space<'g>,
    /// Rays in all queues.
    waiting: AtomicUsize,
    pub(super) state: Mutex<State<'g>>,
    changed: Condvar,
    /// Threads that wait for a change.
    idle: AtomicUsize,
}

pub(super) struct State<'g> {
    ledger: Ledger<'g>,
    /// Threads that may yet put rays into queues.
    busy: usize,
    /// Voxels whose rays are being traced, and by how many threads.
    pub(super) active: Vec<(u32, u32)>,
    /// Whether there are rays that have not begun.
    more: bool,
    done: bool,
}

/// Lets no thread wait for the rays that a panic has taken away.
struct EndOnPanic<'q, 'g, P: Traveller, T: Traveller>(&'q Queues<'g, P, T>);

impl<P: Traveller, T: Traveller> Drop for EndOnPanic<'_, '_, P, T> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.end();
        }
    }
}

/// What a thread does next.
enum Step<P, T> {
    Begin(Vec<Piece>),
    Visit(usize, Load<P, T>),
    Nothing,
}

impl<'g, P: Traveller, T: Traveller> Queues<'g, P, T> {
    /// Bytes that a ray takes which a thread has taken, beside those of its queue: its key, and what may follow from it.
    pub const RAY_BYTES: usize = size_of::<Key>() + size_of::<P>() + size_of::<T>();

    /// Bytes of the tables for `voxels` voxels, whose rays go to a file or not.
    #[must_use]
    pub fn bytes_of(voxels: usize, spills: bool) -> usize {
        let choice = if spills { Self::CHOICE_BYTES } else { 0 };
        (voxels + 1) * (size_of::<Mutex<Queue<P, T>>>() + size_of::<AtomicUsize>() + choice)
    }

    /// Empty, one for each voxel of `grid`.
    #[must_use]
    pub fn new(grid: &'g Grid, ledger: Ledger<'g>, order: Order, limits: Limits, room: Space<'g>) -> Self {
        let count = grid.len() + 1;
        Self {
            grid,
            order,
            limits,
            queues: (0..count).map(|_| Mutex::new(Queue::new())).collect(),
            lengths: (0..count).map(|_| AtomicUsize::new(0)).collect(),
            room,
            waiting: AtomicUsize::new(0),
            state: Mutex::new(State { ledger, busy: 0, active: Vec::new(), more: true, done: false }),
            changed: Condvar::new(),
            idle: AtomicUsize::new(0),
        }
    }

    /// What was done.
    #[must_use]
    pub fn finish(self) -> Ledger<'g> {
        self.state.into_inner().unwrap_or_else(PoisonError::into_inner).ledger
    }

    /// Traces until no ray is left; called by every thread that takes part. What is on its way when `stop` says so
    /// is not answered.
    pub fn work<A: Accel + ?Sized, S: Sink<P, T>>(
        &self,
        accel: &A,
        sink: &mut S,
        stop: &(dyn Fn() -> bool + Sync),
    ) {
        let _end = EndOnPanic(self);
        enter(Room::Queues);
        lock(&self.state).busy += 1;
        let hand = self.room.spill.map_or_else(Vec::new, |spill| Meter::apart(spill.run_pieces()));
        let mut worker = Worker::new(self, accel, sink, stop, hand);
        let mut last = None;
        loop {
            if stop() || self.room.spill.is_some_and(Spill::is_lost) {
                return self.end();
            }
            match self.next() {
                Step::Begin(pieces) => {
                    if let Some(pieces) = worker.sink.begin(pieces, &mut worker.fresh) {
                        self.room.begun.give(pieces);
                        lock(&self.state).more = false;
                    }
                    worker.place();
                }
                Step::Visit(voxel, taken) => {
                    if last.replace(voxel).is_some_and(|last| last != voxel) {
                        worker.sink.settle(false, &mut worker.fresh);
                    }
                    worker.visit(voxel, taken);
                    self.leave(voxel);
                    worker.place();
                }
                Step::Nothing => {
                    if worker.sink.settle(true, &mut worker.fresh) {
                        worker.place();
                    } else if !permits::lend(Room::Idle, || self.wait()) {
                        return;
                    }
                }
            }
        }
    }

    fn end(&self) {
        lock(&self.state).done = true;
        self.changed.notify_all();
    }

    /// Where rays may be taken from now. Threads work together on few voxels, so that what one of them reads serves
    /// the others.
    fn choose(&self, state: &State<'_>) -> Option<usize> {
        let last = self.queues.len() - 1;
        let length = |voxel: usize| self.lengths[voxel].load(Ordering::Relaxed);
        // Those that come past no voxel can run at any time; together, if there are others.
        if length(last) >= self.limits.taken {
            return Some(last);
        }
        let counts = |voxel: u32| Some((voxel, length(voxel as usize))).filter(|(_, n)| *n > 0);
        let best = if state.active.len() < self.limits.voxels {
            state.ledger.best((0..last as u32).filter_map(counts))
        } else {
            state.ledger.best(state.active.iter().filter_map(|&(voxel, _)| counts(voxel)))
        };
        best.map(|voxel| voxel as usize).or_else(|| (length(last) > 0).then_some(last))
    }

    fn next(&self) -> Step<P, T> {
        let mut state = lock(&self.state);
        if state.done {
            return Step::Nothing;
        }
        // There are some, and room for them, or nothing else is on its way.
        if state.more
            && let Some(room) = self.room_to_begin()
            && let Some(pieces) = self.room.begun.several(self.limits.begun, room)
        {
            return Step::Begin(pieces);
        }
        let Some(voxel) = self.choose(&state) else { return Step::Nothing };
        let waiting = self.waiting.load(Ordering::Relaxed);
        let share = (self.lengths[voxel].load(Ordering::Relaxed) / self.limits.shares).max(LEAST_TAKEN);
        let taken = self.take(voxel, share.min(self.limits.taken));
        let count = taken.len;
        if count == 0 {
            return Step::Nothing;
        }
        if voxel < self.grid.len() {
            state.ledger.visit(voxel as u32, count as u64, waiting as u64);
            match state.active.iter_mut().find(|(v, _)| *v == voxel as u32) {
                Some((_, threads)) => *threads += 1,
                None => state.active.push((voxel as u32, 1)),
            }
        }
        Step::Visit(voxel, taken)
    }

    /// Pieces that there must be room for beside what has begun, if rays find room.
    fn room_to_begin(&self) -> Option<usize> {
        let Limits { begun, begin, .. } = self.limits;
        let Some(spill) = self.room.spill else { return Some(begin) };
        (spill.is_open() || self.room.rays.has_room(begin.saturating_sub(begun))).then_some(begun)
    }

    /// This thread's rays of `voxel` have been traced.
    fn leave(&self, voxel: usize) {
        let mut state = lock(&self.state);
        if let Some(at) = state.active.iter().position(|(v, _)| *v as usize == voxel) {
            state.active[at].1 -= 1;
            if state.active[at].1 == 0 {
                state.active.swap_remove(at);
            }
        }
    }

    fn take(&self, voxel: usize, most: usize) -> Load<P, T> {
        let mut load = Load::default();
        let spill = self.room.spill;
        let mut queue = lock(&self.queues[voxel]);
        load.len += queue.met.take(most, &mut load.met, &mut load.runs.met, spill);
        let left = most.saturating_sub(load.len);
        load.len += queue.tests.take(left, &mut load.tests, &mut load.runs.tests, spill);
        let left = most.saturating_sub(load.len);
        load.len += queue.open.take(left, &mut load.open, &mut load.runs.open, spill);
        self.waiting.fetch_sub(load.len, Ordering::Relaxed);
        self.lengths[voxel].store(queue.len(), Ordering::Relaxed);
        load
    }

    /// Puts a ray into a list of the queue of `voxel`, if there is room; whether there was.
    #[inline]
    pub(super) fn put<R: Traveller, E: Pod>(
        &self,
        voxel: usize,
        list: impl Fn(&mut Queue<P, T>) -> &mut Bag<R, E>,
        ray: &R,
        extra: &E,
    ) -> bool {
        let put = || {
            let mut queue = lock(&self.queues[voxel]);
            let added = list(&mut queue).push(ray, extra, self.room.rays);
            if added {
                self.waiting.fetch_add(1, Ordering::Relaxed);
                self.lengths[voxel].fetch_add(1, Ordering::Relaxed);
            }
            added
        };
        put() || (self.make_room() && put())
    }

    /// Says that there are more rays than before.
    pub(super) fn wake(&self) {
        // One is enough: whoever finds more than it takes wakes the next when it has put something down. One that goes
        // to sleep just now is not heard, which loses help and no ray: the caller goes on itself.
        if self.idle.load(Ordering::Relaxed) > 0 {
            self.changed.notify_one();
        }
    }

    /// Waits until there may be something to do; false when there never will be.
    fn wait(&self) -> bool {
        let mut state = lock(&self.state);
        state.busy -= 1;
        loop {
            let waiting = self.waiting.load(Ordering::Relaxed);
            if waiting == 0 && state.busy == 0 && !state.more {
                state.done = true;
                self.changed.notify_all();
            }
            if state.done {
                return false;
            }
            let begins =
                || state.more && self.room_to_begin().is_some_and(|room| self.room.begun.has_room(room));
            if self.choose(&state).is_some() || begins() {
                state.busy += 1;
                return true;
            }
            self.idle.fetch_add(1, Ordering::Relaxed);
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            self.idle.fetch_sub(1, Ordering::Relaxed);
        }
    }
}
