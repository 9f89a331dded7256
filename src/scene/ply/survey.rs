//! What the header of a PLY file tells of the mesh before it is read.
//!
//! Invariant: reads the header and no further. Never judges: what is wrong with a file is said by whoever reads it.

use super::header::{self, Element, Format, Header, Kind, Scalar, Type};
use super::stream::{BUFFER_BYTES, Stream};
use super::vertices;
use crate::error::Result;
use std::path::Path;

/// Holds the headers of nearly all files; the buffer that a mesh is read through is read as a whole.
const HEADER_BYTES: usize = 4 << 10;

/// A mesh before it is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeshFacts {
    /// Vertices.
    pub vertices: u64,
    /// Bytes that a vertex takes in memory, its position included.
    pub vertex_bytes: u64,
    /// Triangles; faces where only those are known.
    pub triangles: u64,
    /// The number of triangles follows from the size of the file: it is right, but for faces that vanish because they
    /// repeat a vertex.
    pub exact: bool,
}

/// Looks at the header of the mesh in `path`.
///
/// # Errors
/// As [`read_ply`](super::read_ply), for what the header shows.
pub fn survey(path: &Path) -> Result<MeshFacts> {
    // What a small buffer cannot read may be a long line.
    survey_with(path, HEADER_BYTES).or_else(|_| survey_with(path, BUFFER_BYTES))
}

fn survey_with(path: &Path, buffer_bytes: usize) -> Result<MeshFacts> {
    let mut stream = Stream::open_with(path, buffer_bytes)?;
    let header = header::read(&mut stream)?;
    let of = |kind: Kind| header.elements.iter().find(|e| e.kind == kind);
    let (vertex, face) = (of(Kind::Vertex), of(Kind::Face));
    let faces = face.map_or(0, |e| e.count);
    let triangles = stream.bytes_left().and_then(|left| triangles(&header, left));
    Ok(MeshFacts {
        vertices: vertex.map_or(0, |e| e.count),
        vertex_bytes: vertex.map_or(Ok(0), |e| vertices::vertex_bytes(&stream, e))?,
        triangles: triangles.unwrap_or(faces),
        exact: triangles.is_some(),
    })
}

/// Triangles of the faces in the `bytes` after a header, where those tell: a face of n corners has n − 2.
fn triangles(header: &Header, bytes: u64) -> Option<u64> {
    if header.format == Format::Ascii {
        return None;
    }
    let at = header.elements.iter().position(|e| e.kind == Kind::Face)?;
    let others = header.elements.iter().enumerate().filter(|(i, _)| *i != at);
    let size = |e: &Element| e.count.checked_mul(e.fixed_bytes()? as u64);
    let beside = others.map(|(_, e)| size(e)).try_fold(0u64, |sum, b| sum.checked_add(b?))?;
    let face = &header.elements[at];
    let (mut fixed, mut item) = (0, None);
    for property in &face.properties {
        match property.kind {
            Type::Scalar(s) => fixed += s.bytes() as u64,
            Type::List { count, item: of } if item.is_none() => {
                fixed += count.bytes() as u64;
                item = Some(of);
            }
            Type::List { .. } => return None,
        }
    }
    let items = bytes.checked_sub(beside)?.checked_sub(face.count.checked_mul(fixed)?)?;
    let item = item.map(Scalar::bytes)? as u64;
    (items % item == 0).then_some(())?;
    (items / item).checked_sub(2 * face.count)
}
