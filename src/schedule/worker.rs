//! What a thread does with rays that it has taken: traces each through one voxel, and puts it where it goes from there.
//!
//! Invariant: no lock is held while a ray is traced.

use super::bag::{Bag, Taken};
use super::meter::Piece;
use super::queues::{Load, Met, Queues};
use super::spill::{Run, Spill};
use super::{Fresh, Sink, Traveller};
use crate::accel::{Accel, Hit, NONE, Ray};
use crate::clock::{Room, enter};
use crate::permits;
use bytemuck::Pod;

/// Rays between two looks at whether to stop: where memory is tight each may wait for many pages.
const STOP_EVERY: usize = 16;

/// A ray's place in the order, and where it lies.
pub(super) type Key = (u64, u32, u32);

/// Rays that are traced before they are put where they go from there: so many that the clock is not looked at for each, and
/// so few that they take no more room than a call does.
const TOGETHER: usize = 32;

/// Where a ray goes next: from where on its way, and into which voxel.
type Next = Option<(f32, u32)>;

/// A thread's way through the queues.
pub(super) struct Worker<'q, 'g, A: ?Sized, P, T, S> {
    queues: &'q Queues<'g, P, T>,
    accel: &'q A,
    pub(super) sink: &'q mut S,
    stop: &'q (dyn Fn() -> bool + Sync),
    pub(super) fresh: Fresh<P, T>,
    keys: Vec<Key>,
    /// Traced, and yet to go on.
    paths: Vec<(P, Hit, Next)>,
    tests: Vec<(T, bool, Next)>,
    /// For what comes from the file: a run has room in it.
    hand: Vec<Piece>,
}

impl<'q, 'g, A: Accel + ?Sized, P: Traveller, T: Traveller, S: Sink<P, T>> Worker<'q, 'g, A, P, T, S> {
    pub(super) fn new(
        queues: &'q Queues<'g, P, T>,
        accel: &'q A,
        sink: &'q mut S,
        stop: &'q (dyn Fn() -> bool + Sync),
        hand: Vec<Piece>,
    ) -> Self {
        let (paths, tests) = (Vec::with_capacity(TOGETHER), Vec::with_capacity(TOGETHER));
        Self { queues, accel, sink, stop, fresh: Fresh::default(), keys: Vec::new(), paths, tests, hand }
    }

    /// Traces what was taken; not all of it when it is to stop, or when some of it is lost. What lies in the file is asked
    /// for first, and comes while what is in memory is traced.
    pub(super) fn visit(&mut self, voxel: usize, mut load: Load<P, T>) {
        let Some(spill) = self.queues.room.spill else { return self.run(voxel, load, false) };
        let mut runs = std::mem::take(&mut load.runs);
        Bag::<P, Met>::expect(&runs.met, spill);
        Bag::<T, f32>::expect(&runs.tests, spill);
        Bag::<P, f32>::expect(&runs.open, spill);
        self.run(voxel, load, false);
        while !(runs.met.is_empty() && runs.tests.is_empty() && runs.open.is_empty()) {
            let hand = &mut self.hand;
            let load = permits::lend(Room::Queues, || Load {
                met: fetch(&mut runs.met, hand, spill),
                tests: fetch(&mut runs.tests, hand, spill),
                open: fetch(&mut runs.open, hand, spill),
                ..Load::default()
            });
            if spill.is_lost() || (self.stop)() {
                break;
            }
            self.run(voxel, load, true);
        }
    }

    /// Traces `load` in the order of rays. Its pieces are this thread's own if they come from the file.
    fn run(&mut self, voxel: usize, load: Load<P, T>, own: bool) {
        let Load { open, met, tests, .. } = load;
        let mut keys = std::mem::take(&mut self.keys);
        self.sort(&tests, &mut keys);
        for keys in keys.chunks(TOGETHER) {
            let rays = keys.iter().map(|&(_, i, j)| tests[i as usize].get(j as usize));
            if !self.test(voxel, rays) {
                break;
            }
        }
        self.give(tests, own);
        self.sort(&open, &mut keys);
        for keys in keys.chunks(TOGETHER) {
            let rays = keys.iter().map(|&(_, i, j)| open[i as usize].get(j as usize));
            if !self.trace(voxel, rays.map(|(item, from)| (item, Met { from, hit: Hit::MISS }))) {
                break;
            }
        }
        self.give(open, own);
        for taken in &met {
            let mut left = (0..taken.len()).map(|i| taken.get(i));
            while left.len() > 0 && self.trace(voxel, left.by_ref().take(TOGETHER)) {}
        }
        self.give(met, own);
        self.keys = keys;
    }

    #[inline(always)]
    fn stops(&self, n: usize) -> bool {
        n % STOP_EVERY == STOP_EVERY - 1 && (self.stop)()
    }

    /// The order of `rays`, in `keys`.
    fn sort<R: Traveller, E: Pod>(&self, rays: &[Taken<R, E>], keys: &mut Vec<Key>) {
        keys.clear();
        for (taken, i) in rays.iter().zip(0u32..) {
            let key = |j: u32| (self.queues.order.key(&taken.get(j as usize).0.ray()), i, j);
            keys.extend((0..taken.len() as u32).map(key));
        }
        keys.sort_unstable();
    }

