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
    // A face takes a byte at least, and gzip packs a thousand into one at most.
    let most = match stream.bytes_left() {
        Some(left) => left,
        None => std::fs::metadata(path).map_or(0, |m| m.len()).saturating_mul(1032),
    };
    let faces = face.map_or(0, |e| e.count.min(most));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::ply::read_ply;
    use flate2::{Compression, write::GzEncoder};
    use std::io::Write;

    /// A triangle and a pentagon over five vertices with normals, as `format` has it; `more` stands in the header.
    fn file(format: &str, more: &str) -> Vec<u8> {
        let head = format!(
            "ply\nformat {format} 1.0\n{more}element vertex 5\nproperty float x\nproperty float y\nproperty float z\n\
             property float nx\nproperty float ny\nproperty float nz\nproperty uchar red\n\
             element face 2\nproperty uchar flags\nproperty list uchar int vertex_indices\nend_header\n"
        );
        let mut out = head.into_bytes();
        let faces: [&[i32]; 2] = [&[0, 1, 2], &[0, 1, 2, 3, 4]];
        let big = format.ends_with("big_endian");
        // A byte or four, and the same as text.
        let mut rest: Vec<(Option<u8>, [u8; 4], String)> = Vec::new();
        for i in 0..5 {
            let (x, y) = ((i as f32).cos(), (i as f32).sin());
            for c in [x, y, 0.0, 0.0, 0.0, 1.0] {
                rest.push((None, c.to_le_bytes(), c.to_string()));
            }
            rest.push((Some(7), [0; 4], "7".into()));
        }
        for face in faces {
            rest.push((Some(0), [0; 4], "0".into()));
            rest.push((Some(face.len() as u8), [0; 4], face.len().to_string()));
            face.iter().for_each(|v| rest.push((None, v.to_le_bytes(), v.to_string())));
        }
        for (byte, bytes, shown) in rest {
            match byte {
                _ if format == "ascii" => out.extend(format!("{shown} ").bytes()),
                Some(byte) => out.push(byte),
                None if big => out.extend(bytes.iter().rev()),
                None => out.extend(bytes),
            }
        }
        out
    }

    #[test]
    fn headers_tell_what_is_read_afterwards() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.ply");
        // The last has a line that no small buffer holds.
        let long = format!("comment {}\n", "x".repeat(9000));
        for (format, more, exact) in [
            ("binary_little_endian", "", true),
            ("binary_big_endian", "", true),
            ("ascii", "", false),
            ("binary_little_endian", long.as_str(), true),
        ] {
            std::fs::write(&path, file(format, more)).expect("written");
            let (facts, mesh) = (survey(&path).expect("a header"), read_ply(&path).expect("a mesh"));
            assert_eq!((mesh.positions.len(), mesh.indices.len()), (5, 4), "{format}");
            let triangles = if exact { 4 } else { 2 };
            assert_eq!(facts, MeshFacts { vertices: 5, vertex_bytes: 24, triangles, exact }, "{format}");
        }
        let path = folder.path().join("a.ply.gz");
        let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
        packed.write_all(&file("binary_little_endian", "")).expect("memory");
        std::fs::write(&path, packed.finish().expect("memory")).expect("written");
        let facts = survey(&path).expect("a header");
        assert_eq!((facts.vertices, facts.triangles, facts.exact), (5, 2, false));
    }

    #[test]
    fn damage_is_an_error_or_no_more_than_a_guess() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.ply");
        let good = file("binary_little_endian", "");
        for length in 0..good.len() {
            std::fs::write(&path, &good[..length]).expect("written");
            if let Ok(facts) = survey(&path) {
                assert!(facts.triangles <= 4, "{length}: {facts:?}");
            }
        }
        let text =
            String::from_utf8_lossy(&good).replace("element face 2", "element face 18446744073709551615");
        std::fs::write(&path, text.as_bytes()).expect("written");
        // Larger than any file: it is held against this one.
        assert!(survey(&path).is_ok_and(|facts| !facts.exact && facts.triangles <= good.len() as u64));
    }
}
