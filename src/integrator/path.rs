//! One step of a path: hits become radiance, shadow rays and next rays. A path is a plain record
//! that can be put down and taken up; steps run over slices of them, so that a scheduler may
//! decide which paths come together. Never waits for I/O, and does not know who called it.
//!
//! Next-event estimation and multiple importance sampling with the power heuristic (Veach 1997);
//! pbrt-v4's depth and roulette rules (4th ed., §13.4).

use crate::accel::{Accel, Hit, NONE, Ray};
use crate::color::Rgb;
use crate::geometry::{Needs, SurfacePoint, Surfaces, offset_origin};
use crate::integrator::bsdf::Scatter;
use crate::integrator::camera::Camera;
use crate::integrator::draws::{Draws, LANES};
use crate::integrator::lights::{Emitter, Lights, NO_LIGHT, power_heuristic};
use crate::integrator::materials::{Materials, Scattering};
use crate::integrator::media::{cross, medium_index};
use crate::math::Frame;
use crate::scene::{Medium, MediumId, MediumInterface};
use crate::settings::Estimator;
use crate::stats::Counters;
use crate::texture::TextureCoordinates;
use glam::{Vec2, Vec3, Vec3A};

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
pub struct World<'a, A> {
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
    /// Texture footprints shrink with the sample count (pbrt: max(1/8, 1/√spp)).
    pub footprint_scale: f32,
    /// How direct light is estimated.
    pub estimator: Estimator,
    /// Whether next-event estimation has anything to do: lights to sample, and an estimator that does.
    pub samples_lights: bool,
    /// Whether any surface is an interface, so that rays may have to pass some.
    pub has_interfaces: bool,
}

/// A path between two events.
#[derive(Clone, Copy, Debug)]
pub struct Path {
    /// Where the ray starts.
    pub origin: Vec3,
    /// Unit direction.
    pub direction: Vec3,
    /// Throughput, the path's weight.
    pub beta: Rgb,
    /// Density with which the direction was drawn [1/sr]; 0 when no light sampling competes.
    pub pdf: f32,
    /// Product of squared index ratios, so that roulette ignores what will be undone on leaving.
    pub eta_scale: f32,
    /// Distance between the last scattering event and `origin` (interfaces passed on the way).
    pub travelled: f32,
    /// Key of the pixel.
    pub key: u32,
    /// Sample number with its bits reversed, as [`SetPair`](super::sampler::SetPair) takes it.
    pub sample: u32,
    /// Where its radiance is summed.
    pub slot: u32,
    /// Medium around the ray, or [`NONE`].
    pub medium: u32,
}

/// A light sample that waits for its visibility.
#[derive(Clone, Copy, Debug)]
pub struct Shadow {
    /// From the surface to the light.
    pub ray: Ray,
    /// Added where nothing is in the way.
    pub contribution: Rgb,
    /// Where.
    pub slot: u32,
    /// Medium at its start, or [`NONE`].
    pub medium: u32,
}

/// Paths that go on together, and room for what they meet. Reused from wave to wave.
#[derive(Default)]
pub struct Wave {
    /// Paths alive.
    pub paths: Vec<Path>,
    /// What each path's ray met; those beyond the paths alive mean nothing.
    hits: Vec<Hit>,
    /// Shadow rays of one step.
    shadows: Vec<Shadow>,
    /// Radiance by slot.
    pub radiance: Vec<Rgb>,
}

/// Whether the processor has all that [`World::run_avx2`] is compiled for.
#[cfg(target_arch = "x86_64")]
fn has_avx2() -> bool {
    use std::arch::is_x86_feature_detected as has;
    has!("avx2") && has!("bmi1") && has!("bmi2") && has!("lzcnt") && has!("popcnt")
}

/// Path edges between two looks at whether to stop: some tens of milliseconds for a wave.
const STOP_EVERY: u32 = 64;

/// How far ahead of shading memory is asked for: indices first, then what they name.
const PREFETCH_INDICES: usize = 12;
const PREFETCH_VERTICES: usize = 6;

