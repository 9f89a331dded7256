//! What threads did, by room of the code: all of their time is told once.
//!
//! Invariant: every test renders what it makes, long enough for a thread's beginning and end to count for little.

use crate::pages::{least, make, settings};
use crate::support::{render, scene};
use weir::settings::{RenderSettings, Schedule};
use weir::stats::{RenderStats, RoomTimes};
use weir::study::generate::Kind;

/// How much of the threads' time may be in no room: what is done before they begin and when they have ended.
const BETWEEN: f64 = 0.03;

#[track_caller]
fn all_is_told(stats: &RenderStats) -> RoomTimes {
    let rooms = stats.time.rooms;
    let all = rooms.threads as f64 * stats.time.render_s;
    let share = rooms.sum() / all;
    // Never more than there was, but for roundings.
    assert!(share > 1.0 - BETWEEN && share < 1.0 + 1e-9, "{share}: {rooms:?} of {all} s");
    assert!(rooms.named().iter().all(|(_, _, seconds)| *seconds >= 0.0), "{rooms:?}");
    assert!(rooms.trace_closest_s > 0.0 && rooms.trace_occlusion_s > 0.0 && rooms.shade_s > 0.0, "{rooms:?}");
    assert!(rooms.camera_s > 0.0 && rooms.film_s > 0.0, "{rooms:?}");
    rooms
}

#[test]
fn where_all_is_in_memory_nobody_waits_or_reads() {
    let scene = scene(
        "LookAt 0 0 -4 0 0 0 0 1 0\nCamera \"perspective\"\n\
         Film \"rgb\" \"integer xresolution\" 160 \"integer yresolution\" 160\nWorldBegin\n\
         LightSource \"point\" \"point3 from\" [ 3 4 -5 ]\nShape \"sphere\"\n",
    );
    for threads in [1, 3] {
        let settings = RenderSettings { spp: Some(64), threads: Some(threads), ..RenderSettings::default() };
        let stats = render(&scene, &settings).stats;
        let rooms = all_is_told(&stats);
        assert_eq!(rooms.threads, threads);
        let none = [rooms.read_textures_s, rooms.read_geometry_s, rooms.queues_s, rooms.turn_s];
        assert_eq!(none, [0.0; 4], "{rooms:?}");
        // A render in one thread has nobody to wait for.
        assert!(threads > 1 || rooms.idle_s < BETWEEN * stats.time.render_s, "{rooms:?}");
    }
}

#[test]
fn where_tiles_and_pages_come_and_go_reading_is_told_apart() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::City, 60_000, folder.path());
    let whole = RenderSettings { spp: Some(16), threads: Some(2), ..settings(folder.path()) };
    let few = RenderSettings { page_bytes: Some(4 << 10), ..whole.clone() };
    let pages = Some(least(&scene, &few));
    for (schedule, geometry_memory) in
        [(Schedule::Depth, pages), (Schedule::Voxel, pages), (Schedule::Sorted, None)]
    {
        let name = schedule.name();
        let base = if geometry_memory.is_some() { &few } else { &whole };
        let few = RenderSettings { schedule, geometry_memory, ..base.clone() };
        let stats = render(&scene, &few).stats;
        assert_eq!(stats.scheduler.name, name);
        let rooms = all_is_told(&stats);
        assert!(rooms.threads > 2, "{name}: some take turns");
        assert!(rooms.turn_s > 0.0, "{name}: {rooms:?}");
        assert_eq!(rooms.queues_s > 0.0, name != "depth", "{name}: {rooms:?}");
        // The cache counts the wait for a permit after a read as reading; here that is a turn.
        let read = stats.geometry_cache.as_ref().map_or(0.0, |cache| cache.total.read_s);
        assert_eq!(rooms.read_geometry_s > 0.0, few.geometry_memory.is_some(), "{name}: {rooms:?}");
        assert!(rooms.read_geometry_s <= read, "{name}: {read}: {rooms:?}");
    }
}

#[test]
fn reads_take_what_they_are_made_to_take() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::City, 60_000, folder.path());
    // Of its 200 kB of texture that has to come again and again.
    let slow = RenderSettings {
        texture_latency_seconds: 0.001,
        texture_memory: Some(140_000),
        threads: Some(2),
        ..settings(folder.path())
    };
    let stats = render(&scene, &slow).stats;
    let rooms = all_is_told(&stats);
    let total = stats.texture_cache.expect("tiles").total;
    let reads = total.counts.reads() as f64;
    assert!(reads > 100.0, "{total:?}");
    assert!(rooms.read_textures_s >= 0.001 * reads, "{reads} reads: {rooms:?}");
    // Both look at the same reads, and here nobody waits for a permit in between.
    assert!(
        (rooms.read_textures_s - total.read_s).abs() < 0.02 * total.read_s,
        "{}: {rooms:?}",
        total.read_s
    );
    // It is reading alone: two threads did all the rest in the time that is left.
    assert!(rooms.shade_s < 2.0 * stats.time.render_s - rooms.read_textures_s, "{rooms:?}");
}
