//! From a hit to a point of the surface: position from barycentric coordinates (not from the ray,
//! whose error grows with distance), with a bound on its error, normals, and only those
//! attributes that the caller needs.

use super::{Mesh, Patches, SceneGeometry, SurfaceShape, vec3};
use crate::accel::{Hit, NONE, Ray};
use crate::math::{Frame, gamma};
use glam::{Mat3, Vec2, Vec3};

/// Attributes that a material asks for; bits, so that a surface's needs are one byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Needs(pub u8);

impl Needs {
    /// Texture coordinates.
    pub const UV: Self = Self(1);
    /// ∂p/∂u, for anisotropic roughness.
    pub const TANGENT: Self = Self(2);
    /// How many texture units a world unit spans, for footprints.
    pub const FOOTPRINT: Self = Self(4);

    /// Whether all of `other` is asked for.
    #[inline(always)]
    #[must_use]
    pub fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Both.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// A point on a surface, world space.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// Position.
    pub p: Vec3,
    /// Bound on the distance between `p` and the surface that a ray would meet.
    pub error: f32,
    /// Unit geometric normal, on the side that pbrt's rules give.
    pub ng: Vec3,
    /// Unit shading normal.
    pub ns: Vec3,
    /// Texture coordinates, if needed.
    pub uv: Vec2,
    /// ∂p/∂u, if needed; else zero.
    pub dpdu: Vec3,
    /// Texture units a world unit spans (geometric mean), if needed; else zero.
    pub uv_rate: f32,
}

/// Moves a ray's origin off its surface along the normal, to the side of `direction`, by the bound
/// on the errors of the point and of the traversal's plane test (pbrt 4th ed. §6.8.6).
#[inline(always)]
#[must_use]
pub fn offset_origin(p: Vec3, error: f32, ng: Vec3, direction: Vec3) -> Vec3 {
    let reach = error * (ng.x.abs() + ng.y.abs() + ng.z.abs());
    p + ng * reach.copysign(ng.dot(direction))
}

/// Rounding of the interpolated position, per unit of coordinate: seven operations in a row; and
/// one more for adding the offset itself.
const INTERPOLATION: f32 = gamma(8);
/// Rounding of the traversal's plane equation, per unit of edge length: two differences, a cross
/// and a dot product.
const PLANE: f32 = gamma(10);

impl SceneGeometry {
    /// The point that `hit` names. `ray` is the ray that found it.
    #[inline(always)]
    #[must_use]
    pub fn surface_point(&self, hit: &Hit, ray: &Ray, needs: Needs) -> SurfacePoint {
        let surface = &self.surfaces[self.surface_of(hit)];
        let mut point = match &surface.shape {
            SurfaceShape::Mesh(mesh) => triangle_point(mesh, hit, needs, surface.flip_normal),
            other => self.uncommon_point(other, hit, ray, surface.flip_normal),
        };
        if hit.instance != NONE {
            self.place(&mut point, hit.instance);
        }
        point
    }

    /// Index of the surface that was hit.
    #[inline(always)]
    #[must_use]
    pub fn surface_of(&self, hit: &Hit) -> usize {
        if hit.instance == NONE {
            hit.geometry as usize
        } else {
            (self.instances[hit.instance as usize].surface_base + hit.geometry) as usize
        }
    }

    /// Starts loading what [`Self::surface_point`] will read; a hint without effect on results.
    #[inline(always)]
    pub fn prefetch_indices(&self, hit: &Hit) {
        if hit.geometry != NONE
            && let SurfaceShape::Mesh(mesh) = &self.surfaces[self.surface_of(hit)].shape
        {
            prefetch(&mesh.indices[hit.primitive as usize]);
        }
    }

    /// As [`Self::prefetch_indices`], for the vertices; reads the indices.
    #[inline(always)]
    pub fn prefetch_vertices(&self, hit: &Hit, needs: Needs) {
        if hit.geometry != NONE
            && let SurfaceShape::Mesh(mesh) = &self.surfaces[self.surface_of(hit)].shape
        {
            for i in mesh.indices[hit.primitive as usize] {
                prefetch(&mesh.positions[i as usize]);
                if needs.has(Needs::UV) && !mesh.uvs.is_empty() {
                    prefetch(&mesh.uvs[i as usize]);
                }
                if !mesh.normals.is_empty() {
                    prefetch(&mesh.normals[i as usize]);
                }
            }
        }
    }

