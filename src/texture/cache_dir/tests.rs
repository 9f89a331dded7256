//! The conversion cache: what it keeps, what it makes again, and what it does under contention.

use super::lock::PATIENCE;
use super::*;
use std::fs::File;
use std::sync::atomic::{AtomicU64, Ordering};

fn source(directory: &Path, seed: u8) -> PathBuf {
    let path = directory.join(format!("s{seed}.pfm"));
    let mut file = b"PF\n90 70\n-1\n".to_vec();
    file.extend((0..90 * 70 * 3).flat_map(|i| (i as f32 * 0.01 + f32::from(seed)).to_le_bytes()));
    fs::write(&path, file).expect("write");
    path
}

fn names(directory: &Path) -> Vec<String> {
    let entries = fs::read_dir(directory).expect("the test's own directory");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("readable").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn convert(dir: &Path, source: &Path) -> Converted {
    converted(dir, source, Encoding::Srgb, 0, Watch::nobody()).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn a_file_is_made_once_and_again_when_it_is_damaged() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let (dir, source) = (directory.path().join("no/such/yet"), source(directory.path(), 0));
    let first = convert(&dir, &source);
    assert!(first.made && !first.remade);
    let bytes = fs::read(&first.path).expect("there");
    assert_eq!(convert(&dir, &source), Converted { made: false, ..first.clone() });
    // Another encoding, another file, though a float image has the same texels under both.
    let linear = converted(&dir, &source, Encoding::Linear, 0, Watch::nobody()).expect("made");
    assert!(linear.made && linear.path != first.path);
    assert!(!converted(&dir, &source, Encoding::Linear, 0, Watch::nobody()).expect("there").made);
    // The two and the locks; no index entry yet, since the source is new.
    assert_eq!(names(&dir).len(), 3, "{:?}", names(&dir));
    for damage in [&bytes[..bytes.len() - 1], &bytes[..5000], &bytes[..0], b"something else"] {
        fs::write(&first.path, damage).expect("write");
        let again = convert(&dir, &source);
        assert!(again.made && again.remade);
        assert_eq!(fs::read(&again.path).expect("there"), bytes);
    }
    // A sound file that was made of something else.
    let other = convert(&dir, &self::source(directory.path(), 1));
    assert!(other.made && other.path != first.path);
    fs::copy(&other.path, &first.path).expect("copy");
    let again = convert(&dir, &source);
    assert!(again.made && again.remade);
    assert_eq!(fs::read(&again.path).expect("there"), bytes);
}

#[test]
fn content_names_the_file_wherever_the_source_stands() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let dir = directory.path().join("cache");
    let source = source(directory.path(), 0);
    let copy = directory.path().join("copy.pfm");
    fs::copy(&source, &copy).expect("copy");
    let first = convert(&dir, &source);
    let second = convert(&dir, &copy);
    assert!(first.path == second.path && !second.made);
    // The same name, other content.
    let other = self::source(directory.path(), 1);
    fs::rename(&other, &source).expect("rename");
    let third = convert(&dir, &source);
    assert!(third.path != first.path && third.made);
}

#[test]
fn many_at_once_make_a_file_once() {
    use rayon::prelude::*;
    let directory = tempfile::tempdir().expect("a temporary directory");
    let dir = directory.path().join("cache");
    let sources = [source(directory.path(), 0), source(directory.path(), 1)];
    let made = AtomicU64::new(0);
    let one = |i: usize| {
        let done = convert(&dir, &sources[i % 2]);
        made.fetch_add(u64::from(done.made), Ordering::Relaxed);
        done.path
    };
    // From plain threads and from rayon's own, which steal while they wait.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().expect("threads");
    let paths: Vec<PathBuf> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|i| scope.spawn(move || one(i))).collect::<Vec<_>>();
        let mut paths: Vec<PathBuf> = pool.install(|| (0..16).into_par_iter().map(one).collect());
        paths.extend(threads.into_iter().map(|t| t.join().expect("no panic")));
        paths
    });
    assert_eq!(made.load(Ordering::Relaxed), 2);
    assert!(paths.iter().all(|p| *p == paths[0] || *p == paths[1]));
}

