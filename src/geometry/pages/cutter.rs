//! Cuts one mesh into pages: the centres of its triangles into groups, and each group into a page or, where vertices are
//! shared less than elsewhere, into several.
//!
//! Invariant: pages depend on the mesh and their size alone. Which triangles are in a group does (`accel/bvh/cut.rs`), and
//! a page takes them in the order of their names.

use super::disk::{CENTRE_BYTES, DiskMesh, PART_BYTES, centre_files};
use super::file::Writer;
use super::format::{Page, encode};
use super::make::Source;
use super::sort::Sorter;
use crate::accel::NONE;
use crate::accel::bvh::{Centre, MAX_TRIANGLES, Spread, cut};
use crate::error::Error;
use crate::geometry::Mesh;
use crate::texture::convert::Failure;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::io::{self, Seek, Write};
use std::ops::Range;
use std::path::Path;

/// Triangles that a thread makes into pages, or finds the centres of, before they are written, at most.
const MOST_AT_ONCE: usize = 1 << 16;

/// A mesh in world space, or to be brought there part by part.
pub(super) enum Placed {
    Memory(Mesh),
    Disk(DiskMesh),
}

/// Cuts `mesh` in `bytes` of memory, beside what it takes itself.
pub(super) struct Cutter<'a> {
    pub(super) pool: &'a ThreadPool,
    pub(super) page_bytes: usize,
    pub(super) source: &'a Source<'a>,
    pub(super) mesh: &'a Placed,
    /// For files without a name.
    pub(super) directory: &'a Path,
    pub(super) bytes: usize,
    pub(super) stop: &'a (dyn Fn() -> bool + Sync),
}

