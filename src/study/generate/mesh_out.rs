//! Triangle meshes as binary PLY, streamed. A mesh is described by code that is run three times: to
//! count, to write vertices, to write faces. So memory is one buffer, however large the mesh.
//! Invariant: the three runs describe the same mesh. Never keeps a mesh.

use crate::error::{Error, Result};
use crate::film::replace::replace_file_unsynced;
use rayon::prelude::*;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::ops::Range;
use std::path::Path;

/// Most vertices of one file.
const MAX_VERTICES: u64 = 1 << 31;
/// Bytes that are gathered before the operating system is asked to write.
const CHUNK: usize = 256 << 10;

/// A vertex: metres, unit normal, texture coordinates.
#[derive(Clone, Copy, Default)]
pub(super) struct Vertex {
    pub(super) p: [f32; 3],
    pub(super) n: [f32; 3],
    pub(super) uv: [f32; 2],
}

enum Phase {
    Count,
    Vertices,
    Faces,
}

/// Where a description puts its surfaces.
pub(super) struct Mesh<'a> {
    phase: Phase,
    normals: bool,
    vertices: u64,
    triangles: u64,
    out: Option<&'a mut BufWriter<File>>,
    bytes: Vec<u8>,
    failed: Option<io::Error>,
}

impl Mesh<'_> {
    fn counting(normals: bool) -> Self {
        Self {
            phase: Phase::Count,
            normals,
            vertices: 0,
            triangles: 0,
            out: None,
            bytes: Vec::new(),
            failed: None,
        }
    }

    /// A grid of `nu` by `nv` cells of two triangles each; `at(i, j)` is asked for `i` in 0..=nu, row by
    /// row. Its side is that of du × dv.
    pub(super) fn grid(&mut self, nu: u32, nv: u32, mut at: impl FnMut(u32, u32) -> Vertex) {
        match self.phase {
            Phase::Count => {}
            Phase::Vertices => {
                for j in 0..=nv {
                    for i in 0..=nu {
                        push_vertex(&mut self.bytes, &at(i, j), self.normals);
                    }
                    self.drain(CHUNK);
                }
            }
            Phase::Faces => {
                let base = self.vertices as u32;
                for j in 0..nv {
                    push_faces(&mut self.bytes, base, nu, j);
                    self.drain(CHUNK);
                }
            }
        }
        self.vertices += (u64::from(nu) + 1) * (u64::from(nv) + 1);
        self.triangles += 2 * u64::from(nu) * u64::from(nv);
    }

    /// One flat quadrilateral a, b, c, d (counter-clockwise) of two triangles.
    pub(super) fn quad(&mut self, corners: [Vertex; 4]) {
        let [a, b, c, d] = corners;
        self.grid(1, 1, |i, j| [[a, b], [d, c]][j as usize][i as usize]);
    }

    /// Whether vertices are wanted in this run; a description may skip what only they need.
    pub(super) fn wants_vertices(&self) -> bool {
        matches!(self.phase, Phase::Vertices)
    }

    /// Counts what a run that is not wanted would have drawn: as [`Self::quad`] `count` times.
    pub(super) fn skip_quads(&mut self, count: u32) {
        match self.phase {
            Phase::Vertices => unreachable!("a run that wants vertices skips none"),
            _ => (0..count).for_each(|_| self.quad([Vertex::default(); 4])),
        }
    }

    fn drain(&mut self, limit: usize) {
        if self.bytes.len() >= limit {
            if let (Some(out), None) = (&mut self.out, &self.failed) {
                self.failed = out.write_all(&self.bytes).err();
            }
            self.bytes.clear();
        }
    }

    fn run(&mut self, phase: Phase, build: impl Fn(&mut Self)) -> io::Result<()> {
        (self.phase, self.vertices, self.triangles) = (phase, 0, 0);
        build(self);
        self.drain(0);
        self.failed.take().map_or(Ok(()), Err)
    }
}

fn push_vertex(bytes: &mut Vec<u8>, v: &Vertex, normals: bool) {
    bytes.extend_from_slice(bytemuck::bytes_of(&v.p.map(f32::to_le)));
    if normals {
        bytes.extend_from_slice(bytemuck::bytes_of(&v.n.map(f32::to_le)));
    }
    bytes.extend_from_slice(bytemuck::bytes_of(&v.uv.map(f32::to_le)));
}

