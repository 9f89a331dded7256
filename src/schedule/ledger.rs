//! What voxels have seen, and what that says of the next visit.
//!
//! Invariant: decides nothing but time.

use super::Grid;
use crate::stats::{Decision, SchedulerStats, VoxelStats};
use std::time::Instant;

/// Seconds to read a byte, and to trace a ray through a voxel: only their ratio matters, and not much.
const READ_S: f64 = 1.0 / 1.2e9;
const TRACE_S: f64 = 1e-6;

/// What is known of the pages in memory.
pub trait Residency: Sync {
    /// Pages of `voxel` that have been in memory and are not now; `None` where that is not counted.
    fn gone(&self, voxel: u32) -> Option<u32>;
    /// Bytes of a page.
    fn page_bytes(&self) -> u64;
    /// Bytes of the tables that counting needs.
    fn index_bytes(&self) -> u64;
}

/// What a voxel has seen in the whole render.
#[derive(Clone, Copy, Default)]
struct Seen {
    visits: u64,
    rays: u64,
}

/// The record of a render.
pub struct Ledger<'g> {
    grid: &'g Grid,
    residency: Option<&'g dyn Residency>,
    seen: Vec<Seen>,
    decisions: Vec<Decision>,
    /// Every how many visits one is kept.
    every: u64,
    visits: u64,
    queued: u64,
    start: Instant,
}

impl<'g> Ledger<'g> {
    /// For `grid`; its time begins now.
    #[must_use]
    pub fn new(grid: &'g Grid, residency: Option<&'g dyn Residency>) -> Self {
        Self {
            grid,
            residency,
            seen: vec![Seen::default(); grid.len()],
            decisions: Vec::new(),
            every: 1,
            visits: 0,
            queued: 0,
            start: Instant::now(),
        }
    }

    /// Bytes of the pages of `voxel` that are thought to be read for its rays: those that have been before and have left;
    /// at the first visit, and where that is not counted, all.
    fn absent(&self, voxel: u32) -> u64 {
        let Some(residency) = self.residency else { return 0 };
        let all = self.grid.pages(voxel);
        let first = self.seen[voxel as usize].visits == 0;
        let pages = if first { all } else { residency.gone(voxel).unwrap_or(all) };
        u64::from(pages) * residency.page_bytes()
    }

    /// Of the voxels in which rays wait, `(voxel, how many)`, the one with the most rays for each second that it costs.
    /// How many rays are served is all that counts: each must be answered before the image is done, so that the weight
    /// of one says nothing of when it should run.
    pub(super) fn best(&self, waiting: impl Iterator<Item = (u32, usize)>) -> Option<u32> {
        let score = |(voxel, count): (u32, usize)| {
            let absent = self.absent(voxel) as f64;
            (count as f64 / (absent * READ_S + count as f64 * TRACE_S), voxel)
        };
        waiting.map(score).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, voxel)| voxel)
    }

    /// Writes down a visit of `voxel` with `count` rays, of `waiting` in all.
    pub(super) fn visit(&mut self, voxel: u32, count: u64, waiting: u64) {
        let cost_bytes = self.absent(voxel);
        let seen = &mut self.seen[voxel as usize];
        *seen = Seen { visits: seen.visits + 1, rays: seen.rays + count };
        self.queued += count;
        if self.visits.is_multiple_of(self.every) {
            if self.decisions.len() == SchedulerStats::MOST_DECISIONS {
                let mut keep = false;
                self.decisions.retain(|_| {
                    keep = !keep;
                    keep
                });
                self.every *= 2;
            }
            let at_s = self.start.elapsed().as_secs_f64();
            let voxel = self.grid.place(voxel).to_array();
            self.decisions.push(Decision { at_s, voxel, rays: count, waiting, cost_bytes });
        }
        self.visits += 1;
    }

    /// Adds what was done to `stats`.
    pub fn report(&self, stats: &mut SchedulerStats) {
        let grid = self.grid;
        let page_bytes = self.residency.map_or(0, Residency::page_bytes);
        stats.grid = grid.dims();
        stats.bounds = grid.bounds();
        stats.voxels = grid.len() as u64;
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
}
