//! A scene made ready for paths: what is loaded, and the world that paths meet. Shared by all that trace the
//! paths of a scene, so that they trace the same.
//!
//! Invariant: owns what a [`World`] borrows, but for the acceleration structures.
//! Never builds one, nor traces.

use super::Control;
use super::load::load;
use super::plan::Planned;
use super::rounds::samples_asked;
use crate::accel::{Accel, Builder, NONE};
use crate::error::{Error, Result};
use crate::geometry::{self, Needs, SceneGeometry, Surface, SurfaceShape, Surfaces};
use crate::integrator::camera::Camera;
use crate::integrator::light::env::EnvironmentMap;
use crate::integrator::lights::Lights;
use crate::integrator::materials::{MaterialTables, Materials};
use crate::integrator::path::{SurfaceShading, World};
use crate::prepare::{Calls, RenderPlan, forced};
use crate::scene::{Film, SceneDescription};
use crate::settings::{Estimator, RenderSettings};
use crate::stats;
use crate::texture::Textures;
use std::sync::Arc;

/// Geometry, textures and tables of a scene.
pub(crate) struct Stage {
    /// Shapes.
    pub(crate) geometry: SceneGeometry,
    /// Textures.
    pub(crate) textures: Arc<Textures>,
    tables: MaterialTables,
}

/// Threads that load, build and trace, and how many.
pub(crate) fn pool(settings: &RenderSettings) -> Result<(rayon::ThreadPool, usize)> {
    let threads = threads_of(settings);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Error::Resource(format!("cannot start {threads} threads: {e}")))?;
    Ok((pool, threads))
}

/// Threads that compute.
pub(crate) fn threads_of(settings: &RenderSettings) -> usize {
    let all = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    settings.threads.unwrap_or_else(all).max(1)
}

impl Stage {
    /// Plans a render of `scene` into `film` and loads what it names, on the current pool; the images of lights go to
    /// [`Lights::new`].
    pub(crate) fn load(
        scene: &SceneDescription,
        film: &Film,
        settings: &RenderSettings,
        threads: usize,
        control: &Control<'_>,
    ) -> Result<(Self, Vec<EnvironmentMap>, RenderPlan)> {
        let planned = Planned::new(scene, film, settings, threads)?;
        let plan = planned.plan.clone();
        let (geometry, textures, environments) = load(scene, settings, planned, threads, control)?;
        let tables = MaterialTables::new(scene, &textures);
        Ok((Self { geometry, textures, tables }, environments, plan))
    }

    /// What paths meet: traversal by `accel`, of everything and of emitters alone.
    pub(crate) fn world<'a, A: Accel + ?Sized>(
        &'a self,
        scene: &'a SceneDescription,
        settings: &RenderSettings,
        film_size: (u32, u32),
        mut lights: Lights,
        (accel, emitters_only): (&'a A, Option<&'a A>),
    ) -> World<'a, A> {
        let materials = Materials::new(scene, &self.textures, &self.tables);
        let forced = forced(&settings.force_effects);
        let found = self.calls(scene, &materials, &lights);
        let calls = found.and(forced);
        let mut shading = shading(&self.geometry, &materials, &lights);
        if forced.has(Calls::TEXTURES) {
            shading.iter_mut().for_each(|s| s.needs = s.needs.and(Needs::UV));
        }
        if forced.has(Calls::LIGHTS) {
            lights.always_choose();
        }
        let mut world = World {
            estimator: settings.estimator,
            samples_lights: false,
            accel,
            emitters_only,
            geometry: Surfaces::new(&self.geometry, |s| shading[s].needs),
            has_interfaces: calls.has(Calls::MEDIA),
            calls,
            shading,
            materials,
            lights,
            media: scene.media.clone(),
            camera_medium: scene.camera_medium,
            camera: Camera::new(&scene.camera, film_size),
            max_depth: 0,
            rr_threshold: 0.0,
            footprint_scale: 1.0,
        };
        Self::configure(&mut world, scene, settings, film_size);
        world
    }

    /// What the scene, as it was loaded, calls for.
    fn calls(&self, scene: &SceneDescription, materials: &Materials<'_>, lights: &Lights) -> Calls {
        let SceneGeometry { surfaces, instances, .. } = &self.geometry;
        let of_surface = |s: &Surface| {
            materials
                .calls(s.material.0)
                .and_if(s.medium.is_some(), Calls::MEDIA)
                .and_if(!matches!(s.shape, SurfaceShape::Mesh(_)), Calls::SHAPES)
        };
        surfaces
            .iter()
            .fold(lights.calls(), |calls, s| calls.and(of_surface(s)))
            .and_if(!instances.is_empty(), Calls::INSTANCES)
            .and_if(scene.camera_medium.is_some(), Calls::MEDIA)
            .and_if(scene.camera.lens_radius > 0.0, Calls::LENS)
    }

    /// Makes of `world` what it is under other `settings`, of which those that belong to loading are not looked at.
    pub(crate) fn configure<A: Accel + ?Sized>(
        world: &mut World<'_, A>,
        scene: &SceneDescription,
        settings: &RenderSettings,
        film_size: (u32, u32),
    ) {
        let spp = settings.footprint_spp.unwrap_or_else(|| samples_asked(scene, settings)).max(1);
        let roulette = settings.roulette.unwrap_or(true);
        world.estimator = settings.estimator;
        world.samples_lights = world.lights.can_be_sampled() && settings.estimator != Estimator::Scattering;
        world.camera = Camera::new(&scene.camera, film_size);
        world.max_depth = settings.max_depth.unwrap_or(scene.integrator.max_depth);
        world.rr_threshold = if roulette { scene.integrator.rr_threshold } else { 0.0 };
        world.footprint_scale = (1.0 / (spp as f32).sqrt()).max(0.125);
    }
}

