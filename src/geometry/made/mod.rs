//! Geometry that is made, not read: displaced meshes and curves, from a control shape and the camera.
//!
//! Invariant: what is made depends on the control shape, where it is placed, the camera and the film, never on a ray or
//! the number of threads. An edge's rate follows from its end points alone, and what is at one place before it is moved
//! is at one place afterwards, so that nothing opens. Never asks for what a ray will need.

mod around;
mod curves;
mod displace;
mod parts;
mod patches;
mod refine;
mod rule;
mod seams;
mod view;

pub use around::Around;
pub use parts::{InPieces, Part, Parts, Piece};
pub use refine::MAX_TRIANGLES;
pub use view::{DEFAULT_EDGE_PIXELS, View};

use super::subdivision;
use crate::error::{Error, Result};
use crate::math::Transform;
use crate::prepare::{MOST_FACES_AT_A_VERTEX, STAYING_TRIANGLE, all_shapes, is_visible};
use crate::scene::{MeshSource, SceneDescription, Shape, ShapeKind, TextureId, TriangleMesh};
use crate::texture::Textures;
use displace::{Displaced, Displacement};
use parts::MOST_NAMES;
use patches::Patches;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// What makers are given.
pub struct Making<'a> {
    view: &'a View,
    textures: Option<&'a Arc<Textures>>,
    room: Option<u64>,
    /// Something would have become too large, which is an error.
    too_large: AtomicBool,
}

/// Most triangles at a vertex of a displaced mesh that is made part by part: each part there takes those that are near.
const MOST_TRIANGLES_AT_A_VERTEX: usize = 1024;

/// Triangles that are counted out however little memory there is, so that a refusal has a number.
const ALWAYS_COUNTED: u64 = 1 << 22;

impl<'a> Making<'a> {
    /// For what `view` sees; `textures` are there where something is displaced, and geometry may take `room` bytes, where
    /// there is a bound.
    #[must_use]
    pub fn new(view: &'a View, textures: Option<&'a Arc<Textures>>, room: Option<u64>) -> Self {
        Self { view, textures, room, too_large: AtomicBool::new(false) }
    }

    /// Whether something has been refused for its size.
    pub(super) fn was_too_large(&self) -> bool {
        self.too_large.load(Ordering::Relaxed)
    }

    /// An error of `shape`, with its place.
    fn placed(&self, e: Error, shape: &Shape) -> Error {
        match e {
            Error::Resource(what) => {
                self.too_large.store(true, Ordering::Relaxed);
                Error::at(&shape.at, what)
            }
            other => other,
        }
    }

    /// Triangles that there is room for where all of them stay.
    fn most_triangles(&self) -> usize {
        let fits = self.room.map_or(u64::MAX, |room| room / STAYING_TRIANGLE);
        usize::try_from(fits).unwrap_or(usize::MAX).min(MAX_TRIANGLES)
    }
}

/// An error of the control mesh of `shape`, with its place.
fn at_shape(e: Error, shape: &Shape) -> Error {
    match e {
        Error::Interrupted => e,
        other => Error::at(&shape.at, other.to_string()),
    }
}

/// Where a shape is in the world.
pub(super) struct Place<'a> {
    /// To world space, or to the space of its object.
    pub(super) to_world: &'a Transform,
    /// And from there to the world, in every place it has.
    pub(super) places: &'a [Transform],
}

/// A mesh in its own space, and what a person should know of it.
pub(super) struct MadeMesh {
    pub(super) mesh: TriangleMesh,
    /// Values of its texture that were no numbers.
    pub(super) not_numbers: u64,
}

/// The mesh that `shape` stands for, in the space of its control shape.
pub(super) fn make(
    source: &MeshSource,
    shape: &Shape,
    places: &[Transform],
    making: &Making<'_>,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<MadeMesh> {
    let placed = |e: Error| making.placed(e, shape);
    let place = Place { to_world: &shape.object_to_world, places };
    Ok(match source {
        MeshSource::Inline(mesh) => MadeMesh { mesh: TriangleMesh::clone(mesh), not_numbers: 0 },
        MeshSource::Ply(path) => MadeMesh { mesh: crate::scene::ply::read_ply(path)?, not_numbers: 0 },
        MeshSource::Subdivision { cage, levels } => {
            let mesh = subdivision::subdivide(cage, *levels, stop).map_err(|e| at_shape(e, shape))?;
            MadeMesh { mesh, not_numbers: 0 }
        }
        MeshSource::Curves(strands) => {
            MadeMesh { mesh: curves::draw(strands, &place, making.view).map_err(placed)?, not_numbers: 0 }
        }
        MeshSource::Displaced { base, texture, edge_length } => {
            let MadeMesh { mesh: base, .. } = make(base, shape, places, making, stop)?;
            let most = making.most_triangles();
            let moved = displaced(base, *texture, *edge_length, place, shape, making, most)?;
            moved.whole(most, stop).map_err(placed)?
        }
    })
}

