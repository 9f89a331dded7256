//! Geometry that does not fit: the picture is the same to the bit however few bytes it gets and however large its
//! pages are; what is damaged or out of date is noticed.
//!
//! Invariant: everything is made on the spot, in a directory of the test's own.

use crate::support::{outcome, render};
use std::fs;
use std::path::Path;
use std::process::Command;
use weir::error::Error;
use weir::scene::{self, SceneDescription};
use weir::settings::{Backend, RenderSettings, Schedule};
use weir::stats::RenderStats;
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

/// How much of `option` a refusal says would do.
pub(crate) fn would_do(scene: &SceneDescription, settings: &RenderSettings, option: &str) -> u64 {
    let Err(Error::Usage(line)) = outcome(scene, settings) else { panic!("{option} is enough") };
    let after = line.split(&format!("{option} ")).nth(1).unwrap_or_else(|| panic!("{line}"));
    after.split(' ').next().and_then(|n| n.parse().ok()).unwrap_or_else(|| panic!("{line}"))
}

/// What a refusal of `budget` asks for.
fn asked_for(scene: &SceneDescription, settings: &RenderSettings, budget: u64) -> u64 {
    let settings = RenderSettings { geometry_memory: Some(budget), ..settings.clone() };
    would_do(scene, &settings, "--geometry-memory")
}

/// The least that does: what pages need is said at once, the rest when they have been made.
pub(crate) fn least(scene: &SceneDescription, settings: &RenderSettings) -> u64 {
    asked_for(scene, settings, asked_for(scene, settings, 1))
}

/// The least memory for rays that does, as the refusal says it.
pub(crate) fn least_for_rays(scene: &SceneDescription, settings: &RenderSettings) -> u64 {
    let settings = RenderSettings { ray_memory: Some(1), ..settings.clone() };
    would_do(scene, &settings, "--ray-memory")
}

#[test]
fn a_budget_that_is_too_small_for_any_page_is_refused_before_one_is_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::Terrain, 50_000, folder.path());
    let settings = RenderSettings { threads: Some(3), ..settings(folder.path()) };
    let asked = asked_for(&scene, &settings, 1);
    assert!(asked > 6 * (64 << 10), "two pages a thread, and not {asked} bytes");
    assert_eq!(asked_for(&scene, &settings, asked - 1), asked);
    assert!(!folder.path().join("cache/pages").exists(), "pages were made in vain");
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
fn as_many_pages_are_looked_at_whatever_is_in_memory() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::City, 60_000, folder.path());
    let settings = RenderSettings {
        page_bytes: Some(4 << 10),
        threads: Some(1),
        schedule: Schedule::Depth,
        ..settings(folder.path())
    };
    let least = least(&scene, &settings);
    let counts = [least, least + (200 << 10), least + (800 << 10)].map(|budget| {
        let settings = RenderSettings { geometry_memory: Some(budget), ..settings.clone() };
        let stats = render(&scene, &settings).stats;
        stats.geometry_cache.unwrap_or_else(|| panic!("{budget}: nothing was paged")).total.counts
    });
    assert!(counts[0].misses() > 2 * counts[2].misses(), "{counts:?}");
    for c in counts {
        assert_eq!(c.lookups, counts[0].lookups, "a look that is a miss counts once");
        assert_eq!(c.lookups, c.micro_hits + c.hits + c.misses());
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

/// Two million triangles, which take 68 MB with the centres of their boxes.
fn large_mesh(path: &Path) {
    let n = 1000u32;
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        (n + 1) * (n + 1),
        2 * n * n
    )
    .into_bytes();
    for at in 0..(n + 1) * (n + 1) {
        let (x, y) = ((at % (n + 1)) as f32 / n as f32, (at / (n + 1)) as f32 / n as f32);
        let z = 0.1 * (17.0 * x).sin() * (23.0 * y).cos();
        [x, y, z].iter().for_each(|c| bytes.extend_from_slice(&c.to_le_bytes()));
    }
    for at in (0..n * (n + 1)).filter(|at| at % (n + 1) < n) {
        for triangle in [[at, at + 1, at + n + 2], [at, at + n + 2, at + n + 1]] {
            bytes.push(3);
            triangle.iter().for_each(|c| bytes.extend_from_slice(&c.to_le_bytes()));
        }
    }
    fs::write(path, bytes).expect("writable");
}

#[test]
fn a_mesh_is_cut_in_bounded_memory() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    large_mesh(&at.join("large.ply"));
    let text = "LookAt 0.5 -1 1  0.5 0.5 0  0 0 1\nCamera \"perspective\"\n\
                Film \"rgb\" \"integer xresolution\" 32 \"integer yresolution\" 32\n\
                Integrator \"path\" \"integer maxdepth\" 1\nWorldBegin\nLightSource \"infinite\"\n\
                Shape \"plymesh\" \"string filename\" \"large.ply\"\n";
    fs::write(at.join("scene.pbrt"), text).expect("writable");
    // A mesh that has just changed is cut each time.
    std::thread::sleep(std::time::Duration::from_millis(3500));
    let peak = || {
        let output = Command::new(env!("CARGO_BIN_EXE_weir"))
            .current_dir(at)
            .args(["scene.pbrt", "--spp", "1", "--threads", "2", "--geometry-memory", "8M", "--quiet"])
            .args(["--cache-dir", "cache", "-o", "image.pfm", "--stats", "stats.json"])
            .output()
            .expect("weir starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let stats = fs::read(at.join("stats.json")).expect("it has been asked for");
        let stats: RenderStats = serde_json::from_slice(&stats).expect("its own statistics");
        let cache = stats.geometry_cache.expect("it is too large to stay");
        let image = fs::read(at.join("image.pfm")).expect("it has been asked for");
        (stats.memory.peak_rss.expect("Linux tells"), cache.making_bytes, image)
    };
    let (cutting, lent, first) = peak();
    let (using, lent_again, second) = peak();
    assert_eq!((lent, lent_again), (32 << 20, 0));
    assert!(first == second, "another picture");
    // 32 MB are lent, whatever the budget; buffers, pages in the making and what an allocator keeps are beside that.
    let more = cutting.saturating_sub(using);
    assert!(more <= 48 << 20, "{more} bytes more to cut it than to use it, {using}");
    assert!(more >= 8 << 20, "nothing was cut: {cutting} and {using} bytes");
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
