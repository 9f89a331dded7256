//! How large things are on the film: what fixes the rate of everything that is made.
//!
//! Invariant: the answer depends on the camera, the film and the points that are asked about, in whatever order these
//! are given; never on a ray. Never knows a mesh.

use crate::math::{DMat4, DVec3, Transform};
use crate::scene::{Camera, CameraKind};

/// Pixels of an edge where nobody asks for another number.
pub const DEFAULT_EDGE_PIXELS: f32 = 2.0;
/// What the camera does not see may be so much coarser: its shadows and reflections are on the film.
const OUT_OF_VIEW: f64 = 8.0;
/// The window reaches so much farther than the film, in halves of its sides: what is moved may come into view.
const MARGIN: f64 = 0.25;
/// Instances that are looked at one by one beside those that may touch the eye; one bound stands for the others.
const LOOKED_AT: usize = 8;

/// Distance beyond a plane, in any unit.
type Plane<'a> = &'a dyn Fn(DVec3) -> f64;

/// The camera, as far as sizes go.
#[derive(Clone, Debug)]
pub struct View {
    world_to_camera: DMat4,
    lens: Lens,
    edge_pixels: f64,
}

#[derive(Clone, Copy, Debug)]
enum Lens {
    /// A pixel at distance 1 is `spread` wide; the window is at distance 1.
    Perspective { spread: f64, window: [f64; 4] },
    /// A pixel is `pixel` wide.
    Orthographic { pixel: f64, window: [f64; 4] },
    /// All around.
    Sphere { spread: f64 },
}

impl View {
    /// Of `camera` on a film of `film` pixels, on which edges are to be `edge_pixels` long at most.
    #[must_use]
    pub fn new(camera: &Camera, film: (u32, u32), edge_pixels: f32) -> Self {
        let (w, h) = (f64::from(film.0), f64::from(film.1));
        let aspect = camera.frame_aspect_ratio.map_or(w / h, f64::from);
        let [x0, x1, y0, y1] = camera.screen_window.map_or_else(
            || {
                if aspect > 1.0 {
                    [-aspect, aspect, -1.0, 1.0]
                } else {
                    [-1.0, 1.0, -1.0 / aspect, 1.0 / aspect]
                }
            },
            |window| window.map(f64::from),
        );
        let pixel = ((x1 - x0) / w * (y1 - y0) / h).abs().sqrt();
        let wider = |a: f64, b: f64| {
            let (lo, hi) = (a.min(b), a.max(b));
            let margin = MARGIN * 0.5 * (hi - lo);
            (lo - margin, hi + margin)
        };
        let ((x0, x1), (y0, y1)) = (wider(x0, x1), wider(y0, y1));
        let lens = match camera.kind {
            CameraKind::Perspective { fov_degrees } => {
                let tangent = (f64::from(fov_degrees).to_radians() * 0.5).tan();
                Lens::Perspective { spread: pixel * tangent, window: [x0, x1, y0, y1].map(|c| c * tangent) }
            }
            CameraKind::Orthographic => Lens::Orthographic { pixel, window: [x0, x1, y0, y1] },
            CameraKind::Spherical { .. } => {
                Lens::Sphere { spread: (4.0 * std::f64::consts::PI / (w * h)).sqrt() }
            }
        };
        let edge_pixels = f64::from(edge_pixels).max(f64::MIN_POSITIVE);
        Self { world_to_camera: camera.camera_to_world.inv, lens, edge_pixels }
    }

    /// Pixels that an edge may have.
    pub(super) fn edge_pixels(&self) -> f64 {
        self.edge_pixels
    }

    /// Pixels from `a` to `b` in camera space, seen face on from the eye; fewer out of view.
    fn pixels(&self, a: DVec3, b: DVec3) -> f64 {
        let along = b - a;
        let length = along.length();
        let nearest = || {
            let t = (-a.dot(along) / along.length_squared()).clamp(0.0, 1.0);
            (a + along * t).length()
        };
        let pixels = match self.lens {
            Lens::Perspective { spread, .. } | Lens::Sphere { spread } => length / (spread * nearest()),
            Lens::Orthographic { pixel, .. } => length / pixel,
        };
        let both = |f: Plane<'_>| f(a) > 0.0 && f(b) > 0.0;
        if self.beyond(&both) { pixels / OUT_OF_VIEW } else { pixels }
    }

