//! Rays that wait on a disk: the picture is the same to the bit, nothing is left whatever ends the program, and what a disk
//! refuses or loses is said in one line.
//!
//! Invariant: every test runs in a directory of its own; what a machine does not allow is skipped and said.

use crate::determinism::everything;
use crate::pages::{least, least_for_rays, make, settings};
use crate::support::render;
use crate::textures_faults::{WEIR, directory, ended, run, same_picture, shell, text, weir};
use std::fs::{self, OpenOptions};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use weir::settings::{Backend, RenderSettings, Schedule};
use weir::stats::RenderStats;
use weir::study::generate::Kind;

#[test]
fn the_picture_is_the_same_wherever_rays_wait() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |i: u32| {
        let at = folder.path().join(i.to_string());
        fs::create_dir(&at).expect("ours");
        at
    };
    let cases = [
        (everything(&at(0)), Schedule::Sorted, 3),
        (make(Kind::City, 20_000, &at(1)), Schedule::Voxel, 3),
        (make(Kind::Terrain, 20_000, &at(2)), Schedule::Voxel, 1),
    ];
    for (scene, schedule, threads) in &cases {
        let whole = RenderSettings {
            schedule: Schedule::Depth,
            backend: Backend::Native,
            spp: Some(10),
            ..settings(folder.path())
        };
        let plain = render(scene, &whole);
        let base = RenderSettings {
            schedule: *schedule,
            page_bytes: Some(4 << 10),
            threads: Some(*threads),
            ray_disk: Some(1 << 30),
            ..whole
        };
        let rays = least_for_rays(scene, &RenderSettings { geometry_memory: Some(1 << 30), ..base.clone() });
        let budget = (*schedule == Schedule::Voxel).then(|| least(scene, &base) + (1 << 20));
        for (ray_memory, ray_disk) in [(rays, 1 << 30), (rays, 300_000), (rays + (1 << 20), 64 << 20)] {
            let settings = RenderSettings {
                geometry_memory: budget,
                ray_memory: Some(ray_memory),
                ray_disk: Some(ray_disk),
                ..base.clone()
            };
            let spilled = render(scene, &settings);
            let stats = &spilled.stats.scheduler;
            let what = format!("{}, {ray_memory} bytes, {ray_disk} on disk", stats.name);
            assert!(spilled.image.pixels == plain.image.pixels, "{what}: another picture");
            assert!(stats.ray_memory_peak <= ray_memory, "{what}: {}", stats.ray_memory_peak);
            assert!(stats.spilled_bytes > 0, "{what}: nothing was spilled");
            assert!(stats.spilled_peak_bytes <= ray_disk.min(stats.spilled_bytes), "{what}");
            assert_eq!(stats.ray_disk, ray_disk, "{what}");
            assert!(spilled.notes.is_empty(), "{what}: {:?}", spilled.notes);
            assert_eq!(plain.stats.rays.closest, spilled.stats.rays.closest, "{what}");
        }
        let settings = RenderSettings { ray_disk: Some(0), ray_memory: Some(rays), ..base };
        assert_eq!(render(scene, &settings).stats.scheduler.spilled_bytes, 0);
    }
    let left = fs::read_dir(folder.path().join("cache")).expect("pages are there");
    let left: Vec<_> =
        left.map(|e| e.expect("readable").file_name()).filter(|n| n != "pages" && n != "locks").collect();
    assert!(left.is_empty(), "{left:?}");
}

/// A scene, and a command line that renders it with as little memory for rays as will do.
fn tight(at: &Path) -> String {
    make(Kind::City, 20_000, at);
    let line = "scene/scene.pbrt --backend native --schedule sorted --threads 2 --max-depth 4 --cache-dir cache --ray-disk";
    let message = ended(&run(at, &format!("{line} 1G --ray-memory 1 -o x.pfm")), 2, 1);
    let least = message.split("--ray-memory ").nth(1).and_then(|rest| rest.split(' ').next());
    format!("{line} 1G --ray-memory {}", least.unwrap_or_else(|| panic!("{message}")))
}

/// The same where no ray waits.
fn at_once(line: &str) -> String {
    line.replace("--schedule sorted", "--schedule depth")
}

/// Names below the cache directory.
fn left(at: &Path) -> Vec<String> {
    let Ok(list) = fs::read_dir(at.join("cache")) else { return Vec::new() };
    list.map(|e| e.expect("readable").file_name().to_string_lossy().into_owned()).collect()
}

