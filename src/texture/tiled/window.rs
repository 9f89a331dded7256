//! Small pieces of a file, read in larger ones: directories and tables while a file is opened.
//!
//! Invariant: never asks for a byte beyond the file's end.

use super::blocks::{BLOCK_BYTES, Blocks};
use super::files::{Cause, PooledFile};

/// A piece of a file that was read last.
pub(super) struct Window<'f> {
    file: &'f PooledFile,
    blocks: Blocks,
    start: u64,
    len: usize,
}

impl<'f> Window<'f> {
    /// Directories of small levels are near each other; so many bytes bring several at once.
    const BYTES: usize = 64 << 10;

    pub(super) fn new(file: &'f PooledFile) -> Self {
        Self { file, blocks: Blocks::default(), start: 0, len: 0 }
    }

    /// Length of the file.
    pub(super) fn file_bytes(&self) -> u64 {
        self.file.bytes()
    }

    /// `len` bytes at `at`.
    pub(super) fn bytes(&mut self, at: u64, len: usize) -> std::result::Result<&[u8], Cause> {
        let end = at.checked_add(len as u64).filter(|&end| end <= self.file.bytes());
        let end =
            end.ok_or_else(|| format!("{len} bytes at {at} are beyond its end; damaged or cut short"))?;
        if at < self.start || end > self.start + self.len as u64 {
            self.len = 0;
            let more = (self.file.bytes() - at).min(len.max(Self::BYTES) as u64) as usize;
            self.file.read(at, more, &mut self.blocks)?;
            (self.start, self.len) = (at, more);
        }
        let skip = (self.start % BLOCK_BYTES as u64) as usize + (at - self.start) as usize;
        Ok(&self.blocks.bytes_mut(skip + len)[skip..])
    }
}
