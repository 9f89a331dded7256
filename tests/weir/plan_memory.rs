//! One budget for everything: the picture is the same at every one, what is counted never exceeds it, what the system
//! counts hardly, and what is too small is refused with what would do.
//!
//! Invariant: everything is made on the spot, in a directory of the test's own.

use crate::pages::{make, would_do};
use crate::support::{image, outcome};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use weir::error::Error;
use weir::film::Image;
use weir::film::write::write_image;
use weir::render::plan;
use weir::scene::pbrt::parse_str;
use weir::scene::{self, SceneDescription};
use weir::settings::{Backend, RenderSettings, Schedule};
use weir::stats::RenderStats;
use weir::study::generate::{Kind, Recipe, TextureFormat, generate};

/// Beyond `--memory` and a twentieth of it, what a process may hold: README names the same.
const CONSTANT: u64 = 48 << 20;
/// The same where the system counts address space of data, stacks of threads among it.
const DATA_CONSTANT: u64 = 96 << 20;

fn settings(at: &Path) -> RenderSettings {
    RenderSettings {
        spp: Some(2),
        max_depth: Some(3),
        cache_dir: Some(at.join("cache")),
        threads: Some(1),
        ..RenderSettings::default()
    }
}

/// A city of 120,000 triangles and so many bytes of texture.
fn city(at: &Path, texture_bytes: u64) -> SceneDescription {
    let recipe = Recipe {
        kind: Kind::City,
        triangles: 120_000,
        texture_bytes,
        seed: 1,
        size: (64, 36),
        format: TextureFormat::Png,
        directory: at.join("scene"),
    };
    generate(&recipe, &|_, _| {}).unwrap_or_else(|e| panic!("{e}"));
    scene::load(&at.join("scene/scene.pbrt")).unwrap_or_else(|e| panic!("{e}"))
}

#[track_caller]
fn assert_within(stats: &RenderStats, memory: u64) {
    let counted = &stats.memory;
    assert_eq!(counted.budget, Some(memory));
    assert!(counted.peak_accounted <= memory, "{counted:?} {:?}", stats.plan);
    let allowed = &stats.plan.memory;
    let of_geometry = allowed.geometry.expect("a bound");
    if counted.moves.is_empty() {
        assert_eq!(counted.accounted.sum(), counted.peak_accounted);
        assert!(counted.accounted.geometry <= of_geometry, "{counted:?} {allowed:?}");
        assert!(counted.accounted.textures <= allowed.textures, "{counted:?} {allowed:?}");
    } else {
        assert!(allowed.balanced, "{allowed:?}");
        // What one gives is nobody's before the other has it.
        let apart = counted.accounted.sum() - counted.peak_accounted;
        let both = counted.accounted.geometry + counted.accounted.textures - apart;
        assert!(both <= of_geometry + allowed.textures, "{counted:?} {allowed:?}");
        let together = |i: usize| counted.moves[i].textures + counted.moves[i].pages;
        assert!((1..counted.moves.len()).all(|i| together(i) <= together(0)), "{counted:?}");
    }
    assert!(counted.accounted.rays <= allowed.rays, "{counted:?} {allowed:?}");
    assert!(counted.accounted.lights <= stats.plan.bytes.lights, "{counted:?}");
}

