//! Renders one frame: load, build, trace, write down what it cost.
//!
//! Invariant: what is timed as one phase has ended before the next begins.
//! Never traces a ray itself.

use super::balance::Balance;
use super::identity::{Found, identity};
use super::job::{Job, Order};
use super::keeper::{Keeper, take_up};
use super::load::open_pages;
use super::plan::looking_up;
use super::rounds::{Rounds, samples_asked};
use super::stage::{Stage, effective_film, emitters_only, pool};
use super::stream::{Queued, RayRoom, Waiting, check_rays};
use super::{Control, Outcome, Progress};
use crate::accel::{Accel, Builder, Pages};
use crate::error::{Error, Result};
use crate::film::{FilmBuffer, FilterSampler, Image, Keeps};
use crate::geometry::made::DEFAULT_EDGE_PIXELS;
use crate::geometry::pages::PageStore;
use crate::geometry::{Needs, SceneGeometry};
use crate::integrator::lights::Lights;
use crate::integrator::path::World;
use crate::prepare::{RenderPlan, Store, calls_named, choose};
use crate::scene::{Film, SceneDescription};
use crate::settings::{Backend, RenderSettings, Schedule};
use crate::stats::{self, AccountedBytes, RenderStats, SchedulerStats};
use glam::{Mat3, Vec3};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::Instant;

/// A scene that is loaded and built, to be rendered as often as one likes.
pub struct Frames<'a, 'c> {
    scene: &'a SceneDescription,
    stage: &'a Stage,
    builder: &'a Builder,
    world: World<'a, dyn Accel + 'a>,
    /// Bytes of geometry and acceleration structures that stay.
    staying: u64,
    /// What loading cost.
    loaded: RenderStats,
    /// What was planned, held to what came.
    plan: RenderPlan,
    threads: usize,
    start: Instant,
    control: &'a Control<'c>,
}

/// See [`super::render`].
pub(super) fn render(
    scene: &SceneDescription,
    settings: &RenderSettings,
    control: &Control<'_>,
) -> Result<Outcome> {
    with_frames(scene, settings, control, |frames| frames.render(settings))
}

/// Loads and builds `scene`, and calls `work` with what renders it.
///
/// # Errors
/// As [`super::render`], and those of `work`.
pub fn with_frames<R>(
    scene: &SceneDescription,
    settings: &RenderSettings,
    control: &Control<'_>,
    work: impl FnOnce(&mut Frames<'_, '_>) -> Result<R>,
) -> Result<R> {
    let (pool, threads) = pool(settings)?;
    let film = effective_film(scene, settings)?;
    let mut loaded = RenderStats::default();
    let start = Instant::now();

    (control.progress)(Progress::Phase("loading"));
    let (stage, environments, mut plan) =
        pool.install(|| Stage::load(scene, &film, settings, threads, control))?;
    let Stage { geometry, textures, .. } = &stage;
    if geometry.pages.is_some() && !plan.pages && settings.memory.is_some() && !settings.backend_named {
        // There are more triangles than were guessed, and Embree cannot let go of any.
        plan.backend = Backend::Native;
        plan.stats.backend = plan.backend.name().to_owned();
    }
    if geometry.pages.is_some() && plan.backend == Backend::Embree && settings.geometry_memory.is_none() {
        return Err(Error::Usage(
            "geometry is larger than its headers said and does not fit into --memory with Embree, which keeps all of it; \
             --backend native would do, or a larger --memory"
                .to_owned(),
        ));
    }
    loaded.time.prepare_s = start.elapsed().as_secs_f64();

    (control.progress)(Progress::Phase("building"));
    let build_start = Instant::now();
    let builder = Builder::new(plan.backend, settings.robust, threads)?;
    let (world_geometry, objects, instances) = geometry.for_backend();
    let pages = geometry.pages.as_ref().map(|pages| pages as &dyn Pages);
    let accel = pool.install(|| builder.build(&world_geometry, &objects, &instances, geometry, pages))?;
    loaded.time.build_s = build_start.elapsed().as_secs_f64();
    let lights = Lights::new(scene, geometry, textures, environments);
    let emitters = emitters_only(&builder, geometry, &lights)?;
    // Embree tells what all its structures take together.
    let of_emitters =
        if plan.backend == Backend::Native { emitters.as_ref().map_or(0, |e| e.bytes()) } else { 0 };
    let staying = geometry.bytes() + accel.bytes() + of_emitters;
    open_pages(geometry, staying, settings, &plan, threads)?;
    if let Some(watch) = control.watch {
        let tiles = textures.store().cache().map(|(cache, _)| cache.used());
        watch.follow(tiles, geometry.pages.as_ref().map(PageStore::used), staying);
    }
    loaded.memory.all_geometry = staying + geometry.pages.as_ref().map_or(0, PageStore::all_bytes);
    loaded.memory.all_textures = textures.store().all_bytes();
    loaded.memory.budget = settings.memory;
    hold_to_what_came(&mut plan, settings, geometry);

    let world = stage.world(scene, settings, film.size, lights, (&*accel, emitters.as_deref()));
    plan.stats.kernel = world.kernel().name().to_owned();
    plan.stats.calls = calls_named(world.calls);
    let (stage, builder) = (&stage, &builder);
    work(&mut Frames { scene, stage, builder, world, staying, loaded, plan, threads, start, control })
}

