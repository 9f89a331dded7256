//! The records of a PLY file. Two loops are fast because real files use them: fixed-size binary
//! vertices whose wanted columns are all floats, and binary triangles as `uchar` + 3 × 32 bits.

use super::header::{Element, Format, Header, Property, Scalar, Type};
use super::stream::Stream;
use super::{Result, reserve_for};
use crate::scene::TriangleMesh;
use crate::scene::polygon;

/// Longest list of a face; a count above it is damage.
const MAX_CORNERS: u64 = 1 << 20;

#[inline(always)]
fn f32_at(record: &[u8], at: usize, big: bool) -> f32 {
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
fn read_scalar(stream: &mut Stream, format: Format, kind: Scalar) -> Result<f64> {
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

fn skip_property(stream: &mut Stream, format: Format, p: &Property, what: &str) -> Result<()> {
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

/// Which properties of `vertex` are wanted.
struct Columns {
    position: [usize; 3],
    normal: Option<[usize; 3]>,
    uv: Option<[usize; 2]>,
}

impl Columns {
    fn of(stream: &Stream, e: &Element) -> Result<Self> {
        let one = |names: &[&str]| e.find(names).filter(|&i| matches!(e.properties[i].kind, Type::Scalar(_)));
        let (Some(x), Some(y), Some(z)) = (one(&["x"]), one(&["y"]), one(&["z"])) else {
            return Err(stream.error_at_line(e.line, "element vertex has no properties x, y and z"));
        };
        let normal = one(&["nx"]).zip(one(&["ny"])).zip(one(&["nz"]));
        let uv = [["u", "v"], ["s", "t"], ["texture_u", "texture_v"], ["texture_s", "texture_t"]]
            .iter()
            .find_map(|[u, v]| one(&[u]).zip(one(&[v])));
        Ok(Self {
            position: [x, y, z],
            normal: normal.map(|((x, y), z)| [x, y, z]),
            uv: uv.map(|(u, v)| [u, v]),
        })
    }

    fn all(&self) -> impl Iterator<Item = usize> {
        self.position
            .into_iter()
            .chain(self.normal.into_iter().flatten())
            .chain(self.uv.into_iter().flatten())
    }
}

/// Reads the vertices' columns.
pub(super) fn read_vertices(
    stream: &mut Stream,
    header: &Header,
    e: &Element,
    mesh: &mut TriangleMesh,
) -> Result<()> {
    let columns = Columns::of(stream, e)?;
    let room = reserve_for(e, stream);
    mesh.positions.reserve_exact(room + 1);
    if columns.normal.is_some() {
        mesh.normals.reserve_exact(room);
    }
    if columns.uv.is_some() {
        mesh.uvs.reserve_exact(room);
    }
    let float = |i: usize| e.properties[i].kind == Type::Scalar(Scalar::F32);
    match e.fixed_bytes() {
        Some(stride) if header.format != Format::Ascii && columns.all().all(float) => {
            let mut offsets = vec![0; e.properties.len()];
            let mut at = 0;
            for (offset, p) in offsets.iter_mut().zip(&e.properties) {
                *offset = at;
                if let Type::Scalar(s) = p.kind {
                    at += s.bytes();
                }
            }
            let big = header.format == Format::Big;
            fast_vertices(stream, e, &columns, &offsets, stride, big, mesh)
        }
        _ => any_vertices(stream, header, e, &columns, mesh),
    }
}

fn fast_vertices(
    stream: &mut Stream,
    e: &Element,
    columns: &Columns,
    offsets: &[usize],
    stride: usize,
    big: bool,
    mesh: &mut TriangleMesh,
) -> Result<()> {
    let mut left = e.count;
    while left > 0 {
        let bytes = stream.fill(stride)?;
        let n = ((bytes.len() / stride) as u64).min(left);
        if n == 0 {
            let i = e.count - left;
            return Err(stream.error(format!("vertex {i} of {}: the file ends in it", e.count)));
        }
        let records = bytes[..n as usize * stride].chunks_exact(stride);
        let get3 = |c: [usize; 3]| {
            let [x, y, z] = c.map(|i| offsets[i]);
            records.clone().map(move |r| [f32_at(r, x, big), f32_at(r, y, big), f32_at(r, z, big)])
        };
        mesh.positions.extend(get3(columns.position));
        if let Some(normal) = columns.normal {
            mesh.normals.extend(get3(normal));
        }
        if let Some([u, v]) = columns.uv.map(|c| c.map(|i| offsets[i])) {
            mesh.uvs.extend(records.clone().map(|r| [f32_at(r, u, big), f32_at(r, v, big)]));
        }
        stream.consume(n as usize * stride);
        left -= n;
    }
    Ok(())
}

fn any_vertices(
    stream: &mut Stream,
    header: &Header,
    e: &Element,
    columns: &Columns,
    mesh: &mut TriangleMesh,
) -> Result<()> {
    let mut values = vec![0.0f32; e.properties.len()];
    for i in 0..e.count {
        for (p, value) in e.properties.iter().zip(&mut values) {
            match p.kind {
                Type::Scalar(s) => *value = read_scalar(stream, header.format, s)? as f32,
                Type::List { .. } => skip_property(stream, header.format, p, &format!("vertex {i}"))?,
            }
        }
        mesh.positions.push(columns.position.map(|c| values[c]));
        mesh.normals.extend(columns.normal.map(|n| n.map(|c| values[c])));
        mesh.uvs.extend(columns.uv.map(|n| n.map(|c| values[c])));
    }
    Ok(())
}

/// Reads the faces as triangles.
pub(super) fn read_faces(
    stream: &mut Stream,
    header: &Header,
    e: &Element,
    mesh: &mut TriangleMesh,
) -> Result<()> {
    let list = e.find(&["vertex_indices", "vertex_index"]).map(|i| (i, e.properties[i].kind));
    let Some((list, Type::List { count, item })) = list else {
        return Err(stream.error_at_line(e.line, "element face has no list vertex_indices"));
    };
    if matches!(item, Scalar::F32 | Scalar::F64) {
        return Err(stream.error_at_line(e.line, "vertex_indices are floats; integers are needed"));
    }
    // A face that is a triangle takes at least this much; lists of fewer corners give none.
    let triangle_bytes = if header.format == Format::Ascii {
        8
    } else {
        header.least_record_bytes(e) as u64 + 3 * item.bytes() as u64
    };
    let room = stream.bytes_left().map_or(u64::MAX, |b| b / triangle_bytes);
    mesh.indices.reserve_exact((reserve_for(e, stream) as u64).min(room) as usize);

    let mut done = 0;
    let single = e.properties.len() == 1 && count.bytes() == 1 && item.bytes() == 4;
    let mut corners = Vec::new();
    let mut split = Vec::new();
    while done < e.count {
        if single && header.format != Format::Ascii {
            done += fast_triangles(stream, e, done, header.format == Format::Big, mesh)?;
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
                if !(index >= 0.0 && index < mesh.positions.len() as f64 && index.fract() == 0.0) {
                    return Err(bad_index(stream, done, index, mesh));
                }
                corners.push(index as u32);
            }
        }
        add_polygon(&corners, mesh, &mut split);
        done += 1;
    }
    Ok(())
}

fn bad_index(stream: &Stream, face: u64, index: f64, mesh: &TriangleMesh) -> crate::error::Error {
    let n = mesh.positions.len();
    stream.error(format!("face {face} names vertex {index}; there are {n}, counted from 0"))
}

fn add_polygon(corners: &[u32], mesh: &mut TriangleMesh, split: &mut Vec<[u32; 3]>) {
    split.clear();
    if corners.len() == 3 {
        split.push([0, 1, 2]);
    } else {
        let points: Vec<[f32; 3]> = corners.iter().map(|&c| mesh.positions[c as usize]).collect();
        polygon::triangulate(&points, split);
    }
    for t in split.iter() {
        let t = t.map(|i| corners[i as usize]);
        if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
            mesh.indices.push(t);
        }
    }
}

/// Reads triangles until the first face that is not one; returns how many faces it read.
fn fast_triangles(
    stream: &mut Stream,
    e: &Element,
    done: u64,
    big: bool,
    mesh: &mut TriangleMesh,
) -> Result<u64> {
    const STRIDE: usize = 13;
    let limit = mesh.positions.len() as u32;
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
            return Err(bad_index(stream, done + read, f64::from(index), mesh));
        }
        if n < most || most == 0 {
            return Ok(read);
        }
    }
}
