//! Tiled copies of plain images under a render: directories that are full or closed, two renders that
//! want one copy, copies that were damaged since. (Files that are tiled already are in
//! `textures_faults`.)
//!
//! Invariant: every test runs in a directory of its own; what a machine does not allow is skipped
//! and said.

use crate::textures::png;
use crate::textures_faults::{
    WEIR, as_nobody, directory, ended, first_offset, run, same_picture, shell, squares, text, weir,
};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// Forces tiled copies of every plain image below, and is enough for their tiles.
const TIGHT: &str = "--texture-memory 100000 --threads 1 --cache-dir cache";

/// Files of a directory that end so.
fn names(at: &Path, end: &str) -> Vec<String> {
    let Ok(entries) = fs::read_dir(at) else { return Vec::new() };
    let names = entries.map(|e| e.expect("readable").file_name().to_string_lossy().into_owned());
    names.filter(|n| n.ends_with(end)).collect()
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_under_the_cache_directory_is_said_and_leaves_nothing() {
    let d = directory();
    let at = d.path();
    png(&at.join("a.png"), (300, 200), 3);
    squares(at, &["a.png"], 1);
    fs::create_dir(at.join("cache")).expect("ours");
    let line = format!("scene.pbrt -o a.pfm {TIGHT}");
    let check = |output: &Output| {
        let message = ended(output, 3, 1);
        assert!(message.contains("--cache-dir") && message.contains("a.png"), "{message}");
        assert!(!at.join("a.pfm").exists());
    };
    let mount = "mount -t tmpfs -o size=64k none cache";
    let mounts = |script: &str| {
        Command::new("unshare").current_dir(at).args(["-m", "sh", "-c", script]).output().expect("unshare")
    };
    if mounts(mount).status.success() {
        let output = mounts(&format!("{mount} && {WEIR} {line}; code=$?; ls -A cache; exit $code"));
        check(&output);
        let left = text(&output.stdout);
        assert!(!left.contains(".tx") && !left.contains(".part"), "{left}");
    } else {
        eprintln!("left out: a full file system, which this user may not mount");
    }
    // 128 blocks of 512 bytes; the signal that comes with the limit is ignored.
    check(&shell(at, "trap '' XFSZ; ulimit -f 128", &line));
    assert!(names(&at.join("cache"), ".tx").is_empty() && names(&at.join("cache"), ".part").is_empty());
    ended(&run(at, &line), 0, 0);
}

#[test]
fn a_closed_cache_directory_serves_what_it_has() {
    let d = directory();
    let at = d.path();
    png(&at.join("a.png"), (300, 200), 3);
    squares(at, &["a.png"], 1);
    let cache = at.join("cache");
    fs::create_dir(&cache).expect("ours");
    let close = || fs::set_permissions(&cache, fs::Permissions::from_mode(0o555)).expect("ours");
    close();
    let line = format!("scene.pbrt {TIGHT}");
    let Some(output) = as_nobody(at, &format!("{line} -o b.pfm")) else { return };
    let message = ended(&output, 3, 1);
    assert!(message.contains("--cache-dir") && message.contains("denied"), "{message}");
    assert!(!at.join("b.pfm").exists());
    fs::set_permissions(&cache, fs::Permissions::from_mode(0o755)).expect("ours");
    ended(&run(at, &format!("{line} -o a.pfm")), 0, 0);
    close();
    let Some(output) = as_nobody(at, &format!("{line} -o b.pfm")) else { return };
    ended(&output, 0, 0);
    same_picture(at, "a.pfm", "b.pfm");
    fs::set_permissions(&cache, fs::Permissions::from_mode(0o755)).expect("ours");
}

#[test]
fn two_renders_that_want_the_same_copy_make_one() {
    let d = directory();
    let at = d.path();
    png(&at.join("a.png"), (1500, 1100), 3);
    squares(at, &["a.png"], 1);
    let start = |name: &str| {
        let mut command = weir(at, &format!("scene.pbrt -q -o {name} {TIGHT}"));
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("weir starts")
    };
    for child in [start("a.pfm"), start("b.pfm")] {
        ended(&child.wait_with_output().expect("it ran"), 0, 0);
    }
    same_picture(at, "a.pfm", "b.pfm");
    assert_eq!(names(&at.join("cache"), ".tx").len(), 1);
    assert!(names(&at.join("cache"), ".part").is_empty());
    // The same as with no copy at all.
    ended(&run(at, "scene.pbrt -o c.pfm --texture-memory 1G"), 0, 0);
    same_picture(at, "a.pfm", "c.pfm");
}

#[test]
fn a_damaged_copy_is_made_again_with_a_note() {
    let d = directory();
    let at = d.path();
    png(&at.join("a.png"), (300, 200), 3);
    squares(at, &["a.png"], 1);
    let line = format!("scene.pbrt {TIGHT} -o");
    ended(&run(at, &format!("{line} a.pfm")), 0, 0);
    let copies = names(&at.join("cache"), ".tx");
    let copy = at.join("cache").join(&copies[0]);
    let whole = fs::read(&copy).expect("there");
    let mut header = whole.clone();
    header[..8].fill(0);
    for damaged in [&whole[..whole.len() / 2], &header, b""] {
        fs::write(&copy, damaged).expect("ours");
        let message = ended(&run(at, &format!("{line} b.pfm")), 0, 1);
        assert!(message.contains(&copies[0]) && message.contains("made again from"), "{message}");
        same_picture(at, "a.pfm", "b.pfm");
        ended(&run(at, &format!("{line} b.pfm")), 0, 0);
        assert_eq!(fs::read(&copy).expect("there"), whole);
    }
    // Of the right length, its own words intact: found out at the tile, and the copy is named.
    let mut index = whole.clone();
    let entry = first_offset(&index);
    index[entry..entry + 4].copy_from_slice(&0x7fff_0000u32.to_le_bytes());
    fs::write(&copy, index).expect("ours");
    let message = ended(&run(at, &format!("{line} b.pfm")), 2, 1);
    assert!(message.contains(&copies[0]), "{message}");
}

#[test]
fn texels_that_are_no_numbers_are_told_when_a_copy_is_made() {
    let d = directory();
    let at = d.path();
    let numbers = (0..150 * 100 * 3).map(|i| if i == 30_000 { f32::NAN } else { 0.5 });
    let mut data = b"PF\n150 100\n-1.0\n".to_vec();
    data.extend(numbers.flat_map(f32::to_le_bytes));
    fs::write(at.join("a.pfm"), data).expect("ours");
    squares(at, &["a.pfm"], 1);
    let message = ended(&run(at, &format!("scene.pbrt -o b.pfm {TIGHT}")), 0, 1);
    assert!(message.contains("a.pfm: 1 texel is infinite or not a number"), "{message}");
}
