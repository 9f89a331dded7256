//! Rays wait in queues of voxels, and the voxel with the best benefit for its cost runs (Pharr et al. 1997).
//!
//! A ray is traced in one voxel only against what it enters there, then goes on to the queue of the next. Benefit is
//! the number of rays that wait: a phase ends when all have been answered, so that the weight of one ray says nothing
//! of when it should run, and none can starve. Cost is the time to read what is absent and to trace the rays. What is
//! absent is estimated: pages leave in the order in which they were used last, so a voxel's are gone when a budget's
//! worth of others has been read since its last visit.
//!
//! Invariant: no lock is held while a ray is traced.

use super::sorted::Sorted;
use super::{Grid, Rays, Requests, Schedule, Sink, TEST};
use crate::accel::{Accel, Hit};
use crate::stats::{Decision, SchedulerStats, VoxelStats};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Rays of a queue that a thread takes at once: some ten milliseconds of work.
const CHUNK: usize = 1 << 13;

/// Seconds to read a byte, and to trace a ray through a voxel: only their ratio matters, and not much.
const READ_S: f64 = 1.0 / 1.2e9;
const TRACE_S: f64 = 1e-6;

/// A ray that waits, having met nothing.
#[derive(Clone, Copy)]
struct Open {
    name: u32,
    from: f32,
}

/// A ray that has met something, which something in another voxel may be before.
#[derive(Clone, Copy)]
struct Met {
    name: u32,
    from: f32,
    hit: Hit,
}

/// Bytes that the two rays of a path take in queues at most: lists have up to twice the room that they need.
pub const QUEUE_BYTES: usize = 2 * (size_of::<Met>() + size_of::<Open>());

#[derive(Default)]
struct Queue {
    open: Vec<Open>,
    met: Vec<Met>,
}

impl Queue {
    fn len(&self) -> usize {
        self.open.len() + self.met.len()
    }

    fn bytes(&self) -> usize {
        self.open.capacity() * size_of::<Open>() + self.met.capacity() * size_of::<Met>()
    }

    fn push(&mut self, Met { name, from, hit }: Met) {
        if hit.geometry == crate::accel::NONE {
            self.open.push(Open { name, from });
        } else {
            self.met.push(Met { name, from, hit });
        }
    }

    /// Up to a chunk of rays.
    fn take(&mut self, out: &mut Vec<Met>) {
        let met = self.met.len().min(CHUNK);
        out.extend(self.met.drain(self.met.len() - met..));
        let open = self.open.len().min(CHUNK - met);
        out.extend(
            (self.open.drain(self.open.len() - open..))
                .map(|Open { name, from }| Met { name, from, hit: Hit::MISS }),
        );
        if self.len() == 0 {
            // Its rays may go to other queues, and so may its memory.
            *self = Self::default();
        }
    }
}

/// What is known of the pages in memory.
pub trait Residency: Sync {
    /// Pages read so far.
    fn reads(&self) -> u64;
    /// Pages that memory holds.
    fn room(&self) -> u64;
    /// Bytes of a page.
    fn page_bytes(&self) -> u64;
}

/// What a voxel has seen in the whole render.
#[derive(Clone, Copy, Default)]
struct Seen {
    /// Pages read when it was last visited.
    reads: Option<u64>,
    visits: u64,
    rays: u64,
}

/// What is kept from phase to phase.
pub struct Ledger {
    seen: Vec<Seen>,
    decisions: Vec<Decision>,
    /// Every how many visits one is kept, and how many have gone by.
    every: u64,
    visits: u64,
    queued: u64,
    start: Instant,
}

impl Ledger {
    /// For `grid`; its time begins now.
    #[must_use]
    pub fn new(grid: &Grid) -> Self {
        Self {
            seen: vec![Seen::default(); grid.len()],
            decisions: Vec::new(),
            every: 1,
            visits: 0,
            queued: 0,
            start: Instant::now(),
        }
    }

