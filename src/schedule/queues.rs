//! The queues of all voxels, and what a thread does with them.
//!
//! A ray is traced in one voxel only against what it enters there, then goes on to the queue of the next voxel with
//! pages on its way. When there is no room for it in any queue it is traced to its end where it is: slower, but never
//! more memory and never a standstill.
//!
//! Invariant: bytes of queues stay below their limit, but for what threads have in their hands; no lock is held while a
//! ray is traced.

use super::bag::Bag;
use super::{Fresh, Grid, Ledger, Order, Sink, Traveller};
use crate::accel::{Accel, Hit, NONE, Ray};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// How much may wait, and how much runs together.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Bytes of queues and of sinks.
    pub bytes: usize,
    /// Bytes that [`Sink::begin`] may add, with what follows from it.
    pub begin_bytes: usize,
    /// Rays of a queue that a thread takes at once.
    pub taken: usize,
}

/// A ray that has met nothing so far, and where it goes on.
#[derive(Clone, Copy)]
struct Open<T> {
    item: T,
    from: f32,
}

/// A ray that has met something, before which something else may lie.
#[derive(Clone, Copy)]
struct Met<P> {
    item: P,
    from: f32,
    hit: Hit,
}

struct Queue<P, T> {
    open: Bag<Open<P>>,
    met: Bag<Met<P>>,
    tests: Bag<Open<T>>,
}

impl<P: Traveller, T: Traveller> Queue<P, T> {
    const fn new() -> Self {
        Self { open: Bag::new(), met: Bag::new(), tests: Bag::new() }
    }

    fn len(&self) -> usize {
        self.open.len() + self.met.len() + self.tests.len()
    }
}

/// What a thread has taken from a queue.
struct Taken<P, T> {
    open: Vec<Vec<Open<P>>>,
    met: Vec<Vec<Met<P>>>,
    tests: Vec<Vec<Open<T>>>,
}

impl<P: Traveller, T: Traveller> Taken<P, T> {
    fn len(&self) -> usize {
        fn count<R>(pieces: &[Vec<R>]) -> usize {
            pieces.iter().map(Vec::len).sum()
        }
        count(&self.open) + count(&self.met) + count(&self.tests)
    }

    fn bytes(&self) -> usize {
        self.open.len() * Bag::<Open<P>>::PIECE_BYTES
            + self.met.len() * Bag::<Met<P>>::PIECE_BYTES
            + self.tests.len() * Bag::<Open<T>>::PIECE_BYTES
    }
}

/// The queues of a render.
pub struct Queues<'g, P, T> {
    grid: &'g Grid,
    order: Order,
    limits: Limits,
    /// By voxel; the last one for rays that come past none.
    queues: Vec<Mutex<Queue<P, T>>>,
    /// How many rays each has.
    lengths: Vec<AtomicUsize>,
    bytes: AtomicUsize,
    peak: AtomicUsize,
    /// Rays in all queues.
    waiting: AtomicUsize,
    state: Mutex<State<'g>>,
    changed: Condvar,
}

struct State<'g> {
    ledger: Ledger<'g>,
    /// Threads that may yet put rays into queues.
    busy: usize,
    /// Whether there are rays that have not begun.
    more: bool,
    done: bool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What a panic leaves is not used: it goes on in the thread that joins.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
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
    Begin,
    Visit(usize, Taken<P, T>),
    Nothing,
}

/// A thread's way through the queues.
struct Worker<'q, 'g, A: ?Sized, P, T, S> {
    queues: &'q Queues<'g, P, T>,
    accel: &'q A,
    sink: &'q mut S,
    fresh: Fresh<P, T>,
    keys: Vec<(u64, u32, u32)>,
}

impl<'g, P: Traveller, T: Traveller> Queues<'g, P, T> {
    /// Empty, one for each voxel of `grid`.
    #[must_use]
    pub fn new(grid: &'g Grid, ledger: Ledger<'g>, order: Order, limits: Limits) -> Self {
        let count = grid.len() + 1;
        Self {
            grid,
            order,
            limits,
            queues: (0..count).map(|_| Mutex::new(Queue::new())).collect(),
            lengths: (0..count).map(|_| AtomicUsize::new(0)).collect(),
            bytes: AtomicUsize::new(0),
            peak: AtomicUsize::new(0),
            waiting: AtomicUsize::new(0),
            state: Mutex::new(State { ledger, busy: 0, more: true, done: false }),
            changed: Condvar::new(),
        }
    }

