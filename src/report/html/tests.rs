//! The page as a whole: what is in it for which record, and that no record breaks it.

use super::*;
use crate::stats::{CacheFile, CacheRow, CacheStats, Decision, Knee, MemorySample, RoomTimes, VoxelStats};

const HOSTILE: &str =
    "</title></script><script>alert(1)</script>\"'><img src=x onerror=alert(1)>&amp;\u{202e}\0.pbrt";

fn row(lookups: u64) -> CacheRow {
    let mut row = CacheRow { pressure: 1.5, read_s: 0.25, stall_s: 0.125, ..CacheRow::default() };
    row.counts.lookups = lookups;
    row.counts.hits = lookups - 3;
    row.counts.misses_compulsory = 2;
    row.counts.misses_capacity = 1;
    row.counts.bytes_loaded = 3000;
    row.counts.footprint_bytes = 2000;
    row
}

/// A record in which nothing is missing.
fn full(name: &str) -> RenderStats {
    let cache = CacheStats {
        budget: 1_000_000,
        peak: 900_000,
        total: row(1000),
        knee: Some(Knee { bytes: 2_000_000, pressure: 1.1, pressure_at_half: 1.7 }),
        by_depth: vec![row(600), row(400)],
        by_file: vec![CacheFile {
            file: name.to_owned(),
            total: row(1000),
            by_level: vec![row(700), row(300)],
        }],
        ..CacheStats::default()
    };
    let mut stats = RenderStats {
        scene: name.to_owned(),
        weir: name.to_owned(),
        command: vec!["weir".to_owned(), name.to_owned()],
        threads: 2,
        busy: 0.5,
        texture_cache: Some(cache.clone()),
        geometry_cache: Some(cache),
        ..RenderStats::default()
    };
    stats.settings.backend = name.to_owned();
    stats.plan.memory.budget = Some(4_000_000);
    stats.plan.memory.because = name.to_owned();
    stats.time.render_s = 2.0;
    stats.time.total_s = 3.0;
    stats.time.rooms = RoomTimes { threads: 10, shade_s: 1.5, turn_s: 16.0, ..RoomTimes::default() };
    stats.image.non_finite_samples = 1;
    stats.interrupted = true;
    stats.memory.timeline = (0..5)
        .map(|i| MemorySample {
            at_s: f64::from(i),
            rss: Some(u64::from(i as u32) * 1_000_000),
            ..MemorySample::default()
        })
        .collect();
    stats.miss_ratio.texture = vec![(1000, 0.5), (100_000, 0.25), (4_000_000, 0.1)];
    stats.miss_ratio.geometry = vec![(1000, 0.5)];
    let scheduler = &mut stats.scheduler;
    scheduler.name = name.to_owned();
    scheduler.because = name.to_owned();
    scheduler.grid = [40, 3, 2];
    scheduler.voxels = 7;
    scheduler.by_voxel = vec![
        VoxelStats { at: [39, 2, 1], bytes: 5, visits: 6, rays: 7 },
        VoxelStats { at: [38, 2, 0], bytes: u64::MAX, visits: 1, rays: 2 },
        VoxelStats { at: [u32::MAX; 3], bytes: 1, visits: 1, rays: 1 },
    ];
    scheduler.decisions = (0..9)
        .map(|i| Decision { at_s: f64::from(i) * 0.1, rays: 5, waiting: 9, ..Decision::default() })
        .collect();
    stats
}

const CHARTS: [&str; 14] = [
    "chart-time-phases",
    "chart-time-threads",
    "chart-time-rooms",
    "chart-memory",
    "chart-texture-file",
    "chart-texture-level",
    "chart-texture-depth",
    "chart-texture-curve",
    "chart-geometry-file",
    "chart-geometry-level",
    "chart-geometry-depth",
    "chart-geometry-curve",
    "chart-scheduler-grid",
    "chart-scheduler-decisions",
];

