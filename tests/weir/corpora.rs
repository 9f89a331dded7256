//! Other people's difficult files through the program itself, a process each: exit code 0, or 2 with
//! one line on stderr; never a signal, a panic, or more time and memory than stated here.
//!
//! Invariant: memory is bounded from outside, by the address space that a process may have. A reader
//! that asks for more is refused by the system, and the test sees how it ends.

use crate::damaged::files;
use crate::support::shared;
use std::fs::{self, File};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Address space of a process [KiB]: 1 GiB. The program with Embree and two threads has some 300 MiB
/// of it before it reads anything; the largest file of the corpora is 2 MB.
const MOST_KIB: u64 = 1 << 20;
const MOST_TIME: Duration = Duration::from_secs(10);

/// How the program ended: its code, and what it said on stderr but for warnings.
struct End {
    code: i32,
    message: String,
}

/// Runs `weir ARGUMENTS` in `folder` under both bounds.
fn run(folder: &Path, arguments: &[&str]) -> End {
    let (out, err) = (folder.join("stdout"), folder.join("stderr"));
    let create = |path: &Path| File::create(path).expect("writable");
    let mut child = Command::new("sh")
        .args(["-c", &format!("ulimit -v {MOST_KIB}; exec \"$@\""), "sh", env!("CARGO_BIN_EXE_weir")])
        .args(arguments)
        .current_dir(folder)
        // Address space is also reserved for every thread and its allocator's arena.
        .env("RAYON_NUM_THREADS", "2")
        .env("MALLOC_ARENA_MAX", "2")
        .stdin(Stdio::null())
        .stdout(create(&out))
        .stderr(create(&err))
        .spawn()
        .expect("sh starts");
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().expect("our child") {
            break status;
        }
        if start.elapsed() > MOST_TIME {
            let _ = child.kill();
            let _ = child.wait();
            panic!("weir {arguments:?}: still running after {MOST_TIME:?}");
        }
        sleep(Duration::from_millis(2));
    };
    let said = String::from_utf8_lossy(&fs::read(&err).expect("written")).into_owned();
    let lines: Vec<&str> = said.lines().filter(|l| !l.contains(": warning: ")).collect();
    let message = lines.join("\n");
    let Some(code) = status.code() else { panic!("weir {arguments:?}: {status}: {message}") };
    assert!(code == 0 || code == 2, "weir {arguments:?}: exit code {code}: {message}");
    assert!(!message.contains("panicked"), "weir {arguments:?}: {message}");
    if code == 2 {
        assert_eq!(lines.len(), 1, "weir {arguments:?}: not one line: {message}");
        assert_eq!(fs::read(&out).expect("written"), b"", "weir {arguments:?}");
    }
    End { code, message }
}

/// Corpora whose files any reader of ours claims, by extension.
const EXTENSIONS: [&str; 11] = ["obj", "ply", "png", "jpg", "jpeg", "exr", "hdr", "bmp", "tga", "tif", "pfm"];
const CORPORA: [&str; 5] = ["hard-assimp", "hard-obj-tinyobj", "hard-obj2gltf", "hard-pngsuite", "exr-valid"];

#[test]
fn the_bound_on_memory_bounds() {
    // A PFM of 12000×10000 needs 1.4 GB; its file is honest, and all hole.
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("large.pfm");
    let header = b"PF\n12000 10000\n-1.0\n";
    fs::write(&path, header).expect("writable");
    let file = File::options().write(true).open(&path).expect("ours");
    file.set_len(header.len() as u64 + 12_000 * 10_000 * 12).expect("a sparse file");
    let status = Command::new("sh")
        .args(["-c", &format!("ulimit -v {MOST_KIB}; exec \"$@\""), "sh", env!("CARGO_BIN_EXE_weir"), "info"])
        .arg(&path)
        .env("RAYON_NUM_THREADS", "2")
        .env("MALLOC_ARENA_MAX", "2")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .expect("sh starts");
    assert!(!status.success(), "{status}: 1.4 GB within 1 GiB");
}

