//! Textures that go wrong under a render: damaged, cut, changed, forbidden, missing; too little memory,
//! too few open files. Exit codes and one clear line each. (Tiled copies that go wrong are in
//! `textures_copies`.)
//!
//! Invariant: every test runs in a directory of its own; what a machine does not allow is skipped
//! and said.

use crate::support::{Frame, head, orthographic};
use crate::textures::{hash8, named_budget, png, tile};
use std::fmt::Write;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use weir::texture::convert::Compression;
use weir::texture::{Pixels, read_image};

pub(crate) const WEIR: &str = env!("CARGO_BIN_EXE_weir");

/// `scene.pbrt`: one square for each image, `side` in a row, seen from the front under an even sky.
pub(crate) fn squares(at: &Path, names: &[&str], side: usize) {
    // Footprints are below a texel of 256 in a square of two in a row: the finest level is read.
    let frame = Frame { size: (160, 160), spp: 16, max_depth: 1 };
    let mut text = head(&orthographic(-1.0, 1.0), frame) + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n";
    let step = 2.0 / side as f64;
    for (i, name) in names.iter().enumerate() {
        let (x, y) = ((i % side) as f64 * step - 1.0, (i / side) as f64 * step - 1.0);
        let (x1, y1) = (x + step, y + step);
        let _ = writeln!(
            text,
            "Texture \"t{i}\" \"spectrum\" \"imagemap\" \"string filename\" \"{name}\"\n\
             Material \"diffuse\" \"texture reflectance\" \"t{i}\"\n\
             Shape \"bilinearmesh\" \"point3 P\" [ {x} {y} 0  {x1} {y} 0  {x} {y1} 0  {x1} {y1} 0 ] \"point2 uv\" [ 0 0 1 0 0 1 1 1 ]"
        );
    }
    fs::write(at.join("scene.pbrt"), text).expect("writable");
}

pub(crate) fn directory() -> tempfile::TempDir {
    let d = tempfile::tempdir().expect("a temporary directory");
    // Somebody else reads here too.
    fs::set_permissions(d.path(), fs::Permissions::from_mode(0o777)).expect("ours");
    d
}

/// 256² texels in three channels, tiled.
fn tiled(at: &Path, name: &str, compression: Compression) {
    png(&at.join("plain.png"), (256, 256), 3);
    tile(&at.join("plain.png"), &at.join(name), compression);
}

pub(crate) fn weir(at: &Path, line: &str) -> Command {
    let mut command = Command::new(WEIR);
    command.current_dir(at).args(line.split_ascii_whitespace()).env_remove("RUST_BACKTRACE");
    command
}

pub(crate) fn run(at: &Path, line: &str) -> Output {
    weir(at, line).output().expect("weir starts")
}

/// Through a shell that does something first.
pub(crate) fn shell(at: &Path, before: &str, line: &str) -> Output {
    let script = format!("{before}; exec {WEIR} {line}");
    Command::new("sh").current_dir(at).args(["-c", &script]).output().expect("a shell")
}

/// As somebody who may not read everything; `None`, and a note, where that cannot be had.
pub(crate) fn as_nobody(at: &Path, line: &str) -> Option<Output> {
    let root = Command::new("id").arg("-u").output().is_ok_and(|o| o.stdout == b"0\n");
    if !root {
        return Some(run(at, line));
    }
    let nobody = |line: &str| {
        Command::new("setpriv")
            .current_dir(at)
            .args(["--reuid=65534", "--regid=65534", "--clear-groups", WEIR])
            .args(line.split_ascii_whitespace())
            .output()
    };
    if !nobody("--version").is_ok_and(|o| o.status.success()) {
        eprintln!("left out: root reads everything, and nobody cannot run {WEIR}");
        return None;
    }
    nobody(line).ok()
}

pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Standard error of a run that ended with `code`, of `lines` lines.
#[track_caller]
pub(crate) fn ended(output: &Output, code: i32, lines: usize) -> String {
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{message}");
    assert_eq!(message.lines().count(), lines, "{message}");
    message
}

#[track_caller]
pub(crate) fn same_picture(at: &Path, a: &str, b: &str) {
    let pixels = |name: &str| read_image(&at.join(name)).unwrap_or_else(|e| panic!("{e}")).pixels;
    assert!(pixels(a) == pixels(b), "{a} and {b} differ");
}

/// Pixels that are magenta, in each of the four squares: bottom left, bottom right, top left, top right.
fn magenta(path: &Path) -> [usize; 4] {
    let image = read_image(path).unwrap_or_else(|e| panic!("{e}"));
    let Pixels::F32(numbers) = &image.pixels else { panic!("a PFM has floats") };
    let mut found = [0; 4];
    for (i, p) in numbers.chunks_exact(3).enumerate() {
        let (right, bottom) = (i % 160 >= 80, i / 160 >= 80);
        if p[0] > 0.99 && p[1] < 0.01 && p[2] > 0.99 {
            found[usize::from(right) + 2 * usize::from(!bottom)] += 1;
        }
    }
    found
}

fn stats(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&fs::read(path).expect("written")).expect("JSON")
}

