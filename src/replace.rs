//! Files that appear whole or not at all: written in the same directory without a name, where the file system has such
//! files, or else under another name; synced; then renamed. Invariant: until the rename the old file is intact, and after
//! an error no partial file is left; after a kill only where it meets the moment between naming and renaming, or where files
//! need names. Never chooses a format.

use crate::error::{Error, Result};
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Partial files that exist now, for [`remove_partial_files`].
static PARTIAL: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
static NEXT: AtomicU64 = AtomicU64::new(0);

/// Writes `path` by `write`, replacing what was there only once every byte is on the disk.
///
/// # Errors
/// [`Error::Io`] with `path`; the old file is then untouched.
pub fn replace_file(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    try_replace_file(path, write).map_err(|e| Error::io(path, e))
}

/// [`replace_file`] for a `write` that has a result, and reasons of its own to fail.
///
/// # Errors
/// Those of `write`, and the system's as `E`; the old file is then untouched.
pub fn try_replace_file<T, E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> std::result::Result<T, E>,
) -> std::result::Result<T, E> {
    replace(path, Manner { through_links: true, synced: true }, write)
}

/// As [`replace_file`], whole under its name for every reader, but on the disk only when the operating
/// system gets to it: for files by the thousand that can be made again.
///
/// # Errors
/// As [`replace_file`].
pub fn replace_file_unsynced(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    replace(path, Manner { through_links: true, synced: false }, write)
        .map_err(|e: io::Error| Error::io(path, e))
}

/// As [`try_replace_file`], but a symbolic link at `path` is replaced itself, and permissions are a new
/// file's: for directories that others may write to, where a link may name a file of somebody's.
///
/// # Errors
/// As [`try_replace_file`].
pub fn try_replace_entry<T, E: From<io::Error>>(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> std::result::Result<T, E>,
) -> std::result::Result<T, E> {
    replace(path, Manner { through_links: false, synced: true }, write)
}

/// As [`replace_file_unsynced`], but a symbolic link at `path` is replaced itself.
///
/// # Errors
/// As [`replace_file`].
pub fn replace_entry_unsynced(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    replace(path, Manner { through_links: false, synced: false }, write)
        .map_err(|e: io::Error| Error::io(path, e))
}

#[derive(Clone, Copy)]
struct Manner {
    /// A link stays, and so do the permissions of what it names.
    through_links: bool,
    synced: bool,
}

fn replace<T, E: From<io::Error>>(
    path: &Path,
    manner: Manner,
    write: impl FnOnce(&mut BufWriter<File>) -> std::result::Result<T, E>,
) -> std::result::Result<T, E> {
    let target = if manner.through_links { resolve(path) } else { path.to_path_buf() };
    let (file, mut partial) = Partial::create(directory_of(&target))?;
    let mut writer = BufWriter::new(file);
    let written = write(&mut writer)?;
    let file = writer.into_inner().map_err(io::IntoInnerError::into_error)?;
    if manner.through_links
        && let Ok(old) = fs::metadata(&target)
    {
        file.set_permissions(old.permissions())?;
    }
    if manner.synced {
        file.sync_all()?;
    }
    fs::rename(partial.name(&file)?, &target)?;
    if manner.synced {
        // The rename itself reaches the disk with its directory; not every file system can sync one.
        let _ = File::open(directory_of(&target)).and_then(|directory| directory.sync_all());
    }
    Ok(written)
}

/// Whether [`replace_file`] could write `path` now: to learn it before an hour of work and not after.
///
/// # Errors
/// [`Error::Io`] or [`Error::Usage`] naming what stands in the way.
pub fn check_replaceable(path: &Path) -> Result<()> {
    let target = resolve(path);
    match fs::metadata(&target) {
        Ok(old) if old.is_dir() => {
            return Err(Error::Usage(format!("{}: is a directory; name a file in it", path.display())));
        }
        Ok(old) if !old.is_file() => {
            let message = format!("{}: is not a regular file; name one that can be replaced", path.display());
            return Err(Error::Usage(message));
        }
        Ok(old) if old.permissions().readonly() => {
            let message =
                format!("{}: is write-protected; make it writable or name another file", path.display());
            return Err(Error::Usage(message));
        }
        Ok(_) => {}
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            let directory = directory_of(&target);
            if !directory.is_dir() {
                let message = format!(
                    "{}: there is no directory {}; make it first",
                    path.display(),
                    directory.display()
                );
                return Err(Error::Usage(message));
            }
        }
        Err(e) => return Err(Error::io(path, e)),
    }
    // Dropping the guard removes the probe.
    let probe = Partial::create(directory_of(&target))
        .and_then(|(file, mut partial)| partial.name(&file).map(|_| ()));
    probe.map_err(|e| Error::io(path, e))
}

