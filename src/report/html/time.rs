//! Where the time went: phase after phase, and what the threads did while rendering, by processor and by room of the code.

use super::parts::{absent, drawing, exact, figure, number};
use crate::report::chart::{Bar, Kind, Part, bars};
use crate::report::seconds;
use crate::stats::RenderStats;
use std::fmt::Write;

/// All charts, or why one cannot be drawn.
pub(super) fn section(stats: &RenderStats) -> String {
    let threads = if stats.time.render_s > 0.0 {
        threads(stats)
    } else {
        absent("chart-time-threads", "What threads did is not known: no rendering time is recorded.")
    };
    format!(
        "<section><h2>Time</h2>\n<div class=\"charts\">{}{threads}{}</div>\n</section>\n",
        phases(stats),
        rooms(stats)
    )
}

fn row(label: &str, from: f64, value: f64, colour: &'static str, title: String) -> Bar {
    Bar {
        label: label.to_owned(),
        name: label.to_owned(),
        from,
        parts: vec![Part { value, colour, title }],
        text: seconds(value),
    }
}

fn phases(stats: &RenderStats) -> String {
    let time = &stats.time;
    let mut rows = Vec::new();
    let mut texts = String::new();
    let mut from = 0.0;
    for (name, field, value) in [
        ("parse", "parse_s", time.parse_s),
        ("prepare", "prepare_s", time.prepare_s),
        ("build", "build_s", time.build_s),
        ("render", "render_s", time.render_s),
        ("write", "write_s", time.write_s),
    ] {
        rows.push(row(name, from, value, "c1", format!("{name}: {} s", exact(&value))));
        let _ = write!(texts, "{name} {}, ", number(&format!("/time/{field}"), &value, &seconds(value)));
        from += value;
    }
    let rest = (time.total_s - from).max(0.0);
    rows.push(row(
        "between",
        from,
        rest,
        "c0",
        format!("{} s of {} s in no phase", rest, exact(&time.total_s)),
    ));
    let drawn = drawing(&bars("time by phase", Kind::Seconds, &rows));
    let texts = format!(
        "<p class=\"said\">{texts}in all {}.</p>",
        number("/time/total_s", &time.total_s, &seconds(time.total_s))
    );
    let said = "One phase begins where the one before ended.";
    figure("chart-time-phases", "Phases", said, &(drawn + &texts))
}

fn threads(stats: &RenderStats) -> String {
    let all = stats.threads as f64 * stats.time.render_s;
    let busy = stats.busy * all;
    let mut rows = vec![
        row(
            "all threads",
            0.0,
            all,
            "c0",
            format!("{} threads for {} s", stats.threads, exact(&stats.time.render_s)),
        ),
        row("on a processor", 0.0, busy, "c1", format!("{} of all threads' time", exact(&stats.busy))),
    ];
    let mut texts = format!("threads {}, ", number("/threads", &stats.threads, &stats.threads.to_string()));
    let busy = format!("{:.1} %", stats.busy * 100.0);
    let _ = write!(texts, "busy {}", number("/busy", &stats.busy, &busy));
    let mut add = |label: &str, pointer: &str, value: f64, colour| {
        rows.push(row(label, 0.0, value, colour, format!("{label}: {} s", exact(&value))));
        let _ = write!(texts, ", {label} {}", number(pointer, &value, &seconds(value)));
    };
    for (name, cache, piece) in
        [("texture_cache", &stats.texture_cache, "tiles"), ("geometry_cache", &stats.geometry_cache, "pages")]
    {
        if let Some(cache) = cache {
            let (read, stall) = (cache.total.read_s, cache.total.stall_s);
            add(&format!("reading {piece}"), &format!("/{name}/read_s"), read, "c2");
            add(&format!("waiting for {piece}"), &format!("/{name}/stall_s"), stall, "c4");
        }
    }
    add("waiting in all", "/time/stall_s", stats.time.stall_s, "c4");
    let said = "Seconds of all threads together. Reading is partly on a processor and partly not; waiting is for \
                what another thread reads, or for room.";
    let drawn = drawing(&bars("what threads did", Kind::Seconds, &rows));
    figure(
        "chart-time-threads",
        "Threads while rendering",
        said,
        &format!("{drawn}<p class=\"said\">{texts}.</p>"),
    )
}

/// What threads did, by room of the code.
fn rooms(stats: &RenderStats) -> String {
    let rooms = &stats.time.rooms;
    let named = rooms.named();
    // A record of an older version has none.
    if named.iter().all(|(_, _, seconds)| *seconds == 0.0) {
        return absent("chart-time-rooms", "What threads did by room of the code is not in the record.");
    }
    let all = rooms.threads as f64 * stats.time.render_s;
    let mut rows = Vec::new();
    let mut texts =
        format!("threads {}", number("/time/rooms/threads", &rooms.threads, &rooms.threads.to_string()));
    for ((field, name, value), colour) in named.into_iter().zip(ROOM_COLOURS) {
        if value != 0.0 {
            rows.push(row(name, 0.0, value, colour, format!("{name}: {} s", exact(&value))));
            let _ = write!(
                texts,
                ", {name} {}",
                number(&format!("/time/rooms/{field}"), &value, &seconds(value))
            );
        }
    }
    let rest = (all - rooms.sum()).max(0.0);
    let title = format!("{rest} s of {all} s before threads began or after they had ended");
    rows.push(row("between", 0.0, rest, "c0", title));
    let turns = if rooms.threads > stats.threads {
        format!(
            " {} threads take turns, so that {} compute while others wait for a disk.",
            rooms.threads, stats.threads
        )
    } else {
        String::new()
    };
    let said = format!(
        "Thread-seconds; each counts in one room. What is read while tracing or shading is reading alone.{turns}"
    );
    let drawn = drawing(&bars("time by room", Kind::Seconds, &rows));
    figure("chart-time-rooms", "Rooms of the code", &said, &format!("{drawn}<p class=\"said\">{texts}.</p>"))
}

/// Of the rooms, in their order: tracing, shading, film, reading, queues, waiting.
const ROOM_COLOURS: [&str; 11] = ["c1", "c6", "c3", "c5", "c5", "c2", "c2", "c0", "c4", "c4", "c0"];
