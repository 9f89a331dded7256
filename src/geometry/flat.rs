//! Surfaces as hits ask for them: what every hit on a triangle reads, a cache line a surface, so that
//! shading reaches a vertex without walking through shapes and meshes. Borrows the geometry.
//!
//! Invariant: entry `s` speaks of surface `s`. Never copies a vertex.

use super::{Mesh, Needs, SceneGeometry, SurfaceShape};

/// All surfaces of a scene, ready for hits. Its questions are in `point.rs`.
pub struct Surfaces<'g> {
    pub(super) geometry: &'g SceneGeometry,
    pub(super) flat: Vec<Flat<'g>>,
}

/// A surface; 64 bytes.
pub(super) struct Flat<'g> {
    /// Corners of triangles; empty for other shapes.
    pub(super) indices: &'g [[u32; 3]],
    pub(super) positions: &'g [[f32; 3]],
    /// Shading normals, or empty.
    pub(super) normals: &'g [[f32; 3]],
    /// For what few hits need; `None` for shapes without triangles.
    pub(super) mesh: Option<&'g Mesh>,
    /// Attributes that the surface's material asks for.
    pub(super) needs: Needs,
    /// Whether the geometric normal is turned.
    pub(super) flip: bool,
}

impl<'g> Surfaces<'g> {
    /// For shading that asks for `needs` of each surface.
    #[must_use]
    pub fn new(geometry: &'g SceneGeometry, needs: impl Fn(usize) -> Needs) -> Self {
        let flat = geometry.surfaces.iter().enumerate().map(|(i, s)| {
            let mesh = match &s.shape {
                SurfaceShape::Mesh(mesh) => Some(mesh),
                SurfaceShape::Paged(_) | SurfaceShape::Patches(_) | SurfaceShape::Quadric(_) => None,
            };
            Flat {
                indices: mesh.map_or(&[], |m| &m.indices),
                positions: mesh.map_or(&[], |m| &m.positions),
                normals: mesh.map_or(&[], |m| &m.normals),
                mesh,
                needs: needs(i),
                flip: s.flip_normal,
            }
        });
        Self { geometry, flat: flat.collect() }
    }
}
