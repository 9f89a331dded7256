//! Rendering with rays that wait: camera paths enter while the memory for rays has room, and a scheduler decides which
//! rays run next.
//!
//! Invariant: film tiles get their passes in order, and each sample the same sums as in `job.rs`.

use super::Progress;
use super::job::{Job, PASS};
use super::rounds::Round;
use crate::accel::Accel;
use crate::color::Rgb;
use crate::error::{Error, Result};
use crate::film::TILE;
use crate::geometry::pages::PageStore;
use crate::integrator::flight::{Flight, GATHERED, Probe, Shader, hit_bytes, unit_bytes};
use crate::integrator::kernel::{General, Kernel, with_kernel};
use crate::integrator::path::Wave;
use crate::integrator::units::{Film, MOST_UNITS, UNIT, Units, unit_pieces};
use crate::permits::{Permits, lock};
use crate::schedule::{Grid, Ledger, Limits, Meter, Order, PIECE_BYTES, Queues, Residency, Space, Spill};
use crate::settings::RenderSettings;
use crate::stats::{Counters, SchedulerStats};
use crate::texture::cache_dir;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Mutex;

/// Memory for rays where nobody says how much.
pub(super) const DEFAULT_RAY_MEMORY: u64 = 256 << 20;

/// Voxels that a budget's worth of pages fills on average.
const VOXELS_IN_MEMORY: u64 = 64;
/// Voxels with pages, at least and at most, unless told otherwise.
const VOXELS: (u64, u64) = (64, 4096);

/// Pairs of page and voxel that are kept to tell what is in memory; where there are more it is not told.
const MOST_PAIRS: usize = 1 << 22;

/// Rays that a thread takes from a voxel's queue at once, some ten milliseconds of work, and from that of all.
const TAKEN: (usize, usize) = (1 << 13, 1 << 16);

const _: () = assert!((TILE * TILE * PASS) as usize <= UNIT, "a pass over a film tile is a unit");

/// Threads that render where some wait for a disk, of which only `threads` compute at a time: disks answer
/// eight questions at once in little more time than one.
pub(super) fn workers(threads: usize) -> usize {
    threads + READERS
}

/// See [`workers`].
const READERS: usize = 8;

/// Threads that share the rays of a voxel, so that they read its pages side by side.
const SHARES: usize = 8;
/// Threads that compute for each voxel that is run at the same time.
const THREADS_A_VOXEL: usize = 4;

/// What decides which rays run next.
pub(super) enum Waiting<'a> {
    /// One queue.
    Sorted,
    /// One for each voxel over `pages`; some `voxels` of them, if that is said.
    Voxel { pages: &'a PageStore, voxels: Option<u32> },
}

impl Waiting<'_> {
    /// What it is called on the command line.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Sorted => "sorted",
            Self::Voxel { .. } => "voxel",
        }
    }
}

impl Residency for PageStore {
    fn gone(&self, voxel: u32) -> Option<u32> {
        Self::gone(self, voxel)
    }

    fn page_bytes(&self) -> u64 {
        Self::page_bytes(self)
    }

    fn index_bytes(&self) -> u64 {
        Self::watch_bytes(self)
    }
}

/// What rays that wait may take.
pub(super) struct RayRoom<'a> {
    /// Bytes of memory.
    pub(super) memory: u64,
    /// Bytes of tables beside; what they take more they take from there.
    pub(super) tables: u64,
    /// Bytes of a file, and the directory for it; the user's cache directory if none is named.
    pub(super) disk: u64,
    pub(super) directory: Option<&'a Path>,
}

/// What came of rays.
#[derive(Default)]
pub(super) struct Queued {
    pub(super) counters: Counters,
    pub(super) stats: SchedulerStats,
    /// What a person should know.
    pub(super) note: Option<String>,
}

/// Whether rays without room in memory go to a file.
pub(super) fn spills(settings: &RenderSettings) -> bool {
    settings.ray_disk.is_some_and(|bytes| bytes > 0)
}

/// Of memory for rays: a part for tables of the file, and of the rest one for the rays that are at hand; all else has the sums
/// of samples on their way, which stay, and so are what bounds how many there are.
const SPILL_TABLES: usize = 16;
const SPILL_RAYS: usize = 4;

/// What threads have in their hands.
struct Hands {
    /// Hits that each gathers to shade, and rays that it takes.
    gathered: usize,
    taken: usize,
    /// Pieces that each has for what comes from a file.
    pieces: usize,
    /// Bytes of it all.
    bytes: usize,
}

impl Hands {
    /// Of `workers` threads: at most a quarter of `memory`, but so much that work is worth while.
    fn new<K: Kernel>(memory: usize, workers: usize, most_taken: usize, spills: bool) -> Self {
        let (hit, ray) = (hit_bytes::<K>(), Queues::<Flight<K>, Probe>::RAY_BYTES);
        let each = memory / (8 * workers);
        let gathered = (each / hit).clamp(16, GATHERED);
        let taken = (each / ray).clamp(64, most_taken);
        // Rays are taken by whole pieces of memory.
        let rays = taken + PIECE_BYTES / size_of::<Flight<K>>();
        let read = (taken * size_of::<Flight<K>>() / PIECE_BYTES).clamp(1, MOST_READ);
        let pieces = if spills { read } else { 0 };
        let bytes = workers * (gathered * hit + rays * ray + pieces * PIECE_BYTES);
        Self { gathered, taken, pieces, bytes }
    }
}