#[test]
fn what_cannot_be_read_or_kept_is_one_line_and_leaves_nothing() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let dir = directory.path().join("cache");
    let line = |dir: &Path, source: &Path| {
        let e = converted(dir, source, Encoding::Srgb, 0, Watch::nobody()).expect_err("must fail");
        let text = e.to_string();
        assert!(!text.contains('\n'), "{text}");
        (e.exit_code(), text)
    };
    let (code, text) = line(&dir, &directory.path().join("missing.png"));
    assert!(code == 2 && text.contains("missing.png"), "{text}");
    let whole = fs::read(source(directory.path(), 0)).expect("there");
    let short = directory.path().join("short.pfm");
    fs::write(&short, &whole[..whole.len() - 1]).expect("write");
    let (code, text) = line(&dir, &short);
    assert!(code == 2 && text.contains("short.pfm"), "{text}");
    assert_eq!(names(&dir), ["locks"]);
    // A directory that is a file.
    let (code, text) = line(&short, &directory.path().join("s0.pfm"));
    assert!(code == 3 && text.contains("--cache-dir"), "{text}");
}

#[test]
fn leftovers_of_a_day_ago_go_and_younger_ones_stay() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let dir = directory.path().join("cache");
    fs::create_dir(&dir).expect("create");
    let day = SystemTime::now() - LEFTOVER_AGE;
    let hour = Duration::from_secs(3600);
    for (name, time) in
        [(".weir-1-0.part", day - hour), (".weir-1-1.part", day + hour), ("mine.part", day - hour)]
    {
        let file = File::create(dir.join(name)).expect("create");
        file.set_modified(time).expect("own file");
    }
    fs::create_dir(dir.join("index")).expect("create");
    let file = File::create(dir.join("index/.weir-1-0.part")).expect("create");
    file.set_modified(day - hour).expect("own file");
    convert(&dir, &source(directory.path(), 0));
    assert!(names(&dir.join("index")).is_empty(), "crashed there too");
    let left = names(&dir);
    assert!(!left.contains(&".weir-1-0.part".to_owned()), "{left:?}");
    assert!(left.contains(&".weir-1-1.part".to_owned()) && left.contains(&"mine.part".to_owned()));
}

#[cfg(unix)]
#[test]
fn a_hash_is_remembered_only_of_a_file_at_rest_and_forgotten_with_its_stamp() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let dir = directory.path().join("cache");
    let source = source(directory.path(), 0);
    let index = dir.join("index").join(index_name(&source));
    convert(&dir, &source);
    assert!(!index.exists(), "it has changed just now and may change again within the clock's tick");
    let stamp = Stamp::of(&source).expect("there");
    let line = format!("{} {}\n", stamp.text().expect("known"), "ab".repeat(16));
    fs::create_dir_all(dir.join("index")).expect("create");
    fs::write(&index, line).expect("write");
    assert_eq!(remembered(&index, &stamp), Some("ab".repeat(16)));
    // Setting the date back does not hide a change.
    let time = fs::metadata(&source).and_then(|m| m.modified()).expect("a time");
    std::thread::sleep(Duration::from_millis(30));
    File::options().append(true).open(&source).and_then(|f| f.set_modified(time)).expect("own file");
    let stamp = Stamp::of(&source).expect("there");
    assert_eq!(remembered(&index, &stamp), None);
    assert_eq!(remembered(&dir.join("index/none"), &stamp), None);
}

