//! Spheres, disks and cylinders, possibly partial, solved in f64 in their own space: at
//! coordinates of 1e7 an f64 discriminant still has 2⁻²⁹ of relative room where f32 has none.

use crate::math::Transform;
use crate::scene::ShapeKind;
use glam::{DVec2, DVec3};
use std::f64::consts::PI;

/// Which quadric, object space, angles in radians.
#[derive(Clone, Copy, Debug)]
pub enum QuadricKind {
    /// Around the origin, clipped to z in [z_min, z_max].
    Sphere {
        /// Radius.
        radius: f64,
        /// Lower clip.
        z_min: f64,
        /// Upper clip.
        z_max: f64,
    },
    /// At z = height.
    Disk {
        /// Height.
        height: f64,
        /// Outer radius.
        radius: f64,
        /// Inner radius.
        inner: f64,
    },
    /// Around z.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Lower end.
        z_min: f64,
        /// Upper end.
        z_max: f64,
    },
}

/// A quadric with its sweep and its place.
#[derive(Clone, Debug)]
pub struct Quadric {
    /// Shape.
    pub kind: QuadricKind,
    /// Sweep in radians, (0, 2π].
    pub phi_max: f64,
    /// Object to world (or to instance space).
    pub to_world: Transform,
    /// As the scene described it.
    pub shape: ShapeKind,
}

/// A point of a quadric in world space.
pub struct QuadricPoint {
    /// Position.
    pub p: DVec3,
    /// ∂p/∂u.
    pub dpdu: DVec3,
    /// ∂p/∂v.
    pub dpdv: DVec3,
    /// Unit cross product of the two, before any flip.
    pub n: DVec3,
    /// Parameters.
    pub uv: DVec2,
}

impl Quadric {
    /// From the scene's parameters; `None` for meshes and patches.
    #[must_use]
    pub fn new(shape: &ShapeKind, to_world: Transform) -> Option<Self> {
        let (kind, phi) = match *shape {
            ShapeKind::Sphere { radius, z_min, z_max, phi_max_degrees } => {
                let r = f64::from(radius);
                let (a, b) = (f64::from(z_min.min(z_max)), f64::from(z_min.max(z_max)));
                (
                    QuadricKind::Sphere { radius: r, z_min: a.clamp(-r, r), z_max: b.clamp(-r, r) },
                    phi_max_degrees,
                )
            }
            ShapeKind::Disk { height, radius, inner_radius, phi_max_degrees } => (
                QuadricKind::Disk {
                    height: height.into(),
                    radius: radius.into(),
                    inner: inner_radius.into(),
                },
                phi_max_degrees,
            ),
            ShapeKind::Cylinder { radius, z_min, z_max, phi_max_degrees } => (
                QuadricKind::Cylinder {
                    radius: radius.into(),
                    z_min: z_min.min(z_max).into(),
                    z_max: z_min.max(z_max).into(),
                },
                phi_max_degrees,
            ),
            ShapeKind::Mesh(_) | ShapeKind::Patches(_) => return None,
        };
        Some(Self {
            kind,
            phi_max: f64::from(phi).clamp(0.0, 360.0).to_radians(),
            to_world,
            shape: shape.clone(),
        })
    }

    /// Mean curvature in world space, along `QuadricPoint::n`; scaled as if the transform were even.
    #[must_use]
    pub fn curvature(&self) -> f32 {
        let own = match self.kind {
            QuadricKind::Sphere { radius, .. } => 1.0 / radius,
            QuadricKind::Cylinder { radius, .. } => 0.5 / radius,
            QuadricKind::Disk { .. } => 0.0,
        };
        (own / self.to_world.m.determinant().cbrt()) as f32
    }

    /// Corners of the object-space box.
    #[must_use]
    pub fn object_bounds(&self) -> (DVec3, DVec3) {
        match self.kind {
            QuadricKind::Sphere { radius: r, z_min, z_max }
            | QuadricKind::Cylinder { radius: r, z_min, z_max } => {
                (DVec3::new(-r, -r, z_min), DVec3::new(r, r, z_max))
            }
            QuadricKind::Disk { height, radius: r, .. } => {
                (DVec3::new(-r, -r, height), DVec3::new(r, r, height))
            }
        }
    }

    /// φ in [0, 2π).
    fn phi(p: DVec3) -> f64 {
        let phi = p.y.atan2(p.x);
        if phi < 0.0 { phi + 2.0 * PI } else { phi }
    }

