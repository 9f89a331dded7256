//! Vertices as they come out of a reader: plain columns, object space.

use crate::scene::curve::Strand;
use crate::scene::description::TextureId;
use std::path::PathBuf;
use std::sync::Arc;

/// Triangles. `normals` and `uvs` are empty or as long as `positions`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertex positions.
    pub positions: Vec<[f32; 3]>,
    /// Shading normals, not necessarily unit; empty when absent.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates; empty when absent.
    pub uvs: Vec<[f32; 2]>,
    /// Shading tangents (pbrt's `S`); empty when absent.
    pub tangents: Vec<[f32; 3]>,
    /// Corner indices, each below `positions.len()`.
    pub indices: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// Leaves room for one vertex behind the last in the positions' allocation: Embree loads
    /// 16 bytes at every 12-byte vertex. Every reader ends with this; nothing else arranges it.
    pub fn pad_positions(&mut self) {
        self.positions.reserve_exact(1);
    }
}

/// Bilinear patches; corners p00, p10, p01, p11 as pbrt orders them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PatchMesh {
    /// Vertex positions.
    pub positions: Vec<[f32; 3]>,
    /// Shading normals; empty when absent.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates; empty when absent (the patch's own u, v then).
    pub uvs: Vec<[f32; 2]>,
    /// Four corners a patch.
    pub indices: Vec<[u32; 4]>,
}

/// Where a mesh comes from; loaded when the plan asks for it.
#[derive(Clone, Debug)]
pub enum MeshSource {
    /// Given in the scene file.
    Inline(Arc<TriangleMesh>),
    /// A PLY file (triangles; quads and polygons become triangles).
    Ply(PathBuf),
    /// Loop subdivision of a control mesh.
    Loop {
        /// Control mesh.
        control: Arc<TriangleMesh>,
        /// Levels of refinement.
        levels: u32,
    },
    /// Another mesh, refined and moved along its normals by a texture.
    Displaced {
        /// What is refined; never displaced itself.
        base: Box<MeshSource>,
        /// How far, in the units of the mesh.
        texture: TextureId,
        /// No edge is longer, in world units (pbrt's `displacement.edgelength`); `None`: only what is seen decides.
        edge_length: Option<f32>,
    },
    /// Curves, each of its own control points.
    Curves(Arc<Vec<Strand>>),
}
