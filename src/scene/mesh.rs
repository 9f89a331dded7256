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

/// Most `corners` at one of so many `vertices`; those elsewhere are an error that others find.
fn most_of_one(vertices: usize, corners: impl Iterator<Item = u32>) -> usize {
    let mut counts = vec![0; vertices];
    corners.for_each(|v| counts.get_mut(v as usize).into_iter().for_each(|count| *count += 1));
    counts.into_iter().max().unwrap_or(0)
}

impl TriangleMesh {
    /// Most triangles at one vertex.
    #[must_use]
    pub fn most_at_a_vertex(&self) -> usize {
        most_of_one(self.positions.len(), self.indices.iter().flatten().copied())
    }

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

/// Faces of any number of corners.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolygonMesh {
    /// Vertex positions.
    pub positions: Vec<[f32; 3]>,
    /// Corners of one face after the other, each below `positions.len()`.
    pub corners: Vec<u32>,
    /// Where the corners of each face end.
    pub ends: Vec<u32>,
}

impl PolygonMesh {
    /// The corners of each face.
    pub fn faces(&self) -> impl Iterator<Item = &[u32]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.corners[start as usize..end as usize])
    }
}

/// The control mesh of a subdivision surface, and by which scheme it is refined.
#[derive(Clone, Debug)]
pub enum Cage {
    /// Loop's, of triangles.
    Loop(Arc<TriangleMesh>),
    /// Catmull and Clark's, of polygons; refined once at least.
    CatmullClark(Arc<PolygonMesh>),
}

impl Cage {
    /// Most triangles after refinement.
    pub const MAX_TRIANGLES: u64 = 1 << 28;

    /// Triangles after `levels` of refinement, as far as numbers go.
    #[must_use]
    pub fn triangles(&self, levels: u32) -> u64 {
        match self {
            Self::Loop(mesh) => (mesh.indices.len() as u64).saturating_mul(4u64.saturating_pow(levels)),
            // First a quadrangle at each corner.
            Self::CatmullClark(mesh) => {
                let quads = 4u64.saturating_pow(levels.saturating_sub(1));
                (2 * mesh.corners.len() as u64).saturating_mul(quads)
            }
        }
    }

    /// Most faces that meet at a vertex, or will at the next level.
    #[must_use]
    pub fn most_at_a_vertex(&self) -> usize {
        match self {
            Self::Loop(mesh) => mesh.most_at_a_vertex(),
            // A face becomes a vertex with a quadrangle at each corner.
            Self::CatmullClark(mesh) => {
                let sides = mesh.faces().map(<[u32]>::len).max().unwrap_or(0);
                most_of_one(mesh.positions.len(), mesh.corners.iter().copied()).max(sides)
            }
        }
    }

    /// Vertices after `levels` of refinement of a closed surface, about.
    #[must_use]
    pub fn vertices(&self, levels: u32) -> u64 {
        let triangles = self.triangles(levels);
        match self {
            // A vertex of each edge; a closed mesh has half as many vertices as triangles.
            Self::Loop(mesh) => {
                mesh.positions.len() as u64 + triangles.saturating_sub(mesh.indices.len() as u64) / 2
            }
            // First one of each face and of each edge, of which two corners are; then as many as quadrangles.
            Self::CatmullClark(mesh) => {
                let corners = mesh.corners.len() as u64;
                let first = (mesh.positions.len() + mesh.ends.len()) as u64 + corners / 2;
                first + (triangles / 2).saturating_sub(corners)
            }
        }
    }
}

/// Where a mesh comes from; loaded when the plan asks for it.
#[derive(Clone, Debug)]
pub enum MeshSource {
    /// Given in the scene file.
    Inline(Arc<TriangleMesh>),
    /// A PLY file (triangles; quads and polygons become triangles).
    Ply(PathBuf),
    /// A subdivision surface.
    Subdivision {
        /// Control mesh.
        cage: Cage,
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