/// `base`, to be divided into `most` triangles at most and moved.
fn displaced(
    base: TriangleMesh,
    texture: TextureId,
    edge_length: Option<f32>,
    place: Place<'_>,
    shape: &Shape,
    making: &Making<'_>,
    most: usize,
) -> Result<Displaced> {
    let textures = making.textures.expect("who loads a displaced mesh has its texture");
    let what = Displacement { texture, edge_length, textures, place, view: making.view };
    match what.lack(&base) {
        Some(lack) => Err(Error::at(&shape.at, lack)),
        None => what.of(base, most).map_err(|e| making.placed(e, shape)),
    }
}

/// The mesh that `shape` stands for in pieces of about `most` triangles; `None` where it is read, not made.
pub(super) fn in_pieces(
    source: &MeshSource,
    shape: &Shape,
    places: &[Transform],
    making: &Making<'_>,
    most: u32,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Option<InPieces>> {
    let placed = |e: Error| making.placed(e, shape);
    let place = Place { to_world: &shape.object_to_world, places };
    let pieces = match source {
        MeshSource::Inline(_) | MeshSource::Ply(_) => return Ok(None),
        MeshSource::Subdivision { cage, .. } if cage.most_at_a_vertex() > MOST_FACES_AT_A_VERTEX => {
            return Ok(None);
        }
        MeshSource::Subdivision { cage, levels } => {
            let pieces = subdivision::divide(cage, *levels, most);
            pieces.map_err(|e| at_shape(e, shape))?
        }
        MeshSource::Curves(strands) => curves::divide(strands, &place, making.view, most).map_err(placed)?,
        MeshSource::Displaced { base, texture, edge_length } => {
            let MadeMesh { mesh: base, .. } = make(base, shape, places, making, stop)?;
            if base.most_at_a_vertex() > MOST_TRIANGLES_AT_A_VERTEX {
                return Ok(None);
            }
            // Of each triangle a byte stays, and more: others are not counted out.
            let room = making.room.map_or(MOST_NAMES, |room| room.clamp(ALWAYS_COUNTED, MOST_NAMES));
            let limit = room as usize;
            let moved = displaced(base, *texture, *edge_length, place, shape, making, limit)?;
            Patches::divide(moved, most, limit, stop).map_err(placed)?
        }
    };
    Ok(Some(pieces))
}

/// Of each object of `scene`, and of the world last, the places where it stands.
pub(super) fn all_places(scene: &SceneDescription) -> Vec<Vec<Transform>> {
    let mut places = vec![Vec::new(); scene.objects.len()];
    for instance in &scene.instances {
        places[instance.object.index()].push(instance.instance_to_world);
    }
    places.push(vec![Transform::IDENTITY]);
    places
}

/// Whether something that is seen is displaced, so that textures have to be there before geometry.
#[must_use]
pub fn wants_textures(scene: &SceneDescription) -> bool {
    let displaced = |s: &Shape| match &s.kind {
        ShapeKind::Mesh(id) => matches!(scene.meshes[id.index()], MeshSource::Displaced { .. }),
        _ => false,
    };
    all_shapes(scene).any(|s| displaced(s) && is_visible(scene, s))
}

/// Vertices and triangles that will be made of each mesh of curves, by the index of the mesh; exact.
#[must_use]
pub fn curve_counts(scene: &SceneDescription, view: &View) -> Vec<Option<(u64, u64)>> {
    let mut counts = vec![None; scene.meshes.len()];
    let places = all_places(scene);
    let world = scene.shapes.iter().map(|s| (s, scene.objects.len()));
    let objects = scene.objects.iter().enumerate().flat_map(|(i, shapes)| shapes.iter().map(move |s| (s, i)));
    for (shape, object) in world.chain(objects) {
        if let ShapeKind::Mesh(id) = shape.kind
            && let MeshSource::Curves(strands) = &scene.meshes[id.index()]
        {
            let place = Place { to_world: &shape.object_to_world, places: &places[object] };
            counts[id.index()] = Some(curves::count(strands, &place, view));
        }
    }
    counts
}

#[cfg(test)]
mod tests;
