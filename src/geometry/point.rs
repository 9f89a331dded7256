//! From a hit to a point of the surface: position from barycentric coordinates (not from the ray,
//! whose error grows with distance), with a bound on its error, normals, and only those
//! attributes that the caller needs.

use super::flat::{Flat, Surfaces};
use super::quadric::{Quadric, QuadricPoint};
use super::{Mesh, Patches, SurfaceShape, vec3};
use crate::accel::{Hit, NONE, Ray};
use crate::math::{Frame, gamma, prefetch};
use glam::{DVec3, Mat4, Vec2, Vec3, Vec3A};

/// Attributes that a material asks for; bits, so that a surface's needs are one byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Needs(pub u8);

impl Needs {
    /// Texture coordinates.
    pub const UV: Self = Self(1);
    /// ∂p/∂u, for anisotropic roughness.
    pub const TANGENT: Self = Self(2);
    /// Footprints: how texture coordinates run over the surface. Read apart from the point.
    pub const FOOTPRINT: Self = Self(4);

    /// Whether all of `other` is asked for.
    #[inline(always)]
    #[must_use]
    pub fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Those that are not in `other`.
    #[must_use]
    pub fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Both.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// What surfaces a scene may have; what it has not is not looked for.
#[derive(Clone, Copy, Debug)]
pub struct Kinds {
    /// Placed objects.
    pub instances: bool,
    /// Quadrics, patches and pages.
    pub others: bool,
    /// Surfaces that need anything of [`Needs`].
    pub attributes: bool,
}

impl Kinds {
    /// Any.
    pub const ALL: Self = Self { instances: true, others: true, attributes: true };
}

/// A point on a surface, world space. Points and normals that every vertex works with are in SIMD
/// registers; the roundings are those of scalars.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// Position.
    pub p: Vec3A,
    /// Bound on the distance between `p` and the surface that a ray would meet.
    pub error: f32,
    /// Unit geometric normal, on the side that pbrt's rules give.
    pub ng: Vec3A,
    /// Unit shading normal.
    pub ns: Vec3A,
    /// Texture coordinates, if needed.
    pub uv: Vec2,
    /// ∂p/∂u, if needed; else zero.
    pub dpdu: Vec3,
}

impl SurfacePoint {
    /// The same, field by field: what a call returned through memory otherwise keeps the commoner points
    /// it is joined with in memory too.
    #[inline(always)]
    fn apart(self) -> Self {
        let Self { p, error, ng, ns, uv, dpdu } = self;
        Self { p, error, ng, ns, uv, dpdu }
    }
}

/// Moves a ray's origin off its surface along the normal, to the side of `direction`, by the bound
/// on the errors of the point and of the traversal's plane test (pbrt 4th ed. §6.8.6).
#[inline(always)]
#[must_use]
pub fn offset_origin(p: Vec3A, error: f32, ng: Vec3A, direction: Vec3A) -> Vec3A {
    let a = ng.abs();
    let reach = error * (a.x + a.y + a.z);
    p + ng * reach.copysign(ng.dot(direction))
}

/// Rounding of the interpolated position, per unit of coordinate: seven operations in a row; and
/// one more for adding the offset itself.
const INTERPOLATION: f32 = gamma(8);
/// Rounding of the traversal's plane equation, per unit of edge length: two differences, a cross
/// and a dot product.
const PLANE: f32 = gamma(10);
/// Rounding of a point on its way through an instance, per unit of what is added up: an element of the inverse, three
/// products, their sum with the translation; the point in the world, and adding the offset.
const PLACING: f32 = gamma(7);

