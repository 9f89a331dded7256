//! What is known of a render before anything is loaded: headers are read, and `prepare` is asked.
//!
//! Invariant: a header is read once for `weir plan` and once for a render; the plan is the same for both.
//! Never loads vertices or texels.

use super::stage::{effective_film, threads_of};
use super::stream::{DEFAULT_RAY_MEMORY, check_rays, least_ray_memory, spills, workers};
use crate::error::Result;
use crate::geometry::made::{DEFAULT_EDGE_PIXELS, View, curve_counts};
use crate::geometry::pages::{
    DEFAULT_PAGE_BYTES, LEAST_PAGE_BYTES, MOST_PAGE_BYTES, check_page_budget, least_page_budget,
};
use crate::integrator::light::env::EnvironmentMap;
use crate::prepare::{self, Headers, ImageNeeds, Least, RenderPlan};
use crate::scene::ply::{MeshFacts, survey};
use crate::scene::{Film, Light, MeshSource, SceneDescription};
use crate::settings::{RenderSettings, Schedule};
use crate::stats::{self, PlanStats};
use crate::texture::{Caching, Survey, image_size};
use rayon::prelude::*;

/// A plan, and what was found on the way to it.
pub(crate) struct Planned {
    pub(crate) plan: RenderPlan,
    pub(crate) needs: Vec<ImageNeeds>,
    pub(crate) images: Survey,
    pub(crate) view: View,
}

impl Planned {
    /// Looks at what `scene` names and plans its render into `film`, on the current pool. A mesh that cannot be read
    /// counts as nothing: whoever loads it says what is wrong.
    pub(crate) fn new(
        scene: &SceneDescription,
        film: &Film,
        settings: &RenderSettings,
        threads: usize,
    ) -> Result<Self> {
        let meshes = scene.meshes.par_iter().map(|mesh| mesh_header(mesh).unwrap_or_default()).collect();
        Self::of(scene, film, settings, threads, meshes)
    }

    fn of(
        scene: &SceneDescription,
        film: &Film,
        settings: &RenderSettings,
        threads: usize,
        mut meshes: Vec<MeshFacts>,
    ) -> Result<Self> {
        let edge_pixels = settings.tessellation.unwrap_or(DEFAULT_EDGE_PIXELS);
        let view = View::new(&scene.camera, film.size, edge_pixels);
        let pixels = f64::from(film.size.0) * f64::from(film.size.1);
        for (i, count) in curve_counts(scene, &view).into_iter().enumerate() {
            if let Some((vertices, triangles)) = count {
                meshes[i] = MeshFacts { vertices, vertex_bytes: 32, triangles, exact: true };
            } else if matches!(scene.meshes[i], MeshSource::Displaced { .. }) {
                meshes[i] =
                    prepare::displaced_facts(&scene.meshes[i], &meshes[i], pixels, f64::from(edge_pixels));
            }
        }
        let needs = prepare::image_needs(scene);
        let images = Survey::new(&scene.images, &needs, Caching::Borrow)?;
        let headers = Headers {
            meshes,
            textures: images.all_bytes(),
            tiled_files: images.has_tiled_files(),
            environments: environments(scene),
        };
        let spills = spills(settings);
        let limits = Limits { page_bytes: page_bytes(settings), threads, spills, images: &images };
        let plan = prepare::plan(scene, film, &headers, &limits, settings)?;
        Ok(Self { plan, needs, images, view })
    }
}

/// What a render of `scene` with `settings` would be, and why; reads headers and no more.
///
/// # Errors
/// A mesh or an image whose header cannot be read; a memory that is too small; a crop outside the film. Memory that is seen
/// to be too small only when something has been loaded is no error here.
pub fn plan(scene: &SceneDescription, settings: &RenderSettings) -> Result<PlanStats> {
    let threads = threads_of(settings);
    let film = effective_film(scene, settings)?;
    let meshes: Vec<Result<MeshFacts>> = scene.meshes.par_iter().map(mesh_header).collect();
    let meshes = meshes.into_iter().collect::<Result<_>>()?;
    let Planned { plan, images, .. } = Planned::of(scene, &film, settings, threads, meshes)?;
    // Where a render says the same before it makes anything.
    images.check(plan.texture_memory, looking_up(&plan, threads))?;
    // Of triangles that are guessed nobody knows what comes and goes.
    let sure = plan.geometry.exact;
    if let (true, Some(budget)) = (sure && plan.pages && plan.stats.bytes.pages > 0, plan.geometry_memory) {
        check_page_budget(budget, page_bytes(settings), looking_up(&plan, threads))?;
    }
    if plan.schedule != Schedule::Depth && (sure || settings.schedule == plan.schedule) {
        check_rays(plan.ray_memory, threads, settings)?;
    }
    Ok(plan.stats)
}

fn mesh_header(mesh: &MeshSource) -> Result<MeshFacts> {
    match mesh {
        MeshSource::Ply(path) => survey(path),
        MeshSource::Displaced { base, .. } => mesh_header(base),
        MeshSource::Inline(_) | MeshSource::Subdivision { .. } | MeshSource::Curves(_) => {
            Ok(MeshFacts::default())
        }
    }
}

/// Bytes of images of lights at infinity.
fn environments(scene: &SceneDescription) -> u64 {
    let bytes = |light: &Light| {
        let Light::Image { image, .. } = light else { return 0 };
        let (w, h) = image_size(&scene.images[image.index()].path).unwrap_or_default();
        EnvironmentMap::bytes_for(w.into(), h.into())
    };
    scene.lights.iter().map(bytes).sum()
}

struct Limits<'a> {
    page_bytes: usize,
    threads: usize,
    spills: bool,
    images: &'a Survey,
}

impl Limits<'_> {
    fn looking(&self, reading: bool) -> usize {
        if reading { workers(self.threads) } else { self.threads }
    }
}

impl Least for Limits<'_> {
    fn page_bytes(&self) -> u64 {
        self.page_bytes as u64
    }

    fn pages(&self, reading: bool) -> u64 {
        least_page_budget(self.page_bytes, self.looking(reading))
    }

    fn textures(&self, reading: bool) -> u64 {
        self.images.least_bytes(self.looking(reading))
    }

    fn rays(&self) -> u64 {
        least_ray_memory(self.threads, self.spills)
    }

    fn usual_rays(&self) -> u64 {
        DEFAULT_RAY_MEMORY
    }

    /// Half of what is free: the other half is for geometry, and for what nobody counts.
    fn usual_textures(&self) -> u64 {
        stats::available_memory_bytes().map_or(1 << 30, |free| free / 2)
    }
}

/// Whole blocks of 4 KiB, as direct reads take them.
pub(super) fn page_bytes(settings: &RenderSettings) -> usize {
    let asked = settings.page_bytes.unwrap_or(DEFAULT_PAGE_BYTES);
    asked.next_multiple_of(LEAST_PAGE_BYTES).clamp(LEAST_PAGE_BYTES, MOST_PAGE_BYTES)
}

/// Threads that look up at the same time, at most: where pages come and go, some that read. Where triangles are guessed, and
/// there is a bound on them, they may yet.
pub(super) fn looking_up(plan: &RenderPlan, threads: usize) -> usize {
    let may = plan.pages || (plan.geometry_memory.is_some() && !plan.geometry.exact);
    if plan.schedule != Schedule::Depth || may { workers(threads) } else { threads }
}