    /// Adds what was done to `stats`.
    pub fn report(&self, grid: &Grid, page_bytes: u64, stats: &mut SchedulerStats) {
        stats.grid = grid.dims();
        stats.bounds = grid.bounds();
        stats.voxels = u64::from(grid.filled());
        stats.voxel_visits = self.visits;
        stats.rays_queued = self.queued;
        stats.rays_per_visit = if self.visits > 0 { self.queued as f64 / self.visits as f64 } else { 0.0 };
        stats.by_voxel = (self.seen.iter().zip(0u32..))
            .filter(|(seen, _)| seen.visits > 0)
            .map(|(seen, i)| VoxelStats {
                at: grid.place(i).to_array(),
                bytes: u64::from(grid.pages(i)) * page_bytes,
                visits: seen.visits,
                rays: seen.rays,
            })
            .collect();
        stats.decisions.clone_from(&self.decisions);
    }

    fn note(&mut self, decision: Decision) {
        if self.visits % self.every == 0 {
            if self.decisions.len() == SchedulerStats::MOST_DECISIONS {
                let mut keep = false;
                self.decisions.retain(|_| {
                    keep = !keep;
                    keep
                });
                self.every *= 2;
            }
            self.decisions.push(decision);
        }
        self.visits += 1;
    }
}

/// The queues of one phase.
pub struct Voxels<'g> {
    grid: &'g Grid,
    residency: &'g dyn Residency,
    order: Sorted,
    state: Mutex<State<'g>>,
    changed: Condvar,
}

struct State<'g> {
    queues: Vec<Queue>,
    /// Voxels whose queues are not empty.
    waiting: Vec<u32>,
    rays: u64,
    /// Bytes of all queues, and the most that they have been.
    bytes: usize,
    peak: usize,
    /// Threads that may still put rays into queues.
    busy: usize,
    /// A thread has panicked: its rays will not come.
    abandoned: bool,
    ledger: &'g mut Ledger,
}

/// Lets no thread wait for the rays that a panic has taken away.
struct AbandonOnPanic<'v, 'g>(&'v Voxels<'g>);

impl Drop for AbandonOnPanic<'_, '_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.lock().abandoned = true;
            self.0.changed.notify_all();
        }
    }
}

/// What a thread does next.
enum Step {
    Visit(u32),
    Done,
}

impl<'g> Voxels<'g> {
    /// Empty queues of `grid`.
    pub fn new(
        grid: &'g Grid,
        residency: &'g dyn Residency,
        order: Sorted,
        ledger: &'g mut Ledger,
    ) -> Self {
        let queues = (0..grid.len()).map(|_| Queue::default()).collect();
        let state = State { queues, waiting: Vec::new(), rays: 0, bytes: 0, peak: 0, busy: 0, abandoned: false, ledger };
        Self { grid, residency, order, state: Mutex::new(state), changed: Condvar::new() }
    }

