//! The scheduler: its grid seen along each axis, and its decisions in time.

use super::parts::{absent, drawing, figure, number, numbers};
use crate::report::chart::{Axis, Heat, Kind, Lines, Series, heat, lines};
use crate::report::escape::escape;
use crate::report::{bytes, count, seconds};
use crate::stats::{Decision, SchedulerStats, VoxelStats};

/// Cells along an axis of a map, at most: smaller ones are not seen.
const CELLS: usize = 32;

/// Words, maps and decisions.
pub(super) fn section(stats: &SchedulerStats) -> String {
    let title = "<section><h2>Scheduler</h2>\n";
    let ids = ["chart-scheduler-grid", "chart-scheduler-decisions"];
    if stats.name.is_empty() {
        let why = "The record names no scheduler: paths were traced in the order of the image's tiles.";
        return format!("{title}{}</section>\n", absent("chart-scheduler", why));
    }
    let maps = if stats.by_voxel.is_empty() || stats.grid.contains(&0) {
        absent(
            ids[0],
            "There is no grid to draw: this scheduler does not sort rays by place, or visited no voxel.",
        )
    } else {
        grid(stats)
    };
    let decisions = if stats.decisions.is_empty() {
        absent(ids[1], "There are no decisions to draw: this scheduler never chose what to take up next.")
    } else {
        decisions(&stats.decisions)
    };
    format!("{title}{}{maps}{decisions}</section>\n", words(stats))
}

fn words(stats: &SchedulerStats) -> String {
    let n = |field: &str, value: u64| number(&format!("/scheduler/{field}"), &value, &count(value as f64));
    let b = |field: &str, value: u64| number(&format!("/scheduler/{field}"), &value, &bytes(value));
    let mut out = format!(
        "<p><b>{}</b>: {}. {} batches, at most {} paths in flight",
        escape(&stats.name),
        escape(stats.because.trim_end_matches('.')),
        n("batches", stats.batches),
        n("paths_in_flight_peak", stats.paths_in_flight_peak)
    );
    if stats.ray_memory > 0 {
        let (peak, allowed) =
            (b("ray_memory_peak", stats.ray_memory_peak), b("ray_memory", stats.ray_memory));
        out += &format!("; rays that waited took {peak} of {allowed}");
    }
    if stats.ray_disk > 0 {
        let s = |field: &str, value: f64| number(&format!("/scheduler/{field}"), &value, &seconds(value));
        out += &format!(
            "; {} of rays went to a file, at most {} of {} at once; {} of writing there, {} of reading",
            b("spilled_bytes", stats.spilled_bytes),
            b("spilled_peak_bytes", stats.spilled_peak_bytes),
            b("ray_disk", stats.ray_disk),
            s("spill_write_s", stats.spill_write_s),
            s("spill_read_s", stats.spill_read_s)
        );
    }
    out += ".</p>\n";
    if stats.voxels > 0 {
        let [x, y, z] = stats.grid;
        out += &format!(
            "<p>{} voxels of a grid of {x} × {y} × {z} hold geometry. {} visits; rays waited in queues {} times, {} a \
             visit.</p>\n",
            n("voxels", stats.voxels),
            n("voxel_visits", stats.voxel_visits),
            n("rays_queued", stats.rays_queued),
            number("/scheduler/rays_per_visit", &stats.rays_per_visit, &count(stats.rays_per_visit))
        );
    }
    out
}

