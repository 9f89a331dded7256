//! Pages of what is made and not read: pieces of a shape that lie close together. All are made once before rays are traced, since
//! only then are their boxes known, and kept in a file without a name; where there is no room for that, they are made again
//! whenever they are needed.
//!
//! Invariant: a page's bytes follow from the shape, its texture and the size of pages alone, so that they are the same each time. Keeps what
//! pages are made of in memory, never what comes of it. A page from the file is used only when its checksum is right.

use super::file::PagedMesh;
use super::format::{Page, encode, is_whole};
use crate::accel::bvh::{Centre, MAX_TRIANGLES, Outline, Spread, left_of};
use crate::clock::{Room, within};
use crate::error::{Error, Result};
use crate::geometry::made::{InPieces, Parts, Piece};
use crate::geometry::place::place_mesh;
use crate::math::Transform;
use crate::permits;
use rayon::prelude::*;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Pieces that a page has room for, so that most pages are nearly full.
const PIECES_A_PAGE: usize = 20;
/// Triangles of a piece, if that is more: what is kept of one is 20 to 100 bytes.
const TRIANGLES_A_PIECE: usize = 8;
/// Bytes of a triangle in a page, about: its tree, its corners, and its share of vertices with normals and texture coordinates.
const TRIANGLE: f64 = 78.0;

/// What is divided into pages, and how.
pub(crate) struct Tessellated<'a> {
    /// Its name, for reports.
    pub(crate) name: String,
    /// Where it goes.
    pub(crate) to_world: &'a Transform,
    /// Whether normals are turned.
    pub(crate) reverse: bool,
    /// Asked now and then whether to give up.
    pub(crate) stop: &'a (dyn Fn() -> bool + Sync),
}

/// A shape whose pages are made.
pub(crate) struct MadePages {
    parts: Box<dyn Parts>,
    /// Pieces of one page after the other's, rising in each, and where they begin.
    pieces: Vec<u32>,
    starts: Vec<u32>,
    /// Where in the file each is; [`NOWHERE`] where it is not.
    slots: Vec<u32>,
    kept: Option<Arc<MadeFile>>,
    to_world: Transform,
    reverse: bool,
    page_bytes: usize,
    /// For reports.
    name: PathBuf,
}

/// Pages that are made to see how long they are.
const SAMPLED: usize = 64;
/// No slot of a file.
const NOWHERE: u32 = u32::MAX;

/// Pages in a file, of one size, of any shapes.
pub(super) struct MadeFile {
    file: File,
    next: AtomicU32,
    /// The disk takes no more.
    full: AtomicBool,
}

impl MadeFile {
    /// In `file`, which is empty.
    pub(super) fn new(file: File) -> Self {
        Self { file, next: AtomicU32::new(0), full: AtomicBool::new(false) }
    }

    /// Writes a page; where it is, if there is room.
    fn put(&self, page: &[u8]) -> u32 {
        if self.full.load(Ordering::Relaxed) {
            return NOWHERE;
        }
        let slot = self.next.fetch_add(1, Ordering::Relaxed);
        if self.file.write_all_at(page, u64::from(slot) * page.len() as u64).is_ok() {
            return slot;
        }
        self.full.store(true, Ordering::Relaxed);
        NOWHERE
    }

    /// Reads a page, if it is there.
    fn get(&self, slot: u32, out: &mut [u8]) -> bool {
        let at = u64::from(slot) * out.len() as u64;
        slot != NOWHERE && self.file.read_exact_at(out, at).is_ok() && is_whole(out)
    }
}

/// Triangles that a page has room for, about.
fn triangles_in_a_page(page_bytes: usize) -> usize {
    ((page_bytes as f64 * 0.97 - 400.0) / TRIANGLE).clamp(1.0, MAX_TRIANGLES as f64) as usize
}

/// Triangles that a piece should have at most.
pub(super) fn triangles_in_a_piece(page_bytes: usize) -> u32 {
    (triangles_in_a_page(page_bytes) / PIECES_A_PAGE).max(TRIANGLES_A_PIECE) as u32
}

/// Bytes that stay of a shape in pieces, at least.
pub(super) fn staying((parts, pieces): &InPieces) -> u64 {
    (parts.bytes() + pieces.len() * size_of::<u32>()) as u64
}