    /// What was done, and the most bytes that queues and sinks have taken.
    #[must_use]
    pub fn finish(self) -> (Ledger<'g>, usize) {
        let state = self.state.into_inner().unwrap_or_else(PoisonError::into_inner);
        (state.ledger, self.peak.into_inner())
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
        lock(&self.state).busy += 1;
        let mut worker = Worker { queues: self, accel, sink, fresh: Fresh::default(), keys: Vec::new() };
        let mut last = None;
        loop {
            if stop() {
                return self.end();
            }
            match self.next(worker.sink.bytes()) {
                Step::Begin => {
                    if !worker.sink.begin(&mut worker.fresh) {
                        lock(&self.state).more = false;
                    }
                    worker.place();
                }
                Step::Visit(voxel, taken) => {
                    if last.replace(voxel).is_some_and(|last| last != voxel) {
                        worker.sink.settle(false, &mut worker.fresh);
                    }
                    worker.visit(voxel, taken);
                    worker.place();
                }
                Step::Nothing => {
                    if worker.sink.settle(true, &mut worker.fresh) {
                        worker.place();
                    } else if !self.wait() {
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

    /// Whether there is room for `more` bytes beside what sinks hold.
    fn has_room(&self, sinks: usize, more: usize) -> bool {
        let bytes = self.bytes.load(Ordering::Relaxed) + sinks;
        self.peak.fetch_max(bytes, Ordering::Relaxed);
        bytes + more <= self.limits.bytes
    }

    fn next(&self, sinks: usize) -> Step<P, T> {
        let mut state = lock(&self.state);
        if state.done {
            return Step::Nothing;
        }
        // A little room is left for rays on their way.
        let waiting = self.waiting.load(Ordering::Relaxed);
        if state.more && (waiting == 0 || self.has_room(sinks, self.limits.begin_bytes)) {
            return Step::Begin;
        }
        if waiting == 0 {
            return Step::Nothing;
        }
        let lengths = self.lengths.iter().map(|n| n.load(Ordering::Relaxed));
        let last = self.queues.len() - 1;
        let counts = (0u32..).zip(lengths.take(last)).filter(|(_, n)| *n > 0);
        // Those that come past no voxel can run at any time.
        let aside = self.lengths[last].load(Ordering::Relaxed) >= self.limits.taken;
        let best = if aside { None } else { state.ledger.best(counts) };
        let voxel = best.map_or(last, |v| v as usize);
        let taken = self.take(voxel);
        let count = taken.len();
        if best.is_some() {
            state.ledger.visit(voxel as u32, count as u64, waiting as u64);
        }
        if count == 0 { Step::Nothing } else { Step::Visit(voxel, taken) }
    }

    fn take(&self, voxel: usize) -> Taken<P, T> {
        let mut taken = Taken { open: Vec::new(), met: Vec::new(), tests: Vec::new() };
        let mut queue = lock(&self.queues[voxel]);
        let most = self.limits.taken;
        queue.met.take(most, &mut taken.met);
        queue.tests.take(most.saturating_sub(taken.len()), &mut taken.tests);
        queue.open.take(most.saturating_sub(taken.len()), &mut taken.open);
        self.bytes.fetch_sub(taken.bytes(), Ordering::Relaxed);
        self.waiting.fetch_sub(taken.len(), Ordering::Relaxed);
        self.lengths[voxel].store(queue.len(), Ordering::Relaxed);
        taken
    }

    fn put(&self, voxel: usize, add: impl FnOnce(&mut Queue<P, T>) -> usize) {
        let mut queue = lock(&self.queues[voxel]);
        let grown = add(&mut queue);
        self.bytes.fetch_add(grown, Ordering::Relaxed);
        self.waiting.fetch_add(1, Ordering::Relaxed);
        self.lengths[voxel].store(queue.len(), Ordering::Relaxed);
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
            if waiting > 0 || state.more {
                state.busy += 1;
                return true;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl<A: Accel + ?Sized, P: Traveller, T: Traveller, S: Sink<P, T>> Worker<'_, '_, A, P, T, S> {
    /// Traces what was taken in the order of rays.
    fn visit(&mut self, voxel: usize, taken: Taken<P, T>) {
        let order = self.queues.order;
        let Taken { open, met, tests } = taken;
        let mut keys = std::mem::take(&mut self.keys);
        keys.clear();
        keys.extend(named(&tests).map(|(i, j, t)| (order.key(&t.item.ray()), i, j)));
        keys.sort_unstable();
        for &(_, i, j) in &keys {
            let Open { item, from } = tests[i as usize][j as usize];
            self.test(voxel, item, from);
        }
        drop(tests);
        keys.clear();
        keys.extend(named(&open).map(|(i, j, p)| (order.key(&p.item.ray()), i, j)));
        keys.sort_unstable();
        for &(_, i, j) in &keys {
            let Open { item, from } = open[i as usize][j as usize];
            self.path(voxel, item, from, &Hit::MISS);
        }
        drop(open);
        for Met { item, from, hit } in met.into_iter().flatten() {
            self.path(voxel, item, from, &hit);
        }
        self.keys = keys;
    }

    /// Where a ray goes from `voxel`.
    #[inline(always)]
    fn after(&self, ray: &Ray, voxel: usize) -> Option<(f32, u32)> {
        if voxel < self.queues.grid.len() { self.queues.grid.next(ray, voxel as u32) } else { None }
    }

    #[inline(always)]
    fn path(&mut self, voxel: usize, item: P, from: f32, so_far: &Hit) {
        let ray = item.ray();
        let mut next = self.after(&ray, voxel);
        if next.is_some() && !self.queues.has_room(self.sink.bytes(), 0) {
            next = None;
        }
        let to = next.map_or(f32::INFINITY, |(to, _)| to);
        let hit = self.accel.closest_part(&ray, from, to, so_far);
        match next {
            Some((from, voxel)) if hit.t >= from => self.queues.put(voxel as usize, |queue| {
                if hit.geometry == NONE {
                    queue.open.push(Open { item, from })
                } else {
                    queue.met.push(Met { item, from, hit })
                }
            }),
            _ => self.sink.hit(item, hit, &mut self.fresh),
        }
    }

    #[inline(always)]
    fn test(&mut self, voxel: usize, item: T, from: f32) {
        let ray = item.ray();
        let mut next = self.after(&ray, voxel);
        if next.is_some() && !self.queues.has_room(self.sink.bytes(), 0) {
            next = None;
        }
        let to = next.map_or(f32::INFINITY, |(to, _)| to);
        let occluded = self.accel.occluded_part(&ray, from, to);
        match next {
            Some((from, voxel)) if !occluded => {
                self.queues.put(voxel as usize, |queue| queue.tests.push(Open { item, from }));
            }
            _ => self.sink.seen(item, occluded),
        }
    }

    /// Puts new rays into the queues where they begin; where there is no room they are traced, and so may bring new ones.
    fn place(&mut self) {
        const START: f32 = f32::NEG_INFINITY;
        let last = self.queues.queues.len() - 1;
        loop {
            let room = self.queues.has_room(self.sink.bytes(), 0);
            if let Some(item) = self.fresh.tests.pop() {
                let voxel = self.queues.grid.enter(&item.ray()).map_or(last, |v| v as usize);
                if room {
                    self.queues.put(voxel, |queue| queue.tests.push(Open { item, from: START }));
                } else {
                    let occluded = self.accel.occluded(&item.ray());
                    self.sink.seen(item, occluded);
                }
            } else if let Some(item) = self.fresh.paths.pop() {
                let voxel = self.queues.grid.enter(&item.ray()).map_or(last, |v| v as usize);
                if room {
                    self.queues.put(voxel, |queue| queue.open.push(Open { item, from: START }));
                } else {
                    let hit = self.accel.closest(&item.ray());
                    self.sink.hit(item, hit, &mut self.fresh);
                }
            } else {
                break;
            }
        }
        self.queues.changed.notify_all();
    }
}

/// Records with the places they have in `pieces`.
fn named<R: Copy>(pieces: &[Vec<R>]) -> impl Iterator<Item = (u32, u32, R)> {
    (pieces.iter().zip(0u32..)).flat_map(|(piece, i)| piece.iter().zip(0u32..).map(move |(r, j)| (i, j, *r)))
}