#[test]
fn what_is_given_up_leaves_nothing_and_gives_up_soon() {
    use std::sync::atomic::AtomicBool;
    let directory = tempfile::tempdir().expect("a temporary directory");
    let (dir, source) = (directory.path().join("cache"), source(directory.path(), 0));
    let cancel = AtomicBool::new(false);
    let told = AtomicU64::new(0);
    let progress = |_, _| {
        told.fetch_add(1, Ordering::Relaxed);
        cancel.store(true, Ordering::Relaxed);
    };
    let watch = Watch { cancel: &cancel, progress: &progress };
    let given_up = converted(&dir, &source, Encoding::Srgb, 0, watch).expect_err("given up");
    assert!(matches!(given_up, Error::Interrupted) && given_up.exit_code() == 130);
    assert_eq!(told.load(Ordering::Relaxed), 1, "one band of rows more at most");
    assert_eq!(names(&dir), ["locks"]);
    // Also by who waits for the lock.
    cancel.store(false, Ordering::Relaxed);
    let held = names(&dir.join("locks")).remove(0);
    let held = File::open(dir.join("locks").join(held)).expect("there");
    held.lock().expect("free");
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| converted(&dir, &source, Encoding::Srgb, 0, watch));
        std::thread::sleep(Duration::from_millis(100));
        assert!(!waiting.is_finished());
        cancel.store(true, Ordering::Relaxed);
        let start = std::time::Instant::now();
        while !waiting.is_finished() && start.elapsed() < Duration::from_secs(20) {
            std::thread::sleep(PATIENCE);
        }
        // Lets it end whatever it waits for, so that a failure is one and no hang.
        drop(held);
        let ended = waiting.join().expect("no panic");
        assert!(matches!(ended, Err(Error::Interrupted)), "{ended:?}");
    });
}

#[test]
fn links_in_the_directory_lead_nowhere() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let directory = tempfile::tempdir().expect("a temporary directory");
    let (dir, source) = (directory.path().join("cache"), source(directory.path(), 0));
    let first = convert(&dir, &source);
    let mode = fs::metadata(&dir).expect("there").permissions().mode();
    assert_eq!(mode & 0o777, 0o700);
    let victim = directory.path().join("victim");
    fs::write(&victim, b"precious").expect("write");
    // In the place of the file, of its lock, and of the index.
    fs::remove_file(&first.path).expect("ours");
    symlink(&victim, &first.path).expect("link");
    let lock = dir.join("locks").join(&names(&dir.join("locks"))[0]);
    fs::remove_file(&lock).expect("ours");
    symlink(directory.path().join("made by a lock"), &lock).expect("link");
    let elsewhere = directory.path().join("elsewhere");
    fs::create_dir(&elsewhere).expect("create");
    symlink(&elsewhere, dir.join("index")).expect("link");
    let old = SystemTime::now() - Duration::from_secs(3600);
    File::options().append(true).open(&source).and_then(|f| f.set_modified(old)).expect("own file");
    std::thread::sleep(UNSETTLED + Duration::from_millis(1100));
    let again = convert(&dir, &source);
    assert!(again.made && again.remade);
    assert!(fs::symlink_metadata(&again.path).expect("there").is_file());
    assert_eq!(fs::read(&victim).expect("there"), b"precious");
    assert!(!directory.path().join("made by a lock").exists());
    assert!(names(&elsewhere).is_empty(), "{:?}", names(&elsewhere));
}

#[test]
fn without_a_lock_it_is_made_all_the_same_and_what_cannot_be_written_says_so() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let (dir, source) = (directory.path().join("cache"), source(directory.path(), 0));
    fs::create_dir(&dir).expect("create");
    // As little to be opened as another person's directory of locks, even for root.
    fs::write(dir.join("locks"), b"").expect("write");
    assert!(convert(&dir, &source).made);
    let e = converted(Path::new("/sys/weir"), &source, Encoding::Srgb, 0, Watch::nobody());
    let text = e.expect_err("nobody writes there").to_string();
    assert!(text.contains("not writable") && text.contains("--cache-dir"), "{text}");
    assert!(!text.contains("make room"), "{text}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_conversion_has_as_many_threads_as_it_is_told() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let source = source(directory.path(), 0);
    for threads in [1, 5] {
        let seen = AtomicU64::new(0);
        // Runs on a thread of the conversion's pool.
        let progress = |_, _| seen.store(rayon::current_num_threads() as u64, Ordering::Relaxed);
        let watch = Watch { progress: &progress, ..Watch::nobody() };
        let dir = directory.path().join(threads.to_string());
        converted(&dir, &source, Encoding::Srgb, threads, watch).expect("made");
        assert_eq!(seen.load(Ordering::Relaxed), threads as u64);
    }
}
