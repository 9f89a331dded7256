//! Settings in force during a render, as the record has them.
//!
//! Invariant: plain data; what the scene says and defaults included. Never decides.

use serde::{Deserialize, Serialize};

/// Settings in force during a render.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct EffectiveSettings {
    /// Which library traversed.
    pub backend: String,
    /// Samples per pixel asked for.
    pub spp: u32,
    /// Seed.
    pub seed: u64,
    /// Scattering events.
    pub max_depth: u32,
    /// Where random numbers came from.
    pub sampler: String,
    /// How direct light was estimated.
    pub estimator: String,
    /// Russian roulette.
    pub roulette: bool,
    /// Embree's robust mode.
    pub robust: bool,
    /// Warnings were errors.
    pub strict: bool,
    /// Limit on the rendering time.
    pub time_limit_s: Option<f64>,
    /// Relative error at which regions stop; `None` when none was asked for.
    pub noise: Option<f64>,
    /// Crop window x0, y0, x1, y1 (exclusive) in the full frame.
    pub crop: [u32; 4],
    /// Full frame.
    pub full_size: [u32; 2],
    /// Bytes of everything together that were asked to be in memory at most; `None` when nothing was asked.
    pub memory: Option<u64>,
    /// Bytes of textures that were asked to be in memory at most; `None` when nothing was asked.
    pub texture_memory: Option<u64>,
    /// Bytes of geometry that were asked to be in memory at most; `None` when nothing was asked.
    pub geometry_memory: Option<u64>,
    /// Filter of all image textures; `None` where each had the scene's.
    pub texture_filter: Option<String>,
    /// Samples per pixel that texture footprints were for.
    pub footprint_spp: u32,
    /// Pixels of an edge of what is displaced, at most.
    pub tessellation: f32,
    /// Least time that a read of a texture tile took.
    pub texture_latency_s: f64,
}
