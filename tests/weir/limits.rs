//! Where the system sets a limit on the size of files, what does not fit is one line and exit code 3, and what was there
//! before is there afterwards.

use crate::support::names;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Runs the program under a limit of so many blocks, which are of 512 bytes or of 1024; its exit code and what it said.
fn limited(at: &Path, blocks: u32, line: &str) -> (Option<i32>, String) {
    let program = env!("CARGO_BIN_EXE_weir");
    let mut shell = Command::new("sh");
    let script = format!("ulimit -f {blocks} && exec \"$0\" {line}");
    shell.current_dir(at).args(["-c", &script, program]).env_remove("RUST_BACKTRACE");
    let output = shell.output().expect("a shell");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

const SCENE: &str = "Film \"rgb\" \"integer xresolution\" 64 \"integer yresolution\" 64\nWorldBegin\n\
                     LightSource \"infinite\"\nShape \"sphere\" \"float radius\" 0.5\n";

#[test]
fn an_image_that_does_not_fit_is_one_line_and_no_file() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = folder.path();
    let noisy = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.pbrt");
    for image in ["a.pfm", "a.exr", "a.png"] {
        fs::write(at.join(image), "old").expect("writable");
        let (code, said) =
            limited(at, 4, &format!("'{}' --spp 1 -q --size 96x96 -o {image}", noisy.display()));
        assert_eq!((code, said.lines().count()), (Some(3), 1), "{said}");
        assert!(said.starts_with(&format!("weir: {image}: ")) && said.contains("ulimit -f"), "{said}");
        assert_eq!(fs::read(at.join(image)).expect("there"), b"old");
        assert_eq!(names(at), [image]);
        fs::remove_file(at.join(image)).expect("there");
    }
    // What fits is written.
    let (code, said) = limited(at, 4, &format!("'{}' --spp 1 -q --size 8x8 -o a.pfm", noisy.display()));
    assert_eq!((code, said.as_str()), (Some(0), ""));
}

#[test]
fn records_and_standard_output_are_held_to_it_too() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = folder.path();
    fs::write(at.join("s.pbrt"), SCENE).expect("writable");
    let (code, said) = limited(at, 4, "s.pbrt --spp 1 -q --size 8x8 -o a.pfm --report r.html");
    assert!(code == Some(3) && said.starts_with("weir: r.html: ") && said.lines().count() == 1, "{said}");
    assert_eq!(names(at), ["a.pfm", "s.pbrt"]);
    let (code, said) = limited(at, 1, "plan s.pbrt --json > plan.json");
    assert!(code == Some(3) && said.starts_with("weir: standard output: "), "{code:?} {said}");
}

#[test]
fn a_checkpoint_that_does_not_fit_stops_no_render() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = folder.path();
    fs::write(at.join("s.pbrt"), SCENE).expect("writable");
    // Where nothing is lit the image is small, and a checkpoint is not.
    fs::write(at.join("dark.pbrt"), SCENE.replace("LightSource \"infinite\"\n", "")).expect("writable");
    let (code, said) = limited(at, 4, "dark.pbrt --spp 2 -q -o a.png --resume");
    assert_eq!(code, Some(0), "{said}");
    assert!(
        said.lines().count() == 1 && said.starts_with("the checkpoint was not written: a.png.weir: "),
        "{said}"
    );
    assert_eq!(names(at), ["a.png", "dark.pbrt", "s.pbrt"]);
}
