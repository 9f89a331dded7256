//! What a render cost: counters kept by each thread and merged at the end, and the record that
//! `--stats` writes. Invariant: every counter of [`Counters`] is merged, because the merge
//! destructures it. Never prints (`report` does) and never decides anything.

mod cache;
mod key_hasher;
mod miss_ratio;
mod moves;
mod plan;
mod process;
mod references;
mod rooms;
mod scheduler;
mod settings;
mod timeline;

pub use cache::{CacheCounts, CacheFile, CacheRow, CacheStats, Knee, MissRatios};
pub use key_hasher::{KeyBuildHasher, spread};
pub use miss_ratio::{StackDistances, sample_hash};
pub use moves::MemoryMove;
pub use plan::{EffectStats, PlanBytes, PlanMemory, PlanStats};
pub use process::{available_memory_bytes, nanoseconds, peak_rss_bytes, rss_bytes, thread_cpu_seconds};
pub use references::{References, SAMPLES};
pub use rooms::RoomTimes;
pub use scheduler::{Decision, SchedulerStats, VoxelStats};
pub use settings::EffectiveSettings;
pub use timeline::{Gauge, MemorySample, MemoryWatch};

use crate::clock::Nanoseconds;
use serde::{Deserialize, Serialize};

/// Counters of one thread. A thread owns its copy and nobody else writes it, so they are plain
/// numbers; the alignment keeps two threads' copies out of one cache line (and its prefetched pair).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(align(128))]
pub struct Counters {
    /// Camera samples finished.
    pub samples: u64,
    /// Samples whose radiance was infinite or not a number, and was dropped.
    pub non_finite_samples: u64,
    /// Closest-hit queries.
    pub closest: u64,
    /// Occlusion queries.
    pub occluded: u64,
    /// Processor time spent working, in nanoseconds.
    pub busy_nanoseconds: u64,
    /// Time by room of the code.
    pub rooms: Nanoseconds,
}

impl Counters {
    /// Adds another thread's counters.
    pub fn merge(&mut self, other: &Self) {
        // Destructured, so that a new counter breaks the build until it is merged.
        let Self { samples, non_finite_samples, closest, occluded, busy_nanoseconds, rooms } = *other;
        self.samples += samples;
        self.non_finite_samples += non_finite_samples;
        self.closest += closest;
        self.occluded += occluded;
        self.busy_nanoseconds += busy_nanoseconds;
        self.rooms.iter_mut().zip(rooms).for_each(|(sum, spent)| *sum += spent);
    }
}

/// What `--stats` writes. Sizes in bytes, times in seconds. Unknown keys are ignored and missing
/// ones are zero when it is read back, so that a report of another version still prints.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RenderStats {
    /// Weir's version.
    pub weir: String,
    /// The scene file.
    pub scene: String,
    /// The command line, the program first; empty where no program was called.
    pub command: Vec<String>,
    /// What was in force, defaults and the scene's own values included.
    pub settings: EffectiveSettings,
    /// What the scene calls for.
    pub plan: PlanStats,
    /// Where the time went.
    pub time: TimeStats,
    /// The image.
    pub image: ImageStats,
    /// Rays traced.
    pub rays: RayStats,
    /// Where the memory went.
    pub memory: MemoryStats,
    /// Textures that are read tile by tile; absent where none is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texture_cache: Option<CacheStats>,
    /// Geometry that is read page by page; absent where all of it stays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub geometry_cache: Option<CacheStats>,
    /// Who decided which rays ran next.
    pub scheduler: SchedulerStats,
    /// What caches of other sizes would have missed.
    pub miss_ratio: MissRatios,
    /// Worker threads.
    pub threads: usize,
    /// Processor seconds of the workers over `render_s` × `threads`, at most 1.
    pub busy: f64,
    /// Whether it was stopped before its last sample.
    pub interrupted: bool,
}