fn grid(stats: &SchedulerStats) -> String {
    type Measure = (&'static str, fn(&VoxelStats) -> u64, fn(u64) -> String);
    let measures: [Measure; 3] = [
        ("visits", |v| v.visits, |n| format!("{n} visits")),
        ("rays", |v| v.rays, |n| format!("{n} rays")),
        ("bytes of pages", |v| v.bytes, |n| format!("{n} B of pages")),
    ];
    let mut inside = "<div class=\"maps\">".to_owned();
    for (name, of, said) in measures {
        inside += &format!("<h3>{name}</h3>");
        for [across, up, along] in [[0, 1, 2], [0, 2, 1], [2, 1, 0]] {
            let map = projection(stats, [across, up, along], name, of, said);
            let most = map.cells.iter().map(|cell| cell.0).fold(0.0, f64::max);
            let most = said(most as u64);
            inside += &format!("<div>{}<small class=\"soft\">full colour: {most}</small></div>", heat(&map));
        }
    }
    inside += "</div>";
    let columns = [("at", "voxel"), ("visits", "visits"), ("rays", "rays"), ("bytes", "pages [B]")];
    inside += &numbers("Numbers", "/scheduler/by_voxel", &stats.by_voxel, &columns);
    let said = "Sums along each axis. A cell's colour is as deep as the square root of its number over the map's \
                largest; what was not visited has none.";
    figure("chart-scheduler-grid", "The grid, seen along z, y and x", said, &inside)
}

/// The grid seen along an axis: sums of `of`.
fn projection(
    stats: &SchedulerStats,
    [across, up, along]: [usize; 3],
    name: &str,
    of: fn(&VoxelStats) -> u64,
    said: fn(u64) -> String,
) -> Heat {
    const NAMES: [&str; 3] = ["x", "y", "z"];
    // Voxels that share a cell, along each axis.
    let together = [across, up].map(|axis| (stats.grid[axis] as usize).div_ceil(CELLS).max(1));
    let size = [(across, together[0]), (up, together[1])]
        .map(|(axis, together)| (stats.grid[axis] as usize).div_ceil(together));
    let mut sums = vec![0u64; size[0] * size[1]];
    for voxel in &stats.by_voxel {
        let (i, j) = (voxel.at[across] as usize / together[0], voxel.at[up] as usize / together[1]);
        // A record is a file, and may say anything.
        if i < size[0] && j < size[1] {
            let sum = &mut sums[j * size[0] + i];
            *sum = sum.saturating_add(of(voxel));
        }
    }
    let range = |cell: usize, together: usize| match together {
        1 => cell.to_string(),
        n => format!("{}–{}", cell * n, cell * n + n - 1),
    };
    let cells = sums.iter().enumerate().map(|(i, sum)| {
        let (x, y) = (range(i % size[0], together[0]), range(i / size[0], together[1]));
        (*sum as f64, format!("{} {x}, {} {y}: {}", NAMES[across], NAMES[up], said(*sum)))
    });
    Heat {
        what: format!("{name}, seen along {}", NAMES[along]),
        axes: [NAMES[across], NAMES[up]],
        size,
        cells: cells.collect(),
    }
}

fn decisions(list: &[Decision]) -> String {
    let end = list.iter().map(|d| d.at_s).fold(0.0, f64::max);
    /// Title, colour, what is counted, whether in dots, and the number.
    type Panel = (&'static str, &'static str, Kind, bool, fn(&Decision) -> u64);
    let panels: [Panel; 3] = [
        ("rays waiting in all queues", "c0", Kind::Count, false, |d| d.waiting),
        ("rays taken from the voxel's queue", "c1", Kind::Count, true, |d| d.rays),
        ("bytes of its pages thought absent", "c4", Kind::Bytes, true, |d| d.cost_bytes),
    ];
    let said = |d: &Decision| {
        let [x, y, z] = d.voxel;
        format!(
            "after {} s: voxel {x}, {y}, {z}; {} rays taken, {} waiting, {} B thought absent",
            d.at_s, d.rays, d.waiting, d.cost_bytes
        )
    };
    let mut inside = String::new();
    for (title, colour, kind, dots, of) in panels {
        let chart = Lines {
            what: format!("{title}, over time"),
            titles: ("rendering time", title),
            x: Axis::up_to(end, Kind::Seconds, 6.0),
            y: Axis::from_zero(list.iter().map(of).max().unwrap_or(0) as f64, kind, 3.0),
            series: vec![Series {
                name: String::new(),
                colour,
                points: list.iter().map(|d| (d.at_s, of(d) as f64)).collect(),
                dots,
            }],
            upright: Vec::new(),
            level: Vec::new(),
            said: list.iter().map(|d| (d.at_s, said(d))).collect(),
            height: 110.0,
        };
        inside += &drawing(&lines(&chart));
    }
    let columns = [
        ("at_s", "time [s]"),
        ("voxel", "voxel"),
        ("rays", "rays taken"),
        ("waiting", "rays waiting"),
        ("cost_bytes", "pages thought absent [B]"),
    ];
    inside += &numbers("Numbers", "/scheduler/decisions", list, &columns);
    let said = "One point a visit of a voxel; where there were very many, every n-th was kept.";
    figure("chart-scheduler-decisions", "Decisions over time", said, &inside)
}