/// A piece while pages are looked for.
#[derive(Clone, Copy)]
struct Lying {
    /// By the name of the piece.
    centre: Centre,
    triangles: u32,
}

impl MadePages {
    /// Of `shape`, which has some pieces, in pages of `page_bytes`. Each is made once, so that its box is known.
    pub(super) fn new(
        shape: InPieces,
        what: Tessellated<'_>,
        page_bytes: usize,
        kept: Option<Arc<MadeFile>>,
    ) -> Result<(PagedMesh, Self)> {
        let (parts, pieces) = shape;
        let triangles = pieces.iter().map(|p| u64::from(p.triangles)).sum();
        let place = |(name, piece): (usize, &Piece)| Lying {
            centre: Centre::at(what.to_world.point(piece.centre.into()).to_array(), name as u32),
            triangles: piece.triangles,
        };
        let some = |(_, piece): &(usize, &Piece)| piece.triangles > 0;
        let mut placed: Vec<Lying> = pieces.iter().enumerate().filter(some).map(place).collect();
        let mut made = Self {
            parts,
            pieces: Vec::new(),
            starts: vec![0],
            slots: Vec::new(),
            kept,
            to_world: *what.to_world,
            reverse: what.reverse,
            page_bytes,
            name: PathBuf::from(what.name),
        };
        let about = group(&mut placed, triangles_in_a_page(page_bytes));
        let groups = match made.triangles_that_fit(&about, &pieces) {
            Some(most) => group(&mut placed, most),
            None => about,
        };
        drop((placed, pieces));
        let boxes = |group: &Vec<u32>| {
            let mut out = Vec::new();
            if (what.stop)() { Err(Error::Interrupted) } else { made.fitting(group, &mut out).map(|()| out) }
        };
        let all: Vec<Result<Vec<Boxed>>> = groups.par_iter().map(boxes).collect();
        let mut outlines = Vec::new();
        for boxed in all {
            for (pieces, of, slot) in boxed? {
                made.pieces.extend(pieces);
                made.starts.push(made.pieces.len() as u32);
                made.slots.push(slot);
                outlines.push(of);
            }
        }
        made.pieces.shrink_to_fit();
        made.starts.shrink_to_fit();
        made.slots.shrink_to_fit();
        outlines.shrink_to_fit();
        Ok((PagedMesh { first: 0, outlines, triangles }, made))
    }

    /// Triangles that nearly all pages have room for, by some of `groups`; `None` where all is in one.
    fn triangles_that_fit(&self, groups: &[Vec<u32>], pieces: &[Piece]) -> Option<usize> {
        let triangles =
            |group: &Vec<u32>| group.iter().map(|&piece| pieces[piece as usize].triangles).sum::<u32>();
        // What a page takes whatever is in it counts in those that are nearly empty.
        let full = triangles_in_a_page(self.page_bytes) as u32 / 2;
        let full: Vec<&Vec<u32>> = groups.iter().filter(|group| triangles(group) >= full).collect();
        let bytes = |group: &&Vec<u32>| match self.page(group) {
            Paged::Page((page, _)) => page.len() as f64 / f64::from(triangles(group)),
            Paged::Nothing | Paged::TooMany => 0.0,
        };
        let apart = full.len().div_ceil(SAMPLED).max(1);
        let most = full.par_iter().step_by(apart).map(bytes).reduce(|| 0.0, f64::max);
        let fits = (self.page_bytes as f64 / most) as usize;
        (groups.len() > 1 && most > 0.0).then(|| fits.clamp(1, MAX_TRIANGLES))
    }

    /// Pieces as one page, or as several where one is too long; those that no ray can hit are none.
    fn fitting(&self, pieces: &[u32], out: &mut Vec<Boxed>) -> Result<()> {
        let page = match self.page(pieces) {
            Paged::Page(page) if page.0.len() <= self.page_bytes => Some(page),
            Paged::Nothing => return Ok(()),
            _ => None,
        };
        let Some((mut page, outline)) = page else {
            let (left, right) = pieces.split_at(pieces.len() / 2);
            if left.is_empty() {
                let name = self.name.display();
                return Err(Error::Usage(format!(
                    "{name}: what is made of it does not fit into pages of {} bytes; give larger ones with --page-size",
                    self.page_bytes
                )));
            }
            self.fitting(left, out)?;
            return self.fitting(right, out);
        };
        page.resize(self.page_bytes, 0);
        let slot = self.kept.as_ref().map_or(NOWHERE, |kept| kept.put(&page));
        out.push((pieces.to_vec(), outline, slot));
        Ok(())
    }

