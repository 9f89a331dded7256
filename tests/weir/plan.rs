//! What `weir plan` says of a scene: the effects that it calls for, what it takes, and how it is rendered; all held
//! against scenes that ask for one effect each, and against renders.
//!
//! Invariant: everything is made on the spot, in a directory of the test's own.

use crate::pages::{make, settings};
use crate::support::outcome;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use weir::render::plan;
use weir::scene::{SceneDescription, pbrt::parse_str};
use weir::settings::{Backend, RenderSettings, Schedule};
use weir::stats::{PlanStats, RenderStats};
use weir::study::generate::Kind;

fn planned(scene: &SceneDescription, settings: &RenderSettings) -> PlanStats {
    let settings = RenderSettings { threads: Some(1), ..settings.clone() };
    plan(scene, &settings).unwrap_or_else(|e| panic!("{e}"))
}

fn stats(scene: &SceneDescription, settings: &RenderSettings) -> RenderStats {
    outcome(scene, settings).unwrap_or_else(|e| panic!("{e}")).stats
}

/// A diffuse sphere under one light, with `camera`, `before` the shape and `beside` it.
fn scene(at: &Path, camera: &str, light: &str, beside: &str, shape: &str) -> SceneDescription {
    let text = format!(
        "Film \"rgb\" \"integer xresolution\" 16 \"integer yresolution\" 16\n{camera}\nWorldBegin\n{light}\n{beside}\n\
         Shape \"sphere\"{shape}\n"
    );
    parse_str(&text, &at.join("scene.pbrt")).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

const SUN: &str = "LightSource \"distant\"";

/// Names of what is on.
fn on(plan: &PlanStats) -> Vec<&str> {
    plan.effects.iter().filter(|(_, e)| e.on).map(|(name, _)| name.as_str()).collect()
}

#[test]
fn each_effect_is_on_where_it_is_asked_for_and_nowhere_else() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    fs::write(at.join("sky.pfm"), [b"PF\n1 1\n-1\n".as_slice(), &[0; 12]].concat()).expect("written");
    let pinhole = "Camera \"perspective\"";
    let glass = "Material \"dielectric\"";
    let medium = "MakeNamedMedium \"fog\" \"string type\" \"homogeneous\" \"rgb sigma_a\" [ 1 1 1 ] \"rgb sigma_s\" [ 0 0 0 ]\n";
    let cases: &[(&[&str], &str, &str, &str, &str)] = &[
        (&[], pinhole, SUN, "", ""),
        (
            &["textures"],
            pinhole,
            SUN,
            "Texture \"t\" \"spectrum\" \"bilerp\" \"rgb v00\" [ 0 0 0 ]\nMaterial \"diffuse\" \"texture reflectance\" \"t\"",
            "",
        ),
        (
            &["ray_differentials", "textures"],
            pinhole,
            SUN,
            "Texture \"t\" \"spectrum\" \"checkerboard\"\nMaterial \"diffuse\" \"texture reflectance\" \"t\"",
            "",
        ),
        // A texture that says the same everywhere is none.
        (
            &[],
            pinhole,
            SUN,
            "Texture \"t\" \"spectrum\" \"constant\" \"rgb value\" [ 1 0 0 ]\nMaterial \"diffuse\" \"texture reflectance\" \"t\"",
            "",
        ),
        (&["alpha_masks"], pinhole, SUN, "", " \"float alpha\" 0.5"),
        (&["transmission"], pinhole, SUN, glass, ""),
        (
            &["rough_lobes", "transmission"],
            pinhole,
            SUN,
            "Material \"dielectric\" \"float roughness\" 0.1",
            "",
        ),
        (&["rough_lobes"], pinhole, SUN, "Material \"conductor\" \"float roughness\" 0.1", ""),
        (&[], pinhole, SUN, "Material \"conductor\"", ""),
        (&["layered_coats"], pinhole, SUN, "Material \"coateddiffuse\"", ""),
        (
            &["media", "transmission"],
            pinhole,
            SUN,
            &format!("{medium}{glass}\nMediumInterface \"fog\" \"\""),
            "",
        ),
        (&["depth_of_field"], "Camera \"perspective\" \"float lensradius\" 0.1", SUN, "", ""),
        (
            &["instances"],
            pinhole,
            SUN,
            "ObjectBegin \"o\"\nShape \"sphere\"\nObjectEnd\nObjectInstance \"o\"",
            "",
        ),
        (&["image_lights"], pinhole, "LightSource \"infinite\" \"string filename\" \"sky.pfm\"", "", ""),
        (&["many_lights"], pinhole, &format!("{SUN}\n{SUN}"), "", ""),
        // A sky of one colour is found, not chosen.
        (&[], pinhole, &format!("{SUN}\nLightSource \"infinite\" \"rgb L\" [ 1 1 1 ]"), "", ""),
        // What is never placed on a visible surface is not asked for.
        (&[], pinhole, SUN, "AttributeBegin\nMaterial \"dielectric\"\nAttributeEnd", ""),
    ];
    for (wanted, camera, light, beside, shape) in cases {
        let scene = scene(at, camera, light, beside, shape);
        let plan = planned(&scene, &RenderSettings::default());
        assert_eq!(on(&plan), *wanted, "{camera} {light} {beside} {shape}: {:#?}", plan.effects);
        assert_eq!(plan.effects.len(), 15);
        // Whoever asks is named by line, wherever the description has it.
        for name in wanted.iter().filter(|n| !matches!(**n, "depth_of_field" | "many_lights")) {
            let because = &plan.effects[*name].because;
            assert!(because.contains("scene.pbrt:"), "{name}: {because}");
        }
        // It renders as it was planned.
        let stats = stats(&scene, &RenderSettings { spp: Some(1), ..RenderSettings::default() });
        assert_eq!(stats.plan.effects, plan.effects);
    }
}

