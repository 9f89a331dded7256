//! Loads the shapes of a scene and answers "what is at this hit". Owns every vertex; Embree only
//! borrows them. Never decides what is needed: the caller's [`Needs`] do.
//!
//! Invariant: geometry `g` of the world (or of an object) in the acceleration structure is
//! surface `g` (or the object's base + `g`) here.

mod custom;
mod flat;
mod load;
pub mod made;
pub mod pages;
mod patch;
mod place;
mod point;
mod quadric;
pub mod subdivision;
mod tangents;

pub use flat::Surfaces;
pub use load::{Opacity, Paging, SceneGeometry, load};
pub use patch::blend_corners;
pub use point::{Kinds, Needs, SurfacePoint, offset_origin};
pub use quadric::Quadric;
pub use tangents::{FootprintEllipse, Tangents};

use crate::math::Transform;
use crate::scene::{AreaLightId, MaterialId, MediumInterface, TextureId};
use glam::Vec3;
use pages::PagedMesh;

/// A loaded triangle mesh, in world space (in object space inside an object).
#[derive(Debug, Default)]
pub struct Mesh {
    /// Vertices; the allocation has room for one more, which Embree's 16-byte reads need.
    pub positions: Vec<[f32; 3]>,
    /// Unit shading normals, or empty.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates, or empty.
    pub uvs: Vec<[f32; 2]>,
    /// Shading tangents, or empty.
    pub tangents: Vec<[f32; 3]>,
    /// Corners.
    pub indices: Vec<[u32; 3]>,
}

/// Bilinear patches in world (or object) space.
#[derive(Debug, Default)]
pub struct Patches {
    /// Vertices.
    pub positions: Vec<[f32; 3]>,
    /// Unit shading normals, or empty.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates, or empty.
    pub uvs: Vec<[f32; 2]>,
    /// Corners p00, p10, p01, p11.
    pub indices: Vec<[u32; 4]>,
}

impl Mesh {
    /// Bytes of its columns.
    #[must_use]
    pub fn bytes(&self) -> usize {
        12 * (self.positions.capacity() + self.normals.len() + self.tangents.len() + self.indices.len())
            + 8 * self.uvs.len()
    }
}

/// Shape of a surface.
#[derive(Debug)]
pub enum SurfaceShape {
    /// Triangles.
    Mesh(Mesh),
    /// Triangles that come and go.
    Paged(PagedMesh),
    /// Bilinear patches.
    Patches(Patches),
    /// Sphere, disk or cylinder.
    Quadric(Quadric),
}

/// A shape and what its attributes said, in the order of the acceleration structure.
#[derive(Debug)]
pub struct Surface {
    /// Geometry.
    pub shape: SurfaceShape,
    /// Material.
    pub material: MaterialId,
    /// Whether the geometric normal is turned against cross(dp/du, dp/dv).
    pub flip_normal: bool,
    /// Emission.
    pub area_light: Option<AreaLightId>,
    /// Opacity texture.
    pub alpha: Option<TextureId>,
    /// Media on both sides.
    pub medium: Option<MediumInterface>,
}

/// An object placed in the world.
#[derive(Clone, Copy, Debug)]
pub struct PlacedInstance {
    /// Object to world.
    pub to_world: Transform,
    /// Index of the object in [`SceneGeometry::objects`].
    pub object: u32,
    /// Index of the object's first surface.
    pub surface_base: u32,
}

/// As a vector.
#[inline(always)]
pub(crate) fn vec3(a: [f32; 3]) -> Vec3 {
    Vec3::from_array(a)
}
