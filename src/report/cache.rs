//! A cache's record as text: what was asked for, what it cost and why, and what another size would do.

use super::{bytes, count, seconds};
use crate::stats::{CacheRow, CacheStats};
use std::io::{self, Write};

/// Files that are listed: those that read most.
const FILES: usize = 8;

pub(super) fn write_cache(stats: &CacheStats, out: &mut impl Write) -> io::Result<()> {
    let c = &stats.total;
    writeln!(
        out,
        "textures  budget {}, peak {}; beside it {} of indices and {} of buffer a thread",
        bytes(stats.budget),
        bytes(stats.peak),
        bytes(stats.index_bytes),
        bytes(stats.buffer_bytes)
    )?;
    writeln!(
        out,
        "          {} tile look-ups: {} in the thread's own tiles, {} in the shared cache, {} misses",
        count(c.lookups as f64),
        share(c.micro_hits, c.lookups),
        share(c.hits, c.lookups),
        share(c.misses_compulsory + c.misses_capacity + c.misses_duplicate, c.lookups)
    )?;
    writeln!(
        out,
        "          misses: {} compulsory, {} capacity, {} duplicate; {} reading, {} waiting",
        count(c.misses_compulsory as f64),
        count(c.misses_capacity as f64),
        count(c.misses_duplicate as f64),
        seconds(c.read_s),
        seconds(c.stall_s)
    )?;
    writeln!(
        out,
        "          footprint {}, loaded {} (pressure {:.2}), {} read from files",
        bytes(c.footprint_bytes),
        bytes(c.bytes_loaded),
        c.pressure,
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
    let used = |rows: &[CacheRow]| rows.iter().rposition(|r| r.lookups > 0).map_or(0, |last| last + 1);
    for (depth, row) in stats.by_depth.iter().enumerate().take(used(&stats.by_depth)) {
        writeln!(out, "  depth {depth:2}  {}", line(row))?;
    }
    let mut levels: Vec<CacheRow> = Vec::new();
    for file in &stats.by_file {
        levels.resize(levels.len().max(file.by_level.len()), CacheRow::default());
        for (sum, row) in levels.iter_mut().zip(&file.by_level) {
            sum.lookups += row.lookups;
            sum.misses_compulsory += row.misses_compulsory;
            sum.misses_capacity += row.misses_capacity;
            sum.bytes_loaded += row.bytes_loaded;
            sum.footprint_bytes += row.footprint_bytes;
        }
    }
    for (level, row) in levels.iter().enumerate().take(used(&levels)) {
        writeln!(out, "  level {level:2}  {}", line(row))?;
    }
    let mut files: Vec<_> = stats.by_file.iter().collect();
    files.sort_by(|a, b| b.total.bytes_loaded.cmp(&a.total.bytes_loaded).then(a.file.cmp(&b.file)));
    for file in files.iter().take(FILES) {
        writeln!(out, "  {}: {}", file.file, line(&file.total))?;
    }
    if files.len() > FILES {
        writeln!(out, "  and {} files that read less", files.len() - FILES)?;
    }
    Ok(())
}

fn share(part: u64, whole: u64) -> String {
    format!("{:.2} %", part as f64 / whole.max(1) as f64 * 100.0)
}

fn line(row: &CacheRow) -> String {
    format!(
        "{} look-ups, {} tiles read, {} of them again, {} loaded, footprint {}",
        count(row.lookups as f64),
        count((row.misses_compulsory + row.misses_capacity) as f64),
        count(row.misses_capacity as f64),
        bytes(row.bytes_loaded),
        bytes(row.footprint_bytes)
    )
}
