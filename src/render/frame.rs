//! Renders one frame: load, build, trace by tiles, sum, write down what it cost.
//!
//! Invariant: threads share one counter of work and nothing else that is written; a tile's passes
//! are summed in order.

use super::{Control, Outcome, Progress};
use crate::accel::embree::{BuildOptions, EmbreeDevice, EmbreeScene};
use crate::accel::{Accel, NONE};
use crate::color::Rgb;
use crate::error::{Error, Result};
use crate::film::{FilmBuffer, FilterSampler, Image};
use crate::geometry::{self, Needs, Opacity, SceneGeometry, Surfaces};
use crate::integrator::camera::Camera;
use crate::integrator::light::env::EnvironmentMap;
use crate::integrator::lights::Lights;
use crate::integrator::lights_build::load_environments;
use crate::integrator::materials::{MaterialTables, Materials};
use crate::integrator::path::{SurfaceShading, Wave, World};
use crate::integrator::sampler::pixel_key;
use crate::prepare;
use crate::scene::{Film, SceneDescription, TextureId};
use crate::settings::{Estimator, RenderSettings};
use crate::stats::{self, Counters, RenderStats};
use crate::texture::convert::Watch;
use crate::texture::{Caching, TextureCoordinates, TextureOptions, TextureStore, Textures};
use glam::{Mat3, Vec2, Vec3};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Samples of a pixel that are traced together: with 64 pixels a tile, a wave is 1024 paths, some
/// 100 KB that stay in the second-level cache.
const PASS: u32 = 16;