    fn lock(&self) -> MutexGuard<'_, State<'g>> {
        // What a panic leaves here is not used: it goes on in the thread that joins.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Most bytes that queues have taken.
    #[must_use]
    pub fn peak_bytes(&self) -> usize {
        self.lock().peak
    }

    /// Bytes of the pages of `voxel` that are thought to be absent.
    fn absent(&self, voxel: u32, seen: &Seen, reads: u64) -> u64 {
        let bytes = u64::from(self.grid.pages(voxel)) * self.residency.page_bytes();
        match seen.reads {
            None => bytes,
            Some(then) => {
                let gone = reads.saturating_sub(then) as f64 / self.residency.room().max(1) as f64;
                (bytes as f64 * gone.min(1.0)) as u64
            }
        }
    }

    /// Chooses a voxel and takes rays of its queue; waits while none has any and some may yet come.
    fn next(&self, taken: &mut Vec<Met>, stop: &(dyn Fn() -> bool + Sync)) -> Step {
        let mut state = self.lock();
        loop {
            if stop() || state.abandoned {
                return Step::Done;
            }
            if !state.waiting.is_empty() {
                break;
            }
            if state.busy == 0 {
                return Step::Done;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        let reads = self.residency.reads();
        let State { queues, waiting, rays, bytes, busy, ledger, .. } = &mut *state;
        let score = |&voxel: &u32| {
            let count = queues[voxel as usize].len() as f64;
            let absent = self.absent(voxel, &ledger.seen[voxel as usize], reads);
            count / (absent as f64 * READ_S + count * TRACE_S)
        };
        let best = (waiting.iter().map(score).enumerate())
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map_or(0, |(place, _)| place);
        let voxel = waiting[best];
        let queue = &mut queues[voxel as usize];
        let before = *rays;
        *bytes -= queue.bytes();
        queue.take(taken);
        *bytes += queue.bytes();
        if queue.len() == 0 {
            waiting.swap_remove(best);
        }
        let count = taken.len() as u64;
        *rays -= count;
        *busy += 1;
        let seen = &mut ledger.seen[voxel as usize];
        let absent = self.absent(voxel, seen, reads);
        *seen = Seen { reads: Some(reads), visits: seen.visits + 1, rays: seen.rays + count };
        ledger.queued += count;
        let at_s = ledger.start.elapsed().as_secs_f64();
        let place = self.grid.place(voxel).to_array();
        ledger.note(Decision { at_s, voxel: place, rays: count, waiting: before, cost_bytes: absent });
        Step::Visit(voxel)
    }

    /// Puts rays into queues, and says that this thread will put in no more for now.
    fn put(&self, out: &mut Vec<(u32, Met)>) {
        let mut state = self.lock();
        let State { queues, waiting, rays, bytes, peak, busy, .. } = &mut *state;
        for (voxel, met) in out.drain(..) {
            let queue = &mut queues[voxel as usize];
            if queue.len() == 0 {
                waiting.push(voxel);
            }
            *bytes -= queue.bytes();
            queue.push(met);
            *bytes += queue.bytes();
            *rays += 1;
        }
        *peak = (*peak).max(*bytes);
        *busy -= 1;
        drop(state);
        self.changed.notify_all();
    }
}

impl Schedule for Voxels<'_> {
    fn work<A: Accel + ?Sized>(
        &self,
        accel: &A,
        rays: &impl Rays,
        requests: &Requests<'_>,
        sink: &mut impl Sink,
        stop: &(dyn Fn() -> bool + Sync),
    ) {
        const ALL: (f32, f32) = (f32::NEG_INFINITY, f32::INFINITY);
        let (mut out, mut taken) = (Vec::new(), Vec::new());
        let _abandon = AbandonOnPanic(self);
        // Before the first request is taken, so that nobody finds all queues empty and leaves.
        self.lock().busy += 1;
        while let Some(range) = requests.take() {
            for name in range {
                let ray = rays.ray(name);
                if let Some(voxel) = self.grid.enter(&ray) {
                    out.push((voxel, Met { name, from: ALL.0, hit: Hit::MISS }));
                } else if name & TEST == 0 {
                    sink.hit(name, accel.closest(&ray));
                } else {
                    sink.seen(name & !TEST, accel.occluded(&ray));
                }
            }
            self.put(&mut out);
            self.lock().busy += 1;
        }
        self.put(&mut out);
        let mut last = None;
        while let Step::Visit(voxel) = self.next(&mut taken, stop) {
            if last.is_some_and(|last| last != voxel) {
                sink.settle();
            }
            last = Some(voxel);
            taken.sort_unstable_by_key(|met| self.order.key(&rays.ray(met.name)));
            for Met { name, from, hit } in taken.drain(..) {
                let ray = rays.ray(name);
                let next = self.grid.next(&ray, voxel);
                let to = next.map_or(ALL.1, |(to, _)| to);
                if name & TEST != 0 {
                    let occluded = accel.occluded_part(&ray, from, to);
                    match next {
                        Some((to, voxel)) if !occluded => out.push((voxel, Met { name, from: to, hit })),
                        _ => sink.seen(name & !TEST, occluded),
                    }
                    continue;
                }
                let hit = accel.closest_part(&ray, from, to, &hit);
                match next {
                    Some((to, voxel)) if hit.t >= to => out.push((voxel, Met { name, from: to, hit })),
                    _ => sink.hit(name, hit),
                }
            }
            self.put(&mut out);
        }
        sink.settle();
    }
}
