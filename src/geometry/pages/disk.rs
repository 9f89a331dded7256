//! A mesh on disk: its vertices as they were read, and its triangles' corners.
//!
//! Invariant: a triangle has the vertices, bit for bit, that it has when the mesh is in memory. Reads what it is asked
//! for, in order of place; what is near each other in the file costs one read.

use super::make::Source;
use super::scratch::Scratch;
use crate::accel::bvh::Centre;
use crate::geometry::Mesh;
use crate::geometry::place::{place_mesh, place_positions};
use crate::scene::TriangleMesh;
use bytemuck::{cast_slice, cast_slice_mut};
use std::io;
use std::path::Path;

/// Vertices that are read together when single ones are asked for, and how many such blocks are kept.
const BLOCK_VERTICES: u64 = 512;
const BLOCKS: usize = 64;

/// Most bytes that a triangle takes while a part of a mesh is in memory: corners, the order of their vertices, three
/// vertices of its own, and its share of finished pages.
pub(super) const PART_BYTES: usize = 320;
/// The same without attributes and pages.
pub(super) const CENTRE_BYTES: usize = 128;

pub(super) struct DiskMesh {
    vertices: Scratch,
    corners: Scratch,
    vertex_count: u64,
    triangles: u64,
    normals: bool,
    uvs: bool,
    /// Blocks that single vertices were asked of last, by number.
    blocks: Vec<(u64, Vec<u8>)>,
}

impl DiskMesh {
    /// An empty one, of vertices like those of `like`.
    pub(super) fn new(directory: &Path, like: &TriangleMesh) -> io::Result<Self> {
        let (normals, uvs) = (!like.normals.is_empty(), !like.uvs.is_empty());
        let vertex_bytes = 12 + if normals { 12 } else { 0 } + if uvs { 8 } else { 0 };
        Ok(Self {
            vertices: Scratch::new(directory, vertex_bytes)?,
            corners: Scratch::new(directory, 12)?,
            vertex_count: 0,
            triangles: 0,
            normals,
            uvs,
            blocks: vec![(u64::MAX, Vec::new()); BLOCKS],
        })
    }

    pub(super) fn triangles(&self) -> u64 {
        self.triangles
    }

    /// Vertices, and columns of attributes: normals, texture coordinates.
    pub(super) fn shape(&self) -> (u64, [bool; 2]) {
        (self.vertex_count, [self.normals, self.uvs])
    }

    /// Takes what `mesh` has.
    pub(super) fn take(&mut self, mesh: &mut TriangleMesh) -> io::Result<()> {
        let mut vertices = self.vertices.writer(self.vertex_count);
        for (i, position) in mesh.positions.iter().enumerate() {
            let mut record = [0f32; 8];
            record[..3].copy_from_slice(position);
            let mut length = 3;
            if self.normals {
                record[length..length + 3].copy_from_slice(&mesh.normals[i]);
                length += 3;
            }
            if self.uvs {
                record[length..length + 2].copy_from_slice(&mesh.uvs[i]);
                length += 2;
            }
            vertices.push(cast_slice::<f32, u8>(&record[..length]))?;
        }
        vertices.flush()?;
        self.corners.write(self.triangles, cast_slice(&mesh.indices))?;
        self.vertex_count += mesh.positions.len() as u64;
        self.triangles += mesh.indices.len() as u64;
        // What they took is given back: they may be as large as the memory that they no longer fit.
        *mesh = TriangleMesh::default();
        Ok(())
    }

    /// The position of one of the vertices that have been taken, of which there are `Some`.
    pub(super) fn position(&mut self, vertex: u32) -> io::Result<Option<[f32; 3]>> {
        let vertex = u64::from(vertex);
        if vertex >= self.vertex_count {
            return Ok(None);
        }
        let (number, within) = (vertex / BLOCK_VERTICES, (vertex % BLOCK_VERTICES) as usize);
        let size = self.vertex_bytes();
        let (held, block) = &mut self.blocks[number as usize % BLOCKS];
        let count = BLOCK_VERTICES.min(self.vertex_count - number * BLOCK_VERTICES) as usize;
        // The last block may have grown since.
        if *held != number || block.len() < count * size {
            *held = u64::MAX;
            block.resize(count * size, 0);
            self.vertices.read(number * BLOCK_VERTICES, block)?;
            *held = number;
        }
        Ok(Some(bytemuck::pod_read_unaligned(&block[within * size..][..12])))
    }

