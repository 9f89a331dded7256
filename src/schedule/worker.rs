//! What a thread does with rays that it has taken: traces each through one voxel, and puts it where it goes from there.
//!
//! Invariant: no lock is held while a ray is traced.

use super::bag::{Bag, Taken};
use super::meter::Piece;
use super::queues::{Load, Met, Queues};
use super::spill::{Run, Spill};
use super::{Fresh, Sink, Traveller};
use crate::accel::{Accel, Hit, NONE, Ray};
use crate::permits;
use bytemuck::Pod;

/// Rays between two looks at whether to stop: where memory is tight each may wait for many pages.
const STOP_EVERY: usize = 16;

/// A ray's place in the order, and where it lies.
pub(super) type Key = (u64, u32, u32);

/// A thread's way through the queues.
pub(super) struct Worker<'q, 'g, A: ?Sized, P, T, S> {
    pub(super) queues: &'q Queues<'g, P, T>,
    pub(super) accel: &'q A,
    pub(super) sink: &'q mut S,
    pub(super) stop: &'q (dyn Fn() -> bool + Sync),
    pub(super) fresh: Fresh<P, T>,
    pub(super) keys: Vec<Key>,
    /// For what comes from the file: a run has room in it.
    pub(super) hand: Vec<Piece>,
}

impl<A: Accel + ?Sized, P: Traveller, T: Traveller, S: Sink<P, T>> Worker<'_, '_, A, P, T, S> {
    /// Traces what was taken; not all of it when it is to stop, or when some of it is lost. What lies in the file is asked
    /// for first, and comes while what is in memory is traced.
    pub(super) fn visit(&mut self, voxel: usize, mut load: Load<P, T>) {
        let Some(spill) = self.queues.room.spill else { return self.trace(voxel, load, false) };
        let mut runs = std::mem::take(&mut load.runs);
        Bag::<P, Met>::expect(&runs.met, spill);
        Bag::<T, f32>::expect(&runs.tests, spill);
        Bag::<P, f32>::expect(&runs.open, spill);
        self.trace(voxel, load, false);
        while !(runs.met.is_empty() && runs.tests.is_empty() && runs.open.is_empty()) {
            let hand = &mut self.hand;
            let load = permits::lend(|| Load {
                met: fetch(&mut runs.met, hand, spill),
                tests: fetch(&mut runs.tests, hand, spill),
                open: fetch(&mut runs.open, hand, spill),
                ..Load::default()
            });
            if spill.is_lost() || (self.stop)() {
                break;
            }
            self.trace(voxel, load, true);
        }
    }

    /// Traces `load` in the order of rays. Its pieces are this thread's own if they come from the file.
    fn trace(&mut self, voxel: usize, load: Load<P, T>, own: bool) {
        let Load { open, met, tests, .. } = load;
        let mut keys = std::mem::take(&mut self.keys);
        self.sort(&tests, &mut keys);
        for (&(_, i, j), n) in keys.iter().zip(0..) {
            if self.stops(n) {
                break;
            }
            let (item, from) = tests[i as usize].get(j as usize);
            self.test(voxel, item, from);
        }
        self.give(tests, own);
        self.sort(&open, &mut keys);
        for (&(_, i, j), n) in keys.iter().zip(0..) {
            if self.stops(n) {
                break;
            }
            let (item, from) = open[i as usize].get(j as usize);
            self.path(voxel, item, from, &Hit::MISS);
        }
        self.give(open, own);
        for taken in &met {
            for i in 0..taken.len() {
                if self.stops(i) {
                    break;
                }
                let (item, Met { from, hit }) = taken.get(i);
                self.path(voxel, item, from, &hit);
            }
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
    fn after(&self, ray: &Ray, voxel: usize) -> Option<(f32, u32)> {
        if voxel < self.queues.grid.len() { self.queues.grid.next(ray, voxel as u32) } else { None }
    }

    #[inline(always)]
    fn path(&mut self, voxel: usize, item: P, from: f32, so_far: &Hit) {
        let ray = item.ray();
        let next = self.after(&ray, voxel);
        let to = next.map_or(f32::INFINITY, |(to, _)| to);
        let mut hit = self.accel.closest_part(&ray, from, to, so_far);
        if let Some((from, voxel)) = next.filter(|&(to, _)| hit.t >= to) {
            let (queues, voxel) = (self.queues, voxel as usize);
            let put = if hit.geometry == NONE {
                queues.put(voxel, |queue| &mut queue.open, &item, &from)
            } else {
                queues.put(voxel, |queue| &mut queue.met, &item, &Met { from, hit })
            };
            if put {
                return;
            }
            hit = self.accel.closest_part(&ray, from, f32::INFINITY, &hit);
        }
        self.sink.hit(item, hit, &mut self.fresh);
    }

    #[inline(always)]
    fn test(&mut self, voxel: usize, item: T, from: f32) {
        let ray = item.ray();
        let next = self.after(&ray, voxel);
        let to = next.map_or(f32::INFINITY, |(to, _)| to);
        let mut occluded = self.accel.occluded_part(&ray, from, to);
        if let Some((from, voxel)) = next.filter(|_| !occluded) {
            if self.queues.put(voxel as usize, |queue| &mut queue.tests, &item, &from) {
                return;
            }
            occluded = self.accel.occluded_part(&ray, from, f32::INFINITY);
        }
        self.sink.seen(item, occluded);
    }

    /// Puts new rays into the queues where they begin; where there is no room they are traced, and so may bring new ones.
    pub(super) fn place(&mut self) {
        const FROM: f32 = f32::NEG_INFINITY;
        let queues = self.queues;
        let last = queues.queues.len() - 1;
        let voxel = |ray: &Ray| queues.grid.enter(ray).map_or(last, |v| v as usize);
        for n in 0.. {
            if self.stops(n) {
                break;
            }
            if let Some(item) = self.fresh.tests.pop() {
                let ray = item.ray();
                if !queues.put(voxel(&ray), |queue| &mut queue.tests, &item, &FROM) {
                    self.sink.seen(item, self.accel.occluded(&ray));
                }
            } else if let Some(item) = self.fresh.paths.pop() {
                let ray = item.ray();
                if !queues.put(voxel(&ray), |queue| &mut queue.open, &item, &FROM) {
                    self.sink.hit(item, self.accel.closest(&ray), &mut self.fresh);
                }
            } else {
                break;
            }
        }
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