#[test]
fn a_full_record_has_every_chart() {
    let page = html_page(&full("a.pbrt"), Some(&Image::new(4, 3)));
    for id in CHARTS {
        let figure = page.split(&format!("<figure class=\"chart\" id=\"{id}\">")).nth(1);
        let figure = figure.unwrap_or_else(|| panic!("{id} is missing"));
        assert!(figure.split("</figure>").next().is_some_and(|f| f.contains("<svg ")), "{id} has no drawing");
    }
    assert!(page.contains("<img src=\"data:image/png;base64,"));
    // Voxels 38 and 39 share a cell of a grid of forty, and their bytes do not wrap.
    assert!(page.contains("x 38–39, y 2: 7 visits"), "no cell of two voxels");
    assert!(page.contains("x 38–39, z 0: 18446744073709551615 B of pages"));
    assert!(page.contains("<code>--texture-memory 2000000</code>"));
}

#[test]
fn an_empty_record_says_why_there_is_nothing() {
    let page = html_page(&RenderStats::default(), None);
    for id in [
        "image",
        "command",
        "chart-time-threads",
        "chart-time-rooms",
        "chart-memory",
        "chart-texture",
        "chart-geometry",
        "chart-scheduler",
    ] {
        let why = page.split(&format!("<p class=\"absent\" id=\"{id}\">")).nth(1);
        let why = why.and_then(|w| w.split("</p>").next()).unwrap_or_else(|| panic!("{id} is missing"));
        assert!(why.ends_with('.') && why.len() > 20, "{id}: {why}");
    }
    assert_eq!(page.matches("<figure class=\"chart\"").count(), 1, "the phases alone");
}

#[test]
fn names_are_text() {
    let page = html_page(&full(HOSTILE), None);
    for forbidden in ["<script", "<img", "onerror=alert(1)>", "\u{202e}", "\0", "</script"] {
        assert!(!page.contains(forbidden), "{forbidden}");
    }
    assert!(page.contains("&lt;script&gt;alert(1)&lt;/script&gt;"));
    assert_eq!(
        page.matches("</title></head>").count() + page.matches("<title>").count(),
        page.matches("</title>").count()
    );
    // Nothing is asked for: no address but those of nothing and of data, no handler, no script.
    let quoted = |attribute: &str| page.matches(&format!(" {attribute}=\"")).count();
    assert_eq!((quoted("src"), quoted("href")), (0, 1));
    assert!(page.contains("default-src 'none'"));
    assert!(
        !page.contains("url(")
            && !page.contains("@import")
            && !page.contains("http://")
            && !page.contains("https://")
    );
}

#[test]
fn what_is_no_number_never_reaches_a_drawing() {
    let mut stats = full("a.pbrt");
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0, 0.0, f64::MAX] {
        stats.time.parse_s = bad;
        stats.time.render_s = bad;
        stats.time.total_s = bad;
        stats.time.rooms.shade_s = bad;
        stats.busy = bad;
        stats.scheduler.rays_per_visit = bad;
        stats.scheduler.decisions[3].at_s = bad;
        stats.memory.timeline[2].at_s = bad;
        stats.memory.timeline[4].at_s = bad;
        stats.miss_ratio.texture[1].1 = bad;
        let cache = stats.texture_cache.as_mut().expect("a full record");
        cache.total.pressure = bad;
        cache.total.read_s = bad;
        cache.total.stall_s = bad;
        let page = html_page(&stats, None);
        for svg in page.split("<svg ").skip(1) {
            let svg = svg.split("</svg>").next().expect("some");
            // Attributes alone: in words a number may be what it is.
            for tag in svg.split('<').filter_map(|part| part.split_once('>')).map(|(tag, _)| tag) {
                for (name, value) in tag.split(' ').filter_map(|a| a.split_once('=')) {
                    if ["x", "y", "width", "height", "fill-opacity"].contains(&name) {
                        let value: f64 = value.trim_matches(['"', '/']).parse().unwrap_or(f64::NAN);
                        assert!(value.is_finite(), "{bad}: {tag}");
                    }
                }
                if let Some(path) = tag.split(" d=\"").nth(1) {
                    let path = path.split('"').next().expect("closed");
                    assert!(path.chars().all(|c| "MLHVhv 0123456789.-".contains(c)), "{bad}: {path}");
                }
            }
        }
    }
}