#[test]
fn info_ends_well_on_every_file() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (mut read, mut refused) = (0, 0);
    for corpus in CORPORA {
        let Some(corpus) = shared(corpus) else { continue };
        let paths = files(&corpus, &EXTENSIONS);
        assert!(paths.len() > 10, "{}", corpus.display());
        for path in paths {
            let path = fs::canonicalize(path).expect("it was listed").to_string_lossy().into_owned();
            let end = run(folder.path(), &["info", &path]);
            if end.code == 0 {
                read += 1;
                continue;
            }
            refused += 1;
            // Whose fault it is comes first.
            let named = end
                .message
                .contains(Path::new(&path).file_name().expect("a file").to_string_lossy().as_ref());
            assert!(named || end.message.contains(".mtl"), "{path}: {}", end.message);
        }
    }
    eprintln!("{read} read, {refused} refused");
    assert!(read == 0 || read > 250 && refused < read / 5, "{read} read, {refused} refused");
}

#[test]
fn every_model_renders_or_is_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (mut rendered, mut refused) = (0, 0);
    for corpus in ["hard-assimp", "hard-obj-tinyobj", "hard-obj2gltf", "obj-cornell", "obj-spot"] {
        let Some(corpus) = shared(corpus) else { continue };
        for path in files(&corpus, &["obj", "ply"]) {
            let path = fs::canonicalize(path).expect("it was listed").to_string_lossy().into_owned();
            let line = ["render", &path, "--spp", "1", "--size", "32x32", "--threads", "2", "-o", "out.pfm"];
            let end = run(folder.path(), &line);
            let image = folder.path().join("out.pfm");
            if end.code == 0 {
                rendered += 1;
                let image = weir::film::read::read_image(&image).unwrap_or_else(|e| panic!("{path}: {e}"));
                assert_eq!((image.width, image.height, image.non_finite_pixels()), (32, 32, 0), "{path}");
                assert!(image.pixels.iter().flatten().any(|&c| c > 0.0), "{path}: black");
            } else {
                refused += 1;
            }
            if image.exists() {
                fs::remove_file(&image).expect("ours");
            }
            // What was half written is gone.
            let left = fs::read_dir(folder.path()).expect("readable").count();
            assert_eq!(left, 2, "{path}: files are left behind");
        }
    }
    eprintln!("{rendered} rendered, {refused} refused");
    assert!(
        rendered == 0 || rendered > 80 && refused < rendered / 2,
        "{rendered} rendered, {refused} refused"
    );
}

/// A damaged texture names the scene's line that asked for it.
#[test]
fn a_scene_with_a_damaged_texture_is_refused_in_one_line() {
    let Some(corpus) = shared("hard-pngsuite") else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut tried = 0;
    for path in files(&corpus, &["png"]) {
        let name = path.file_name().expect("a file").to_string_lossy().into_owned();
        let damaged = name.starts_with('x');
        // Each damaged one, and some of the good.
        if !damaged && !name.starts_with("tp") {
            continue;
        }
        let path = fs::canonicalize(&path).expect("it was listed");
        let scene = format!(
            "Camera \"perspective\"\nWorldBegin\nLightSource \"infinite\"\n\
             Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"{}\"\n\
             Material \"diffuse\" \"texture reflectance\" \"t\"\nTranslate 0 0 3\nShape \"sphere\"\n",
            path.display()
        );
        fs::write(folder.path().join("a.pbrt"), scene).expect("writable");
        let line = ["a.pbrt", "--spp", "1", "--size", "16x16", "--threads", "1", "-o", "out.pfm"];
        let end = run(folder.path(), &line);
        assert_eq!(end.code, if damaged { 2 } else { 0 }, "{name}: {}", end.message);
        assert!(!damaged || end.message.starts_with("a.pbrt:4:"), "{name}: {}", end.message);
        tried += 1;
    }
    assert!(tried > 15, "{tried}");
}