#[test]
fn the_picture_is_the_same_at_every_memory_and_what_is_counted_stays_within() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = city(folder.path(), 20_000_000);
    let base = RenderSettings { backend: Backend::Native, ..settings(folder.path()) };
    let plain = image(&scene, &base);
    let one = RenderSettings { memory: Some(1), ..base.clone() };
    let least = would_do(&scene, &one, "--memory");
    assert!(least > 5_000_000 && least < 40_000_000, "{least}");
    let mut stores = Vec::new();
    for memory in [least, least + 2_000_000, 2 * least, 3 * least, 8 * least, 1 << 30] {
        for schedule in [Schedule::Auto, Schedule::Depth, Schedule::Voxel] {
            let settings = RenderSettings { memory: Some(memory), schedule, ..base.clone() };
            let result = match outcome(&scene, &settings) {
                // Rays that wait beside geometry that stays take more than the least for all.
                Err(Error::Usage(_)) if schedule == Schedule::Voxel => continue,
                result => result.unwrap_or_else(|e| panic!("{memory} {schedule:?}: {e}")),
            };
            assert_eq!(result.image.pixels, plain.pixels, "{memory} {schedule:?}");
            let stats = result.stats;
            assert_within(&stats, memory);
            assert_eq!(stats.plan, plan(&scene, &settings).unwrap_or_else(|e| panic!("{e}")));
            assert_eq!(stats.plan.schedule, stats.scheduler.name);
            let allowed = stats.plan.memory;
            stores.push((allowed.geometry_store, allowed.texture_store));
            let tiled = stats.texture_cache.is_some();
            assert_eq!((stats.geometry_cache.is_some(), tiled), {
                let (geometry, textures) = stores.last().expect("one was pushed");
                (geometry == "pages", textures == "tiles")
            });
        }
    }
    for (geometry, textures) in [("pages", "tiles"), ("resident", "whole")] {
        let has = stores.iter().any(|(g, t)| (&**g, &**t) == (geometry, textures));
        assert!(has, "{geometry} {textures}: {stores:?}");
    }
}

/// Textures begin with an eighth; this scene is nearly all texture, seen from near.
#[test]
fn textures_get_what_geometry_does_not_need() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = city(folder.path(), 60_000_000);
    let base = RenderSettings {
        backend: Backend::Native,
        spp: Some(64),
        size: Some((128, 72)),
        texture_latency_seconds: 0.0005,
        ..settings(folder.path())
    };
    let plain = image(&scene, &RenderSettings { texture_latency_seconds: 0.0, ..base.clone() });
    let memory = would_do(&scene, &RenderSettings { memory: Some(1), ..base.clone() }, "--memory");
    let settings = RenderSettings { memory: Some(memory + 4_000_000), ..base };
    let result = outcome(&scene, &settings).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(result.image.pixels, plain.pixels);
    assert_within(&result.stats, memory + 4_000_000);
    let moves = &result.stats.memory.moves;
    println!("{moves:#?}");
    let allowed = &result.stats.plan.memory;
    let most = moves.iter().map(|m| m.textures).max();
    assert!(most > Some(allowed.textures), "{moves:?} {:?}", result.stats.texture_cache);
}

#[test]
fn parts_that_are_given_are_kept() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = city(folder.path(), 20_000_000);
    let settings = RenderSettings {
        backend: Backend::Native,
        memory: Some(64 << 20),
        texture_memory: Some(3 << 20),
        geometry_memory: Some(8 << 20),
        ray_memory: Some(9 << 20),
        schedule: Schedule::Voxel,
        ..settings(folder.path())
    };
    let stats = outcome(&scene, &settings).unwrap_or_else(|e| panic!("{e}")).stats;
    assert_within(&stats, 64 << 20);
    let allowed = &stats.plan.memory;
    assert_eq!((allowed.geometry, allowed.textures, allowed.rays), (Some(8 << 20), 3 << 20, 9 << 20));
    assert_eq!(stats.scheduler.ray_memory, 9 << 20);
}

#[test]
fn embree_gives_way_unless_it_was_asked_for_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::Terrain, 120_000, folder.path());
    let base = RenderSettings { backend: Backend::Embree, ..settings(folder.path()) };
    let tight = RenderSettings { memory: Some(11_000_000), ..base.clone() };
    let result = outcome(&scene, &tight).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(
        (result.stats.settings.backend.as_str(), result.stats.plan.backend.as_str()),
        ("native", "native")
    );
    assert!(
        result.notes.iter().any(|line| line.contains("embree") && line.contains("native")),
        "{:?}",
        result.notes
    );
    assert_within(&result.stats, 11_000_000);
    let named = RenderSettings { backend_named: true, ..tight };
    let enough = would_do(&scene, &named, "--memory");
    let stats = outcome(&scene, &RenderSettings { memory: Some(enough), ..named.clone() })
        .unwrap_or_else(|e| panic!("{e}"))
        .stats;
    assert!(stats.settings.backend.starts_with("embree"), "{}", stats.settings.backend);
    assert_within(&stats, enough);
    let Err(e) = outcome(&scene, &RenderSettings { memory: Some(enough - 1), ..named }) else {
        panic!("{enough} was not the least")
    };
    assert!(e.exit_code() == 2 && e.to_string().contains("--backend native"), "{e}");
}

