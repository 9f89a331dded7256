//! Files without a name, for what does not fit in memory while a mesh is cut.
//!
//! Invariant: nothing of them is left when the program ends, however it ends. Reading and writing take the few blocks
//! of memory that are stated here.

use crate::replace::nameless_file;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Bytes that are written, or read in order, at once.
pub(super) const BLOCK_BYTES: usize = 256 << 10;
/// Bytes that are read at once where not all are wanted: what a run of neighbours takes, and no dearer than one alone.
const NEAR_BYTES: usize = 16 << 10;

/// A file of records of one size, a number of words.
pub(super) struct Scratch {
    file: File,
    record_bytes: usize,
}

impl Scratch {
    /// An empty one on the disk of `directory`.
    pub(super) fn new(directory: &Path, record_bytes: usize) -> io::Result<Self> {
        Ok(Self { file: nameless_file(directory)?, record_bytes })
    }

    /// Reads records from `first` on.
    pub(super) fn read(&self, first: u64, out: &mut [u8]) -> io::Result<()> {
        self.file.read_exact_at(out, first * self.record_bytes as u64)
    }

    /// Calls `take` with each of the records `names`, which rise, of a file of `count`.
    pub(super) fn pick(
        &self,
        names: impl Iterator<Item = u32>,
        count: u64,
        mut take: impl FnMut(&[u8]),
    ) -> io::Result<()> {
        let size = self.record_bytes;
        let each = (NEAR_BYTES / size).max(1) as u64;
        let mut block = vec![0; each as usize * size];
        let mut held = 0..0;
        for name in names {
            let name = u64::from(name);
            if !held.contains(&name) {
                held = name..(name + each).min(count);
                self.read(name, &mut block[..(held.end - held.start) as usize * size])?;
            }
            take(&block[(name - held.start) as usize * size..][..size]);
        }
        Ok(())
    }

    /// Calls `take` with the records of `range`, in order, some at a time.
    pub(super) fn stream<E: From<io::Error>>(
        &self,
        range: std::ops::Range<u64>,
        most_bytes: usize,
        mut take: impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let each = (most_bytes / self.record_bytes).max(1) as u64;
        // Words, so that records of words can be looked at where they lie.
        let mut block = vec![0u32; each.min(range.end - range.start) as usize * self.record_bytes / 4];
        let block: &mut [u8] = bytemuck::cast_slice_mut(&mut block);
        let mut at = range.start;
        while at < range.end {
            let count = each.min(range.end - at);
            let block = &mut block[..count as usize * self.record_bytes];
            self.read(at, block)?;
            take(block)?;
            at += count;
        }
        Ok(())
    }

    /// Writes records from `first` on.
    pub(super) fn write(&self, first: u64, records: &[u8]) -> io::Result<()> {
        self.file.write_all_at(records, first * self.record_bytes as u64)
    }

    /// Writes one record after the other, from `first` on.
    pub(super) fn writer(&self, first: u64) -> Writer<'_> {
        Writer { to: self, at: first, block: Vec::with_capacity(BLOCK_BYTES) }
    }
}

/// Writes one record after the other.
pub(super) struct Writer<'a> {
    to: &'a Scratch,
    at: u64,
    block: Vec<u8>,
}

impl Writer<'_> {
    #[inline(always)]
    pub(super) fn push(&mut self, record: &[u8]) -> io::Result<()> {
        if self.block.len() + record.len() > BLOCK_BYTES {
            self.flush()?;
        }
        self.block.extend_from_slice(record);
        Ok(())
    }

    /// To be called at the end, before anything is read.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.to.write(self.at, &self.block)?;
        self.at += (self.block.len() / self.to.record_bytes) as u64;
        self.block.clear();
        Ok(())
    }
}
