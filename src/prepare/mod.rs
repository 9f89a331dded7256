//! The description in, the plan out: what a scene calls for, what it takes, and so how it is rendered.
//!
//! Invariant: one plan for `weir plan` and for a render; it follows from the description, from what headers say
//! ([`Headers`]) and from the settings alone.
//! Never opens a file, loads anything or decides a sampling.

mod bytes;
mod divide;
mod effects;
mod images;
mod kernel;
mod schedule;
mod textures;

pub use bytes::{
    GeometryBytes, LEAST_PAGED, MOST_FACES_AT_A_VERTEX, STAYING_TRIANGLE, are_worth_pages, description_bytes,
    displaced_facts, film_bytes, geometry_bytes, has_to_stay, light_bytes,
};
pub use divide::{Division, Least, divide};
pub use effects::{EFFECTS, calls, effects};
pub use images::{ImageNeeds, image_needs};
pub use kernel::{Calls, KernelName, calls_named, forced, kernel_for};
pub use schedule::{Store, choose};
pub use textures::{KnownTexture, known_textures, mix};

use crate::error::Result;
use crate::scene::ply::MeshFacts;
use crate::scene::{Film, Material, SceneDescription, Shape};
use crate::settings::{Backend, RenderSettings, Schedule};
use crate::stats::{PlanBytes, PlanMemory, PlanStats};

/// What headers say of the files that a scene names.
#[derive(Clone, Debug, Default)]
pub struct Headers {
    /// Of each mesh of the description that is a file; nothing of others.
    pub meshes: Vec<MeshFacts>,
    /// Bytes of all levels of all images that textures read.
    pub textures: u64,
    /// Whether some of them are tiled files, which are never in memory as a whole.
    pub tiled_files: bool,
    /// Bytes of the images of lights at infinity, as they are kept.
    pub environments: u64,
}

/// How a scene is to be rendered, and why.
#[derive(Clone, Debug)]
pub struct RenderPlan {
    /// As it is told.
    pub stats: PlanStats,
    /// Which rays run next; never [`Schedule::Auto`].
    pub schedule: Schedule,
    /// What traverses.
    pub backend: Backend,
    /// Bytes of geometry; `None` where nothing bounds it.
    pub geometry_memory: Option<u64>,
    /// Whether large meshes come and go.
    pub pages: bool,
    /// Bytes of textures.
    pub texture_memory: u64,
    /// Bytes of rays that wait.
    pub ray_memory: u64,
    /// What is expected of geometry.
    pub geometry: GeometryBytes,
}

/// Meshes are cut in so much at least: some pages of several threads.
const LEAST_CUT: u64 = 8 << 20;
/// And in so much at most, or a quarter of what geometry may take.
const MOST_CUT: u64 = 32 << 20;

impl RenderPlan {
    /// Bytes that meshes are cut into pages in, where there is a bound on all: what pages and rays take afterwards.
    #[must_use]
    pub fn cut_in(&self) -> Option<u64> {
        let memory = self.stats.memory.budget?;
        let PlanBytes { film, lights, description, .. } = self.stats.bytes;
        let there = film + lights + description + self.geometry.staying + self.texture_memory;
        let most = (self.geometry_memory.unwrap_or(0) / 4).max(MOST_CUT);
        Some(memory.saturating_sub(there).clamp(LEAST_CUT, most))
    }

    /// Bytes of tables that stand beside the rays that wait; those beyond go off the rays. Without a bound on all
    /// nothing does.
    #[must_use]
    pub fn table_room(&self) -> u64 {
        if self.stats.memory.budget.is_some() { self.stats.memory.tables } else { u64::MAX }
    }
}

/// Plans the render of `scene` into `film` with `settings`.
///
/// # Errors
/// [`Error::Usage`](crate::error::Error::Usage) where [`RenderSettings::memory`] is too small: with the number that
/// would do.
pub fn plan(
    scene: &SceneDescription,
    film: &Film,
    headers: &Headers,
    least: &dyn Least,
    settings: &RenderSettings,
) -> Result<RenderPlan> {
    let bytes = |backend| geometry_bytes(scene, &headers.meshes, backend, least.page_bytes());
    let shining = bytes(settings.backend).shining;
    let lights = light_bytes(scene, headers.environments, shining);
    let fixed = [film_bytes(film, settings), lights, description_bytes(scene)];
    let division = divide(settings, fixed, headers.textures, &bytes, least)?;
    let geometry = bytes(division.backend);
    let pages = division.pages && geometry.pages > 0;
    let store = if pages {
        let room = division.geometry.unwrap_or(u64::MAX).saturating_sub(geometry.staying);
        Store::Pages { bytes: geometry.pages, room }
    } else {
        Store::Resident
    };
    let (schedule, because) = choose(settings, store);
    let whole_textures = headers.textures <= division.textures && !headers.tiled_files;
    let [film, lights, description] = fixed;
    let calls = calls(scene, pages).and(forced(&settings.force_effects));
    let stats = PlanStats {
        kernel: kernel_for(calls).name().to_owned(),
        calls: calls_named(calls),
        effects: effects(scene),
        schedule: schedule.name().to_owned(),
        because,
        backend: division.backend.name().to_owned(),
        bytes: PlanBytes {
            geometry: geometry.whole,
            textures: headers.textures,
            film,
            lights,
            description,
            building: geometry.building,
            pages: geometry.pages,
            primitives: geometry.primitives,
        },
        memory: PlanMemory {
            budget: settings.memory,
            geometry: division.geometry,
            geometry_store: if pages { "pages" } else { "resident" }.to_owned(),
            textures: division.textures,
            texture_store: if whole_textures { "whole" } else { "tiles" }.to_owned(),
            rays: if schedule == Schedule::Depth { 0 } else { division.rays },
            tables: division.tables,
            balanced: division.balanced && pages && !whole_textures && headers.textures > 0,
            because: division.because,
        },
    };
    Ok(RenderPlan {
        stats,
        schedule,
        backend: division.backend,
        geometry_memory: division.geometry,
        pages,
        texture_memory: division.textures,
        ray_memory: division.rays,
        geometry,
    })
}

/// Shapes of the world and of its objects.
pub(crate) fn all_shapes(scene: &SceneDescription) -> impl Iterator<Item = &Shape> {
    scene.shapes.iter().chain(scene.objects.iter().flatten())
}

/// Whether a ray has to stop at `shape`: an interface without emission neither scatters nor emits, and matters only
/// where it separates media.
#[must_use]
pub fn is_visible(scene: &SceneDescription, shape: &Shape) -> bool {
    !matches!(scene.materials[shape.material.index()], Material::Interface)
        || shape.area_light.is_some()
        || shape.medium.is_some()
}

#[cfg(test)]
mod tests;
