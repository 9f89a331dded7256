//! Hits become radiance, shadow rays and next rays: emission that a path found itself, light sampling and
//! the next direction. Traces nothing; `path.rs` does.
//!
//! Next-event estimation and multiple importance sampling with the power heuristic (Veach 1997);
//! pbrt-v4's roulette rules (4th ed., §13.4).

use super::bsdf::{BsdfSample, Scatter};
use super::cone::{self, Cone, Event, sample_angle};
use super::draws::{Draws, LANES};
use super::kernel::{Kernel, Part};
use super::lights::{Emitter, NO_LIGHT, power_heuristic};
use super::materials::Scattering;
use super::media::cross;
use super::path::{Path, Shadow, SurfaceShading, Wave, World};
use crate::accel::{Accel, Hit, NONE, Ray};
use crate::clock::{Room, enter};
use crate::color::Rgb;
use crate::geometry::{Needs, SurfacePoint, offset_origin};
use crate::math::Frame;
use crate::prepare::Calls;
use crate::settings::Estimator;
use crate::texture::TextureCoordinates;
use glam::{Vec2, Vec3, Vec3A};

/// How far ahead of shading memory is asked for: indices first, then what they name.
const PREFETCH_INDICES: usize = 12;
const PREFETCH_VERTICES: usize = 6;