impl Frames<'_, '_> {
    /// Renders it. `settings` may differ from those that it was loaded with in samples, seed, size, crop, depth, roulette,
    /// estimator, sampler and limits of time; what was planned stays.
    ///
    /// # Errors
    /// A crop outside the film, or a memory for rays that is too small.
    pub fn render(&mut self, settings: &RenderSettings) -> Result<Outcome> {
        let film = effective_film(self.scene, settings)?;
        Stage::configure(&mut self.world, self.scene, settings, film.size);
        self.trace(settings, &film)
    }

    fn trace(&self, settings: &RenderSettings, film: &Film) -> Result<Outcome> {
        let Self { scene, stage, builder, ref world, ref plan, staying, threads, start, control, .. } = *self;
        let (geometry, textures) = (&stage.geometry, &stage.textures);
        let mut stats = self.loaded.clone();
        let spp = samples_asked(scene, settings);
        let seed = settings.seed.unwrap_or(scene.seed);
        let by_rounds = settings.noise.is_some() || settings.checkpoint.is_some();
        let keeps = Keeps { cut: by_rounds, squares: settings.noise.is_some() };
        let buffer = FilmBuffer::keeping(film.crop, keeps);
        let (keeper, resumed) = match &settings.checkpoint {
            Some(kept) => {
                // By surfaces: a kernel may be made to have cones that nothing reads.
                let wants_footprints = world.shading.iter().any(|s| s.needs.has(Needs::FOOTPRINT));
                let footprints = wants_footprints.then_some(world.footprint_scale);
                let found =
                    Found { backend: plan.backend, footprints, max_depth: world.max_depth, seed, spp };
                let identity = identity(scene, settings, film, &found);
                let resumed = take_up(&kept.path, &buffer, &identity, spp)?;
                let there = resumed.as_ref().map(|there| there.samples);
                (Some(Keeper::new(kept, identity, there)), resumed)
            }
            None => (None, None),
        };
        let before = resumed.as_ref().map_or(0, |there| there.samples);
        let targets = resumed.map(|there| there.targets);
        let rounds = by_rounds.then(|| Rounds::new(spp, settings.noise, &buffer, targets));
        // Only where tiles may have to go and come again does the order of work cost anything.
        let reads_tiles = !textures.store().all_tiles_fit()
            || geometry.pages.as_ref().is_some_and(|pages| !pages.fits_all());
        let waiting = match (plan.schedule, &geometry.pages) {
            (Schedule::Voxel, Some(pages)) => Some(Waiting::Voxel { pages, voxels: settings.voxels }),
            (Schedule::Voxel | Schedule::Sorted, _) => Some(Waiting::Sorted),
            (Schedule::Auto | Schedule::Depth, _) => None,
        };
        let ray_memory = plan.ray_memory;
        if waiting.is_some() {
            check_rays(ray_memory, threads, settings)?;
        }
        let job = Job {
            world,
            textures: textures.store(),
            pages: geometry.pages.as_ref(),
            film,
            filter: FilterSampler::new(&scene.filter),
            spp,
            seed,
            rounds,
            sampler: settings.sampler,
            next: AtomicU64::new(0),
            order: if reads_tiles && settings.time_limit_seconds.is_none() {
                Order::Tiles
            } else {
                Order::Passes
            },
            along: buffer.along(),
            buffer,
            samples: AtomicU64::new(before),
            regions_left: AtomicU64::new(0),
            most_threads: AtomicUsize::new(0),
            first_pixel: OnceLock::new(),
            stopped: AtomicBool::new(false),
            control,
            deadline: settings.time_limit_seconds,
            start: Instant::now(),
        };
        let traced = || match &waiting {
            None => Ok(Queued { counters: job.run(threads), ..Queued::default() }),
            Some(waiting) => {
                let room = RayRoom {
                    memory: ray_memory,
                    tables: plan.table_room(),
                    disk: settings.ray_disk.unwrap_or(0),
                    directory: settings.cache_dir.as_deref(),
                };
                job.run_in_queues(threads, waiting, &room)
            }
        };
        let run = || keeper.as_ref().map_or_else(traced, |keeper| keeper.during(&job, traced));
        let balance = match (textures.store().cache(), &geometry.pages) {
            (Some((tiles, _)), Some(pages)) if plan.stats.memory.balanced => {
                Some(Balance::new(tiles, pages, looking_up(plan, threads), threads))
            }
            _ => None,
        };
        let queued = match &balance {
            Some(balance) => balance.during(run),
            None => run(),
        };
        let Queued { counters, stats: scheduler, note } = queued?;
        let render_s = job.start.elapsed().as_secs_f64();

        let interrupted = job.stopped.load(Ordering::Relaxed);
        stats.time.render_s = render_s;
        stats.time.rooms.threads = job.most_threads.load(Ordering::Relaxed);
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
        let pixels = u64::from((x1 - x0) * (y1 - y0)).max(1);
        stats.image.spp = ((before + counters.samples) / pixels) as u32;
        stats.image.resumed_samples = before;
        if by_rounds {
            let (least, most, all) = job.buffer.samples(spp);
            (stats.image.spp_min, stats.image.spp_max) = (Some(least), Some(most));
            stats.image.spp_mean = Some(all as f64 / pixels as f64);
            stats.image.estimated_relmse = job.buffer.estimated_relmse();
        }
        stats.settings = stats::EffectiveSettings {
            backend: builder.name(),
            spp,
            seed: job.seed,
            max_depth: world.max_depth,
            sampler: settings.sampler.name().to_owned(),
            estimator: settings.estimator.name().to_owned(),
            roulette: settings.roulette.unwrap_or(true),
            robust: settings.robust && plan.backend == Backend::Embree,
            strict: settings.strict,
            time_limit_s: settings.time_limit_seconds,
            noise: settings.noise,
            crop: film.crop,
            full_size: [film.size.0, film.size.1],
            memory: settings.memory,
            texture_memory: settings.texture_memory,
            geometry_memory: settings.geometry_memory,
            texture_filter: settings.texture_filter.map(|filter| filter.name().to_owned()),
            footprint_spp: settings.footprint_spp.unwrap_or(spp).max(1),
            tessellation: settings.tessellation.unwrap_or(DEFAULT_EDGE_PIXELS),
            texture_latency_s: settings.texture_latency_seconds,
        };
        stats.memory.accounted = AccountedBytes {
            geometry: staying,
            textures: textures.store().bytes(),
            rays: scheduler.ray_memory_peak,
            film: job.buffer.bytes() + 12 * u64::from(x1 - x0) * u64::from(y1 - y0),
            lights: world.lights.bytes(),
            description: plan.stats.bytes.description,
            tables: scheduler.index_bytes,
        };
        stats.scheduler = SchedulerStats {
            name: waiting.as_ref().map_or("depth", Waiting::name).into(),
            because: plan.stats.because.clone(),
            ..scheduler
        };
        stats.plan = plan.stats.clone();
        let mut unreadable = Vec::new();
        if let Some((cache, names)) = textures.store().cache() {
            let cost = cache.stats(names);
            stats.memory.accounted.tables += cost.index_bytes;
            stats.time.stall_s = cost.total.stall_s;
            stats.texture_cache = Some(cost);
            stats.miss_ratio.texture = cache.miss_ratio_curve();
            let stands_in = |line: &String| format!("{line}; magenta stands in for it");
            unreadable = cache.failures().iter().map(stands_in).collect();
        }
        if let Some(pages) = &geometry.pages {
            let (mut cost, curve, failures) = pages.stats();
            cost.making_bytes = geometry.making_bytes;
            stats.time.stall_s += cost.total.stall_s;
            stats.memory.accounted.geometry += cost.peak;
            stats.memory.accounted.tables += cost.index_bytes;
            stats.geometry_cache = Some(cost);
            stats.miss_ratio.geometry = curve;
            unreadable.extend(failures);
        }
        stats.memory.peak_accounted = stats.memory.accounted.sum();
        if let Some(balance) = balance {
            let (moves, apart) = balance.finish();
            stats.memory.peak_accounted -= apart;
            stats.memory.moves = moves;
        }
        stats.finish(&counters);
        let mut notes = textures.store().notes().to_vec();
        notes.extend_from_slice(&geometry.notes);
        notes.extend(note);
        if let (Some(rounds), false) = (&job.rounds, interrupted) {
            notes.extend(rounds.unmet(&job.buffer));
        }
        let mut unsaved = None;
        if let Some(keeper) = keeper {
            let (seconds, failed) = keeper.end();
            stats.time.checkpoint_s = seconds;
            unsaved = failed;
        }
        if plan.backend != settings.backend {
            notes.push(format!(
                "all geometry does not fit into --memory with {}, which keeps it there: {} traces",
                settings.backend.name(),
                plan.backend.name()
            ));
        }
        if settings.robust && plan.backend == Backend::Native {
            notes.push(
                "--robust is a mode of Embree: the native hierarchy has no other, and lets no ray slip"
                    .to_owned(),
            );
        }
        let mut image = Image::cropped(film.size, film.crop);
        image.pixels = job.buffer.resolve();
        white_balance(&mut image.pixels, film);
        Ok(Outcome { image, stats, interrupted, notes, unreadable, unsaved })
    }
}

