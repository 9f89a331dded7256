//! The program as a person or a script meets it: exit codes, one-line errors, files that are whole.
//!
//! Invariant: every test runs in a directory of its own and leaves nothing behind.
//! Never: judges what a picture shows; the library's tests do.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A lit sphere, 40 by 30 pixels.
const SCENE: &str = r#"LookAt 0 0 -5  0 0 0  0 1 0
Camera "perspective" "float fov" 40
Film "rgb" "integer xresolution" 40 "integer yresolution" 30 "string filename" "deep/lit.png"
Sampler "zsobol" "integer pixelsamples" 4
WorldBegin
LightSource "infinite" "rgb L" [ 1 1 1 ]
Material "diffuse" "rgb reflectance" [ 0.5 0.25 0.1 ]
Shape "sphere"
"#;

fn directory() -> TempDir {
    let directory = tempfile::tempdir().expect("a temporary directory");
    fs::write(directory.path().join("lit.pbrt"), SCENE).expect("writable");
    directory
}

fn weir(at: &Path, arguments: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_weir"));
    command.current_dir(at).args(arguments).env_remove("RUST_BACKTRACE");
    command
}

fn run(at: &Path, line: &str) -> Output {
    weir(at, line.split_ascii_whitespace()).output().expect("weir starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn succeeds(at: &Path, line: &str) -> String {
    let output = run(at, line);
    assert_eq!(output.status.code(), Some(0), "weir {line}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// Ends with `code` and says so in one line on stderr, and nothing on stdout.
fn fails(at: &Path, line: &str, code: i32) -> String {
    let output = run(at, line);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "weir {line}: {message}");
    assert_eq!(message.trim_end().lines().count(), 1, "weir {line}: {message}");
    assert!(output.stdout.is_empty(), "weir {line}");
    message
}

fn names(at: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(at)
        .expect("readable")
        .map(|entry| entry.expect("readable").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

#[test]
fn renders_into_every_named_file_and_says_so() {
    let d = directory();
    let out = succeeds(d.path(), "lit.pbrt -o a.exr -o b.png -o c.pfm --stats s.json --spp 2");
    let lines: Vec<&str> = out.lines().collect();
    assert_eq!(lines.len(), 5, "{out}");
    assert!(lines[0].starts_with("wrote a.exr: 40x30, 2 samples per pixel"), "{out}");
    assert!(lines[4].contains("samples/s"), "{out}");
    assert_eq!(names(d.path()), ["a.exr", "b.png", "c.pfm", "lit.pbrt", "s.json"]);
    let stats: serde_json::Value =
        serde_json::from_slice(&fs::read(d.path().join("s.json")).expect("written")).expect("JSON");
    assert_eq!(stats["image"]["samples"], 40 * 30 * 2);
    assert_eq!(stats["image"]["width"], 40);
    assert!(stats["time"]["total_s"].as_f64() > stats["time"]["render_s"].as_f64());
    let report = succeeds(d.path(), "report s.json");
    assert!(report.contains("lit.pbrt") && report.contains("40 × 30"), "{report}");
    let info = succeeds(d.path(), "info a.exr");
    assert!(info.contains("40 x 30") && info.contains("weir.spp = 2"), "{info}");
    // The same picture in all three, up to what 8 bits hold.
    assert!(succeeds(d.path(), "diff c.pfm a.exr").contains("identical"));
    succeeds(d.path(), "diff b.png a.exr --fail-above 0.001");
}

#[test]
fn the_default_output_has_the_scenes_name_and_stays_here() {
    let d = directory();
    assert!(succeeds(d.path(), "lit.pbrt").starts_with("wrote lit.png: 40x30, 4 samples"));
    assert_eq!(names(d.path()), ["lit.pbrt", "lit.png"]);
}

#[test]
fn quiet_says_nothing() {
    let d = directory();
    let output = run(d.path(), "render lit.pbrt -q --spp 1");
    assert_eq!(output.status.code(), Some(0));
    assert!(output.stdout.is_empty() && output.stderr.is_empty());
}

#[test]
fn a_crop_keeps_its_place_in_the_frame() {
    let d = directory();
    succeeds(d.path(), "lit.pbrt --spp 1 --crop 10,5,30,15 -o a.exr");
    let info = succeeds(d.path(), "info a.exr");
    assert!(info.contains("20 x 10 at 10,5 of 40 x 30 at 0,0"), "{info}");
}

#[test]
fn wrong_input_is_one_line_and_2() {
    let d = directory();
    let at = d.path();
    fs::write(at.join("bad.pbrt"), "Camera \"perspective\"\nWorldBegin\nShap \"sphere\"\n")
        .expect("writable");
    fs::write(at.join("cut.exr"), b"v/1\x01").expect("writable");
    fs::write(at.join("bad.json"), "{\n \"weir\": 3").expect("writable");
    fs::write(at.join("odd.xyz"), "").expect("writable");
    assert!(fails(at, "bad.pbrt -o a.exr", 2).starts_with("bad.pbrt:3:1: "));
    assert!(fails(at, "bad.json.pbrt", 2).contains("bad.json.pbrt"));
    assert!(fails(at, "report bad.json", 2).starts_with("bad.json:2:"));
    assert!(fails(at, "info odd.xyz", 2).contains(".pbrt"));
    assert!(fails(at, "info missing.png", 2).contains("missing.png"));
    assert!(fails(at, "diff cut.exr cut.exr", 2).starts_with("cut.exr: "));
    assert!(fails(at, "lit.pbrt --spp none", 2).contains("--spp"));
    assert!(fails(at, "", 2).contains("weir --help"));
    // Outputs are looked at before the scene is.
    assert!(fails(at, "missing.pbrt -o a.tga", 2).contains(".exr, .png or .pfm"));
    assert!(fails(at, "missing.pbrt -o no/such/a.exr", 2).contains("no directory"));
    assert!(fails(at, "missing.pbrt --stats no/such/s.json", 2).contains("no directory"));
}

#[test]
fn a_failed_render_leaves_the_old_image() {
    let d = directory();
    fs::write(d.path().join("a.exr"), "precious").expect("writable");
    fails(d.path(), "missing.pbrt -o a.exr", 2);
    assert_eq!(fs::read(d.path().join("a.exr")).expect("there"), b"precious");
    assert_eq!(names(d.path()), ["a.exr", "lit.pbrt"]);
}

#[cfg(unix)]
#[test]
fn nothing_is_written_over_the_scene() {
    let d = directory();
    let at = d.path();
    for link in ["link.json", "link.exr", "lit.png"] {
        std::os::unix::fs::symlink("lit.pbrt", at.join(link)).expect("a link");
    }
    fs::hard_link(at.join("lit.pbrt"), at.join("hard.json")).expect("a second name");
    let here = at.display();
    // The last would write the scene's own name for its image.
    for line in [
        "lit.pbrt -o a.exr --stats lit.pbrt",
        "lit.pbrt -o a.exr --stats ./lit.pbrt",
        &format!("lit.pbrt -o a.exr --stats {here}/lit.pbrt"),
        "lit.pbrt -o a.exr --stats link.json",
        "lit.pbrt -o a.exr --stats hard.json",
        "lit.pbrt -o lit.pbrt",
        "lit.pbrt -o a.exr -o link.exr",
        "link.json -o lit.pbrt",
        "lit.pbrt",
    ] {
        let message = fails(at, line, 2);
        assert!(message.contains("is the scene too; name another file"), "{line}: {message}");
    }
    assert_eq!(fs::read_to_string(at.join("lit.pbrt")).expect("there"), SCENE);
    assert_eq!(names(at), ["hard.json", "link.exr", "link.json", "lit.pbrt", "lit.png"]);
    fs::write(at.join("old.json"), "").expect("writable");
    succeeds(at, "lit.pbrt --spp 1 -o a.exr --stats old.json");
}

#[test]
fn diff_gives_its_verdict_as_exit_code() {
    let d = directory();
    let at = d.path();
    succeeds(at, "lit.pbrt --spp 1 -o a.pfm");
    succeeds(at, "lit.pbrt --spp 1 --size 20x30 -o small.pfm");
    let mut bytes = fs::read(at.join("a.pfm")).expect("there");
    let head = b"PF\n40 30\n-1.0\n".len();
    for float in bytes[head..].chunks_exact_mut(4) {
        let value = f32::from_le_bytes([float[0], float[1], float[2], float[3]]) * 2.0;
        float.copy_from_slice(&value.to_le_bytes());
    }
    fs::write(at.join("twice.pfm"), bytes).expect("writable");
    succeeds(at, "diff a.pfm a.pfm --fail-above 0");
    let json: serde_json::Value =
        serde_json::from_str(&succeeds(at, "diff twice.pfm a.pfm --json")).expect("JSON");
    let ratio = json["mean_ratio"]["luminance"].as_f64().expect("a number");
    assert!((ratio - 2.0).abs() < 1e-6, "{json}");
    assert_eq!(json["agreement"]["agree"], false);
    assert_eq!(json["relmse_epsilon"], 0.01);
    let output = run(at, "diff twice.pfm a.pfm --fail-above 0.001");
    assert_eq!(output.status.code(), Some(1));
    assert!(fails(at, "diff small.pfm a.pfm", 2).contains("20×30"));
}

#[test]
fn info_describes_a_scene() {
    let d = directory();
    let info = succeeds(d.path(), "info lit.pbrt");
    for needed in ["perspective", "40 x 30", "1: 1 sphere", "1 constant sky", "4 per pixel"] {
        assert!(info.contains(needed), "{needed} is missing in:\n{info}");
    }
}

#[test]
fn a_closed_pipe_is_no_error() {
    let d = directory();
    let mut child = weir(d.path(), ["info", "lit.pbrt"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("weir starts");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(0));
    assert!(output.stderr.is_empty(), "{}", text(&output.stderr));
}

/// What stands in the place of a file and is none, by name: pipes, directories, sockets.
#[cfg(unix)]
fn put_no_file(at: &Path, kind: &str, name: &str) {
    let path = at.join(name);
    match kind {
        "pipe" => {
            let mode = rustix::fs::Mode::from_raw_mode(0o600);
            rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, mode, 0).expect("a pipe");
        }
        "directory" => fs::create_dir(&path).expect("a directory"),
        _ => drop(std::os::unix::net::UnixListener::bind(&path).expect("a socket")),
    }
}

#[cfg(unix)]
#[test]
fn what_is_no_file_is_refused_and_not_waited_for() {
    for kind in ["pipe", "directory", "socket"] {
        let d = directory();
        let at = d.path();
        for name in ["a.pbrt", "a.pbrt.gz", "a.obj", "a.ply", "a.ply.gz", "a.png", "a.tx"] {
            put_no_file(at, kind, name);
            for command in ["info", "render"] {
                if command == "render" && matches!(name, "a.png" | "a.tx") {
                    continue;
                }
                let message = fails_soon(weir(at, [command, name]));
                assert!(message.starts_with(name) && message.contains("regular file"), "{kind}: {message}");
            }
        }
        fs::write(at.join("outer.pbrt"), "Include \"a.pbrt\"\n").expect("writable");
        let message = fails_soon(weir(at, ["info", "outer.pbrt"]));
        assert!(message.starts_with("outer.pbrt:1:") && message.contains("no file"), "{kind}: {message}");
    }
}

/// Ends with 2 before anybody would think that it waits, and says why in one line.
#[cfg(unix)]
fn fails_soon(mut command: Command) -> String {
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("weir starts");
    let start = Instant::now();
    while child.try_wait().expect("our child").is_none() {
        if start.elapsed() > Duration::from_secs(30) {
            let _ = child.kill();
            panic!("{command:?} waits");
        }
        sleep(Duration::from_millis(5));
    }
    let output = child.wait_with_output().expect("our child");
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{command:?}: {message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{command:?}: {message}");
    message
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_exhausted_resource() {
    let d = directory();
    let full = fs::OpenOptions::new().write(true).open("/dev/full").expect("Linux has it");
    let output = weir(d.path(), ["info", "lit.pbrt"]).stdout(full).output().expect("weir starts");
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
}

#[cfg(unix)]
mod signals {
    use super::*;

    /// Renders without an end in sight.
    fn endless(at: &Path) -> Child {
        let weir = weir(at, ["lit.pbrt", "-o", "a.exr", "--spp", "16777216", "--stats", "s.json"]);
        // Whoever runs the tests in the background has them ignore what is sent here.
        Command::new("env")
            .arg("--default-signal=INT,HUP,TERM")
            .arg(weir.get_program())
            .args(weir.get_args())
            .current_dir(at)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("weir starts")
    }

    fn send(signal: &str, child: &Child) {
        // The shell's own: a bare system has no program of that name.
        let command = format!("kill {signal} {}", child.id());
        let status = Command::new("sh").args(["-c", &command]).status();
        assert!(status.expect("a shell exists").success());
    }

    fn ends(mut child: Child) -> Output {
        let start = Instant::now();
        while child.try_wait().expect("our child").is_none() {
            if start.elapsed() > Duration::from_secs(30) {
                // Its own error says more than a test that hangs.
                let _ = child.kill();
                panic!("weir did not stop within 30 s of the signal");
            }
            sleep(Duration::from_millis(20));
        }
        child.wait_with_output().expect("our child")
    }

    #[test]
    fn the_first_writes_what_is_done() {
        for signal in ["-INT", "-TERM"] {
            let d = directory();
            // Until it renders, a signal rightly ends it with 130: then give it more time.
            let output = [1, 4, 16].iter().find_map(|&seconds| {
                let child = endless(d.path());
                sleep(Duration::from_secs(seconds));
                send(signal, &child);
                Some(ends(child)).filter(|output| output.status.code() != Some(130))
            });
            let output = output.expect("it renders within 16 s");
            let message = text(&output.stderr);
            assert_eq!(output.status.code(), Some(0), "{message}");
            assert!(message.contains("of 16777216 samples per pixel"), "{message}");
            assert!(text(&output.stdout).starts_with("wrote a.exr"));
            assert_eq!(names(d.path()), ["a.exr", "lit.pbrt", "s.json"]);
            assert!(succeeds(d.path(), "info a.exr").contains("weir.interrupted = yes"));
        }
    }

    #[test]
    fn one_too_early_ends_it_and_leaves_nothing() {
        let d = directory();
        fs::write(d.path().join("a.exr"), "precious").expect("writable");
        let child = endless(d.path());
        // Within the first milliseconds there is either no handler yet or nothing to write; later
        // the second ends it.
        send("-INT", &child);
        let mut child = child;
        let start = Instant::now();
        while child.try_wait().expect("our child").is_none() && start.elapsed() < Duration::from_secs(30) {
            send("-INT", &child);
            sleep(Duration::from_millis(5));
        }
        let output = ends(child);
        // No code at all: before the handler the system ends it.
        assert!(matches!(output.status.code(), Some(130 | 0) | None), "{}", text(&output.stderr));
        let left = names(d.path());
        assert!(left.iter().all(|name| !name.starts_with(".weir")), "{left:?}");
        if fs::read(d.path().join("a.exr")).expect("there") != b"precious" {
            succeeds(d.path(), "info a.exr");
        }
    }
}
