//! Closest hit and occlusion over slices of geometry. Knows no store, no material and no file.
//! Whoever builds a [`Accel`] keeps the vertex memory alive; a query allocates nothing.

mod backend;
pub mod bvh;
#[cfg(feature = "embree")]
pub mod embree;

pub use backend::Builder;
use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use std::ops::Range;

/// "No geometry", "no instance".
pub const NONE: u32 = u32::MAX;

/// A ray: points `origin + t·direction` for t in (t_min, t_max). `direction` need not be unit.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Ray {
    /// Origin, world space.
    pub origin: Vec3,
    /// Direction, world space.
    pub direction: Vec3,
    /// Nearest distance that counts.
    pub t_min: f32,
    /// Farthest distance that counts.
    pub t_max: f32,
}

impl Ray {
    /// From `origin` along `direction` without end.
    #[inline(always)]
    #[must_use]
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
    }
}

/// The nearest intersection. `geometry == NONE` is a miss.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Hit {
    /// Distance along the ray in units of its direction's length.
    pub t: f32,
    /// First parameter of the primitive: for triangles the weight of vertex 1.
    pub u: f32,
    /// Second parameter: for triangles the weight of vertex 2.
    pub v: f32,
    /// Index of the geometry in the order it was given; inside an instance, within its object.
    pub geometry: u32,
    /// Index of the primitive in its geometry.
    pub primitive: u32,
    /// Index of the instance, or [`NONE`].
    pub instance: u32,
    /// Where in which page the primitive lies ([`bvh::PageView`]), or [`NONE`] where geometry does not come
    /// and go.
    pub place: u32,
}

impl Hit {
    /// No intersection.
    pub const MISS: Self = Self {
        t: f32::INFINITY,
        u: 0.0,
        v: 0.0,
        geometry: NONE,
        primitive: NONE,
        instance: NONE,
        place: NONE,
    };
}

/// Primitives that intersect themselves (quadrics, patches), and per-hit opacity; implemented by
/// the room that owns the shapes.
pub trait Custom: Sync + Send {
    /// Axis-aligned bounds of primitive `primitive` of the geometry known as `user`, in its
    /// object's space.
    fn bounds(&self, user: u32, primitive: u32) -> (Vec3, Vec3);
    /// Nearest intersection in (t_min, t_max): t, u, v.
    fn intersect(&self, user: u32, primitive: u32, ray: &Ray) -> Option<(f32, f32, f32)>;
    /// Whether the surface is there at the hit (t, u, v) of this ray (alpha masks). The answer may
    /// depend on the ray and the hit, and on nothing else.
    fn is_opaque(&self, user: u32, primitive: u32, hit: (f32, f32, f32), ray: &Ray) -> bool;
}

/// Geometry handed to a backend.
#[derive(Clone, Copy)]
pub enum Geometry<'a> {
    /// Triangles over shared vertex memory, which must outlive the scene and be readable for 16
    /// bytes at the last vertex.
    Triangles {
        /// Vertices.
        positions: &'a [[f32; 3]],
        /// Corners.
        indices: &'a [[u32; 3]],
        /// Name passed to [`Custom::is_opaque`]; `None` when every hit counts.
        alpha: Option<u32>,
    },
    /// Primitives that [`Custom`] intersects.
    Custom {
        /// How many.
        count: u32,
        /// Name passed to [`Custom`].
        user: u32,
        /// Whether to ask [`Custom::is_opaque`].
        alpha: bool,
    },
    /// Triangles that come and go, page by page. For the native hierarchy alone.
    Pages {
        /// Name of the first page, passed to [`Pages::visit`]; the others follow.
        first: u32,
        /// Where their triangles are.
        outlines: &'a [bvh::Outline],
    },
}

/// Where pages come from; implemented by the room that owns them.
pub trait Pages: Sync + Send {
    /// Calls `look` with the bytes of page `page` ([`bvh::PageView`] reads them), which stay where they are
    /// until it returns. May wait for a disk.
    fn visit(&self, page: u32, look: &mut dyn FnMut(&[u8]));
}

/// A box with pages in it.
#[derive(Clone, Debug)]
pub struct PageBox {
    /// Least corner, world space.
    pub lo: Vec3,
    /// Greatest corner.
    pub hi: Vec3,
    /// Names of the pages.
    pub pages: Range<u32>,
}

/// One object placed in the world.
#[derive(Clone, Copy, Debug)]
pub struct InstanceOf {
    /// Index of the object's scene.
    pub object: u32,
    /// Object to world, column-major 3×4 (three axes, then translation).
    pub transform: [f32; 12],
}

/// Answers rays.
pub trait Accel: Send + Sync {
    /// The nearest hit.
    fn closest(&self, ray: &Ray) -> Hit;
    /// Whether anything lies in (t_min, t_max).
    fn occluded(&self, ray: &Ray) -> bool;
    /// The nearer of `so_far` and the nearest hit of what the ray enters in \[`from`, `to`). Asked of parts that
    /// follow each other from minus infinity on, each time with the last answer, it gives what [`Self::closest`]
    /// does, to the bit, wherever they are cut: with the last part, or as soon as the answer is nearer than `to`.
    /// A backend that knows no parts answers in the first.
    fn closest_part(&self, ray: &Ray, from: f32, to: f32, so_far: &Hit) -> Hit {
        let _ = to;
        if from == f32::NEG_INFINITY { self.closest(ray) } else { *so_far }
    }
    /// [`Self::occluded`] likewise.
    fn occluded_part(&self, ray: &Ray, from: f32, to: f32) -> bool {
        let _ = to;
        from == f32::NEG_INFINITY && self.occluded(ray)
    }
    /// Where in the world pages lie, if there are any: what a scheduler may want to know.
    fn pages(&self) -> Vec<PageBox> {
        Vec::new()
    }
    /// Bytes held by acceleration structures now, as far as the backend reports them.
    fn bytes(&self) -> u64;
    /// World bounds; an empty scene has min > max.
    fn bounds(&self) -> (Vec3, Vec3);
}
