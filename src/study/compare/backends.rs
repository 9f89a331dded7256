//! Both backends over the same shapes, and what it took to build them.
//!
//! Invariant: builds take turns, native first, on one thread and then on all; the ones that are kept are the last.

use super::arbiter::Shapes;
use super::rates::median;
use crate::accel::Accel;
use crate::accel::Geometry;
use crate::accel::bvh::{BvhScene, Form};
#[cfg(feature = "embree")]
use crate::accel::embree::{BuildOptions, EmbreeDevice, EmbreeScene};
use crate::error::{Error, Result};
use std::time::Instant;

/// Primitives up to which builds are timed three times.
const SMALL: u64 = 2_000_000;

/// What a build took.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cost {
    /// On all threads, median \[s\].
    pub(super) build_s: f64,
    /// On one thread \[s\].
    pub(super) build_1_thread_s: f64,
    /// Held by the acceleration structure, as far as the backend tells.
    pub(super) bytes: u64,
}

/// Everything that is compared.
pub(super) struct Backends<'a> {
    pub(super) native: BvhScene<'a>,
    pub(super) native_cost: Cost,
    /// Version, scene, cost; `None` in a Weir without Embree.
    pub(super) embree: Option<(String, Box<dyn Accel + 'a>, Cost)>,
    pub(super) robust: Option<Box<dyn Accel + 'a>>,
}

/// Triangles and others, those of instances once.
pub(super) fn primitives(shapes: &Shapes<'_>) -> u64 {
    let count = |g: &Geometry<'_>| match g {
        Geometry::Triangles { indices, .. } => indices.len() as u64,
        Geometry::Custom { count, .. } => u64::from(*count),
        // What is compared stays in memory.
        Geometry::Pages { .. } => 0,
    };
    shapes.world.iter().chain(shapes.objects.iter().flatten()).map(count).sum()
}

fn timed<T>(build: impl FnOnce() -> Result<T>) -> Result<(T, f64)> {
    let start = Instant::now();
    let built = build()?;
    Ok((built, start.elapsed().as_secs_f64()))
}

impl<'a> Backends<'a> {
    /// Builds over `shapes`, which must be the very slices for all. `robust` asks for Embree's robust mode too; `rounds`
    /// of 0 builds once, on all threads, and times only that.
    pub(super) fn new(
        shapes: &Shapes<'a>,
        pool: &rayon::ThreadPool,
        threads: usize,
        robust: bool,
        rounds: u32,
    ) -> Result<Self> {
        let rounds = if rounds > 1 && primitives(shapes) > SMALL { 1 } else { rounds.min(3) };
        let one = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .map_err(|e| Error::Resource(format!("cannot start a thread: {e}")))?;
        let native_on = |pool: &rayon::ThreadPool| {
            timed(|| {
                pool.install(|| {
                    BvhScene::new(
                        &shapes.world,
                        &shapes.objects,
                        &shapes.instances,
                        shapes.custom,
                        None,
                        Form::best(),
                    )
                })
            })
        };
        #[cfg(feature = "embree")]
        let device = EmbreeDevice::new()?;
        #[cfg(feature = "embree")]
        let embree_on = |threads: usize, robust: bool| {
            timed(|| {
                EmbreeScene::new(
                    &device,
                    &shapes.world,
                    &shapes.objects,
                    &shapes.instances,
                    shapes.custom,
                    BuildOptions { robust, threads },
                )
            })
        };
        // Native on one and on all threads, Embree on one and on all.
        let mut taken: [Vec<f64>; 4] = Default::default();
        for _ in 0..rounds {
            taken[0].push(native_on(&one)?.1);
            #[cfg(feature = "embree")]
            taken[2].push(embree_on(1, false)?.1);
            if threads > 1 {
                taken[1].push(native_on(pool)?.1);
                #[cfg(feature = "embree")]
                taken[3].push(embree_on(threads, false)?.1);
            }
        }
        let (native, native_s) = native_on(pool)?;
        taken[1].push(native_s);
        #[cfg(feature = "embree")]
        let (embree, robust) = {
            let before = device.bytes();
            let (scene, seconds) = embree_on(threads, false)?;
            taken[3].push(seconds);
            let bytes = device.bytes().saturating_sub(before);
            let [_, _, one, all] = &taken;
            let cost = cost(one, all, bytes);
            let embree: (String, Box<dyn Accel + 'a>, Cost) = (device.version(), Box::new(scene), cost);
            let robust = if robust {
                Some(Box::new(embree_on(threads, true)?.0) as Box<dyn Accel + 'a>)
            } else {
                None
            };
            (Some(embree), robust)
        };
        #[cfg(not(feature = "embree"))]
        let (embree, robust) = {
            let _ = (robust, threads);
            (None, None)
        };
        let native_cost = cost(&taken[0], &taken[1], native.bytes());
        Ok(Self { native, native_cost, embree, robust })
    }
}

fn cost(one: &[f64], all: &[f64], bytes: u64) -> Cost {
    let one = if one.is_empty() { all } else { one };
    Cost { build_s: median(all.to_vec()), build_1_thread_s: median(one.to_vec()), bytes }
}