/// Pieces that are read at once, at most: 64 KiB.
const MOST_READ: usize = 16;

/// Least memory for rays that works, whatever the kernel: a film tile's paths, and what threads have in their hands.
pub(super) fn least_ray_memory(threads: usize, spills: bool) -> u64 {
    let hands = Hands::new::<General>(0, workers(threads), TAKEN.0, spills).bytes;
    (unit_bytes::<General>() + hands) as u64 * 4 / 3
}

/// Holds a memory for rays against [`least_ray_memory`], and their file against its least.
///
/// # Errors
/// [`Error::Usage`] when it is too small.
pub(super) fn check_rays(bytes: u64, threads: usize, settings: &RenderSettings) -> Result<()> {
    let least = least_ray_memory(threads, spills(settings));
    if let Some(disk @ 1..Spill::LEAST_BYTES) = settings.ray_disk {
        let least = Spill::LEAST_BYTES;
        return Err(Error::Usage(format!(
            "--ray-disk {disk} has no room for any ray; {least} bytes or more would do, or 0"
        )));
    }
    if bytes < least {
        return Err(Error::Usage(format!(
            "a ray memory of {bytes} bytes is too small: --ray-memory {least} would do, for the paths of one film tile \
             and what {threads} threads have in hand"
        )));
    }
    Ok(())
}

/// Sums of passes, by tile and pass.
type Passes = HashMap<(u32, u32), Vec<[f32; 4]>>;

/// A part of the film's units, on their way.
struct Part<'j, 'a, A: ?Sized> {
    job: &'j Job<'a, A>,
    round: Option<&'j Round>,
    first: u64,
    /// Those that came before their turn.
    early: Mutex<Passes>,
}

impl<A: Accel + ?Sized, K: Kernel> Film<K> for Part<'_, '_, A> {
    fn start(&self, unit: u32, wave: &mut Wave<K>, weights: &mut Vec<f32>) {
        let (tile, pass) = self.job.unit(self.round, self.first + u64::from(unit));
        self.job.start(tile, pass, wave, weights);
    }

    fn finish(&self, unit: u32, radiance: &[Rgb], weights: &[f32], counters: &mut Counters) {
        let (tile, pass) = self.job.unit(self.round, self.first + u64::from(unit));
        let mut sums = Vec::new();
        self.job.sum((tile, pass), radiance, weights, &mut sums, counters);
        let buffer = &self.job.buffer;
        {
            let mut early = lock(&self.early);
            early.insert((tile, pass), sums);
            let mut pass = buffer.passes(tile);
            while let Some(sums) = early.remove(&(tile, pass)) {
                buffer.add(tile, pass, self.job.cut(pass), &sums);
                pass += 1;
            }
        }
        self.job.count_samples(weights.len() as u64, counters);
    }
}

