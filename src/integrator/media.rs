//! Media between surfaces: absorption along a ray, and passage through surfaces that only separate
//! media. Homogeneous and absorbing; what scatters in them is not simulated (the reader warns).
//! Costs nothing where a scene has neither.

use super::kernel::{Kernel, Part};
use super::materials::Scattering;
use super::path::{Path, Shadow, World};
use crate::accel::{Accel, Hit, NONE, Ray};
use crate::color::Rgb;
use crate::geometry::{Kinds, SurfacePoint, offset_origin};
use crate::scene::{MediumId, MediumInterface};
use crate::stats::Counters;
use glam::Vec3A;

impl<A: Accel + ?Sized> World<'_, A> {
    /// Continues through surfaces that do not scatter. Each stands for one more ray.
    #[cold]
    pub(super) fn pass_interfaces<K: Kernel>(
        &self,
        path: &mut Path<K>,
        hit: &mut Hit,
        counters: &mut Counters,
    ) {
        while hit.geometry != NONE {
            let surface = self.geometry.surface_of(hit, Kinds::ALL);
            let ray = Ray::new(path.origin, path.direction);
            let Some(point) = self.passed::<K>(surface, hit, &ray, path.choice_key()) else { return };
            let shading = &self.shading[surface];
            // A packed field cannot be lent to `*=`.
            let through = self.transmittance(K::medium(path.medium), hit.t);
            path.beta = through * path.beta;
            let direction = path.direction.into();
            path.medium = cross::<K>(shading.medium, point.ng, direction, path.medium);
            path.travelled = Part::new(path.travelled.or(0.0) + hit.t);
            path.origin = offset_origin(point.p, point.error, point.ng, direction).into();
            counters.closest += 1;
            *hit = self.accel.closest(&Ray::new(path.origin, path.direction));
        }
    }

    /// The point at which a ray passes a surface without scattering; `None` where it does not.
    fn passed<K: Kernel>(&self, surface: usize, hit: &Hit, ray: &Ray, key: u32) -> Option<SurfacePoint> {
        let shading = &self.shading[surface];
        if !shading.may_pass || shading.emitter != NONE {
            return None;
        }
        let point = self.geometry.surface_point(hit, surface, || *ray, Kinds::ALL);
        let at = || self.coordinates(&point, key);
        let scattering = self.materials.scattering::<K>(shading.material, at, || key);
        matches!(scattering, Scattering::Passes).then_some(point)
    }

    /// Beer's law over a distance in a medium.
    #[inline(always)]
    pub(super) fn transmittance(&self, medium: u32, distance: f32) -> Rgb {
        if medium == NONE {
            return Rgb::ONE;
        }
        let m = &self.media[medium as usize];
        // 0 · ∞ is 0 here: a channel that does not absorb lets everything through.
        let along = |sigma: f32| if sigma > 0.0 { (-sigma * distance).exp() } else { 1.0 };
        Rgb::new(along(m.sigma_a.x), along(m.sigma_a.y), along(m.sigma_a.z))
    }

    /// What reaches the light through media and interfaces.
    #[cold]
    pub(super) fn transmitted<K: Kernel>(&self, shadow: &Shadow<K>, counters: &mut Counters) -> Rgb {
        let (mut ray, mut medium, mut through) = (shadow.ray, shadow.medium, Rgb::ONE);
        loop {
            // What is left of the way: an interface passed shortens it.
            let length = ray.direction.length();
            let hit = self.accel.closest(&ray);
            counters.closest += 1;
            if hit.geometry == NONE {
                return through * self.transmittance(K::medium(medium), ray.t_max * length);
            }
            let surface = self.geometry.surface_of(&hit, Kinds::ALL);
            // A mix decides by the point alone here: a shadow ray is nobody's path.
            let Some(point) = self.passed::<K>(surface, &hit, &ray, 0) else { return Rgb::ZERO };
            let shading = &self.shading[surface];
            through *= self.transmittance(K::medium(medium), hit.t * length);
            let direction = ray.direction.into();
            medium = cross::<K>(shading.medium, point.ng, direction, medium);
            let origin = offset_origin(point.p, point.error, point.ng, direction).into();
            if ray.t_max.is_finite() {
                ray.direction = ray.origin + ray.direction - origin;
            }
            ray.origin = origin;
        }
    }
}

/// The medium behind a surface in direction `w`.
#[inline(always)]
pub(super) fn cross<K: Kernel>(
    interface: Option<MediumInterface>,
    ng: Vec3A,
    w: Vec3A,
    current: K::Medium,
) -> K::Medium {
    match interface {
        Some(m) if K::MEDIA => Part::new(medium_index(if w.dot(ng) > 0.0 { m.outside } else { m.inside })),
        _ => current,
    }
}

#[inline(always)]
pub(super) fn medium_index(medium: Option<MediumId>) -> u32 {
    medium.map_or(NONE, |m| m.0)
}
