//! All lights of a scene: which one to sample, how, and with what density. A constant sky is not
//! sampled: every scattering function's own sampling beats a uniform sphere of directions, so a
//! shadow ray towards it would cost time and add noise.
//!
//! Invariant: `pdf_area` and `background` weigh with exactly the densities that `sample` draws
//! with. Never traces a ray.

use crate::accel::Ray;
use crate::color::Rgb;
use crate::geometry::{SurfacePoint, blend_corners, offset_origin};
use crate::integrator::light::cylinder::Cylinder;
use crate::integrator::light::delta::DeltaLight;
use crate::integrator::light::disk::Disk;
use crate::integrator::light::env::EnvironmentMap;
use crate::integrator::light::parallelogram::Parallelogram;
use crate::integrator::light::patch::Patch;
use crate::integrator::light::sphere::Sphere;
use crate::integrator::light::tree::LightTree;
use crate::integrator::light::{WideSample, triangle};
use crate::math::gamma;
use crate::prepare::Calls;
use crate::scene::{Channels, ImageId, TextureFilter, TextureId, Wrap};
use crate::texture::{Footprint, Sampler, TextureCoordinates, Textures};
use glam::{Vec2, Vec3, Vec3A};
use std::sync::Arc;

/// A surface that emits.
pub struct Emitter {
    /// Index of the surface.
    pub surface: u32,
    /// Both sides emit.
    pub two_sided: bool,
    /// Image over (u, v), a factor.
    pub image: Option<ImageId>,
    /// Light of each primitive.
    pub(super) light_by_primitive: Vec<u32>,
}

impl Emitter {
    /// The light that primitive `primitive` belongs to; [`NO_LIGHT`] for one without area.
    #[inline(always)]
    #[must_use]
    pub fn light_of(&self, primitive: u32) -> u32 {
        self.light_by_primitive[primitive as usize]
    }
}

/// A primitive that no light covers, because it has no area to sample.
pub const NO_LIGHT: u32 = u32::MAX;

/// What a light with a place looks like.
pub(super) enum Place {
    Parallelogram(Parallelogram),
    Triangle([Vec3; 3]),
    Patch(Patch),
    Sphere(Sphere),
    Disk(Disk),
    Cylinder(Cylinder),
    Delta(DeltaLight),
}

/// A light with a place.
pub(super) struct Bounded {
    pub(super) place: Place,
    /// Radiance, scale and power included; unused for delta lights.
    pub(super) radiance: Rgb,
    /// Whether it emits against the normal that sampling gives.
    pub(super) flip: bool,
    /// Its emitter; unused for delta lights.
    pub(super) emitter: u32,
    /// How much of it is there.
    pub(super) opacity: Opacity,
}

/// Alpha of an emitting surface.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Opacity {
    /// None, or 1 everywhere.
    Solid,
    /// Rays find it with this probability.
    Texture(TextureId),
    /// 0 everywhere: no ray finds it, but it lights, which is pbrt's way to hide a light.
    Hidden,
}

/// A light infinitely far away that is sampled.
pub(super) enum Infinite {
    Distant { irradiance: Rgb, towards: Vec3 },
    Image { map: Box<EnvironmentMap>, scale: Rgb },
}

/// A direction towards a light.
pub struct LightSample {
    /// Unit direction.
    pub wi: Vec3A,
    /// Radiance along it (for delta lights the irradiance of a facing surface).
    pub radiance: Rgb,
    /// Density [1/sr] with the choice of the light included; for delta lights the choice alone.
    pub pdf: f32,
    /// No scattering function could have found it.
    pub delta: bool,
    target: Target,
}

/// Where a shadow ray ends.
enum Target {
    Infinity,
    /// A point without a surface.
    Point(Vec3A),
    /// A point of a surface and its normal.
    Surface(Vec3A, Vec3A),
}