impl<A: Accel + ?Sized> Job<'_, A> {
    /// Renders with rays that wait, in `room`.
    ///
    /// # Errors
    /// [`Error::Resource`] when rays that went to a file cannot be read again.
    pub(super) fn run_in_queues(
        &self,
        threads: usize,
        waiting: &Waiting<'_>,
        room: &RayRoom<'_>,
    ) -> Result<Queued> {
        with_kernel!(self.world.kernel(), K => self.queues_with::<K>(threads, waiting, room))
    }

    fn queues_with<K: Kernel>(
        &self,
        threads: usize,
        waiting: &Waiting<'_>,
        room: &RayRoom<'_>,
    ) -> Result<Queued> {
        (self.control.progress)(Progress::Phase("rendering"));
        let mut counters = Counters::default();
        let RayRoom { memory: ray_memory, disk, .. } = *room;
        let mut stats = SchedulerStats { ray_memory, ray_disk: disk, ..SchedulerStats::default() };
        let (grid, residency, taken) = match waiting {
            Waiting::Sorted => (Grid::new(&[], 0), None, TAKEN.1),
            Waiting::Voxel { pages, voxels } => {
                let wanted = pages.all_bytes() * VOXELS_IN_MEMORY / pages.budget().max(1);
                let wanted = voxels.unwrap_or(wanted.clamp(VOXELS.0, VOXELS.1) as u32);
                let boxes = self.world.accel.pages();
                let grid = Grid::new(&boxes, wanted);
                if let Some(pairs) = grid.pairs(&boxes, MOST_PAIRS) {
                    pages.watch(pairs, grid.len());
                }
                let residency: &dyn Residency = *pages;
                (grid, Some(residency), TAKEN.0)
            }
        };
        let mut ledger = Some(Ledger::new(&grid, residency));
        let order = Order::new(self.world.accel.bounds());
        let passes = u64::from(self.spp.div_ceil(PASS));
        let total = u64::from(self.buffer.tile_count()) * passes;
        // Many times as many as memory holds, so that the end of a part, where few rays are left, costs little.
        let in_part = |bytes: usize| (bytes / unit_bytes::<K>() * 64).min(MOST_UNITS as usize) as u64;
        let bytes = usize::try_from(ray_memory).unwrap_or(usize::MAX);
        stats.index_bytes = (grid.bytes() + Queues::<Flight<K>, Probe>::bytes_of(grid.len(), disk > 0))
            as u64
            + in_part(bytes).min(total) * Units::PLACE_BYTES as u64
            + residency.map_or(0, Residency::index_bytes);
        let bytes = bytes.saturating_sub(stats.index_bytes.saturating_sub(room.tables) as usize);
        // One at least: tables may take more than there is beside the least.
        let in_part = in_part(bytes).max(1);
        let Hands { gathered, taken, pieces, bytes: hands } =
            Hands::new::<K>(bytes, workers(threads), taken, disk > 0);
        // Where all come past one queue nobody gains by sharing.
        let shares = if residency.is_some() { SHARES } else { 1 };
        let voxels = threads.div_ceil(THREADS_A_VOXEL);
        let tables = Spill::most_table_bytes(disk).min(bytes / SPILL_TABLES);
        let bytes = bytes.saturating_sub(hands + tables);
        let begun = unit_pieces(self.most_samples());
        let spill = match (disk, room.directory) {
            (0, _) => None,
            (_, Some(directory)) => Some(Spill::new(directory.to_owned(), disk, tables, pieces)),
            (_, None) => Some(Spill::new(cache_dir::default_dir()?, disk, tables, pieces)),
        };
        // Where rays may leave for a file, sums that stay must not take all memory from them.
        let holds = bytes.saturating_add(usize::try_from(disk).unwrap_or(usize::MAX)) / SPILL_RAYS;
        let sums = (bytes - bytes / SPILL_RAYS).min(holds);
        let apart = spill.as_ref().map(|_| sums.max(begun * PIECE_BYTES));
        let of_units = apart.map(Meter::new);
        let meter = Meter::new(bytes.saturating_sub(apart.unwrap_or(0)));
        let places =
            Space { rays: &meter, begun: of_units.as_ref().unwrap_or(&meter), spill: spill.as_ref() };
        let limits = Limits { begun, begin: unit_bytes::<K>().div_ceil(PIECE_BYTES), taken, shares, voxels };
        self.by_rounds(|round| {
            let total = round.map_or(total, Round::passes);
            let mut first = 0;
            let lost = || spill.as_ref().is_some_and(Spill::is_lost);
            while first < total && !self.should_stop() && !lost() {
                let count = (total - first).min(in_part) as u32;
                let units = Units::new(count, places.begun);
                let part = Part { job: self, round, first, early: Mutex::default() };
                let record = ledger.take().expect("who writes in it gives it back");
                let queues = Queues::new(&grid, record, order, limits, places);
                let permits = Permits::new(threads);
                let counted = self.crew(workers(threads), |counters| {
                    permits.hold(|| {
                        let stop = || self.should_stop() || lost();
                        let mut shader =
                            Shader::<A, K>::new(self.world, &units, &part, counters, gathered, &stop);
                        queues.work(self.world.accel, &mut shader, &stop);
                    });
                });
                counters.merge(&counted);
                ledger = Some(queues.finish());
                stats.paths_in_flight_peak = stats.paths_in_flight_peak.max(units.peak_paths());
                first += u64::from(count);
                stats.batches += 1;
            }
            !lost()
        });
        let mut peak = meter.bytes() + of_units.as_ref().map_or(0, Meter::bytes) + hands;
        ledger.iter().for_each(|ledger| ledger.report(&mut stats));
        let mut note = None;
        if let Some(spill) = &spill {
            if let Some(line) = spill.lost() {
                return Err(Error::Resource(line.to_owned()));
            }
            spill.report(&mut stats);
            peak += spill.table_bytes();
            note = spill.refused().map(str::to_owned);
        }
        stats.ray_memory_peak = peak as u64;
        Ok(Queued { counters, stats, note })
    }

    /// Samples of a unit, at most.
    fn most_samples(&self) -> usize {
        (TILE * TILE * PASS.min(self.spp)) as usize
    }

    /// Which tile and pass unit `i` of `round` is, or of all.
    fn unit(&self, round: Option<&Round>, i: u64) -> (u32, u32) {
        if let Some(round) = round {
            return round.unit(i);
        }
        let (tiles, passes) = (u64::from(self.buffer.tile_count()), u64::from(self.spp.div_ceil(PASS)));
        let (place, pass) =
            if self.deadline.is_some() { (i % tiles, i / tiles) } else { (i / passes, i % passes) };
        (self.along[place as usize], pass as u32)
    }
}
