//! The records of a PLY file: numbers, elements that nobody wants, and faces. One loop is fast because real files use
//! it: binary triangles as `uchar` + 3 × 32 bits.

use super::header::{Element, Format, Header, Property, Scalar, Type};
use super::stream::Stream;
use super::{MeshSink, Result, reserve_for};
use crate::scene::TriangleMesh;
use crate::scene::polygon;

/// Vertices, or faces, after which those that are read one by one are handed on.
pub(super) const PIECE: usize = 4096;
/// Longest list of a face; a count above it is damage.
const MAX_CORNERS: u64 = 1 << 20;

#[inline(always)]
pub(super) fn f32_at(record: &[u8], at: usize, big: bool) -> f32 {
    let b = [record[at], record[at + 1], record[at + 2], record[at + 3]];
    if big { f32::from_be_bytes(b) } else { f32::from_le_bytes(b) }
}

fn scalar_at(b: &[u8], kind: Scalar, big: bool) -> f64 {
    macro_rules! get {
        ($t:ty, $n:literal) => {{
            let mut a = [0u8; $n];
            a.copy_from_slice(&b[..$n]);
            f64::from(if big { <$t>::from_be_bytes(a) } else { <$t>::from_le_bytes(a) })
        }};
    }
    match kind {
        Scalar::I8 => get!(i8, 1),
        Scalar::U8 => get!(u8, 1),
        Scalar::I16 => get!(i16, 2),
        Scalar::U16 => get!(u16, 2),
        Scalar::I32 => get!(i32, 4),
        Scalar::U32 => get!(u32, 4),
        Scalar::F32 => get!(f32, 4),
        Scalar::F64 => get!(f64, 8),
    }
}

/// One number, of text or of bytes. Every PLY integer is exact in f64.
pub(super) fn read_scalar(stream: &mut Stream, format: Format, kind: Scalar) -> Result<f64> {
    if format == Format::Ascii {
        return stream.token(|word| std::str::from_utf8(word).ok()?.parse().ok());
    }
    let n = kind.bytes();
    let value = scalar_at(stream.need(n)?, kind, format == Format::Big);
    stream.consume(n);
    Ok(value)
}

fn read_count(stream: &mut Stream, format: Format, kind: Scalar, what: &str) -> Result<u64> {
    let n = read_scalar(stream, format, kind)?;
    if n >= 0.0 && n.fract() == 0.0 {
        return Ok(n as u64);
    }
    Err(stream.error(format!("{what}: a list of length {n}")))
}

pub(super) fn skip_property(stream: &mut Stream, format: Format, p: &Property, what: &str) -> Result<()> {
    match p.kind {
        Type::Scalar(s) => read_scalar(stream, format, s).map(drop),
        Type::List { count, item } => {
            let n = read_count(stream, format, count, what)?;
            if format == Format::Ascii {
                for _ in 0..n {
                    read_scalar(stream, format, item)?;
                }
                return Ok(());
            }
            stream.skip(n.saturating_mul(item.bytes() as u64))
        }
    }
}

/// Passes over all records of an element.
pub(super) fn skip_element(stream: &mut Stream, header: &Header, e: &Element) -> Result<()> {
    if e.properties.is_empty() {
        return Ok(());
    }
    if let (Some(n), true) = (e.fixed_bytes(), header.format != Format::Ascii) {
        return stream.skip((n as u64).saturating_mul(e.count));
    }
    for i in 0..e.count {
        for p in &e.properties {
            skip_property(stream, header.format, p, &format!("{} {i}", e.name))?;
        }
    }
    Ok(())
}

/// Which property has the corners, and how long they and their number are.
fn corners(e: &Element) -> Option<(usize, Scalar, Scalar)> {
    let i = e.find(&["vertex_indices", "vertex_index"])?;
    match e.properties[i].kind {
        Type::List { count, item } => Some((i, count, item)),
        Type::Scalar(_) => None,
    }
}

/// Room for all triangles that the header claims and the file may have.
pub(super) fn make_room_for_triangles(
    stream: &Stream,
    header: &Header,
    e: &Element,
    mesh: &mut TriangleMesh,
) {
    let Some((_, _, item)) = corners(e) else { return };
    // A face that is a triangle takes at least this much; lists of fewer corners give none.
    let triangle_bytes = if header.format == Format::Ascii {
        8
    } else {
        header.least_record_bytes(e) as u64 + 3 * item.bytes() as u64
    };
    let room = stream.bytes_left().map_or(u64::MAX, |b| b / triangle_bytes);
    mesh.indices.reserve_exact((reserve_for(e, stream) as u64).min(room) as usize);
}

