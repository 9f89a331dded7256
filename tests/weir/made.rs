//! Displacement and curves as a person meets them: known outlines, one picture whatever the memory and the threads, one
//! line for what is wrong.
//!
//! Invariant: everything is made on the spot, in a directory of the test's own.

use crate::pages::least;
use crate::significance::Runs;
use crate::support::{
    Frame, bits, grey, head, icosphere, mean, orthographic, outcome, render, scene, scene_beside,
};
use std::fs;
use std::path::Path;
use weir::film::Image;
use weir::film::write::write_image;
use weir::render::plan;
use weir::scene::SceneDescription;
use weir::scene::pbrt::parse_str;
use weir::settings::{Backend, RenderSettings, Schedule};
use weir::stats::{CacheRow, RenderStats};

const HALF: f64 = 2.0;

/// A black shape against a white sky, seen along z.
fn silhouette(shape: &str) -> SceneDescription {
    let frame = Frame { size: (32, 32), spp: 16, max_depth: 1 };
    let text = head(&orthographic(-5.0, HALF), frame)
        + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\nMaterial \"diffuse\" \"rgb reflectance\" [ 0 0 0 ]\n"
        + shape;
    scene(&text)
}

#[track_caller]
fn covers(shape: &str, area: f64) {
    // A fortieth of a pixel is nothing here.
    let settings = RenderSettings { tessellation: Some(0.2), ..RenderSettings::default() };
    let runs = Runs::of(&silhouette(shape), &settings, 12);
    runs.assert_mean(1.0 - area / (4.0 * HALF * HALF), 2e-3, shape);
}

#[test]
fn straight_curves_cover_their_length_times_their_width() {
    for kind in ["flat", "cylinder"] {
        let shape =
            |more: &str| format!("Rotate 20 0 0 1\nShape \"curve\" \"string type\" \"{kind}\" {more}");
        covers(&shape("\"point3 P\" [ -1 0 0 -.3 0 0 .4 0 0 1 0 0 ] \"float width\" .5"), 2.0 * 0.5);
        covers(
            &shape(
                "\"point3 P\" [ -1 0 0 -.3333333 0 0 .3333333 0 0 1 0 0 ] \"float width0\" .8 \"float width1\" 0",
            ),
            0.8,
        );
        // It begins half-way to the second point, and ends half-way to the last.
        covers(
            &shape(
                "\"string basis\" \"bspline\" \"integer degree\" 2 \"point3 P\" [ -1.5 0 0 -.5 0 0 .5 0 0 1.5 0 0 ] \
                 \"float width\" .5",
            ),
            2.0 * 0.5,
        );
        covers(
            &shape("\"integer degree\" 2 \"point3 P\" [ -1 0 0 0 0 0 1 0 0 ] \"float width\" .25"),
            2.0 * 0.25,
        );
    }
    let ribbon = |n: &str| {
        format!(
            "Shape \"curve\" \"string type\" \"ribbon\" \"point3 P\" [ -1 0 0 -.3 0 0 .4 0 0 1 0 0 ] \"float width\" .5 \
             \"normal N\" [ {n} {n} ]"
        )
    };
    covers(&ribbon("0 0 1"), 2.0 * 0.5);
    // Turned by 60 degrees from the eye.
    covers(&ribbon("0 0.8660254 .5"), 2.0 * 0.25);
}

#[test]
fn a_sphere_that_is_moved_out_by_half_is_a_larger_one() {
    let ball = icosphere(5);
    let moved = format!(
        "Texture \"half\" \"float\" \"constant\" \"float value\" .5\n\
         Shape \"trianglemesh\" {ball} \"texture displacement\" \"half\""
    );
    covers(&moved, std::f64::consts::PI * 1.5 * 1.5);
    let smooth = format!("Scale 1.5 1.5 1.5\nShape \"trianglemesh\" {ball}");
    let pictures = [moved, smooth].map(|shape| {
        mean(&grey(&outcome(&silhouette(&shape), &RenderSettings::default()).expect("sound").image))
    });
    assert!((pictures[0] - pictures[1]).abs() < 2e-3, "{pictures:?}");
}

/// A globe with a seam, moved by an image, and curves.
fn everything(folder: &Path) -> SceneDescription {
    scene_beside(&described(folder), folder)
}

