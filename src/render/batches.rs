//! Rendering with rays that wait: batches of paths as large as the memory for rays allows, each taken through the scene
//! edge by edge in the order that a scheduler finds.
//!
//! Invariant: film tiles get their passes in order, and each sample the same sums as in `job.rs`.

use super::job::{Job, PASS, Scratch};
use super::{Control, Progress};
use crate::accel::Accel;
use crate::error::{Error, Result};
use crate::film::TILE;
use crate::geometry::pages::PageStore;
use crate::integrator::batch::{Batch, Beginning, Next, PATH_BYTES, Shader};
use crate::integrator::path::Wave;
use crate::schedule::{self, Grid, Ledger, QUEUE_BYTES, Requests, Residency, Schedule, Sorted, Voxels};
use crate::stats::{Counters, SchedulerStats};
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Memory for rays where nobody says how much.
pub(super) const DEFAULT_RAY_MEMORY: u64 = 256 << 20;

/// Voxels that a budget's worth of pages fills on average.
const VOXELS_IN_MEMORY: u64 = 16;
/// Voxels with pages, at least and at most, unless told otherwise.
const VOXELS: (u64, u64) = (64, 4096);

/// Slots whose sums a thread settles at a time.
const SETTLED: usize = 1 << 14;

/// What decides which rays run next.
pub(super) enum Waiting<'a> {
    Sorted,
    Voxel { pages: &'a PageStore, voxels: Option<u32> },
}

/// Tiles and passes of a batch.
struct Units {
    first: u64,
    count: usize,
    /// Slots of one.
    stride: usize,
}

impl Residency for PageStore {
    fn reads(&self) -> u64 {
        Self::reads(self)
    }

    fn room(&self) -> u64 {
        Self::room(self)
    }

    fn page_bytes(&self) -> u64 {
        Self::page_bytes(self)
    }
}

/// Bytes that a film tile's pass takes in flight, the least that rays need.
fn unit_bytes(spp: u32) -> u64 {
    let paths = u64::from(TILE * TILE) * u64::from(spp.min(PASS));
    paths * (PATH_BYTES + QUEUE_BYTES) as u64
}

/// Holds a memory for rays against the least that one batch takes.
///
/// # Errors
/// [`Error::Usage`] when it is too small.
pub(super) fn check_ray_memory(bytes: u64, spp: u32) -> Result<()> {
    let least = unit_bytes(spp);
    if bytes < least {
        return Err(Error::Usage(format!(
            "a ray memory of {bytes} bytes is too small: --ray-memory {least} would do, for the paths of one film tile"
        )));
    }
    Ok(())
}

