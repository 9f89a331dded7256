//! What accuracy costs: biases that are known, noise of a known slope, and a page whose numbers are the record's.
//!
//! Invariant: what is asserted holds whatever a machine's speed is; times are asserted nowhere.

use crate::page::{all, browser_that_tells, numbers_hold, opened};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::AtomicBool;
use weir::render::{Control, Progress};
use weir::report::cost::{CostStudy, Point};
use weir::scene::SceneDescription;
use weir::settings::{Estimator, RenderSettings};
use weir::study::cost::{Found, Options, study};

/// A box that emits 1 and reflects half: a path of D edges sees 2 − 2^(1−D), everywhere.
const BOX: &str = "LookAt .2 .1 -.3  .5 .4 1  0 1 0\nCamera \"perspective\" \"float fov\" 80\n\
    Film \"rgb\" \"integer xresolution\" 64 \"integer yresolution\" 64 \"string filename\" \"box.exr\"\n\
    Sampler \"zsobol\" \"integer pixelsamples\" 4\nIntegrator \"path\" \"integer maxdepth\" 8\nWorldBegin\n\
    Material \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\nReverseOrientation\n\
    AreaLightSource \"diffuse\" \"rgb L\" [ 1 1 1 ]\n\
    Shape \"trianglemesh\" \"point3 P\" [ -1 -1 -1  1 -1 -1  -1 1 -1  1 1 -1  -1 -1 1  1 -1 1  -1 1 1  1 1 1 ]\n\
    \"integer indices\" [ 0 2 1 1 2 3  4 5 6 5 7 6  0 1 4 1 5 4  2 6 3 3 6 7  0 4 2 2 4 6  1 3 5 3 7 5 ]\n";

/// A floor under a square light: smooth, with one event.
const FLOOR: &str = "LookAt 0 3 -3  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" 30\n\
    Film \"rgb\" \"integer xresolution\" 64 \"integer yresolution\" 64\n\
    Sampler \"zsobol\" \"integer pixelsamples\" 4\nIntegrator \"path\" \"integer maxdepth\" 1\nWorldBegin\n\
    Material \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\n\
    Shape \"trianglemesh\" \"point3 P\" [ -9 0 -9  9 0 -9  -9 0 9  9 0 9 ] \"integer indices\" [ 0 1 2 1 3 2 ]\n\
    AttributeBegin\nMaterial \"diffuse\" \"rgb reflectance\" [ 0 0 0 ]\n\
    AreaLightSource \"diffuse\" \"rgb L\" [ 9 9 9 ] \"bool twosided\" true\n\
    Shape \"trianglemesh\" \"point3 P\" [ -1 4 -1  1 4 -1  -1 4 1  1 4 1 ] \"integer indices\" [ 0 1 2 1 3 2 ]\n\
    AttributeEnd\n";

fn studied(text: &str, estimator: Estimator, budget_s: f64) -> CostStudy {
    let settings = RenderSettings { estimator, ..RenderSettings::default() };
    studied_with(&crate::support::scene(text), settings, budget_s)
}

fn studied_with(scene: &SceneDescription, settings: RenderSettings, budget_s: f64) -> CostStudy {
    let settings = RenderSettings { threads: Some(1), ..settings };
    let options = Options { settings, budget_s, target: 0.05, reference: None, patience: f64::INFINITY };
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_: Progress| {}, watch: None };
    let Found { study, reference, .. } = study(scene, &options, &control).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!([reference.width, reference.height], study.size);
    study
}

fn point<'s>(study: &'s CostStudy, knob: &str, value: &str) -> &'s Point {
    let named = |p: &&Point| p.knob == knob && p.value == value;
    study.points.iter().find(named).unwrap_or_else(|| panic!("no {knob} {value} in {:?}", study.points))
}

#[test]
fn known_biases_are_found_and_nothing_else_is_one() {
    // Without light sampling every path sees the same, but for roulette.
    let study = studied(BOX, Estimator::Scattering, 5.0);
    let own = 2.0 - 0.5f64.powi(8);
    for (depth, edges) in [(2, 3), (4, 5)] {
        let point = point(&study, "depth", &depth.to_string());
        let seen = 2.0 - 0.5f64.powi(edges - 1);
        let bias = (2.0 - seen) / (4.0f64 + 0.01).sqrt();
        // The mean over thousands of pixels, of which some with the largest errors are left out.
        assert!((point.bias / bias - 1.0).abs() < 0.05, "{depth}: {} is not {bias}", point.bias);
        assert!(point.bias_bound >= point.bias);
        let light = point.light.expect("it is not the scene's own").mean;
        assert!((light - (seen / own - 1.0)).abs() < 5e-3, "{depth}: {light}");
    }
    assert!(point(&study, "depth", "2").at_target.is_none(), "12.5 % stay");
    assert!(point(&study, "depth", "4").at_target.is_some(), "3.1 % stay");
    let text = study.advice.join("\n");
    assert!(text.contains("Never 5.0 %: ") && text.contains("depth 2 ("), "{text}");
}

