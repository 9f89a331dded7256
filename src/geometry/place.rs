//! Brings meshes into world space.
//!
//! Invariant: what becomes of a vertex depends on that vertex alone, so that a part of a mesh is placed as the whole is.

use super::Mesh;
use crate::math::Transform;
use crate::scene::TriangleMesh;
use glam::Vec3;

pub(super) fn place_mesh(mut mesh: TriangleMesh, to_world: &Transform, reverse: bool) -> Mesh {
    place_positions(&mut mesh.positions, to_world);
    if *to_world != Transform::IDENTITY {
        for t in &mut mesh.tangents {
            *t = to_world.vector(Vec3::from(*t)).to_array();
        }
    }
    // Embree reads 16 bytes at the last vertex.
    mesh.pad_positions();
    Mesh {
        normals: place_normals(mesh.normals, to_world, reverse),
        positions: mesh.positions,
        uvs: mesh.uvs,
        tangents: mesh.tangents,
        indices: mesh.indices,
    }
}

pub(super) fn place_positions(positions: &mut [[f32; 3]], to_world: &Transform) {
    if *to_world != Transform::IDENTITY {
        for v in positions {
            *v = to_world.point(Vec3::from(*v)).to_array();
        }
    }
}

pub(super) fn place_normals(
    mut normals: Vec<[f32; 3]>,
    to_world: &Transform,
    reverse: bool,
) -> Vec<[f32; 3]> {
    let sign = if reverse { -1.0 } else { 1.0 };
    for n in &mut normals {
        *n = (to_world.normal(Vec3::from(*n)).normalize_or_zero() * sign).to_array();
    }
    normals
}
