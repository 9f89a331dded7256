//! Embree against the native hierarchy, hit by hit: the same rays through both, and a third voice in f64 that says who is
//! right and why (`arbiter`, `judge`), by bounds derived from the arithmetic of each (`bounds`). And how fast each is.
//!
//! Invariant: the same scene, settings and seed give the same rays and the same verdicts; only times differ.
//! Never changes what is compared: acceleration structures are built as for rendering.

mod aimed;
mod arbiter;
mod backends;
mod bounds;
mod held;
mod hits;
mod judge;
mod outcome;
mod paths;
mod picture;
mod rates;
mod replay;
#[cfg(test)]
mod testing;
mod verdict;

pub use arbiter::Shapes;
pub use held::{Held, hold};
pub use hits::Kind;
pub use outcome::{
    Answer, Answers, Backend, Comparison, Hits, Ratios, RayCounts, Worst, parse_ray, ray_text,
};
pub use rates::{Query, Rate};
pub use replay::replay;

use crate::accel::bvh::Work;
use crate::accel::{Accel, Builder, Ray};
use crate::error::{Error, Result};
use crate::film::{FilterSampler, Image};
use crate::integrator::lights::Lights;
use crate::render::stage::{Stage, effective_film, emitters_only, pool};
use crate::render::{Control, Progress};
use crate::scene::SceneDescription;
use crate::settings::{Backend as BackendName, RenderSettings};
use arbiter::Arbiter;
use backends::{Backends, Cost, primitives};
use bounds::Voice;
use hits::{Disagreement, Pair, Tally};
use paths::{Recorder, Source};
use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

/// What to compare and how much.
#[derive(Clone, Debug)]
pub struct Options {
    /// Size, crop, depth, seed and threads of the paths.
    pub settings: RenderSettings,
    /// Rays of paths; a quarter of it is aimed besides.
    pub rays: usize,
    /// Whether Embree's robust mode is compared too.
    pub robust: bool,
    /// Rounds of each rate; 0 measures none.
    pub rounds: u32,
    /// Disagreements to list.
    pub worst: usize,
    /// Whether a picture is wanted; its pixels' rays are compared too.
    pub picture: bool,
}

/// Rays that agree which the arbiter looks at all the same, about.
const AUDITS: usize = 20_000;
/// Without Embree, rays that the arbiter looks at.
const AUDITS_ALONE: usize = 40_000;
/// Boxes and instances that may be looked at for them: some tens of seconds.
const AUDIT_STEPS: usize = 1 << 28;
/// However large the scene is.
const FEWEST_AUDITS: usize = 500;
/// Rays of one rate, at most.
const MOST_TIMED: usize = 1 << 18;