/// Geometry may have come otherwise than its headers said, where those leave it open: the schedule is chosen again.
fn hold_to_what_came(plan: &mut RenderPlan, settings: &RenderSettings, geometry: &SceneGeometry) {
    if geometry.pages.is_some() == plan.pages {
        return;
    }
    let store = match &geometry.pages {
        Some(pages) => Store::Pages { bytes: pages.all_bytes(), room: pages.budget() },
        None => Store::Resident,
    };
    plan.pages = geometry.pages.is_some();
    (plan.schedule, plan.stats.because) = choose(settings, store);
    if settings.memory.is_some() && settings.schedule == Schedule::Auto && plan.schedule != Schedule::Depth {
        // Nothing was set aside for rays.
        plan.schedule = Schedule::Depth;
        plan.stats.because =
            "geometry is larger than its headers said, and no memory was left for rays that wait".into();
    }
    plan.stats.schedule = plan.schedule.name().to_owned();
    plan.stats.memory.geometry_store = if plan.pages { "pages" } else { "resident" }.to_owned();
}

/// The sensor's white balance, on the finished image: it is linear.
fn white_balance(pixels: &mut [[f32; 3]], film: &Film) {
    let m = Mat3::from_cols_array_2d(&film.white_balance).transpose();
    if m == Mat3::IDENTITY {
        return;
    }
    for p in pixels {
        *p = (m * Vec3::from(*p)).to_array();
    }
}
