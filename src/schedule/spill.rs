//! A file without a name for rays that have no room in memory: what was written is read once, and its place used again.
//!
//! Rays are written many at once, one behind the other, into extents of one size. What belongs together is a run: a
//! part of an extent, with a checksum. Runs of one list are linked, so that a list holds no more than the last one's name.
//!
//! Invariant: a run that is read has the bytes that were written, or the render ends. The file stays below its limit, and
//! the tables of it below theirs; nothing is left of it when the program ends, however it ends. Never maps the file: where a
//! disk is full, a write says so, and a map would end the program.

use super::meter::{PIECE_BYTES, Piece};
use crate::permits::lock;
use crate::replace::nameless_file;
use crate::stats::SchedulerStats;
use std::fs::{DirBuilder, File};
use std::io::{self, IoSlice, IoSliceMut};
use std::os::unix::fs::DirBuilderExt;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock};
use std::time::Instant;
use xxhash_rust::xxh3::Xxh3;

/// Pieces that an extent has room for.
pub(super) const EXTENT_PIECES: usize = 64;
const EXTENT_BYTES: usize = EXTENT_PIECES * PIECE_BYTES;

/// In place of a run's name: none.
pub(super) const NO_RUN: u32 = u32::MAX;

/// Where records lie in the file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    extent: u32,
    offset: u32,
    /// Pairs of records.
    pub(super) pairs: u32,
    check: u32,
    /// The run before it.
    next: u32,
}

/// The file, and where what lies in it.
#[derive(Debug)]
pub struct Spill {
    directory: PathBuf,
    most_extents: usize,
    /// Bytes that tables may take.
    most_table_bytes: usize,
    /// Pieces of a run, at most.
    run_pieces: usize,
    file: OnceLock<File>,
    tables: Mutex<Tables>,
    /// One writes at a time.
    pub(super) writer: Mutex<()>,
    /// Whether there is room for another extent.
    open: AtomicBool,
    /// Why nothing more is written.
    refused: OnceLock<String>,
    /// Why what was written could not be read.
    lost: OnceLock<String>,
    written: AtomicU64,
    write_nanoseconds: AtomicU64,
    read_nanoseconds: AtomicU64,
}

#[derive(Debug, Default)]
struct Tables {
    runs: Vec<Run>,
    /// Places in `runs` that are free: the first, linked as runs are; and how many are not.
    free_run: Option<u32>,
    used_runs: usize,
    /// Runs that lie in each extent, and extents without any.
    extents: Vec<u32>,
    free_extents: Vec<u32>,
    bytes: u64,
    peak_bytes: u64,
}

/// Bytes of the tables for an extent: both lists.
const BYTES_AN_EXTENT: usize = 2 * size_of::<u32>();

impl Tables {
    fn bytes(&self) -> usize {
        self.runs.len() * size_of::<Run>() + self.extents.len() * BYTES_AN_EXTENT
    }
}

/// Whole extents of a file of `bytes` bytes.
fn extents_in(bytes: u64) -> usize {
    usize::try_from(bytes / EXTENT_BYTES as u64).unwrap_or(usize::MAX)
}

impl Spill {
    /// Bytes of the smallest file.
    pub const LEAST_BYTES: u64 = EXTENT_BYTES as u64;

    /// Bytes of tables that a file of `bytes` bytes can make use of: a run has a piece at least.
    #[must_use]
    pub fn most_table_bytes(bytes: u64) -> usize {
        let an_extent = EXTENT_PIECES * size_of::<Run>() + BYTES_AN_EXTENT;
        // As many runs as have names.
        let most = NO_RUN as usize * size_of::<Run>();
        extents_in(bytes).saturating_mul(an_extent).min(most)
    }

    /// A file of at most `bytes` bytes in `directory`, made when it is needed; its tables take `table_bytes`, and what is
    /// written together at most `run_pieces`.
    #[must_use]
    pub fn new(directory: PathBuf, bytes: u64, table_bytes: usize, run_pieces: usize) -> Self {
        let most_extents = extents_in(bytes).min(NO_RUN as usize).min(table_bytes / 4 / BYTES_AN_EXTENT);
        let spill = Self {
            directory,
            most_extents,
            most_table_bytes: table_bytes,
            run_pieces: run_pieces.clamp(1, EXTENT_PIECES),
            file: OnceLock::new(),
            tables: Mutex::default(),
            writer: Mutex::default(),
            open: AtomicBool::new(false),
            refused: OnceLock::new(),
            lost: OnceLock::new(),
            written: AtomicU64::new(0),
            write_nanoseconds: AtomicU64::new(0),
            read_nanoseconds: AtomicU64::new(0),
        };
        {
            let mut tables = lock(&spill.tables);
            // At once, so that they never stand twice while they grow.
            tables.runs.reserve_exact(spill.most_runs());
            tables.extents.reserve_exact(most_extents);
            tables.free_extents.reserve_exact(most_extents);
            spill.look(&tables);
        }
        spill
    }