/// The text of it, beside its image in `folder`.
fn described(folder: &Path) -> String {
    let mut hills = Image::new(256, 256);
    for (i, p) in hills.pixels.iter_mut().enumerate() {
        let (x, y) = ((i % 256) as f32 / 20.0, (i / 256) as f32 / 13.0);
        *p = [0.15 * (x.sin() * y.cos() + 0.3 * (3.7 * x).sin()); 3];
    }
    write_image(&folder.join("hills.exr"), &hills, &[]).expect("writable");
    let frame = Frame { size: (61, 43), spp: 5, max_depth: 4 };
    head("LookAt 0 2 -4  0 .3 0  0 1 0\nCamera \"perspective\" \"float fov\" 45", frame)
        + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n\
           Texture \"hills\" \"float\" \"imagemap\" \"string filename\" \"hills.exr\"\n\
           Texture \"from above\" \"float\" \"imagemap\" \"string filename\" \"hills.exr\" \"string mapping\" \"planar\" \
           \"vector3 v1\" [ .2 0 0 ] \"vector3 v2\" [ 0 0 .2 ]\n\
           Shape \"trianglemesh\" \"point3 P\" [ -9 0 -9  9 0 -9  9 0 9  -9 0 9 ] \"point2 uv\" [ 0 0 5 0 5 5 0 5 ] \
           \"integer indices\" [ 0 2 1 0 3 2 ] \"texture displacement\" \"hills\"\n\
           AttributeBegin\nTranslate 1 1 0\nShape \"loopsubdiv\" \"integer levels\" 2 \
           \"point3 P\" [ 1 0 0 -1 0 0 0 1 0 0 -1 0 0 0 1 0 0 -1 ] \
           \"integer indices\" [ 0 2 4 2 1 4 1 3 4 3 0 4 2 0 5 1 2 5 3 1 5 0 3 5 ] \"texture displacement\" \"from above\" \
           \"float displacement.edgelength\" .1\nAttributeEnd\n\
           ObjectBegin \"hair\"\nShape \"curve\" \"point3 P\" [ 0 0 0 .2 1 0 -.2 1.2 0 0 1.5 .1 ] \"float width\" .1\n\
           Shape \"curve\" \"point3 P\" [ .3 0 0 .5 1 0 .1 1.2 0 .5 1.5 .1 ] \"float width\" .1\nObjectEnd\n\
           AttributeBegin\nTranslate -1 0 0\nObjectInstance \"hair\"\nAttributeEnd\n\
           AttributeBegin\nTranslate -1.5 0 1\nScale -1 2 1\nObjectInstance \"hair\"\nAttributeEnd\n"
}

#[test]
fn one_picture_with_any_threads_and_any_memory() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = everything(folder.path());
    // Two curves of one look are one surface.
    assert_eq!(scene.objects[0].len(), 1);
    let cache_dir = Some(folder.path().join("cache"));
    let settings = RenderSettings { backend: Backend::Native, cache_dir, ..RenderSettings::default() };
    let one = render(&scene, &settings);
    assert_eq!(one.stats.image.non_finite_samples, 0);
    assert_eq!(
        bits(&one.image),
        bits(&render(&scene, &RenderSettings { threads: Some(3), ..settings.clone() }).image)
    );
    // The texture that moves it comes and goes in tiles, and what is made stays.
    let tiles = RenderSettings { texture_memory: Some(300_000), threads: Some(2), ..settings.clone() };
    let tiled = render(&scene, &tiles);
    assert!(tiled.stats.texture_cache.is_some());
    assert_eq!(bits(&one.image), bits(&tiled.image));
    let bounded = RenderSettings { geometry_memory: Some(200 << 20), ..settings.clone() };
    assert_eq!(bits(&one.image), bits(&render(&scene, &bounded).image));
    let small = outcome(&scene, &RenderSettings { geometry_memory: Some(100_000), ..settings.clone() });
    let Err(error) = small else { panic!("two pages a thread do not fit") };
    assert!(error.exit_code() == 2 && error.to_string().contains("--geometry-memory"), "{error}");
    // Finer edges are another picture, and more triangles.
    let finer = render(&scene, &RenderSettings { tessellation: Some(0.5), ..settings });
    assert!(finer.stats.memory.all_geometry > 4 * one.stats.memory.all_geometry);
    assert_ne!(bits(&one.image), bits(&finer.image));
}

/// Pages of a shape whose place in the scene's file begins so.
fn made<'a>(stats: &'a RenderStats, line: &str) -> &'a CacheRow {
    let cache = stats.geometry_cache.as_ref().expect("pages come and go");
    let found = cache.by_file.iter().find(|row| row.file.contains(line));
    &found.unwrap_or_else(|| panic!("{line}: {:?}", cache.by_file)).total
}

