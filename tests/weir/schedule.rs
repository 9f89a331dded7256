//! Rays that wait: whatever runs next, in however little memory, on however many threads, the picture is the same to
//! the bit.
//!
//! Invariant: everything is made on the spot, in a directory of the test's own.

use crate::determinism::everything;
use crate::pages::{least, least_for_rays, make, settings};
use crate::support::render;
use std::sync::{Arc, mpsc};
use std::time::Duration;
use std::{fs, thread};
use weir::settings::{Backend, RenderSettings, Schedule};
use weir::study::generate::Kind;

#[test]
fn sorted_rays_give_the_picture_of_waves() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = everything(folder.path());
    for backend in [Backend::default(), Backend::Native] {
        let waves = RenderSettings { schedule: Schedule::Depth, backend, ..RenderSettings::default() };
        let plain = render(&scene, &waves);
        let sorted = RenderSettings { schedule: Schedule::Sorted, ..waves };
        let least = least_for_rays(&scene, &sorted);
        for (ray_memory, threads) in [(least, 1), (4 << 20, 3), (64 << 20, 2)] {
            let settings =
                RenderSettings { ray_memory: Some(ray_memory), threads: Some(threads), ..sorted.clone() };
            let queued = render(&scene, &settings);
            let what = format!("{backend:?}, {ray_memory} bytes, {threads} threads");
            assert!(queued.image.pixels == plain.image.pixels, "{what}: another picture");
            let (before, stats) = (&plain.stats.rays, &queued.stats);
            assert_eq!(
                (before.closest, before.occluded),
                (stats.rays.closest, stats.rays.occluded),
                "{what}"
            );
            assert_eq!(stats.scheduler.name, "sorted");
            let peak = stats.scheduler.ray_memory_peak;
            assert!(peak > 0 && peak <= ray_memory, "{what}: {peak}");
        }
    }
}

#[test]
fn voxels_give_the_picture_of_waves_at_every_budget_and_grid() {
    for (kind, threads) in [(Kind::City, 3), (Kind::Forest, 1), (Kind::Terrain, 2)] {
        let folder = tempfile::tempdir().expect("a folder");
        let scene = make(kind, 60_000, folder.path());
        let whole = RenderSettings { schedule: Schedule::Depth, ..settings(folder.path()) };
        let plain = render(&scene, &whole);
        let base = RenderSettings {
            schedule: Schedule::Voxel,
            page_bytes: Some(4 << 10),
            threads: Some(threads),
            ..settings(folder.path())
        };
        let least = least(&scene, &base);
        let rays = least_for_rays(&scene, &RenderSettings { geometry_memory: Some(1 << 30), ..base.clone() });
        for (budget, voxels, ray_memory) in [
            (least, Some(1), 32 << 20),
            (least, None, rays),
            (least + 300_000, Some(5000), 2 << 20),
            (least + 2_000_000, Some(30), 1 << 20),
        ] {
            let settings = RenderSettings {
                geometry_memory: Some(budget),
                voxels,
                ray_memory: Some(ray_memory),
                ..base.clone()
            };
            let queued = render(&scene, &settings);
            let what = format!("{kind}, {budget} bytes, {voxels:?} voxels, {ray_memory} for rays");
            assert!(queued.image.pixels == plain.image.pixels, "{what}: another picture");
            let stats = &queued.stats;
            let (scheduler, cache) = (
                &stats.scheduler,
                stats.geometry_cache.as_ref().unwrap_or_else(|| panic!("{what}: nothing was paged")),
            );
            assert!(cache.peak <= budget, "{what}: {}", cache.peak);
            assert!(scheduler.ray_memory_peak <= ray_memory, "{what}: {}", scheduler.ray_memory_peak);
            assert_eq!(scheduler.name, "voxel", "{what}");
            assert!(scheduler.voxels > 0 && scheduler.voxel_visits > 0, "{what}: {scheduler:?}");
            let seen: u64 = scheduler.by_voxel.iter().map(|v| v.rays).sum();
            let visits: u64 = scheduler.by_voxel.iter().map(|v| v.visits).sum();
            assert_eq!((seen, visits), (scheduler.rays_queued, scheduler.voxel_visits), "{what}");
            assert_eq!(plain.stats.rays.closest, stats.rays.closest, "{what}");
        }
    }
}

#[test]
fn what_is_chosen_is_said_with_its_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::Terrain, 30_000, folder.path());
    let choice = |geometry_memory, schedule| {
        let settings = RenderSettings {
            geometry_memory,
            schedule,
            page_bytes: Some(4 << 10),
            ..settings(folder.path())
        };
        let scheduler = render(&scene, &settings).stats.scheduler;
        (scheduler.name, scheduler.because)
    };
    let base = RenderSettings { page_bytes: Some(4 << 10), ..settings(folder.path()) };
    assert_eq!(choice(None, Schedule::Auto).0, "depth");
    assert_eq!(choice(Some(1 << 30), Schedule::Auto).0, "depth");
    assert_eq!(choice(Some(least(&scene, &base)), Schedule::Auto).0, "voxel");
    let (name, because) = choice(None, Schedule::Voxel);
    assert!(name == "sorted" && because.contains("stays in memory"), "{name}: {because}");
    assert_eq!(choice(None, Schedule::Depth), ("depth".into(), "asked for".into()));
}

