//! A cache: how much of what was asked for was there, by file, level and depth, and what other sizes would do.

use super::curves::curve;
use super::parts::{absent, drawing, figure, key, number, table};
use crate::report::chart::{Bar, Kind, Part, bars};
use crate::report::{bytes, count, seconds};
use crate::stats::{CacheCounts, CacheFile, CacheRow, CacheStats};
use std::borrow::Cow;
use std::ffi::OsStr;
use std::path::Path;

/// A cache and its words.
pub(super) struct Which<'a> {
    /// Its part of the ids of charts, and of the record's keys.
    pub(super) id: &'static str,
    /// The section's title.
    pub(super) title: &'static str,
    /// What it holds.
    pub(super) piece: &'static str,
    /// What gives it its size.
    pub(super) option: &'static str,
    /// Its record.
    pub(super) cache: Option<&'a CacheStats>,
    /// Misses over look-ups by size.
    pub(super) curve: &'a [(u64, f64)],
    /// Bytes that the option counts beside the cache.
    pub(super) beside: u64,
    /// Why there may be no record.
    pub(super) why: &'static str,
}

/// Files in the chart, and in the table.
const DRAWN: usize = 10;
const LISTED: usize = 100;

const CAUSES: [(&str, &str); 3] =
    [("c1", "first read"), ("c4", "read again after eviction"), ("c5", "another's read awaited")];

const COLUMNS: [(&str, &str); 13] = [
    ("lookups", "look-ups"),
    ("micro_hits", "in the thread's own"),
    ("hits", "in the shared cache"),
    ("misses_compulsory", "first reads"),
    ("misses_capacity", "repeated reads"),
    ("misses_duplicate", "waited for another's"),
    ("bytes_read", "read [B]"),
    ("bytes_loaded", "loaded [B]"),
    ("footprint_bytes", "footprint [B]"),
    ("pressure", "loaded / footprint"),
    ("read_s", "reading [s]"),
    ("stall_s", "waiting [s]"),
    ("failed", "failed"),
];

/// The section of a cache.
pub(super) fn section(which: &Which<'_>) -> String {
    let Which { id, title, why, .. } = which;
    let charts = match which.cache {
        None => absent(&format!("chart-{id}"), why),
        Some(cache) => {
            let by = [by_file(which, cache), by_level(which, cache), by_depth(which, cache)].concat();
            format!("{}<div class=\"charts\">{by}{}</div>\n", summary(which, cache), curve(which, cache))
        }
    };
    format!("<section><h2>{title}</h2>\n{charts}</section>\n")
}

fn summary(which: &Which<'_>, cache: &CacheStats) -> String {
    let Which { id, piece, .. } = which;
    let c = &cache.total.counts;
    let n = |field: &str, value: u64| number(&format!("/{id}_cache/{field}"), &value, &count(value as f64));
    let b = |field: &str, value: u64| number(&format!("/{id}_cache/{field}"), &value, &bytes(value));
    let f = |field: &str, value: f64, shown: &str| number(&format!("/{id}_cache/{field}"), &value, shown);
    format!(
        "<p>{} look-ups of {piece}s: {} were in the thread's own, {} in the shared cache; {} were read for the first \
         time, {} again after they had been evicted, {} while another thread was reading them. The footprint is {}, \
         loaded were {}: {} times as much. Budget {}, peak {}. Reading took {}, waiting {} of the threads' time.</p>\n",
        n("lookups", c.lookups),
        n("micro_hits", c.micro_hits),
        n("hits", c.hits),
        n("misses_compulsory", c.misses_compulsory),
        n("misses_capacity", c.misses_capacity),
        n("misses_duplicate", c.misses_duplicate),
        b("footprint_bytes", c.footprint_bytes),
        b("bytes_loaded", c.bytes_loaded),
        f("pressure", cache.total.pressure, &format!("{:.2}", cache.total.pressure)),
        b("budget", cache.budget),
        b("peak", cache.peak),
        f("read_s", cache.total.read_s, &seconds(cache.total.read_s)),
        f("stall_s", cache.total.stall_s, &seconds(cache.total.stall_s)),
    )
}

fn share(part: u64, whole: u64) -> f64 {
    part as f64 / whole.max(1) as f64
}

fn row(label: &str, name: &str, c: &CacheCounts) -> Bar {
    let of = [c.misses_compulsory, c.misses_capacity, c.misses_duplicate];
    let parts = CAUSES.iter().zip(of).map(|((colour, cause), misses)| Part {
        value: share(misses, c.lookups),
        colour,
        title: format!("{name}: {misses} of {} look-ups: {cause}", c.lookups),
    });
    let found = share(c.micro_hits + c.hits, c.lookups) * 100.0;
    let text = format!("{found:.2} % found of {}", count(c.lookups as f64));
    Bar { label: label.to_owned(), name: name.to_owned(), from: 0.0, parts: parts.collect(), text }
}