/// Passes from which one over the whole film comes first in [`Order::Tiles`]: it reads all textures once
/// more, which many passes are long enough for.
const PREVIEW: u64 = 8;

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
    let options = BuildOptions { robust: settings.robust, threads };
    let (world_geometry, objects, instances) = geometry.for_backend();
    let device = EmbreeDevice::new()?;
    let accel = EmbreeScene::new(&device, &world_geometry, &objects, &instances, &geometry, options)?;
    stats.time.build_s = build_start.elapsed().as_secs_f64();
    stats.plan.bytes.geometry = geometry.bytes() + accel.bytes();
    stats.plan.bytes.textures = textures.store().all_bytes();

    let materials = Materials::new(scene, &textures, &tables);
    let lights = Lights::new(scene, &geometry, &textures, environments);
    let emitters = emitters_only(&device, &geometry, &lights, options)?;
    let shading = shading(&geometry, &materials, &lights);
    let spp = settings.spp.unwrap_or(scene.spp).max(1);
    let roulette = settings.roulette.unwrap_or(true);
    let samples_lights = lights.can_be_sampled() && settings.estimator != Estimator::Scattering;
    let world = World {
        estimator: settings.estimator,
        samples_lights,
        accel: &accel,
        emitters_only: emitters.as_ref(),
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
    let reads_tiles = !textures.store().all_tiles_fit();
    let job = Job {
        world: &world,
        textures: textures.store(),
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
        backend: format!("embree {}", device.version()),
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
        texture_latency_s: settings.texture_latency_seconds,
    };
    stats.finish(&counters);
    let mut unreadable = Vec::new();
    if let Some((cache, names)) = textures.store().cache() {
        let cost = cache.stats(names);
        // Reading is waiting too, for everything but the processor's share of decoding.
        stats.time.stall_s += cost.total.stall_s;
        stats.texture_cache = Some(cost);
        stats.miss_ratio.texture = cache.miss_ratio_curve();
        unreadable = cache.failures();
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

fn load(
    scene: &SceneDescription,
    settings: &RenderSettings,
    threads: usize,
    control: &Control<'_>,
) -> Result<(SceneGeometry, Arc<Textures>, Vec<EnvironmentMap>)> {
    let needs = prepare::image_needs(scene);
    let options = TextureOptions {
        budget: settings.texture_memory.unwrap_or_else(default_texture_memory),
        threads,
        cache_dir: settings.cache_dir.clone(),
        latency: Duration::from_secs_f64(settings.texture_latency_seconds.max(0.0)),
        caching: Caching::Direct,
    };
    let converting = |done, total| (control.progress)(Progress::Converting { done, total });
    let watch = Watch { cancel: control.cancel, progress: &converting };
    let (geometry, (store, environments)) = rayon::join(
        || geometry::load(scene),
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

/// A scene of the emitting surfaces alone, for the last ray of a path; `None` where nothing emits.
fn emitters_only<'g>(
    device: &Arc<EmbreeDevice>,
    geometry: &'g SceneGeometry,
    lights: &Lights,
    options: BuildOptions,
) -> Result<Option<EmbreeScene<'g>>> {
    if lights.emitters.is_empty() {
        return Ok(None);
    }
    let emitting = geometry.describe_emitters();
    Ok(Some(EmbreeScene::new(device, &emitting, &[], &[], geometry, options)?))
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

/// Which work comes first. The picture is the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    /// A pass over the whole film before the next: whenever it is stopped, the image is whole.
    Passes,
    /// All passes of a tile before the next tile: what its rays read is read once, and not again for
    /// every pass. Where passes are many the first still goes over the whole film, so that what is
    /// stopped is an image; where they are few, tiles that were not reached stay black.
    Tiles,
}

/// What the threads share while rendering.
struct Job<'a, A> {
    world: &'a World<'a, A>,
    textures: &'a TextureStore,
    film: &'a Film,
    buffer: FilmBuffer,
    filter: FilterSampler,
    spp: u32,
    seed: u64,
    /// The next piece of work, in `order`.
    next: AtomicU64,
    order: Order,
    /// Film tiles along a curve that keeps neighbours together.
    along: Vec<u32>,
    samples: AtomicU64,
    first_pixel: OnceLock<Instant>,
    stopped: AtomicBool,
    control: &'a Control<'a>,
    deadline: Option<f64>,
    start: Instant,
}

impl<A: Accel> Job<'_, A> {
    fn run(&self, threads: usize) -> Counters {
        (self.control.progress)(Progress::Phase("rendering"));
        let mut total = Counters::default();
        std::thread::scope(|scope| {
            // A thread that the system refuses is one fewer; this one works in any case.
            let workers: Vec<_> = (1..threads)
                .map_while(|_| std::thread::Builder::new().spawn_scoped(scope, || self.work()).ok())
                .collect();
            total.merge(&self.work());
            for w in workers {
                match w.join() {
                    Ok(counters) => total.merge(&counters),
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
        });
        total
    }

    fn work(&self) -> Counters {
        let mut counters = Counters::default();
        let mut wave = Wave::default();
        let attached = self.textures.attach();
        let mut scratch = Scratch::default();
        let tiles = u64::from(self.buffer.tile_count());
        let passes = u64::from(self.spp.div_ceil(PASS));
        let total = u64::from(self.spp)
            * u64::from(self.film.crop[2] - self.film.crop[0])
            * u64::from(self.film.crop[3] - self.film.crop[1]);
        let cpu = stats::thread_cpu_seconds();
        let abandon = AbandonOnPanic(&self.buffer);
        // Asked before taking work: whoever holds a later pass of a tile waits for the earlier one.
        'work: while !self.should_stop() {
            let item = self.next.fetch_add(1, Ordering::Relaxed);
            let (round, place) = (item / tiles, item % tiles);
            let work = match self.order {
                Order::Passes if round < passes => round..round + 1,
                Order::Tiles if round == 0 && passes >= PREVIEW => 0..1,
                Order::Tiles if round == 0 => 0..passes,
                Order::Tiles if round == 1 && passes >= PREVIEW => 1..passes,
                _ => break,
            };
            // They were u32 before they were multiplied.
            let tile = self.along[place as usize];
            for pass in work {
                if !self.tile(tile, pass as u32, &mut wave, &mut scratch, &mut counters) {
                    break 'work;
                }
                let samples = scratch.weights.len() as u64;
                counters.samples += samples;
                if self.first_pixel.get().is_none() {
                    let _ = self.first_pixel.set(Instant::now());
                }
                let done = self.samples.fetch_add(samples, Ordering::Relaxed) + samples;
                // A few times a second at most.
                if done >> 16 != (done - samples) >> 16 {
                    (self.control.progress)(Progress::Samples { done, total });
                }
            }
        }
        drop(abandon);
        drop(attached);
        if let (Some(from), Some(to)) = (cpu, stats::thread_cpu_seconds()) {
            counters.busy_nanoseconds = ((to - from) * 1e9) as u64;
        }
        counters
    }

    fn should_stop(&self) -> bool {
        let stop = self.control.cancel.load(Ordering::Relaxed)
            || self.deadline.is_some_and(|limit| self.start.elapsed().as_secs_f64() >= limit);
        if stop {
            self.stopped.store(true, Ordering::Relaxed);
        }
        stop
    }

    /// One pass over one tile: camera paths for its pixels, run to their end, summed by pixel. False
    /// when it was stopped on the way, and added nothing.
    fn tile(
        &self,
        tile: u32,
        pass: u32,
        wave: &mut Wave,
        scratch: &mut Scratch,
        counters: &mut Counters,
    ) -> bool {
        let [x0, y0, x1, y1] = self.buffer.rectangle(tile);
        let samples = pass * PASS..((pass + 1) * PASS).min(self.spp);
        scratch.weights.clear();
        for y in y0..y1 {
            for x in x0..x1 {
                let key = pixel_key(x, y, self.seed);
                let centre = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                let filter = |u: Vec2| self.filter.sample(u);
                self.world.start(wave, &mut scratch.weights, (centre, key), samples.clone(), filter);
            }
        }
        if !self.world.run(wave, counters, &|| self.should_stop()) {
            self.buffer.abandon();
            return false;
        }
        scratch.sums.clear();
        let per_pixel = samples.len();
        for (radiance, weights) in wave.radiance.chunks(per_pixel).zip(scratch.weights.chunks(per_pixel)) {
            let mut sum = [0.0f32; 4];
            for (&l, &w) in radiance.iter().zip(weights) {
                let l = self.sensor(l, counters);
                for (s, v) in sum.iter_mut().zip([l.x * w, l.y * w, l.z * w, w]) {
                    *s += v;
                }
            }
            scratch.sums.push(sum);
        }
        self.buffer.add(tile, pass, &scratch.sums)
    }

    /// Exposure and the bound on a sample's components; what is not finite is counted and black.
    #[inline(always)]
    fn sensor(&self, l: Rgb, counters: &mut Counters) -> Rgb {
        if !l.is_finite() {
            counters.non_finite_samples += 1;
            return Rgb::ZERO;
        }
        let l = l * self.film.imaging_ratio;
        let m = l.max_element();
        if m > self.film.max_component_value { l * (self.film.max_component_value / m) } else { l }
    }
}

/// Lets no thread wait for the pass that a panic has taken away.
struct AbandonOnPanic<'a>(&'a FilmBuffer);

impl Drop for AbandonOnPanic<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.abandon();
        }
    }
}

/// Buffers of a thread that are reused from tile to tile.
#[derive(Default)]
struct Scratch {
    weights: Vec<f32>,
    sums: Vec<[f32; 4]>,
}