/// Seconds of wall time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TimeStats {
    /// Reading the scene file.
    pub parse_s: f64,
    /// Planning, and loading meshes and textures.
    pub prepare_s: f64,
    /// Building acceleration structures.
    pub build_s: f64,
    /// From the first ray to the last.
    pub render_s: f64,
    /// Encoding and writing images.
    pub write_s: f64,
    /// Writing checkpoints, most of it while rendering goes on.
    pub checkpoint_s: f64,
    /// All of it.
    pub total_s: f64,
    /// From the start to the first finished pixel sample.
    pub first_pixel_s: f64,
    /// Threads waiting for tiles of textures that others read, or for room for them, summed.
    pub stall_s: f64,
    /// What threads did while rendering.
    pub rooms: RoomTimes,
}

/// The image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ImageStats {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Whole samples per pixel that are in the image.
    pub spp: u32,
    /// Samples of the pixels that have fewest; `None` where all were to get the same in one go.
    pub spp_min: Option<u32>,
    /// Of those that have most.
    pub spp_max: Option<u32>,
    /// Of a pixel in the mean.
    pub spp_mean: Option<f64>,
    /// Camera samples traced.
    pub samples: u64,
    /// Camera samples that a checkpoint had; they are not counted in `samples`.
    pub resumed_samples: u64,
    /// Samples that were infinite or not a number.
    pub non_finite_samples: u64,
    /// relMSE against the picture of infinitely many samples, as the samples themselves tell it; `None` where no error was
    /// estimated, which takes `--noise`.
    pub estimated_relmse: Option<f64>,
    /// Pixels that a stopped render did not reach; black.
    pub pixels_without_samples: u64,
}

/// Rays traced.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RayStats {
    /// Closest-hit queries.
    pub closest: u64,
    /// Occlusion queries.
    pub occluded: u64,
    /// Both kinds, per second of `render_s`.
    pub per_second: f64,
}

/// Bytes of memory.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MemoryStats {
    /// The bound asked for; `None` when there is none.
    pub budget: Option<u64>,
    /// Most that our own accounting saw at once, or less than a step of [`Self::moves`] above it.
    pub peak_accounted: u64,
    /// What that is made of.
    pub accounted: AccountedBytes,
    /// Vertices, attributes and acceleration structures, were all of them resident: as they were found, where
    /// `plan.bytes` says what was expected.
    pub all_geometry: u64,
    /// Textures, all levels, likewise.
    pub all_textures: u64,
    /// Most that the process held, by the operating system; `None` when it does not say.
    pub peak_rss: Option<u64>,
    /// `peak_rss` less `peak_accounted`: code, stacks, what nobody counted.
    pub unaccounted: Option<i64>,
    /// Memory over time; empty where nobody watched.
    pub timeline: Vec<MemorySample>,
    /// What textures and geometry gave each other, where there is a bound on all.
    pub moves: Vec<MemoryMove>,
}

/// The most that each part took, which may have been at different times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct AccountedBytes {
    /// Geometry that stays, its acceleration structures, and pages.
    pub geometry: u64,
    /// Textures: images in memory and tiles.
    pub textures: u64,
    /// Rays that wait, and what threads have in hand of them.
    pub rays: u64,
    /// The film's sums, and the finished image.
    pub film: u64,
    /// Images of lights at infinity, and what chooses among lights.
    pub lights: u64,
    /// The scene's own tables, with the meshes that stand in its file.
    pub description: u64,
    /// Tables of what waits and of what comes and goes.
    pub tables: u64,
}

impl AccountedBytes {
    /// All of it.
    #[must_use]
    pub fn sum(&self) -> u64 {
        let Self { geometry, textures, rays, film, lights, description, tables } = *self;
        geometry + textures + rays + film + lights + description + tables
    }
}

impl RenderStats {
    /// Fills in what follows from merged counters and from `time.render_s`, `threads`, `time.rooms.threads` and
    /// `memory.peak_accounted`, which must be set before; reads the process's peak memory.
    pub fn finish(&mut self, counters: &Counters) {
        let Counters { samples, non_finite_samples, closest, occluded, busy_nanoseconds, rooms } = *counters;
        self.time.rooms = RoomTimes::new(self.time.rooms.threads, &rooms);
        self.image.samples = samples;
        self.image.non_finite_samples = non_finite_samples;
        self.rays = RayStats {
            closest,
            occluded,
            per_second: per_second((closest + occluded) as f64, self.time.render_s),
        };
        // Two clocks, so the quotient may pass one by their granularity.
        self.busy =
            per_second(busy_nanoseconds as f64 * 1e-9, self.time.render_s * self.threads as f64).min(1.0);
        self.note_peak_memory();
    }