impl<A: Accel + ?Sized> Job<'_, A> {
    /// Renders with rays that wait in at most `ray_memory` bytes.
    pub(super) fn run_in_batches(
        &self,
        threads: usize,
        waiting: &Waiting<'_>,
        ray_memory: u64,
    ) -> (Counters, SchedulerStats) {
        let control: &Control<'_> = self.control;
        (control.progress)(Progress::Phase("rendering"));
        let mut counters = Counters::default();
        let mut stats = SchedulerStats { ray_memory, ..SchedulerStats::default() };
        let grid = match waiting {
            Waiting::Sorted => Grid::new(&[], 0),
            Waiting::Voxel { pages, voxels } => {
                let wanted = pages.all_bytes() * VOXELS_IN_MEMORY / pages.budget().max(1);
                let wanted = voxels.map_or(wanted.clamp(VOXELS.0, VOXELS.1) as u32, |v| v);
                Grid::new(&self.world.accel.pages(), wanted)
            }
        };
        let mut ledger = Ledger::new(&grid);
        let passes = u64::from(self.spp.div_ceil(PASS));
        let total = u64::from(self.buffer.tile_count()) * passes;
        let most = usize::try_from(ray_memory / unit_bytes(self.spp)).unwrap_or(usize::MAX).max(1);
        // Names of paths are below those of rays that ask for the sky.
        let most = most.min((schedule::MOST_RAYS / 4) as usize / (TILE * TILE * PASS) as usize);
        let batches = total.div_ceil(most as u64).max(1);
        // All of one size, so that none is small.
        let most = total.div_ceil(batches) as usize;
        let mut first = 0;
        let samples =
            u64::from(self.spp) * u64::from(self.film.crop[2] - self.film.crop[0])
                * u64::from(self.film.crop[3] - self.film.crop[1]);
        while first < total && !self.should_stop() {
            let count = most.min((total - first) as usize);
            let stride = (TILE * TILE * self.spp.min(PASS)) as usize;
            let units = Units { first, count, stride };
            let done = self.batch(threads, waiting, (&grid, &mut ledger), &units, &mut stats, &mut counters);
            if !done {
                self.buffer.abandon();
                break;
            }
            first += count as u64;
            stats.batches += 1;
            if self.first_pixel.get().is_none() {
                let _ = self.first_pixel.set(Instant::now());
            }
            (control.progress)(Progress::Samples { done: counters.samples, total: samples });
        }
        if let Waiting::Voxel { pages, .. } = waiting {
            ledger.report(&grid, pages.page_bytes(), &mut stats);
        }
        (counters, stats)
    }

    /// Which tile and pass unit `i` is.
    fn unit(&self, i: u64) -> (u32, u32) {
        let (tiles, passes) = (u64::from(self.buffer.tile_count()), u64::from(self.spp.div_ceil(PASS)));
        let (place, pass) =
            if self.deadline.is_some() { (i % tiles, i / tiles) } else { (i / passes, i % passes) };
        (self.along[place as usize], pass as u32)
    }

    /// One batch from the camera to the film; false when it was stopped on the way, and added nothing.
    fn batch(
        &self,
        threads: usize,
        waiting: &Waiting<'_>,
        (grid, ledger): (&Grid, &mut Ledger),
        units: &Units,
        stats: &mut SchedulerStats,
        counters: &mut Counters,
    ) -> bool {
        let slots = units.count * units.stride;
        let (mut batch, weights) = self.begin(threads, units, slots, counters);
        stats.paths_in_flight_peak = stats.paths_in_flight_peak.max(weights.iter().map(|w| w.len() as u64).sum());
        let stop = || self.should_stop();
        let mut depth = 0;
        while !batch.is_done() {
            batch.count(counters);
            let requests = batch.requests();
            let requests = Requests::new(&requests);
            let next = Next::new();
            let bounds = self.world.accel.bounds();
            let queued = match waiting {
                Waiting::Sorted => {
                    self.phase(threads, &Sorted::new(bounds), &requests, (&batch, &next), depth, counters);
                    0
                }
                Waiting::Voxel { pages, .. } => {
                    let voxels = Voxels::new(grid, *pages, Sorted::new(bounds), ledger);
                    self.phase(threads, &voxels, &requests, (&batch, &next), depth, counters);
                    voxels.peak_bytes()
                }
            };
            if stop() {
                return false;
            }
            self.settle(threads, &batch, counters);
            let before = batch.bytes();
            batch = batch.turn(next);
            let bytes = (before + batch.bytes() + queued + 4 * slots) as u64;
            stats.ray_memory_peak = stats.ray_memory_peak.max(bytes);
            depth += 1;
        }
        self.finish(threads, units, &batch, &weights, counters)
    }

    /// Camera paths, and the weights of their samples by unit.
    fn begin(
        &self,
        threads: usize,
        units: &Units,
        slots: usize,
        counters: &mut Counters,
    ) -> (Batch, Vec<Vec<f32>>) {
        let begin = Next::new();
        let taken = AtomicUsize::new(0);
        let parts = self.crew(threads, counters, |_| {
            let (mut wave, mut writer, mut weights) = (Wave::default(), Beginning::new(&begin), Vec::new());
            loop {
                let i = taken.fetch_add(1, Ordering::Relaxed);
                if i >= units.count {
                    return weights;
                }
                let (tile, pass) = self.unit(units.first + i as u64);
                let mut of_unit = Vec::with_capacity(units.stride);
                self.start(tile, pass, &mut wave, &mut of_unit);
                writer.add(&mut wave, (i * units.stride) as u32);
                weights.push((i, of_unit));
            }
        });
        let mut weights = vec![Vec::new(); units.count];
        for (i, of_unit) in parts.into_iter().flatten() {
            weights[i] = of_unit;
        }
        (Batch::new(begin, slots), weights)
    }

    /// Traces all rays and shades what they meet.
    fn phase(
        &self,
        threads: usize,
        schedule: &impl Schedule,
        requests: &Requests<'_>,
        (batch, next): (&Batch, &Next),
        depth: u32,
        counters: &mut Counters,
    ) {
        self.crew(threads, counters, |counters| {
            let mut shader = Shader::new(self.world, batch, next, depth, counters);
            schedule.work(self.world.accel, batch, requests, &mut shader, &|| self.should_stop());
            shader.finish();
        });
    }

    fn settle(&self, threads: usize, batch: &Batch, counters: &mut Counters) {
        let slots = batch.slots();
        let taken = AtomicUsize::new(0);
        self.crew(threads, counters, |_| {
            loop {
                let start = taken.fetch_add(SETTLED, Ordering::Relaxed);
                if start >= slots {
                    return;
                }
                batch.settle(start..(start + SETTLED).min(slots));
            }
        });
    }

    /// Sums by pixel, to the film.
    fn finish(
        &self,
        threads: usize,
        units: &Units,
        batch: &Batch,
        weights: &[Vec<f32>],
        counters: &mut Counters,
    ) -> bool {
        let taken = AtomicUsize::new(0);
        let done = self.crew(threads, counters, |counters| {
            let mut scratch = Scratch::default();
            loop {
                // In order: whoever holds a later pass of a tile waits for the earlier one.
                let i = taken.fetch_add(1, Ordering::Relaxed);
                if i >= units.count {
                    return true;
                }
                let (tile, pass) = self.unit(units.first + i as u64);
                let slots: Range<usize> = i * units.stride..i * units.stride + weights[i].len();
                let radiance = slots.map(|slot| batch.radiance(slot));
                if !self.sum(tile, pass, radiance, &weights[i], &mut scratch, counters) {
                    return false;
                }
                let samples = weights[i].len() as u64;
                counters.samples += samples;
                self.samples.fetch_add(samples, Ordering::Relaxed);
            }
        });
        done.into_iter().all(|d| d)
    }
}