/// Compares, and draws where they differ if that is asked for.
///
/// # Errors
/// As rendering: what cannot be read, a crop outside the film, memory that runs out, an interruption.
pub fn compare(
    scene: &SceneDescription,
    options: &Options,
    control: &Control<'_>,
) -> Result<(Comparison, Option<Image>)> {
    let settings = &options.settings;
    let phase = |name| {
        (control.progress)(Progress::Phase(name));
        if control.cancel.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
    };
    let (pool, threads) = pool(settings)?;
    let film = effective_film(scene, settings)?;
    phase("loading")?;
    let (stage, environments, _) = pool.install(|| Stage::load(scene, &film, settings, threads, control))?;
    let lights = Lights::new(scene, &stage.geometry, &stage.textures, environments);
    let (world, objects, instances) = stage.geometry.for_backend();
    let shapes = Shapes { world, objects, instances, custom: &stage.geometry };
    phase("building both")?;
    let backends = Backends::new(&shapes, &pool, threads, options.robust, options.rounds)?;
    let native: &dyn Accel = &backends.native;

    phase("recording rays")?;
    let builder = Builder::new(BackendName::Native, false, threads)?;
    let emitters = emitters_only(&builder, &stage.geometry, &lights)?;
    let recorder = Recorder::new(native);
    let accel: &dyn Accel = &recorder;
    let world = stage.world(scene, settings, film.size, lights, (accel, emitters.as_deref()));
    let source = Source {
        world: &world,
        recorder: &recorder,
        film: &film,
        filter: FilterSampler::new(&scene.filter),
        spp: settings.spp.unwrap_or(scene.spp).max(1),
        seed: settings.seed.unwrap_or(scene.seed),
    };
    let attached = stage.textures.store().attach();
    let (by_kind, taken) = source.record(options.rays.div_ceil(3));
    let eye = world.camera.ray(
        glam::Vec2::new(film.size.0 as f32, film.size.1 as f32) * 0.5,
        glam::Vec2::splat(0.5),
        true,
    );
    let aimed = aimed::aimed(&shapes, options.rays / 4, source.seed, native.bounds(), eye.ray.origin);
    let middles: Vec<Ray> = if options.picture {
        let through = |p| world.camera.ray(p, glam::Vec2::splat(0.5), true).ray;
        picture::middles(film.crop).into_iter().map(through).collect()
    } else {
        Vec::new()
    };

    phase("comparing")?;
    let [camera, bounce, shadow] = &by_kind;
    let sets: [(Kind, &'static str, &[Ray]); 5] = [
        (Kind::Camera, "camera", camera),
        (Kind::Bounce, "bounce", bounce),
        (Kind::Shadow, "shadow", shadow),
        (Kind::Aimed, "aimed", &aimed),
        (Kind::Pixel, "pixel", &middles),
    ];
    let total: usize = sets.iter().map(|s| s.2.len()).sum();
    let embree = backends.embree.as_ref().map(|e| &*e.1);
    let run = |other: Option<&dyn Accel>, voice: Voice| {
        let voices = [Voice::Native, if other.is_some() { voice } else { Voice::Native }];
        let arbiter = pool.install(|| Arbiter::new(&shapes, voices));
        let pair = Pair { native, other: other.unwrap_or(native), arbiter: &arbiter };
        let audits = if other.is_some() { AUDITS } else { AUDITS_ALONE };
        let every = total / audits.min(AUDIT_STEPS / arbiter.steps().max(1)).max(FEWEST_AUDITS) + 1;
        sets.map(|(kind, name, rays)| (name, pool.install(|| pair.compare(kind, rays, every))))
    };
    let tallies = run(embree, Voice::Embree);
    let robust = backends.robust.as_deref().map(|robust| join(run(Some(robust), Voice::EmbreeRobust)).1);
    let (by_name, all) = join(tallies);

    let picture = options.picture.then(|| {
        let mut image =
            pool.install(|| picture::shaded(film.size, film.crop, &middles, native, &world.geometry));
        let mut mark = |d: &Disagreement| {
            let pixel = match d.kind {
                Kind::Pixel => {
                    let across = film.crop[2] - film.crop[0];
                    let i = d.index as u32;
                    Some((film.crop[0] + i % across, film.crop[1] + i / across))
                }
                Kind::Camera => source.pixel_of(&taken, 0, d.index, &d.ray),
                Kind::Bounce => source.pixel_of(&taken, 1, d.index, &d.ray),
                Kind::Shadow => source.pixel_of(&taken, 2, d.index, &d.ray),
                Kind::Aimed => None,
            };
            if let Some(pixel) = pixel {
                picture::mark(&mut image, pixel, d);
            }
        };
        all.disagreements.iter().for_each(&mut mark);
        image
    });
    drop(attached);

    phase("measuring")?;
    let work = count(&backends, [camera, bounce]);
    let rates =
        if options.rounds > 0 { measure(&backends, &by_kind, options, &pool, threads) } else { Vec::new() };
    let count = |i: usize| sets[i].2.len() as u64;
    let comparison = Comparison {
        weir: env!("CARGO_PKG_VERSION").into(),
        scene: scene.path.display().to_string(),
        primitives: primitives(&shapes),
        instances: shapes.instances.len() as u64,
        threads,
        seed: source.seed,
        rays: RayCounts {
            camera: count(0),
            bounce: count(1),
            shadow: count(2),
            aimed: count(3),
            pixel: count(4),
        },
        hits: Hits::of(&all),
        by_kind: by_name,
        robust: robust.as_ref().map(Hits::of),
        worst: all.worst(options.worst).into_iter().map(Worst::of).collect(),
        embree: backends.embree.as_ref().map(|(version, _, cost)| Backend {
            misses_through_closed_mesh: all.slipped[1],
            ..backend(version.clone(), cost, &shapes, &rates, |r| r.embree)
        }),
        native: Backend {
            misses_through_closed_mesh: all.slipped[0],
            nodes_per_ray: work.map(|w| w.0),
            leaves_per_ray: work.map(|w| w.1),
            ..backend(env!("CARGO_PKG_VERSION").into(), &backends.native_cost, &shapes, &rates, |r| {
                Some(r.native)
            })
        },
        native_over_embree: backends.embree.as_ref().map(|e| ratios(&backends.native_cost, &e.2, &rates)),
        rates,
    };
    Ok((comparison, picture))
}

/// By kind, and all together.
fn join(tallies: [(&'static str, Tally); 5]) -> (BTreeMap<&'static str, Hits>, Tally) {
    let asked = tallies.iter().filter(|(_, t)| t.rays > 0);
    let by_name = asked.map(|(name, tally)| (*name, Hits::of(tally))).collect();
    (by_name, tallies.into_iter().fold(Tally::default(), |all, (_, tally)| all.merge(tally)))
}

/// Nodes and leaves that a ray visits.
fn count(backends: &Backends<'_>, sets: [&Vec<Ray>; 2]) -> Option<(f64, f64)> {
    let mut work = Work::default();
    let rays: usize = sets.iter().map(|s| s.len()).sum();
    for ray in sets.into_iter().flatten() {
        let _ = backends.native.closest_counted(ray, &mut work);
    }
    (rays > 0).then(|| (work.nodes as f64 / rays as f64, work.leaves as f64 / rays as f64))
}

/// Every rate, one thread first.
fn measure(
    backends: &Backends<'_>,
    [camera, bounce, shadow]: &[Vec<Ray>; 3],
    options: &Options,
    pool: &rayon::ThreadPool,
    threads: usize,
) -> Vec<Rate> {
    let part = |rays: &Vec<Ray>| rays[..rays.len().min(MOST_TIMED)].to_vec();
    let (camera, bounce, shadow) = (part(camera), part(bounce), part(shadow));
    let mut shuffled = bounce.clone();
    let mut random = aimed::Random(1);
    for i in (1..shuffled.len()).rev() {
        shuffled.swap(i, (random.unit() * (i + 1) as f64) as usize);
    }
    let set = |kind, shuffled, query, rays| rates::Set { kind, shuffled, query, rays };
    let sets = [
        set(Kind::Camera, false, Query::Closest, &camera[..]),
        set(Kind::Bounce, false, Query::Closest, &bounce),
        set(Kind::Bounce, true, Query::Closest, &shuffled),
        set(Kind::Camera, false, Query::Occluded, &camera),
        set(Kind::Shadow, false, Query::Occluded, &shadow),
        set(Kind::Bounce, true, Query::Occluded, &shuffled),
    ];
    let accels: [Option<&dyn Accel>; 3] =
        [Some(&backends.native), backends.embree.as_ref().map(|e| &*e.1), backends.robust.as_deref()];
    let pools = [None, Some(pool)];
    let pools = &pools[..if threads > 1 { 2 } else { 1 }];
    let sets = || sets.iter().filter(|s| !s.rays.is_empty());
    pools
        .iter()
        .flat_map(|pool| sets().map(move |set| rates::measure(accels, set, options.rounds, *pool)))
        .collect()
}

/// Rates of the headline: of one thread, in the order of paths.
fn headline(rates: &[Rate], kinds: [Kind; 2], query: Query) -> impl Iterator<Item = &Rate> {
    let is = move |r: &&Rate| r.threads == 1 && !r.shuffled && r.query == query && kinds.contains(&r.kind);
    rates.iter().filter(is)
}

const PATHS: [Kind; 2] = [Kind::Camera, Kind::Bounce];
const SHADOWS: [Kind; 2] = [Kind::Shadow; 2];

fn backend(
    version: String,
    cost: &Cost,
    shapes: &Shapes<'_>,
    rates: &[Rate],
    of: impl Fn(&Rate) -> Option<f64> + Copy,
) -> Backend {
    // All rays over all seconds.
    let rate = |kinds, query| {
        let (mut rays, mut seconds) = (0.0, 0.0);
        for r in headline(rates, kinds, query) {
            rays += r.rays as f64 * 1e-6;
            seconds += r.rays as f64 * 1e-6 / of(r)?;
        }
        (seconds > 0.0).then(|| rays / seconds)
    };
    Backend {
        version,
        build_s: cost.build_s,
        build_1_thread_s: cost.build_1_thread_s,
        bytes: cost.bytes,
        bytes_per_triangle: cost.bytes as f64 / primitives(shapes).max(1) as f64,
        closest_mrays_per_s: rate(PATHS, Query::Closest),
        occluded_mrays_per_s: rate(SHADOWS, Query::Occluded),
        misses_through_closed_mesh: 0,
        nodes_per_ray: None,
        leaves_per_ray: None,
    }
}

fn ratios(native: &Cost, embree: &Cost, rates: &[Rate]) -> Ratios {
    let mean = |kinds, query| {
        let logs: Vec<f64> =
            headline(rates, kinds, query).filter_map(|r| r.native_over_embree).map(f64::ln).collect();
        (!logs.is_empty()).then(|| (logs.iter().sum::<f64>() / logs.len() as f64).exp())
    };
    Ratios {
        closest: mean(PATHS, Query::Closest),
        occluded: mean(SHADOWS, Query::Occluded),
        build: native.build_s / embree.build_s,
        build_1_thread: native.build_1_thread_s / embree.build_1_thread_s,
        bytes: native.bytes as f64 / embree.bytes.max(1) as f64,
    }
}