    /// Whether all of something is beyond one of the planes around what is in view; `all` says of a distance whether it
    /// is positive everywhere.
    fn beyond(&self, all: &dyn Fn(Plane<'_>) -> bool) -> bool {
        match self.lens {
            Lens::Sphere { .. } => false,
            Lens::Perspective { window: [x0, x1, y0, y1], .. } => {
                all(&|p| -p.z)
                    || all(&|p| p.x - x1 * p.z)
                    || all(&|p| x0 * p.z - p.x)
                    || all(&|p| p.y - y1 * p.z)
                    || all(&|p| y0 * p.z - p.y)
            }
            Lens::Orthographic { window: [x0, x1, y0, y1], .. } => {
                all(&|p| -p.z)
                    || all(&|p| p.x - x1)
                    || all(&|p| x0 - p.x)
                    || all(&|p| p.y - y1)
                    || all(&|p| y0 - p.y)
            }
        }
    }

    /// Most pixels that a unit may have within `radius` of `centre`, in camera space.
    fn pixels_per_unit(&self, centre: DVec3, radius: f64) -> f64 {
        let most = match self.lens {
            Lens::Perspective { spread, .. } | Lens::Sphere { spread } => {
                1.0 / (spread * (centre.length() - radius).max(0.0))
            }
            Lens::Orthographic { pixel, .. } => 1.0 / pixel,
        };
        // A plane's coefficients are not of unit length: its value changes by so much over the radius at most.
        let reach = |f: Plane<'_>| {
            let gradient = DVec3::new(f(DVec3::X), f(DVec3::Y), f(DVec3::Z)) - DVec3::splat(f(DVec3::ZERO));
            f(centre) > radius * gradient.length()
        };
        if self.beyond(&reach) { most / OUT_OF_VIEW } else { most }
    }
}

/// Of a matrix, how much longer it makes anything, about: exact without shear.
pub(super) fn stretch(m: &DMat4) -> f64 {
    [m.x_axis, m.y_axis, m.z_axis].map(|axis| axis.truncate().length()).into_iter().fold(0.0, f64::max)
}

/// A mesh's space, seen from everywhere it is placed.
pub(super) struct Seen<'a> {
    view: &'a View,
    /// To camera space.
    near: Vec<DMat4>,
    /// Pixels a unit in every other place, at most.
    far: f64,
}

impl<'a> Seen<'a> {
    /// What lies within `radius` of `centre`, in all of its `places`.
    pub(super) fn new(view: &'a View, places: &[Transform], centre: DVec3, radius: f64) -> Self {
        let all = places.iter().map(|place| {
            let m = view.world_to_camera * place.m;
            let stretch = stretch(&m);
            (view.pixels_per_unit(m.transform_point3(centre), stretch * radius) * stretch, m)
        });
        let mut all: Vec<(f64, DMat4)> = all.collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let touching = all.iter().take_while(|(bound, _)| !bound.is_finite()).count();
        let far = all.get(touching + LOOKED_AT).map_or(0.0, |(bound, _)| *bound);
        let near = all.iter().take(touching + LOOKED_AT).map(|(_, m)| *m).collect();
        Self { view, near, far }
    }

    /// The larger of the edge's pixels over those it may have, where it is largest.
    pub(super) fn edge(&self, a: DVec3, b: DVec3) -> f64 {
        // Rounding must not depend on who asks.
        let before = |a: &DVec3, b: &DVec3| {
            a.to_array().partial_cmp(&b.to_array()) == Some(std::cmp::Ordering::Greater)
        };
        let (a, b) = if before(&a, &b) { (b, a) } else { (a, b) };
        let far = self.far * (b - a).length();
        let near = self.near.iter().map(|m| self.view.pixels(m.transform_point3(a), m.transform_point3(b)));
        near.fold(far, f64::max) / self.view.edge_pixels
    }

    /// Pixels that a unit has within `radius` of `centre`, at most.
    pub(super) fn pixels_per_unit(&self, centre: DVec3, radius: f64) -> f64 {
        let near = self.near.iter().map(|m| {
            let stretch = stretch(m);
            self.view.pixels_per_unit(m.transform_point3(centre), stretch * radius) * stretch
        });
        near.fold(self.far, f64::max)
    }
}