#[test]
fn pages_that_are_made_again_are_the_same_picture() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    // An octahedron of 8192 triangles.
    let smooth = "Translate 0 .5 -1\nScale .4 .4 .4\nShape \"loopsubdiv\" \"integer levels\" 5 \
                  \"point3 P\" [ 1 0 0 -1 0 0 0 1 0 0 -1 0 0 0 1 0 0 -1 ] \
                  \"integer indices\" [ 0 2 4 2 1 4 1 3 4 3 0 4 2 0 5 1 2 5 3 1 5 0 3 5 ]\n";
    // A cube of 12288, within its reach.
    let squares =
        format!("Translate 3 0 0\nShape \"catmullclark\" \"integer levels\" 5 {}\n", crate::support::CUBE);
    let scene = scene_beside(&(described(folder.path()) + smooth + &squares), folder.path());
    let whole = RenderSettings {
        backend: Backend::Native,
        cache_dir: Some(folder.path().join("cache")),
        tessellation: Some(0.3),
        page_bytes: Some(16 << 10),
        threads: Some(2),
        ..RenderSettings::default()
    };
    let one = render(&scene, &whole);
    assert!(one.stats.geometry_cache.is_none());
    let least = least(&scene, &whole);
    assert!(least < one.stats.memory.all_geometry / 4, "{least} of {}", one.stats.memory.all_geometry);
    // Below a file there is no directory.
    let nowhere = Some(folder.path().join("hills.exr/cache"));
    for (schedule, geometry_memory, threads, kept) in [
        (Schedule::Depth, least, 2, true),
        (Schedule::Depth, 2 * least, 1, false),
        (Schedule::Sorted, least, 2, true),
        (Schedule::Voxel, least, 2, false),
        (Schedule::Voxel, 3 * least, 2, true),
    ] {
        let paged = RenderSettings {
            schedule,
            geometry_memory: Some(geometry_memory),
            threads: Some(threads),
            cache_dir: if kept { whole.cache_dir.clone() } else { nowhere.clone() },
            ..whole.clone()
        };
        let paged = render(&scene, &paged);
        let what = format!("{}, {geometry_memory} bytes, {threads} threads, kept: {kept}", schedule.name());
        assert_eq!(bits(&one.image), bits(&paged.image), "{what}");
        let stats = &paged.stats;
        let cache = stats.geometry_cache.as_ref().expect("pages come and go");
        assert!(cache.peak <= geometry_memory, "{what}: {}", cache.peak);
        assert!(stats.memory.accounted.geometry <= geometry_memory, "{what}: {:?}", stats.memory);
        // The plane, the displaced octahedron, the hair and the smooth one.
        for line in ["test.pbrt:11:", "test.pbrt:14:", "test.pbrt:17:", "test.pbrt:31:"] {
            let counts = &made(stats, line).counts;
            assert!(counts.misses_compulsory > 3, "{what}: {line} {counts:?}");
            assert!(geometry_memory > least || counts.misses_capacity > 0, "{what}: {line} {counts:?}");
            assert_eq!(
                counts.bytes_read,
                if kept { counts.bytes_loaded } else { 0 },
                "{what}: {line} {counts:?}"
            );
        }
        let rooms = &stats.time.rooms;
        assert_eq!(
            (rooms.make_geometry_s == 0.0, rooms.read_geometry_s > 0.0),
            (kept, kept),
            "{what}: {rooms:?}"
        );
    }
    let pages = fs::read_dir(folder.path().join("cache/pages")).expect("a directory");
    assert_eq!(pages.count(), 0, "what is made is kept by no name");
}

#[test]
fn what_no_ray_can_hit_is_in_no_page() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frame = Frame { size: (16, 16), spp: 2, max_depth: 2 };
    // All corners on a line; texture coordinates without number beside it.
    let text = head("LookAt 0 2 -4  0 0 0  0 1 0\nCamera \"perspective\"", frame)
        + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n\
           Texture \"none\" \"float\" \"constant\" \"float value\" 0\n\
           Shape \"trianglemesh\" \"point3 P\" [ 0 0 0  1 0 0  2 0 0 ] \"point2 uv\" [ 0 0 1 0 0 1 ] \
           \"texture displacement\" \"none\" \"float displacement.edgelength\" .02\n\
           Shape \"trianglemesh\" \"point3 P\" [ -1 0 0  1 0 0  0 1 0 ] \"point2 uv\" [ 0 0 1 0 0 1 ] \
           \"texture displacement\" \"none\" \"float displacement.edgelength\" .02\n";
    let scene = scene_beside(&text, folder.path());
    let whole = RenderSettings {
        backend: Backend::Native,
        cache_dir: Some(folder.path().join("cache")),
        page_bytes: Some(4 << 10),
        ..RenderSettings::default()
    };
    let least = least(&scene, &whole);
    // Each shape says what it needs before its pages are made, and all together afterwards.
    let paged = render(&scene, &RenderSettings { geometry_memory: Some(2 * least), ..whole.clone() });
    let cache = paged.stats.geometry_cache.as_ref().expect("pages come and go");
    assert!(cache.by_file.iter().all(|row| row.file.contains("test.pbrt:11:")), "{:?}", cache.by_file);
    assert_eq!(bits(&render(&scene, &whole).image), bits(&paged.image));
}