/// The place of the first tile's entry in an uncompressed file's table of places.
pub(crate) fn first_offset(bytes: &[u8]) -> usize {
    let known: Vec<u8> = [4096u32, 4096 + 12_288].iter().flat_map(|o| o.to_le_bytes()).collect();
    bytes.windows(8).rposition(|w| w == known).expect("tiles stand one behind the other")
}

#[test]
fn tiles_that_cannot_be_read_are_magenta_and_counted_and_said_once_a_file() {
    let d = directory();
    let at = d.path();
    let files = ["rotten.tx", "short.tx", "cut.exr", "good.tx"];
    for name in files {
        let kind = if name == "short.tx" { Compression::None } else { Compression::Zip };
        tiled(at, name, kind);
    }
    squares(at, &files, 2);
    ended(&run(at, "scene.pbrt -o clean.pfm --texture-memory 1M"), 0, 0);
    assert_eq!(magenta(&at.join("clean.pfm")), [0; 4]);
    // A stretch in the middle overwritten; a tile that lies behind the end; the end missing.
    let change = |name: &str, f: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = fs::read(at.join(name)).expect("there");
        f(&mut bytes);
        fs::write(at.join(name), bytes).expect("ours");
    };
    change("rotten.tx", &|bytes| {
        let middle = bytes.len() / 3;
        (0..3000).for_each(|i| bytes[middle + i] = hash8(i as u32, 1, 1));
    });
    change("short.tx", &|bytes| {
        let entry = first_offset(bytes);
        bytes[entry..entry + 4].copy_from_slice(&0x7fff_0000u32.to_le_bytes());
    });
    change("cut.exr", &|bytes| bytes.truncate(bytes.len() / 2));
    // With room for all, and with so little that what failed is tried again and again.
    for (budget, threads) in [("1M", 2), ("140000", 1)] {
        let line =
            format!("scene.pbrt -o a.pfm --stats s.json --texture-memory {budget} --threads {threads}");
        let output = run(at, &line);
        let message = ended(&output, 2, 3);
        for name in &files[..3] {
            let said: Vec<&str> = message.lines().filter(|l| l.contains(name)).collect();
            assert!(said.len() == 1 && said[0].contains("magenta"), "{name}: {message}");
        }
        assert!(text(&output.stdout).contains("wrote a.pfm"), "the image is written all the same");
        let seen = magenta(&at.join("a.pfm"));
        assert!(seen[..3].iter().all(|&n| n > 100) && seen[3] == 0, "{seen:?}");
        let cache = &stats(&at.join("s.json"))["texture_cache"];
        let failed = |v: &serde_json::Value| v["failed"].as_u64().expect("counted");
        let by_file = cache["by_file"].as_array().expect("a list");
        for file in by_file {
            let good = file["file"].as_str().is_some_and(|f| f.ends_with("good.tx"));
            assert_eq!(failed(file) == 0, good, "{file}");
        }
        assert_eq!(failed(cache), by_file.iter().map(failed).sum::<u64>());
    }
}

#[test]
fn files_that_cannot_be_opened_end_it_before_it_begins() {
    let d = directory();
    let at = d.path();
    for name in ["header.tx", "cut.tx", "cut.exr", "locked.tx"] {
        tiled(at, name, Compression::Zip);
        let mut bytes = fs::read(at.join(name)).expect("there");
        match name {
            // The pointer to the first directory; the directories themselves; half of the header.
            "header.tx" => bytes[4..8].fill(0xff),
            "cut.tx" => bytes.truncate(bytes.len() / 2),
            "cut.exr" => bytes.truncate(200),
            _ => {}
        }
        fs::write(at.join(name), bytes).expect("ours");
    }
    fs::set_permissions(at.join("locked.tx"), fs::Permissions::from_mode(0o000)).expect("ours");
    for (name, what) in
        [("header.tx", ""), ("cut.tx", ""), ("cut.exr", ""), ("none.tx", "no file"), ("locked.tx", "denied")]
    {
        squares(at, &[name], 1);
        let line = "scene.pbrt -o a.pfm --threads 1";
        let Some(output) = (if name == "locked.tx" { as_nobody(at, line) } else { Some(run(at, line)) })
        else {
            continue;
        };
        let message = ended(&output, 2, 1);
        assert!(
            message.contains(name) && message.contains("scene.pbrt:") && message.contains(what),
            "{message}"
        );
        assert!(!at.join("a.pfm").exists() && output.stdout.is_empty());
    }
}

