//! Directories of a TIFF file, classic or big, in either byte order: tags and their numbers, read
//! through a [`Window`].
//!
//! Invariant: nothing is allocated by a count that the file claims; a directory has at most 4096
//! entries. Never interprets a tag.

use super::files::Cause;
use super::window::Window;
use std::collections::BTreeMap;

type Result<T> = std::result::Result<T, Cause>;

#[derive(Clone, Copy)]
pub(super) struct Entry {
    pub(super) kind: u16,
    pub(super) count: u64,
    /// Where its values are in the file.
    pub(super) at: u64,
}

pub(super) struct Directory {
    pub(super) entries: BTreeMap<u16, Entry>,
    pub(super) next: u64,
}

pub(super) struct Reader<'w, 'f> {
    pub(super) window: &'w mut Window<'f>,
    pub(super) big_endian: bool,
    pub(super) big_tiff: bool,
}

impl Reader<'_, '_> {
    pub(super) fn number(&self, bytes: &[u8]) -> u64 {
        let fold = |v: u64, &b: &u8| v << 8 | u64::from(b);
        if self.big_endian { bytes.iter().fold(0, fold) } else { bytes.iter().rev().fold(0, fold) }
    }

    pub(super) fn number_at(&mut self, at: u64, len: usize) -> Result<u64> {
        let mut bytes = [0; 8];
        bytes[..len].copy_from_slice(self.window.bytes(at, len)?);
        Ok(self.number(&bytes[..len]))
    }

    pub(super) fn directory(&mut self, at: u64) -> Result<Directory> {
        let (count_len, entry_len, word) = if self.big_tiff { (8, 20, 8) } else { (2, 12, 4) };
        let count = self.number_at(at, count_len)?;
        if count > 4096 {
            return Err(format!("a directory of {count} entries; damaged"));
        }
        let mut entries = BTreeMap::new();
        let start = at + count_len as u64;
        for i in 0..count {
            let entry_at = start + i * entry_len as u64;
            let mut bytes = [0; 20];
            bytes[..entry_len].copy_from_slice(self.window.bytes(entry_at, entry_len)?);
            let kind = self.number(&bytes[2..4]) as u16;
            let count = self.number(&bytes[4..4 + word]);
            let fits = count.saturating_mul(kind_bytes(kind) as u64) <= word as u64;
            let at =
                if fits { entry_at + 4 + word as u64 } else { self.number(&bytes[4 + word..4 + 2 * word]) };
            entries.insert(self.number(&bytes[..2]) as u16, Entry { kind, count, at });
        }
        let next = self.number_at(start + count * entry_len as u64, word)?;
        Ok(Directory { entries, next })
    }

    /// Calls `each` with the index and value of every number of `entry`.
    pub(super) fn numbers(&mut self, entry: Entry, mut each: impl FnMut(usize, u64)) -> Result<()> {
        let size = kind_bytes(entry.kind);
        if !matches!(entry.kind, 1 | 3 | 4 | 13 | 16 | 18) {
            return Err(format!("a table of numbers has type {}; damaged", entry.kind));
        }
        let mut i = 0;
        while i < entry.count {
            let n = (entry.count - i).min(8192);
            let at = entry.at.saturating_add(i * size as u64);
            let big_endian = self.big_endian;
            let bytes = self.window.bytes(at, n as usize * size)?;
            for (k, b) in bytes.chunks_exact(size).enumerate() {
                let fold = |v: u64, &b: &u8| v << 8 | u64::from(b);
                let v = if big_endian { b.iter().fold(0, fold) } else { b.iter().rev().fold(0, fold) };
                each(i as usize + k, v);
            }
            i += n;
        }
        Ok(())
    }

    /// The one number of a tag, or of all its numbers when they are equal; `None` when they differ.
    pub(super) fn uniform(&mut self, dir: &Directory, tag: u16, default: u64) -> Result<Option<u64>> {
        let Some(&entry) = dir.entries.get(&tag) else { return Ok(Some(default)) };
        if entry.count == 0 || entry.count > 64 {
            return Err(format!("tag {tag} has {} numbers; damaged", entry.count));
        }
        let (mut first, mut same) = (0, true);
        self.numbers(entry, |i, v| {
            first = if i == 0 { v } else { first };
            same &= v == first;
        })?;
        Ok(same.then_some(first))
    }
}

/// Size of a value of a TIFF type; 0 for one that is not known.
pub(super) fn kind_bytes(kind: u16) -> usize {
    match kind {
        1 | 2 | 6 | 7 => 1,
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16..=18 => 8,
        _ => 0,
    }
}
