//! What a scene calls for, as `weir plan --json` prints it and `--stats` writes it.
//!
//! Invariant: plain data; one render and one `weir plan` of the same scene and options have the same. Never decides.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What the scene calls for, and what a render chooses.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct PlanStats {
    /// Each effect that a scene may call for, by name.
    pub effects: BTreeMap<String, EffectStats>,
    /// The code that paths run through, by name.
    pub kernel: String,
    /// What it has to have.
    pub calls: String,
    /// `depth`, `sorted` or `voxel`.
    pub schedule: String,
    /// Why that one.
    pub because: String,
    /// `embree` or `native`.
    pub backend: String,
    /// Bytes were everything resident.
    pub bytes: PlanBytes,
    /// What each part of a render may take.
    pub memory: PlanMemory,
}

/// Whether a scene calls for an effect.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct EffectStats {
    /// It is simulated.
    pub on: bool,
    /// Who asks for it, or why it is off.
    pub because: String,
}

/// Bytes were everything resident, by what headers and the scene file say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct PlanBytes {
    /// Vertices, attributes and acceleration structures.
    pub geometry: u64,
    /// Textures, all levels, decoded.
    pub textures: u64,
    /// The film's sums, and the finished image.
    pub film: u64,
    /// Images of lights at infinity, and what chooses among lights.
    pub lights: u64,
    /// The scene's own tables, with the meshes that stand in its file.
    pub description: u64,
    /// Beside the rest while acceleration structures of all geometry are built.
    pub building: u64,
    /// Geometry as pages, where it would come and go.
    pub pages: u64,
    /// Triangles and other primitives, instances not multiplied.
    pub primitives: u64,
}

/// What each part may take.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct PlanMemory {
    /// All together (`--memory`); `None` when there is no bound.
    pub budget: Option<u64>,
    /// Geometry and its acceleration structures; `None` when there is no bound.
    pub geometry: Option<u64>,
    /// `resident` or `pages`.
    pub geometry_store: String,
    /// Textures.
    pub textures: u64,
    /// `whole` or `tiles`.
    pub texture_store: String,
    /// Rays that wait; 0 where none does.
    pub rays: u64,
    /// Tables of what waits and of what comes and goes; 0 without a bound on all.
    pub tables: u64,
    /// Geometry and textures give each other of theirs while rendering, by what each reads again.
    pub balanced: bool,
    /// How it was divided.
    pub because: String,
}
