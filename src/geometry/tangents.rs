//! What footprints need to know of a surface where a ray met it: how texture coordinates run over it
//! and how it bends. Asked for apart from the surface point, since few hits need it. World space;
//! never more than a first-order answer.

use super::{Mesh, Patches, SurfaceShape, Surfaces, vec3};
use crate::accel::{Hit, NONE, Ray};
use crate::math::Vec3;
use glam::{Mat3, Vec2, Vec3A};

/// Two vectors in the tangent plane with the change of (u, v) along each.
#[derive(Clone, Copy, Debug)]
pub struct Tangents {
    /// The vectors.
    pub along: [Vec3A; 2],
    /// What they change.
    pub duv: [Vec2; 2],
}

/// A footprint in the tangent plane: an ellipse with perpendicular axes.
#[derive(Clone, Copy, Debug)]
pub struct FootprintEllipse {
    /// Unit normal of the plane.
    pub n: Vec3A,
    /// One axis's direction, of any length; the other is n × this.
    pub along: Vec3A,
    /// What the two are multiplied by.
    pub scale: [f32; 2],
}

impl FootprintEllipse {
    /// Its axes.
    #[inline(always)]
    #[must_use]
    pub fn axes(&self) -> [Vec3; 2] {
        [(self.along * self.scale[0]).into(), (self.n.cross(self.along) * self.scale[1]).into()]
    }
}

impl Tangents {
    /// The same, field by field; see `SurfacePoint::apart`.
    #[inline(always)]
    fn apart(self) -> Self {
        let Self { along: [a, b], duv: [da, db] } = self;
        Self { along: [a, b], duv: [da, db] }
    }

    /// Changes of (u, v) along the ellipse's axes; zero where the surface is degenerate.
    #[inline(always)]
    #[must_use]
    pub fn uv(&self, ellipse: &FootprintEllipse) -> [Vec2; 2] {
        let [a, b] = self.along;
        let FootprintEllipse { n, along, scale: [x, y] } = *ellipse;
        let across = n.cross(along);
        // h = (b · (n × h) a − a · (n × h) b) / (a × b · n), and n × (n × h) = −h.
        let area = a.cross(b).dot(n);
        let inverse = 1.0 / area;
        let inverse = if inverse.is_finite() { inverse } else { 0.0 };
        let [da, db] = self.duv;
        [
            (da * b.dot(across) - db * a.dot(across)) * (inverse * x),
            (db * a.dot(along) - da * b.dot(along)) * (inverse * y),
        ]
    }
}

impl Surfaces<'_> {
    /// How texture coordinates run where `hit` is on `surface`. `ray` is the ray that found it.
    #[inline(always)]
    #[must_use]
    pub fn tangents(&self, hit: &Hit, surface: usize, ray: impl FnOnce() -> Ray) -> Tangents {
        match self.flat[surface].mesh {
            Some(mesh) if hit.instance == NONE => mesh_tangents(mesh, hit),
            _ => self.uncommon_tangents(hit, surface, &ray()).apart(),
        }
    }

    #[inline(never)]
    fn uncommon_tangents(&self, hit: &Hit, surface: usize, ray: &Ray) -> Tangents {
        let mut tangents = match &self.geometry.surfaces[surface].shape {
            SurfaceShape::Mesh(mesh) => mesh_tangents(mesh, hit),
            SurfaceShape::Paged(_) => self.geometry.with_paged(hit, mesh_tangents),
            SurfaceShape::Patches(patches) => patch_tangents(patches, hit),
            SurfaceShape::Quadric(q) => {
                let at = self.on_quadric(q, hit, ray);
                Tangents { along: [at.dpdu.as_vec3a(), at.dpdv.as_vec3a()], duv: [Vec2::X, Vec2::Y] }
            }
        };
        if hit.instance != NONE {
            let t = &self.geometry.instances[hit.instance as usize].to_world;
            tangents.along = tangents.along.map(|v| t.vector(v.into()).into());
        }
        tangents
    }

    /// Mean curvature [1/length], positive where the surface bulges along its shading normal: of a
    /// mesh by its vertices' normals, so that one without is flat. A patch counts as flat.
    #[inline(always)]
    #[must_use]
    pub fn curvature(&self, hit: &Hit, surface: usize) -> f32 {
        let flat = &self.flat[surface];
        if flat.mesh.is_some() && flat.normals.is_empty() {
            return 0.0;
        }
        self.curvature_of_curved(hit, surface)
    }

    #[inline(never)]
    fn curvature_of_curved(&self, hit: &Hit, surface: usize) -> f32 {
        let surface = &self.geometry.surfaces[surface];
        let curvature = match &surface.shape {
            SurfaceShape::Mesh(mesh) => mesh_curvature(mesh, hit),
            SurfaceShape::Paged(_) => self.geometry.with_paged(hit, mesh_curvature),
            SurfaceShape::Quadric(q) => q.curvature() * if surface.flip_normal { -1.0 } else { 1.0 },
            SurfaceShape::Patches(_) => 0.0,
        };
        let scale = match hit.instance {
            NONE => 1.0,
            i => {
                let m = &self.geometry.instances[i as usize].to_world.m;
                Mat3::from_mat4(m.as_mat4()).determinant().abs().cbrt()
            }
        };
        let curvature = curvature / scale;
        if curvature.is_finite() { curvature } else { 0.0 }
    }
}