    fn give<R: Traveller, E: Pod>(&mut self, rays: Vec<Taken<R, E>>, own: bool) {
        let pieces = rays.into_iter().map(Taken::into_piece);
        if own {
            self.hand.extend(pieces);
        } else {
            self.queues.room.rays.give(pieces);
        }
    }

    /// Where a ray goes from `voxel`.
    #[inline(always)]
    fn after(&self, ray: &Ray, voxel: usize) -> Next {
        if voxel < self.queues.grid.len() { self.queues.grid.next(ray, voxel as u32) } else { None }
    }

    /// Traces `rays` in `voxel` and puts them where they go from there; false when it is to stop.
    #[inline(always)]
    fn trace(&mut self, voxel: usize, rays: impl Iterator<Item = (P, Met)>) -> bool {
        enter(Room::TraceClosest);
        let mut traced = std::mem::take(&mut self.paths);
        for ((item, Met { from, hit }), n) in rays.zip(0..) {
            if self.stops(n) {
                return false;
            }
            let ray = item.ray();
            let next = self.after(&ray, voxel);
            let to = next.map_or(f32::INFINITY, |(to, _)| to);
            let hit = self.accel.closest_part(&ray, from, to, &hit);
            traced.push((item, hit, next.filter(|&(to, _)| hit.t >= to)));
        }
        enter(Room::Queues);
        for (item, mut hit, next) in traced.drain(..) {
            if let Some((from, voxel)) = next {
                let (queues, voxel) = (self.queues, voxel as usize);
                let put = if hit.geometry == NONE {
                    queues.put(voxel, |queue| &mut queue.open, &item, &from)
                } else {
                    queues.put(voxel, |queue| &mut queue.met, &item, &Met { from, hit })
                };
                // Where there is no room for one there is none for the next: most times the room is the same.
                enter(if put { Room::Queues } else { Room::TraceClosest });
                if put {
                    continue;
                }
                hit = self.accel.closest_part(&item.ray(), from, f32::INFINITY, &hit);
            }
            self.sink.hit(item, hit, &mut self.fresh);
        }
        self.paths = traced;
        enter(Room::Queues);
        true
    }

    /// As [`Self::trace`], of tests.
    #[inline(always)]
    fn test(&mut self, voxel: usize, rays: impl Iterator<Item = (T, f32)>) -> bool {
        enter(Room::TraceOcclusion);
        let mut traced = std::mem::take(&mut self.tests);
        for ((item, from), n) in rays.zip(0..) {
            if self.stops(n) {
                return false;
            }
            let ray = item.ray();
            let next = self.after(&ray, voxel);
            let to = next.map_or(f32::INFINITY, |(to, _)| to);
            let occluded = self.accel.occluded_part(&ray, from, to);
            traced.push((item, occluded, next.filter(|_| !occluded)));
        }
        enter(Room::Queues);
        for (item, mut occluded, next) in traced.drain(..) {
            if let Some((from, voxel)) = next {
                let put = self.queues.put(voxel as usize, |queue| &mut queue.tests, &item, &from);
                enter(if put { Room::Queues } else { Room::TraceOcclusion });
                if put {
                    continue;
                }
                occluded = self.accel.occluded_part(&item.ray(), from, f32::INFINITY);
            }
            self.sink.seen(item, occluded);
        }
        self.tests = traced;
        enter(Room::Queues);
        true
    }

    /// Puts new rays into the queues where they begin; where there is no room they are traced, and so may bring new ones.
    pub(super) fn place(&mut self) {
        const FROM: f32 = f32::NEG_INFINITY;
        enter(Room::Queues);
        let queues = self.queues;
        let last = queues.queues.len() - 1;
        let voxel = |ray: &Ray| queues.grid.enter(ray).map_or(last, |v| v as usize);
        for n in 0.. {
            if self.stops(n) {
                break;
            }
            if let Some(item) = self.fresh.tests.pop() {
                let ray = item.ray();
                let put = queues.put(voxel(&ray), |queue| &mut queue.tests, &item, &FROM);
                enter(if put { Room::Queues } else { Room::TraceOcclusion });
                if !put {
                    self.sink.seen(item, self.accel.occluded(&ray));
                }
            } else if let Some(item) = self.fresh.paths.pop() {
                let ray = item.ray();
                let put = queues.put(voxel(&ray), |queue| &mut queue.open, &item, &FROM);
                enter(if put { Room::Queues } else { Room::TraceClosest });
                if !put {
                    self.sink.hit(item, self.accel.closest(&ray), &mut self.fresh);
                }
            } else {
                break;
            }
        }
        enter(Room::Queues);
        queues.wake();
    }
}

/// Reads as many of `runs` as `hand` has room for; nothing more where one is lost.
fn fetch<R: Traveller, E: Pod>(
    runs: &mut Vec<Run>,
    hand: &mut Vec<Piece>,
    spill: &Spill,
) -> Vec<Taken<R, E>> {
    let mut read = Vec::new();
    while let Some(run) = runs.last()
        && !spill.is_lost()
        && let Some(taken) = Bag::<R, E>::fetch(run, hand, spill)
    {
        read.extend(taken);
        runs.pop();
    }
    read
}
