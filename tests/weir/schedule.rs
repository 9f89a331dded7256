//! Rays that wait: whatever runs next, in however little memory, on however many threads, the picture is the same to
//! the bit.
//!
//! Invariant: everything is made on the spot, in a directory of the test's own.

use crate::determinism::everything;
use crate::pages::{least, make, settings};
use crate::support::outcome;
use weir::error::Error;
use weir::render::Outcome;
use weir::scene::SceneDescription;
use weir::settings::{Backend, RenderSettings, Schedule};
use weir::study::generate::Kind;

fn render(scene: &SceneDescription, settings: &RenderSettings) -> Outcome {
    outcome(scene, settings).unwrap_or_else(|e| panic!("{e}"))
}

/// The least that does, as the refusal says it.
fn least_for_rays(scene: &SceneDescription, settings: &RenderSettings) -> u64 {
    let settings = RenderSettings { ray_memory: Some(1), ..settings.clone() };
    let Err(Error::Usage(line)) = outcome(scene, &settings) else { panic!("one byte is enough") };
    let after = line.split("--ray-memory ").nth(1).unwrap_or_else(|| panic!("{line}"));
    after.split(' ').next().and_then(|n| n.parse().ok()).unwrap_or_else(|| panic!("{line}"))
}

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
