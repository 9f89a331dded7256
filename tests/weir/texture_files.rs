//! `weir texture` and the conversion cache as processes: files that are whole or absent whatever
//! happens, and memory that does not follow the image's size. That texels are right, the library's own
//! tests show.
//!
//! Invariant: every test runs in a directory of its own.

use crate::support::names;
use std::fs::{self, File};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use weir::scene::Encoding;
use weir::texture::cache_dir::converted;
use weir::texture::convert::Watch;
use weir::texture::read_image;

fn weir(at: &Path, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_weir"));
    command.current_dir(at).args(line.split_ascii_whitespace()).env_remove("RUST_BACKTRACE");
    command
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn succeeds(at: &Path, line: &str) -> String {
    let output = weir(at, line).output().expect("weir starts");
    assert_eq!(output.status.code(), Some(0), "weir {line}: {}", text(&output.stderr));
    text(&output.stdout)
}

#[track_caller]
fn one_line(output: &Output, code: i32) -> String {
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    assert!(output.stdout.is_empty());
    message
}

fn png(at: &Path, name: &str, (w, h): (u32, u32)) {
    let image = image::RgbImage::from_fn(w, h, |x, y| image::Rgb([x as u8, (x * y) as u8, (y * 3) as u8]));
    image.save(at.join(name)).expect("write");
}

/// All zeros, and all hole: it takes no room on the disk.
fn sparse_pfm(path: &Path, width: u64, height: u64) {
    let header = format!("PF\n{width} {height}\n-1.0\n");
    fs::write(path, &header).expect("writable");
    let file = File::options().write(true).open(path).expect("ours");
    file.set_len(header.len() as u64 + width * height * 12).expect("a sparse file");
}

#[test]
fn a_texture_says_what_it_is_and_reads_as_the_image_it_was() {
    let d = tempfile::tempdir().expect("a temporary directory");
    png(d.path(), "a.png", (300, 131));
    let said = succeeds(d.path(), "texture a.png -o a.tx --wrap clamp --encoding gamma:2.2");
    for part in ["300 x 131 texels, 9 levels", "RGB, 8-bit, gamma:2.2", "zip"] {
        assert!(said.contains(part), "{said}");
    }
    assert_eq!(succeeds(d.path(), "texture a.png -o b.exr -q --threads 1"), "");
    succeeds(d.path(), "texture a.png -o c.tif --compression none");
    assert_eq!(names(d.path()), ["a.png", "a.tx", "b.exr", "c.tif"]);
    let said = succeeds(d.path(), "info a.tx");
    for part in ["tiles of 64 x 64, zip", "levels      9", "clamp,clamp", "weir:encoding=2.2"] {
        assert!(said.contains(part), "{said}");
    }
    assert!(succeeds(d.path(), "info c.tif").contains("tiles of 64 x 64, not compressed"));
    let said = succeeds(d.path(), "info b.exr");
    for part in ["tiles of 64 x 64", "levels      9", "periodic,periodic", "weir:read=srgb"] {
        assert!(said.contains(part), "{said}");
    }
    let [png, tx, tif] = ["a.png", "a.tx", "c.tif"].map(|n| read_image(&d.path().join(n)).expect("sound"));
    assert!(png == tx && png == tif);
    // A texture of a texture is the same texture.
    succeeds(d.path(), "texture a.tx -o again.tif --compression none");
    assert_eq!(read_image(&d.path().join("again.tif")).expect("sound"), png);
}

#[test]
fn wrong_requests_are_one_line_and_touch_nothing() {
    let d = tempfile::tempdir().expect("a temporary directory");
    png(d.path(), "a.png", (30, 20));
    fs::copy(d.path().join("a.png"), d.path().join("b.tx")).expect("copy");
    fs::write(d.path().join("old.tx"), b"old").expect("write");
    let whole = fs::read(d.path().join("a.png")).expect("there");
    fs::write(d.path().join("short.png"), &whole[..whole.len() - 30]).expect("write");
    fs::write(d.path().join("text.png"), b"not an image").expect("write");
    fs::write(d.path().join("empty.png"), b"").expect("write");
    let mut wrong = whole.clone();
    wrong[whole.len() / 2] ^= 1;
    fs::write(d.path().join("wrong.png"), wrong).expect("write");
    let before = names(d.path());
    for (line, what) in [
        ("texture a.png -o a.png", "name it .tx, .tif or .exr"),
        ("texture b.tx -o b.tx", "is the input too"),
        ("texture b.tx -o ./b.tx", "is the input too"),
        ("texture a.png -o a.jpg", "name it .tx, .tif or .exr"),
        ("texture a.png -o no/such/a.tx", "no directory"),
        ("texture none.png -o old.tx", "none.png"),
        ("texture short.png -o old.tx", "short.png: the image is cut short"),
        ("texture text.png -o old.tx", "text.png"),
        ("texture empty.png -o old.tx", "empty.png: the file is empty"),
        ("texture wrong.png -o old.tx", "wrong.png"),
        ("texture . -o old.tx", "not a regular file"),
        ("texture a.png -o old.tx --encoding sRGB", "auto, srgb, linear or gamma:G"),
        ("texture a.png -o old.tx --wrap round", "round"),
        ("texture a.png -o old.tx --threads 0", "--threads"),
        ("texture a.png", "--output"),
    ] {
        let output = weir(d.path(), line).output().expect("weir starts");
        let message = one_line(&output, 2);
        assert!(message.contains(what), "{line}: {message}");
    }
    assert_eq!(names(d.path()), before);
    assert_eq!(fs::read(d.path().join("old.tx")).expect("there"), b"old");
}

/// Corpora of damaged images: never a panic, a signal, more than one line, or an output.
#[test]
fn damaged_images_leave_no_texture() {
    let mut seen = 0;
    for folder in ["hard-pngsuite", "exr-valid"] {
        let Some(folder) = crate::support::shared(folder) else { continue };
        let d = tempfile::tempdir().expect("a temporary directory");
        for path in crate::damaged::files(&folder, &["png", "exr"]).into_iter().step_by(4) {
            // Cut in the middle: some formats are whole without their last bytes.
            let bytes = fs::read(&path).expect("there");
            let name = if path.extension().is_some_and(|e| e == "exr") { "cut.exr" } else { "cut.png" };
            fs::write(d.path().join(name), &bytes[..bytes.len() / 2]).expect("write");
            let output = weir(d.path(), &format!("texture {name} -o out.tx")).output().expect("weir starts");
            one_line(&output, 2);
            assert_eq!(names(d.path()).iter().filter(|n| !n.starts_with("cut.")).count(), 0);
            seen += 1;
        }
    }
    eprintln!("{seen} files");
}

/// A shell that bounds the process in `limit`s, then `weir`.
#[cfg(target_os = "linux")]
fn limited(at: &Path, limit: &str, line: &str) -> Output {
    Command::new("sh")
        .current_dir(at)
        .args(["-c", &format!("{limit}; exec \"$@\""), "sh", env!("CARGO_BIN_EXE_weir")])
        .args(line.split_ascii_whitespace())
        .env("RAYON_NUM_THREADS", "2")
        .env("MALLOC_ARENA_MAX", "2")
        .output()
        .expect("sh starts")
}

#[cfg(target_os = "linux")]
#[test]
fn memory_does_not_follow_the_image() {
    let d = tempfile::tempdir().expect("a temporary directory");
    // 1.15 GB of pixels in 640 MiB of address space, of which the program alone has some 300.
    sparse_pfm(&d.path().join("large.pfm"), 12_000, 8_000);
    let output = limited(d.path(), "ulimit -v 655360", "texture large.pfm -o large.tx --threads 2");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("12000 x 8000 texels, 14 levels"));
    // The bound does bound: whole, it does not fit.
    let output = limited(d.path(), "ulimit -v 655360", "info large.pfm");
    assert_ne!(output.status.code(), Some(0));
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_the_old_file_and_nothing_else() {
    let d = tempfile::tempdir().expect("a temporary directory");
    png(d.path(), "a.png", (700, 500));
    fs::write(d.path().join("a.tx"), b"old").expect("write");
    for line in ["texture a.png -o a.tx --compression none", "texture a.png -o a.exr"] {
        // 128 blocks of 512 bytes; the signal that comes with the limit is ignored.
        let output = limited(d.path(), "trap '' XFSZ; ulimit -f 128", line);
        let message = text(&output.stderr);
        assert!(matches!(output.status.code(), Some(2 | 3)), "{message}");
        assert!(message.contains("File too large") && message.lines().count() == 1, "{message}");
        assert_eq!(names(d.path()), ["a.png", "a.tx"]);
        assert_eq!(fs::read(d.path().join("a.tx")).expect("there"), b"old");
    }
}

/// Waits until `process` has written a partial file of some size.
#[cfg(target_os = "linux")]
fn wait_for_partial(process: u32) {
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(60) {
        // Without a name, or under one that nobody knows beforehand.
        let partial = |link: &Path| {
            let name = fs::read_link(link).unwrap_or_default().to_string_lossy().into_owned();
            (name.ends_with(".part") || name.ends_with(" (deleted)"))
                && fs::metadata(link).is_ok_and(|m| m.is_file() && m.len() > 100_000)
        };
        let open = fs::read_dir(format!("/proc/{process}/fd"));
        if open.into_iter().flatten().flatten().any(|entry| partial(&entry.path())) {
            return;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("nothing was being written");
}

#[cfg(target_os = "linux")]
#[test]
fn a_kill_leaves_the_old_file_and_no_trace() {
    let d = tempfile::tempdir().expect("a temporary directory");
    sparse_pfm(&d.path().join("large.pfm"), 12_000, 12_000);
    fs::write(d.path().join("a.tx"), b"old").expect("write");
    for signal in ["-TERM", "-KILL"] {
        let line = "texture large.pfm -o a.tx --compression none --threads 1";
        let mut child = weir(d.path(), line).stderr(Stdio::null()).spawn().expect("weir starts");
        wait_for_partial(child.id());
        let killed = Command::new("kill").args([signal, &child.id().to_string()]).status();
        assert!(killed.expect("kill starts").success());
        assert_ne!(child.wait().expect("it ran").code(), Some(0));
        assert_eq!(fs::read(d.path().join("a.tx")).expect("there"), b"old");
        assert_eq!(names(d.path()), ["a.tx", "large.pfm"], "after {signal}");
    }
}

/// Set in the processes that the next test starts of itself.
const CHILD: &str = "WEIR_TEST_CACHE_CHILD";

#[test]
fn processes_that_want_the_same_file_make_it_once() {
    if let Some(at) = std::env::var_os(CHILD) {
        // The threads of one process, beside those of the others.
        std::thread::scope(|scope| {
            for _ in 0..3 {
                scope.spawn(|| {
                    let at = Path::new(&at);
                    let done =
                        converted(&at.join("cache"), &at.join("a.png"), Encoding::Srgb, 0, Watch::nobody());
                    let done = done.unwrap_or_else(|e| panic!("{e}"));
                    println!("made={} {}", done.made, done.path.display());
                });
            }
        });
        return;
    }
    let d = tempfile::tempdir().expect("a temporary directory");
    png(d.path(), "a.png", (1500, 1100));
    let start = || {
        Command::new(std::env::current_exe().expect("this test"))
            .args(["--exact", "texture_files::processes_that_want_the_same_file_make_it_once", "--nocapture"])
            .env(CHILD, d.path())
            .stdout(Stdio::piped())
            .spawn()
            .expect("it starts again")
    };
    let children = [start(), start(), start()];
    let said: String = children
        .into_iter()
        .map(|child| {
            let output = child.wait_with_output().expect("it ran");
            assert!(output.status.success());
            text(&output.stdout)
        })
        .collect();
    assert_eq!(said.matches("made=true").count(), 1, "{said}");
    assert_eq!(said.matches("made=false").count(), 8, "{said}");
    let cache: Vec<String> = names(&d.path().join("cache"));
    assert_eq!(cache.iter().filter(|n| n.ends_with(".tx")).count(), 1, "{cache:?}");
    assert!(!cache.iter().any(|n| n.ends_with(".part")), "{cache:?}");
    let file = d.path().join("cache").join(cache.iter().find(|n| n.ends_with(".tx")).expect("one"));
    assert_eq!(read_image(&file).expect("sound"), read_image(&d.path().join("a.png")).expect("sound"));
}

#[cfg(target_os = "linux")]
#[test]
fn a_crashed_holder_of_a_lock_keeps_nobody_out() {
    let d = tempfile::tempdir().expect("a temporary directory");
    png(d.path(), "a.png", (30, 20));
    let cache = d.path().join("cache");
    let done = converted(&cache, &d.path().join("a.png"), Encoding::Srgb, 0, Watch::nobody()).expect("made");
    fs::remove_file(&done.path).expect("ours");
    // Lock files stay; what locked them does not.
    let locks = names(&cache.join("locks"));
    assert_eq!(locks.len(), 1);
    let held = File::options().append(true).open(cache.join("locks").join(&locks[0])).expect("there");
    held.lock().expect("free");
    let start = Instant::now();
    let waiting = std::thread::scope(|scope| {
        let thread = scope.spawn(|| {
            converted(&cache, &d.path().join("a.png"), Encoding::Srgb, 0, Watch::nobody()).expect("made")
        });
        std::thread::sleep(Duration::from_millis(200));
        assert!(!thread.is_finished(), "the lock does not lock");
        // As the system does when a process ends.
        drop(held);
        thread.join().expect("no panic")
    });
    assert!(waiting.made && start.elapsed() < Duration::from_secs(60));
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_or_read_only_cache_names_the_option_that_helps() {
    let d = tempfile::tempdir().expect("a temporary directory");
    png(d.path(), "a.png", (300, 200));
    // Nobody, not even root, makes a directory there.
    let e = converted(Path::new("/proc/weir"), &d.path().join("a.png"), Encoding::Srgb, 0, Watch::nobody())
        .expect_err("must fail");
    let message = e.to_string();
    assert!(message.contains("--cache-dir") && message.contains("/proc/weir"), "{message}");
    assert!(e.exit_code() == 3 && !message.contains('\n'), "{message}");
}
