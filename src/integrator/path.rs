//! Runs paths to their end, one edge of all at a time: finds what they meet, has it shaded (`shade.rs`)
//! and connects light samples. A path is a plain record that can be put down and taken up; steps run
//! over slices of them, so that a scheduler may decide which paths come together. Never waits for I/O,
//! and does not know who called it.
//!
//! Depth counts scattering events, as in pbrt-v4 (4th ed., §13.4).

use crate::accel::{Accel, Hit, NONE, Ray};
use crate::clock::{Room, enter};
use crate::color::Rgb;
use crate::geometry::{Needs, Surfaces};
use crate::integrator::camera::{Camera, CameraRay};
use crate::integrator::cone::Cone;
use crate::integrator::kernel::{Kernel, Part};
use crate::integrator::lights::Lights;
use crate::integrator::materials::Materials;
use crate::integrator::media::medium_index;
use crate::integrator::sampler::Set;
use crate::prepare::{Calls, KernelName, kernel_for};
use crate::scene::{Medium, MediumId, MediumInterface};
use crate::settings::Estimator;
use crate::stats::Counters;
use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};
use std::ops::Range;

/// What shading needs to know of a surface; 32 bytes, two a cache line.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceShading {
    /// Index of the compiled material.
    pub material: u32,
    /// Index into [`Lights::emitters`], or [`NONE`].
    pub emitter: u32,
    /// Attributes the material asks for.
    pub needs: Needs,
    /// Rays may pass without scattering: an interface, or a mix that has one among its parts.
    pub may_pass: bool,
    /// Media on both sides.
    pub medium: Option<MediumInterface>,
}

/// Everything a path can meet. Shared by all threads, never written while rendering.
pub struct World<'a, A: ?Sized> {
    /// Traversal.
    pub accel: &'a A,
    /// Traversal of emitting surfaces alone (world geometry ids), if that is worth having.
    pub emitters_only: Option<&'a A>,
    /// Surfaces.
    pub geometry: Surfaces<'a>,
    /// By surface.
    pub shading: Vec<SurfaceShading>,
    /// Materials.
    pub materials: Materials<'a>,
    /// Lights.
    pub lights: Lights,
    /// Media.
    pub media: Vec<Medium>,
    /// The camera's medium.
    pub camera_medium: Option<MediumId>,
    /// Camera.
    pub camera: Camera,
    /// Scattering events.
    pub max_depth: u32,
    /// Throughput below which paths play roulette; 0 turns it off.
    pub rr_threshold: f32,
    /// What is called for: by the scene, or because it is forced.
    pub calls: Calls,
    /// Texture footprints shrink with the sample count (pbrt: max(1/8, 1/√spp)).
    pub footprint_scale: f32,
    /// How direct light is estimated.
    pub estimator: Estimator,
    /// Whether next-event estimation has anything to do: lights to sample, and an estimator that does.
    pub samples_lights: bool,
    /// Whether any surface is an interface, so that rays may have to pass some.
    pub has_interfaces: bool,
}

/// A path between two events, with what the kernel `K` may change of it. Packed, so that it is plain words whatever it has.
#[repr(C, packed)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Path<K>
where
    K: Kernel,
{
    /// Where the ray starts.
    pub origin: Vec3,
    /// Unit direction.
    pub direction: Vec3,
    /// Throughput, the path's weight.
    pub beta: Rgb,
    /// Density with which the direction was drawn [1/sr]; 0 when no light sampling competes.
    pub pdf: f32,
    /// Product of squared index ratios, so that roulette ignores what will be undone on leaving.
    pub eta_scale: K::Ratio,
    /// Distance between the last scattering event and `origin` (interfaces passed on the way).
    pub travelled: K::Travelled,
    /// Key of the pixel.
    pub key: u32,
    /// Sample number with its bits reversed, as [`SetPair`](super::sampler::SetPair) takes it.
    pub sample: u32,
    /// Where its radiance is summed.
    pub slot: u32,
    /// Medium around the ray, or [`NONE`].
    pub medium: K::Medium,
    /// Its width for texture footprints, if any are wanted.
    pub cone: K::Cone,
}

/// A light sample that waits for its visibility.
#[derive(Clone, Copy, Debug)]
pub struct Shadow<K: Kernel> {
    /// From the surface to the light.
    pub ray: Ray,
    /// Added where nothing is in the way.
    pub contribution: Rgb,
    /// Where.
    pub slot: u32,
    /// Medium at its start, or [`NONE`].
    pub medium: K::Medium,
}

/// Paths that go on together, and room for what they meet. Reused from wave to wave.
pub struct Wave<K: Kernel> {
    /// Paths alive.
    pub paths: Vec<Path<K>>,
    /// What each path's ray met; those beyond the paths alive mean nothing.
    pub(super) hits: Vec<Hit>,
    /// Shadow rays of one step.
    pub(super) shadows: Vec<Shadow<K>>,
    /// Radiance by slot.
    pub radiance: Vec<Rgb>,
    /// What light samples have brought of it, until the end. A sum of its own, so that schedules in which light samples
    /// come back late add alike.
    direct: Vec<Rgb>,
}

