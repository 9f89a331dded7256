//! Cuts meshes into page files in the cache directory, and finds those that are there.
//!
//! Invariant: a file is named by what it was made of and how; it is there whole or not at all. Its bytes depend on neither
//! the memory nor the threads that it was made with. Meshes are cut on threads of their own: one of rayon's that waits
//! might otherwise be handed the very job that it waits for.

use super::collect::{Asked, Kept, collect};
use super::cutter::{Cutter, Placed};
use super::file::{self, PageFile, PagedMesh};
use super::files::least_page_budget;
use super::format::VERSION;
use super::memory::CutMemory;
use super::tessellate::{MadeFile, MadePages, Tessellated, staying, triangles_in_a_piece};
use crate::error::{Error, Result};
use crate::geometry::Mesh;
use crate::geometry::made::InPieces;
use crate::geometry::place::place_mesh;
use crate::math::Transform;
use crate::prepare::{LEAST_PAGED, are_worth_pages};
use crate::replace::{nameless_file, try_replace_entry};
use crate::texture::cache_dir::{MakersLock, UNSETTLED};
use crate::texture::convert::Failure;
use crate::texture::convert::fingerprint::Stamp;
use crate::texture::{Caching, FilePool, cache_dir, open_file_limit};
use rayon::ThreadPool;
use std::fs::DirBuilder;
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::SystemTime;
use xxhash_rust::xxh3::xxh3_64;

/// Bytes that meshes are cut in at least, whatever the budget.
const LEAST_MEMORY: u64 = 32 << 20;

/// Makes page files of one size.
pub(crate) struct PageMaker {
    /// The cache directory, and that of page files in it.
    root: PathBuf,
    directory: PathBuf,
    page_bytes: usize,
    /// Bytes that pages and all else will have.
    budget: u64,
    files: Arc<FilePool>,
    pool: ThreadPool,
    memory: CutMemory,
    /// Pages that are made, once there are any.
    kept: OnceLock<Option<Arc<MadeFile>>>,
    /// That will look at pages.
    threads: usize,
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

impl Named {
    /// The lock of whoever makes it, one of few.
    pub(super) fn lock_name(&self) -> String {
        format!("pages-{:02x}", self.key >> 56)
    }
}

/// What became of a mesh.
pub(crate) enum Made {
    /// It is on disk.
    Pages(PagedMesh, PageFile),
    /// It is too small to be cut.
    Stays(Mesh),
}

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
    /// Files in `directory` (the user's cache directory if not given), of pages of `page_bytes`, for a render in `budget`
    /// bytes by as many threads as there are here.
    ///
    /// # Errors
    /// [`Error::Usage`] when there is no cache directory.
    pub(crate) fn new(directory: Option<&Path>, page_bytes: usize, budget: u64) -> Result<Self> {
        let root = match directory {
            Some(directory) => directory.to_path_buf(),
            None => cache_dir::default_dir()?,
        };
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(rayon::current_num_threads())
            .thread_name(|i| format!("cut-{i}"))
            .build()
            .map_err(|e| Error::Resource(format!("no threads to cut meshes: {e}")))?;
        Ok(Self {
            directory: root.join("pages"),
            root,
            page_bytes,
            budget,
            files: Arc::new(FilePool::new(open_file_limit(), Caching::Direct)),
            pool,
            memory: CutMemory::new((budget / 4).max(LEAST_MEMORY)),
            kept: OnceLock::new(),
            threads: 1,
        })
    }

    /// The same with so many bytes to cut in.
    pub(crate) fn within(mut self, bytes: u64) -> Self {
        self.memory = CutMemory::new(bytes);
        self
    }

    /// The same for so many threads that will look at pages.
    pub(crate) fn for_threads(self, threads: usize) -> Self {
        Self { threads, ..self }
    }

    /// Most bytes that meshes have been cut in at once.
    pub(crate) fn most_lent(&self) -> u64 {
        self.memory.most_lent()
    }

    pub(super) fn path(&self, named: &Named) -> PathBuf {
        self.directory.join(format!("{:016x}.pages", named.key))
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
        file::open(&self.path(named), named.key, self.page_bytes, &self.files)
    }