/// The scene's film with what the command line overrides.
pub(crate) fn effective_film(scene: &SceneDescription, settings: &RenderSettings) -> Result<Film> {
    let mut film = scene.film.clone();
    if let Some(size) = settings.size {
        // The scene's crop keeps its place in the frame.
        let scaled =
            |c: u32, from: u32, to: u32| (u64::from(c) * u64::from(to) / u64::from(from.max(1))) as u32;
        let [x0, y0, x1, y1] = film.crop;
        film.crop = [
            scaled(x0, film.size.0, size.0),
            scaled(y0, film.size.1, size.1),
            scaled(x1, film.size.0, size.0),
            scaled(y1, film.size.1, size.1),
        ];
        film.size = size;
    }
    if let Some(crop) = settings.crop {
        film.crop = crop;
    }
    let [x0, y0, x1, y1] = film.crop;
    if x0 >= x1 || y0 >= y1 || x1 > film.size.0 || y1 > film.size.1 {
        return Err(Error::Usage(format!(
            "crop {x0},{y0},{x1},{y1} is empty or leaves the film of {}x{}; give x0,y0,x1,y1 in pixels, x1 and y1 exclusive",
            film.size.0, film.size.1
        )));
    }
    // The sums, the finished image and one encoded copy.
    let bytes = u64::from(x1 - x0) * u64::from(y1 - y0) * (16 + 12 + 12);
    if stats::available_memory_bytes().is_some_and(|free| bytes > free) {
        return Err(Error::Resource(format!(
            "a film of {}x{} pixels takes {bytes} bytes, more than the memory that is free; render a crop of it",
            x1 - x0,
            y1 - y0
        )));
    }
    Ok(film)
}

/// A scene of the emitting surfaces alone, for the last ray of a path; `None` where nothing emits.
pub(crate) fn emitters_only<'g>(
    builder: &Builder,
    geometry: &'g SceneGeometry,
    lights: &Lights,
) -> Result<Option<Box<dyn Accel + 'g>>> {
    if lights.emitters.is_empty() {
        return Ok(None);
    }
    let emitting = geometry.describe_emitters();
    builder.build(&emitting, &[], &[], geometry, None).map(Some)
}

fn shading(geometry: &SceneGeometry, materials: &Materials<'_>, lights: &Lights) -> Vec<SurfaceShading> {
    let mut list: Vec<SurfaceShading> = geometry
        .surfaces
        .iter()
        .map(|s| SurfaceShading {
            material: s.material.0,
            emitter: NONE,
            needs: materials.needs(s.material.0),
            may_pass: materials.may_pass(s.material.0),
            medium: s.medium,
        })
        .collect();
    for (i, emitter) in lights.emitters.iter().enumerate() {
        let s = &mut list[emitter.surface as usize];
        s.emitter = u32::try_from(i).expect("emitters are counted in u32");
        if emitter.image.is_some() {
            s.needs = s.needs.and(geometry::Needs::UV);
        }
    }
    list
}