/// Quadrilaterals as text count as one triangle each, and are two: what was planned for half of them is planned again.
#[test]
fn a_wrong_guess_is_made_good() {
    let folder = tempfile::tempdir().expect("a folder");
    let n = 200u32;
    let mut ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\n\
         property list uchar int vertex_indices\nend_header\n",
        (n + 1) * (n + 1),
        n * n
    );
    for i in 0..(n + 1) * (n + 1) {
        let (x, y) = (f64::from(i % (n + 1)) / f64::from(n), f64::from(i / (n + 1)) / f64::from(n));
        ply += &format!("{x} {y} {}\n", (20.0 * x * y).sin() * 0.1);
    }
    for i in 0..n * n {
        let a = i / n * (n + 1) + i % n;
        ply += &format!("4 {a} {} {} {}\n", a + 1, a + n + 2, a + n + 1);
    }
    fs::write(folder.path().join("quads.ply"), ply).expect("written");
    let text = "LookAt 0.5 0.5 -2  0.5 0.5 0  0 1 0\nCamera \"perspective\"\n\
                Film \"rgb\" \"integer xresolution\" 32 \"integer yresolution\" 32\nWorldBegin\n\
                LightSource \"infinite\"\nShape \"plymesh\" \"string filename\" \"quads.ply\"\n";
    let scene = crate::support::scene_beside(text, folder.path());
    let base = RenderSettings { backend: Backend::Native, ..settings(folder.path()) };
    let plain = image(&scene, &base);
    for memory in [9_000_000, 11_000_000, 13_000_000, 64_000_000] {
        let settings = RenderSettings { memory: Some(memory), ..base.clone() };
        let result = match outcome(&scene, &settings) {
            Err(e @ Error::Usage(_)) if memory < 64_000_000 => {
                assert!(e.to_string().contains("--memory "), "{e}");
                continue;
            }
            result => result.unwrap_or_else(|e| panic!("{memory}: {e}")),
        };
        assert_eq!(result.image.pixels, plain.pixels, "{memory}");
        let stats = result.stats;
        assert!(stats.memory.peak_accounted <= memory, "{memory}: {:?}", stats.memory);
        assert_eq!(stats.plan.schedule, stats.scheduler.name);
        assert_eq!(stats.plan.memory.geometry_store == "pages", stats.geometry_cache.is_some());
    }
}

/// Runs `weir LINE` in `at` with so many bytes of data.
fn limited(at: &Path, data_bytes: u64, line: &str) -> Output {
    let run = format!("ulimit -d {}; exec {} {line}", data_bytes / 1024, env!("CARGO_BIN_EXE_weir"));
    Command::new("sh").current_dir(at).args(["-c", &run]).output().expect("a shell")
}

#[cfg(target_os = "linux")]
#[test]
fn a_process_takes_no_more_than_it_was_given_and_a_constant() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let recipe = Recipe {
        kind: Kind::City,
        triangles: 1_500_000,
        texture_bytes: 60_000_000,
        seed: 1,
        size: (320, 180),
        format: TextureFormat::Png,
        directory: at.join("scene"),
    };
    generate(&recipe, &|_, _| {}).unwrap_or_else(|e| panic!("{e}"));
    // Were everything resident it would take 250 MB.
    for memory in [60u64 << 20, 120 << 20] {
        let line = format!(
            "scene/scene.pbrt --memory {memory} --threads 2 --spp 2 --cache-dir cache --stats s.json -o x.exr -q"
        );
        let output = limited(at, memory + memory / 20 + DATA_CONSTANT, &line);
        assert!(output.status.success(), "{memory}: {output:?}");
        let text = fs::read_to_string(at.join("s.json")).expect("written");
        let stats: RenderStats = serde_json::from_str(&text).expect("statistics");
        assert_within(&stats, memory);
        assert_eq!(stats.plan.memory.geometry_store, "pages");
        let peak = stats.memory.peak_rss.expect("Linux tells");
        assert!(peak <= memory + memory / 20 + CONSTANT, "{memory}: {peak} resident");
    }
    // The limit bites: without a bound the same render does not live in it.
    let all = "scene/scene.pbrt --backend native --threads 2 --spp 2 --cache-dir cache -o x.exr -q";
    assert!(!limited(at, (30 << 20) + DATA_CONSTANT, all).status.success());
}

