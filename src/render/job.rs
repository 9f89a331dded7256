//! The work of a frame: tiles and their passes, handed out to threads, traced and summed.
//!
//! Invariant: threads share one counter of work and nothing else that is written; a tile's passes
//! are summed in order.
//! Never loads, and never decides what is rendered.

use super::rounds::{Round, Rounds};
use super::stream::workers;
use super::{Control, Progress};
use crate::accel::Accel;
use crate::clock::{self, Room, enter};
use crate::color::Rgb;
pub(super) use crate::film::PASS;
use crate::film::{FilmBuffer, FilterSampler};
use crate::geometry::pages::PageStore;
use crate::integrator::kernel::{Kernel, with_kernel};
use crate::integrator::path::{Wave, World};
use crate::integrator::sampler::pixel_key;
use crate::permits::Permits;
use crate::scene::Film;
use crate::settings::Sampler;
use crate::stats::{self, Counters};
use crate::texture::TextureStore;
use glam::Vec2;
use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::Instant;

/// Passes from which one over the whole film comes first in [`Order::Tiles`]: it reads all textures once
/// more, which many passes are long enough for.
const PREVIEW: u64 = 8;

/// Which work comes first. The picture is the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    /// A pass over the whole film before the next: whenever it is stopped, the image is whole.
    Passes,
    /// All passes of a tile before the next tile: what its rays read is read once, and not again for
    /// every pass. Where passes are many the first still goes over the whole film, so that what is
    /// stopped is an image; where they are few, tiles that were not reached stay black.
    Tiles,
}

/// What the threads share while rendering.
pub(super) struct Job<'a, A: ?Sized> {
    pub(super) world: &'a World<'a, A>,
    pub(super) textures: &'a TextureStore,
    /// Geometry that comes and goes, if any does.
    pub(super) pages: Option<&'a PageStore>,
    pub(super) film: &'a Film,
    pub(super) buffer: FilmBuffer,
    pub(super) filter: FilterSampler,
    pub(super) spp: u32,
    pub(super) seed: u64,
    pub(super) sampler: Sampler,
    /// What decides how many passes tiles get, where not all get the same without a stop.
    pub(super) rounds: Option<Rounds>,
    /// The next piece of work, in `order`.
    pub(super) next: AtomicU64,
    pub(super) order: Order,
    /// Film tiles along a curve that keeps neighbours together.
    pub(super) along: Vec<u32>,
    pub(super) samples: AtomicU64,
    /// Tiles that the round is about.
    pub(super) regions_left: AtomicU64,
    /// Threads that worked together, at most.
    pub(super) most_threads: AtomicUsize,
    pub(super) first_pixel: OnceLock<Instant>,
    pub(super) stopped: AtomicBool,
    pub(super) control: &'a Control<'a>,
    pub(super) deadline: Option<f64>,
    pub(super) start: Instant,
}