impl<K: Kernel> Default for Wave<K> {
    fn default() -> Self {
        let (radiance, direct) = (Vec::new(), Vec::new());
        Self { paths: Vec::new(), hits: Vec::new(), shadows: Vec::new(), radiance, direct }
    }
}

/// Whether the processor has all that [`World::run_avx2`] is compiled for.
#[cfg(target_arch = "x86_64")]
fn has_avx2() -> bool {
    use std::arch::is_x86_feature_detected as has;
    has!("avx2") && has!("bmi1") && has!("bmi2") && has!("lzcnt") && has!("popcnt")
}

/// Path edges between two looks at whether to stop: some tens of milliseconds for a wave.
const STOP_EVERY: u32 = 64;

impl<'a, A: Accel + ?Sized> World<'a, A> {
    /// The kernel that has all that is called for.
    #[must_use]
    pub fn kernel(&self) -> KernelName {
        kernel_for(self.calls)
    }

    /// Adds camera paths to `wave`: samples `samples` of the pixel with centre `centre` and key `key`.
    /// `filter` draws a sample's place around the centre and its weight, which goes to `weights`.
    pub fn start<K: Kernel>(
        &self,
        wave: &mut Wave<K>,
        weights: &mut Vec<f32>,
        pixel: (Vec2, u32),
        samples: Range<u32>,
        filter: impl Fn(Vec2) -> (Vec2, f32),
    ) {
        #[cfg(target_arch = "x86_64")]
        if has_avx2() {
            // SAFETY: the processor has been found to have every feature it is compiled for.
            return unsafe { self.start_avx2(wave, weights, pixel, samples, filter) };
        }
        self.start_here(wave, weights, pixel, samples, filter);
    }

    /// [`Self::start_here`] as [`Self::run_avx2`] is [`Self::run_here`].
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn start_avx2<K: Kernel>(
        &self,
        wave: &mut Wave<K>,
        weights: &mut Vec<f32>,
        pixel: (Vec2, u32),
        samples: Range<u32>,
        filter: impl Fn(Vec2) -> (Vec2, f32),
    ) {
        self.start_here(wave, weights, pixel, samples, filter);
    }

    #[inline(always)]
    fn start_here<K: Kernel>(
        &self,
        wave: &mut Wave<K>,
        weights: &mut Vec<f32>,
        (centre, key): (Vec2, u32),
        samples: Range<u32>,
        filter: impl Fn(Vec2) -> (Vec2, f32),
    ) {
        let set = Set::new(key, 0);
        let medium = medium_index(self.camera_medium);
        for sample in samples {
            let sample = sample.reverse_bits();
            let u = set.sample(sample);
            let (offset, weight) = filter(Vec2::new(u[0], u[1]));
            weights.push(weight);
            let lens = Vec2::new(u[2], u[3]);
            let CameraRay { ray, cone } = self.camera.ray(centre + offset, lens, K::LENS);
            let scale = self.footprint_scale;
            let slot = wave.paths.len() as u32;
            wave.paths.push(Path {
                origin: ray.origin,
                direction: ray.direction,
                beta: Rgb::ONE,
                pdf: 0.0,
                eta_scale: Part::new(1.0),
                travelled: Part::new(0.0),
                key,
                sample,
                slot,
                medium: Part::new(medium),
                cone: Part::new(Cone { width: cone.width * scale, spread: cone.spread * scale }),
            });
        }
    }

    /// Runs the paths of `wave` to their end; `wave.radiance` holds the result. Asks `stop` now and
    /// then on long paths; false when it said so, and the radiance is then of no use.
    pub fn run<K: Kernel>(
        &self,
        wave: &mut Wave<K>,
        counters: &mut Counters,
        stop: &dyn Fn() -> bool,
    ) -> bool {
        #[cfg(target_arch = "x86_64")]
        if has_avx2() {
            // SAFETY: the processor has been found to have every feature it is compiled for.
            return unsafe { self.run_avx2(wave, counters, stop) };
        }
        self.run_here(wave, counters, stop)
    }

