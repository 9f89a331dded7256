//! All lights of a scene: which one to sample, how, and with what density. A constant sky is not
//! sampled: every scattering function's own sampling beats a uniform sphere of directions, so a
//! shadow ray towards it would cost time and add noise.
//!
//! Invariant: `pdf_area` and `background` weigh with exactly the densities that `sample` draws
//! with. Never traces a ray.

use crate::accel::Ray;
use crate::color::Rgb;
use crate::error::Result;
use crate::geometry::{SceneGeometry, SurfacePoint, SurfaceShape, offset_origin};
use crate::integrator::path::LIGHT_POINT;
use crate::math::warp;
use crate::scene::{AreaLight, ImageId, Light, SceneDescription};
use crate::texture::Textures;
use glam::{Vec2, Vec3};

/// A surface that emits.
pub struct Emitter {
    /// Index of the surface.
    pub surface: u32,
    /// Radiance, scale and power included.
    pub radiance: Rgb,
    /// Both sides emit.
    pub two_sided: bool,
    /// Image over (u, v), a factor.
    pub image: Option<ImageId>,
    /// Light of the first primitive.
    first_light: u32,
}

impl Emitter {
    /// The light that primitive `primitive` belongs to.
    #[inline(always)]
    #[must_use]
    pub fn light_of(&self, primitive: u32) -> u32 {
        self.first_light + primitive
    }

    /// Radiance at texture coordinates.
    #[inline(always)]
    #[must_use]
    pub fn radiance_at(&self, _uv: Vec2) -> Rgb {
        self.radiance
    }
}

/// One light with a place.
struct Bounded {
    v: [Vec3; 3],
    n: Vec3,
    area: f32,
    emitter: u32,
}

/// A direction towards a light.
pub struct LightSample {
    /// Unit direction.
    pub wi: Vec3,
    /// Radiance along it (for delta lights with the falloff included).
    pub radiance: Rgb,
    /// Density [1/sr] with the choice of the light included; for delta lights the choice alone.
    pub pdf: f32,
    /// No scattering function could have found it.
    pub delta: bool,
    /// Point on the light, the bound on its error and its normal; `None` infinitely far.
    target: Option<(Vec3, f32, Vec3)>,
}

impl LightSample {
    /// The shadow ray from a surface point; ends just before the light.
    #[inline(always)]
    #[must_use]
    pub fn ray_from(&self, p: Vec3, error: f32, ng: Vec3) -> Ray {
        let origin = offset_origin(p, error, ng, self.wi);
        match self.target {
            None => Ray::new(origin, self.wi),
            Some((target, error, n)) => {
                let target = offset_origin(target, error, n, -self.wi);
                Ray { origin, direction: target - origin, t_min: 0.0, t_max: 1.0 }
            }
        }
    }
}

/// The lights.
pub struct Lights {
    /// Emitting surfaces.
    pub emitters: Vec<Emitter>,
    bounded: Vec<Bounded>,
    constant: Rgb,
    distant: Vec<(Rgb, Vec3)>,
}

impl Lights {
    /// Collects the lights of a scene.
    ///
    /// # Errors
    /// An environment image that cannot be used.
    pub fn new(
        scene: &SceneDescription,
        geometry: &SceneGeometry,
        _textures: &Textures,
        _bounds: (Vec3, Vec3),
    ) -> Result<Self> {
        let mut lights =
            Self { emitters: Vec::new(), bounded: Vec::new(), constant: Rgb::ZERO, distant: Vec::new() };
        for light in &scene.lights {
            match light {
                Light::Constant { radiance } => lights.constant += *radiance,
                Light::Distant { irradiance, towards } => {
                    lights.distant.push((*irradiance, Vec3::from(*towards)));
                }
                _ => {}
            }
        }
        for (i, surface) in geometry.surfaces.iter().enumerate().take(geometry.world_count) {
            let Some(id) = surface.area_light else { continue };
            let AreaLight { radiance, two_sided, image, .. } = scene.area_lights[id.index()];
            let first_light = lights.bounded.len() as u32;
            if let SurfaceShape::Mesh(m) = &surface.shape {
                for t in &m.indices {
                    let v = t.map(|k| Vec3::from(m.positions[k as usize]));
                    let mut n = (v[1] - v[0]).cross(v[2] - v[0]);
                    if surface.flip_normal {
                        n = -n;
                    }
                    if !m.normals.is_empty() && n.dot(Vec3::from(m.normals[t[0] as usize])) < 0.0 {
                        n = -n;
                    }
                    let area = n.length() * 0.5;
                    lights.bounded.push(Bounded {
                        v,
                        n: n.normalize_or_zero(),
                        area,
                        emitter: lights.emitters.len() as u32,
                    });
                }
            }
            lights.emitters.push(Emitter { surface: i as u32, radiance, two_sided, image, first_light });
        }
        Ok(lights)
    }

    /// Whether any light is worth a shadow ray.
    #[inline(always)]
    #[must_use]
    pub fn can_be_sampled(&self) -> bool {
        !self.bounded.is_empty() || !self.distant.is_empty()
    }

    /// Whether rays that leave the scene find light.
    #[inline(always)]
    #[must_use]
    pub fn has_background(&self) -> bool {
        self.constant != Rgb::ZERO
    }

    /// Radiance from infinitely far along `direction`, weighted against light sampling from `p`
    /// where `pdf` > 0 is the density that drew the direction.
    #[inline(always)]
    #[must_use]
    pub fn background(&self, _p: Vec3, _direction: Vec3, _pdf: f32) -> Rgb {
        self.constant
    }

    /// Samples a light from `p`.
    #[inline(always)]
    #[must_use]
    pub fn sample(&self, p: Vec3, _n: Vec3, u: [f32; 4]) -> Option<LightSample> {
        let count = self.bounded.len() + self.distant.len();
        let i = ((u[2] * count as f32) as usize).min(count - 1);
        let pmf = 1.0 / count as f32;
        if i >= self.bounded.len() {
            let (radiance, wi) = self.distant[i - self.bounded.len()];
            return Some(LightSample { wi, radiance, pdf: pmf, delta: true, target: None });
        }
        let light = &self.bounded[i];
        let emitter = &self.emitters[light.emitter as usize];
        let (b0, b1) = warp::uniform_triangle(Vec2::new(u[0], u[1]));
        let point = light.v[0] * b0 + light.v[1] * b1 + light.v[2] * (1.0 - b0 - b1);
        let d = point - p;
        let d2 = d.length_squared();
        let wi = d / d2.sqrt();
        let cos = -wi.dot(light.n);
        if cos <= 0.0 && !emitter.two_sided {
            return None;
        }
        let pdf = pmf * d2 / (light.area * cos.abs());
        if !pdf.is_finite() {
            return None;
        }
        let error = LIGHT_POINT * point.abs().max_element();
        Some(LightSample {
            wi,
            radiance: emitter.radiance,
            pdf,
            delta: false,
            target: Some((point, error, light.n)),
        })
    }

    /// Density [1/sr] with which [`Self::sample`] from `p` would have found the point of light
    /// `light` that lies `distance` away along `wi` and turns its normal by `cos`.
    #[inline(always)]
    #[must_use]
    pub fn pdf_area(&self, _p: Vec3, light: u32, _point: &SurfacePoint, _wi: Vec3, distance: f32, cos: f32) -> f32 {
        let count = self.bounded.len() + self.distant.len();
        distance * distance / (self.bounded[light as usize].area * cos * count as f32)
    }
}
