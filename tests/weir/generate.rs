//! Generated scenes: the same bytes from the same seed, as large as asked for, loadable.
//!
//! Invariant: counts are taken from the files, not from what the generator says of itself.
//! Never: judges whether a scene is worth looking at; people do.

use crate::support::outcome;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;
use weir::scene;
use weir::settings::RenderSettings;
use weir::study::generate::{Kind, Recipe, TextureFormat, Written, generate};

const KINDS: [Kind; 3] = [Kind::City, Kind::Forest, Kind::Terrain];

fn make(kind: Kind, counts: (u64, u64), seed: u64, threads: usize, at: &Path) -> Written {
    let recipe = Recipe {
        kind,
        triangles: counts.0,
        texture_bytes: counts.1,
        seed,
        size: (1280, 720),
        format: TextureFormat::Png,
        directory: at.to_path_buf(),
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    pool.install(|| generate(&recipe, &|_, _| {})).unwrap_or_else(|e| panic!("{kind}: {e}"))
}

/// Files below `at`, by name, with a hash of their bytes (FNV-1a).
fn hashes(at: &Path) -> BTreeMap<String, u64> {
    let mut all = BTreeMap::new();
    for folder in ["", "meshes", "textures"] {
        for entry in fs::read_dir(at.join(folder)).expect("a folder").map(|e| e.expect("an entry").path()) {
            if entry.is_file() {
                let bytes = fs::read(&entry).expect("readable");
                let name = entry.strip_prefix(at).expect("below").to_string_lossy().into_owned();
                all.insert(name, fnv(&bytes));
            }
        }
    }
    all
}

fn fnv(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// Triangles that the headers of the PLY files say, and four bytes for every texel of the PNG files.
fn counted(at: &Path) -> (u64, u64) {
    let files = |folder: &str| -> Vec<_> {
        let entries = fs::read_dir(at.join(folder)).expect("a folder");
        entries.map(|e| e.expect("an entry").path()).collect()
    };
    let faces = |bytes: &[u8]| {
        let text = String::from_utf8_lossy(&bytes[..bytes.len().min(400)]).into_owned();
        let line = text.lines().find_map(|l| l.strip_prefix("element face ")).expect("a PLY header");
        line.parse::<u64>().expect("a count")
    };
    let triangles = files("meshes").iter().map(|p| faces(&fs::read(p).expect("readable"))).sum();
    let pngs = files("textures").into_iter().filter(|p| p.extension().is_some_and(|e| e == "png"));
    let texels = pngs.map(|p| {
        let bytes = fs::read(p).expect("readable");
        let side =
            |at: usize| u64::from(u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four bytes")));
        4 * side(16) * side(20)
    });
    (triangles, texels.sum())
}

#[test]
fn a_seed_gives_the_same_bytes_whatever_the_threads() {
    for kind in KINDS {
        let d = tempfile::tempdir().expect("a temporary directory");
        let [a, b, c] = ["a", "b", "c"].map(|n| d.path().join(n));
        make(kind, (30_000, 600_000), 5, 1, &a);
        make(kind, (30_000, 600_000), 5, 3, &b);
        make(kind, (30_000, 600_000), 6, 2, &c);
        assert_eq!(hashes(&a), hashes(&b), "{kind}");
        assert_ne!(hashes(&a), hashes(&c), "{kind}");
    }
}

#[test]
fn counts_are_met_within_five_per_cent() {
    for kind in KINDS {
        for counts in [(1_000, 100_000), (40_000, 3_000_000), (700_000, 400_000)] {
            let d = tempfile::tempdir().expect("a temporary directory");
            let written = make(kind, counts, 1, 2, d.path());
            let (triangles, bytes) = counted(d.path());
            assert_eq!((triangles, bytes), (written.triangles, written.texture_bytes), "{kind} {counts:?}");
            let near = |n: u64, wanted: u64| (n as f64 / wanted as f64 - 1.0).abs() <= 0.05;
            assert!(
                near(triangles, counts.0) && near(bytes, counts.1),
                "{kind} {counts:?}: {triangles} {bytes}"
            );
            assert!(written.instanced_triangles >= triangles);
        }
    }
}

#[test]
fn scenes_load_without_warnings_and_are_lit() {
    for kind in KINDS {
        let d = tempfile::tempdir().expect("a temporary directory");
        let written = make(kind, (400_000, 1_000_000), 0, 2, d.path());
        let scene = scene::load(&written.scene).unwrap_or_else(|e| panic!("{kind}: {e}"));
        assert!(scene.warnings.is_empty(), "{kind}: {:?}", scene.warnings);
        let settings = RenderSettings { size: Some((16, 9)), spp: Some(4), ..RenderSettings::default() };
        let image = outcome(&scene, &settings).unwrap_or_else(|e| panic!("{kind}: {e}")).image;
        let mean = image.pixels.iter().flatten().map(|&c| f64::from(c)).sum::<f64>() / (3.0 * 144.0);
        // Neither night nor overexposed; the upper left corner sees the sky or what it lights.
        assert!((0.02..1.0).contains(&mean), "{kind}: mean {mean}");
    }
}

fn weir(at: &Path, line: &str) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_weir"))
        .current_dir(at)
        .args(line.split_ascii_whitespace())
        .env_remove("RUST_BACKTRACE")
        .output()
        .expect("weir starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

#[test]
fn a_directory_of_somebody_else_is_left_alone_and_ours_replaced() {
    let d = tempfile::tempdir().expect("a temporary directory");
    let line = "generate terrain --triangles 2k --texture-bytes 200k --texture-format png -o here";
    let (code, out, message) = weir(d.path(), line);
    assert_eq!(code, Some(0), "{message}");
    assert!(out.starts_with("wrote here") && out.contains("triangles"), "{out}");
    let first = hashes(&d.path().join("here"));
    fs::write(d.path().join("here/meshes/stale.ply"), "old").expect("writable");
    assert_eq!(weir(d.path(), line).0, Some(0));
    assert_eq!(hashes(&d.path().join("here")), first, "an earlier mesh stays behind");
    fs::create_dir(d.path().join("mine")).expect("writable");
    fs::write(d.path().join("mine/letter.txt"), "dear").expect("writable");
    let (code, _, message) = weir(d.path(), &line.replace("here", "mine"));
    assert_eq!(code, Some(2));
    assert!(message.contains("not empty") && message.trim_end().lines().count() == 1, "{message}");
    assert_eq!(fs::read(d.path().join("mine/letter.txt")).expect("still there"), b"dear");
    assert_eq!(fs::read_dir(d.path().join("mine")).expect("a folder").count(), 1);
}

#[test]
fn wrong_arguments_are_one_line_and_two() {
    let d = tempfile::tempdir().expect("a temporary directory");
    for (arguments, needle) in [
        ("desert", "city, forest, terrain"),
        ("city --triangles 10", "from 1000 to 1000000000"),
        ("city --triangles many", "20M"),
        ("city --triangles -5", "20M"),
        ("city --triangles nan", "20M"),
        ("city --texture-bytes 1", "from 100000"),
        ("city --texture-bytes 1e30", "20M"),
        ("terrain --texture-bytes 1T --triangles 1k", "triangles at least"),
        ("forest --texture-bytes 1T --triangles 1k", "triangles at least"),
        ("city --size 0x4", "1280x720"),
        ("city --texture-format jpg", "png"),
    ] {
        let line = format!("generate {arguments} -o out");
        let line = if arguments.contains("format") { line } else { line + " --texture-format png" };
        let (code, out, message) = weir(d.path(), &line);
        assert_eq!(code, Some(2), "{line}: {message}");
        assert_eq!(message.trim_end().lines().count(), 1, "{line}: {message}");
        assert!(message.contains(needle) && out.is_empty(), "{line}: {message}");
        assert!(!d.path().join("out").exists(), "{line}");
    }
    fs::write(d.path().join("file"), "x").expect("writable");
    assert_eq!(weir(d.path(), "generate city --texture-format png -o file").0, Some(2));
}
