//! What the acceleration structure asks about shapes that it does not know itself, and about masks.
//!
//! Invariant: the answer depends on the ray and the primitive alone, however often it is asked and in whatever order.

use super::{SceneGeometry, SurfaceShape};
use crate::accel::{Custom, Ray};
use crate::math::gamma;
use glam::{DVec3, Vec2, Vec3};

impl Custom for SceneGeometry {
    fn bounds(&self, user: u32, primitive: u32) -> (Vec3, Vec3) {
        match &self.surfaces[user as usize].shape {
            SurfaceShape::Quadric(q) => {
                let (lo, hi) = q.object_bounds();
                let mut low = DVec3::INFINITY;
                let mut high = DVec3::NEG_INFINITY;
                for corner in 0..8 {
                    let pick = |bit: i32, a: f64, b: f64| if corner >> bit & 1 == 0 { a } else { b };
                    let p = DVec3::new(pick(0, lo.x, hi.x), pick(1, lo.y, hi.y), pick(2, lo.z, hi.z));
                    let p = q.to_world.point_f64(p);
                    low = low.min(p);
                    high = high.max(p);
                }
                // Rounded outwards to f32.
                let down = |v: DVec3| v.as_vec3().map(f32::next_down);
                let up = |v: DVec3| v.as_vec3().map(f32::next_up);
                (down(low), up(high))
            }
            SurfaceShape::Patches(p) => {
                // A flat one along an axis has a box without thickness, and rays within its plane miss that by
                // the rounding of a face's distance: two operations on the way there, which is in proportion to
                // the coordinates.
                let (lo, hi) = p.bounds(primitive);
                let pad = gamma(8) * (lo.abs().max(hi.abs()).max_element() + (hi - lo).max_element());
                (lo - pad, hi + pad)
            }
            SurfaceShape::Mesh(_) | SurfaceShape::Paged(_) => {
                unreachable!("the backend intersects triangles itself")
            }
        }
    }

    fn intersect(&self, user: u32, primitive: u32, ray: &Ray) -> Option<(f32, f32, f32)> {
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let (lo, hi) = (f64::from(ray.t_min), f64::from(ray.t_max));
        match &self.surfaces[user as usize].shape {
            SurfaceShape::Quadric(q) => {
                let t = q.intersect(o, d, lo, hi)?;
                if self.surfaces[user as usize].alpha.is_some() {
                    let uv = q.at(o + d * t).uv;
                    return Some((t as f32, uv.x as f32, uv.y as f32));
                }
                Some((t as f32, 0.0, 0.0))
            }
            SurfaceShape::Patches(p) => {
                p.intersect(primitive, o, d, lo, hi).map(|(t, u, v)| (t as f32, u as f32, v as f32))
            }
            SurfaceShape::Mesh(_) | SurfaceShape::Paged(_) => {
                unreachable!("the backend intersects triangles itself")
            }
        }
    }

    fn is_opaque(&self, user: u32, primitive: u32, (t, u, v): (f32, f32, f32), ray: &Ray) -> bool {
        let surface = &self.surfaces[user as usize];
        let (Some(texture), Some(opacity)) = (surface.alpha, &self.opacity) else { return true };
        let (uv, p) = match &surface.shape {
            SurfaceShape::Mesh(m) => {
                let [i0, i1, i2] = m.indices[primitive as usize].map(|i| i as usize);
                let b = [1.0 - u - v, u, v];
                let uv = if m.uvs.is_empty() {
                    Vec2::new(b[1] + b[2], b[2])
                } else {
                    Vec2::from(m.uvs[i0]) * b[0] + Vec2::from(m.uvs[i1]) * b[1] + Vec2::from(m.uvs[i2]) * b[2]
                };
                let p = [i0, i1, i2].map(|i| Vec3::from(m.positions[i]));
                (uv, p[0] * b[0] + p[1] * b[1] + p[2] * b[2])
            }
            SurfaceShape::Patches(patches) => {
                let p = patches.at(primitive, u.into(), v.into()).0.as_vec3();
                (patches.uv(primitive, u, v), p)
            }
            SurfaceShape::Quadric(_) => (Vec2::new(u, v), ray.origin + ray.direction * t),
            SurfaceShape::Paged(_) => unreachable!("meshes with masks are not paged"),
        };
        let a = opacity.opacity(texture, uv, p);
        // The draw is a hash of the ray and the primitive, so that it is the same in whatever order
        // a traversal asks (pbrt-v4 hashes the ray likewise).
        a >= 1.0 || (a > 0.0 && hash_ray(ray, user, primitive) < a)
    }
}

/// Uniform in [0, 1) from a ray's bits and a primitive's name.
fn hash_ray(ray: &Ray, user: u32, primitive: u32) -> f32 {
    let mut h = u64::from(user) << 32 | u64::from(primitive);
    for c in ray.origin.to_array().into_iter().chain(ray.direction.to_array()) {
        // Multiply and xor-shift (the finalizer of SplitMix64).
        h = (h ^ u64::from(c.to_bits())).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        h ^= h >> 31;
    }
    h = h.wrapping_mul(0x94d0_49bb_1331_11eb);
    (h >> 40) as f32 * (1.0 / (1u64 << 24) as f32)
}