    fn inside_sweep(&self, p: DVec3) -> bool {
        self.phi_max >= 2.0 * PI || Self::phi(p) <= self.phi_max
    }

    /// Nearest t in (t_min, t_max) of the world-space ray; t is in units of `d`.
    #[must_use]
    pub fn intersect(&self, o: DVec3, d: DVec3, t_min: f64, t_max: f64) -> Option<f64> {
        let o = self.to_world.inv.transform_point3(o);
        let d = self.to_world.inv.transform_vector3(d);
        let accept = |t: f64, clip: &dyn Fn(DVec3) -> bool| {
            t > t_min && t < t_max && {
                let p = o + d * t;
                clip(p) && self.inside_sweep(p)
            }
        };
        match self.kind {
            QuadricKind::Sphere { radius, z_min, z_max } => {
                let full = z_min <= -radius && z_max >= radius;
                let clip = |p: DVec3| full || (p.z >= z_min && p.z <= z_max);
                let a = d.length_squared();
                let b = o.dot(d);
                // Distance of the line to the centre, from the perpendicular: no cancellation
                // for far origins (Hearn and Baker; pbrt 4th ed. §6.8.3).
                let perpendicular = o - d * (b / a);
                let discriminant = a * (radius * radius - perpendicular.length_squared());
                let (t0, t1) = roots(a, b, o.length_squared() - radius * radius, discriminant)?;
                [t0, t1].into_iter().find(|&t| accept(t, &clip))
            }
            QuadricKind::Cylinder { radius, z_min, z_max } => {
                let clip = |p: DVec3| p.z >= z_min && p.z <= z_max;
                let (o2, d2) = (o.truncate(), d.truncate());
                let a = d2.length_squared();
                if a == 0.0 {
                    return None;
                }
                let b = o2.dot(d2);
                let perpendicular = o2 - d2 * (b / a);
                let discriminant = a * (radius * radius - perpendicular.length_squared());
                let (t0, t1) = roots(a, b, o2.length_squared() - radius * radius, discriminant)?;
                [t0, t1].into_iter().find(|&t| accept(t, &clip))
            }
            QuadricKind::Disk { height, radius, inner } => {
                if d.z == 0.0 {
                    return None;
                }
                let t = (height - o.z) / d.z;
                let clip = |p: DVec3| {
                    let r2 = p.truncate().length_squared();
                    r2 <= radius * radius && r2 >= inner * inner
                };
                accept(t, &clip).then_some(t)
            }
        }
    }

    /// Everything at a world-space point near the surface; the point is put onto it first, so
    /// that the error of an f32 ray parameter along the ray does not lift it off.
    #[must_use]
    pub fn at(&self, near: DVec3) -> QuadricPoint {
        let mut p = self.to_world.inv.transform_point3(near);
        let phi = Self::phi(p).min(self.phi_max);
        let u = phi / self.phi_max;
        let (v, dpdu, dpdv);
        match self.kind {
            QuadricKind::Sphere { radius, z_min, z_max } => {
                let l = p.length();
                p = if l > 0.0 { p * (radius / l) } else { DVec3::new(radius, 0.0, 0.0) };
                let (theta_min, theta_max) =
                    ((z_min / radius).clamp(-1.0, 1.0).acos(), (z_max / radius).clamp(-1.0, 1.0).acos());
                let theta = (p.z / radius).clamp(-1.0, 1.0).acos();
                v = (theta - theta_min) / (theta_max - theta_min);
                let r = p.truncate().length();
                let (c, s) = if r > 0.0 { (p.x / r, p.y / r) } else { (1.0, 0.0) };
                // At a pole ∂p/∂u vanishes; its direction is still that of the meridian's normal.
                let ru = r.max(radius * 1e-9);
                dpdu = DVec3::new(-s * ru, c * ru, 0.0) * self.phi_max;
                dpdv = DVec3::new(p.z * c, p.z * s, -r) * (theta_max - theta_min);
            }
            QuadricKind::Cylinder { radius, z_min, z_max } => {
                let r = p.truncate().length();
                if r > 0.0 {
                    p.x *= radius / r;
                    p.y *= radius / r;
                }
                v = (p.z - z_min) / (z_max - z_min);
                dpdu = DVec3::new(-p.y, p.x, 0.0) * self.phi_max;
                dpdv = DVec3::new(0.0, 0.0, z_max - z_min);
            }
            QuadricKind::Disk { height, radius, inner } => {
                p.z = height;
                let r = p.truncate().length();
                let (c, s) = if r > 0.0 { (p.x / r, p.y / r) } else { (1.0, 0.0) };
                v = (radius - r) / (radius - inner);
                let ru = r.max(radius * 1e-9);
                dpdu = DVec3::new(-s * ru, c * ru, 0.0) * self.phi_max;
                dpdv = DVec3::new(c, s, 0.0) * (inner - radius);
            }
        }
        let m = &self.to_world.m;
        let n = self.to_world.inv.transpose().transform_vector3(dpdu.cross(dpdv)).normalize_or_zero();
        QuadricPoint {
            p: m.transform_point3(p),
            dpdu: m.transform_vector3(dpdu),
            dpdv: m.transform_vector3(dpdv),
            n,
            uv: DVec2::new(u, v),
        }
    }
}

