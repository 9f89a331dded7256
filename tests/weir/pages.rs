//! Geometry that does not fit: the picture is the same to the bit however few bytes it gets and however large its
//! pages are; what is damaged or out of date is noticed.
//!
//! Invariant: everything is made on the spot, in a directory of the test's own.

use crate::support::outcome;
use std::fs;
use std::path::Path;
use weir::error::Error;
use weir::render::Outcome;
use weir::scene::{self, SceneDescription};
use weir::settings::{Backend, RenderSettings};
use weir::study::generate::{Kind, Recipe, TextureFormat, generate};

pub(crate) fn make(kind: Kind, triangles: u64, at: &Path) -> SceneDescription {
    let recipe = Recipe {
        kind,
        triangles,
        texture_bytes: 200_000,
        seed: 1,
        size: (64, 36),
        format: TextureFormat::Png,
        directory: at.join("scene"),
    };
    generate(&recipe, &|_, _| {}).unwrap_or_else(|e| panic!("{kind}: {e}"));
    scene::load(&at.join("scene/scene.pbrt")).unwrap_or_else(|e| panic!("{kind}: {e}"))
}

pub(crate) fn settings(at: &Path) -> RenderSettings {
    RenderSettings {
        spp: Some(2),
        max_depth: Some(3),
        backend: Backend::Native,
        cache_dir: Some(at.join("cache")),
        ..RenderSettings::default()
    }
}

fn render(scene: &SceneDescription, settings: &RenderSettings) -> Outcome {
    outcome(scene, settings).unwrap_or_else(|e| panic!("{e}"))
}

/// The least that does, as the refusal says it.
pub(crate) fn least(scene: &SceneDescription, settings: &RenderSettings) -> u64 {
    let settings = RenderSettings { geometry_memory: Some(1), ..settings.clone() };
    let Err(Error::Usage(line)) = outcome(scene, &settings) else { panic!("one byte is enough") };
    let after = line.split("--geometry-memory ").nth(1).unwrap_or_else(|| panic!("{line}"));
    after.split(' ').next().and_then(|n| n.parse().ok()).unwrap_or_else(|| panic!("{line}"))
}

#[test]
fn the_picture_is_the_same_at_every_budget_and_page_size() {
    let cases = [(Kind::City, 4 << 10, 3), (Kind::Forest, 64 << 10, 1), (Kind::Terrain, 128 << 10, 2)];
    for (kind, page_bytes, threads) in cases {
        let folder = tempfile::tempdir().expect("a folder");
        let scene = make(kind, 60_000, folder.path());
        let plain = render(&scene, &settings(folder.path()));
        assert!(plain.stats.geometry_cache.is_none());
        let settings = RenderSettings {
            page_bytes: Some(page_bytes),
            threads: Some(threads),
            ..settings(folder.path())
        };
        let least = least(&scene, &settings);
        for budget in [least, least + (300 << 10)] {
            let settings = RenderSettings { geometry_memory: Some(budget), ..settings.clone() };
            let paged = render(&scene, &settings);
            let what = format!("{kind}, {page_bytes} bytes a page, budget {budget}");
            assert!(paged.unreadable.is_empty(), "{what}: {:?}", paged.unreadable);
            let cache = paged.stats.geometry_cache.unwrap_or_else(|| panic!("{what}: nothing was paged"));
            assert!(cache.peak <= budget, "{what}: {}", cache.peak);
            assert!(cache.total.counts.lookups > 1000, "{what}: {cache:?}");
            assert!(budget > least || cache.total.counts.misses_capacity > 0, "{what}: all fits");
            assert!(paged.image.pixels == plain.image.pixels, "{what}: another picture");
            assert!(!paged.stats.miss_ratio.geometry.is_empty(), "{what}: no curve");
        }
    }
    // One scene at other page sizes.
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::Terrain, 30_000, folder.path());
    let plain = render(&scene, &settings(folder.path()));
    for page_bytes in [4 << 10, 20_000, 64 << 10] {
        let settings =
            RenderSettings { page_bytes: Some(page_bytes), threads: Some(2), ..settings(folder.path()) };
        let budget = least(&scene, &settings);
        let paged = render(&scene, &RenderSettings { geometry_memory: Some(budget), ..settings });
        assert!(paged.image.pixels == plain.image.pixels, "{page_bytes} bytes a page: another picture");
    }
}

