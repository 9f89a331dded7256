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

/// Reads the mesh in `path` (`.ply`, or `.ply.gz`).
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Input`] with the line (ascii and header)
/// or with the element's number and byte offset (binary) when it is not a whole PLY mesh.
pub fn read_ply(path: &Path) -> Result<TriangleMesh> {
    let mut stream = Stream::open(path)?;
    let header = header::read(&mut stream)?;
    check_sizes(&header, &stream)?;
    let mut mesh = TriangleMesh::default();
    let (mut vertices, mut faces) = (false, false);
    for element in &header.elements {
        match element.kind {
            Kind::Vertex if !vertices => {
                body::read_vertices(&mut stream, &header, element, &mut mesh)?;
                vertices = true;
            }
            Kind::Face if !faces && !vertices => {
                return Err(stream.error("faces come before vertices; put `element vertex` first"));
            }
            Kind::Face if !faces => {
                body::read_faces(&mut stream, &header, element, &mut mesh)?;
                faces = true;
            }
            // What follows the faces is of no use, and need not be whole.
            _ if faces => break,
            _ => body::skip_element(&mut stream, &header, element)?,
        }
    }
    if !vertices || mesh.positions.is_empty() {
        return Err(Error::file(path, "no vertices; an `element vertex` with x, y and z is needed"));
    }
    if !faces || header.elements.iter().any(|e| e.kind == Kind::Face && e.count == 0) {
        let message = "no faces, only points; an `element face` with vertex_indices is needed";
        return Err(Error::file(path, message));
    }
    if let Some(i) = mesh.positions.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
        return Err(Error::file(path, format!("vertex {i}: its position is not finite")));
    }
    mesh.pad_positions();
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