#[test]
fn what_weir_has_not_is_off_and_says_who_asks() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let bumps =
        "Texture \"t\" \"float\" \"checkerboard\"\nMaterial \"diffuse\" \"texture displacement\" \"t\"";
    for (name, line, beside) in [
        ("motion_blur", 5, "ActiveTransform EndTime\nTranslate 1 0 0\nActiveTransform All"),
        ("bump_and_normal_maps", 6, bumps),
        ("bump_and_normal_maps", 5, "Material \"diffuse\" \"string normalmap\" \"n.png\""),
        ("spectral_dispersion", 5, "Material \"dielectric\" \"spectrum eta\" [ 400 1.6 700 1.4 ]"),
    ] {
        let scene = scene(at, "Camera \"perspective\"", SUN, beside, "");
        let plan = planned(&scene, &RenderSettings::default());
        let effect = &plan.effects[name];
        let place = format!("scene.pbrt:{line}");
        assert!(!effect.on && effect.because.contains(&place), "{name}: {effect:?} {:?}", scene.warnings);
        assert!(effect.because.starts_with("Weir has none"), "{}", effect.because);
    }
    let plain = planned(&scene(at, "Camera \"perspective\"", SUN, "", ""), &RenderSettings::default());
    for name in ["motion_blur", "bump_and_normal_maps", "spectral_dispersion"] {
        assert_eq!(plain.effects[name].because, "nothing asks for it, and Weir has none");
    }
    assert_eq!(plain.effects["displacement"].because, "nothing asks for it");
}

/// The share by which an expectation may be off, either way.
const SHARE: f64 = 0.1;

#[track_caller]
fn assert_near(expected: u64, found: u64, what: &str) {
    let off = expected as f64 / found as f64 - 1.0;
    assert!(off.abs() < SHARE, "{what}: {expected} expected, {found} found, off by {:.1} %", off * 100.0);
}

#[test]
fn bytes_are_those_of_a_render() {
    for kind in [Kind::City, Kind::Forest, Kind::Terrain] {
        let folder = tempfile::tempdir().expect("a folder");
        let scene = make(kind, 60_000, folder.path());
        for backend in [Backend::Embree, Backend::Native] {
            let settings = RenderSettings {
                backend,
                spp: Some(1),
                texture_memory: Some(1 << 28),
                ..settings(folder.path())
            };
            let plan = planned(&scene, &settings);
            let stats = stats(&scene, &settings);
            assert_near(plan.bytes.geometry, stats.memory.all_geometry, &format!("{kind} {backend:?}"));
            // 8-bit images all: not a byte of doubt.
            assert_eq!(plan.bytes.textures, stats.memory.all_textures, "{kind}");
            assert!(plan.bytes.textures > 100_000);
            assert_eq!(plan.bytes.film, stats.memory.accounted.film);
            // At most a place in the tree of lights that none takes.
            let lights = stats.memory.accounted.lights;
            assert!((lights..=lights + 1000).contains(&plan.bytes.lights), "{kind}: {lights}");
            assert_eq!(plan, stats.plan, "one plan for both");
        }
    }
}

#[test]
fn all_kinds_of_meshes_are_counted_by_their_headers() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    // 60 × 60 quadrilaterals: a face is two triangles, which only the length of the file says.
    let n = 60u32;
    let mut ply = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        (n + 1) * (n + 1),
        n * n
    )
    .into_bytes();
    for i in 0..(n + 1) * (n + 1) {
        let (x, y) = ((i % (n + 1)) as f32, (i / (n + 1)) as f32);
        [x, y, (x * y).sin()].iter().for_each(|c| ply.extend(c.to_le_bytes()));
    }
    for i in 0..n * n {
        let a = i / n * (n + 1) + i % n;
        ply.push(4);
        [a, a + 1, a + n + 2, a + n + 1].iter().for_each(|c| ply.extend(c.to_le_bytes()));
    }
    fs::write(at.join("quads.ply"), &ply).expect("written");
    let loop_control = crate::support::icosphere(0);
    for (what, shape, primitives) in [
        ("quads", "Shape \"plymesh\" \"string filename\" \"quads.ply\"".to_owned(), 7201),
        ("inline", format!("Shape \"trianglemesh\" {}", crate::support::icosphere(4)), 5121),
        ("loop", format!("Shape \"loopsubdiv\" \"integer levels\" 4 {loop_control}"), 5121),
        (
            "squares",
            format!("Shape \"catmullclark\" \"integer levels\" 5 {}", crate::support::CUBE),
            12 * 1024 + 1,
        ),
        ("spheres", "Shape \"sphere\"\n".repeat(800), 801),
    ] {
        let scene = scene(at, "Camera \"perspective\"", SUN, &shape, "");
        let settings = RenderSettings { spp: Some(1), backend: Backend::Native, ..RenderSettings::default() };
        let plan = planned(&scene, &settings);
        assert_eq!(plan.bytes.primitives, primitives, "{what}");
        assert_near(plan.bytes.geometry, stats(&scene, &settings).memory.all_geometry, what);
    }
}

