//! What a cache of tiles or pages cost: counts by cause, and the record that `--stats` writes.
//!
//! Invariant: a look-up is a hit or a miss of one cause, and nothing else.

use serde::{Deserialize, Serialize};

/// Counts of one mip level, of one ray depth, or of any sum of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct CacheCounts {
    /// Tiles asked for.
    pub lookups: u64,
    /// Of these, found in the thread's own tiles, without a lock.
    pub micro_hits: u64,
    /// Found in the shared cache.
    pub hits: u64,
    /// Read for the first time.
    pub misses_compulsory: u64,
    /// Read again, because it had been evicted.
    pub misses_capacity: u64,
    /// Not there, but another thread was reading it: waited for, not read a second time.
    pub misses_duplicate: u64,
    /// Bytes read from files.
    pub bytes_read: u64,
    /// Bytes brought in, decoded.
    pub bytes_loaded: u64,
    /// Bytes brought in for the first time, decoded: unique bytes touched.
    pub footprint_bytes: u64,
    /// Time spent reading and decoding.
    #[serde(skip)]
    pub read_ns: u64,
    /// Time spent waiting: for another thread's read, or for room.
    #[serde(skip)]
    pub stall_ns: u64,
    /// Reads that failed; they count as misses and as loaded too, since what stands in for them does.
    pub failed: u64,
}

impl CacheCounts {
    /// Adds another's counts.
    pub fn add(&mut self, other: &Self) {
        let Self {
            lookups,
            micro_hits,
            hits,
            misses_compulsory,
            misses_capacity,
            misses_duplicate,
            bytes_read,
            bytes_loaded,
            footprint_bytes,
            read_ns,
            stall_ns,
            failed,
        } = *other;
        self.lookups += lookups;
        self.micro_hits += micro_hits;
        self.hits += hits;
        self.misses_compulsory += misses_compulsory;
        self.misses_capacity += misses_capacity;
        self.misses_duplicate += misses_duplicate;
        self.bytes_read += bytes_read;
        self.bytes_loaded += bytes_loaded;
        self.footprint_bytes += footprint_bytes;
        self.read_ns += read_ns;
        self.stall_ns += stall_ns;
        self.failed += failed;
    }

    /// Look-ups that found nothing in memory.
    #[must_use]
    pub fn misses(&self) -> u64 {
        self.misses_compulsory + self.misses_capacity + self.misses_duplicate
    }

    /// Tiles or pages that were read.
    #[must_use]
    pub fn reads(&self) -> u64 {
        self.misses_compulsory + self.misses_capacity
    }
}

/// [`CacheCounts`] as they are written: seconds, and what follows from the counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CacheRow {
    /// The counts, without their nanoseconds: these are 0, and stand below as seconds.
    #[serde(flatten)]
    pub counts: CacheCounts,
    /// `bytes_loaded` over `footprint_bytes`: 1 is ideal, 2 fine, 10 bad; 0 where nothing was read.
    pub pressure: f64,
    /// Time spent reading and decoding \[s\], summed over threads.
    pub read_s: f64,
    /// Time spent waiting for another thread's read or for room \[s\], summed over threads.
    pub stall_s: f64,
}

impl From<&CacheCounts> for CacheRow {
    fn from(c: &CacheCounts) -> Self {
        Self {
            counts: CacheCounts { read_ns: 0, stall_ns: 0, ..*c },
            pressure: super::per_second(c.bytes_loaded as f64, c.footprint_bytes as f64),
            read_s: c.read_ns as f64 * 1e-9,
            stall_s: c.stall_ns as f64 * 1e-9,
        }
    }
}

/// One file's part.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CacheFile {
    /// Its name.
    pub file: String,
    /// Sum over its levels.
    #[serde(flatten)]
    pub total: CacheRow,
    /// By mip level, the finest first.
    pub by_level: Vec<CacheRow>,
}

/// Where a larger cache stops paying, as the miss-ratio curve has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Knee {
    /// The smallest cache that reads at most 1.1 times the footprint \[bytes\].
    pub bytes: u64,
    /// What it reads over the footprint.
    pub pressure: f64,
    /// What half of it would read over the footprint.
    pub pressure_at_half: f64,
}

/// A cache's record.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CacheStats {
    /// Bytes it was allowed.
    pub budget: u64,
    /// Most bytes it held at once, those being read included.
    pub peak: u64,
    /// Bytes of tables beside the budget: where tiles are in their files, and which were read.
    pub index_bytes: u64,
    /// Bytes of the largest read buffer of a thread, beside the budget.
    pub buffer_bytes: u64,
    /// Most bytes that were lent at once, before the first sample, to make what was missing of its files; 0 where
    /// nothing was, and for textures, whose makers need little.
    pub making_bytes: u64,
    /// Sum over all files.
    #[serde(flatten)]
    pub total: CacheRow,
    /// Where a larger cache stops paying; absent where nothing was read.
    pub knee: Option<Knee>,
    /// By ray depth, from the camera's rays on; the last holds the deeper ones too.
    pub by_depth: Vec<CacheRow>,
    /// Files that were asked for.
    pub by_file: Vec<CacheFile>,
}

/// Predicted misses over look-ups by size of the cache \[bytes\], sizes rising.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MissRatios {
    /// Of the texture cache.
    pub texture: Vec<(u64, f64)>,
    /// Of the geometry cache.
    pub geometry: Vec<(u64, f64)>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// The keys are a contract: other programs read them.
    #[test]
    fn a_row_has_the_keys_of_the_contract_and_comes_back() {
        let counts = CacheCounts {
            lookups: 21,
            micro_hits: 1,
            hits: 2,
            misses_compulsory: 3,
            misses_capacity: 4,
            misses_duplicate: 5,
            bytes_read: 6,
            bytes_loaded: 16,
            footprint_bytes: 8,
            read_ns: 500_000_000,
            stall_ns: 250_000_000,
            failed: 9,
        };
        let row = CacheRow::from(&counts);
        let mut json = json!({
            "lookups": 21,
            "micro_hits": 1,
            "hits": 2,
            "misses_compulsory": 3,
            "misses_capacity": 4,
            "misses_duplicate": 5,
            "bytes_read": 6,
            "bytes_loaded": 16,
            "footprint_bytes": 8,
            "pressure": 2.0,
            "read_s": 0.5,
            "stall_s": 0.25,
            "failed": 9,
        });
        assert_eq!(serde_json::to_value(row).expect("plain data"), json);

        let file = CacheFile { file: "a.tx".to_owned(), total: row, by_level: vec![row] };
        json["by_level"] = json!([json]);
        json["file"] = json!("a.tx");
        assert_eq!(serde_json::to_value(&file).expect("plain data"), json);
        let read: CacheFile = serde_json::from_str(&json.to_string()).expect("as written");
        assert_eq!(read, file);

        let sparse: CacheStats =
            serde_json::from_str(r#"{"lookups": 7, "new": 1, "by_depth": [{"hits": 3}]}"#)
                .expect("of another version");
        assert_eq!(serde_json::to_value(sparse.total).expect("plain data")["lookups"], 7);
        assert_eq!(serde_json::to_value(&sparse.by_depth).expect("plain data")[0]["hits"], 3);
    }
}
