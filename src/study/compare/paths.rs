//! Rays of the real paths: waves over tiles spread over the film, traced through an [`Accel`] that writes down what it
//! is asked.
//!
//! Invariant: rays are in the order in which paths ask. The same scene, settings and seed give the same rays.
//! Never changes an answer.

use crate::accel::{Accel, Hit, Ray};
use crate::film::{FilmBuffer, FilterSampler};
use crate::integrator::kernel::General;
use crate::integrator::path::{Wave, World};
use crate::integrator::sampler::pixel_key;
use crate::scene::Film;
use crate::stats::Counters;
use glam::{Vec2, Vec3};
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Samples of a pixel that a wave takes, as in rendering.
const PASS: u32 = 16;
/// Waves that may add nothing to what is still wanted before the search for more ends.
const PATIENCE: u32 = 64;

/// Camera, bounce and shadow rays.
pub(super) type ByKind = [Vec<Ray>; 3];

#[derive(Default)]
struct Log {
    /// Camera rays of the wave that are yet to come; they are asked for first.
    camera_left: usize,
    rays: ByKind,
    /// No more than so many of each.
    most: usize,
}

/// Answers as another does, and writes down the rays.
pub(super) struct Recorder<'a> {
    inner: &'a dyn Accel,
    log: Mutex<Log>,
}

impl<'a> Recorder<'a> {
    pub(super) fn new(inner: &'a dyn Accel) -> Self {
        Self { inner, log: Mutex::new(Log::default()) }
    }

    fn log<T>(&self, f: impl FnOnce(&mut Log) -> T) -> T {
        f(&mut self.log.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Log {
    fn push(&mut self, kind: usize, ray: &Ray) {
        if self.rays[kind].len() < self.most {
            self.rays[kind].push(*ray);
        }
    }
}

impl Accel for Recorder<'_> {
    fn closest(&self, ray: &Ray) -> Hit {
        self.log(|log| {
            let kind = usize::from(log.camera_left == 0);
            log.camera_left = log.camera_left.saturating_sub(1);
            log.push(kind, ray);
        });
        self.inner.closest(ray)
    }

    fn occluded(&self, ray: &Ray) -> bool {
        self.log(|log| log.push(2, ray));
        self.inner.occluded(ray)
    }

    fn bytes(&self) -> u64 {
        self.inner.bytes()
    }

    fn bounds(&self) -> (Vec3, Vec3) {
        self.inner.bounds()
    }
}

/// What paths are drawn from.
pub(super) struct Source<'s, 'w> {
    pub(super) world: &'s World<'w, dyn Accel + 'w>,
    pub(super) recorder: &'s Recorder<'w>,
    pub(super) film: &'s Film,
    pub(super) filter: FilterSampler,
    pub(super) spp: u32,
    pub(super) seed: u64,
}

/// A wave that was recorded: its tile, its samples, and how many rays of each kind there were before it.
pub(super) struct Taken {
    tile: u32,
    samples: Range<u32>,
    before: [usize; 3],
}

impl Source<'_, '_> {
    /// Runs the samples of some pixels.
    fn run(&self, wave: &mut Wave<General>, pixels: [u32; 4], samples: &Range<u32>) {
        let [x0, y0, x1, y1] = pixels;
        let mut weights = Vec::new();
        for y in y0..y1 {
            for x in x0..x1 {
                let centre = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                let key = pixel_key(x, y, self.seed);
                let filter = |u: Vec2| self.filter.sample(u);
                self.world.start(wave, &mut weights, (centre, key), samples.clone(), filter);
            }
        }
        self.recorder.log(|log| log.camera_left = wave.paths.len());
        self.world.run(wave, &mut Counters::default(), &|| false);
    }

    /// Up to `most` rays of each kind, and the waves they are from.
    pub(super) fn record(&self, most: usize) -> (ByKind, Vec<Taken>) {
        self.recorder.log(|log| *log = Log { most, ..Log::default() });
        let counts = || self.recorder.log(|log| [0, 1, 2].map(|k: usize| log.rays[k].len()));
        let buffer = FilmBuffer::new(self.film.crop);
        let tiles = buffer.tile_count();
        let step = spreading_step(tiles);
        let (mut wave, mut taken, mut idle) = (Wave::<General>::default(), Vec::new(), 0);
        'waves: for pass in 0..self.spp.div_ceil(PASS) {
            let samples = pass * PASS..((pass + 1) * PASS).min(self.spp);
            for i in 0..tiles {
                let before = counts();
                if before.iter().all(|&n| n >= most) || idle > PATIENCE {
                    break 'waves;
                }
                let tile = (u64::from(i) * step % u64::from(tiles)) as u32;
                self.run(&mut wave, buffer.rectangle(tile), &samples);
                idle = if counts() == before { idle + 1 } else { 0 };
                taken.push(Taken { tile, samples: samples.clone(), before });
            }
        }
        (self.recorder.log(|log| std::mem::take(&mut log.rays)), taken)
    }

    /// The pixel whose path asked for ray number `index` of `kind`. Its tile is run again, pixel by pixel: a path's rays
    /// do not depend on those beside it.
    pub(super) fn pixel_of(
        &self,
        taken: &[Taken],
        kind: usize,
        index: usize,
        ray: &Ray,
    ) -> Option<(u32, u32)> {
        let wave = taken.get(taken.partition_point(|t| t.before[kind] <= index).checked_sub(1)?)?;
        let [x0, y0, x1, y1] = FilmBuffer::new(self.film.crop).rectangle(wave.tile);
        let mut paths = Wave::<General>::default();
        for y in y0..y1 {
            for x in x0..x1 {
                self.recorder.log(|log| *log = Log { most: usize::MAX, ..Log::default() });
                self.run(&mut paths, [x, y, x + 1, y + 1], &wave.samples);
                if self.recorder.log(|log| log.rays[kind].iter().any(|r| bits(r) == bits(ray))) {
                    return Some((x, y));
                }
            }
        }
        None
    }
}

fn bits(ray: &Ray) -> [u32; 8] {
    let ([a, b, c], [d, e, f]) = (ray.origin.to_array(), ray.direction.to_array());
    [a, b, c, d, e, f, ray.t_min, ray.t_max].map(f32::to_bits)
}

/// A step, prime to `n` and near its golden section, so that any first part of the steps is spread over all of `n`.
fn spreading_step(n: u32) -> u64 {
    let prime_to = |a: u64, mut b: u64| {
        let mut a = a;
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a == 1
    };
    let n = u64::from(n.max(1));
    let mut step = (n as f64 * 0.618_033_988_75) as u64;
    while !prime_to(step.max(1), n) {
        step += 1;
    }
    step.max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_reach_every_tile() {
        for n in [1, 2, 3, 4, 12, 100, 14_400] {
            let mut seen = vec![false; n as usize];
            for i in 0..n {
                seen[(u64::from(i) * spreading_step(n) % u64::from(n)) as usize] = true;
            }
            assert!(seen.iter().all(|&s| s), "{n}");
        }
    }
}