/// Starts a render slow enough to be disturbed, disturbs it once it has its textures open.
#[cfg(target_os = "linux")]
fn disturbed(at: &Path, line: &str, disturb: impl FnOnce()) -> Output {
    let child = weir(at, line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("weir starts");
    let start = Instant::now();
    let has_it = || {
        let fds = fs::read_dir(format!("/proc/{}/fd", child.id()));
        let link = |e: std::io::Result<fs::DirEntry>| e.and_then(|e| fs::read_link(e.path()));
        fds.is_ok_and(|fds| fds.map(link).any(|l| l.is_ok_and(|l| l.ends_with("a.tx"))))
    };
    while !has_it() {
        assert!(start.elapsed() < Duration::from_secs(60), "it never opened a.tx");
        std::thread::sleep(Duration::from_millis(2));
    }
    // Its header is read within this, its tiles are not.
    std::thread::sleep(Duration::from_millis(250));
    disturb();
    child.wait_with_output().expect("it ran")
}

#[cfg(target_os = "linux")]
#[test]
fn a_file_that_changes_under_a_render_is_never_mixed_with_what_it_was() {
    let d = directory();
    let at = d.path();
    tiled(at, "a.tx", Compression::None);
    squares(at, &["a.tx"], 1);
    ended(&run(at, "scene.pbrt -o clean.pfm --threads 1"), 0, 0);
    // 16 tiles of the finest level, 120 ms each.
    let line = "scene.pbrt -o a.pfm --threads 1 --texture-latency-ms 120";
    // Another file of the name: the one that is open is read to the end.
    let output = disturbed(at, line, || {
        png(&at.join("plain.png"), (300, 200), 1);
        tile(&at.join("plain.png"), &at.join("new.tx"), Compression::None);
        fs::rename(at.join("new.tx"), at.join("a.tx")).expect("ours");
    });
    ended(&output, 0, 0);
    same_picture(at, "a.pfm", "clean.pfm");
    // The same file, written again.
    tiled(at, "a.tx", Compression::None);
    let output = disturbed(at, line, || {
        let mut bytes = fs::read(at.join("a.tx")).expect("there");
        bytes[4096..200_000].iter_mut().for_each(|b| *b = !*b);
        fs::write(at.join("a.tx"), bytes).expect("ours");
    });
    let message = ended(&output, 2, 1);
    assert!(message.contains("a.tx") && message.contains("changed while rendering"), "{message}");
    assert!(magenta(&at.join("a.pfm")).iter().sum::<usize>() > 2000, "it read what was not there before");
}

#[test]
fn too_small_a_budget_names_one_that_works() {
    let d = directory();
    let at = d.path();
    tiled(at, "a.tx", Compression::None);
    png(&at.join("b.png"), (300, 200), 3);
    for (files, threads) in [(&["a.tx"][..], 1), (&["a.tx", "b.png"], 2)] {
        squares(at, files, 2);
        let line = format!("scene.pbrt -o a.pfm --cache-dir cache --threads {threads} --texture-memory");
        let message = ended(&run(at, &format!("{line} 1000")), 2, 1);
        let enough = named_budget(&message);
        ended(&run(at, &format!("{line} {enough}")), 0, 0);
        ended(&run(at, &format!("{line} {}", enough - 1)), 2, 1);
    }
}

#[test]
fn many_files_need_few_open_ones() {
    let d = directory();
    let at = d.path();
    tiled(at, "0.tx", Compression::None);
    let files: Vec<String> = (0..300).map(|i| format!("{i}.tx")).collect();
    for name in &files[1..] {
        fs::copy(at.join("0.tx"), at.join(name)).expect("ours");
    }
    squares(at, &files.iter().map(String::as_str).collect::<Vec<_>>(), 18);
    ended(&run(at, "scene.pbrt -o a.pfm --texture-memory 500000 --threads 2"), 0, 0);
    for limit in [64, 24] {
        let line = "scene.pbrt -o b.pfm --texture-memory 500000 --threads 2";
        ended(&shell(at, &format!("ulimit -n {limit}"), line), 0, 0);
        same_picture(at, "a.pfm", "b.pfm");
    }
}

#[test]
fn stats_have_the_keys_of_the_contract_and_the_report_their_part() {
    let d = directory();
    let at = d.path();
    tiled(at, "a.tx", Compression::None);
    squares(at, &["a.tx"], 1);
    ended(&run(at, "scene.pbrt -o a.pfm --stats s.json --texture-memory 100000 --threads 1"), 0, 0);
    let all = stats(&at.join("s.json"));
    let cache = &all["texture_cache"];
    for key in [
        "budget",
        "peak",
        "lookups",
        "micro_hits",
        "hits",
        "misses_compulsory",
        "misses_capacity",
        "misses_duplicate",
        "bytes_read",
        "footprint_bytes",
        "read_s",
        "stall_s",
    ] {
        assert!(cache[key].is_number(), "{key}: {}", cache[key]);
    }
    assert_eq!(cache["budget"], 100_000);
    let files = cache["by_file"].as_array().expect("a list");
    assert!(files.len() == 1 && files[0]["file"].as_str().is_some_and(|f| f.ends_with("a.tx")), "{files:?}");
    assert_eq!(files[0]["lookups"], cache["lookups"]);
    let curve = all["miss_ratio"]["texture"].as_array().expect("a list");
    assert!(!curve.is_empty() && curve.iter().all(|p| p[0].is_u64() && p[1].is_f64()), "{curve:?}");
    let report = text(&run(at, "report s.json").stdout);
    for part in [
        "textures  budget 100 kB, peak ",
        "tile look-ups",
        "compulsory",
        "footprint",
        "times the footprint",
        "a.tx: ",
    ] {
        assert!(report.contains(part), "{part}: {report}");
    }
}
