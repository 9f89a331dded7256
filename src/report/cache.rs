//! A cache's record as text: what was asked for, what it cost and why, and what another size would do.

use super::{bytes, count, seconds};
use crate::stats::{CacheCounts, CacheStats};
use std::io::{self, Write};

/// Files that are listed: those that read most.
const FILES: usize = 8;

pub(super) fn write_cache(
    stats: &CacheStats,
    (what, piece): (&str, &str),
    out: &mut impl Write,
) -> io::Result<()> {
    let (row, c) = (&stats.total, &stats.total.counts);
    writeln!(
        out,
        "{what}  budget {}, peak {}; beside it {} of indices and {} of buffer a thread",
        bytes(stats.budget),
        bytes(stats.peak),
        bytes(stats.index_bytes),
        bytes(stats.buffer_bytes)
    )?;
    if stats.making_bytes > 0 {
        writeln!(out, "          {} to make files before", bytes(stats.making_bytes))?;
    }
    writeln!(
        out,
        "          {} {piece} look-ups: {} in the thread's own {piece}s, {} in the shared cache, {} misses",
        count(c.lookups as f64),
        share(c.micro_hits, c.lookups),
        share(c.hits, c.lookups),
        share(c.misses(), c.lookups)
    )?;
    writeln!(
        out,
        "          misses: {} compulsory, {} capacity, {} duplicate; {} reading, {} waiting",
        count(c.misses_compulsory as f64),
        count(c.misses_capacity as f64),
        count(c.misses_duplicate as f64),
        seconds(row.read_s),
        seconds(row.stall_s)
    )?;
    writeln!(
        out,
        "          footprint {}, loaded {} (pressure {:.2}), {} read from files",
        bytes(c.footprint_bytes),
        bytes(c.bytes_loaded),
        row.pressure,
        bytes(c.bytes_read)
    )?;
    if let Some(k) = stats.knee {
        writeln!(
            out,
            "          at {} it would read {:.1} times the footprint; at {}, {:.1} times",
            bytes(k.bytes),
            k.pressure,
            bytes(k.bytes / 2),
            k.pressure_at_half
        )?;
    }
    let used = |rows: &[CacheCounts]| rows.iter().rposition(|r| r.lookups > 0).map_or(0, |last| last + 1);
    let depths: Vec<CacheCounts> = stats.by_depth.iter().map(|row| row.counts).collect();
    for (depth, row) in depths.iter().enumerate().take(used(&depths)) {
        writeln!(out, "  depth {depth:2}  {}", line(row, piece))?;
    }
    let mut levels: Vec<CacheCounts> = Vec::new();
    for file in &stats.by_file {
        levels.resize(levels.len().max(file.by_level.len()), CacheCounts::default());
        for (sum, row) in levels.iter_mut().zip(&file.by_level) {
            sum.add(&row.counts);
        }
    }
    for (level, row) in levels.iter().enumerate().take(used(&levels)) {
        writeln!(out, "  level {level:2}  {}", line(row, piece))?;
    }
    let mut files: Vec<_> = stats.by_file.iter().collect();
    files.sort_by(|a, b| {
        b.total.counts.bytes_loaded.cmp(&a.total.counts.bytes_loaded).then(a.file.cmp(&b.file))
    });
    for file in files.iter().take(FILES) {
        writeln!(out, "  {}: {}", file.file, line(&file.total.counts, piece))?;
    }
    if files.len() > FILES {
        writeln!(out, "  and {} files that read less", files.len() - FILES)?;
    }
    Ok(())
}

fn share(part: u64, whole: u64) -> String {
    format!("{:.2} %", part as f64 / whole.max(1) as f64 * 100.0)
}

fn line(row: &CacheCounts, piece: &str) -> String {
    format!(
        "{} look-ups, {} {piece}s read, {} of them again, {} loaded, footprint {}",
        count(row.lookups as f64),
        count(row.reads() as f64),
        count(row.misses_capacity as f64),
        bytes(row.bytes_loaded),
        bytes(row.footprint_bytes)
    )
}