/// Reads the faces as triangles between the first `vertices` vertices.
pub(super) fn read_faces(
    stream: &mut Stream,
    header: &Header,
    e: &Element,
    vertices: u64,
    mesh: &mut TriangleMesh,
    sink: &mut impl MeshSink,
) -> Result<()> {
    let Some((list, count, item)) = corners(e) else {
        return Err(stream.error_at_line(e.line, "element face has no list vertex_indices"));
    };
    if matches!(item, Scalar::F32 | Scalar::F64) {
        return Err(stream.error_at_line(e.line, "vertex_indices are floats; integers are needed"));
    }

    let mut done = 0;
    let single = e.properties.len() == 1 && count.bytes() == 1 && item.bytes() == 4;
    let mut corners = Vec::new();
    let mut split = Vec::new();
    while done < e.count {
        if single && header.format != Format::Ascii {
            let big = header.format == Format::Big;
            done += fast_triangles(stream, e, done, vertices, big, mesh, sink)?;
            if done == e.count {
                break;
            }
        }
        // One face of any kind, then the fast loop again.
        corners.clear();
        for (k, p) in e.properties.iter().enumerate() {
            if k != list {
                skip_property(stream, header.format, p, &format!("face {done}"))?;
                continue;
            }
            let n = read_count(stream, header.format, count, &format!("face {done}"))?;
            if n > MAX_CORNERS {
                return Err(stream.error(format!("face {done} has {n} corners; {MAX_CORNERS} at most")));
            }
            for _ in 0..n {
                let index = read_scalar(stream, header.format, item)?;
                if !(index >= 0.0 && index < vertices as f64 && index.fract() == 0.0) {
                    return Err(bad_index(stream, done, index, vertices));
                }
                corners.push(index as u32);
            }
        }
        add_polygon(&corners, mesh, &mut split, sink)?;
        done += 1;
        if done.is_multiple_of(PIECE as u64) || done == e.count {
            sink.grown(mesh)?;
        }
    }
    Ok(())
}

fn bad_index(stream: &Stream, face: u64, index: f64, vertices: u64) -> crate::error::Error {
    stream.error(format!("face {face} names vertex {index}; there are {vertices}, counted from 0"))
}

fn add_polygon(
    corners: &[u32],
    mesh: &mut TriangleMesh,
    split: &mut Vec<[u32; 3]>,
    sink: &mut impl MeshSink,
) -> Result<()> {
    split.clear();
    if corners.len() == 3 {
        split.push([0, 1, 2]);
    } else {
        let points = corners.iter().map(|&c| sink.position(mesh, c)).collect::<Result<Vec<_>>>()?;
        polygon::triangulate(&points, split);
    }
    for t in split.iter() {
        let t = t.map(|i| corners[i as usize]);
        if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
            mesh.indices.push(t);
        }
    }
    Ok(())
}

/// Reads triangles until the first face that is not one; returns how many faces it read.
fn fast_triangles(
    stream: &mut Stream,
    e: &Element,
    done: u64,
    vertices: u64,
    big: bool,
    mesh: &mut TriangleMesh,
    sink: &mut impl MeshSink,
) -> Result<u64> {
    const STRIDE: usize = 13;
    let limit = u32::try_from(vertices).expect("the header's check lets no more through");
    let mut read = 0;
    loop {
        let bytes = stream.fill(STRIDE)?;
        let most = (e.count - done - read).min((bytes.len() / STRIDE) as u64) as usize;
        let mut n = 0;
        let mut bad = None;
        for r in bytes[..most * STRIDE].chunks_exact(STRIDE) {
            if r[0] != 3 {
                break;
            }
            let at = |k: usize| {
                let b = [r[k], r[k + 1], r[k + 2], r[k + 3]];
                if big { u32::from_be_bytes(b) } else { u32::from_le_bytes(b) }
            };
            let t = [at(1), at(5), at(9)];
            let top = t[0].max(t[1]).max(t[2]);
            if top >= limit {
                bad = Some(top);
                break;
            }
            n += 1;
            if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
                mesh.indices.push(t);
            }
        }
        stream.consume(n * STRIDE);
        read += n as u64;
        if let Some(index) = bad {
            return Err(bad_index(stream, done + read, f64::from(index), vertices));
        }
        sink.grown(mesh)?;
        if n < most || most == 0 {
            return Ok(read);
        }
    }
}