/// Roots of a·t² + 2b·t + c with the discriminant given; smaller first.
fn roots(a: f64, b: f64, c: f64, discriminant: f64) -> Option<(f64, f64)> {
    if !(discriminant >= 0.0 && a > 0.0) {
        return None;
    }
    let root = discriminant.sqrt();
    let q = if b < 0.0 { -b + root } else { -b - root };
    let (t0, t1) = (q / a, if q != 0.0 { c / q } else { 0.0 });
    Some(if t0 < t1 { (t0, t1) } else { (t1, t0) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat4;

    fn sphere(radius: f32) -> Quadric {
        let kind = ShapeKind::Sphere { radius, z_min: -radius, z_max: radius, phi_max_degrees: 360.0 };
        Quadric::new(&kind, Transform::IDENTITY).expect("a sphere is a quadric")
    }

    #[test]
    fn sphere_is_hit_where_it_stands() {
        let s = sphere(2.0);
        let t = s.intersect(DVec3::new(0.0, 0.0, -10.0), DVec3::Z, 0.0, f64::INFINITY);
        assert!((t.expect("through the centre") - 8.0).abs() < 1e-12);
        let inside = s.intersect(DVec3::ZERO, DVec3::X, 0.0, f64::INFINITY);
        assert!((inside.expect("from the centre") - 2.0).abs() < 1e-12);
        assert!(s.intersect(DVec3::new(0.0, 2.1, -10.0), DVec3::Z, 0.0, f64::INFINITY).is_none());
    }

    #[test]
    fn normals_point_outwards_and_follow_the_transform() {
        let mut s = sphere(1.0);
        s.to_world =
            Transform::from_matrix(DMat4::from_scale(DVec3::new(1.0, 3.0, 1.0))).expect("invertible");
        let q = s.at(DVec3::new(0.0, 3.0, 0.0));
        assert!((q.n - DVec3::Y).length() < 1e-9);
        assert!((q.p - DVec3::new(0.0, 3.0, 0.0)).length() < 1e-9);
    }

    #[test]
    fn far_away_spheres_are_not_missed() {
        // A unit sphere seen from 1e7: the f32 discriminant would be lost.
        let s = sphere(1.0);
        let t = s.intersect(DVec3::new(0.999_999, 0.0, -1e7), DVec3::Z, 0.0, f64::INFINITY);
        let expected = 1e7 - (1.0f64 - 0.999_999 * 0.999_999).sqrt();
        assert!((t.expect("just inside the rim") - expected).abs() < 1e-6);
    }

    #[test]
    fn disk_and_cylinder_clip_to_their_sweep() {
        let disk = ShapeKind::Disk { height: 1.0, radius: 2.0, inner_radius: 1.0, phi_max_degrees: 90.0 };
        let d = Quadric::new(&disk, Transform::IDENTITY).expect("a disk is a quadric");
        let down = |x: f64, y: f64| d.intersect(DVec3::new(x, y, 5.0), -DVec3::Z, 0.0, f64::INFINITY);
        assert_eq!(down(1.0, 1.0), Some(4.0));
        assert_eq!(down(-1.0, 1.0), None);
        assert_eq!(down(0.3, 0.3), None);
        assert!((d.at(DVec3::new(1.0, 1.0, 1.0)).n - DVec3::Z).length() < 1e-9);
        let cylinder = ShapeKind::Cylinder { radius: 1.0, z_min: 0.0, z_max: 2.0, phi_max_degrees: 360.0 };
        let c = Quadric::new(&cylinder, Transform::IDENTITY).expect("a cylinder is a quadric");
        let side = |z: f64| c.intersect(DVec3::new(5.0, 0.0, z), -DVec3::X, 0.0, f64::INFINITY);
        assert_eq!(side(1.0), Some(4.0));
        assert_eq!(side(2.5), None);
    }
}
