//! PLY files (Turk 1994): ascii, and binary in both byte orders, plain or gzipped, into a
//! [`TriangleMesh`]. Reads x y z, nx ny nz, (u v | s t | texture_u texture_v | texture_s texture_t)
//! of `vertex` and `vertex_indices` (`vertex_index`) of `face`; skips every other element and
//! property. Polygons become triangles; faces that repeat a vertex vanish.
//!
//! Invariant: memory follows the bytes that are there, never a count that a header claims.
//! Never moves, welds or reorders vertices.

mod body;
mod header;
mod stream;
mod survey;
mod vertices;

pub use survey::{MeshFacts, survey};

use crate::color::Rgb;
use crate::error::{Error, Location, Result};
use crate::math::Transform;
use crate::scene::{
    Material, MaterialId, MeshId, MeshSource, SceneDescription, Shape, ShapeKind, Texture, TextureId,
    TriangleMesh, view,
};
use header::{Element, Header, Kind};
use std::path::Path;
use std::sync::Arc;
use stream::Stream;

/// What a header says of a mesh, held against the bytes of the file where their number is known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Claim {
    /// Vertices.
    pub(crate) vertices: u64,
    /// Bytes that a vertex takes in memory.
    pub(crate) vertex_bytes: u64,
    /// Faces, of any number of corners.
    pub(crate) faces: u64,
}

/// Where a mesh goes while it is read.
pub(crate) trait MeshSink {
    /// Asked before anything is read: whether to make room for all that is claimed.
    fn makes_room(&mut self, claim: Claim) -> Result<bool>;

    /// `mesh` has got some more vertices, or triangles, which may be taken out of it.
    fn grown(&mut self, mesh: &mut TriangleMesh) -> Result<()>;

    /// The position of a vertex that has been read.
    fn position(&mut self, mesh: &TriangleMesh, vertex: u32) -> Result<[f32; 3]>;
}

/// Keeps all of it.
struct Whole;

impl MeshSink for Whole {
    fn makes_room(&mut self, _: Claim) -> Result<bool> {
        Ok(true)
    }

    fn grown(&mut self, _: &mut TriangleMesh) -> Result<()> {
        Ok(())
    }

    fn position(&mut self, mesh: &TriangleMesh, vertex: u32) -> Result<[f32; 3]> {
        Ok(mesh.positions[vertex as usize])
    }
}

/// Reads the mesh in `path` (`.ply`, or `.ply.gz`).
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Input`] with the line (ascii and header)
/// or with the element's number and byte offset (binary) when it is not a whole PLY mesh.
pub fn read_ply(path: &Path) -> Result<TriangleMesh> {
    let mut mesh = read_ply_into(path, &mut Whole)?;
    mesh.pad_positions();
    Ok(mesh)
}

/// Reads the mesh in `path` by way of `sink`, which may take parts out of it: what is left in the end.
///
/// # Errors
/// As [`read_ply`], and those of `sink`.
pub(crate) fn read_ply_into(path: &Path, sink: &mut impl MeshSink) -> Result<TriangleMesh> {
    let mut stream = Stream::open(path)?;
    let header = header::read(&mut stream)?;
    check_sizes(&header, &stream)?;
    let of = |kind: Kind| header.elements.iter().find(|e| e.kind == kind);
    let makes_room = sink.makes_room(Claim {
        vertices: of(Kind::Vertex).map_or(0, |e| e.count),
        vertex_bytes: of(Kind::Vertex).map_or(Ok(0), |e| vertices::vertex_bytes(&stream, e))?,
        faces: of(Kind::Face).map_or(0, |e| e.count),
    })?;
    let mut mesh = TriangleMesh::default();
    let (mut vertices, mut faces) = (None, false);
    for element in &header.elements {
        match element.kind {
            Kind::Vertex if vertices.is_none() => {
                if makes_room {
                    vertices::make_room_for_vertices(&stream, element, &mut mesh)?;
                }
                vertices = Some(vertices::read_vertices(&mut stream, &header, element, &mut mesh, sink)?);
            }
            Kind::Face if !faces => {
                let Some(vertices) = &vertices else {
                    return Err(stream.error("faces come before vertices; put `element vertex` first"));
                };
                if makes_room {
                    body::make_room_for_triangles(&stream, &header, element, &mut mesh);
                }
                body::read_faces(&mut stream, &header, element, vertices.count, &mut mesh, sink)?;
                faces = true;
            }
            // What follows the faces is of no use, and need not be whole.
            _ if faces => break,
            _ => body::skip_element(&mut stream, &header, element)?,
        }
    }
    let Some(vertices) = vertices.filter(|v| v.count > 0) else {
        return Err(Error::file(path, "no vertices; an `element vertex` with x, y and z is needed"));
    };
    if !faces || header.elements.iter().any(|e| e.kind == Kind::Face && e.count == 0) {
        let message = "no faces, only points; an `element face` with vertex_indices is needed";
        return Err(Error::file(path, message));
    }
    if let Some(i) = vertices.not_finite {
        return Err(Error::file(path, format!("vertex {i}: its position is not finite")));
    }
    Ok(mesh)
}

/// Reads the mesh in `path` as a scene: grey, with a camera that frames it, a soft sky and a sun.
///
/// # Errors
/// As [`read_ply`].
pub fn read_ply_scene(path: &Path) -> Result<SceneDescription> {
    let mesh = read_ply(path)?;
    let mut scene = SceneDescription { path: path.to_path_buf(), ..SceneDescription::default() };
    scene.textures.push(Texture::Constant(Rgb::splat(0.5)));
    scene.materials.push(Material::Diffuse { reflectance: TextureId(0) });
    scene.meshes.push(MeshSource::Inline(Arc::new(mesh)));
    scene.shapes.push(Shape {
        kind: ShapeKind::Mesh(MeshId(0)),
        object_to_world: Transform::IDENTITY,
        reverse_orientation: false,
        material: MaterialId(0),
        area_light: None,
        alpha: None,
        medium: None,
        at: Location::whole(path),
    });
    view::add_camera_and_lights(&mut scene);
    Ok(scene)
}

/// Holds the header's counts against the bytes that are there, before anything is allocated.
fn check_sizes(header: &Header, stream: &Stream) -> Result<()> {
    let Some(mut left) = stream.bytes_left() else { return Ok(()) };
    for e in &header.elements {
        let least = (header.least_record_bytes(e) as u64).saturating_mul(e.count);
        if least > left {
            let message = format!(
                "element {}: {} records need at least {least} bytes, but {left} are left in the file; \
                 it is cut short or its count is wrong",
                e.name, e.count
            );
            return Err(stream.error_at_line(e.line, message));
        }
        left -= least;
        if e.kind == Kind::Face {
            // What follows is not read; see above.
            break;
        }
    }
    Ok(())
}

/// How many records may be reserved for at once: all that the file has room for, and of a gzipped
/// stream, whose length is unknown, what a hostile header may have for nothing.
fn reserve_for(element: &Element, stream: &Stream) -> usize {
    const UNCHECKED: u64 = 1 << 16;
    element.count.min(if stream.bytes_left().is_some() { u64::MAX } else { UNCHECKED }) as usize
}

#[cfg(test)]
mod tests;