impl<A: Accel + ?Sized> World<'_, A> {
    /// Turns hits into radiance, shadow rays and next rays; keeps the paths that go on, in order.
    #[inline(always)]
    pub(super) fn shade<K: Kernel>(&self, wave: &mut Wave<K>, depth: u32) {
        enter(Room::Shade);
        let Wave { paths, hits, shadows, radiance, .. } = wave;
        let hits = &hits[..paths.len()];
        shadows.clear();
        self.materials.textures().store().set_depth(depth);
        let mut draws = Draws::new(depth);
        let mut kept = 0;
        let images = self.lights.has_images();
        for start in (0..hits.len()).step_by(LANES) {
            let group = start..(start + LANES).min(hits.len());
            if depth < self.max_depth {
                draws.draw(&paths[group.clone()]);
            }
            if images {
                self.look_ahead(&paths[group.clone()], &hits[group.clone()], &draws, depth);
            }
            for i in group {
                if let Some(hit) = hits.get(i + PREFETCH_INDICES) {
                    self.geometry.prefetch_indices(hit, K::KINDS);
                }
                if let Some(hit) = hits.get(i + PREFETCH_VERTICES) {
                    self.geometry.prefetch_vertices(hit, K::KINDS);
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

    /// Asks for what a group of paths will read of images of light: those that met nothing what they see, and the others
    /// what they sample. Each waits for memory then, one after the other; here they wait together.
    #[inline(never)]
    fn look_ahead<K: Kernel>(&self, paths: &[Path<K>], hits: &[Hit], draws: &Draws, depth: u32) {
        let sampled = |lane: usize| {
            let &[.., a, b, c, d] = draws.numbers(lane);
            let samples = self.samples_lights && depth < self.max_depth && hits[lane].geometry != NONE;
            samples.then(|| self.lights.image_for([a, b, c, d])).flatten()
        };
        for (lane, path) in paths.iter().enumerate() {
            if hits[lane].geometry == NONE {
                self.lights.soon_background(path.direction, path.pdf);
            } else if let Some((map, u)) = sampled(lane) {
                map.soon_sampled(u);
            }
        }
        for lane in 0..paths.len() {
            if let Some((map, u)) = sampled(lane) {
                map.soon_seen(u);
            }
        }
    }

    /// Radiance from where no surface is.
    #[inline(always)]
    pub(super) fn add_background<K: Kernel>(&self, path: &Path<K>, radiance: &mut Rgb) {
        // A medium without end absorbs what comes from infinitely far.
        let beta = path.beta * self.transmittance(K::medium(path.medium), f32::INFINITY);
        *radiance += beta * self.lights.background(path.direction, path.pdf);
    }

    /// Emission of a surface towards the path of weight `beta`, weighted against light sampling.
    #[inline(always)]
    fn add_emission<K: Kernel>(
        &self,
        path: &Path<K>,
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
            let distance = path.travelled.or(0.0) + hit.t;
            let at = Vec2::new(hit.u, hit.v);
            let pdf = self.lights.pdf_area(path.reference(), light, point, at, distance, cos.abs());
            weight = power_heuristic(path.pdf, pdf);
        }
        *radiance += beta * self.lights.emitted(emitter, light, point.uv) * weight;
    }

    /// The path behind what `path` met; `None` where it ends.
    #[inline(always)]
    fn shade_one<K: Kernel>(
        &self,
        path: &Path<K>,
        hit: &Hit,
        depth: u32,
        draw: (&[f32; 8], Vec3),
        radiance: &mut Rgb,
        shadows: &mut Vec<Shadow<K>>,
    ) -> Option<Path<K>> {
        if hit.geometry == NONE {
            self.add_background(path, radiance);
            return None;
        }
        let surface = self.geometry.surface_of(hit, K::KINDS);
        let shading = &self.shading[surface];
        let ray = || Ray::new(path.origin, path.direction);
        let point = &self.geometry.surface_point(hit, surface, ray, K::KINDS);
        let mut beta = path.beta;
        if K::MEDIA && K::medium(path.medium) != NONE {
            beta *= self.transmittance(K::medium(path.medium), hit.t);
        }
        if shading.emitter != NONE {
            let emitter = &self.lights.emitters[shading.emitter as usize];
            self.add_emission(path, beta, hit, point, emitter, radiance);
        }
        if depth >= self.max_depth {
            return None;
        }
        let scattering = self.materials.scattering::<K>(
            shading.material,
            // A call would need all of it in memory, of which most look-ups read little.
            #[inline(always)]
            || {
                let mut at = self.coordinates(point, path.choice_key());
                if K::FOOTPRINTS && shading.needs.has(Needs::FOOTPRINT) {
                    self.add_footprint(&mut at, path, hit, surface, point);
                }
                at
            },
            || path.choice_key(),
        );
        match scattering {
            Scattering::Diffuse(d) => self.scatter(&d, path, beta, hit, shading, point, depth, draw, shadows),
            Scattering::Other(b) if K::LOBES => {
                self.scatter(&b, path, beta, hit, shading, point, depth, draw, shadows)
            }
            // An interface that `trace` did not pass, because it emits.
            Scattering::Passes if K::MEDIA => {
                let direction = path.direction.into();
                Some(Path {
                    beta,
                    travelled: Part::new(path.travelled.or(0.0) + hit.t),
                    origin: offset_origin(point.p, point.error, point.ng, direction).into(),
                    medium: cross::<K>(shading.medium, point.ng, direction, path.medium),
                    ..*path
                })
            }
            Scattering::Other(_) | Scattering::Passes => {
                unreachable!("the kernel has what materials call for")
            }
        }
    }

    /// Light sampling and the next direction at a surface that scatters. Compiled for each kind of
    /// scattering function that it is called with.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "the parts of one vertex; a record of them costs copies")]
    fn scatter<K: Kernel>(
        &self,
        bsdf: &impl Scatter,
        path: &Path<K>,
        mut beta: Rgb,
        hit: &Hit,
        shading: &SurfaceShading,
        point: &SurfacePoint,
        depth: u32,
        (u, cosine): (&[f32; 8], Vec3),
        shadows: &mut Vec<Shadow<K>>,
    ) -> Option<Path<K>> {
        let frame = if K::LOBES && shading.needs.has(Needs::TANGENT) {
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
                    medium: cross::<K>(shading.medium, point.ng, light.wi, path.medium),
                });
            }
        }

        let s = bsdf.sample(wo, u[2], Vec2::new(u[0], u[1]), cosine)?;
        beta *= s.weight;
        let mut eta_scale = path.eta_scale.or(1.0);
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
            eta_scale: Part::new(eta_scale),
            travelled: Part::new(0.0),
            medium: cross::<K>(shading.medium, point.ng, wide, path.medium),
            cone: if K::FOOTPRINTS && self.calls.has(Calls::FOOTPRINTS) {
                Part::new(self.next_cone(path, hit, point, &s, direction))
            } else {
                path.cone
            },
            ..*path
        })
    }

    /// Where the textures of a surface are asked for, without a footprint.
    #[inline(always)]
    pub(super) fn coordinates(&self, point: &SurfacePoint, key: u32) -> TextureCoordinates {
        TextureCoordinates { key, ..TextureCoordinates::at(point.uv, point.p.into(), point.ns.into()) }
    }

    /// Adds what the path's cone covers of the surface.
    #[inline(always)]
    fn add_footprint<K: Kernel>(
        &self,
        at: &mut TextureCoordinates,
        path: &Path<K>,
        hit: &Hit,
        surface: usize,
        point: &SurfacePoint,
    ) {
        let width = path.cone.or(Cone::default()).width_at(path.travelled.or(0.0) + hit.t);
        let ellipse = cone::ellipse(width, path.direction.into(), point.ng);
        let tangents = self.geometry.tangents(hit, surface, || Ray::new(path.origin, path.direction));
        [at.dp_dx, at.dp_dy] = ellipse.axes();
        [at.duv_dx, at.duv_dy] = tangents.uv(&ellipse);
    }

    /// The path's cone behind the surface, in `direction`.
    #[inline(always)]
    fn next_cone<K: Kernel>(
        &self,
        path: &Path<K>,
        hit: &Hit,
        point: &SurfacePoint,
        s: &BsdfSample,
        direction: Vec3,
    ) -> Cone {
        let n = Vec3::from(point.ns);
        let cos = path.direction.dot(n);
        // A lobe this wide hides what curvature adds.
        let narrow = s.delta || s.pdf > 1.0;
        let curvature =
            if narrow { self.geometry.curvature(hit, self.geometry.surface_of(hit, K::KINDS)) } else { 0.0 };
        let event = Event {
            // Seen from behind, what bulges is hollow.
            curvature: if cos < 0.0 { curvature } else { -curvature },
            cos_in: cos.abs(),
            cos_out: direction.dot(n).abs(),
            through: s.transmission.then_some(s.eta),
            rough: if s.delta { 0.0 } else { sample_angle(s.pdf, self.footprint_scale) },
        };
        path.cone.or(Cone::default()).after(path.travelled.or(0.0) + hit.t, &event)
    }
}