    /// [`Self::run_here`] compiled for processors from 2013 on: the same operations in the same
    /// order, so the same bits, in fewer and wider instructions.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn run_avx2<K: Kernel>(
        &self,
        wave: &mut Wave<K>,
        counters: &mut Counters,
        stop: &dyn Fn() -> bool,
    ) -> bool {
        self.run_here(wave, counters, stop)
    }

    #[inline(always)]
    fn run_here<K: Kernel>(
        &self,
        wave: &mut Wave<K>,
        counters: &mut Counters,
        stop: &dyn Fn() -> bool,
    ) -> bool {
        let count = wave.paths.len();
        wave.radiance.clear();
        wave.radiance.resize(count, Rgb::ZERO);
        wave.direct.clear();
        wave.direct.resize(count, Rgb::ZERO);
        wave.hits.resize(count, Hit::MISS);
        for depth in 0..=self.max_depth {
            if wave.paths.is_empty() {
                break;
            }
            if depth % STOP_EVERY == STOP_EVERY - 1 && stop() {
                wave.paths.clear();
                return false;
            }
            if depth == self.max_depth && depth > 0 {
                self.last_step(wave, counters);
                break;
            }
            self.trace(wave, counters);
            self.shade(wave, depth);
            self.connect(wave, counters);
        }
        wave.paths.clear();
        for (radiance, direct) in wave.radiance.iter_mut().zip(&wave.direct) {
            *radiance += *direct;
        }
        true
    }

    /// Finds what every path's ray meets, passing interfaces.
    #[inline(always)]
    fn trace<K: Kernel>(&self, wave: &mut Wave<K>, counters: &mut Counters) {
        enter(Room::TraceClosest);
        let hits = &mut wave.hits[..wave.paths.len()];
        counters.closest += hits.len() as u64;
        for (path, hit) in wave.paths.iter().zip(&mut *hits) {
            *hit = self.accel.closest(&Ray::new(path.origin, path.direction));
        }
        if K::MEDIA && self.has_interfaces {
            for (path, hit) in wave.paths.iter_mut().zip(hits) {
                self.pass_interfaces(path, hit, counters);
            }
        }
    }

    /// Adds the light samples that nothing occludes.
    #[inline(always)]
    fn connect<K: Kernel>(&self, wave: &mut Wave<K>, counters: &mut Counters) {
        enter(Room::TraceOcclusion);
        counters.occluded += wave.shadows.len() as u64;
        for shadow in &wave.shadows {
            let transmitted = if K::MEDIA && (self.has_interfaces || K::medium(shadow.medium) != NONE) {
                self.transmitted(shadow, counters)
            } else if self.accel.occluded(&shadow.ray) {
                Rgb::ZERO
            } else {
                Rgb::ONE
            };
            wave.direct[shadow.slot as usize] += shadow.contribution * transmitted;
        }
    }

    /// The last ray of a path can only find emission. Where few surfaces emit, the ray is tried
    /// against those alone; only what finds one there is traced in full, and what finds none asks
    /// no more than whether the sky is open. Same picture, fewer nodes.
    #[inline(always)]
    fn last_step<K: Kernel>(&self, wave: &mut Wave<K>, counters: &mut Counters) {
        enter(Room::TraceOcclusion);
        let sky = self.lights.has_background();
        if !(K::MEDIA && self.has_interfaces) {
            let mut kept = 0;
            for i in 0..wave.paths.len() {
                let path = wave.paths[i];
                if self.may_emit(&path, counters) {
                    wave.paths[kept] = path;
                    kept += 1;
                } else if sky {
                    counters.occluded += 1;
                    if !self.accel.occluded(&Ray::new(path.origin, path.direction)) {
                        self.add_background(&path, &mut wave.radiance[path.slot as usize]);
                    }
                }
            }
            wave.paths.truncate(kept);
        }
        self.trace(wave, counters);
        self.shade(wave, self.max_depth);
    }

    /// Whether the ray of `path` may run into a surface that emits.
    #[inline(always)]
    pub(super) fn may_emit<K: Kernel>(&self, path: &Path<K>, counters: &mut Counters) -> bool {
        match self.emitters_only {
            Some(emitters) => {
                counters.occluded += 1;
                emitters.occluded(&Ray::new(path.origin, path.direction))
            }
            None => !self.lights.emitters.is_empty(),
        }
    }

    /// [`Self::shade`] for whoever traces by itself.
    pub(super) fn shade_wave<K: Kernel>(&self, wave: &mut Wave<K>, depth: u32) {
        #[cfg(target_arch = "x86_64")]
        if has_avx2() {
            // SAFETY: the processor has been found to have every feature it is compiled for.
            return unsafe { self.shade_avx2(wave, depth) };
        }
        self.shade(wave, depth);
    }

    /// [`Self::shade`] as [`Self::run_avx2`] is [`Self::run_here`].
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn shade_avx2<K: Kernel>(&self, wave: &mut Wave<K>, depth: u32) {
        self.shade(wave, depth);
    }
}

impl<K: Kernel> Path<K> {
    /// Decides between mixed materials; the same for all who ask about one vertex.
    #[inline(always)]
    pub(super) fn choice_key(&self) -> u32 {
        self.key ^ self.sample.reverse_bits()
    }

    /// The last scattering event, from which light sampling would have started.
    #[inline(always)]
    pub(super) fn reference(&self) -> Vec3 {
        let travelled = self.travelled.or(0.0);
        if travelled == 0.0 { self.origin } else { self.origin - self.direction * travelled }
    }
}
