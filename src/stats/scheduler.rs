//! What the scheduler did: visits of voxels, rays that waited, and its decisions in time.
//!
//! Invariant: plain data; never decides.

use serde::{Deserialize, Serialize};

/// What the scheduler did during a render.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SchedulerStats {
    /// `depth`, `sorted` or `voxel`.
    pub name: String,
    /// Why it was chosen.
    pub because: String,
    /// Batches of paths that went through the scene together.
    pub batches: u64,
    /// Most paths in flight at once.
    pub paths_in_flight_peak: u64,
    /// Bytes that paths, their rays and hits were allowed; 0 where nothing waits.
    pub ray_memory: u64,
    /// Most bytes that they took.
    pub ray_memory_peak: u64,
    /// Bytes that the file for rays without room in memory might take; 0 where there was none.
    pub ray_disk: u64,
    /// Bytes that were written there, and the most that lay there at once.
    pub spilled_bytes: u64,
    /// See `spilled_bytes`.
    pub spilled_peak_bytes: u64,
    /// Seconds of writing there, of all threads; waiting until another has written is not in it.
    pub spill_write_s: f64,
    /// See `spill_write_s`.
    pub spill_read_s: f64,
    /// Bytes of tables beside: the grid, its queues, what tells which pages are in memory.
    pub index_bytes: u64,
    /// Cells along each axis; zero without a grid.
    pub grid: [u32; 3],
    /// The grid's box: least corner, greatest corner.
    pub bounds: [[f32; 3]; 2],
    /// Voxels that geometry lies in.
    pub voxels: u64,
    /// Times a voxel was taken up.
    pub voxel_visits: u64,
    /// Times a ray waited in a voxel's queue.
    pub rays_queued: u64,
    /// `rays_queued` over `voxel_visits`.
    pub rays_per_visit: f64,
    /// Each voxel that was visited.
    pub by_voxel: Vec<VoxelStats>,
    /// Visits in their order; every n-th where there were more than [`SchedulerStats::MOST_DECISIONS`].
    pub decisions: Vec<Decision>,
}

/// What one voxel saw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct VoxelStats {
    /// Which: along x, y and z.
    pub at: [u32; 3],
    /// Bytes of the pages that lie in it.
    pub bytes: u64,
    /// Times it was taken up.
    pub visits: u64,
    /// Rays traced in it.
    pub rays: u64,
}

/// One visit of a voxel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Decision {
    /// Seconds since rendering began.
    pub at_s: f64,
    /// Which voxel.
    pub voxel: [u32; 3],
    /// Rays that were taken from its queue.
    pub rays: u64,
    /// Rays that waited in all queues at that time.
    pub waiting: u64,
    /// Bytes of its pages that were thought to be absent.
    pub cost_bytes: u64,
}

impl SchedulerStats {
    /// Decisions that are kept at most.
    pub const MOST_DECISIONS: usize = 4096;
}
