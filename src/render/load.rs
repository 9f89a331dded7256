//! Reads what a scene names, in parallel: meshes, textures, sky images.
//!
//! Invariant: texels beside those of sky images stay within the memory that the settings give them.
//! Never builds what is traced.

use super::plan::{Planned, looking_up, page_bytes};
use super::{Control, Progress};
use crate::error::{Error, Result};
use crate::geometry::made::{Making, wants_textures};
use crate::geometry::{self, Opacity, Paging, SceneGeometry};
use crate::integrator::light::env::EnvironmentMap;
use crate::integrator::lights_build::load_environments;
use crate::prepare::RenderPlan;
use crate::scene::{SceneDescription, TextureId};
use crate::settings::RenderSettings;
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
    planned: Planned,
    threads: usize,
    control: &Control<'_>,
) -> Result<(SceneGeometry, Arc<Textures>, Vec<EnvironmentMap>)> {
    let Planned { plan, needs, images, view } = planned;
    let options = TextureOptions {
        budget: plan.texture_memory,
        threads: looking_up(&plan, threads),
        cache_dir: settings.cache_dir.clone(),
        latency: Duration::from_secs_f64(settings.texture_latency_seconds.max(0.0)),
        caching: Caching::Borrow,
    };
    let paging = plan.geometry_memory.filter(|_| plan.pages || !plan.geometry.exact).map(|budget| Paging {
        budget,
        cut_in: plan.cut_in(),
        whole: (!plan.pages).then_some(plan.geometry.primitives),
        threads: looking_up(&plan, threads),
        page_bytes: page_bytes(settings),
        cache_dir: settings.cache_dir.clone(),
    });
    let converting = |done, total| (control.progress)(Progress::Converting { done, total });
    let watch = Watch { cancel: control.cancel, progress: &converting };
    let shapes = |textures: Option<&Arc<Textures>>| {
        let making = Making::new(&view, textures, plan.geometry_memory);
        geometry::load(scene, paging.as_ref(), &making, &|| control.cancel.load(Ordering::Relaxed))
    };
    let images = || -> Result<(Arc<Textures>, Vec<EnvironmentMap>)> {
        let (store, environments) = rayon::join(
            || TextureStore::load_found(images, &scene.images, &needs, &options, watch),
            || load_environments(scene),
        );
        let textures = Textures::new(scene.textures.clone(), store?, settings.texture_filter)?;
        Ok((Arc::new(textures), environments?))
    };
    let (mut geometry, (textures, environments)) = if wants_textures(scene) {
        let images = images()?;
        (shapes(Some(&images.0))?, images)
    } else {
        // What images say of themselves comes first, whoever was first.
        let (geometry, images) = rayon::join(|| shapes(None), images);
        let images = images?;
        (geometry?, images)
    };
    if geometry.surfaces.iter().any(|s| s.alpha.is_some()) {
        geometry.opacity = Some(Box::new(TextureOpacity(Arc::clone(&textures))));
    }
    Ok((geometry, textures, environments))
}

/// Gives pages what is left of the memory for geometry when what stays has been put in its place.
pub(super) fn open_pages(
    geometry: &SceneGeometry,
    staying: u64,
    settings: &RenderSettings,
    plan: &RenderPlan,
    threads: usize,
) -> Result<()> {
    let Some(budget) = plan.geometry_memory else { return Ok(()) };
    let (computing, threads) = (threads, looking_up(plan, threads));
    let readers = match threads - computing {
        0 => String::new(),
        n => format!(" ({n} of them wait for disks)"),
    };
    let least = geometry.pages.as_ref().map_or(0, |pages| pages.least(threads));
    let Some(left) = budget.checked_sub(staying).filter(|&left| left >= least) else {
        let needed = staying + least;
        let (name, given, would_do) = match (settings.geometry_memory, settings.memory) {
            // An eighth of what is added goes to rays.
            (None, Some(all)) => ("--memory", all, all + (needed - budget) * 8 / 7 + 1),
            _ => ("--geometry-memory", budget, needed),
        };
        let what = name.trim_start_matches("--").replace('-', " ");
        return Err(Error::Usage(format!(
            "a {what} of {given} bytes is too small: {name} {would_do} would do; {staying} bytes \
             stay (small, shining and masked shapes, and what finds pages), and {threads} threads{readers} need two pages each"
        )));
    };
    geometry.pages.as_ref().map_or(Ok(()), |pages| pages.open(left, threads))
}

/// Opacity by texture, for alpha masks.
struct TextureOpacity(Arc<Textures>);

impl Opacity for TextureOpacity {
    fn opacity(&self, texture: TextureId, uv: Vec2, p: Vec3) -> f32 {
        self.0.eval(texture, &TextureCoordinates::at(uv, p, Vec3::ZERO)).x
    }
}