/// Mean curvature by the normals of the corners.
fn mesh_curvature(mesh: &Mesh, hit: &Hit) -> f32 {
    if mesh.normals.is_empty() {
        return 0.0;
    }
    let [i0, i1, i2] = mesh.indices[hit.primitive as usize].map(|i| i as usize);
    let p0 = vec3(mesh.positions[i0]);
    let (a, b) = (vec3(mesh.positions[i1]) - p0, vec3(mesh.positions[i2]) - p0);
    let [n0, n1, n2] = [i0, i1, i2].map(|i| vec3(mesh.normals[i]).normalize_or_zero());
    let n = a.cross(b);
    // Half the divergence of the interpolated normal, by the gradients of barycentrics.
    let divergence = b.cross(n).dot(n1 - n0) + n.cross(a).dot(n2 - n0);
    0.5 * divergence / n.length_squared()
}

#[inline(always)]
fn mesh_tangents(mesh: &Mesh, hit: &Hit) -> Tangents {
    let [i0, i1, i2] = mesh.indices[hit.primitive as usize].map(|i| i as usize);
    let [p0, p1, p2] = [i0, i1, i2].map(|i| Vec3A::from_array(mesh.positions[i]));
    let along = [p1 - p0, p2 - p0];
    // pbrt's default coordinates where there are none.
    let duv = if mesh.uvs.is_empty() {
        [Vec2::X, Vec2::ONE]
    } else {
        let uv = [i0, i1, i2].map(|i| Vec2::from(mesh.uvs[i]));
        [uv[1] - uv[0], uv[2] - uv[0]]
    };
    Tangents { along, duv }
}