    /// Reads `source`, which was given its name, and makes its pages.
    ///
    /// # Errors
    /// Those of reading; [`Error::Input`] when the source has changed since; [`Error::Usage`] when the budget is too
    /// small for pages at all; [`Error::Resource`] when the directory cannot take them; [`Error::Interrupted`] when
    /// `stop` says so.
    pub(crate) fn make(
        &self,
        source: &Source<'_>,
        named: &Named,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Made> {
        std::thread::scope(|scope| match scope.spawn(|| self.make_here(source, named, stop)).join() {
            Ok(made) => made,
            Err(panic) => std::panic::resume_unwind(panic),
        })
    }

    fn make_here(
        &self,
        source: &Source<'_>,
        named: &Named,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Made> {
        let go_on = || if stop() { Err(Error::Interrupted) } else { Ok(()) };
        // What cannot be made here is said when it is needed.
        let _ = DirBuilder::new().recursive(true).mode(0o700).create(&self.root);
        let lock = MakersLock::open(&self.root, &named.lock_name());
        lock.wait(go_on)?;
        // Whoever had the lock before may have made it.
        if let Some((mesh, file)) = self.find(named) {
            return Ok(Made::Pages(mesh, file));
        }
        let cannot = |e: io::Error| {
            Error::Resource(format!(
                "{}: cannot keep the pages of {}: {e}; make room there or name another directory with --cache-dir",
                self.directory.display(),
                source.path.display()
            ))
        };
        let directory = || self.directory();
        let asked = Asked {
            go_on: &|triangles| {
                go_on()?;
                if triangles < LEAST_PAGED { Ok(()) } else { self.check_budget() }
            },
            stop,
            directory: &directory,
            cannot: &cannot,
        };
        let (kept, share) = collect(source.path, &self.memory, &asked)?;
        let kept = match kept {
            Kept::Memory(mesh) => Placed::Memory(place_mesh(mesh, source.to_world, source.reverse)),
            Kept::Disk(disk) => Placed::Disk(disk),
        };
        match kept {
            Placed::Memory(mesh) if (mesh.indices.len() as u64) < LEAST_PAGED => {
                return Ok(Made::Stays(mesh));
            }
            Placed::Disk(disk) if disk.triangles() < LEAST_PAGED => {
                let names: Vec<u32> = (0..disk.triangles() as u32).collect();
                return Ok(Made::Stays(disk.part(&names, source).map_err(cannot)?));
            }
            _ => {}
        }
        named.stamp.check(source.path)?;
        directory().map_err(cannot)?;
        cache_dir::remove_leftovers(&self.directory);
        let path = self.path(named);
        let cutter = Cutter {
            pool: &self.pool,
            page_bytes: self.page_bytes,
            source,
            mesh: &kept,
            directory: &self.directory,
            bytes: share.bytes as usize,
            stop,
        };
        let made = try_replace_entry(&path, |out| cutter.write(out, named.key));
        made.map_err(|failure| match failure {
            Failure::Source(e) => e,
            Failure::Write(e) => cannot(e),
        })?;
        let (mesh, file) = self
            .find(named)
            .ok_or_else(|| cannot(io::Error::other("what was written there is not what is read back")))?;
        Ok(Made::Pages(mesh, file))
    }

    /// Triangles that a piece of what is made should have at most.
    pub(crate) fn piece_triangles(&self) -> u32 {
        triangles_in_a_piece(self.page_bytes)
    }

    /// The pages of a shape in pieces; `None` where it is too small for any, or what they are made of takes half of what they do.
    ///
    /// # Errors
    /// [`Error::Usage`] when the budget or a page is too small; [`Error::Interrupted`].
    pub(crate) fn tessellate(
        &self,
        shape: InPieces,
        what: Tessellated<'_>,
    ) -> Result<Option<(PagedMesh, MadePages)>> {
        let triangles: u64 = shape.1.iter().map(|piece| u64::from(piece.triangles)).sum();
        let stays = staying(&shape);
        if !are_worth_pages(triangles, stays) {
            return Ok(None);
        }
        // Before anything is made.
        let least = stays + least_page_budget(self.page_bytes, self.threads);
        if self.budget < least {
            return Err(too_small(self.budget, least, self.threads));
        }
        // Where nothing can be kept, pages are made again.
        let file = || self.directory().and_then(nameless_file).ok();
        let kept = self.kept.get_or_init(|| file().map(|file| Arc::new(MadeFile::new(file))));
        MadePages::new(shape, what, self.page_bytes, kept.clone()).map(Some)
    }

    /// The directory of page files, made if it is not there.
    fn directory(&self) -> io::Result<&Path> {
        DirBuilder::new().recursive(true).mode(0o700).create(&self.directory)?;
        Ok(&self.directory)
    }

    /// Whether it can hold the fewest pages that do.
    fn check_budget(&self) -> Result<()> {
        check_page_budget(self.budget, self.page_bytes, self.threads)
    }
}

/// Holds what pages may take against [`least_page_budget`].
///
/// # Errors
/// [`Error::Usage`] when it is too small.
pub fn check_page_budget(budget: u64, page_bytes: usize, threads: usize) -> Result<()> {
    let least = least_page_budget(page_bytes, threads);
    if budget >= least {
        return Ok(());
    }
    Err(too_small(budget, least, threads))
}

fn too_small(budget: u64, least: u64, threads: usize) -> Error {
    Error::Usage(format!(
        "a geometry memory of {budget} bytes is too small: --geometry-memory {least} at least, beside what stays; \
         {threads} threads need two pages each"
    ))
}
