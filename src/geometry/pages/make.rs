//! Cuts meshes into page files in the cache directory, and finds those that are there.
//!
//! Invariant: a file is named by what it was made of and how; it is there whole or not at all.

use super::file::{self, PageFile, PagedMesh};
use super::format::{VERSION, encode};
use crate::accel::bvh::cut;
use crate::error::{Error, Result};
use crate::geometry::Mesh;
use crate::math::Transform;
use crate::replace::try_replace_entry;
use crate::texture::convert::fingerprint::Stamp;
use crate::texture::{Caching, FilePool, cache_dir, open_file_limit};
use rayon::prelude::*;
use std::fs::DirBuilder;
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use xxhash_rust::xxh3::xxh3_64;

/// Makes page files of one size.
pub(crate) struct PageMaker {
    directory: PathBuf,
    page_bytes: usize,
    files: Arc<FilePool>,
}

/// What a page file is made of.
pub(crate) struct Source<'a> {
    /// The mesh's file.
    pub(crate) path: &'a Path,
    /// Where its vertices go.
    pub(crate) to_world: &'a Transform,
    /// Whether normals are turned.
    pub(crate) reverse: bool,
}

/// A source as it was at a time.
pub(crate) struct Named {
    key: u64,
    stamp: Stamp,
}

/// A file that changed within this time may change again without a new time stamp: clocks of file
/// systems are as coarse as two seconds (FAT).
const UNSETTLED: Duration = Duration::from_secs(3);

impl Source<'_> {
    /// Names the mesh as it is now, with all that its pages depend on.
    fn name(&self, page_bytes: usize) -> Result<Named> {
        let stamp = Stamp::of(self.path)?;
        let full = std::fs::canonicalize(self.path).unwrap_or_else(|_| self.path.to_path_buf());
        let mut text = full.into_os_string().into_encoded_bytes();
        // Pages are made anew each time of a file that may change unnoticed, or of which the system says too little.
        let known = stamp.text().filter(|_| stamp.settled(UNSETTLED));
        let known = known.unwrap_or_else(|| format!("{:?}", SystemTime::now()));
        text.extend_from_slice(format!("\0{known}\0{VERSION}\0{page_bytes}\0{}", self.reverse).as_bytes());
        for entry in self.to_world.m.to_cols_array() {
            text.extend_from_slice(&entry.to_bits().to_le_bytes());
        }
        Ok(Named { key: xxh3_64(&text), stamp })
    }
}

impl PageMaker {
    /// Files in `directory` (the user's cache directory if not given), of pages of `page_bytes`.
    ///
    /// # Errors
    /// [`Error::Usage`] when there is no cache directory.
    pub(crate) fn new(directory: Option<&Path>, page_bytes: usize) -> Result<Self> {
        let directory = match directory {
            Some(directory) => directory.to_path_buf(),
            None => cache_dir::default_dir()?,
        };
        let files = Arc::new(FilePool::new(open_file_limit(), Caching::Direct));
        Ok(Self { directory: directory.join("pages"), page_bytes, files })
    }

    fn path(&self, key: u64) -> PathBuf {
        self.directory.join(format!("{key:016x}.pages"))
    }

    /// `source` as it is now, before it is read.
    ///
    /// # Errors
    /// [`Error::Io`] when it is not there.
    pub(crate) fn name(&self, source: &Source<'_>) -> Result<Named> {
        source.name(self.page_bytes)
    }

    /// The pages of what has this name, if they have been made.
    pub(crate) fn find(&self, named: &Named) -> Option<(PagedMesh, PageFile)> {
        file::open(&self.path(named.key), named.key, self.page_bytes, &self.files)
    }

    /// Makes the pages of `mesh`, which was read from `source` after that was given its name.
    ///
    /// # Errors
    /// [`Error::Input`] when the source has changed since; [`Error::Resource`] when the directory cannot take them.
    pub(crate) fn make(
        &self,
        source: &Source<'_>,
        named: &Named,
        mesh: &Mesh,
    ) -> Result<(PagedMesh, PageFile)> {
        named.stamp.check(source.path)?;
        let key = named.key;
        let path = self.path(key);
        let pages = self.pages(mesh);
        let cannot = |e: io::Error| {
            Error::Resource(format!(
                "{}: cannot keep the pages of {}: {e}; make room there or name another directory with --cache-dir",
                self.directory.display(),
                source.path.display()
            ))
        };
        DirBuilder::new().recursive(true).mode(0o700).create(&self.directory).map_err(cannot)?;
        cache_dir::remove_leftovers(&self.directory);
        let triangles = mesh.indices.len() as u64;
        try_replace_entry(&path, |out| file::write(out, key, self.page_bytes, triangles, &pages))
            .map_err(cannot)?;
        file::open(&path, key, self.page_bytes, &self.files)
            .ok_or_else(|| cannot(io::Error::other("what was written there is not what is read back")))
    }

    /// The pages of `mesh`, in order, none longer than a page may be.
    fn pages(&self, mesh: &Mesh) -> Vec<(Vec<u8>, [[f32; 3]; 2])> {
        let groups = cut(&mesh.positions, &mesh.indices, None, self.triangles_in_a_page(mesh));
        groups.into_par_iter().flat_map_iter(|names| self.fitting(mesh, names)).collect()
    }

    /// A group as one page, or as several where vertices are shared less than elsewhere.
    fn fitting(&self, mesh: &Mesh, names: Vec<u32>) -> Vec<(Vec<u8>, [[f32; 3]; 2])> {
        let page = encode(mesh, &names);
        if page.0.len() <= self.page_bytes {
            return vec![page];
        }
        let halves = cut(&mesh.positions, &mesh.indices, Some(&names), names.len().div_ceil(2));
        halves.into_iter().flat_map(|half| self.fitting(mesh, half)).collect()
    }

    /// Triangles that a page has room for, by the mean of the mesh.
    fn triangles_in_a_page(&self, mesh: &Mesh) -> usize {
        let triangles = mesh.indices.len().max(1) as f64;
        let attributes = (12 * (mesh.normals.len() + mesh.tangents.len()) + 8 * mesh.uvs.len()) as f64;
        // 56 bytes of tree and corners of a block, 8 of places of corners; vertices on the edge of a page are there
        // twice, which is what a fifth more is for.
        let each = 56.0 + 8.0 + 1.2 * attributes / triangles;
        ((self.page_bytes as f64 * 0.97 - 400.0) / each).clamp(1.0, crate::accel::bvh::MAX_TRIANGLES as f64)
            as usize
    }
}
