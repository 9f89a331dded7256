//! Memory over time against what was allowed, and its peaks.

use super::parts::{absent, drawing, figure, number, numbers};
use crate::report::bytes;
use crate::report::chart::{Axis, Kind, Lines, Mark, Series, lines};
use crate::report::escape::escape;
use crate::stats::{AccountedBytes, MemorySample, RenderStats};
use std::fmt::Write;

/// Chart and peaks.
pub(super) fn section(stats: &RenderStats) -> String {
    let memory = &stats.memory;
    let known = |size: Option<u64>, none: &str| size.map_or(none.to_owned(), bytes);
    let chart = if memory.timeline.is_empty() {
        let why = "Memory over time is not in the record: nobody watched. `--stats` and `--report` do.";
        absent("chart-memory", why)
    } else {
        timeline(stats)
    };
    format!(
        "<section><h2>Memory</h2>\n<p>Peak {}, of which {} are accounted for. Budget of all together: {}. Were everything in memory: \
         geometry {}, textures {}.</p>\n{}{chart}{}</section>\n",
        number("/memory/peak_rss", &memory.peak_rss, &known(memory.peak_rss, "unknown")),
        number("/memory/peak_accounted", &memory.peak_accounted, &bytes(memory.peak_accounted)),
        number("/memory/budget", &memory.budget, &known(memory.budget, "none")),
        number("/plan/bytes/geometry", &stats.plan.bytes.geometry, &bytes(stats.plan.bytes.geometry)),
        number("/plan/bytes/textures", &stats.plan.bytes.textures, &bytes(stats.plan.bytes.textures)),
        division(stats),
        moves(stats),
    )
}

/// What textures and geometry gave each other, where they may.
fn moves(stats: &RenderStats) -> String {
    if !stats.plan.memory.balanced {
        return String::new();
    }
    let moves = &stats.memory.moves;
    let Some(last) = moves.last() else {
        return "<p>Textures and geometry gave each other nothing: it would have saved nothing worth it.</p>\n".to_owned();
    };
    let columns = [
        ("at_s", "time since rendering began [s]"),
        ("to", "to"),
        ("bytes", "moved [B]"),
        ("pages", "pages may take [B]"),
        ("textures", "tiles may take [B]"),
        ("saves", "reading saved [s/s]"),
    ];
    format!(
        "<p>Memory went to whoever saved the most seconds with it, by the curves of what caches of other sizes would have \
         read again: {} moves, after which pages may take {} and tiles {}.</p>\n{}\n",
        moves.len(),
        bytes(last.pages),
        bytes(last.textures),
        numbers("Every move", "/memory/moves", moves, &columns)
    )
}

/// What each part took, and what it was allowed where there is a bound on all.
fn division(stats: &RenderStats) -> String {
    let AccountedBytes { geometry, textures, rays, film, lights, description, tables } =
        stats.memory.accounted;
    let taken = [
        ("geometry", geometry),
        ("textures", textures),
        ("rays", rays),
        ("film", film),
        ("lights", lights),
        ("description", description),
        ("tables", tables),
    ];
    let part = |(name, size): &(&str, u64)| {
        let key = format!("/memory/accounted/{name}");
        format!("{name} {}", number(&key, size, &bytes(*size)))
    };
    let taken: Vec<String> = taken.iter().map(part).collect();
    let mut out = format!("<p>Accounted, the most of each: {}.</p>\n", taken.join(", "));
    let plan = &stats.plan.memory;
    if plan.budget.is_some() {
        let known = plan.geometry.map_or("no bound".to_owned(), bytes);
        let allowed = [
            ("geometry", number("/plan/memory/geometry", &plan.geometry, &known)),
            ("textures", number("/plan/memory/textures", &plan.textures, &bytes(plan.textures))),
            ("rays", number("/plan/memory/rays", &plan.rays, &bytes(plan.rays))),
            ("tables", number("/plan/memory/tables", &plan.tables, &bytes(plan.tables))),
        ];
        let allowed: Vec<String> = allowed.iter().map(|(name, size)| format!("{name} {size}")).collect();
        let _ = writeln!(out, "<p>Allowed: {}; {}.</p>", allowed.join(", "), escape(&plan.because));
    }
    out
}

fn timeline(stats: &RenderStats) -> String {
    let samples = &stats.memory.timeline;
    let series = |name: &str, colour, of: &dyn Fn(&MemorySample) -> Option<u64>| Series {
        name: name.to_owned(),
        colour,
        points: samples.iter().filter_map(|s| Some((s.at_s, of(s)? as f64))).collect(),
        dots: false,
    };
    let mut drawn = vec![series("process", "c0", &|s| s.rss)];
    let mut level = Vec::new();
    let mut budget = |text: &str, size: Option<u64>, colour| {
        level.extend(size.map(|size| Mark {
            at: size as f64,
            text: format!("{text} {}", bytes(size)),
            colour,
        }));
    };
    budget("budget", stats.memory.budget, "c0");
    if samples.iter().any(|s| s.geometry_staying > 0) {
        drawn.push(series("geometry, staying", "c5", &|s| Some(s.geometry_staying)));
    }
    if let Some(cache) = &stats.geometry_cache {
        drawn.push(series("pages", "c2", &|s| Some(s.geometry_cache)));
        budget("for pages", Some(cache.budget), "c2");
    }
    if let Some(cache) = &stats.texture_cache {
        drawn.push(series("tiles", "c1", &|s| Some(s.texture_cache)));
        // What is far above all that was used says so in words, and leaves the chart its scale.
        budget("for tiles", Some(cache.budget), "c1");
    }
    let most = drawn.iter().flat_map(|s| &s.points).map(|p| p.1).fold(0.0, f64::max);
    level.retain(|mark| mark.at <= most * 1.5);
    let top = level.iter().map(|m| m.at).fold(most, f64::max);
    let time = &stats.time;
    let end = samples.last().map_or(0.0, |s| s.at_s);
    let render_from = time.parse_s + time.prepare_s + time.build_s;
    let mark = |at: f64, text: &str| Mark { at, text: text.to_owned(), colour: "c0" };
    let upright = [mark(render_from, "rendering"), mark(render_from + time.render_s, "writing")];
    let chart = Lines {
        what: "memory over time".to_owned(),
        titles: ("time since the start", "memory"),
        x: Axis::up_to(end, Kind::Seconds, 6.0),
        y: Axis::from_zero(top, Kind::Bytes, 5.0),
        series: drawn,
        upright: upright.into_iter().filter(|m| m.at > 0.0 && m.at < end).collect(),
        level,
        said: samples.iter().map(|s| (s.at_s, said(s))).collect(),
        height: 230.0,
    };
    let columns = [
        ("at_s", "time [s]"),
        ("rss", "process [B]"),
        ("geometry_staying", "geometry, staying [B]"),
        ("geometry_cache", "pages [B]"),
        ("texture_cache", "tiles [B]"),
    ];
    let table = numbers("Numbers", "/memory/timeline", samples, &columns);
    let said = "What the process holds, by the operating system, and what is counted. Dashed: what was allowed, \
                where that is not far above.";
    figure("chart-memory", "Memory over time", said, &(drawing(&lines(&chart)) + &table))
}

fn said(s: &MemorySample) -> String {
    let MemorySample { at_s, rss, texture_cache, geometry_cache, geometry_staying } = *s;
    format!(
        "after {at_s} s: process {}, geometry that stays {geometry_staying} B, pages {geometry_cache} B, \
         tiles {texture_cache} B",
        rss.map_or("unknown".to_owned(), |rss| format!("{rss} B"))
    )
}