/// Light is followed through interfaces and media while paths are shaded: that reads pages too, and must not wait for
/// anybody who waits for it.
#[test]
fn interfaces_before_pages_neither_change_the_picture_nor_stop_it() {
    let folder = tempfile::tempdir().expect("a folder");
    make(Kind::City, 60_000, folder.path());
    let path = folder.path().join("scene/scene.pbrt");
    let haze = "MakeNamedMedium \"haze\" \"string type\" \"homogeneous\" \"rgb sigma_a\" [ .02 .01 .03 ] \"rgb sigma_s\" [ 0 0 0 ]\n\
                AttributeBegin\nMediumInterface \"haze\" \"\"\nMaterial \"interface\"\nTranslate -10 20 45\n\
                Shape \"sphere\" \"float radius\" 25\nAttributeEnd\n\
                AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ 50 40 30 ]\nTranslate -5 0 60\n\
                Shape \"sphere\" \"float radius\" 3\nAttributeEnd\n";
    let text = fs::read_to_string(&path).expect("just made") + haze;
    fs::write(&path, text).expect("writable");
    let scene = weir::scene::load(&path).expect("a scene");
    let whole = RenderSettings { schedule: Schedule::Depth, spp: Some(17), ..settings(folder.path()) };
    let plain = render(&scene, &whole);
    let base = RenderSettings { page_bytes: Some(4 << 10), threads: Some(4), ..whole.clone() };
    let (said, heard) = mpsc::channel();
    let scene = Arc::new(scene);
    for schedule in [Schedule::Sorted, Schedule::Voxel] {
        let base = RenderSettings { schedule, ..base.clone() };
        let budget = least(&scene, &base);
        let rays = least_for_rays(&scene, &RenderSettings { geometry_memory: Some(budget), ..base.clone() });
        for ray_memory in [rays, 8 << 20] {
            let settings = RenderSettings {
                geometry_memory: Some(budget),
                ray_memory: Some(ray_memory),
                ..base.clone()
            };
            let (scene, said) = (Arc::clone(&scene), said.clone());
            // Not joined: one that never ends would hold up the test that finds it.
            thread::spawn(move || {
                let _ = said.send(render(&scene, &settings));
            });
            let queued = heard.recv_timeout(Duration::from_secs(200));
            let queued = queued.unwrap_or_else(|e| panic!("{schedule:?}, {ray_memory} bytes: {e}"));
            assert!(queued.image.pixels == plain.image.pixels, "{schedule:?}, {ray_memory}: another picture");
            let stats = &queued.stats;
            assert!(stats.scheduler.ray_memory_peak <= ray_memory, "{schedule:?}: {:?}", stats.scheduler);
            assert!(stats.geometry_cache.as_ref().is_some_and(|c| c.total.counts.misses_capacity > 0));
        }
    }
}

#[test]
fn many_threads_need_more_memory_for_rays_and_say_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = everything(folder.path());
    let few = RenderSettings { schedule: Schedule::Sorted, threads: Some(1), ..RenderSettings::default() };
    let many = RenderSettings { threads: Some(64), ..few.clone() };
    let (least_of_few, least) = (least_for_rays(&scene, &few), least_for_rays(&scene, &many));
    assert!(least > 2 * least_of_few, "{least} for 64 threads, {least_of_few} for one");
    let peak =
        render(&scene, &RenderSettings { ray_memory: Some(least), ..many }).stats.scheduler.ray_memory_peak;
    assert!(peak <= least, "{peak} of {least}");
}

/// Asked to stop, it stops within moments, whatever waits.
#[test]
fn a_limit_on_time_is_kept() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::City, 60_000, folder.path());
    let base = RenderSettings {
        page_bytes: Some(4 << 10),
        spp: Some(100_000),
        time_limit_seconds: Some(0.5),
        ..settings(folder.path())
    };
    for schedule in [Schedule::Sorted, Schedule::Voxel, Schedule::Auto] {
        let settings = RenderSettings { schedule, ..base.clone() };
        let settings = RenderSettings { geometry_memory: Some(least(&scene, &settings)), ..settings };
        let stats = render(&scene, &settings).stats;
        assert!(stats.interrupted, "{schedule:?}");
        // Far more than it takes on a busy machine; all samples would take hours.
        assert!(stats.time.render_s < 30.0, "{schedule:?}: {} s", stats.time.render_s);
        assert!(schedule != Schedule::Auto || stats.scheduler.name == "depth");
    }
}