fn patch_tangents(patches: &Patches, hit: &Hit) -> Tangents {
    let (_, dpdu, dpdv) = patches.at(hit.primitive, hit.u.into(), hit.v.into());
    let duv = if patches.uvs.is_empty() {
        [Vec2::X, Vec2::Y]
    } else {
        let [t00, t10, t01, t11] =
            patches.indices[hit.primitive as usize].map(|i| Vec2::from(patches.uvs[i as usize]));
        [(t10 - t00) * (1.0 - hit.v) + (t11 - t01) * hit.v, (t01 - t00) * (1.0 - hit.u) + (t11 - t10) * hit.u]
    };
    Tangents { along: [dpdu.as_vec3a(), dpdv.as_vec3a()], duv }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::made::{Making, View};
    use crate::geometry::{Kinds, Needs, SceneGeometry, load};
    use crate::scene::pbrt::parse_str;
    use std::path::Path;

    fn geometry(shape: &str) -> SceneGeometry {
        let scene = parse_str(&format!("WorldBegin\n{shape}\n"), Path::new("test.pbrt")).expect("a scene");
        let view = View::new(&scene.camera, (1, 1), 1.0);
        let making = Making::new(&view, None, None);
        load(&scene, None, &making, &|| false).expect("geometry")
    }

    /// Change of (u, v) along `h`, which must come out the same as either axis.
    fn along(tangents: &Tangents, n: Vec3A, h: Vec3A) -> Vec2 {
        let [first, _] = tangents.uv(&FootprintEllipse { n, along: h, scale: [1.0, 0.0] });
        let turned = FootprintEllipse { n, along: h.cross(n), scale: [0.0, 1.0] };
        let [_, second] = tangents.uv(&turned);
        let step: Vec3 = (h - n * h.dot(n)).into();
        assert!((turned.axes()[1] - step).length() < 1e-5 * step.length());
        assert!((first - second).length() < 1e-4 * first.length(), "{first} {second}");
        first
    }

    /// Along small steps on the surface the map gives what the surface's own coordinates give.
    #[test]
    fn maps_agree_with_finite_differences() {
        let mesh = "Shape \"trianglemesh\" \"point3 P\" [ 0 0 0  2 .3 .1  .5 3 1 ]";
        let patch = "Shape \"bilinearmesh\" \"point3 P\" [ 0 0 0  3 .2 .1  .1 2 .3  2.5 2.2 1.5 ]";
        for (shape, h) in [
            (mesh.to_owned(), 1e-2),
            (format!("{mesh} \"point2 uv\" [ .1 .2  3 .4  .2 5 ]"), 1e-2),
            (patch.to_owned(), 1e-3),
            (format!("{patch} \"point2 uv\" [ .1 .2  3 .4  .2 5  4 6 ]"), 1e-3),
            (
                format!(
                    "ObjectBegin \"o\"\n{patch}\nObjectEnd\nRotate 30 1 2 3\nScale 2 .5 -3\nObjectInstance \"o\""
                ),
                1e-3,
            ),
            (
                format!(
                    "ObjectBegin \"o\"\n{mesh}\nObjectEnd\nRotate 30 1 2 3\nScale 2 .5 -3\nObjectInstance \"o\""
                ),
                1e-2,
            ),
        ] {
            let g = geometry(&shape);
            let surfaces = Surfaces::new(&g, |_| Needs::UV);
            let instance = if shape.contains("Instance") { 0 } else { NONE };
            let hit = |u, v| Hit { t: 1.0, u, v, geometry: 0, primitive: 0, instance, place: NONE };
            let ray = Ray::new(Vec3::ZERO, Vec3::Z);
            let at = |u, v| surfaces.surface_point(&hit(u, v), 0, || ray, Kinds::ALL);
            let (u, v) = (0.3, 0.4);
            let tangents = surfaces.tangents(&hit(u, v), 0, || ray);
            let n = at(u, v).ng;
            for (du, dv) in [(h, 0.0), (0.0, h), (h, -0.7 * h)] {
                let (a, b) = (at(u - du, v - dv), at(u + du, v + dv));
                let (got, want) = (along(&tangents, n, b.p - a.p), b.uv - a.uv);
                // Second order cancels; f32 leaves 1e-7 of the coordinates over steps of h.
                assert!((got - want).length() < 2e-3 * want.length(), "{shape}: {got}, not {want}");
            }
        }
    }

    #[test]
    fn quadrics_map_as_they_are_parametrised() {
        let g = geometry("Translate 1 2 3\nScale 2 2 2\nShape \"sphere\" \"float radius\" 1.5");
        let surfaces = Surfaces::new(&g, |_| Needs::UV);
        // From the centre, so that points lie where the ray goes; the sphere's radius is 3.
        let ray = |d: Vec3| Ray::new(Vec3::new(1.0, 2.0, 3.0), d.normalize());
        let hit = Hit { t: 3.0, u: 0.0, v: 0.0, geometry: 0, primitive: 0, instance: NONE, place: NONE };
        let at = |d: Vec3| surfaces.surface_point(&hit, 0, || ray(d), Kinds::ALL);
        let d = Vec3::new(0.3, 0.8, 0.4);
        let tangents = surfaces.tangents(&hit, 0, || ray(d));
        let n = at(d).ng;
        for step in [Vec3::X, Vec3::Y, Vec3::Z] {
            let (a, b) = (at(d - step * 1e-3), at(d + step * 1e-3));
            let (got, want) = (along(&tangents, n, b.p - a.p), b.uv - a.uv);
            assert!((got - want).length() < 2e-3 * want.length(), "{got}, not {want}");
        }
        assert!((surfaces.curvature(&hit, 0) - 1.0 / 3.0).abs() < 1e-6);
    }

    #[test]
    fn a_mesh_of_a_sphere_curves_as_the_sphere() {
        // A narrow triangle on a sphere of radius 2 with the sphere's normals.
        let corner = |x: f32, y: f32| Vec3::new(x, y, 3.0).normalize();
        let corners = [corner(0.2, 0.1), corner(0.6, 0.2), corner(0.3, 0.7)];
        let list = |scale: f32| {
            corners
                .iter()
                .map(|c| format!("{} {} {} ", c.x * scale, c.y * scale, c.z * scale))
                .collect::<String>()
        };
        let shape = |n: f32| {
            format!("Shape \"trianglemesh\" \"point3 P\" [ {} ] \"normal N\" [ {} ]", list(2.0), list(n))
        };
        let hit = Hit { t: 1.0, u: 0.3, v: 0.3, geometry: 0, primitive: 0, instance: NONE, place: NONE };
        let curvature = |text: &str, hit: &Hit| {
            let g = geometry(text);
            Surfaces::new(&g, |_| Needs::default()).curvature(hit, 0)
        };
        // The chord stands for the arc: second order in the edge, 0.05.
        assert!((curvature(&shape(1.0), &hit) - 0.5).abs() < 0.01);
        assert!((curvature(&shape(-5.0), &hit) + 0.5).abs() < 0.01);
        let placed =
            format!("ObjectBegin \"o\"\n{}\nObjectEnd\nScale 4 4 4\nObjectInstance \"o\"", shape(1.0));
        assert!((curvature(&placed, &Hit { instance: 0, ..hit }) - 0.125).abs() < 0.01);
        let flat = "Shape \"trianglemesh\" \"point3 P\" [ 0 0 0  2 .3 .1  .5 3 1 ]";
        assert_eq!(curvature(flat, &hit), 0.0);
    }
}
