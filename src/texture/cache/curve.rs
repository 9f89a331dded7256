//! What a cache's counts say: its record, and what caches of other sizes would have read.
//! Never touches a tile.

use super::tile::cost;
use super::{CachedFile, TileCache};
use crate::permits::lock;
use crate::stats::{CacheRow, CacheStats};
use std::path::PathBuf;
use std::sync::atomic::Ordering;

impl TileCache {
    /// What it cost, with `names` for its files.
    #[must_use]
    pub fn stats(&self, names: &[PathBuf]) -> CacheStats {
        let counts = self.counts();
        let total = counts.total();
        let (first, stay) = (total.misses_compulsory, self.alone_bytes());
        CacheStats {
            budget: self.budget(),
            peak: self.peak(),
            index_bytes: self.index_bytes(),
            buffer_bytes: self.scratch_bytes(),
            making_bytes: 0,
            total: CacheRow::from(&total),
            knee: self.references.knee(first, |bytes| self.predicted(bytes, first, stay)),
            by_depth: counts.depths.iter().map(CacheRow::from).collect(),
            by_file: counts.by_file(names),
        }
    }

    /// Predicted misses over look-ups for caches of other sizes, in rising order of bytes.
    #[must_use]
    pub fn miss_ratio_curve(&self) -> Vec<(u64, f64)> {
        let total = lock(&self.totals).total();
        let (first, stay) = (total.misses_compulsory, self.alone_bytes());
        self.references.curve(total.lookups, |bytes| self.predicted(bytes, first, stay))
    }

    /// Tiles that a cache of `bytes` would have read in the run that this one has seen.
    #[must_use]
    pub fn predicted_misses(&self, bytes: u64) -> f64 {
        let first = lock(&self.totals).total().misses_compulsory;
        let stay = self.alone_bytes();
        self.predicted(bytes, first, stay)
    }

    /// Tiles that caches of so many bytes would have read again, so far.
    #[must_use]
    pub fn again(&self, sizes: &[u64]) -> Vec<f64> {
        let stay = self.alone_bytes();
        let others = |&bytes: &u64| bytes - stay.min(self.kept_limit(bytes));
        self.references.again(&sizes.iter().map(others).collect::<Vec<_>>())
    }

    /// [`Self::predicted_misses`], with what does not depend on `bytes`: tiles read at all, and bytes
    /// of levels that stay, which leave less to the others and are not among the sampled.
    fn predicted(&self, bytes: u64, first: u64, stay: u64) -> f64 {
        let kept = stay.min(self.kept_limit(bytes));
        self.references.misses(bytes - kept, first)
    }

    /// Bytes of all tiles that have been read and are alone in their level.
    fn alone_bytes(&self) -> u64 {
        let alone = |f: &CachedFile| {
            let read =
                |tile: &u32| f.seen[*tile as usize / 64].load(Ordering::Relaxed) >> (tile % 64) & 1 == 1;
            (f.alone..f.file.tile_count()).filter(read).count() as u64 * cost(f.lines)
        };
        self.files.iter().map(alone).sum()
    }

    /// Most bytes of levels that stay in a cache of `bytes`.
    pub(super) fn kept_limit(&self, bytes: u64) -> u64 {
        bytes.saturating_sub(self.least) / 16
    }
}