    #[cold]
    #[inline(never)]
    fn uncommon_point(&self, shape: &SurfaceShape, hit: &Hit, ray: &Ray, flip: bool) -> SurfacePoint {
        let sign = if flip { -1.0 } else { 1.0 };
        match shape {
            SurfaceShape::Patches(patches) => patch_point(patches, hit, sign),
            SurfaceShape::Quadric(q) => {
                let (mut o, mut d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
                if hit.instance != NONE {
                    let inverse = &self.instances[hit.instance as usize].to_world.inv;
                    o = inverse.transform_point3(o);
                    d = inverse.transform_vector3(d);
                }
                let at = q.at(o + d * f64::from(hit.t));
                let p = at.p.as_vec3();
                let ng = at.n.as_vec3() * sign;
                let stretch = at.dpdu.cross(at.dpdv).length();
                SurfacePoint {
                    p,
                    // p is rounded once from f64; traversal meets the quadric in f64 and rounds t.
                    error: gamma(4) * max_abs(p) + gamma(2) * hit.t.abs() * max_abs(ray.direction),
                    ng,
                    ns: ng,
                    uv: at.uv.as_vec2(),
                    dpdu: at.dpdu.as_vec3(),
                    uv_rate: if stretch > 0.0 { (1.0 / stretch).sqrt() as f32 } else { 0.0 },
                }
            }
            SurfaceShape::Mesh(_) => unreachable!("meshes are handled by the caller"),
        }
    }

    /// From an instance's space to the world.
    #[inline(never)]
    fn place(&self, point: &mut SurfacePoint, instance: u32) {
        let t = &self.instances[instance as usize].to_world;
        let scale = Mat3::from_mat4(t.m.as_mat4());
        let before = point.p;
        point.p = t.m.transform_point3(before.as_dvec3()).as_vec3();
        // The object-space bound, stretched by the largest column sum, and the rounding of the
        // transform that the traversal applies to the ray.
        let stretch = scale.x_axis.abs() + scale.y_axis.abs() + scale.z_axis.abs();
        point.error = point.error * max_abs(stretch)
            + gamma(4) * (max_abs(point.p) + max_abs(stretch) * max_abs(before));
        // How the transform stretches areas of the surface: |det M| · |M⁻ᵀ n| (Nanson).
        let normal = t.normal(point.ng);
        let area = scale.determinant().abs() * normal.length();
        if area > 0.0 {
            point.uv_rate /= area.sqrt();
        }
        point.ng = normal.normalize_or_zero();
        point.ns = t.normal(point.ns).normalize_or_zero();
        point.dpdu = t.vector(point.dpdu);
    }
}

#[inline(always)]
fn max_abs(v: Vec3) -> f32 {
    v.abs().max_element()
}

#[inline(always)]
fn triangle_point(mesh: &Mesh, hit: &Hit, needs: Needs, flip: bool) -> SurfacePoint {
    let [i0, i1, i2] = mesh.indices[hit.primitive as usize].map(|i| i as usize);
    let (p0, p1, p2) = (vec3(mesh.positions[i0]), vec3(mesh.positions[i1]), vec3(mesh.positions[i2]));
    let (b1, b2) = (hit.u, hit.v);
    let b0 = 1.0 - b1 - b2;
    let p = p0 * b0 + p1 * b1 + p2 * b2;
    let (e1, e2) = (p1 - p0, p2 - p0);
    let cross = e1.cross(e2);
    let area2 = cross.length();
    let mut ng = cross / area2;
    if flip {
        ng = -ng;
    }
    let magnitude = p0.abs().max(p1.abs()).max(p2.abs());
    let error = INTERPOLATION * magnitude.max_element() + PLANE * e1.abs().max(e2.abs()).max_element();
    let mut ns = ng;
    if !mesh.normals.is_empty() {
        let n = vec3(mesh.normals[i0]) * b0 + vec3(mesh.normals[i1]) * b1 + vec3(mesh.normals[i2]) * b2;
        let l2 = n.length_squared();
        if l2 > 0.0 {
            ns = n / l2.sqrt();
            if ns.dot(ng) < 0.0 {
                ng = -ng;
            }
        }
    }
    let mut point = SurfacePoint { p, error, ng, ns, uv: Vec2::new(b1, b2), dpdu: Vec3::ZERO, uv_rate: 0.0 };
    if needs != Needs::default() {
        let (uv0, uv1, uv2) = if mesh.uvs.is_empty() {
            // pbrt's default coordinates.
            (Vec2::ZERO, Vec2::new(1.0, 0.0), Vec2::ONE)
        } else {
            (Vec2::from(mesh.uvs[i0]), Vec2::from(mesh.uvs[i1]), Vec2::from(mesh.uvs[i2]))
        };
        point.uv = uv0 * b0 + uv1 * b1 + uv2 * b2;
        let (d1, d2) = (uv1 - uv0, uv2 - uv0);
        let determinant = d1.perp_dot(d2);
        if needs.has(Needs::FOOTPRINT) {
            point.uv_rate = (determinant.abs() / area2).sqrt();
        }
        if needs.has(Needs::TANGENT) {
            let given = (!mesh.tangents.is_empty()).then(|| {
                vec3(mesh.tangents[i0]) * b0 + vec3(mesh.tangents[i1]) * b1 + vec3(mesh.tangents[i2]) * b2
            });
            point.dpdu = given.filter(|s| s.length_squared() > 0.0).unwrap_or_else(|| {
                let t = (e1 * d2.y - e2 * d1.y) / determinant;
                if t.is_finite() { t } else { Frame::from_z(ng).x }
            });
        }
    }
    point
}

fn patch_point(patches: &Patches, hit: &Hit, sign: f32) -> SurfacePoint {
    let (u, v) = (f64::from(hit.u), f64::from(hit.v));
    let (p, dpdu, dpdv) = patches.at(hit.primitive, u, v);
    let corners = patches.indices[hit.primitive as usize].map(|i| i as usize);
    let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
    let cross = dpdu.cross(dpdv);
    let mut ng = cross.normalize_or_zero().as_vec3() * sign;
    let mut ns = ng;
    if !patches.normals.is_empty() {
        let n: Vec3 = corners.iter().zip(weights).map(|(&i, w)| vec3(patches.normals[i]) * w as f32).sum();
        if n.length_squared() > 0.0 {
            ns = n.normalize();
            if ns.dot(ng) < 0.0 {
                ng = -ng;
            }
        }
    }
    let (mut uv, mut dpdu32) = (Vec2::new(hit.u, hit.v), dpdu.as_vec3());
    let mut uv_area = 1.0f32;
    if !patches.uvs.is_empty() {
        let [t00, t10, t01, t11] = corners.map(|i| Vec2::from(patches.uvs[i]));
        let (fu, fv) = (hit.u, hit.v);
        uv = patches.uv(hit.primitive, fu, fv);
        let du = (t10 - t00) * (1.0 - fv) + (t11 - t01) * fv;
        let dv = (t01 - t00) * (1.0 - fu) + (t11 - t10) * fu;
        let determinant = du.perp_dot(dv);
        uv_area = determinant.abs();
        if determinant != 0.0 {
            dpdu32 = (dpdu.as_vec3() * dv.y - dpdv.as_vec3() * du.y) / determinant;
        }
    }
    let (lo, hi) = patches.bounds(hit.primitive);
    SurfacePoint {
        p: p.as_vec3(),
        // u and v are rounded to f32: the point slides on the patch by an ulp of its extent, and
        // p is rounded once.
        error: gamma(4) * max_abs(lo.abs().max(hi.abs())) + gamma(4) * max_abs(hi - lo),
        ng,
        ns,
        uv,
        dpdu: dpdu32,
        uv_rate: (uv_area / (cross.length() as f32)).sqrt(),
    }
}

/// A prefetch into all cache levels where the target has one.
#[inline(always)]
fn prefetch<T>(at: &T) {
    #[cfg(target_arch = "x86_64")]
    {
        // SAFETY: prefetching is a hint and valid for any address.
        unsafe {
            std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(
                std::ptr::from_ref(at).cast::<i8>(),
            );
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = at;
}