/// A new file in `directory` that has no name any more, for reading and writing: it goes when it is closed, and when
/// the program does, however that ends.
///
/// # Errors
/// The operating system's.
pub fn nameless_file(directory: &Path) -> io::Result<File> {
    // Dropping the guard removes the name, if there is one.
    Partial::create(directory).map(|(file, _)| file)
}

/// Removes every partial file of this process, which makes no other from now on: for an exit that runs
/// no destructors, while other threads still write.
pub fn remove_partial_files() {
    let mut partial = PARTIAL.lock().unwrap_or_else(PoisonError::into_inner);
    for path in partial.drain(..) {
        let _ = fs::remove_file(path);
    }
    // Whoever would make or finish one now waits for the exit.
    std::mem::forget(partial);
}

/// Through a symbolic link to what it names: renaming would otherwise replace the link.
fn resolve(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf())
}

fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// A partial file. Dropping it removes its name, which nothing has any more after a rename.
struct Partial {
    directory: PathBuf,
    name: Option<PathBuf>,
}

impl Partial {
    /// In `directory`; without a name, if that can be had.
    fn create(directory: &Path) -> io::Result<(File, Self)> {
        let directory = directory.to_path_buf();
        if let Some(file) = nameless::create(&directory) {
            return Ok((file, Self { directory, name: None }));
        }
        let create = |path: &Path| OpenOptions::new().read(true).write(true).create_new(true).open(path);
        let (file, name) = under_new_name(&directory, create)?;
        Ok((file, Self { directory, name: Some(name) }))
    }

    /// The name of `file`, which is its own, and which gets one now if it has none.
    fn name(&mut self, file: &File) -> io::Result<&Path> {
        let name = match self.name.take() {
            Some(name) => name,
            None => under_new_name(&self.directory, |path| nameless::link(file, path))?.1,
        };
        Ok(self.name.insert(name))
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        let Some(name) = &self.name else { return };
        let mut partial = PARTIAL.lock().unwrap_or_else(PoisonError::into_inner);
        partial.retain(|other| other != name);
        // After a rename there is nothing of that name left to remove.
        let _ = fs::remove_file(name);
    }
}

/// What `make` makes under a name in `directory` that nothing has.
fn under_new_name<T>(directory: &Path, make: impl Fn(&Path) -> io::Result<T>) -> io::Result<(T, PathBuf)> {
    loop {
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let path = directory.join(format!(".weir-{}-{number}.part", std::process::id()));
        // Held across the making, so that an exit in between misses no file.
        let mut partial = PARTIAL.lock().unwrap_or_else(PoisonError::into_inner);
        match make(&path) {
            Ok(made) => {
                partial.push(path.clone());
                return Ok((made, path));
            }
            // Left by a killed process of the same id.
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(e),
        }
    }
}

/// Files that have no name until they are given one.
#[cfg(target_os = "linux")]
mod nameless {
    use super::{File, Path, PathBuf, fs, io};
    use rustix::fs::{AtFlags, CWD, Mode, OFlags, linkat, open};
    use std::os::fd::AsRawFd;

    /// In `directory`; `None` where the file system has none, or the system no way to name them.
    pub(super) fn create(directory: &Path) -> Option<File> {
        let flags = OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC;
        let file = File::from(open(directory, flags, Mode::from_raw_mode(0o666)).ok()?);
        fs::symlink_metadata(by_number(&file)).is_ok().then_some(file)
    }

    /// Gives `file` a name.
    pub(super) fn link(file: &File, path: &Path) -> io::Result<()> {
        Ok(linkat(CWD, by_number(file), CWD, path, AtFlags::SYMLINK_FOLLOW)?)
    }

    fn by_number(file: &File) -> PathBuf {
        format!("/proc/self/fd/{}", file.as_raw_fd()).into()
    }
}

#[cfg(not(target_os = "linux"))]
mod nameless {
    use super::{File, Path, io};

    pub(super) fn create(_: &Path) -> Option<File> {
        None
    }

    pub(super) fn link(_: &File, _: &Path) -> io::Result<()> {
        unreachable!("every file has a name")
    }
}