impl Surfaces<'_> {
    /// The point that `hit` names on `surface`, which is what [`Self::surface_of`] says of it. `ray`
    /// gives the ray that found it.
    #[inline(always)]
    #[must_use]
    pub fn surface_point(
        &self,
        hit: &Hit,
        surface: usize,
        ray: impl FnOnce() -> Ray,
        kinds: Kinds,
    ) -> SurfacePoint {
        let flat = &self.flat[surface];
        let point = match flat.mesh {
            Some(mesh) => triangle_point(flat, mesh, hit, kinds.attributes),
            None if !kinds.others => unreachable!("the kernel has what surfaces call for"),
            None => self.uncommon_point(surface, hit, &ray()).apart(),
        };
        if !kinds.instances || hit.instance == NONE { point } else { self.place(point, hit.instance).apart() }
    }

    /// Index of the surface that was hit.
    #[inline(always)]
    #[must_use]
    pub fn surface_of(&self, hit: &Hit, kinds: Kinds) -> usize {
        debug_assert!(kinds.instances || hit.instance == NONE, "the kernel has what is placed");
        if !kinds.instances || hit.instance == NONE {
            hit.geometry as usize
        } else {
            (self.geometry.instances[hit.instance as usize].surface_base + hit.geometry) as usize
        }
    }

    /// Starts loading what [`Self::surface_point`] will read; a hint without effect on results.
    #[inline(always)]
    pub fn prefetch_indices(&self, hit: &Hit, kinds: Kinds) {
        if hit.geometry != NONE {
            soon(self.flat[self.surface_of(hit, kinds)].indices, hit.primitive);
        }
    }

    /// As [`Self::prefetch_indices`], for the vertices; reads the indices.
    #[inline(always)]
    pub fn prefetch_vertices(&self, hit: &Hit, kinds: Kinds) {
        if hit.geometry == NONE {
            return;
        }
        let flat = &self.flat[self.surface_of(hit, kinds)];
        // Other shapes than triangles have no indices.
        let Some(&corners) = flat.indices.get(hit.primitive as usize) else { return };
        for i in corners {
            soon(flat.positions, i);
        }
        if !flat.normals.is_empty() {
            for i in corners {
                soon(flat.normals, i);
            }
        }
        if kinds.attributes
            && flat.needs.has(Needs::UV)
            && let Some(mesh) = flat.mesh
        {
            for i in corners {
                soon(&mesh.uvs, i);
            }
        }
    }

    #[cold]
    #[inline(never)]
    fn uncommon_point(&self, surface: usize, hit: &Hit, ray: &Ray) -> SurfacePoint {
        let flat = &self.flat[surface];
        let surface = &self.geometry.surfaces[surface];
        let sign = if surface.flip_normal { -1.0 } else { 1.0 };
        match &surface.shape {
            SurfaceShape::Patches(patches) => patch_point(patches, hit, sign),
            SurfaceShape::Quadric(q) => {
                let at = self.on_quadric(q, hit, ray);
                let p = at.p.as_vec3();
                let ng = at.n.as_vec3() * sign;
                let direction = self.own_direction(hit, ray).as_vec3();
                SurfacePoint {
                    p: p.into(),
                    // p is rounded once from f64; traversal meets the quadric in f64 and rounds t.
                    error: gamma(4) * max_abs(p) + gamma(2) * hit.t.abs() * max_abs(direction),
                    ng: ng.into(),
                    ns: ng.into(),
                    uv: at.uv.as_vec2(),
                    dpdu: at.dpdu.as_vec3(),
                }
            }
            SurfaceShape::Paged(_) => self.geometry.with_paged(hit, |mesh, hit| {
                let (indices, positions, normals) =
                    (&mesh.indices[..], &mesh.positions[..], &mesh.normals[..]);
                let Flat { needs, flip, .. } = *flat;
                triangle_point(
                    &Flat { indices, positions, normals, mesh: Some(mesh), needs, flip },
                    mesh,
                    hit,
                    true,
                )
            }),
            SurfaceShape::Mesh(_) => unreachable!("meshes are handled by the caller"),
        }
    }

    /// The direction of `ray` in the space of the hit's instance, in which a distance along it is that of the hit.
    fn own_direction(&self, hit: &Hit, ray: &Ray) -> DVec3 {
        let d = ray.direction.as_dvec3();
        match self.geometry.instances.get(hit.instance as usize) {
            Some(instance) => instance.to_world.inv.transform_vector3(d),
            None => d,
        }
    }

    /// Where `ray` met the quadric `q`, in the space of the hit's instance.
    pub(super) fn on_quadric(&self, q: &Quadric, hit: &Hit, ray: &Ray) -> QuadricPoint {
        let mut o = ray.origin.as_dvec3();
        if hit.instance != NONE {
            o = self.geometry.instances[hit.instance as usize].to_world.inv.transform_point3(o);
        }
        q.at(o + self.own_direction(hit, ray) * f64::from(hit.t))
    }

    /// From an instance's space to the world.
    #[inline(never)]
    fn place(&self, mut point: SurfacePoint, instance: u32) -> SurfacePoint {
        let t = &self.geometry.instances[instance as usize].to_world;
        let p = t.m.transform_point3(Vec3::from(point.p).as_dvec3()).as_vec3();
        point.p = p.into();
        // By rows, without signs.
        let sizes = |m: &Mat4, v: Vec3| {
            m.x_axis.truncate().abs() * v.x
                + m.y_axis.truncate().abs() * v.y
                + m.z_axis.truncate().abs() * v.z
        };
        let (forth, back) = (t.m.as_mat4(), t.inv.as_mat4());
        let stretch = max_abs(sizes(&forth, Vec3::ONE));
        // The traversal takes the ray back into the object's space, in f32: the error of its origin there, seen in
        // the world, and that of its direction over the length of the triangle, of which PLANE says a bound.
        let origin = sizes(&forth, sizes(&back, p.abs()) + back.w_axis.truncate().abs());
        let direction = max_abs(sizes(&forth, sizes(&back, Vec3::ONE))) * (gamma(4) / PLANE);
        point.error = point.error * stretch * (1.0 + direction) + PLACING * max_abs(origin);
        point.ng = t.normal(point.ng.into()).normalize_or_zero().into();
        point.ns = t.normal(point.ns.into()).normalize_or_zero().into();
        point.dpdu = t.vector(point.dpdu);
        point
    }
}

#[inline(always)]
fn max_abs(v: Vec3) -> f32 {
    v.abs().max_element()
}