/// Starts a render that would last for minutes; the file for its rays, when there are some in it.
#[cfg(target_os = "linux")]
fn spilling(at: &Path, line: &str) -> (Child, PathBuf) {
    let line = format!("{line} --spp 16384 -q -o long.pfm");
    let mut child =
        weir(at, &line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("weir starts");
    let start = Instant::now();
    loop {
        let files = fs::read_dir(format!("/proc/{}/fd", child.id())).into_iter().flatten().flatten();
        let is_it = |path: &PathBuf| {
            let names = fs::read_link(path).is_ok_and(|to| {
                let to = to.to_string_lossy().into_owned();
                to.contains("/cache/") && to.ends_with(" (deleted)")
            });
            names && fs::metadata(path).is_ok_and(|there| there.len() > 0)
        };
        if let Some(file) = files.map(|entry| entry.path()).find(is_it) {
            return (child, file);
        }
        assert!(child.try_wait().expect("a child").is_none(), "it has ended");
        if start.elapsed() > Duration::from_secs(120) {
            let _ = child.kill();
            panic!("nothing was spilled");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[cfg(target_os = "linux")]
#[test]
fn who_is_killed_leaves_nothing() {
    let d = directory();
    let at = d.path();
    let line = tight(at);
    let (mut child, _) = spilling(at, &line);
    // SIGKILL.
    child.kill().expect("ours");
    assert_eq!(child.wait().expect("it ran").code(), None);
    assert_eq!(left(at), [""; 0]);
    assert!(!at.join("long.pfm").exists());
    ended(&run(at, &format!("{line} --spp 16 -q -o a.pfm")), 0, 0);
    ended(&run(at, &format!("{} --spp 16 -q -o b.pfm", at_once(&line))), 0, 0);
    same_picture(at, "a.pfm", "b.pfm");
    assert_eq!(left(at), [""; 0]);
}

#[cfg(target_os = "linux")]
#[test]
fn rays_that_a_disk_has_lost_leave_no_image() {
    let d = directory();
    let at = d.path();
    let (mut child, file) = spilling(at, &tight(at));
    // What was written is not there any more, or is zeros; until something of it is wanted.
    while child.try_wait().expect("a child").is_none() {
        let _ = OpenOptions::new().write(true).open(&file).and_then(|file| file.set_len(0));
        std::thread::sleep(Duration::from_millis(1));
    }
    let message = ended(&child.wait_with_output().expect("it ran"), 3, 1);
    assert!(message.contains("cache") && message.contains("cannot be read again"), "{message}");
    assert!(!at.join("long.pfm").exists());
    assert_eq!(left(at), [""; 0]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_costs_time_alone() {
    let d = directory();
    let at = d.path();
    let line = tight(at);
    ended(&run(at, &format!("{} --spp 32 -q -o a.pfm", at_once(&line))), 0, 0);
    let line = format!("{line} --spp 32 -o b.pfm --stats s.json");
    let check = |output: &Output| {
        let message = ended(output, 0, 1);
        assert!(message.starts_with("warning: ") && message.contains("traced on the spot"), "{message}");
        assert!(message.contains("--cache-dir"), "{message}");
        same_picture(at, "a.pfm", "b.pfm");
        fs::remove_file(at.join("b.pfm")).expect("there");
    };
    fs::create_dir_all(at.join("cache")).expect("ours");
    let mount = "mount -t tmpfs -o size=100k none cache";
    let mounts = |script: &str| {
        Command::new("unshare").current_dir(at).args(["-m", "sh", "-c", script]).output().expect("unshare")
    };
    if mounts(mount).status.success() {
        let output = mounts(&format!("{mount} && {WEIR} {line}; code=$?; ls -A cache; exit $code"));
        check(&output);
        assert!(!text(&output.stdout).contains(".part"));
        // What had room is used all the same.
        let stats: RenderStats =
            serde_json::from_slice(&fs::read(at.join("s.json")).expect("written")).expect("its own");
        assert!(stats.scheduler.spilled_bytes > 0 && stats.scheduler.spilled_peak_bytes < 100 << 10);
    } else {
        eprintln!("left out: a full file system, which this user may not mount");
    }
    // 256 blocks of 512 bytes; the signal that comes with the limit is ignored.
    check(&shell(at, "trap '' XFSZ; ulimit -f 256", &line));
    // A directory that cannot be made.
    fs::write(at.join("file"), "").expect("ours");
    check(&run(at, &line.replace("--cache-dir cache", "--cache-dir file/below")));
    assert_eq!(left(at), [""; 0]);
}

#[cfg(target_os = "linux")]
#[test]
fn too_few_handles_are_said_and_change_no_picture() {
    let d = directory();
    let at = d.path();
    let line = tight(at);
    ended(&run(at, &format!("{} --spp 32 -q -o a.pfm", at_once(&line))), 0, 0);
    let mut done = 0;
    for limit in 4..12 {
        let output = shell(at, &format!("ulimit -n {limit}"), &format!("{line} --spp 32 -o b.pfm"));
        let message = text(&output.stderr);
        assert!(message.lines().count() <= 1, "{limit}: {message}");
        if output.status.success() {
            done += 1;
            same_picture(at, "a.pfm", "b.pfm");
            fs::remove_file(at.join("b.pfm")).expect("there");
        } else {
            assert!(!message.is_empty() && !message.contains("panic"), "{limit}: {message}");
            assert!(!at.join("b.pfm").exists(), "{limit}: {message}");
        }
        assert_eq!(left(at), [""; 0], "{limit}");
    }
    assert!(done > 0, "eleven handles do not do");
}

#[test]
fn a_file_without_room_is_refused_and_much_memory_does_no_harm() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let line = tight(at);
    let line = line.split("--ray-disk").next().expect("it is in it");
    let message = ended(&run(at, &format!("{line} --ray-disk 255K -q -o x.pfm")), 2, 1);
    assert!(message.contains("--ray-disk 261120") && message.contains("262144"), "{message}");
    ended(&run(at, &format!("{line} --ray-disk 1G --ray-memory 1T --spp 1 -q -o x.pfm")), 0, 0);
}
