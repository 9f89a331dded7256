//! A page file: a head, the boxes of the pages, and the pages, each on a boundary of 4 KiB.
//!
//! Invariant: a file whose head says that it is whole is; a page is used only when its checksum is right.

use super::format::{VERSION, is_whole};
use super::residents::Residents;
use crate::error::{Error, Result};
use crate::open::open_entry;
use crate::texture::cache::TileSource;
use crate::texture::{FilePool, RawFile, TileScratch};
use bytemuck::{Pod, Zeroable};
use std::io::{self, Read, Write};
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
    /// Of the head, this being zero, and the boxes.
    checksum: u64,
}

const _: () = assert!(size_of::<Head>() == 64, "boxes follow at once");

type Box3 = [[f32; 3]; 2];

fn data_start(pages: usize) -> u64 {
    ((size_of::<Head>() + pages * size_of::<Box3>()) as u64).next_multiple_of(ALIGNMENT)
}

fn checksum(head: &Head, bounds: &[Box3]) -> u64 {
    let head = Head { checksum: 0, ..*head };
    xxh3_64_with_seed(bytemuck::cast_slice(bounds), xxh3_64(bytemuck::bytes_of(&head)))
}

/// What is to be known of a mesh on disk.
#[derive(Debug)]
pub struct PagedMesh {
    /// Name of its first page; the others follow.
    pub(crate) first: u32,
    /// Boxes of its pages.
    pub(crate) bounds: Vec<Box3>,
    /// Triangles.
    pub(crate) triangles: u64,
}

/// An open page file.
pub(crate) struct PageFile {
    file: RawFile,
    page_bytes: usize,
    pages: u32,
    start: u64,
    /// Who is told of what is in memory, and what the first page is called there.
    residents: Option<(Arc<Residents>, u32)>,
}

/// Writes the file of `pages`, each at most `page_bytes` long with its box.
pub(super) fn write(
    out: &mut impl Write,
    source: u64,
    page_bytes: usize,
    triangles: u64,
    pages: &[(Vec<u8>, Box3)],
) -> io::Result<()> {
    let bounds: Vec<Box3> = pages.iter().map(|(_, b)| *b).collect();
    let start = data_start(pages.len());
    let mut head = Head {
        magic: MAGIC,
        version: VERSION,
        page_bytes: u32::try_from(page_bytes).expect("pages are small"),
        source,
        triangles,
        file_bytes: start + (pages.len() * page_bytes) as u64,
        pages: u32::try_from(pages.len()).expect("pages are counted in u32"),
        unused: [0; 3],
        checksum: 0,
    };
    head.checksum = checksum(&head, &bounds);
    out.write_all(bytemuck::bytes_of(&head))?;
    out.write_all(bytemuck::cast_slice(&bounds))?;
    let padding = vec![0; page_bytes.max(ALIGNMENT as usize)];
    out.write_all(&padding[..start as usize - size_of::<Head>() - size_of_val(&bounds[..])])?;
    for (page, _) in pages {
        out.write_all(page)?;
        out.write_all(&padding[..page_bytes - page.len()])?;
    }
    Ok(())
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
    let start = data_start(head.pages as usize);
    let right = head.magic == MAGIC
        && head.version == VERSION
        && head.source == source
        && head.page_bytes as usize == page_bytes
        && head.file_bytes == length
        && start.checked_add(u64::from(head.pages) * page_bytes as u64) == Some(length);
    if !right {
        return None;
    }
    let mut bounds = vec![Box3::default(); head.pages as usize];
    stream.read_exact(bytemuck::cast_slice_mut(&mut bounds)).ok()?;
    if checksum(&head, &bounds) != head.checksum {
        return None;
    }
    let file = RawFile::open(path, files).ok()?;
    let mesh = PagedMesh { first: 0, bounds, triangles: head.triangles };
    Some((mesh, PageFile { file, page_bytes, pages: head.pages, start, residents: None }))
}

impl PageFile {
    /// Where it lies.
    pub(crate) fn path(&self) -> &Path {
        self.file.path()
    }

    /// Tells `residents` what is in memory, from now on; the first page is called `first` there.
    pub(super) fn report_to(&mut self, residents: Arc<Residents>, first: u32) {
        self.residents = Some((residents, first));
    }
}

impl TileSource for PageFile {
    fn tile_count(&self) -> u32 {
        self.pages
    }

    fn tile_bytes(&self) -> usize {
        self.page_bytes
    }

    fn first_tiles(&self) -> &[u32] {
        &[0]
    }

    fn index_bytes(&self) -> usize {
        size_of::<Self>()
    }

    fn is_alone(&self, _: u32) -> bool {
        // None is more worth keeping than another.
        false
    }

    fn read_tile(&self, tile: u32, out: &mut [u8], scratch: &mut TileScratch) -> Result<u64> {
        let offset = self.start + u64::from(tile) * self.page_bytes as u64;
        let wrong = |cause: &str| Error::file(self.path(), format!("page {tile}: {cause}"));
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

    fn came(&self, tile: u32) {
        if let Some((residents, first)) = &self.residents {
            residents.came(first + tile);
        }
    }

    fn went(&self, tile: u32) {
        if let Some((residents, first)) = &self.residents {
            residents.went(first + tile);
        }
    }

    fn fill_unreadable(&self, out: &mut [u8]) {
        // A page without nodes.
        out.fill(0);
    }
}