#[test]
fn noise_has_the_slope_that_is_known_and_no_bias() {
    let study = studied(FLOOR, Estimator::Both, 5.0);
    // Four standard deviations for each: false alarms 3e-5, of some ten points.
    for point in study.points.iter().filter(|p| p.knob != "depth") {
        assert_eq!(point.bias, 0.0, "{point:?}");
    }
    // Four dimensions, smooth: scrambled Sobol points are far better than samples that know nothing of each other.
    let own = study.points.iter().find(|p| p.knob == "samples" && p.spp == 16).expect("it is on the ladder");
    let ratio = point(&study, "sampler", "independent").noise / own.noise;
    assert!(ratio > 1.5, "{ratio}");
    assert!(study.slope > 1.2, "{}", study.slope);
    assert_eq!(own.over_own, Some(1.0));
    assert!(point(&study, "direct light", "BSDF only").noise > 2.0 * own.noise);
    // The noise of a mean over thousands of pixels is known to some per cent, twice.
    for check in &study.checks {
        assert!((check.measured / check.predicted - 1.0).abs() < 0.3, "{check:?}");
    }
}

#[test]
fn what_few_samples_blur_is_no_bias() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/textures.pbrt");
    let scene = weir::scene::load(&path).unwrap_or_else(|e| panic!("{e}"));
    let study =
        studied_with(&scene, RenderSettings { size: Some((96, 64)), ..RenderSettings::default() }, 6.0);
    for point in study.points.iter().filter(|p| p.knob == "samples") {
        assert_eq!(point.bias, 0.0, "{point:?}");
    }
    assert!(study.points[0].at_target.is_some(), "{:?}", study.advice);
}

#[test]
fn a_picture_without_noise_or_light_is_told_as_one() {
    let dark = BOX.replace("AreaLightSource \"diffuse\" \"rgb L\" [ 1 1 1 ]\n", "");
    let study = studied(&dark, Estimator::Both, 2.0);
    assert_eq!(study.advice, ["Every render is the same: one sample per pixel does."]);
    assert!(study.checks.is_empty() && study.points.iter().all(|p| p.knob != "together"));
}

fn weir(at: &Path, arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_weir"));
    let output =
        command.current_dir(at).args(arguments).env_remove("RUST_BACKTRACE").output().expect("weir starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap_or(-1), text(&output.stdout), text(&output.stderr))
}

#[test]
fn the_page_has_the_numbers_of_the_record() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let at = directory.path();
    fs::write(at.join("<box>.pbrt"), BOX).expect("writable");
    let line =
        ["cost", "<box>.pbrt", "--budget", "5s", "--threads", "1", "--json", "c.json", "--report", "c.html"];
    let (code, text, message) = weir(at, &line);
    assert_eq!(code, 0, "{message}");
    assert!(text.starts_with("For 5.0 % error this scene needs "), "{text}");
    let page = fs::read_to_string(at.join("c.html")).expect("written");
    let bytes = fs::read(at.join("c.json")).expect("written");
    let study: CostStudy = serde_json::from_slice(&bytes).expect("a record");
    for sentence in &study.advice {
        assert!(text.contains(sentence), "{sentence}");
    }
    let json: serde_json::Value = serde_json::from_slice(&bytes).expect("JSON");
    let (keyed, rows) = numbers_hold(&page, &json);
    assert!(keyed > 5 * study.points.len() && rows == study.points.len(), "{keyed} numbers, {rows} rows");
    assert!(!page.contains("<box>") && page.contains("&lt;box&gt;"));
    assert!(page.matches("data:image/png;base64,").count() >= 5, "crops and their differences");
    let mut other = json;
    other["points"][0]["error"] = serde_json::json!(7.5);
    assert!(std::panic::catch_unwind(|| numbers_hold(&page, &other)).is_err(), "the check can fail");
    if let Some(browser) = browser_that_tells(at) {
        let (dom, said) = opened(&browser, at, "c.html").expect("it came up before");
        assert!(said.is_empty(), "{said:?}");
        assert!(all(&dom, "id=\"chart-cost\"", "</figure>").iter().all(|figure| figure.contains("<svg ")));
    }
}

#[test]
fn wrong_use_is_one_line_and_writes_nothing() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let at = directory.path();
    fs::write(at.join("box.pbrt"), BOX).expect("writable");
    let (code, _, message) =
        weir(at, &["box.pbrt", "--spp", "1", "--size", "20x10", "-o", "small.exr", "-q"]);
    assert_eq!(code, 0, "{message}");
    let before = fs::read_dir(at).expect("readable").count();
    for (line, needed) in [
        ("cost box.pbrt --reference small.exr", "--size 20x10"),
        ("cost box.pbrt --reference no.exr", "no.exr"),
        ("cost box.pbrt --target 0", "between 0 and 1"),
        ("cost box.pbrt --target 5", "between 0 and 1"),
        ("cost box.pbrt --budget 0s", "above zero"),
        ("cost box.pbrt --json box.pbrt", "is the scene too"),
        ("cost box.pbrt --reference small.exr --json small.exr", "is the reference too"),
        ("cost box.pbrt --json a --report a", "is to be written twice"),
        ("cost no.pbrt", "no.pbrt"),
    ] {
        let (code, _, message) = weir(at, &line.split(' ').collect::<Vec<_>>());
        assert!(
            code == 2 && message.contains(needed) && message.trim_end().lines().count() == 1,
            "{line}: {message}"
        );
    }
    assert_eq!(fs::read_dir(at).expect("readable").count(), before);
    // A reference of the film's size does.
    let line = "cost box.pbrt --size 20x10 --reference small.exr --budget 2s --threads 1";
    let (code, text, message) = weir(at, &line.split(' ').collect::<Vec<_>>());
    assert!(code == 0 && text.contains("small.exr, whose own error is not known"), "{message} {text}");
}