fn numbered(what: &str, i: usize, c: &CacheCounts) -> Bar {
    let name = format!("{what} {i}");
    row(&name, &name, c)
}

/// A file's name without its folders.
fn last(file: &str) -> Cow<'_, str> {
    Path::new(file).file_name().map_or(file.into(), OsStr::to_string_lossy)
}

fn misses(which: &Which<'_>, part: &str, title: &str, rows: &[Bar], table: &str) -> String {
    let id = format!("chart-{}-{part}", which.id);
    if rows.is_empty() {
        return absent(&id, &format!("{title}: no {} was asked for.", which.piece));
    }
    let drawn = drawing(&bars(&format!("misses {title}"), Kind::Share, rows));
    let said = format!("Look-ups that did not find their {} in memory, in per cent of all.", which.piece);
    figure(&id, &format!("Misses {title}"), &said, &(key(&CAUSES) + &drawn + table))
}

fn by_file(which: &Which<'_>, cache: &CacheStats) -> String {
    let mut files: Vec<(usize, &CacheFile)> = cache.by_file.iter().enumerate().collect();
    files.sort_by(|(_, a), (_, b)| {
        b.total.counts.bytes_loaded.cmp(&a.total.counts.bytes_loaded).then(a.file.cmp(&b.file))
    });
    let rows: Vec<Bar> =
        files.iter().take(DRAWN).map(|(_, f)| row(&last(&f.file), &f.file, &f.total.counts)).collect();
    let mut columns = vec![("file", "file")];
    columns.extend(COLUMNS);
    let pointer = |i: usize| Some(format!("/{}_cache/by_file/{i}", which.id));
    let listed = files.iter().take(LISTED).map(|(i, file)| (pointer(*i), *file));
    let title = match files.len() {
        n if n > LISTED => format!("Numbers of the {LISTED} that loaded most, of {n} files"),
        _ => "Numbers".to_owned(),
    };
    let few = if files.len() > DRAWN {
        format!("by file: the {DRAWN} that loaded most")
    } else {
        "by file".to_owned()
    };
    misses(which, "file", &few, &rows, &table(&title, listed, &columns))
}

fn by_level(which: &Which<'_>, cache: &CacheStats) -> String {
    let mut levels: Vec<CacheCounts> = Vec::new();
    for file in &cache.by_file {
        levels.resize(levels.len().max(file.by_level.len()), CacheCounts::default());
        for (sum, row) in levels.iter_mut().zip(&file.by_level) {
            sum.add(&row.counts);
        }
    }
    if levels.len() < 2 && which.piece == "page" {
        let id = format!("chart-{}-level", which.id);
        return absent(
            &id,
            "Pages of geometry have no levels of detail, so that there is nothing to tell apart.",
        );
    }
    let used = || levels.iter().enumerate().filter(|(_, c)| c.lookups > 0);
    let rows: Vec<Bar> = used().map(|(level, c)| numbered("level", level, c)).collect();
    // Sums over files: the record has no row of them to point at, nor their times, which it keeps in seconds.
    let mut columns = vec![("level", "level, of all files")];
    columns.extend(COLUMNS.iter().filter(|c| !matches!(c.0, "pressure" | "read_s" | "stall_s")));
    let listed = used().map(|(level, c)| {
        let mut row = serde_json::to_value(c).expect("plain data");
        row["level"] = level.into();
        (None, row)
    });
    misses(which, "level", "by mip level", &rows, &table("Numbers", listed, &columns))
}

fn by_depth(which: &Which<'_>, cache: &CacheStats) -> String {
    let used = || cache.by_depth.iter().enumerate().filter(|(_, row)| row.counts.lookups > 0);
    let rows: Vec<Bar> = used().map(|(depth, c)| numbered("depth", depth, &c.counts)).collect();
    if rows.len() < 2 && which.piece == "page" {
        let id = format!("chart-{}-depth", which.id);
        return absent(&id, "Look-ups of pages are not counted by the depth of the ray.");
    }
    let pointer = |i: usize| Some(format!("/{}_cache/by_depth/{i}", which.id));
    let listed = used().map(|(i, row): (usize, &CacheRow)| (pointer(i), row));
    misses(
        which,
        "depth",
        "by ray depth",
        &rows,
        &table("Numbers, from the camera's rays on", listed, &COLUMNS),
    )
}