/// Row `j` of a grid.
fn push_faces(bytes: &mut Vec<u8>, base: u32, nu: u32, j: u32) {
    let row = nu + 1;
    for i in 0..nu {
        let a = base + j * row + i;
        for [a, b, c] in [[a, a + 1, a + row + 1], [a, a + row + 1, a + row]] {
            bytes.push(3);
            bytes.extend_from_slice(&a.to_le_bytes());
            bytes.extend_from_slice(&b.to_le_bytes());
            bytes.extend_from_slice(&c.to_le_bytes());
        }
    }
}

trait LittleEndian {
    fn to_le(self) -> u32;
}

impl LittleEndian for f32 {
    fn to_le(self) -> u32 {
        self.to_bits().to_le()
    }
}

fn header(vertices: u64, triangles: u64, normals: bool) -> String {
    let normal = "property float nx\nproperty float ny\nproperty float nz\n";
    format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
         property float z\n{}property float u\nproperty float v\nelement face {triangles}\n\
         property list uchar uint vertex_indices\nend_header\n",
        if normals { normal } else { "" }
    )
}

fn check(path: &Path, vertices: u64) -> Result<()> {
    if vertices <= MAX_VERTICES {
        return Ok(());
    }
    let message = format!("{}: {vertices} vertices in one file; at most {MAX_VERTICES}", path.display());
    Err(Error::Usage(message))
}

/// Triangles that `build` describes.
pub(super) fn count(build: impl Fn(&mut Mesh)) -> u64 {
    let mut mesh = Mesh::counting(false);
    build(&mut mesh);
    mesh.triangles
}

/// Writes what `build` describes, whole or not at all.
pub(super) fn write_mesh(path: &Path, normals: bool, build: impl Fn(&mut Mesh)) -> Result<()> {
    let mut counted = Mesh::counting(normals);
    build(&mut counted);
    check(path, counted.vertices)?;
    replace_file_unsynced(path, |out| {
        out.write_all(header(counted.vertices, counted.triangles, normals).as_bytes())?;
        let mut mesh = Mesh::counting(normals);
        mesh.bytes = Vec::with_capacity(CHUNK + 4096);
        mesh.out = Some(out);
        mesh.run(Phase::Vertices, &build)?;
        mesh.run(Phase::Faces, &build)
    })
}

/// Writes one grid of any size with normals: `rows(j0..j1)` gives whole rows of nu + 1 vertices, and is
/// asked for bands of rows in parallel. Memory: two bands of about 4 MB a thread.
pub(super) fn write_grid(
    path: &Path,
    nu: u32,
    nv: u32,
    rows: impl Fn(Range<u32>) -> Vec<Vertex> + Sync,
) -> Result<()> {
    let vertices = (u64::from(nu) + 1) * (u64::from(nv) + 1);
    check(path, vertices)?;
    let row_bytes = (nu as usize + 1) * size_of::<Vertex>();
    let band = ((4 << 20) / row_bytes).clamp(1, 256) as u32;
    let together = band.saturating_mul(rayon::current_num_threads() as u32);
    replace_file_unsynced(path, |out| {
        let triangles = 2 * u64::from(nu) * u64::from(nv);
        out.write_all(header(vertices, triangles, true).as_bytes())?;
        let mut parallel = |rows_of: u32, make: &(dyn Fn(Range<u32>) -> Vec<u8> + Sync)| -> io::Result<()> {
            for start in (0..rows_of).step_by(together as usize) {
                let end = start.saturating_add(together).min(rows_of);
                let bands: Vec<u32> = (start..end).step_by(band as usize).collect();
                let done: Vec<Vec<u8>> =
                    bands.par_iter().map(|&j| make(j..j.saturating_add(band).min(end))).collect();
                done.iter().try_for_each(|bytes| out.write_all(bytes))?;
            }
            Ok(())
        };
        parallel(nv + 1, &|range| {
            let mut bytes = Vec::with_capacity(row_bytes * range.len());
            rows(range).iter().for_each(|v| push_vertex(&mut bytes, v, true));
            bytes
        })?;
        parallel(nv, &|range| {
            let mut bytes = Vec::with_capacity(nu as usize * 26 * range.len());
            range.for_each(|j| push_faces(&mut bytes, 0, nu, j));
            bytes
        })
    })
}