#[test]
fn a_render_goes_as_planned() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::Terrain, 60_000, folder.path());
    let base = RenderSettings {
        page_bytes: Some(4 << 10),
        texture_memory: Some(1 << 20),
        threads: Some(1),
        ..settings(folder.path())
    };
    let whole = planned(&scene, &base).bytes.geometry;
    for (geometry_memory, schedule, time_limit_seconds, wanted) in [
        (None, Schedule::Auto, None, "depth"),
        (None, Schedule::Sorted, None, "sorted"),
        (None, Schedule::Voxel, None, "sorted"),
        (Some(2 * whole), Schedule::Auto, None, "depth"),
        (Some(whole / 3), Schedule::Auto, None, "depth"),
        (Some(whole / 11), Schedule::Auto, None, "voxel"),
        (Some(whole / 3), Schedule::Voxel, None, "voxel"),
        (Some(whole / 3), Schedule::Depth, None, "depth"),
        (Some(whole / 3), Schedule::Auto, Some(600.0), "depth"),
        (Some(whole / 3), Schedule::Sorted, None, "sorted"),
    ] {
        let settings = RenderSettings { geometry_memory, schedule, time_limit_seconds, ..base.clone() };
        let plan = planned(&scene, &settings);
        let stats = stats(&scene, &settings);
        assert_eq!(plan.schedule, wanted, "{geometry_memory:?} {schedule:?}");
        assert_eq!((&stats.scheduler.name, &stats.scheduler.because), (&plan.schedule, &plan.because));
        assert_eq!(stats.plan, plan);
        let pages = plan.memory.geometry_store == "pages";
        assert_eq!(pages, stats.geometry_cache.is_some(), "{geometry_memory:?} {schedule:?}");
        if pages {
            assert_near(
                plan.bytes.pages,
                stats.memory.all_geometry - stats.memory.accounted.geometry
                    + stats.geometry_cache.map_or(0, |c| c.peak),
                "pages",
            );
        }
    }
}

/// Runs the program in `at`.
fn weir(at: &Path, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_weir"));
    command.current_dir(at).args(line.split(' ')).output().expect("it runs")
}

#[test]
fn the_program_prints_a_table_or_json_and_one_line_for_what_is_wrong() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    make(Kind::Terrain, 5_000, at);
    let output = weir(at, "plan scene/scene.pbrt --texture-memory 64M");
    let table = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    for needed in
        ["ray differentials     on ", "motion blur           off", "  schedule     depth: ", "  geometry "]
    {
        assert!(table.contains(needed), "{needed} is missing in:\n{table}");
    }
    let output = weir(at, "plan scene/scene.pbrt --texture-memory 64M --json");
    let json: PlanStats = serde_json::from_slice(&output.stdout).expect("a plan");
    let output =
        weir(at, "render scene/scene.pbrt --texture-memory 64M --spp 1 --stats stats.json -o x.exr -q");
    assert!(output.status.success(), "{output:?}");
    let text = fs::read_to_string(at.join("stats.json")).expect("written");
    let stats: RenderStats = serde_json::from_str(&text).expect("statistics");
    assert_eq!(stats.plan, json);

    fs::write(at.join("bad.ply"), "ply\nformat ascii 1.0\nelement vertex many\nend_header\n")
        .expect("written");
    let scene = "WorldBegin\nShape \"plymesh\" \"string filename\" \"bad.ply\"\n";
    fs::write(at.join("bad.pbrt"), scene).expect("written");
    for (line, needed) in [
        ("plan bad.pbrt", "bad.ply:3"),
        ("plan none.pbrt", "none.pbrt"),
        ("plan", "SCENE"),
        ("plan scene/scene.pbrt --crop 5,5,900,900", "crop"),
        ("plan scene/scene.pbrt --memory lots", "lots"),
    ] {
        let output = weir(at, line);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{line}: {said}");
        assert!(said.lines().count() == 1 && said.contains(needed), "{line}: {said}");
        assert!(output.stdout.is_empty());
    }
}
