//! The vertices of a PLY file. One loop is fast because real files use it: fixed-size binary vertices whose wanted
//! columns are all floats.

use super::body::{PIECE, f32_at, read_scalar, skip_property};
use super::header::{Element, Format, Header, Scalar, Type};
use super::stream::Stream;
use super::{MeshSink, Result, reserve_for};
use crate::scene::TriangleMesh;

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

/// Bytes of a vertex's columns in memory.
pub(super) fn vertex_bytes(stream: &Stream, e: &Element) -> Result<u64> {
    Ok(4 * Columns::of(stream, e)?.all().count() as u64)
}

/// Room for all vertices that the header claims and the file may have.
pub(super) fn make_room_for_vertices(stream: &Stream, e: &Element, mesh: &mut TriangleMesh) -> Result<()> {
    let columns = Columns::of(stream, e)?;
    let room = reserve_for(e, stream);
    mesh.positions.reserve_exact(room + 1);
    if columns.normal.is_some() {
        mesh.normals.reserve_exact(room);
    }
    if columns.uv.is_some() {
        mesh.uvs.reserve_exact(room);
    }
    Ok(())
}

/// What has become of the vertices.
#[derive(Default)]
pub(super) struct Vertices {
    /// How many there are.
    pub(super) count: u64,
    /// The first whose position is not finite.
    pub(super) not_finite: Option<u64>,
}

impl Vertices {
    /// Hands on what `mesh` has got beyond its first `before` vertices.
    fn pass_on(&mut self, before: usize, mesh: &mut TriangleMesh, sink: &mut impl MeshSink) -> Result<()> {
        let new = &mesh.positions[before..];
        if self.not_finite.is_none() {
            let odd = new.iter().position(|p| !p.iter().all(|c| c.is_finite()));
            self.not_finite = odd.map(|i| self.count + i as u64);
        }
        self.count += new.len() as u64;
        sink.grown(mesh)
    }
}

/// Reads the vertices' columns.
pub(super) fn read_vertices(
    stream: &mut Stream,
    header: &Header,
    e: &Element,
    mesh: &mut TriangleMesh,
    sink: &mut impl MeshSink,
) -> Result<Vertices> {
    let columns = Columns::of(stream, e)?;
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
            fast_vertices(stream, e, &columns, (&offsets, stride, big), mesh, sink)
        }
        _ => any_vertices(stream, header, e, &columns, mesh, sink),
    }
}

fn fast_vertices(
    stream: &mut Stream,
    e: &Element,
    columns: &Columns,
    (offsets, stride, big): (&[usize], usize, bool),
    mesh: &mut TriangleMesh,
    sink: &mut impl MeshSink,
) -> Result<Vertices> {
    let mut vertices = Vertices::default();
    let mut left = e.count;
    while left > 0 {
        let bytes = stream.fill(stride)?;
        let n = ((bytes.len() / stride) as u64).min(left);
        if n == 0 {
            let i = e.count - left;
            return Err(stream.error(format!("vertex {i} of {}: the file ends in it", e.count)));
        }
        let records = bytes[..n as usize * stride].chunks_exact(stride);
        let before = mesh.positions.len();
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
        vertices.pass_on(before, mesh, sink)?;
    }
    Ok(vertices)
}

fn any_vertices(
    stream: &mut Stream,
    header: &Header,
    e: &Element,
    columns: &Columns,
    mesh: &mut TriangleMesh,
    sink: &mut impl MeshSink,
) -> Result<Vertices> {
    let mut vertices = Vertices::default();
    let mut before = mesh.positions.len();
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
        if mesh.positions.len() - before == PIECE || i + 1 == e.count {
            vertices.pass_on(before, mesh, sink)?;
            before = mesh.positions.len();
        }
    }
    Ok(vertices)
}
