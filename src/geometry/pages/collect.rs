//! Reads a mesh that is to be cut: into memory while its share lasts, and to disk from there on.
//!
//! Invariant: what is held, the centres to come included, stays within three quarters of the share and the piece that
//! was read last; the last quarter is for pages in the making.

use super::disk::DiskMesh;
use super::memory::{CutMemory, Share};
use crate::error::{Error, Result};
use crate::scene::TriangleMesh;
use crate::scene::ply::{Claim, MeshSink, read_ply_into};
use std::io;
use std::path::Path;

/// Of a triangle: its corners, and the centre of its box.
const TRIANGLE_BYTES: u64 = 12 + 16;
/// What is lent at least: some pages in the making.
const LEAST_SHARE: u64 = 1 << 20;
/// As much is written to disk at once.
const PIECE_BYTES: u64 = 256 << 10;

/// A mesh that has been read.
pub(super) enum Kept {
    /// As it was read.
    Memory(TriangleMesh),
    Disk(DiskMesh),
}

/// Whom a reader asks.
pub(super) struct Asked<'a> {
    /// Whether to go on, at this number of triangles.
    pub(super) go_on: &'a dyn Fn(u64) -> Result<()>,
    /// Whether to give up.
    pub(super) stop: &'a (dyn Fn() -> bool + Sync),
    /// Where files may be made.
    pub(super) directory: &'a dyn Fn() -> io::Result<&'a Path>,
    /// What it means when they cannot.
    pub(super) cannot: &'a dyn Fn(io::Error) -> Error,
}

struct Collector<'a> {
    path: &'a Path,
    memory: &'a CutMemory,
    asked: &'a Asked<'a>,
    share: Option<Share<'a>>,
    disk: Option<DiskMesh>,
    /// It does not fit, if its header is right.
    large: bool,
    /// Those that are on disk.
    triangles: u64,
}

/// Reads the mesh `path` into a share of `memory`, or to disk.
///
/// # Errors
/// Those of reading, of disks, and of those `asked`.
pub(super) fn collect<'a>(
    path: &'a Path,
    memory: &'a CutMemory,
    asked: &'a Asked<'a>,
) -> Result<(Kept, Share<'a>)> {
    let mut collector =
        Collector { path, memory, asked, share: None, disk: None, large: false, triangles: 0 };
    let mut mesh = read_ply_into(path, &mut collector)?;
    let kept = match collector.disk.take() {
        Some(mut disk) => {
            disk.take(&mut mesh).map_err(asked.cannot)?;
            Kept::Disk(disk)
        }
        None => Kept::Memory(mesh),
    };
    let share = collector.share.take().expect("readers ask for room first");
    Ok((kept, share))
}

fn bytes(mesh: &TriangleMesh) -> u64 {
    let columns = 12 * (mesh.positions.len() + mesh.normals.len()) + 8 * mesh.uvs.len();
    columns as u64 + TRIANGLE_BYTES * mesh.indices.len() as u64
}

impl Collector<'_> {
    fn move_to_disk(&mut self, mesh: &mut TriangleMesh) -> Result<()> {
        let cannot = self.asked.cannot;
        if self.disk.is_none() {
            let directory = (self.asked.directory)().map_err(cannot)?;
            self.disk = Some(DiskMesh::new(directory, mesh).map_err(cannot)?);
        }
        let disk = self.disk.as_mut().expect("it has just been made");
        self.triangles += mesh.indices.len() as u64;
        disk.take(mesh).map_err(cannot)
    }
}

impl MeshSink for Collector<'_> {
    fn makes_room(&mut self, claim: Claim) -> Result<bool> {
        let vertices = claim.vertices.saturating_mul(claim.vertex_bytes);
        let held = claim.faces.saturating_mul(TRIANGLE_BYTES).saturating_add(vertices);
        let needed = (held / 3).saturating_mul(4).saturating_add(LEAST_SHARE);
        let share = self.memory.lend(needed, self.asked.stop)?;
        self.large = needed > share.bytes;
        self.share = Some(share);
        Ok(!self.large)
    }

    fn grown(&mut self, mesh: &mut TriangleMesh) -> Result<()> {
        let triangles = self.triangles + mesh.indices.len() as u64;
        (self.asked.go_on)(triangles)?;
        if triangles > u64::from(u32::MAX) {
            return Err(Error::file(
                self.path,
                format!("more than {} triangles; divide it into several meshes", u32::MAX),
            ));
        }
        if self.large {
            if self.disk.is_none() || bytes(mesh) >= PIECE_BYTES {
                self.move_to_disk(mesh)?;
            }
        } else if bytes(mesh) > self.share.as_ref().map_or(0, |s| s.bytes / 4 * 3) {
            // Faces of many corners, or a header that is wrong.
            self.move_to_disk(mesh)?;
            self.large = true;
            // All there is, now that nothing is held that others may wait for.
            self.share = None;
            self.share = Some(self.memory.lend(u64::MAX, self.asked.stop)?);
        }
        Ok(())
    }

    fn position(&mut self, mesh: &TriangleMesh, vertex: u32) -> Result<[f32; 3]> {
        let Some(disk) = &mut self.disk else { return Ok(mesh.positions[vertex as usize]) };
        let on_disk = disk.position(vertex).map_err(self.asked.cannot)?;
        Ok(on_disk.unwrap_or_else(|| mesh.positions[(u64::from(vertex) - disk.shape().0) as usize]))
    }
}