impl Cutter<'_> {
    /// Writes the whole page file of what is called `key`.
    pub(super) fn write<W: Write + Seek>(&self, out: &mut W, key: u64) -> Result<(), Failure> {
        let mut writer = Writer::new(out, self.page_bytes)?;
        let most = self.triangles_in_a_page();
        let triangles = match self.mesh {
            Placed::Memory(mesh) => {
                self.part(self.centres(mesh), most, &mut writer)?;
                mesh.indices.len() as u64
            }
            Placed::Disk(disk) => {
                let (sorter, count, spread) = self.centres_on_disk(disk, most)?;
                sorter.divide(0, 0..count, &spread, &mut |part| self.part(part, most, &mut writer))?;
                disk.triangles()
            }
        };
        writer.finish(key, triangles)?;
        Ok(())
    }

    /// Centres of all triangles that rays can hit.
    fn centres(&self, mesh: &Mesh) -> Vec<Centre> {
        let mut centres = vec![Centre::default(); mesh.indices.len()];
        let fill = |(name, (centre, corners)): (usize, (&mut Centre, &[u32; 3]))| {
            let corners = corners.map(|c| mesh.positions[c as usize]);
            let name = u32::try_from(name).expect("readers count triangles in u32");
            match Centre::of(corners, name) {
                Some(of) => *centre = of,
                None => centre.name = NONE,
            }
        };
        self.pool.install(|| {
            centres.par_iter_mut().zip(&mesh.indices).enumerate().with_min_len(4096).for_each(fill);
        });
        centres.retain(|c| c.name != NONE);
        centres
    }

    /// The same, ready to be divided: how many, and where they are.
    fn centres_on_disk(&self, disk: &DiskMesh, most: usize) -> Result<(Sorter<'_>, u64, Spread), Failure> {
        let files = centre_files(self.directory)?;
        let mut writer = files[0].writer(0);
        let (mut count, mut spread) = (0, Spread::NONE);
        let each = self.at_once(CENTRE_BYTES) as u64;
        let starts = (0..disk.triangles()).step_by(each as usize);
        let of = |first: u64| disk.centres(first..(first + each).min(disk.triangles()), self.source);
        self.in_rounds(starts, of, |centres: Vec<Centre>| {
            for centre in &centres {
                spread.add(centre);
                writer.push(bytemuck::bytes_of(centre))?;
            }
            count += centres.len() as u64;
            Ok(())
        })?;
        writer.flush()?;
        drop(writer);
        // Half is for these, a quarter for pages in the making.
        Ok((Sorter { files, most, room: self.bytes / 2, stop: self.stop }, count, spread))
    }

    /// How many threads have room for a page in the making.
    fn workers(&self) -> usize {
        (self.bytes / 4 / (MAX_TRIANGLES * PART_BYTES)).clamp(1, self.pool.current_num_threads())
    }

    /// How many triangles each of them takes at once that need `bytes` each.
    fn at_once(&self, bytes: usize) -> usize {
        (self.bytes / 4 / self.workers() / bytes).clamp(1, MOST_AT_ONCE)
    }

    /// Calls `make` with items, as many at a time as there are workers, and `take` with the results in order.
    fn in_rounds<I: Send, T: Send>(
        &self,
        mut items: impl Iterator<Item = I>,
        make: impl Fn(I) -> io::Result<T> + Sync,
        mut take: impl FnMut(T) -> io::Result<()>,
    ) -> Result<(), Failure> {
        loop {
            let round: Vec<I> = items.by_ref().take(self.workers()).collect();
            if round.is_empty() {
                return Ok(());
            }
            if (self.stop)() {
                return Err(Failure::Source(Error::Interrupted));
            }
            let made: Vec<io::Result<T>> = self.pool.install(|| round.into_par_iter().map(&make).collect());
            for result in made {
                take(result?)?;
            }
        }
    }

    /// Writes the pages of a part of the mesh, of which all centres are here.
    fn part<W: Write + Seek>(
        &self,
        mut centres: Vec<Centre>,
        most: usize,
        writer: &mut Writer<'_, W>,
    ) -> Result<(), Failure> {
        let ends = self.pool.install(|| cut(&mut centres, most));
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let groups: Vec<Range<usize>> = starts.zip(&ends).map(|(start, &end)| start..end).collect();
        let in_a_batch = (self.at_once(PART_BYTES) / most).max(1);
        let pages = |groups: &[Range<usize>]| {
            let names = |group: &Range<usize>| {
                let mut names: Vec<u32> = centres[group.clone()].iter().map(|c| c.name).collect();
                names.sort_unstable();
                names
            };
            self.pages(groups.iter().map(names).collect())
        };
        self.in_rounds(groups.chunks(in_a_batch), pages, |pages: Vec<Page>| {
            pages.iter().try_for_each(|page| writer.push(page))
        })
    }

    /// The pages of `groups` of triangles, names rising in each.
    fn pages(&self, mut groups: Vec<Vec<u32>>) -> io::Result<Vec<Page>> {
        let mut out = Vec::with_capacity(groups.len());
        match self.mesh {
            Placed::Memory(mesh) => {
                groups.iter().for_each(|group| self.fitting(mesh, group, &|n| n, &mut out));
            }
            Placed::Disk(disk) => {
                let mut all: Vec<u32> = groups.iter().flatten().copied().collect();
                all.sort_unstable();
                let mesh = disk.part(&all, self.source)?;
                for group in &mut groups {
                    for name in group.iter_mut() {
                        *name = all.binary_search(name).expect("it is one of them") as u32;
                    }
                    // Order is kept, so that ties are broken as in the whole mesh.
                    self.fitting(&mesh, group, &|n| all[n as usize], &mut out);
                }
            }
        }
        Ok(out)
    }

    /// A group as one page, or as several where one is too long.
    fn fitting(&self, mesh: &Mesh, names: &[u32], called: &impl Fn(u32) -> u32, out: &mut Vec<Page>) {
        let page = encode(mesh, names, called);
        if page.0.len() <= self.page_bytes {
            return out.push(page);
        }
        let centre = |&n: &u32| Centre::of(mesh.indices[n as usize].map(|c| mesh.positions[c as usize]), n);
        let mut centres: Vec<Centre> = names.iter().filter_map(centre).collect();
        let mut start = 0;
        for end in cut(&mut centres, names.len().div_ceil(2)) {
            let mut half: Vec<u32> = centres[start..end].iter().map(|c| c.name).collect();
            half.sort_unstable();
            self.fitting(mesh, &half, called, out);
            start = end;
        }
    }

    /// Triangles that a page has room for, by the mean of the mesh.
    fn triangles_in_a_page(&self) -> usize {
        let bytes = |vertices: u64, columns: [bool; 3]| {
            let each: u64 = columns.iter().zip([12, 8, 12]).map(|(&has, n)| if has { n } else { 0 }).sum();
            vertices * each
        };
        let (triangles, attributes) = match self.mesh {
            Placed::Memory(m) => {
                let columns = [!m.normals.is_empty(), !m.uvs.is_empty(), !m.tangents.is_empty()];
                (m.indices.len() as u64, bytes(m.positions.len() as u64, columns))
            }
            Placed::Disk(disk) => {
                let (vertices, [normals, uvs]) = disk.shape();
                (disk.triangles(), bytes(vertices, [normals, uvs, false]))
            }
        };
        // 56 bytes of tree and corners of a block, 8 of places of corners; vertices on the edge of a page are there
        // twice, which is what a fifth more is for.
        let each = 56.0 + 8.0 + 1.2 * attributes as f64 / triangles.max(1) as f64;
        ((self.page_bytes as f64 * 0.97 - 400.0) / each).clamp(1.0, MAX_TRIANGLES as f64) as usize
    }
}
