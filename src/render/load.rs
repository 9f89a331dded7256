//! Reads what a scene names, in parallel: meshes, textures, sky images.
//!
//! Invariant: texels beside those of sky images stay within the memory that the settings give them.
//! Never builds what is traced.

use super::stream::workers;
use super::{Control, Progress};
use crate::error::{Error, Result};
use crate::geometry::pages::{DEFAULT_PAGE_BYTES, LEAST_PAGE_BYTES, MOST_PAGE_BYTES};
use crate::geometry::{self, Opacity, Paging, SceneGeometry};
use crate::integrator::light::env::EnvironmentMap;
use crate::integrator::lights_build::load_environments;
use crate::prepare;
use crate::scene::{SceneDescription, TextureId};
use crate::settings::{RenderSettings, Schedule};
use crate::stats;
use crate::texture::convert::Watch;
use crate::texture::{Caching, TextureCoordinates, TextureOptions, TextureStore, Textures};
use glam::{Vec2, Vec3};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Geometry with the masks of its surfaces, textures, and the images of lights.
pub(super) fn load(
    scene: &SceneDescription,
    settings: &RenderSettings,
    threads: usize,
    control: &Control<'_>,
) -> Result<(SceneGeometry, Arc<Textures>, Vec<EnvironmentMap>)> {
    let needs = prepare::image_needs(scene);
    let threads = looking_up(settings, threads);
    let options = TextureOptions {
        budget: settings.texture_memory.unwrap_or_else(default_texture_memory),
        threads,
        cache_dir: settings.cache_dir.clone(),
        latency: Duration::from_secs_f64(settings.texture_latency_seconds.max(0.0)),
        caching: Caching::Borrow,
    };
    let paging = settings.geometry_memory.map(|budget| Paging {
        budget,
        page_bytes: page_bytes(settings),
        cache_dir: settings.cache_dir.clone(),
    });
    let converting = |done, total| (control.progress)(Progress::Converting { done, total });
    let watch = Watch { cancel: control.cancel, progress: &converting };
    let (geometry, (store, environments)) = rayon::join(
        || geometry::load(scene, paging.as_ref(), &|| control.cancel.load(Ordering::Relaxed)),
        || {
            rayon::join(
                || TextureStore::load(&scene.images, &needs, &options, watch),
                || load_environments(scene),
            )
        },
    );
    let textures = Arc::new(Textures::new(scene.textures.clone(), store?, settings.texture_filter)?);
    let mut geometry = geometry?;
    if geometry.surfaces.iter().any(|s| s.alpha.is_some()) {
        geometry.opacity = Some(Box::new(TextureOpacity(Arc::clone(&textures))));
    }
    Ok((geometry, textures, environments?))
}

/// Threads that look up at the same time, at most.
fn looking_up(settings: &RenderSettings, threads: usize) -> usize {
    let waits =
        settings.geometry_memory.is_some() || matches!(settings.schedule, Schedule::Sorted | Schedule::Voxel);
    if waits { workers(threads) } else { threads }
}

/// Whole blocks of 4 KiB, as direct reads take them.
fn page_bytes(settings: &RenderSettings) -> usize {
    let asked = settings.page_bytes.unwrap_or(DEFAULT_PAGE_BYTES);
    asked.next_multiple_of(LEAST_PAGE_BYTES).clamp(LEAST_PAGE_BYTES, MOST_PAGE_BYTES)
}

/// Gives pages what is left of the memory for geometry when what stays has been put in its place.
pub(super) fn open_pages(
    geometry: &SceneGeometry,
    staying: u64,
    settings: &RenderSettings,
    threads: usize,
) -> Result<()> {
    let Some(budget) = settings.geometry_memory else { return Ok(()) };
    let (computing, threads) = (threads, looking_up(settings, threads));
    let readers = match threads - computing {
        0 => String::new(),
        n => format!(" ({n} of them wait for disks)"),
    };
    let least = geometry.pages.as_ref().map_or(0, |pages| pages.least(threads));
    let Some(left) = budget.checked_sub(staying).filter(|&left| left >= least) else {
        let needed = staying + least;
        return Err(Error::Usage(format!(
            "a geometry memory of {budget} bytes is too small: --geometry-memory {needed} would do; {staying} bytes \
             stay (small, shining and masked shapes, and what finds pages), and {threads} threads{readers} need two pages each"
        )));
    };
    geometry.pages.as_ref().map_or(Ok(()), |pages| pages.open(left, threads))
}

/// Half of what is free: the other half is for geometry, and for what nobody counts.
fn default_texture_memory() -> u64 {
    stats::available_memory_bytes().map_or(1 << 30, |free| free / 2)
}

/// Opacity by texture, for alpha masks.
struct TextureOpacity(Arc<Textures>);

impl Opacity for TextureOpacity {
    fn opacity(&self, texture: TextureId, uv: Vec2, p: Vec3) -> f32 {
        self.0.eval(texture, &TextureCoordinates::at(uv, p, Vec3::ZERO)).x
    }
}
