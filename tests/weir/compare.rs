//! `weir compare` on whole scenes: nothing is unexplained, the contract's keys are there, one ray can be asked again.
//!
//! Invariant: few rays, no rates: those are measured by hand. That a wrong answer is found is tested beside the code
//! (`study/compare/hits_tests.rs`).

use crate::support::shared;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn weir(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_weir")).args(arguments).output().expect("weir starts")
}

fn own(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name)
}

/// Compares, and gives the JSON. Fails where anything is unexplained.
#[track_caller]
fn compared(scene: &Path, rays: &str, more: &[&str]) -> Value {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let json = folder.path().join("compare.json");
    let (scene, json) = (scene.to_string_lossy(), json.to_string_lossy());
    let line = ["compare", &scene, "--rays", rays, "--threads", "2", "--json", &json];
    let mut line: Vec<&str> = line.iter().chain(more).copied().collect();
    if !more.contains(&"--rounds") {
        line.extend(["--rounds", "0"]);
    }
    let output = weir(&line);
    let text = String::from_utf8_lossy(&output.stdout);
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{line:?}: {text}{error}");
    let written = std::fs::read_to_string(&*json).expect("it was written");
    serde_json::from_str(&written).expect("JSON")
}

fn number(json: &Value, key: &str) -> u64 {
    json[key].as_u64().unwrap_or_else(|| panic!("{key} in {json}"))
}

#[track_caller]
fn adds_up(json: &Value) {
    let rays = json["rays"].as_object().expect("counts").values();
    let all: u64 = rays.map(|n| n.as_u64().expect("a count")).sum();
    let parts = ["same", "ties", "explained", "unexplained"].map(|key| number(json, key));
    assert_eq!(parts.iter().sum::<u64>(), all, "{json}");
    assert_eq!(number(json, "unexplained"), 0);
    assert!(number(json, "within_bound") <= number(json, "same"));
    assert!(number(json, "occlusion_checked") > all / 5 && number(json, "audited") > 100, "{json}");
}

#[test]
fn the_scenes_of_the_house_have_nothing_unexplained() {
    for name in ["cornell.pbrt", "instances.pbrt", "materials.pbrt", "furnace.pbrt", "textures.pbrt"] {
        let json = compared(&own(name), "20000", &["--seed", "3"]);
        adds_up(&json);
        assert!(number(&json, "same") > 15_000, "{name}: {json}");
        // The rays are those of paths; in textures.pbrt paths end at the first event and ask for light alone.
        assert_eq!(number(&json["rays"], "camera"), 6667, "{name}");
        assert!(number(&json["rays"], "bounce") > 1000 || name == "textures.pbrt", "{name}: {json}");
    }
}

#[test]
fn other_peoples_scenes_have_nothing_unexplained() {
    for name in ["pbrt-classroom", "pbrt-living-room", "pbrt-material-testball"] {
        let Some(folder) = shared(name) else { return };
        let json = compared(&folder.join("scene-v4.pbrt"), "30000", &["--robust"]);
        adds_up(&json);
        assert!(
            number(&json["rays"], "shadow") == 10_000 && number(&json["rays"], "aimed") == 7500,
            "{json}"
        );
        assert_eq!(number(&json["native"], "misses_through_closed_mesh"), 0, "{name}");
        assert_eq!(number(&json["robust"], "unexplained"), 0, "{name}");
        assert!(number(&json, "within_bound") > 1000, "{name}: the backends round differently");
    }
}

#[test]
fn the_keys_of_the_contract_are_there() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let picture = folder.path().join("where.exr");
    let more = ["--size", "40x30", "-o", &picture.to_string_lossy(), "--rounds", "1"];
    let json = compared(&own("instances.pbrt"), "3000", &more);
    for key in ["camera", "bounce", "shadow", "aimed"] {
        assert!(number(&json["rays"], key) > 0, "{key}");
    }
    assert_eq!(number(&json["rays"], "pixel"), 1200);
    for backend in ["embree", "native"] {
        let b = &json[backend];
        assert!(b["version"].as_str().is_some_and(|v| !v.is_empty()), "{b}");
        for key in ["build_s", "bytes", "closest_mrays_per_s", "occluded_mrays_per_s"] {
            assert!(b[key].as_f64().is_some_and(|n| n > 0.0), "{backend} {key}: {b}");
        }
        number(b, "misses_through_closed_mesh");
    }
    assert!(json["native"]["nodes_per_ray"].as_f64().is_some_and(|n| n >= 1.0));
    assert!(json["embree"]["nodes_per_ray"].is_null());
    // One thread and two, each kind.
    assert_eq!(json["rates"].as_array().map(Vec::len), Some(12));
    assert!(json["worst"].is_array());
    let image = weir::film::read::read_image(&picture).expect("a picture");
    assert_eq!((image.width, image.height, image.non_finite_pixels()), (40, 30, 0));
    assert!(image.pixels.iter().flatten().any(|&c| c > 0.1), "black");
}

#[test]
fn the_same_seed_gives_the_same_verdicts() {
    let run = |seed| {
        let mut json = compared(&own("cornell.pbrt"), "9000", &["--seed", seed]);
        let kept = ["rays", "same", "ties", "within_bound", "explained", "reasons", "by_kind", "worst"];
        json.as_object_mut().expect("an object").retain(|key, _| kept.contains(&key.as_str()));
        json
    };
    assert_eq!(run("1"), run("1"));
    assert_ne!(run("1"), run("2"));
}

#[test]
fn one_ray_can_be_asked_again() {
    let scene = own("cornell.pbrt");
    let scene = scene.to_string_lossy();
    let output = weir(&["compare", &scene, "--ray", "0.1,-3.9,1.3,0,1,0"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{text}");
    for needed in ["native ", "embree ", "embree robust", "arbiter, embree: no difference", "hits in ["] {
        assert!(text.contains(needed), "{needed}: {text}");
    }
    for wrong in ["1,2,3", "0,0,0,0,0,0", "0,0,0,0,0,1,3,2"] {
        let output = weir(&["compare", &scene, "--ray", wrong]);
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), error.lines().count()), (Some(2), 1), "{wrong}: {error}");
    }
}