impl<'a, A: Accel> World<'a, A> {
    /// A camera path for the raster position `raster` (pixels).
    #[inline(always)]
    #[must_use]
    pub fn camera_path(&self, raster: Vec2, lens: Vec2, key: u32, sample: u32, slot: u32) -> Path {
        let ray = self.camera.ray(raster, lens).ray;
        Path {
            origin: ray.origin,
            direction: ray.direction,
            beta: Rgb::ONE,
            pdf: 0.0,
            eta_scale: 1.0,
            travelled: 0.0,
            key,
            sample: sample.reverse_bits(),
            slot,
            medium: medium_index(self.camera_medium),
        }
    }

    /// Runs the paths of `wave` to their end; `wave.radiance` holds the result. Asks `stop` now and
    /// then on long paths; false when it said so, and the radiance is then of no use.
    pub fn run(&self, wave: &mut Wave, counters: &mut Counters, stop: &dyn Fn() -> bool) -> bool {
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
    fn run_avx2(&self, wave: &mut Wave, counters: &mut Counters, stop: &dyn Fn() -> bool) -> bool {
        self.run_here(wave, counters, stop)
    }

    #[inline(always)]
    fn run_here(&self, wave: &mut Wave, counters: &mut Counters, stop: &dyn Fn() -> bool) -> bool {
        let count = wave.paths.len();
        wave.radiance.clear();
        wave.radiance.resize(count, Rgb::ZERO);
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
        true
    }

    /// Finds what every path's ray meets, passing interfaces.
    #[inline(always)]
    fn trace(&self, wave: &mut Wave, counters: &mut Counters) {
        let hits = &mut wave.hits[..wave.paths.len()];
        counters.closest += hits.len() as u64;
        for (path, hit) in wave.paths.iter().zip(&mut *hits) {
            *hit = self.accel.closest(&Ray::new(path.origin, path.direction));
        }
        if self.has_interfaces {
            for (path, hit) in wave.paths.iter_mut().zip(hits) {
                self.pass_interfaces(path, hit, counters);
            }
        }
    }

    /// Turns hits into radiance, shadow rays and next rays; keeps the paths that go on, in order.
    #[inline(always)]
    fn shade(&self, wave: &mut Wave, depth: u32) {
        let Wave { paths, hits, shadows, radiance } = wave;
        let hits = &hits[..paths.len()];
        shadows.clear();
        let mut draws = Draws::new(depth);
        let mut kept = 0;
        for start in (0..hits.len()).step_by(LANES) {
            let group = start..(start + LANES).min(hits.len());
            if depth < self.max_depth {
                draws.draw(&paths[group.clone()]);
            }
            for i in group {
                if let Some(hit) = hits.get(i + PREFETCH_INDICES) {
                    self.geometry.prefetch_indices(hit);
                }
                if let Some(hit) = hits.get(i + PREFETCH_VERTICES) {
                    self.geometry.prefetch_vertices(hit);
                }
                let (path, draw) = (&paths[i], (draws.numbers(i - start), draws.cosine(i - start)));
                let radiance = &mut radiance[path.slot as usize];
                if let Some(next) = self.shade_one(path, &hits[i], depth, draw, radiance, shadows) {
                    paths[kept] = next;
                    kept += 1;
                }
            }
        }
        paths.truncate(kept);
    }

    /// Radiance from where no surface is.
    #[inline(always)]
    fn add_background(&self, path: &Path, radiance: &mut Rgb) {
        // A medium without end absorbs what comes from infinitely far.
        let beta = path.beta * self.transmittance(path.medium, f32::INFINITY);
        *radiance += beta * self.lights.background(path.direction, path.pdf);
    }

    /// Emission of a surface towards the path of weight `beta`, weighted against light sampling.
    #[inline(always)]
    fn add_emission(
        &self,
        path: &Path,
        beta: Rgb,
        hit: &Hit,
        point: &SurfacePoint,
        emitter: &Emitter,
        radiance: &mut Rgb,
    ) {
        let cos = -path.direction.dot(point.ng.into());
        if cos <= 0.0 && !emitter.two_sided {
            return;
        }
        let light = emitter.light_of(hit.primitive);
        if light == NO_LIGHT {
            return;
        }
        let mut weight = 1.0;
        if path.pdf > 0.0 {
            let distance = path.travelled + hit.t;
            let at = Vec2::new(hit.u, hit.v);
            let pdf = self.lights.pdf_area(path.reference(), light, point, at, distance, cos.abs());
            weight = power_heuristic(path.pdf, pdf);
        }
        *radiance += beta * self.lights.emitted(emitter, light, point.uv) * weight;
    }

    /// The path behind what `path` met; `None` where it ends.
    #[inline(always)]
    fn shade_one(
        &self,
        path: &Path,
        hit: &Hit,
        depth: u32,
        draw: (&[f32; 8], Vec3),
        radiance: &mut Rgb,
        shadows: &mut Vec<Shadow>,
    ) -> Option<Path> {
        if hit.geometry == NONE {
            self.add_background(path, radiance);
            return None;
        }
        let surface = self.geometry.surface_of(hit);
        let shading = &self.shading[surface];
        let point = &self.geometry.surface_point(hit, surface, || Ray::new(path.origin, path.direction));
        let mut beta = path.beta;
        if path.medium != NONE {
            beta *= self.transmittance(path.medium, hit.t);
        }
        if shading.emitter != NONE {
            let emitter = &self.lights.emitters[shading.emitter as usize];
            self.add_emission(path, beta, hit, point, emitter, radiance);
        }
        if depth >= self.max_depth {
            return None;
        }
        let at = || self.coordinates(point, shading.needs);
        match self.materials.scattering(shading.material, at, || path.choice_key()) {
            Scattering::Diffuse(d) => self.scatter(&d, path, beta, shading, point, depth, draw, shadows),
            Scattering::Other(b) => self.scatter(&b, path, beta, shading, point, depth, draw, shadows),
            // An interface that `trace` did not pass, because it emits.
            Scattering::Passes => {
                let direction = path.direction.into();
                Some(Path {
                    beta,
                    travelled: path.travelled + hit.t,
                    origin: offset_origin(point.p, point.error, point.ng, direction).into(),
                    medium: cross(shading.medium, point.ng, direction, path.medium),
                    ..*path
                })
            }
        }
    }

    /// Light sampling and the next direction at a surface that scatters. Compiled for each kind of
    /// scattering function that it is called with.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "the parts of one vertex; a record of them costs copies")]
    fn scatter(
        &self,
        bsdf: &impl Scatter,
        path: &Path,
        mut beta: Rgb,
        shading: &SurfaceShading,
        point: &SurfacePoint,
        depth: u32,
        (u, cosine): (&[f32; 8], Vec3),
        shadows: &mut Vec<Shadow>,
    ) -> Option<Path> {
        let frame = if shading.needs.has(Needs::TANGENT) {
            Frame::from_z_x(point.ns.into(), point.dpdu)
        } else {
            Frame::from_z(point.ns.into())
        };
        let wo = frame.to_local(-path.direction);

        if self.samples_lights
            && !bsdf.is_delta()
            && let Some(light) = self.lights.sample(point.p, [u[4], u[5], u[6], u[7]])
        {
            let wi = frame.to_local(light.wi.into());
            let (f, pdf) = bsdf.eval(wo, wi);
            if f != Rgb::ZERO {
                let plain = light.delta || self.estimator == Estimator::Lights;
                let weight = if plain { 1.0 } else { power_heuristic(light.pdf, pdf) };
                shadows.push(Shadow {
                    ray: light.ray_from(point.p, point.error, point.ng),
                    contribution: beta * f * light.radiance * (weight / light.pdf),
                    slot: path.slot,
                    medium: cross(shading.medium, point.ng, light.wi, path.medium),
                });
            }
        }

        let s = bsdf.sample(wo, u[2], Vec2::new(u[0], u[1]), cosine)?;
        beta *= s.weight;
        let mut eta_scale = path.eta_scale;
        if s.transmission {
            eta_scale *= s.eta * s.eta;
        }
        // Russian roulette from the second scattering event on, as pbrt-v4 does.
        let weight = beta.max_element() * eta_scale;
        if weight < self.rr_threshold && depth >= 1 {
            let q = (1.0 - weight).max(0.0);
            if u[3] < q {
                return None;
            }
            beta /= 1.0 - q;
        }
        if beta == Rgb::ZERO {
            return None;
        }
        let direction = frame.to_world(s.wi);
        let wide = Vec3A::from(direction);
        Some(Path {
            origin: offset_origin(point.p, point.error, point.ng, wide).into(),
            direction,
            beta,
            pdf: match self.estimator {
                Estimator::Scattering => 0.0,
                _ if s.delta => 0.0,
                Estimator::Both => s.pdf,
                // So improbable beside light sampling that the heuristic gives it no weight.
                Estimator::Lights => f32::MIN_POSITIVE,
            },
            eta_scale,
            travelled: 0.0,
            medium: cross(shading.medium, point.ng, wide, path.medium),
            ..*path
        })
    }

    /// Where the textures of a surface are asked for.
    #[inline(always)]
    pub(super) fn coordinates(&self, point: &SurfacePoint, needs: Needs) -> TextureCoordinates {
        TextureCoordinates {
            uv: point.uv,
            p: point.p.into(),
            n: point.ns.into(),
            width: if needs.has(Needs::FOOTPRINT) { self.footprint(point) } else { 0.0 },
        }
    }

    /// Width in texture units of a pixel as the camera would see it at `point` (pbrt-v4's
    /// approximation for every bounce, 4th ed. §10.1.3).
    #[inline]
    fn footprint(&self, point: &SurfacePoint) -> f32 {
        self.camera.pixel_width_at(point.p.into(), point.ng.into()) * point.uv_rate * self.footprint_scale
    }

    /// Adds the light samples that nothing occludes.
    #[inline(always)]
    fn connect(&self, wave: &mut Wave, counters: &mut Counters) {
        counters.occluded += wave.shadows.len() as u64;
        for shadow in &wave.shadows {
            let transmitted = if self.has_interfaces || shadow.medium != NONE {
                self.transmitted(shadow, counters)
            } else if self.accel.occluded(&shadow.ray) {
                Rgb::ZERO
            } else {
                Rgb::ONE
            };
            wave.radiance[shadow.slot as usize] += shadow.contribution * transmitted;
        }
    }

    /// The last ray of a path can only find emission. Where few surfaces emit, the ray is tried
    /// against those alone; only what finds one there is traced in full, and what finds none asks
    /// no more than whether the sky is open. Same picture, fewer nodes.
    #[inline(always)]
    fn last_step(&self, wave: &mut Wave, counters: &mut Counters) {
        let sky = self.lights.has_background();
        let plain = self.has_interfaces;
        if !plain {
            let mut kept = 0;
            for i in 0..wave.paths.len() {
                let path = wave.paths[i];
                let ray = Ray::new(path.origin, path.direction);
                let may_emit = match self.emitters_only {
                    Some(emitters) => {
                        counters.occluded += 1;
                        emitters.occluded(&ray)
                    }
                    None => !self.lights.emitters.is_empty(),
                };
                if may_emit {
                    wave.paths[kept] = path;
                    kept += 1;
                } else if sky {
                    counters.occluded += 1;
                    if !self.accel.occluded(&ray) {
                        self.add_background(&path, &mut wave.radiance[path.slot as usize]);
                    }
                }
            }
            wave.paths.truncate(kept);
        }
        self.trace(wave, counters);
        self.shade(wave, self.max_depth);
    }
}

impl Path {
    /// Decides between mixed materials; the same for all who ask about one vertex.
    #[inline(always)]
    pub(super) fn choice_key(&self) -> u32 {
        self.key ^ self.sample.reverse_bits()
    }

    /// The last scattering event, from which light sampling would have started.
    #[inline(always)]
    fn reference(&self) -> Vec3 {
        self.origin - self.direction * self.travelled
    }
}