    /// Reads the process's peak memory again: writing images comes after [`Self::finish`].
    ///
    /// Linux keeps the peak from counters that it sums roughly and tells what is resident from an exact sum, so a sample
    /// may lie above the peak; what was once seen was there.
    pub fn note_peak_memory(&mut self) {
        let seen = self.memory.timeline.iter().filter_map(|sample| sample.rss).max();
        self.memory.peak_rss = peak_rss_bytes().max(seen);
        self.memory.unaccounted =
            self.memory.peak_rss.map(|rss| rss as i64 - self.memory.peak_accounted as i64);
    }

    /// Camera samples per second of rendering; 0 when no time passed.
    #[must_use]
    pub fn samples_per_second(&self) -> f64 {
        per_second(self.image.samples as f64, self.time.render_s)
    }
}

fn per_second(count: f64, seconds: f64) -> f64 {
    if seconds > 0.0 { count / seconds } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn merging_adds_every_counter() {
        let times = |n: u64| Counters {
            samples: n,
            non_finite_samples: 2 * n,
            closest: 3 * n,
            occluded: 4 * n,
            busy_nanoseconds: 5 * n,
            rooms: std::array::from_fn(|i| (6 + i as u64) * n),
        };
        let (a, twice) = (times(1), times(2));
        let mut sum = a;
        sum.merge(&a);
        assert_eq!(sum, twice);
    }

    #[test]
    fn finishing_derives_rates() {
        let mut stats = RenderStats { threads: 2, ..RenderStats::default() };
        stats.time.render_s = 4.0;
        stats.memory.peak_accounted = 1000;
        let counters = Counters {
            samples: 800,
            non_finite_samples: 1,
            closest: 3000,
            occluded: 1000,
            busy_nanoseconds: 6_000_000_000,
            ..Counters::default()
        };
        stats.finish(&counters);
        assert_eq!(stats.busy, 0.75);
        assert_eq!(stats.rays.per_second, 1000.0);
        assert_eq!(stats.samples_per_second(), 200.0);
        assert_eq!((stats.image.samples, stats.image.non_finite_samples), (800, 1));
        if let Some(rss) = stats.memory.peak_rss {
            assert_eq!(stats.memory.unaccounted, Some(rss as i64 - 1000));
        }
        assert_eq!(RenderStats::default().samples_per_second(), 0.0);
    }

    #[test]
    fn no_sample_is_above_the_peak() {
        let mut stats = RenderStats::default();
        let rss = Some(1 << 60);
        stats.memory.timeline =
            vec![MemorySample { rss, ..MemorySample::default() }, MemorySample::default()];
        stats.note_peak_memory();
        assert_eq!(stats.memory.peak_rss, rss, "more than any process holds");
    }

    /// The keys are a contract: other programs read them.
    #[test]
    fn json_has_the_keys_of_the_contract() {
        let json = serde_json::to_value(RenderStats::default()).expect("plain data");
        for (object, keys) in [
            ("", &["weir", "scene", "command", "settings", "plan", "time", "image", "rays", "memory"][..]),
            ("plan", &["effects", "schedule", "bytes"]),
            ("plan/bytes", &["geometry", "textures"]),
            (
                "time",
                &[
                    "parse_s",
                    "prepare_s",
                    "build_s",
                    "render_s",
                    "write_s",
                    "total_s",
                    "first_pixel_s",
                    "stall_s",
                ],
            ),
            ("image", &["width", "height", "spp", "samples", "non_finite_samples", "estimated_relmse"]),
            ("rays", &["closest", "occluded", "per_second"]),
            ("memory", &["budget", "peak_accounted", "peak_rss", "unaccounted", "timeline"]),
        ] {
            for key in keys {
                let pointer = if object.is_empty() { format!("/{key}") } else { format!("/{object}/{key}") };
                assert!(json.pointer(&pointer).is_some(), "{pointer} is missing");
            }
        }
        let sparse: RenderStats =
            serde_json::from_str(r#"{"scene": "a.pbrt", "new": 1}"#).expect("of another version");
        assert_eq!(sparse.scene, "a.pbrt");
    }
}