impl LightSample {
    /// The shadow ray from the surface point `p` that the light was sampled from, known to `error`;
    /// ends just before the light.
    #[inline(always)]
    #[must_use]
    pub fn ray_from(&self, p: Vec3A, error: f32, ng: Vec3A) -> Ray {
        let origin = offset_origin(p, error, ng, self.wi);
        let end = match self.target {
            Target::Infinity => return Ray::new(origin.into(), self.wi.into()),
            Target::Point(target) => target,
            Target::Surface(target, n) => {
                // For a sphere or cylinder the rounding scales with the shape as well; both are
                // within the largest coordinate unless the shape surrounds the origin.
                let error = LIGHT_POINT * (target.abs().max_element() + (target - p).abs().max_element());
                offset_origin(target, error, n, -self.wi)
            }
        };
        Ray { origin: origin.into(), direction: (end - origin).into(), t_min: 0.0, t_max: 1.0 }
    }
}

/// Bound on the relative rounding of a point sampled on a light, per unit of coordinate.
const LIGHT_POINT: f32 = gamma(16);

/// The lights of a scene. Built by [`super::lights_build`].
pub struct Lights {
    /// Emitting surfaces.
    pub emitters: Vec<Emitter>,
    pub(super) bounded: Vec<Bounded>,
    pub(super) tree: Option<LightTree>,
    pub(super) infinite: Vec<Infinite>,
    pub(super) constant: Rgb,
    /// Probability of choosing among the infinite ones.
    pub(super) choose_infinite: f32,
    /// One bounded light and no other: nothing to choose.
    pub(super) single: bool,
    pub(super) textures: Arc<Textures>,
    /// Texture coordinates of the corners of triangles and patches with an image or a mask, by light.
    pub(super) textured_corners: Vec<(u32, [Vec2; 4])>,
}

impl Lights {
    /// What they ask of a kernel.
    #[must_use]
    pub fn calls(&self) -> Calls {
        let mask = |light: &Bounded| matches!(light.opacity, Opacity::Texture(_));
        let textured = self.emitters.iter().any(|e| e.image.is_some()) || self.bounded.iter().any(mask);
        let other = !self.single || self.constant != Rgb::ZERO;
        Calls::NONE.and_if(textured, Calls::TEXTURES).and_if(other, Calls::LIGHTS)
    }

    /// Chooses among lights even where there is one.
    pub fn always_choose(&mut self) {
        self.single = false;
    }

    /// Whether any light is worth a shadow ray.
    #[inline(always)]
    #[must_use]
    pub fn can_be_sampled(&self) -> bool {
        self.tree.is_some() || !self.infinite.is_empty()
    }

    /// Whether rays that leave the scene find light.
    #[inline(always)]
    #[must_use]
    pub fn has_background(&self) -> bool {
        self.constant != Rgb::ZERO || self.has_images()
    }