#[test]
fn a_memory_that_is_too_small_is_one_line_before_anything_is_loaded() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    make(Kind::Terrain, 30_000, at);
    for line in ["plan scene/scene.pbrt --memory 1K", "render scene/scene.pbrt --memory 1K -o x.exr"] {
        let output = limited(at, 1 << 40, line);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{line}: {said}");
        assert!(said.lines().count() == 1 && said.contains("would do"), "{line}: {said}");
        assert!(!at.join("x.exr").exists());
    }
}

#[test]
fn parts_that_are_too_small_are_refused_by_the_plan_in_the_same_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = city(folder.path(), 200_000);
    let base = RenderSettings { backend: Backend::Native, ..settings(folder.path()) };
    let rays = RenderSettings { schedule: Schedule::Voxel, ray_memory: Some(1000), ..base.clone() };
    let pages = RenderSettings { geometry_memory: Some(1000), ..base.clone() };
    for (name, few) in [("--ray-memory", rays), ("--geometry-memory", pages)] {
        let planned = plan(&scene, &few).err().unwrap_or_else(|| panic!("{name}: planned"));
        let rendered = outcome(&scene, &few).err().unwrap_or_else(|| panic!("{name}: rendered"));
        assert_eq!(planned.to_string(), rendered.to_string());
        assert!(planned.to_string().contains(name) && planned.exit_code() == 2, "{planned}");
    }
    // A tiled file tells how large its tiles are; of a plain one that is not known before its copy is made.
    let tiled = folder.path().join("tiled");
    fs::create_dir(&tiled).expect("writable");
    let png = folder.path().join("plain.png");
    let mut image = Image::new(200, 200);
    image.pixels.iter_mut().zip(0u8..=255).for_each(|(p, i)| *p = [f32::from(i) / 255.0; 3]);
    write_image(&png, &image, &[]).expect("writable");
    let made = Command::new(env!("CARGO_BIN_EXE_weir"))
        .args(["texture", "-q", "-o"])
        .args([tiled.join("t.tx"), png])
        .output()
        .expect("weir starts");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let scene = parse_str(
        "WorldBegin\nLightSource \"infinite\"\nTexture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"t.tx\"\n\
         Material \"diffuse\" \"texture reflectance\" \"t\"\nShape \"sphere\"\n",
        &tiled.join("s.pbrt"),
    )
    .expect("a scene");
    let few = RenderSettings { texture_memory: Some(1000), ..base };
    let planned = plan(&scene, &few).expect_err("too small").to_string();
    assert_eq!(planned, outcome(&scene, &few).err().expect("too small").to_string());
    assert!(planned.contains("--texture-memory"), "{planned}");
}

#[test]
fn a_mode_of_embree_that_the_native_hierarchy_has_not_is_said() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = city(folder.path(), 200_000);
    for (backend, robust, said) in
        [(Backend::Native, true, 1), (Backend::Native, false, 0), (Backend::Embree, true, 0)]
    {
        let settings = RenderSettings { backend, robust, ..settings(folder.path()) };
        let outcome = outcome(&scene, &settings).unwrap_or_else(|e| panic!("{e}"));
        let lines = outcome.notes.iter().filter(|line| line.starts_with("--robust is a mode of Embree"));
        assert_eq!(lines.count(), said, "{:?}", outcome.notes);
        assert_eq!(outcome.stats.settings.robust, robust && said == 0, "what was in force");
    }
}