    fn most_runs(&self) -> usize {
        (self.most_table_bytes - self.most_extents * BYTES_AN_EXTENT) / size_of::<Run>()
    }

    /// Pieces of a run, at most.
    pub(super) fn run_pieces(&self) -> usize {
        self.run_pieces
    }

    /// Whether something may be written.
    pub(super) fn is_open(&self) -> bool {
        self.open.load(Ordering::Relaxed)
    }

    /// How many runs there is room for.
    pub(super) fn runs_left(&self) -> usize {
        self.most_runs() - lock(&self.tables).used_runs
    }

    /// Whether something was written that cannot be read.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.lost.get().is_some()
    }

    /// Why what was written cannot be read: what depends on it is not known.
    #[must_use]
    pub fn lost(&self) -> Option<&str> {
        self.lost.get().map(String::as_str)
    }

    /// Why less was written than there was need for.
    #[must_use]
    pub fn refused(&self) -> Option<&str> {
        self.refused.get().map(String::as_str)
    }

    /// Says whether there is room, under the lock of `tables`.
    fn look(&self, tables: &Tables) {
        let room = !tables.free_extents.is_empty() || tables.extents.len() < self.most_extents;
        let open = room && tables.used_runs < self.most_runs() && self.refused.get().is_none();
        self.open.store(open, Ordering::Relaxed);
    }

    /// Writes `parts`, each a number of pairs and their bytes, which go into one extent; the run of each. `None` when that
    /// cannot be done, now or ever. For one thread at a time: the one that holds `writer`.
    pub(super) fn write(&self, parts: &[(usize, Vec<&[u8]>)]) -> Option<Vec<Run>> {
        let extent = {
            let mut tables = lock(&self.tables);
            match tables.free_extents.pop() {
                Some(extent) => extent,
                None if tables.extents.len() < self.most_extents => {
                    tables.extents.push(0);
                    // Fewer than `NO_RUN`.
                    (tables.extents.len() - 1) as u32
                }
                None => return None,
            }
        };
        let start = Instant::now();
        let written = self.try_write(extent, parts);
        self.write_nanoseconds.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
        let mut tables = lock(&self.tables);
        let done = written.is_ok();
        match written {
            Ok(bytes) => {
                tables.extents[extent as usize] = parts.len() as u32;
                tables.bytes += bytes;
                tables.peak_bytes = tables.peak_bytes.max(tables.bytes);
                self.written.fetch_add(bytes, Ordering::Relaxed);
            }
            Err(e) => {
                tables.free_extents.push(extent);
                let directory = self.directory.display();
                let _ = self.refused.set(format!(
                    "{directory}: rays that wait cannot be kept there any more: {e}; those without room in memory are \
                     traced on the spot, and the image is the same; make room there, or name another directory with \
                     --cache-dir, or --ray-disk 0"
                ));
            }
        }
        self.look(&tables);
        drop(tables);
        done.then(|| {
            let mut offset = 0;
            let run = |(pairs, chunks): &(usize, Vec<&[u8]>)| {
                let run = Run { extent, offset, pairs: *pairs as u32, check: check(chunks), next: NO_RUN };
                offset += chunks.iter().map(|chunk| chunk.len() as u32).sum::<u32>();
                run
            };
            parts.iter().map(run).collect()
        })
    }

    fn file(&self) -> io::Result<&File> {
        if let Some(file) = self.file.get() {
            return Ok(file);
        }
        DirBuilder::new().recursive(true).mode(0o700).create(&self.directory)?;
        let file = nameless_file(&self.directory)?;
        Ok(self.file.get_or_init(|| file))
    }

    fn try_write(&self, extent: u32, parts: &[(usize, Vec<&[u8]>)]) -> io::Result<u64> {
        let file = self.file()?;
        let chunks = parts.iter().flat_map(|(_, chunks)| chunks);
        let mut slices: Vec<IoSlice<'_>> = chunks.map(|chunk| IoSlice::new(chunk)).collect();
        let mut rest = &mut slices[..];
        let begin = u64::from(extent) * EXTENT_BYTES as u64;
        let mut at = begin;
        while !rest.is_empty() {
            match rustix::io::pwritev(file, rest, at) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(count) => {
                    at += count as u64;
                    IoSlice::advance_slices(&mut rest, count);
                }
                Err(rustix::io::Errno::INTR) => {}
                Err(e) => return Err(e.into()),
            }
        }
        Ok(at - begin)
    }

    /// Puts `run` before the runs that end with `head`; its name. There is room for it ([`Self::runs_left`]).
    pub(super) fn link(&self, run: Run, head: u32) -> u32 {
        let mut tables = lock(&self.tables);
        let run = Run { next: head, ..run };
        tables.used_runs += 1;
        let name = match tables.free_run {
            Some(name) => {
                let next = tables.runs[name as usize].next;
                tables.free_run = Some(next).filter(|&next| next != NO_RUN);
                tables.runs[name as usize] = run;
                name
            }
            None => {
                tables.runs.push(run);
                (tables.runs.len() - 1) as u32
            }
        };
        self.look(&tables);
        name
    }

    /// Takes the run `name` away from the others; and the one before it.
    pub(super) fn unlink(&self, name: u32) -> (Run, u32) {
        let mut tables = lock(&self.tables);
        let run = tables.runs[name as usize];
        tables.runs[name as usize].next = tables.free_run.unwrap_or(NO_RUN);
        tables.free_run = Some(name);
        tables.used_runs -= 1;
        self.look(&tables);
        (run, run.next)
    }

    /// Asks the system to bring `run`, of `bytes` bytes, while something else is done.
    pub(super) fn expect(&self, run: &Run, bytes: usize) {
        if let (Some(file), Some(bytes)) = (self.file.get(), std::num::NonZeroU64::new(bytes as u64)) {
            let advice = rustix::fs::Advice::WillNeed;
            let _ = rustix::fs::fadvise(file, Self::place(run), Some(bytes), advice);
        }
    }

    fn place(run: &Run) -> u64 {
        u64::from(run.extent) * EXTENT_BYTES as u64 + u64::from(run.offset)
    }

    /// Reads `run` into `pieces`, of which the last gets `last_bytes` and each other `full_bytes`, and gives its place back;
    /// whether it could be read.
    pub(super) fn read(&self, run: &Run, pieces: &mut [Piece], last_bytes: usize, full_bytes: usize) -> bool {
        let start = Instant::now();
        let count = pieces.len();
        let size = |i: usize| if i + 1 == count { last_bytes } else { full_bytes };
        let result = self.try_read(run, pieces, &size);
        self.read_nanoseconds.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
        if let Err(e) = result {
            let _ = self.lost.set(format!(
                "{}: rays that were kept there cannot be read again: {e}; there is no image without them; render again, with \
                 another --cache-dir or with --ray-disk 0",
                self.directory.display()
            ));
            return false;
        }
        let bytes = (count - 1) * full_bytes + last_bytes;
        let mut tables = lock(&self.tables);
        tables.bytes -= bytes as u64;
        let runs = &mut tables.extents[run.extent as usize];
        *runs -= 1;
        if *runs == 0 {
            tables.free_extents.push(run.extent);
            self.look(&tables);
        }
        true
    }

    fn try_read(&self, run: &Run, pieces: &mut [Piece], size: &dyn Fn(usize) -> usize) -> io::Result<()> {
        let file = self.file.get().ok_or(io::ErrorKind::NotFound)?;
        let mut at = Self::place(run);
        let mut slices: Vec<IoSliceMut<'_>> = (pieces.iter_mut().enumerate())
            .map(|(i, piece)| IoSliceMut::new(&mut bytemuck::cast_slice_mut(&mut piece[..])[..size(i)]))
            .collect();
        let mut rest = &mut slices[..];
        while !rest.is_empty() {
            match rustix::io::preadv(file, rest, at) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(count) => {
                    at += count as u64;
                    IoSliceMut::advance_slices(&mut rest, count);
                }
                Err(rustix::io::Errno::INTR) => {}
                Err(e) => return Err(e.into()),
            }
        }
        let chunks: Vec<&[u8]> =
            pieces.iter().enumerate().map(|(i, p)| &bytemuck::cast_slice(&p[..])[..size(i)]).collect();
        if check(&chunks) != run.check {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "they are not what was written"));
        }
        Ok(())
    }

    /// Bytes of tables that were ever in use.
    #[must_use]
    pub fn table_bytes(&self) -> usize {
        lock(&self.tables).bytes()
    }

    /// Adds what was done to `stats`.
    pub fn report(&self, stats: &mut SchedulerStats) {
        let seconds = |n: &AtomicU64| n.load(Ordering::Relaxed) as f64 * 1e-9;
        stats.spilled_bytes = self.written.load(Ordering::Relaxed);
        stats.spilled_peak_bytes = lock(&self.tables).peak_bytes;
        stats.spill_write_s = seconds(&self.write_nanoseconds);
        stats.spill_read_s = seconds(&self.read_nanoseconds);
    }

    /// With a file that is there already.
    #[cfg(test)]
    pub(super) fn with_file(self, file: File) -> Self {
        self.file.set(file).expect("it is new");
        self
    }
}

/// Of bytes in parts, however they are divided.
fn check(chunks: &[&[u8]]) -> u32 {
    let mut hash = Xxh3::new();
    chunks.iter().for_each(|chunk| hash.update(chunk));
    hash.digest() as u32
}