/// Writes `bytes` as `path`, whole or not at all.
///
/// # Errors
/// As [`replace_file`].
pub fn replace_with_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    replace_file(path, |writer| writer.write_all(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(directory: &Path) -> Vec<String> {
        let entries = fs::read_dir(directory).expect("the test's own directory");
        let mut names: Vec<String> =
            entries.map(|e| e.expect("readable").file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn an_error_leaves_the_old_file_and_nothing_else() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let path = directory.path().join("a.exr");
        replace_with_bytes(&path, b"old").expect("first write");
        let failed = replace_file(&path, |writer| {
            writer.write_all(&[7; 100_000])?;
            Err(io::Error::other("disk on fire"))
        });
        assert!(failed.expect_err("must fail").to_string().contains("disk on fire"));
        assert_eq!(fs::read(&path).expect("still there"), b"old");
        assert_eq!(names(directory.path()), ["a.exr"]);
    }

    #[test]
    fn a_panic_leaves_the_old_file_and_nothing_else() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let path = directory.path().join("a.exr");
        replace_with_bytes(&path, b"old").expect("first write");
        let target = path.clone();
        let thread = std::thread::spawn(move || replace_file(&target, |_| panic!("expected by this test")));
        assert!(thread.join().is_err());
        assert_eq!(fs::read(&path).expect("still there"), b"old");
        assert_eq!(names(directory.path()), ["a.exr"]);
    }

    #[test]
    fn the_old_file_is_whole_while_the_new_one_is_being_written() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let path = directory.path().join("a.exr");
        replace_with_bytes(&path, b"old").expect("first write");
        replace_file(&path, |writer| {
            writer.write_all(b"new")?;
            writer.flush()?;
            assert_eq!(fs::read(&path)?, b"old");
            let part = |name: &String| name.ends_with(".part");
            assert!(names(directory.path()).iter().all(|name| name == "a.exr" || part(name)));
            Ok(())
        })
        .expect("second write");
        assert_eq!(fs::read(&path).expect("there"), b"new");
        assert_eq!(names(directory.path()), ["a.exr"]);
    }

    #[test]
    fn checks_name_what_stands_in_the_way() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let message = |path: &Path| check_replaceable(path).expect_err("must fail").to_string();
        assert!(message(directory.path()).contains("is a directory"));
        assert!(message(&directory.path().join("no/such/a.exr")).contains("no directory"));
        assert!(message(&directory.path().join("x").join("..").join("y/a.exr")).contains("no directory"));
        let path = directory.path().join("protected.exr");
        replace_with_bytes(&path, b"old").expect("write");
        let mut permissions = fs::metadata(&path).expect("there").permissions();
        permissions.set_readonly(true);
        fs::set_permissions(&path, permissions).expect("own file");
        assert!(message(&path).contains("write-protected"));
        check_replaceable(&directory.path().join("new.exr")).expect("free to write");
        assert_eq!(names(directory.path()), ["protected.exr"]);
        // Never as a file below a file.
        assert!(check_replaceable(&path.join("a.exr")).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn a_link_keeps_being_one() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let (target, link) = (directory.path().join("real.exr"), directory.path().join("link.exr"));
        replace_with_bytes(&target, b"old").expect("write");
        std::os::unix::fs::symlink(&target, &link).expect("link");
        replace_with_bytes(&link, b"new").expect("write");
        assert_eq!(fs::read(&target).expect("there"), b"new");
        assert!(fs::symlink_metadata(&link).expect("there").file_type().is_symlink());
    }

    #[cfg(unix)]
    #[test]
    fn an_entry_takes_the_place_of_a_link() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let victim = directory.path().join("victim");
        replace_with_bytes(&victim, b"precious").expect("write");
        for name in ["a", "b"] {
            std::os::unix::fs::symlink(&victim, directory.path().join(name)).expect("link");
        }
        let write = |out: &mut BufWriter<File>| out.write_all(b"new");
        try_replace_entry(&directory.path().join("a"), write).expect("write");
        replace_entry_unsynced(&directory.path().join("b"), write).expect("write");
        for name in ["a", "b"] {
            let path = directory.path().join(name);
            assert!(fs::symlink_metadata(&path).expect("there").is_file());
            assert_eq!(fs::read(&path).expect("there"), b"new");
        }
        assert_eq!(fs::read(&victim).expect("there"), b"precious");
    }
}