#[inline(always)]
fn triangle_point(flat: &Flat<'_>, mesh: &Mesh, hit: &Hit, attributes: bool) -> SurfacePoint {
    let corners = flat.indices[hit.primitive as usize].map(|i| i as usize);
    let [p0, p1, p2] = corners.map(|i| Vec3A::from_array(flat.positions[i]));
    let (b1, b2) = (hit.u, hit.v);
    let b0 = 1.0 - b1 - b2;
    let p = p0 * b0 + p1 * b1 + p2 * b2;
    let (e1, e2) = (p1 - p0, p2 - p0);
    let cross = e1.cross(e2);
    let l2 = cross.length_squared();
    let mut ng = if (f32::MIN_POSITIVE..f32::INFINITY).contains(&l2) {
        cross / l2.sqrt()
    } else {
        extreme_normal(e1, e2)
    };
    if flat.flip {
        ng = -ng;
    }
    let magnitude = p0.abs().max(p1.abs()).max(p2.abs());
    let error = INTERPOLATION * magnitude.max_element() + PLANE * e1.abs().max(e2.abs()).max_element();
    let mut ns = ng;
    if !flat.normals.is_empty() {
        let [n0, n1, n2] = corners.map(|i| Vec3A::from_array(flat.normals[i]));
        let n = n0 * b0 + n1 * b1 + n2 * b2;
        let l2 = n.length_squared();
        if l2 > 0.0 {
            ns = n / l2.sqrt();
            if ns.dot(ng) < 0.0 {
                ng = -ng;
            }
        }
    }
    let mut point = SurfacePoint { p, error, ng, ns, uv: Vec2::new(b1, b2), dpdu: Vec3::ZERO };
    debug_assert!(attributes || flat.needs == Needs::default(), "the kernel has what materials need");
    if attributes && flat.needs != Needs::default() {
        let edges = [e1.into(), e2.into()];
        add_attributes(&mut point, mesh, corners, [b0, b1, b2], edges, flat.needs);
    }
    point
}

/// Unit normal of a triangle so small or so large that the square of its area is none in f32: below the least normal
/// number it loses digits, above the greatest it is lost. In f64 no edge is. Without area it is any unit vector.
#[cold]
#[inline(never)]
fn extreme_normal(e1: Vec3A, e2: Vec3A) -> Vec3A {
    e1.as_dvec3().cross(e2.as_dvec3()).normalize_or(DVec3::Z).as_vec3a()
}

/// Texture coordinates and what follows from them. `edges` lead from the first corner to the others.
#[inline(always)]
fn add_attributes(
    point: &mut SurfacePoint,
    mesh: &Mesh,
    [i0, i1, i2]: [usize; 3],
    [b0, b1, b2]: [f32; 3],
    [e1, e2]: [Vec3; 2],
    needs: Needs,
) {
    let (uv0, uv1, uv2) = if mesh.uvs.is_empty() {
        // pbrt's default coordinates.
        (Vec2::ZERO, Vec2::new(1.0, 0.0), Vec2::ONE)
    } else {
        (Vec2::from(mesh.uvs[i0]), Vec2::from(mesh.uvs[i1]), Vec2::from(mesh.uvs[i2]))
    };
    point.uv = uv0 * b0 + uv1 * b1 + uv2 * b2;
    if needs.has(Needs::TANGENT) {
        let (d1, d2) = (uv1 - uv0, uv2 - uv0);
        let determinant = d1.perp_dot(d2);
        let given = (!mesh.tangents.is_empty()).then(|| {
            vec3(mesh.tangents[i0]) * b0 + vec3(mesh.tangents[i1]) * b1 + vec3(mesh.tangents[i2]) * b2
        });
        point.dpdu = given.filter(|s| s.length_squared() > 0.0).unwrap_or_else(|| {
            let t = (e1 * d2.y - e2 * d1.y) / determinant;
            if t.is_finite() { t } else { Frame::from_z(point.ng.into()).x }
        });
    }
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
    if !patches.uvs.is_empty() {
        let [t00, t10, t01, t11] = corners.map(|i| Vec2::from(patches.uvs[i]));
        let (fu, fv) = (hit.u, hit.v);
        uv = patches.uv(hit.primitive, fu, fv);
        let du = (t10 - t00) * (1.0 - fv) + (t11 - t01) * fv;
        let dv = (t01 - t00) * (1.0 - fu) + (t11 - t10) * fu;
        let determinant = du.perp_dot(dv);
        if determinant != 0.0 {
            dpdu32 = (dpdu.as_vec3() * dv.y - dpdv.as_vec3() * du.y) / determinant;
        }
    }
    let (lo, hi) = patches.bounds(hit.primitive);
    SurfacePoint {
        p: p.as_vec3().into(),
        // u and v are rounded to f32: the point slides on the patch by an ulp of its extent, and
        // p is rounded once.
        error: gamma(4) * max_abs(lo.abs().max(hi.abs())) + gamma(4) * max_abs(hi - lo),
        ng: ng.into(),
        ns: ns.into(),
        uv,
        dpdu: dpdu32,
    }
}

/// A hint that element `i` will be read.
#[inline(always)]
fn soon<T>(slice: &[T], i: u32) {
    prefetch(slice.as_ptr().wrapping_add(i as usize), 1);
}