    fn vertex_bytes(&self) -> usize {
        12 + if self.normals { 12 } else { 0 } + if self.uvs { 8 } else { 0 }
    }

    /// The triangles `names`, which rise, as a mesh of them alone: the first is called 0.
    pub(super) fn part(&self, names: &[u32], source: &Source<'_>) -> io::Result<Mesh> {
        let mut indices = Vec::with_capacity(names.len());
        self.corners.pick(names.iter().copied(), self.triangles, |record| {
            indices.push(bytemuck::pod_read_unaligned::<[u32; 3]>(record));
        })?;
        let vertices = localise(&mut indices);
        let mut mesh = TriangleMesh { indices, ..TriangleMesh::default() };
        // One more, which placing asks for.
        mesh.positions.reserve_exact(vertices.len() + 1);
        mesh.normals.reserve_exact(if self.normals { vertices.len() } else { 0 });
        mesh.uvs.reserve_exact(if self.uvs { vertices.len() } else { 0 });
        self.vertices.pick(vertices.into_iter(), self.vertex_count, |record| {
            let (position, mut rest) = record.split_at(12);
            mesh.positions.push(bytemuck::pod_read_unaligned(position));
            if self.normals {
                mesh.normals.push(bytemuck::pod_read_unaligned(&rest[..12]));
                rest = &rest[12..];
            }
            if self.uvs {
                mesh.uvs.push(bytemuck::pod_read_unaligned(rest));
            }
        })?;
        Ok(place_mesh(mesh, source.to_world, source.reverse))
    }

    /// The centres of the triangles of `range` that rays can hit.
    pub(super) fn centres(
        &self,
        range: std::ops::Range<u64>,
        source: &Source<'_>,
    ) -> io::Result<Vec<Centre>> {
        let mut indices = vec![[0u32; 3]; (range.end - range.start) as usize];
        self.corners.read(range.start, cast_slice_mut(&mut indices))?;
        let vertices = localise(&mut indices);
        let mut positions: Vec<[f32; 3]> = Vec::with_capacity(vertices.len());
        self.vertices.pick(vertices.into_iter(), self.vertex_count, |record| {
            positions.push(bytemuck::pod_read_unaligned(&record[..12]));
        })?;
        place_positions(&mut positions, source.to_world);
        let centre = |(corners, name): (&[u32; 3], u64)| {
            let name = u32::try_from(name).expect("the collector counts triangles in u32");
            Centre::of(corners.map(|c| positions[c as usize]), name)
        };
        Ok(indices.iter().zip(range).filter_map(centre).collect())
    }
}

/// Counts the vertices of `corners` anew, from 0 and in their order: what each was called.
fn localise(corners: &mut [[u32; 3]]) -> Vec<u32> {
    let flat: &mut [u32] = cast_slice_mut(corners);
    let mut order: Vec<u64> = (0u64..).zip(flat.iter()).map(|(at, &v)| u64::from(v) << 32 | at).collect();
    order.sort_unstable();
    let mut vertices = Vec::with_capacity(flat.len() / 4);
    for entry in order {
        let (vertex, at) = ((entry >> 32) as u32, entry as u32 as usize);
        if vertices.last() != Some(&vertex) {
            vertices.push(vertex);
        }
        flat[at] = vertices.len() as u32 - 1;
    }
    vertices
}

/// Centres on disk, which are sorted from one file into the other and back.
pub(super) fn centre_files(directory: &Path) -> io::Result<[Scratch; 2]> {
    Ok([Scratch::new(directory, size_of::<Centre>())?, Scratch::new(directory, size_of::<Centre>())?])
}