#[test]
fn what_is_too_much_as_a_whole_comes_and_goes() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = everything(folder.path());
    let whole = RenderSettings {
        cache_dir: Some(folder.path().join("cache")),
        tessellation: Some(0.3),
        spp: Some(1),
        ..RenderSettings::default()
    };
    let one = render(&scene, &whole);
    // A displaced mesh is a guess before it is made, and here one that is too small.
    let memory = Some(12 << 20);
    assert!(one.stats.memory.all_geometry > 12 << 20, "{}", one.stats.memory.all_geometry);
    let bounded = render(&scene, &RenderSettings { memory, threads: Some(2), ..whole.clone() });
    assert!(bounded.stats.geometry_cache.is_some());
    assert!(bounded.stats.memory.peak_accounted <= 12 << 20, "{:?}", bounded.stats.memory);
    let resident = RenderSettings { backend: Backend::Native, ..whole.clone() };
    assert_eq!(bits(&render(&scene, &resident).image), bits(&bounded.image));
    // Embree cannot let go of any.
    let embree = RenderSettings { backend: Backend::Embree, backend_named: true, memory, ..whole };
    if cfg!(feature = "embree") {
        let Err(error) = outcome(&scene, &embree) else { panic!("it fits, whole") };
        assert!(error.exit_code() == 2 && error.to_string().contains("--backend native"), "{error}");
    }
}

/// Each has a run and no frame, the least that strands are kept as beside their triangles, which are few.
#[test]
fn ribbons_of_one_segment_come_and_go() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frame = Frame { size: (16, 16), spp: 1, max_depth: 1 };
    let mut text = head("LookAt 0 0 -4  0 0 0  0 1 0\nCamera \"perspective\"", frame);
    for i in 0..8000 {
        let (x, y) = (f64::from(i % 100) * 0.02 - 1.0, f64::from(i / 100) * 0.025 - 1.0);
        let points: Vec<String> = (0..4).map(|k| format!("{x} {} 0", y + 0.005 * f64::from(k))).collect();
        text += &format!(
            "Shape \"curve\" \"string type\" \"ribbon\" \"normal N\" [ 0 0 -1 0 0 -1 ] \"point3 P\" [ {} ] \
             \"float width\" .01\n",
            points.join(" ")
        );
    }
    let scene = crate::support::scene(&text);
    let settings = RenderSettings {
        backend: Backend::Native,
        threads: Some(1),
        cache_dir: Some(folder.path().join("cache")),
        ..RenderSettings::default()
    };
    let whole = render(&scene, &settings);
    let memory = least(&scene, &settings);
    assert!(memory < whole.stats.memory.all_geometry, "{memory}");
    let bounded = render(&scene, &RenderSettings { geometry_memory: Some(memory), ..settings });
    assert!(bounded.stats.geometry_cache.is_some_and(|cache| cache.total.counts.misses_compulsory > 0));
    assert!(bounded.stats.memory.accounted.geometry <= memory, "{:?}", bounded.stats.memory);
    assert_eq!(bits(&whole.image), bits(&bounded.image));
}

#[test]
fn the_plan_says_what_is_displaced_and_counts_curves() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = everything(folder.path());
    let settings = RenderSettings::default();
    let found = plan(&scene, &settings).expect("a plan");
    let displacement = &found.effects["displacement"];
    assert!(displacement.on && displacement.because.contains("test.pbrt:11:1"), "{displacement:?}");
    assert_eq!(render(&scene, &settings).stats.plan.effects, found.effects);
    // Curves alone are counted, not guessed: bytes within a tenth.
    let only = |pixels| {
        let frame = Frame { size: (pixels, pixels), spp: 1, max_depth: 1 };
        let mut text = head("LookAt 0 0 -4  0 0 0  0 1 0\nCamera \"perspective\"", frame);
        for i in 0..200 {
            let x = f64::from(i) * 0.01 - 1.0;
            text += &format!(
                "Shape \"curve\" \"point3 P\" [ {x} -1 0 {x} 0 .7 {x} .5 -.8 .1 1 0 ] \"float width\" .02\n"
            );
        }
        text
    };
    let scene = crate::support::scene(&only(500));
    assert_eq!(scene.shapes.len(), 1);
    let expected = plan(&scene, &settings).expect("a plan").bytes.geometry as f64;
    let came = render(&scene, &settings).stats.memory.all_geometry as f64;
    assert!((expected / came - 1.0).abs() < 0.1, "{expected} expected, {came} came");
}

