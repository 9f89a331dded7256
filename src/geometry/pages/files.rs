//! Where the pages of a scene come from; they are named one after the other from 0.

use super::file::PageFile;
use super::residents::Residents;
use super::tessellate::MadePages;
use crate::accel::bvh::PageView;
use crate::clock::Room;
use crate::error::{Error, Result};
use crate::permits;
use crate::texture::TileScratch;
use std::path::{Path, PathBuf};

/// What a page in memory costs beside its bytes: its record, its places in tables, and what the allocator adds.
const BOOKKEEPING: usize = 256;

/// Bytes that a page of `page_bytes` takes of a budget.
fn cost(page_bytes: usize) -> u64 {
    (page_bytes + BOOKKEEPING) as u64
}

/// Least budget for pages of `page_bytes` and `threads` threads: two pages a thread, one that it looks at and one
/// that it reads.
#[must_use]
pub fn least_page_budget(page_bytes: usize, threads: usize) -> u64 {
    2 * threads.max(1) as u64 * cost(page_bytes)
}

/// Where pages of a mesh come from.
pub(crate) enum PageSource {
    /// They are read.
    File(PageFile),
    /// They are made.
    Made(Box<MadePages>),
}

impl PageSource {
    fn pages(&self) -> u32 {
        match self {
            Self::File(file) => file.pages(),
            Self::Made(made) => made.pages(),
        }
    }

    fn name(&self) -> &Path {
        match self {
            Self::File(file) => file.path(),
            Self::Made(made) => made.name(),
        }
    }
}

/// All of them.
pub(super) struct PageFiles {
    files: Vec<PageSource>,
    /// By page: where it comes from; and by that: its first page.
    of: Vec<u32>,
    firsts: Vec<u32>,
    pub(super) page_bytes: usize,
    pub(super) residents: Residents,
}

impl PageFiles {
    /// Of `files`, each with pages of `page_bytes`.
    ///
    /// # Errors
    /// [`Error::Resource`] when there are more pages than names.
    pub(super) fn new(files: Vec<PageSource>, page_bytes: usize) -> Result<Self> {
        let mut firsts = Vec::with_capacity(files.len());
        let mut of = Vec::new();
        for (file, i) in files.iter().zip(0u32..) {
            firsts.push(of.len() as u32);
            of.resize(of.len() + file.pages() as usize, i);
        }
        if of.len() > PageView::MAX_PAGES as usize {
            return Err(Error::Resource(format!(
                "{} pages of geometry, and {} can be named; give larger ones with --page-size",
                of.len(),
                PageView::MAX_PAGES
            )));
        }
        let residents = Residents::new(of.len());
        Ok(Self { files, of, firsts, page_bytes, residents })
    }

    /// Pages of all files.
    pub(super) fn pages(&self) -> usize {
        self.of.len()
    }

    pub(super) fn file_of(&self, page: u32) -> usize {
        self.of[page as usize] as usize
    }

    /// What a page takes of a budget.
    pub(super) fn cost(&self) -> u64 {
        cost(self.page_bytes)
    }

    pub(super) fn count(&self) -> usize {
        self.files.len()
    }

    pub(super) fn names(&self) -> Vec<PathBuf> {
        self.files.iter().map(|f| f.name().to_path_buf()).collect()
    }

    /// Bytes of the tables that find pages.
    pub(super) fn index_bytes(&self) -> usize {
        size_of_val(&self.files[..]) + size_of_val(&self.of[..]) + size_of_val(&self.firsts[..])
    }

    /// Bytes of what pages are made of.
    pub(super) fn control_bytes(&self) -> usize {
        let of = |file: &PageSource| match file {
            PageSource::File(_) => 0,
            PageSource::Made(made) => made.bytes(),
        };
        self.files.iter().map(of).sum()
    }

    /// Reads `page` into `out`, or makes it there; how many bytes were read for it.
    pub(super) fn bring(&self, page: u32, out: &mut [u8], scratch: &mut TileScratch) -> Result<u64> {
        let file = self.file_of(page);
        let at = page - self.firsts[file];
        match &self.files[file] {
            PageSource::File(file) => permits::lend(Room::ReadGeometry, || file.read(at, out, scratch)),
            PageSource::Made(made) => Ok(made.bring(at, out)),
        }
    }
}
