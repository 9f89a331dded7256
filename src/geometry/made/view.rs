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

/// A plane around what is in view, in camera space; `across` points away from that, and is of any length.
#[derive(Clone, Copy, Debug)]
struct Plane {
    across: DVec3,
    offset: f64,
}

impl Plane {
    /// Nothing is beyond it.
    const NOWHERE: Self = Self { across: DVec3::ZERO, offset: -1.0 };

    /// How far a point is beyond it, in units of the length of `across`.
    #[inline]
    fn beyond(&self, p: DVec3) -> f64 {
        self.across.dot(p) + self.offset
    }
}

/// The camera, as far as sizes go.
#[derive(Clone, Debug)]
pub struct View {
    world_to_camera: DMat4,
    lens: Lens,
    planes: [Plane; 5],
    edge_pixels: f64,
}

#[derive(Clone, Copy, Debug)]
enum Lens {
    /// All that is seen is seen from a point; a pixel at distance 1 is `spread` wide.
    Point { spread: f64 },
    /// A pixel is `pixel` wide everywhere.
    Parallel { pixel: f64 },
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
        // The window is at distance 1: a side of it at `side` times that, or at `side` from the axis.
        let sides = |f: &dyn Fn(DVec3, f64, f64) -> Plane| {
            let behind = Plane { across: DVec3::NEG_Z, offset: 0.0 };
            [behind, f(DVec3::X, 1.0, x1), f(DVec3::X, -1.0, x0), f(DVec3::Y, 1.0, y1), f(DVec3::Y, -1.0, y0)]
        };
        let (lens, planes) = match camera.kind {
            CameraKind::Perspective { fov_degrees } => {
                let tangent = (f64::from(fov_degrees).to_radians() * 0.5).tan();
                let plane = |axis: DVec3, sign: f64, side: f64| Plane {
                    across: sign * (axis - side * tangent * DVec3::Z),
                    offset: 0.0,
                };
                (Lens::Point { spread: pixel * tangent }, sides(&plane))
            }
            CameraKind::Orthographic => {
                let plane =
                    |axis: DVec3, sign: f64, side: f64| Plane { across: sign * axis, offset: -sign * side };
                (Lens::Parallel { pixel }, sides(&plane))
            }
            CameraKind::Spherical { .. } => {
                let spread = (4.0 * std::f64::consts::PI / (w * h)).sqrt();
                (Lens::Point { spread }, [Plane::NOWHERE; 5])
            }
        };
        let edge_pixels = f64::from(edge_pixels).max(f64::MIN_POSITIVE);
        Self { world_to_camera: camera.camera_to_world.inv, lens, planes, edge_pixels }
    }

    /// Pixels that an edge may have.
    pub(super) fn edge_pixels(&self) -> f64 {
        self.edge_pixels
    }

    /// A point of camera space, as [`Self::pixels`] asks for it.
    #[inline]
    fn eye(&self, p: DVec3) -> Eye {
        let outside = |(i, plane): (usize, &Plane)| u8::from(plane.beyond(p) > 0.0) << i;
        Eye { p, outside: self.planes.iter().enumerate().map(outside).sum() }
    }

    /// Pixels from `a` to `b`, seen face on from the eye; fewer out of view.
    #[inline]
    fn pixels(&self, a: &Eye, b: &Eye) -> f64 {
        let along = b.p - a.p;
        let length = along.length_squared();
        let nearest = || {
            let t = (-a.p.dot(along) / length).clamp(0.0, 1.0);
            (a.p + along * t).length_squared()
        };
        let pixels = match self.lens {
            Lens::Point { spread } => (length / nearest()).sqrt() / spread,
            Lens::Parallel { pixel } => length.sqrt() / pixel,
        };
        if a.outside & b.outside == 0 { pixels } else { pixels / OUT_OF_VIEW }
    }

    /// Most pixels that a unit may have within `radius` of `centre`, in camera space.
    fn pixels_per_unit(&self, centre: DVec3, radius: f64) -> f64 {
        let most = match self.lens {
            Lens::Point { spread } => 1.0 / (spread * (centre.length() - radius).max(0.0)),
            Lens::Parallel { pixel } => 1.0 / pixel,
        };
        // A plane's coefficients are not of unit length: its value changes by so much over the radius at most.
        let beyond = |plane: &Plane| plane.beyond(centre) > radius * plane.across.length();
        if self.planes.iter().any(beyond) { most / OUT_OF_VIEW } else { most }
    }
}

/// Of a matrix, how much longer it makes anything, about: exact without shear.
pub(super) fn stretch(m: &DMat4) -> f64 {
    [m.x_axis, m.y_axis, m.z_axis].map(|axis| axis.truncate().length()).into_iter().fold(0.0, f64::max)
}

/// A mesh's space, seen from everywhere it is placed.
pub(super) struct Seen {
    view: View,
    /// To camera space.
    near: Vec<DMat4>,
    /// Pixels a unit in every other place, at most.
    far: f64,
}

/// A point of camera space, and the planes around what is in view beyond which it is, a bit each.
#[derive(Clone, Copy, Debug)]
struct Eye {
    p: DVec3,
    outside: u8,
}

/// A point in the world, and where the camera is that sees it nearest.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    pub(super) world: DVec3,
    /// In camera space, from the first place.
    first: Eye,
}

impl Seen {
    /// What lies within `radius` of `centre`, in all of its `places`.
    pub(super) fn new(view: &View, places: &[Transform], centre: DVec3, radius: f64) -> Self {
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
        Self { view: view.clone(), near, far }
    }

    /// A point, as edges that end in it are looked at.
    #[inline]
    pub(super) fn spot(&self, world: DVec3) -> Spot {
        let first = self.near.first().map_or(DVec3::ZERO, |m| m.transform_point3(world));
        Spot { world, first: self.view.eye(first) }
    }

    /// The larger of the edge's pixels over those it may have, where it is largest.
    #[inline]
    pub(super) fn edge(&self, a: &Spot, b: &Spot) -> f64 {
        // Rounding must not depend on who asks.
        let before = |a: &DVec3, b: &DVec3| {
            a.to_array().partial_cmp(&b.to_array()) == Some(std::cmp::Ordering::Greater)
        };
        let (a, b) = if before(&a.world, &b.world) { (b, a) } else { (a, b) };
        let far = if self.far > 0.0 { self.far * (b.world - a.world).length() } else { 0.0 };
        let Some((_, others)) = self.near.split_first() else { return far / self.view.edge_pixels };
        let first = self.view.pixels(&a.first, &b.first);
        let near = others.iter().map(|m| {
            let [a, b] = [a, b].map(|spot| self.view.eye(m.transform_point3(spot.world)));
            self.view.pixels(&a, &b)
        });
        near.fold(far.max(first), f64::max) / self.view.edge_pixels
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
