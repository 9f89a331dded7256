//! Camera rays from film positions, with the cone that one pixel covers. pbrt's conventions: the
//! camera looks along +z, y is up, raster y runs down, `fov` spans the shorter axis.

use crate::accel::Ray;
use crate::integrator::cone::Cone;
use crate::integrator::light::octahedral::square_to_sphere;
use crate::math::warp::concentric_disk;
use crate::scene::{self, CameraKind};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// A camera ready to make rays.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    kind: Projection,
    /// Raster to screen: screen = offset + raster · scale.
    offset: Vec2,
    scale: Vec2,
    /// Side of a pixel on the screen: the root of its area.
    pixel: f32,
    film: Vec2,
    /// Camera axes and position in world space.
    x: Vec3,
    y: Vec3,
    z: Vec3,
    position: Vec3,
    lens_radius: f32,
    focal_distance: f32,
}

#[derive(Clone, Copy, Debug)]
enum Projection {
    /// Half the tangent of the field of view scales the screen.
    Perspective {
        tangent: f32,
    },
    Orthographic,
    EqualArea,
    LatLong,
}

/// A ray with the footprint of its pixel.
#[derive(Clone, Copy, Debug)]
pub struct CameraRay {
    /// The ray; unit direction.
    pub ray: Ray,
    /// The cone that is as wide as a pixel (the geometric mean of its sides).
    pub cone: Cone,
}

impl Camera {
    /// For a film of `film` pixels.
    #[must_use]
    pub fn new(camera: &scene::Camera, film: (u32, u32)) -> Self {
        let (w, h) = (film.0 as f32, film.1 as f32);
        let aspect = camera.frame_aspect_ratio.unwrap_or(w / h);
        let [x0, x1, y0, y1] = camera.screen_window.unwrap_or(if aspect > 1.0 {
            [-aspect, aspect, -1.0, 1.0]
        } else {
            [-1.0, 1.0, -1.0 / aspect, 1.0 / aspect]
        });
        let kind = match camera.kind {
            CameraKind::Perspective { fov_degrees } => {
                Projection::Perspective { tangent: (fov_degrees.to_radians() * 0.5).tan() }
            }
            CameraKind::Orthographic => Projection::Orthographic,
            CameraKind::Spherical { equal_area: true } => Projection::EqualArea,
            CameraKind::Spherical { equal_area: false } => Projection::LatLong,
        };
        let t = &camera.camera_to_world;
        Self {
            kind,
            offset: Vec2::new(x0, y1),
            scale: Vec2::new((x1 - x0) / w, (y0 - y1) / h),
            pixel: ((x1 - x0) / w * (y1 - y0) / h).abs().sqrt(),
            film: Vec2::new(w, h),
            x: t.vector(Vec3::X),
            y: t.vector(Vec3::Y),
            z: t.vector(Vec3::Z),
            position: t.point(Vec3::ZERO),
            lens_radius: camera.lens_radius,
            focal_distance: camera.focal_distance,
        }
    }

    #[inline(always)]
    fn turn(&self, v: Vec3) -> Vec3 {
        self.x * v.x + self.y * v.y + self.z * v.z
    }

    /// The ray through `raster` (pixels, y down) and the lens point warped from `lens` in [0,1)², if `has_lens`.
    #[inline(always)]
    #[must_use]
    pub fn ray(&self, raster: Vec2, lens: Vec2, has_lens: bool) -> CameraRay {
        debug_assert!(has_lens || self.lens_radius == 0.0, "only kernels with a lens are given one");
        let screen = self.offset + raster * self.scale;
        let (mut origin, mut direction, width, spread);
        match self.kind {
            Projection::Perspective { tangent } => {
                origin = Vec3::ZERO;
                direction = Vec3::new(screen.x * tangent, screen.y * tangent, 1.0);
                width = 0.0;
                // A pixel's width over the distance to the screen; off the axis a pixel's solid angle
                // falls with the cube of the cosine.
                let cos = direction.length_recip();
                spread = self.pixel * tangent * cos * cos.sqrt();
                if has_lens && self.lens_radius > 0.0 {
                    let focus = direction * self.focal_distance;
                    let l = concentric_disk(lens) * self.lens_radius;
                    origin = Vec3::new(l.x, l.y, 0.0);
                    direction = focus - origin;
                }
            }
            Projection::Orthographic => {
                origin = Vec3::new(screen.x, screen.y, 0.0);
                direction = Vec3::Z;
                width = self.pixel * self.x.length();
                spread = 0.0;
                if has_lens && self.lens_radius > 0.0 {
                    let focus = origin + direction * self.focal_distance;
                    let l = concentric_disk(lens) * self.lens_radius;
                    origin += Vec3::new(l.x, l.y, 0.0);
                    direction = focus - origin;
                }
            }
            Projection::EqualArea | Projection::LatLong => {
                let uv = raster / self.film;
                let d = if let Projection::LatLong = self.kind {
                    let (theta, phi) = (PI * uv.y, 2.0 * PI * uv.x);
                    Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
                } else {
                    square_to_sphere(fold(uv))
                };
                origin = Vec3::ZERO;
                // pbrt's sphere has z up; the camera has y up.
                direction = Vec3::new(d.x, d.z, d.y);
                width = 0.0;
                spread = (4.0 * PI / (self.film.x * self.film.y)).sqrt();
            }
        }
        let ray = Ray::new(self.position + self.turn(origin), self.turn(direction).normalize());
        CameraRay { ray, cone: Cone { width, spread } }
    }
}

/// A point beyond an edge of the octahedral square, brought back: each edge is folded in its middle.
/// A filter reaches over the film's edge by a few pixels only.
fn fold(mut uv: Vec2) -> Vec2 {
    if uv.x < 0.0 || uv.x > 1.0 {
        uv.x = if uv.x < 0.0 { -uv.x } else { 2.0 - uv.x };
        uv.y = 1.0 - uv.y;
    }
    if uv.y < 0.0 || uv.y > 1.0 {
        uv.y = if uv.y < 0.0 { -uv.y } else { 2.0 - uv.y };
        uv.x = 1.0 - uv.x;
    }
    uv.clamp(Vec2::ZERO, Vec2::ONE)
}