    fn page(&self, pieces: &[u32]) -> Paged {
        let part = self.parts.make(pieces);
        let mesh = place_mesh(part.mesh, &self.to_world, self.reverse);
        let corners = |name: u32| mesh.indices[name as usize].map(|v| mesh.positions[v as usize]);
        let can_be_hit = |&name: &u32| Centre::of(corners(name), name).is_some();
        let names: Vec<u32> = (0..mesh.indices.len() as u32).filter(can_be_hit).collect();
        match names.len() {
            0 => Paged::Nothing,
            1..=MAX_TRIANGLES => Paged::Page(encode(&mesh, &names, |n| part.names[n as usize])),
            _ => Paged::TooMany,
        }
    }

    /// Its name, for reports.
    pub(super) fn name(&self) -> &Path {
        &self.name
    }

    /// How many pages it has.
    pub(super) fn pages(&self) -> u32 {
        self.starts.len() as u32 - 1
    }

    /// Bytes that stay.
    pub(super) fn bytes(&self) -> usize {
        self.parts.bytes()
            + size_of_val(&self.pieces[..])
            + size_of_val(&self.starts[..])
            + size_of_val(&self.slots[..])
    }

    /// Whether values of a texture were no numbers.
    pub(crate) fn not_numbers(&self) -> bool {
        self.parts.not_numbers()
    }

    /// Reads page `page` into `out`, which has the size of one, or makes it there; how many bytes were read.
    pub(super) fn bring(&self, page: u32, out: &mut [u8]) -> u64 {
        let slot = self.slots[page as usize];
        if let Some(kept) = &self.kept
            && permits::lend(Room::ReadGeometry, || kept.get(slot, out))
        {
            return out.len() as u64;
        }
        within(Room::MakeGeometry, || self.make(page, out));
        0
    }

    fn make(&self, page: u32, out: &mut [u8]) {
        let [start, end] = [page, page + 1].map(|i| self.starts[i as usize] as usize);
        match self.page(&self.pieces[start..end]) {
            Paged::Page((bytes, _)) if bytes.len() <= out.len() => {
                let (page, rest) = out.split_at_mut(bytes.len());
                page.copy_from_slice(&bytes);
                rest.fill(0);
            }
            // A texture that has become unreadable, which is said elsewhere, moves it otherwise: a page without nodes.
            _ => out.fill(0),
        }
    }
}

/// What comes of some pieces.
enum Paged {
    Page(Page),
    /// No ray can hit them.
    Nothing,
    /// More triangles than a page can name.
    TooMany,
}

/// Pieces of a page, where they are, and where it is kept.
type Boxed = (Vec<u32>, Outline, u32);

/// Pieces that lie close together, of `most` triangles in all at most where one alone has no more; names rise in each group.
fn group(pieces: &mut [Lying], most: usize) -> Vec<Vec<u32>> {
    let total: u64 = pieces.iter().map(|p| u64::from(p.triangles)).sum();
    let Some(goal) = left_of(total, most).filter(|_| pieces.len() > 1) else {
        let mut names: Vec<u32> = pieces.iter().map(|p| p.centre.name).collect();
        names.sort_unstable();
        return if names.is_empty() { Vec::new() } else { vec![names] };
    };
    let mut spread = Spread::NONE;
    pieces.iter().for_each(|p| spread.add(&p.centre));
    let axis = spread.axis();
    pieces.sort_unstable_by_key(|p| p.centre.key(axis));
    let mut sum = 0;
    let fits = |p: &&Lying| {
        sum += u64::from(p.triangles);
        sum <= goal
    };
    let middle = pieces.iter().take_while(fits).count().clamp(1, pieces.len() - 1);
    let (left, right) = pieces.split_at_mut(middle);
    let (mut left, right) = rayon::join(|| group(left, most), || group(right, most));
    left.extend(right);
    left
}