/// What is said of `text`, read and rendered.
fn refusal(folder: &Path, text: &str) -> String {
    let said = match parse_str(text, &folder.join("test.pbrt")) {
        Err(e) => e,
        Ok(scene) => match outcome(&scene, &RenderSettings { spp: Some(1), ..RenderSettings::default() }) {
            Err(e) => e,
            Ok(_) => panic!("nothing is wrong with {text}"),
        },
    };
    let line = said.to_string();
    assert!(!line.contains('\n'), "{line}");
    line
}

#[test]
fn what_is_wrong_is_one_line_with_its_place() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = folder.path();
    fs::write(
        at.join("bare.ply"),
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
         element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    )
    .expect("writable");
    let image = Image::new(2, 2);
    write_image(&at.join("t.exr"), &image, &[]).expect("writable");
    let texture = "Texture \"t\" \"float\" \"imagemap\" \"string filename\" \"t.exr\"";
    let tiny = "Shape \"trianglemesh\" \"point3 P\" [ 0 0 0 1 0 0 0 1 0 ] \"point2 uv\" [ 0 0 1 0 0 1 ] \
                \"texture displacement\" \"t\" \"float displacement.edgelength\" 1e-6";
    for (shape, wanted) in [
        ("Shape \"curve\"", "3:1: the curve needs \"point3 P\""),
        ("Shape \"curve\" \"point3 P\" [ 0 0 0 1 0 0 2 0 0 ]", "3:15: 3 control points; 3 n + 1 are needed"),
        ("Shape \"curve\" \"integer degree\" 4 \"point3 P\" [ 0 0 0 ]", "3:15: \"degree\" is 4"),
        (
            "Shape \"curve\" \"string basis\" \"bspline\" \"point3 P\" [ 0 0 0 1 0 0 2 0 0 ]",
            "3:40: 3 control points; 4 or more",
        ),
        ("Shape \"curve\" \"string basis\" \"hermite\" \"point3 P\" [ 0 0 0 ]", "3:15: unknown basis"),
        (
            "Shape \"curve\" \"string type\" \"ribbon\" \"point3 P\" [ 0 0 0 1 0 0 2 0 0 3 0 0 ]",
            "3:1: a ribbon needs \"normal N\"",
        ),
        (
            "Shape \"curve\" \"string type\" \"ribbon\" \"normal N\" [ 0 0 1 ] \"point3 P\" [ 0 0 0 1 0 0 2 0 0 3 0 0 ]",
            "3:38: 1 normals; this curve takes 2",
        ),
        (
            "Shape \"plymesh\" \"string filename\" \"bare.ply\" \"texture displacement\" \"no\"",
            "no float texture \"no\"",
        ),
        (
            "Shape \"plymesh\" \"string filename\" \"bare.ply\" \"texture displacement\" \"t\"",
            "3:1: the mesh has no texture coordinates",
        ),
        (
            "Shape \"plymesh\" \"string filename\" \"bare.ply\" \"float displacement.edgelength\" 0",
            "3:46: \"displacement.edgelength\" is 0; it must be positive",
        ),
        (tiny, "3:1: its displacement makes more than 67108864 triangles (1154700"),
        ("Shape \"sphere\" \"texture displacement\" \"t\"", "3:16"),
    ] {
        let line = refusal(at, &format!("WorldBegin\n{texture}\n{shape}\n"));
        assert!(line.contains(wanted), "{shape}\n{line}");
    }
    for (value, wanted) in [("0", "0"), ("\"a\"", "a"), ("-1", "-1")] {
        let line = refusal(at, &format!("Option \"displacementedgescale\" {value}\nWorldBegin\n"));
        assert!(line.contains(wanted) && line.contains("a number above zero"), "{line}");
    }
    // The option stretches edges: what was refused at 1e-6 can be made of those of 0.1.
    let text = format!(
        "Option \"displacementedgescale\" 1e5\nFilm \"rgb\" \"integer xresolution\" 8 \"integer yresolution\" 8\nWorldBegin\n{texture}\n{tiny}\n"
    );
    let scene = parse_str(&text, &at.join("test.pbrt")).expect("sound");
    render(&scene, &RenderSettings { spp: Some(1), ..RenderSettings::default() });
}
