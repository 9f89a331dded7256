//! A page file: a head, the pages, each on a boundary of 4 KiB, and the outlines of the pages.
//!
//! Invariant: a file whose head says that it is whole is, since the head is written last; a page is used only when its
//! checksum is right.

use super::format::{Page, VERSION, is_whole};
use crate::accel::bvh::Outline;
use crate::error::{Error, Result};
use crate::open::open_entry;
use crate::texture::{FilePool, RawFile, TileScratch};
use bytemuck::{Pod, Zeroable};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::Arc;
use xxhash_rust::xxh3::{xxh3_64, xxh3_64_with_seed};

const MAGIC: [u8; 8] = *b"WEIRPAGE";
/// What direct reads are aligned to.
const ALIGNMENT: u64 = 4096;

/// The head of a file; all numbers little-endian.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Head {
    magic: [u8; 8],
    version: u32,
    page_bytes: u32,
    /// What the file was made of.
    source: u64,
    triangles: u64,
    /// Length of the file.
    file_bytes: u64,
    pages: u32,
    unused: [u32; 3],
    /// Of the head, this being zero, and the outlines.
    checksum: u64,
}

const _: () = assert!(size_of::<Head>() as u64 <= ALIGNMENT, "pages begin on the first boundary");

/// Where the outlines begin.
fn pages_end(pages: usize, page_bytes: usize) -> u64 {
    ALIGNMENT + (pages as u64).saturating_mul(page_bytes as u64)
}

fn checksum(head: &Head, outlines: &[Outline]) -> u64 {
    let head = Head { checksum: 0, ..*head };
    xxh3_64_with_seed(bytemuck::cast_slice(outlines), xxh3_64(bytemuck::bytes_of(&head)))
}

/// What is to be known of a mesh on disk.
#[derive(Debug)]
pub struct PagedMesh {
    /// Name of its first page; the others follow.
    pub(crate) first: u32,
    /// Where the triangles of its pages are.
    pub(crate) outlines: Vec<Outline>,
    /// Triangles.
    pub(crate) triangles: u64,
}

/// An open page file.
pub(crate) struct PageFile {
    file: RawFile,
    page_bytes: usize,
    pages: u32,
}

/// Writes a file page by page.
pub(super) struct Writer<'a, W: Write + Seek> {
    out: &'a mut W,
    page_bytes: usize,
    outlines: Vec<Outline>,
    padding: Vec<u8>,
}

impl<'a, W: Write + Seek> Writer<'a, W> {
    /// To `out`, which is empty, pages of `page_bytes` at most.
    pub(super) fn new(out: &'a mut W, page_bytes: usize) -> io::Result<Self> {
        let padding = vec![0; page_bytes.max(ALIGNMENT as usize)];
        out.write_all(&padding[..ALIGNMENT as usize])?;
        Ok(Self { out, page_bytes, outlines: Vec::new(), padding })
    }

    /// The next page.
    pub(super) fn push(&mut self, (page, outline): &Page) -> io::Result<()> {
        self.out.write_all(page)?;
        self.out.write_all(&self.padding[..self.page_bytes - page.len()])?;
        self.outlines.push(*outline);
        Ok(())
    }

    /// Makes it a whole file, of `triangles` triangles of `source`.
    pub(super) fn finish(self, source: u64, triangles: u64) -> io::Result<()> {
        let Self { out, page_bytes, outlines, .. } = self;
        let pages = u32::try_from(outlines.len()).map_err(|_| io::Error::other("more pages than names"))?;
        let mut head = Head {
            magic: MAGIC,
            version: VERSION,
            page_bytes: u32::try_from(page_bytes).expect("pages are small"),
            source,
            triangles,
            file_bytes: pages_end(outlines.len(), page_bytes) + size_of_val(&outlines[..]) as u64,
            pages,
            unused: [0; 3],
            checksum: 0,
        };
        head.checksum = checksum(&head, &outlines);
        out.write_all(bytemuck::cast_slice(&outlines))?;
        out.seek(SeekFrom::Start(0))?;
        out.write_all(bytemuck::bytes_of(&head))
    }
}

/// Opens the file at `path`; `None` when it is not there, or is not the whole file made of `source` with pages of
/// `page_bytes`.
pub(super) fn open(
    path: &Path,
    source: u64,
    page_bytes: usize,
    files: &Arc<FilePool>,
) -> Option<(PagedMesh, PageFile)> {
    let mut stream = open_entry(path).ok()?;
    let length = stream.metadata().ok()?.len();
    let mut head = Head::zeroed();
    stream.read_exact(bytemuck::bytes_of_mut(&mut head)).ok()?;
    let pages_end = pages_end(head.pages as usize, page_bytes);
    let right = head.magic == MAGIC
        && head.version == VERSION
        && head.source == source
        && head.page_bytes as usize == page_bytes
        && head.file_bytes == length
        && pages_end + u64::from(head.pages) * size_of::<Outline>() as u64 == length;
    if !right {
        return None;
    }
    stream.seek(SeekFrom::Start(pages_end)).ok()?;
    let mut outlines = vec![Outline::zeroed(); head.pages as usize];
    stream.read_exact(bytemuck::cast_slice_mut(&mut outlines)).ok()?;
    if checksum(&head, &outlines) != head.checksum {
        return None;
    }
    let file = RawFile::open(path, files).ok()?;
    let mesh = PagedMesh { first: 0, outlines, triangles: head.triangles };
    Some((mesh, PageFile { file, page_bytes, pages: head.pages }))
}

impl PageFile {
    /// Where it lies.
    pub(crate) fn path(&self) -> &Path {
        self.file.path()
    }

    /// How many pages it has.
    pub(super) fn pages(&self) -> u32 {
        self.pages
    }

    /// Reads page `page` into `out`, which has the size of one; how many bytes were read for it.
    ///
    /// # Errors
    /// One line that names the file, the page and the cause.
    pub(super) fn read(&self, page: u32, out: &mut [u8], scratch: &mut TileScratch) -> Result<u64> {
        let offset = ALIGNMENT + u64::from(page) * self.page_bytes as u64;
        let wrong = |cause: &str| Error::file(self.path(), format!("page {page}: {cause}"));
        let read = self.file.read(offset, out, scratch).map_err(|cause| wrong(&cause))?;
        if is_whole(out) {
            return Ok(read);
        }
        // It would be found damaged again and again.
        let _ = std::fs::remove_file(self.path());
        Err(wrong(
            "damaged, and triangles are missing from the image; the file has been deleted: render again",
        ))
    }
}