#[test]
fn a_budget_for_everything_keeps_everything() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::Terrain, 50_000, folder.path());
    let settings = RenderSettings { geometry_memory: Some(1 << 30), ..settings(folder.path()) };
    let outcome = render(&scene, &settings);
    assert!(outcome.stats.geometry_cache.is_none(), "nothing needs to come and go");
    assert!(!folder.path().join("cache/pages").exists(), "nothing is written");
}

#[test]
fn embree_says_that_it_cannot_page() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::Terrain, 50_000, folder.path());
    let settings = RenderSettings {
        geometry_memory: Some(2 << 20),
        backend: Backend::Embree,
        ..settings(folder.path())
    };
    let Err(error) = outcome(&scene, &settings) else { panic!("Embree has paged") };
    assert!(error.to_string().contains("--backend native"), "{error}");
}

#[test]
fn damaged_and_outdated_pages_are_noticed() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let scene = make(Kind::Terrain, 60_000, at);
    // Of a file that has just changed pages are made anew each time.
    std::thread::sleep(std::time::Duration::from_millis(3500));
    let plain = render(&scene, &settings(at));
    let paging = RenderSettings { page_bytes: Some(64 << 10), threads: Some(1), ..settings(at) };
    let budget = least(&scene, &paging) + (1 << 20);
    let paging = RenderSettings { geometry_memory: Some(budget), ..paging };
    let pages = || -> Vec<_> {
        let list = fs::read_dir(at.join("cache/pages")).expect("made by `least`");
        list.map(|e| e.expect("an entry").path()).collect()
    };
    let first = pages();
    assert!(!first.is_empty());
    // A head that is wrong, a file that is cut short, no file: made again without a word.
    for damage in 0..3 {
        for page in &pages() {
            let mut bytes = fs::read(page).expect("readable");
            match damage {
                0 => bytes[20] ^= 1,
                1 => bytes.truncate(bytes.len() / 2),
                _ => bytes.clear(),
            }
            fs::write(page, bytes).expect("writable");
        }
        let again = render(&scene, &paging);
        assert!(again.unreadable.is_empty(), "damage {damage}: {:?}", again.unreadable);
        assert!(again.image.pixels == plain.image.pixels, "damage {damage}");
    }
    // Pages that are wrong inside: found when they are read, said in one line, and made again the next time.
    for page in &pages() {
        let mut bytes = fs::read(page).expect("readable");
        let count = bytes.len();
        for at in (count / 2..count).step_by(4096) {
            bytes[at + 100] ^= 1;
        }
        fs::write(page, bytes).expect("writable");
    }
    let holes = render(&scene, &paging);
    assert!(!holes.unreadable.is_empty(), "damaged pages went unnoticed");
    assert!(holes.unreadable.iter().all(|line| !line.contains("magenta")), "{:?}", holes.unreadable);
    assert!(holes.unreadable.iter().all(|line| line.contains("render again")), "{:?}", holes.unreadable);
    let again = render(&scene, &paging);
    assert!(again.unreadable.is_empty(), "{:?}", again.unreadable);
    assert!(again.image.pixels == plain.image.pixels);
    // Another mesh under the same name.
    let meshes = fs::read_dir(at.join("scene/meshes")).expect("meshes");
    let largest =
        meshes.map(|e| e.expect("an entry").path()).max_by_key(|p| fs::metadata(p).map_or(0, |m| m.len()));
    let mesh = largest.expect("a mesh");
    let mut bytes = fs::read(&mesh).expect("readable");
    let body = bytes.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    bytes[body] ^= 1;
    fs::write(&mesh, bytes).expect("writable");
    let before = pages().len();
    let changed = render(&scene, &settings(at));
    let paged = render(&scene, &paging);
    assert!(paged.image.pixels == changed.image.pixels, "pages of the mesh as it was");
    assert!(pages().len() > before, "new pages were made");
}
