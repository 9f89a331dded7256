//! The page that `--report` writes: its numbers are those of the record, its names are text, and a browser
//! finds nothing wrong with it.
//!
//! Invariant: every test runs in a directory of its own.
//! Never: needs a browser; what needs one says that it was left out.

use crate::page::{all, browser_that_tells, numbers_hold, opened};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use std::process::Command;
use tempfile::TempDir;

/// A file name that is markup, if anybody lets it.
const HOSTILE: &str = "<b onclick=x>&'\".pbrt";

fn weir(at: &Path, arguments: &[&str]) -> (i32, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_weir"));
    let output =
        command.current_dir(at).args(arguments).env_remove("RUST_BACKTRACE").output().expect("weir starts");
    (output.status.code().unwrap_or(-1), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[track_caller]
fn succeeds(at: &Path, arguments: &[&str]) {
    let (code, message) = weir(at, arguments);
    assert_eq!(code, 0, "weir {arguments:?}: {message}");
}

/// A small city whose textures and geometry come and go, rendered; its page and its record.
fn rendered() -> (TempDir, String, Value) {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let at = directory.path();
    succeeds(at, &["generate", "city", "--triangles", "60K", "--texture-bytes", "2M", "-o", "city"]);
    fs::rename(at.join("city/scene.pbrt"), at.join("city").join(HOSTILE)).expect("ours");
    let scene = format!("city/{HOSTILE}");
    let line = "--backend native --schedule voxel --geometry-memory 3M --ray-disk 64M --texture-memory 1M --size 40x30 --spp 2 --threads 2 \
                --cache-dir cache -o c.png --stats s.json --report r.html";
    let mut arguments = vec![scene.as_str()];
    arguments.extend(line.split_ascii_whitespace());
    succeeds(at, &arguments);
    let page = fs::read_to_string(at.join("r.html")).expect("written");
    let record = record(at, "s.json");
    (directory, page, record)
}

fn record(at: &Path, name: &str) -> Value {
    serde_json::from_slice(&fs::read(at.join(name)).expect("there")).expect("JSON")
}

#[test]
fn the_pages_numbers_are_the_records() {
    let (directory, page, stats) = rendered();
    let (keyed, rows) = numbers_hold(&page, &stats);
    assert!(keyed > 60 && rows > 20, "{keyed} numbers, {rows} rows");
    for id in [
        "time-phases",
        "time-rooms",
        "memory",
        "texture-file",
        "texture-level",
        "texture-curve",
        "geometry-file",
        "geometry-curve",
    ] {
        assert!(page.contains(&format!("<figure class=\"chart\" id=\"chart-{id}\">")), "{id} is missing");
    }
    assert_eq!(page.matches("<img src=\"data:image/png;base64,").count(), 1);
    // Nothing of the scene's name is markup, and all of it is there.
    assert!(!page.contains("<b on"));
    assert!(page.contains("&lt;b onclick=x&gt;&amp;&#39;&quot;.pbrt"));
    let command: Vec<&str> =
        stats["command"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
    assert!(
        command.contains(&format!("city/{HOSTILE}").as_str()) && command.ends_with(&["--report", "r.html"])
    );

    // The same page from the record, but for the image.
    let at = directory.path();
    succeeds(at, &["report", "s.json", "-o", "again.html"]);
    let again = fs::read_to_string(at.join("again.html")).expect("written");
    assert_eq!(numbers_hold(&again, &stats), (keyed - 3, rows), "three stand below the image");
    assert!(!again.contains("<img"));
    let charts = |page: &str| page[page.find("<section>").expect("one")..].to_owned();
    assert!(charts(&again) == charts(&page), "the record's page and the render's differ");

    // The check can fail.
    let mut other = stats;
    other["time"]["render_s"] = json!(1234.5);
    assert!(std::panic::catch_unwind(|| numbers_hold(&page, &other)).is_err());
}

#[test]
fn memory_is_watched_while_somebody_asks() {
    let (directory, _, stats) = rendered();
    let samples = stats["memory"]["timeline"].as_array().expect("a list");
    assert!((2..=512).contains(&samples.len()), "{}", samples.len());
    let of = |sample: &Value, name: &str| sample[name].as_f64().unwrap_or_else(|| panic!("{name}: {sample}"));
    assert!(samples.windows(2).all(|w| of(&w[0], "at_s") <= of(&w[1], "at_s")));
    let last = samples.last().expect("some");
    assert!(of(last, "at_s") <= stats["time"]["total_s"].as_f64().expect("a number") + 5.0);
    for (name, cache) in [("texture_cache", "texture_cache"), ("geometry_cache", "geometry_cache")] {
        let (used, peak) = (of(last, name), stats[cache]["peak"].as_f64().expect("a number"));
        assert!(used > 0.0 && used <= peak, "{name}: {used} of {peak}");
    }
    assert!(of(last, "geometry_staying") > 0.0);
    #[cfg(target_os = "linux")]
    assert!(
        samples.iter().all(|s| of(s, "rss") <= stats["memory"]["peak_rss"].as_f64().expect("Linux tells"))
    );
    drop(directory);
}

#[test]
fn a_report_takes_no_other_files_place() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let at = directory.path();
    let scene = "Film \"rgb\" \"integer xresolution\" 4 \"integer yresolution\" 3 \"string filename\" \"lit.png\"\n\
                 WorldBegin\nLightSource \"infinite\"\nShape \"sphere\"\n";
    fs::write(at.join("lit.pbrt"), scene).expect("writable");
    for (line, needed) in [
        ("lit.pbrt -o a.exr --report lit.pbrt", "is the scene too"),
        ("lit.pbrt -o a.png --report ./a.png", "is to be written twice"),
        ("lit.pbrt -o a.png --stats r --report r", "is to be written twice"),
        ("lit.pbrt --report lit.png", "is to be written twice"),
        ("lit.pbrt --stats lit.png", "is to be written twice"),
        ("lit.pbrt -o a.exr --report no/such/r.html", "no directory"),
        ("report lit.pbrt -o lit.pbrt", "is the record too"),
    ] {
        let (code, message) = weir(at, &line.split(' ').collect::<Vec<_>>());
        assert!(
            code == 2 && message.contains(needed) && message.trim_end().lines().count() == 1,
            "{line}: {message}"
        );
    }
    assert_eq!(fs::read_to_string(at.join("lit.pbrt")).expect("there"), scene);
    assert_eq!(fs::read_dir(at).expect("readable").count(), 1);
}

#[test]
fn a_browser_finds_nothing_wrong() {
    let (directory, _, mut stats) = rendered();
    let at = directory.path();
    let Some(browser) = browser_that_tells(at) else { return };
    stats["scheduler"]["name"] = json!("voxel");
    stats["scheduler"]["grid"] = json!([4, 3, 2]);
    stats["scheduler"]["by_voxel"] = json!([{"at": [1, 2, 0], "visits": 3, "rays": 40, "bytes": 500}]);
    stats["scheduler"]["decisions"] = json!([{"at_s": 0.5, "voxel": [1, 2, 0], "rays": 40, "waiting": 99}]);
    fs::write(at.join("made.json"), stats.to_string()).expect("writable");
    succeeds(at, &["report", "made.json", "-o", "made.html"]);
    for page in ["r.html", "made.html"] {
        let (dom, said) = opened(&browser, at, page).expect("it came up before");
        assert!(said.is_empty(), "{page}: {said:?}");
        let figures = all(&dom, "<figure class=\"chart\" id=\"", "</figure>");
        assert!(figures.iter().all(|figure| figure.contains("<svg ")), "{page}: a figure without a drawing");
        let mut ids: Vec<&str> = figures.iter().filter_map(|f| f.split('"').next()).collect();
        ids.extend(all(&dom, "<p class=\"absent\" id=\"", "\""));
        for id in [
            "chart-time-phases",
            "chart-time-threads",
            "chart-time-rooms",
            "chart-memory",
            "chart-texture-file",
            "chart-texture-level",
            "chart-texture-depth",
            "chart-texture-curve",
            "chart-geometry-file",
            "chart-geometry-level",
            "chart-geometry-depth",
            "chart-geometry-curve",
            "chart-scheduler-grid",
            "chart-scheduler-decisions",
        ] {
            assert!(ids.contains(&id), "{page}: {id} is missing");
        }
        assert_eq!(figures.iter().filter(|f| f.starts_with("chart-scheduler-")).count(), 2, "{page}");
        // Parsed as it was meant: what the name says is text, and no element of it came to be.
        assert!(!dom.contains("<b onclick") && dom.contains("onclick=x"), "{page}");
    }
}

#[test]
fn the_record_and_the_page_have_every_setting() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let at = directory.path();
    let scene = "Film \"rgb\" \"integer xresolution\" 4 \"integer yresolution\" 3\nWorldBegin\n\
                 LightSource \"infinite\"\nShape \"sphere\"\n";
    fs::write(at.join("s.pbrt"), scene).expect("writable");
    let rendered = |more: &str| {
        let line = format!("s.pbrt --spp 4 -q -o s.exr --stats s.json --report s.html {more}");
        succeeds(at, &line.split_ascii_whitespace().collect::<Vec<_>>());
        let page = fs::read_to_string(at.join("s.html")).expect("written");
        let stats = record(at, "s.json");
        numbers_hold(&page, &stats);
        (page, stats["settings"].clone())
    };
    let more = "--sampler independent --estimator lights --texture-filter trilinear --footprint-spp 9 --tessellation 4.5 \
                --memory 1G";
    let (page, settings) = rendered(more);
    let (_, usual) = rendered("");
    for (name, given, default) in [
        ("sampler", json!("independent"), json!("sobol")),
        ("estimator", json!("lights"), json!("both")),
        ("texture_filter", json!("trilinear"), Value::Null),
        ("footprint_spp", json!(9), json!(4)),
        ("tessellation", json!(4.5), json!(2.0)),
        ("memory", json!(1u64 << 30), Value::Null),
    ] {
        assert_eq!((&settings[name], &usual[name]), (&given, &default), "{name}");
        assert!(page.contains(&format!("data-key=\"/settings/{name}\"")), "{name} is not in the page");
    }
    let settings = settings.as_object().expect("an object");
    assert_eq!(page.matches("data-key=\"/settings/").count(), settings.len(), "each once");
}
