//! Renders one frame: load, build, trace, write down what it cost.
//!
//! Invariant: what is timed as one phase has ended before the next begins.
//! Never traces a ray itself.

use super::job::{Job, Order};
use super::load::{load, open_pages};
use super::{Control, Outcome, Progress};
use crate::accel::{Accel, Builder, NONE, Pages};
use crate::error::{Error, Result};
use crate::film::{FilmBuffer, FilterSampler, Image};
use crate::geometry::pages::PageStore;
use crate::geometry::{self, Needs, SceneGeometry, Surfaces};
use crate::integrator::camera::Camera;
use crate::integrator::lights::Lights;
use crate::integrator::materials::{MaterialTables, Materials};
use crate::integrator::path::{SurfaceShading, World};
use crate::scene::{Film, SceneDescription};
use crate::settings::{Estimator, RenderSettings};
use crate::stats::{self, RenderStats};
use glam::{Mat3, Vec3};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

/// See [`super::render`].
pub(super) fn render(
    scene: &SceneDescription,
    settings: &RenderSettings,
    control: &Control<'_>,
) -> Result<Outcome> {
    let threads = settings
        .threads
        .unwrap_or_else(|| std::thread::available_parallelism().map_or(1, std::num::NonZero::get))
        .max(1);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Error::Resource(format!("cannot start {threads} threads: {e}")))?;
    let film = effective_film(scene, settings)?;
    let mut stats = RenderStats::default();
    let start = Instant::now();

    (control.progress)(Progress::Phase("loading"));
    let (geometry, textures, environments) = pool.install(|| load(scene, settings, threads, control))?;
    let tables = pool.install(|| MaterialTables::new(scene, &textures));
    stats.time.prepare_s = start.elapsed().as_secs_f64();

    (control.progress)(Progress::Phase("building"));
    let build_start = Instant::now();
    let builder = Builder::new(settings.backend, settings.robust, threads)?;
    let (world_geometry, objects, instances) = geometry.for_backend();
    let pages = geometry.pages.as_ref().map(|pages| pages as &dyn Pages);
    let accel = pool.install(|| builder.build(&world_geometry, &objects, &instances, &geometry, pages))?;
    stats.time.build_s = build_start.elapsed().as_secs_f64();
    let staying = geometry.bytes() + accel.bytes();
    open_pages(&geometry, staying, settings, threads)?;
    stats.plan.bytes.geometry = staying + geometry.pages.as_ref().map_or(0, PageStore::all_bytes);
    stats.plan.bytes.textures = textures.store().all_bytes();

    let materials = Materials::new(scene, &textures, &tables);
    let lights = Lights::new(scene, &geometry, &textures, environments);
    let emitters = emitters_only(&builder, &geometry, &lights)?;
    let shading = shading(&geometry, &materials, &lights);
    let spp = settings.spp.unwrap_or(scene.spp).max(1);
    let roulette = settings.roulette.unwrap_or(true);
    let samples_lights = lights.can_be_sampled() && settings.estimator != Estimator::Scattering;
    let world = World {
        estimator: settings.estimator,
        samples_lights,
        accel: &*accel,
        emitters_only: emitters.as_deref(),
        geometry: Surfaces::new(&geometry, |s| shading[s].needs),
        has_interfaces: shading.iter().any(|s| s.may_pass),
        wants_footprints: shading.iter().any(|s| s.needs.has(Needs::FOOTPRINT)),
        shading,
        materials,
        lights,
        media: scene.media.clone(),
        camera_medium: scene.camera_medium,
        camera: Camera::new(&scene.camera, film.size),
        max_depth: settings.max_depth.unwrap_or(scene.integrator.max_depth),
        rr_threshold: if roulette { scene.integrator.rr_threshold } else { 0.0 },
        footprint_scale: (1.0 / (spp as f32).sqrt()).max(0.125),
    };

    let buffer = FilmBuffer::new(film.crop);
    // Only where tiles may have to go and come again does the order of work cost anything.
    let reads_tiles =
        !textures.store().all_tiles_fit() || geometry.pages.as_ref().is_some_and(|pages| !pages.fits_all());
    let job = Job {
        world: &world,
        textures: textures.store(),
        pages: geometry.pages.as_ref(),
        film: &film,
        filter: FilterSampler::new(&scene.filter),
        spp,
        seed: settings.seed.unwrap_or(scene.seed),
        next: AtomicU64::new(0),
        order: if reads_tiles && settings.time_limit_seconds.is_none() {
            Order::Tiles
        } else {
            Order::Passes
        },
        along: buffer.along(),
        buffer,
        samples: AtomicU64::new(0),
        first_pixel: OnceLock::new(),
        stopped: AtomicBool::new(false),
        control,
        deadline: settings.time_limit_seconds,
        start: Instant::now(),
    };
    let counters = job.run(threads);
    let render_s = job.start.elapsed().as_secs_f64();

    let interrupted = job.stopped.load(Ordering::Relaxed);
    stats.time.render_s = render_s;
    stats.time.total_s = start.elapsed().as_secs_f64();
    stats.time.first_pixel_s =
        job.first_pixel.get().map_or(0.0, |t: &Instant| t.duration_since(start).as_secs_f64());
    stats.threads = threads;
    stats.weir = env!("CARGO_PKG_VERSION").into();
    stats.scene = scene.path.display().to_string();
    stats.interrupted = interrupted;
    let [x0, y0, x1, y1] = film.crop;
    stats.image.width = x1 - x0;
    stats.image.height = y1 - y0;
    stats.image.pixels_without_samples = job.buffer.untouched_pixels();
    stats.image.spp = (counters.samples / u64::from((x1 - x0) * (y1 - y0)).max(1)) as u32;
    stats.memory.peak_accounted =
        geometry.bytes() + accel.bytes() + textures.store().bytes() + job.buffer.bytes();
    stats.settings = stats::EffectiveSettings {
        backend: builder.name(),
        spp,
        seed: job.seed,
        max_depth: world.max_depth,
        roulette,
        robust: settings.robust,
        strict: settings.strict,
        time_limit_s: settings.time_limit_seconds,
        crop: film.crop,
        full_size: [film.size.0, film.size.1],
        texture_memory: settings.texture_memory,
        geometry_memory: settings.geometry_memory,
        texture_latency_s: settings.texture_latency_seconds,
    };
    stats.finish(&counters);
    let mut unreadable = Vec::new();
    if let Some((cache, names)) = textures.store().cache() {
        let cost = cache.stats(names);
        stats.time.stall_s = cost.total.stall_s;
        stats.texture_cache = Some(cost);
        stats.miss_ratio.texture = cache.miss_ratio_curve();
        unreadable = cache.failures();
    }
    if let Some(pages) = &geometry.pages {
        let (cost, curve, failures) = pages.stats();
        stats.time.stall_s += cost.total.stall_s;
        stats.memory.peak_accounted += cost.peak + cost.index_bytes;
        stats.geometry_cache = Some(cost);
        stats.miss_ratio.geometry = curve;
        unreadable.extend(failures);
    }
    let notes = textures.store().notes().to_vec();
    let mut image = Image::cropped(film.size, film.crop);
    image.pixels = job.buffer.resolve();
    balance(&mut image.pixels, &film);
    Ok(Outcome { image, stats, interrupted, notes, unreadable })
}

/// The scene's film with what the command line overrides.
fn effective_film(scene: &SceneDescription, settings: &RenderSettings) -> Result<Film> {
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
fn emitters_only<'g>(
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

/// The sensor's white balance, on the finished image: it is linear.
fn balance(pixels: &mut [[f32; 3]], film: &Film) {
    let m = Mat3::from_cols_array_2d(&film.white_balance).transpose();
    if m == Mat3::IDENTITY {
        return;
    }
    for p in pixels {
        *p = (m * Vec3::from(*p)).to_array();
    }
}