impl<A: Accel + ?Sized> Job<'_, A> {
    /// Renders a wave at a time on each thread.
    pub(super) fn run(&self, threads: usize) -> Counters {
        (self.control.progress)(Progress::Phase("rendering"));
        with_kernel!(self.world.kernel(), K => self.run_with::<K>(threads))
    }

    fn run_with<K: Kernel>(&self, threads: usize) -> Counters {
        let mut total = Counters::default();
        self.by_rounds(|round| {
            let counted = if self.pages.is_none_or(PageStore::fits_all) {
                self.crew(threads, |counters| self.work::<K>(round, counters))
            } else {
                let permits = Permits::new(threads);
                self.crew(workers(threads), |counters| permits.hold(|| self.work::<K>(round, counters)))
            };
            total.merge(&counted);
            true
        });
        total
    }

    /// Calls `work` for each round, or once where there are none, as long as it says that it can go on.
    pub(super) fn by_rounds(&self, mut work: impl FnMut(Option<&Round>) -> bool) {
        let Some(rounds) = &self.rounds else {
            work(None);
            return;
        };
        while let Some(round) = rounds.next(&self.buffer) {
            if self.should_stop() {
                break;
            }
            self.regions_left.store(round.tiles(), Ordering::Relaxed);
            self.say_progress(self.samples.load(Ordering::Relaxed));
            if !work(Some(&round)) {
                break;
            }
        }
    }

    /// Says how far it is: where nobody knows how many samples there will be, in regions that are done.
    fn say_progress(&self, done: u64) {
        let total = u64::from(self.buffer.tile_count());
        (self.control.progress)(if self.rounds.as_ref().is_some_and(Rounds::by_error) {
            let left = self.regions_left.load(Ordering::Relaxed);
            Progress::Regions { done: total.saturating_sub(left), total, samples: done }
        } else {
            Progress::Samples { done, total: self.total_samples() }
        });
    }

    /// Calls `work` on `threads` threads, each of which keeps textures and pages at hand; what they count.
    pub(super) fn crew(&self, threads: usize, work: impl Fn(&mut Counters) + Sync) -> Counters {
        let begin = Instant::now();
        let one = || {
            clock::start(begin);
            let mut counters = Counters::default();
            let attached = self.textures.attach();
            let held = self.pages.map(PageStore::hold);
            let cpu = stats::thread_cpu_seconds();
            work(&mut counters);
            drop(attached);
            drop(held);
            if let (Some(from), Some(to)) = (cpu, stats::thread_cpu_seconds()) {
                counters.busy_nanoseconds = ((to - from) * 1e9) as u64;
            }
            let (spent, end) = clock::stop();
            counters.rooms = spent;
            (counters, end.unwrap_or(begin))
        };
        let mut ended = Vec::with_capacity(threads);
        let mut total = Counters::default();
        let mut take = |(counters, end): (Counters, Instant)| {
            total.merge(&counters);
            ended.push(end);
        };
        std::thread::scope(|scope| {
            // A thread that the system refuses is one fewer; this one works in any case.
            let workers: Vec<_> = (1..threads)
                .map_while(|_| std::thread::Builder::new().spawn_scoped(scope, one).ok())
                .collect();
            take(one());
            for w in workers {
                match w.join() {
                    Ok(counted) => take(counted),
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
        });
        let last = Instant::now();
        let idle = ended.iter().map(|end| last.saturating_duration_since(*end).as_nanos() as u64);
        total.rooms[Room::Idle as usize] += idle.sum::<u64>();
        self.most_threads.fetch_max(ended.len(), Ordering::Relaxed);
        total
    }

    fn work<K: Kernel>(&self, round: Option<&Round>, counters: &mut Counters) {
        let mut wave = Wave::<K>::default();
        let mut scratch = Scratch::default();
        let _abandon = AbandonOnPanic(&self.buffer);
        if let Some(round) = round {
            while !self.should_stop()
                && let Some((tile, passes)) = round.take()
                && self.passes(tile, passes, &mut wave, &mut scratch, counters)
            {}
            return;
        }
        let tiles = u64::from(self.buffer.tile_count());
        let passes = u64::from(self.spp.div_ceil(PASS));
        // Asked before taking work: whoever holds a later pass of a tile waits for the earlier one.
        while !self.should_stop() {
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
            let passes = work.start as u32..work.end as u32;
            if !self.passes(tile, passes, &mut wave, &mut scratch, counters) {
                break;
            }
        }
    }

    /// Some passes over one tile; false when they were stopped.
    fn passes<K: Kernel>(
        &self,
        tile: u32,
        passes: Range<u32>,
        wave: &mut Wave<K>,
        scratch: &mut Scratch,
        counters: &mut Counters,
    ) -> bool {
        for pass in passes {
            if !self.tile(tile, pass, wave, scratch, counters) {
                return false;
            }
            self.count_samples(scratch.weights.len() as u64, counters);
        }
        true
    }

    /// Adds samples that are done, and says so now and then.
    pub(super) fn count_samples(&self, samples: u64, counters: &mut Counters) {
        counters.samples += samples;
        if self.first_pixel.get().is_none() {
            let _ = self.first_pixel.set(Instant::now());
        }
        let done = self.samples.fetch_add(samples, Ordering::Relaxed) + samples;
        // A few times a second at most.
        if done >> 16 != (done - samples) >> 16 {
            self.say_progress(done);
        }
    }

    fn total_samples(&self) -> u64 {
        let [x0, y0, x1, y1] = self.film.crop;
        u64::from(self.spp) * u64::from(x1 - x0) * u64::from(y1 - y0)
    }

    pub(super) fn should_stop(&self) -> bool {
        let stop = self.control.cancel.load(Ordering::Relaxed)
            || self.deadline.is_some_and(|limit| self.start.elapsed().as_secs_f64() >= limit);
        if stop {
            self.stopped.store(true, Ordering::Relaxed);
        }
        stop
    }

    /// One pass over one tile: camera paths for its pixels, run to their end, summed by pixel. False
    /// when it was stopped on the way, and added nothing.
    fn tile<K: Kernel>(
        &self,
        tile: u32,
        pass: u32,
        wave: &mut Wave<K>,
        scratch: &mut Scratch,
        counters: &mut Counters,
    ) -> bool {
        enter(Room::Camera);
        scratch.weights.clear();
        self.start(tile, pass, wave, &mut scratch.weights);
        let done = self.world.run(wave, counters, &|| self.should_stop());
        // Until the next tile begins.
        enter(Room::Film);
        if !done {
            self.buffer.abandon();
            return false;
        }
        self.sum((tile, pass), &wave.radiance, &scratch.weights, &mut scratch.sums, counters);
        self.buffer.add(tile, pass, self.cut(pass), &scratch.sums)
    }

    /// Adds the camera paths of one pass over one tile to `wave`, and the weights of their samples to `weights`.
    pub(super) fn start<K: Kernel>(&self, tile: u32, pass: u32, wave: &mut Wave<K>, weights: &mut Vec<f32>) {
        let [x0, y0, x1, y1] = self.buffer.rectangle(tile);
        let samples = self.samples_of(tile, pass);
        for y in y0..y1 {
            for x in x0..x1 {
                let key = pixel_key(x, y, self.seed);
                let centre = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                let filter = |u: Vec2| self.filter.sample(u);
                match self.sampler {
                    Sampler::Sobol => {
                        self.world.start(wave, weights, (centre, key), samples.clone(), filter);
                    }
                    // The first point of a scramble of its own.
                    Sampler::Independent => samples.clone().for_each(|sample| {
                        let seed = self.seed.wrapping_add((u64::from(sample) + 1) << 32);
                        self.world.start(wave, weights, (centre, pixel_key(x, y, seed)), 0..1, filter);
                    }),
                }
            }
        }
    }

    /// Samples of a pass that are yet to be taken: all, unless it was begun in another render.
    fn samples_of(&self, tile: u32, pass: u32) -> Range<u32> {
        pass * PASS + self.buffer.begun(tile, pass)..((pass + 1) * PASS).min(self.spp)
    }

    /// Samples of a pass that is cut short.
    pub(super) fn cut(&self, pass: u32) -> Option<u32> {
        let samples = self.spp - pass * PASS;
        (samples < PASS).then_some(samples)
    }

    /// Sums the samples of one pass over one tile by pixel, after those that are there.
    pub(super) fn sum(
        &self,
        (tile, pass): (u32, u32),
        radiance: &[Rgb],
        weights: &[f32],
        sums: &mut Vec<[f32; 4]>,
        counters: &mut Counters,
    ) {
        sums.clear();
        let samples = self.samples_of(tile, pass);
        let per_pixel = samples.len();
        let begun =
            if samples.start > pass * PASS { self.buffer.begun_sums(tile, pass) } else { Box::default() };
        let mut begun = begun.iter().copied();
        for (radiance, weights) in radiance.chunks(per_pixel).zip(weights.chunks(per_pixel)) {
            let mut sum = begun.next().unwrap_or([0.0f32; 4]);
            for (&l, &w) in radiance.iter().zip(weights) {
                let l = self.sensor(l, counters);
                for (s, v) in sum.iter_mut().zip([l.x * w, l.y * w, l.z * w, w]) {
                    *s += v;
                }
            }
            sums.push(sum);
        }
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