    /// Bytes held by environment maps and the light tree.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let maps = self.infinite.iter().map(|l| match l {
            Infinite::Image { map, .. } => map.bytes(),
            Infinite::Distant { .. } => 0,
        });
        let tree = self.tree.as_ref().map_or(0, LightTree::bytes);
        maps.sum::<u64>() + (tree + self.bounded.len() * size_of::<Bounded>()) as u64
    }

    /// Whether any light is an image.
    #[inline(always)]
    #[must_use]
    pub fn has_images(&self) -> bool {
        self.infinite.iter().any(|l| matches!(l, Infinite::Image { .. }))
    }

    /// A hint that [`Self::background`] will be asked.
    #[inline]
    pub fn soon_background(&self, direction: Vec3, pdf: f32) {
        for light in &self.infinite {
            if let Infinite::Image { map, .. } = light {
                map.soon(direction, pdf > 0.0);
            }
        }
    }

    /// The image that [`Self::sample`] samples for `u`, if any, and where.
    #[inline]
    #[must_use]
    pub fn image_for(&self, u: [f32; 4]) -> Option<(&EnvironmentMap, Vec2)> {
        if self.single || u[2] >= self.choose_infinite {
            return None;
        }
        match self.chosen_infinite(u[2] / self.choose_infinite) {
            Infinite::Image { map, .. } => Some((map, Vec2::new(u[0], u[1]))),
            Infinite::Distant { .. } => None,
        }
    }

    #[inline]
    fn chosen_infinite(&self, choice: f32) -> &Infinite {
        let count = self.infinite.len();
        &self.infinite[((choice * count as f32) as usize).min(count - 1)]
    }

    /// Radiance from infinitely far along `direction`, weighted against light sampling where
    /// `pdf` > 0 is the density that drew the direction.
    #[inline(always)]
    #[must_use]
    pub fn background(&self, direction: Vec3, pdf: f32) -> Rgb {
        let mut sum = self.constant;
        for light in &self.infinite {
            let Infinite::Image { map, scale } = light else { continue };
            let mut radiance = map.radiance(direction) * *scale;
            if pdf > 0.0 {
                radiance *= power_heuristic(pdf, self.pdf_infinite() * map.pdf(direction));
            }
            sum += radiance;
        }
        sum
    }

    #[inline(always)]
    fn pdf_infinite(&self) -> f32 {
        self.choose_infinite / self.infinite.len() as f32
    }

    /// Radiance of light `light` of `emitter` at texture coordinates.
    #[inline(always)]
    #[must_use]
    pub fn emitted(&self, emitter: &Emitter, light: u32, uv: Vec2) -> Rgb {
        let radiance = self.bounded[light as usize].radiance;
        match emitter.image {
            None => radiance,
            Some(image) => radiance * self.image_at(image, uv),
        }
    }

    #[inline(never)]
    fn image_at(&self, image: ImageId, uv: Vec2) -> Rgb {
        let sampler = Sampler { filter: TextureFilter::Point, wrap: Wrap::Clamp, channels: Channels::Rgb };
        self.textures.store().lookup(image, uv, Footprint::default(), sampler)
    }

    /// Samples a light from `p`; `u` are four numbers of one set.
    #[inline(always)]
    #[must_use]
    pub fn sample(&self, p: Vec3A, u: [f32; 4]) -> Option<LightSample> {
        let square = Vec2::new(u[0], u[1]);
        if self.single {
            return self.sample_bounded(p, 0, 1.0, square);
        }
        let choice = u[2];
        if choice < self.choose_infinite {
            return self.sample_infinite(choice / self.choose_infinite, square);
        }
        let share = 1.0 - self.choose_infinite;
        // Dividing can round up to 1, which is not in [0, 1).
        let remapped = ((choice - self.choose_infinite) / share).min(1.0 - f32::EPSILON / 2.0);
        let (light, pmf) = self.tree.as_ref()?.sample(p.into(), Vec3::ZERO, remapped)?;
        self.sample_bounded(p, light, pmf * share, square)
    }

    #[inline(never)]
    fn sample_infinite(&self, choice: f32, u: Vec2) -> Option<LightSample> {
        let pmf = self.pdf_infinite();
        Some(match self.chosen_infinite(choice) {
            Infinite::Distant { irradiance, towards } => LightSample {
                wi: (*towards).into(),
                radiance: *irradiance,
                pdf: pmf,
                delta: true,
                target: Target::Infinity,
            },
            Infinite::Image { map, scale } => {
                let s = map.sample(u)?;
                LightSample {
                    wi: s.wi.into(),
                    radiance: s.radiance * *scale,
                    pdf: s.pdf * pmf,
                    delta: false,
                    target: Target::Infinity,
                }
            }
        })
    }

    #[inline(always)]
    fn sample_bounded(&self, from: Vec3A, light: usize, pmf: f32, u: Vec2) -> Option<LightSample> {
        let bounded = &self.bounded[light];
        let p = Vec3::from(from);
        let s: WideSample = match &bounded.place {
            Place::Parallelogram(q) => q.sample_wide(from, u)?,
            Place::Triangle([a, b, c]) => triangle::sample(p, *a, *b, *c, u)?.into(),
            Place::Patch(s) => s.sample(p, u)?.into(),
            Place::Sphere(s) => s.sample(p, u)?.into(),
            Place::Disk(s) => s.sample(p, u)?.into(),
            Place::Cylinder(s) => s.sample(p, u)?.into(),
            Place::Delta(d) => return sample_delta(d, p, pmf),
        };
        let towards = s.point - from;
        let wi = towards * towards.length_recip();
        let emitter = &self.emitters[bounded.emitter as usize];
        let faces = (s.n.dot(wi) < 0.0) != bounded.flip;
        if !faces && !emitter.two_sided {
            return None;
        }
        let mut radiance = bounded.radiance;
        if let Some(image) = emitter.image {
            radiance *= self.image_at(image, self.uv_of(light, &s));
        }
        let mut delta = false;
        match bounded.opacity {
            Opacity::Solid => {}
            Opacity::Hidden => delta = true,
            Opacity::Texture(alpha) => {
                let at = TextureCoordinates::at(self.uv_of(light, &s), s.point.into(), s.n.into());
                radiance *= self.textures.eval(alpha, &at).x.clamp(0.0, 1.0);
            }
        }
        Some(LightSample {
            wi,
            radiance,
            pdf: s.pdf_solid_angle * pmf,
            delta,
            target: Target::Surface(s.point, s.n),
        })
    }

    /// Texture coordinates of a sampled point: quadrics name their own; triangles and patches with an
    /// image or a mask are never merged, and keep the mesh's.
    fn uv_of(&self, light: usize, s: &WideSample) -> Vec2 {
        match &self.bounded[light].place {
            Place::Triangle(_) => {
                let [a, b, c, _] =
                    self.corner_uvs(light).unwrap_or([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::ONE]);
                a * s.b0 + b * s.b1 + c * (1.0 - s.b0 - s.b1)
            }
            Place::Patch(_) => {
                let (u, v) = (s.b0, s.b1);
                self.corner_uvs(light).map_or(Vec2::new(u, v), |corners| blend_corners(corners, u, v))
            }
            _ => Vec2::new(s.b0, s.b1),
        }
    }

    fn corner_uvs(&self, light: usize) -> Option<[Vec2; 4]> {
        let i = self.textured_corners.binary_search_by_key(&(light as u32), |c| c.0).ok()?;
        Some(self.textured_corners[i].1)
    }

    /// Density [1/sr] with which [`Self::sample`] from `p` would have found `point` of light
    /// `light`, `distance` away, its normal turned by `cos` > 0 from the line; `parameters` are the
    /// hit's own (u, v).
    #[inline(always)]
    #[must_use]
    pub fn pdf_area(
        &self,
        p: Vec3,
        light: u32,
        point: &SurfacePoint,
        parameters: Vec2,
        distance: f32,
        cos: f32,
    ) -> f32 {
        let bounded = &self.bounded[light as usize];
        let shape = match &bounded.place {
            Place::Parallelogram(q) => q.pdf(p, distance, cos),
            Place::Triangle([a, b, c]) => triangle::pdf(p, *a, *b, *c, distance, cos),
            Place::Patch(s) => s.pdf(p, parameters),
            Place::Sphere(s) => s.pdf(p, point.p.into()),
            Place::Disk(s) => s.pdf(p, point.p.into()),
            Place::Cylinder(s) => s.pdf(p, point.p.into()),
            Place::Delta(_) => 0.0,
        };
        if self.single {
            return shape;
        }
        let Some(tree) = &self.tree else { return 0.0 };
        shape * (1.0 - self.choose_infinite) * tree.pmf(p, Vec3::ZERO, light as usize)
    }
}

fn sample_delta(light: &DeltaLight, p: Vec3, pmf: f32) -> Option<LightSample> {
    let s = light.sample(p)?;
    let end = p + s.wi * s.distance;
    let target = if s.distance.is_finite() { Target::Point(end.into()) } else { Target::Infinity };
    Some(LightSample { wi: s.wi.into(), radiance: s.irradiance, pdf: pmf, delta: true, target })
}

/// Veach's power heuristic with exponent 2, in a form whose squares cannot overflow.
#[inline(always)]
#[must_use]
pub fn power_heuristic(a: f32, b: f32) -> f32 {
    let r = b / a;
    1.0 / (1.0 + r * r)
}
