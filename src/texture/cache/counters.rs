//! What a thread's look-ups cost, per file and level and per ray depth, and their sum over threads.
//!
//! Invariant: a thread owns its counts; they are merged once, when it is done. Hits in the thread's
//! own tiles are counted beside the tile and booked when it leaves, so that they cost one addition.

use crate::stats::{CacheCounts, CacheFile, CacheRow};
use std::path::PathBuf;

/// Counts of all files.
#[derive(Clone, Debug, Default)]
pub struct FileCounts {
    /// By file and level; levels that were never asked for may be missing at the end.
    pub files: Vec<Vec<CacheCounts>>,
    /// By ray depth; the last one holds the deeper ones too.
    pub depths: Vec<CacheCounts>,
}

/// Depths that are told apart.
pub(super) const DEPTHS: usize = 16;

impl FileCounts {
    pub(crate) fn new(files: usize) -> Self {
        Self { files: vec![Vec::new(); files], depths: vec![CacheCounts::default(); DEPTHS] }
    }

    /// Counts for `level` of `file`.
    #[inline]
    pub(crate) fn level(&mut self, file: usize, level: usize) -> &mut CacheCounts {
        let counts = &mut self.files[file];
        if counts.len() <= level {
            counts.resize(level + 1, CacheCounts::default());
        }
        &mut counts[level]
    }

    /// Adds another thread's counts.
    pub(crate) fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self.files.iter_mut().zip(&other.files) {
            if mine.len() < theirs.len() {
                mine.resize(theirs.len(), CacheCounts::default());
            }
            mine.iter_mut().zip(theirs).for_each(|(m, t)| m.add(t));
        }
        self.depths.iter_mut().zip(&other.depths).for_each(|(m, t)| m.add(t));
    }

    /// Records of the files that were asked for, with `names` for all.
    #[must_use]
    pub fn by_file(&self, names: &[PathBuf]) -> Vec<CacheFile> {
        let asked = names.iter().zip(&self.files).filter(|(_, levels)| !levels.is_empty());
        asked
            .map(|(name, levels)| {
                let mut sum = CacheCounts::default();
                levels.iter().for_each(|l| sum.add(l));
                CacheFile {
                    file: name.display().to_string(),
                    total: CacheRow::from(&sum),
                    by_level: levels.iter().map(CacheRow::from).collect(),
                }
            })
            .collect()
    }

    /// Sum over all files.
    #[must_use]
    pub fn total(&self) -> CacheCounts {
        let mut total = CacheCounts::default();
        self.files.iter().flatten().for_each(|c| total.add(c));
        total
    }
}
