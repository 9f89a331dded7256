//! Converted textures kept from render to render, named by the content they were made of. A file
//! there is whole or absent; it is used after a look at its header and length, and made again when
//! either is not what it should be.
//!
//! Two Weirs, or two threads, that want the same file make it once: whoever has the lock makes it,
//! the others wait and use it. Locks are the operating system's, so that a crash leaves none behind;
//! whoever can have none, in a directory that somebody else made, goes on without: renaming is atomic.
//! Conversions run on threads of their own: a thread of rayon's that waited for one might otherwise
//! be handed the very job that it waits for.
//!
//! Invariant: what a name says a file was made of, it was made of. Never follows a symbolic link in the
//! directory, which others may write to; never deletes a converted file that is whole: to make room, a
//! person deletes the directory.

mod lock;

pub(crate) use lock::MakersLock;

use super::convert::fingerprint::{self, Stamp, VERSION, encoding_text};
use super::convert::{self, Compression, Container, Failure, Settings, Watch, WrapMode};
use crate::error::{Error, Result};
use crate::open::open_entry;
use crate::replace::{replace_entry_unsynced, try_replace_entry};
use crate::scene::Encoding;
use lock::own_directory;
use std::ffi::OsString;
use std::fs::{self, DirBuilder};
use std::io::{self, BufReader, Read, Write};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};
use tiff::decoder::Decoder;
use tiff::tags::Tag;

/// A file of a process that is not here is left alone so long: the process may be on another machine, and write.
const GONE_AGE: Duration = Duration::from_secs(60);
/// A temporary file that nobody has touched for so long has no owner any more.
const LEFTOVER_AGE: Duration = Duration::from_secs(24 * 3600);
/// A file that changed within this time may change again without a new time stamp: clocks of file
/// systems are as coarse as two seconds (FAT).
pub(crate) const UNSETTLED: Duration = Duration::from_secs(3);
/// No entry of the index is longer.
const INDEX_BYTES: u64 = 1 << 10;

/// `$XDG_CACHE_HOME/weir`, otherwise `~/.cache/weir`.
///
/// # Errors
/// [`Error::Usage`] when neither variable names a directory.
pub fn default_dir() -> Result<PathBuf> {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|p| p.is_absolute());
    let home = || absolute("HOME").map(|home| home.join(".cache"));
    absolute("XDG_CACHE_HOME").or_else(home).map(|cache| cache.join("weir")).ok_or_else(|| {
        let message = "neither XDG_CACHE_HOME nor HOME names a directory; name one with --cache-dir";
        Error::Usage(message.to_owned())
    })
}

/// What [`converted`] did.
#[derive(Clone, Debug, PartialEq)]
pub struct Converted {
    /// The tiled file.
    pub path: PathBuf,
    /// It was made now.
    pub made: bool,
    /// A file of that name was there and was not what it should be: worth a note.
    pub remade: bool,
    /// Texels replaced because they were infinite or not a number; counted when the file is made.
    pub replaced: u64,
}

/// The tiled TIFF of `source` in `dir`, made if it is not there. `encoding` is how integers are read.
/// `watch` counts rows of a conversion. May be called from any thread, also several times at once; each
/// conversion has `threads` of its own, 0: as many as there are processors.
///
/// # Errors
/// [`Error::Input`] or [`Error::Io`] when the source cannot be read; [`Error::Resource`] naming
/// `--cache-dir` when the directory cannot take the file; [`Error::Interrupted`] when `watch` gave up.
pub fn converted(
    dir: &Path,
    source: &Path,
    encoding: Encoding,
    threads: usize,
    watch: Watch<'_>,
) -> Result<Converted> {
    watch.check()?;
    let stamp = Stamp::of(source)?;
    let index = dir.join("index").join(index_name(source));
    let hash = match remembered(&index, &stamp) {
        Some(hash) => hash,
        None => fingerprint::of_file_watched(source, watch)?,
    };
    let path = dir.join(format!("{hash}-{}-v{VERSION}.tx", encoding_text(encoding)));
    let existing = look(&path, &hash, encoding);
    if existing == Look::Whole {
        remember(&index, &stamp, &hash);
        return Ok(Converted { path, made: false, remade: false, replaced: 0 });
    }
    let cannot = |e: io::Error| {
        let (dir, source) = (dir.display(), source.display());
        let (what, help) = match e.kind() {
            io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => ("not writable: ", ""),
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => ("", "make room there or "),
            _ => ("", ""),
        };
        let help = format!("{help}name another directory with --cache-dir");
        Error::Resource(format!("{dir}: {what}cannot keep the converted texture {source}: {e}; {help}"))
    };
    DirBuilder::new().recursive(true).mode(0o700).create(dir).map_err(cannot)?;
    let lock = MakersLock::open(dir, &hash[..2]);
    let settings = Settings {
        container: Container::Tiff,
        // A miss then costs one read and no inflating.
        compression: Compression::None,
        wrap: WrapMode::Periodic,
        encoding: Some(encoding),
    };
    let work = || -> std::result::Result<Converted, Failure> {
        lock.wait(|| watch.check())?;
        // Whoever had the lock before may have made it.
        let existing = look(&path, &hash, encoding);
        if existing == Look::Whole {
            return Ok(Converted { path: path.clone(), made: false, remade: false, replaced: 0 });
        }
        remove_leftovers(dir);
        let index = dir.join("index");
        if fs::symlink_metadata(&index).is_ok_and(|m| m.is_dir()) {
            remove_leftovers(&index);
        }
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("convert-{i}"))
            .build()
            .map_err(|e| Error::Resource(format!("no threads to convert textures: {e}")))?;
        let summary = try_replace_entry(&path, |out| {
            let summary = pool.install(|| convert::convert(source, &settings, &hash, out, watch))?;
            stamp.check(source)?;
            Ok::<_, Failure>(summary)
        })?;
        let remade = existing == Look::Other;
        Ok(Converted { path: path.clone(), made: true, remade, replaced: summary.replaced })
    };
    let done = std::thread::scope(|scope| match scope.spawn(work).join() {
        Ok(done) => done,
        Err(panic) => std::panic::resume_unwind(panic),
    });
    let done = done.map_err(|failure| match failure {
        Failure::Source(e) => e,
        Failure::Write(e) => cannot(e),
    })?;
    remember(&index, &stamp, &hash);
    Ok(done)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Look {
    Absent,
    /// Something else, or not all of it.
    Other,
    Whole,
}

/// Whether `path` is what `converted` would make: its own text says so, and how long it is.
fn look(path: &Path, hash: &str, encoding: Encoding) -> Look {
    let Ok(file) = open_entry(path) else {
        return if fs::symlink_metadata(path).is_ok() { Look::Other } else { Look::Absent };
    };
    let Ok(meta) = file.metadata() else { return Look::Other };
    let text = Decoder::new(BufReader::new(file))
        .and_then(|mut decoder| decoder.get_tag_ascii_string(Tag::ImageDescription));
    let whole = text.is_ok_and(|text| {
        let value = |key| fingerprint::value(&text, key);
        value("weir:source") == Some(hash)
            && value("weir:read") == Some(&encoding_text(encoding))
            && value("weir:version") == Some(&VERSION.to_string())
            && value("weir:bytes").and_then(|b| u64::from_str_radix(b, 16).ok()) == Some(meta.len())
    });
    if whole { Look::Whole } else { Look::Other }
}

/// The name of a source's entry in the index: a hash of its full path.
fn index_name(source: &Path) -> OsString {
    let full = fs::canonicalize(source).unwrap_or_else(|_| source.to_path_buf());
    format!("{:032x}", xxhash_rust::xxh3::xxh3_128(full.as_os_str().as_encoded_bytes())).into()
}

/// The content's hash as it was when the source last had this stamp: a texture of gigabytes need not
/// be read to learn that it has not changed. The stamp has size, device, inode, and the times of the
/// last change of content and of inode, so that setting a file's date back does not fool it, nor
/// does another file under the same name. What could: a write within the same tick of the file
/// system's clock as the one before (hence [`UNSETTLED`]), a clock set back over a write of the same
/// length, a network file system that reports times late, and a write to the disk behind the file
/// system's back.
fn remembered(index: &Path, stamp: &Stamp) -> Option<String> {
    let text = index_text(index)?;
    let (known, hash) = text.trim_end().split_once(' ')?;
    let sound = hash.len() == 32 && hash.bytes().all(|b| b.is_ascii_hexdigit());
    (sound && known == stamp.text()?).then(|| hash.to_owned())
}

fn index_text(index: &Path) -> Option<String> {
    let mut text = String::new();
    open_entry(index).ok()?.take(INDEX_BYTES).read_to_string(&mut text).ok()?;
    Some(text)
}

/// Failing to remember costs time only.
fn remember(index: &Path, stamp: &Stamp, hash: &str) {
    let Some(text) = stamp.text().filter(|_| stamp.settled(UNSETTLED)) else { return };
    let line = format!("{text} {hash}\n");
    if index_text(index).is_some_and(|old| old == line) {
        return;
    }
    if index.parent().is_some_and(|parent| own_directory(parent).is_ok()) {
        // On the disk whenever it gets there: what is torn is not believed.
        let _ = replace_entry_unsynced(index, |out| out.write_all(line.as_bytes()));
    }
}

/// Removes what crashed makers left: files of processes that are no more here, and such as nobody has touched for a day,
/// whose process may be on another machine.
pub(crate) fn remove_leftovers(dir: &Path) {
    let Ok(entries) = fs::read_dir(dir) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let own = |n: &str| n.strip_prefix(".weir-")?.strip_suffix(".part")?.split('-').next()?.parse().ok();
        let process: Option<u32> = name.to_str().and_then(own);
        let ours = process.is_some();
        let gone = process.is_some_and(is_gone);
        let age = entry.metadata().and_then(|m| m.modified()).ok();
        let old =
            age.and_then(|t| SystemTime::now().duration_since(t).ok()).is_some_and(|d| d > LEFTOVER_AGE);
        let still = age.and_then(|t| SystemTime::now().duration_since(t).ok()).is_some_and(|d| d > GONE_AGE);
        if ours && (old || (gone && still)) {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Whether this machine says that it has no such process. One on another machine that shares the directory is taken for
/// gone too, if its file has not grown for a minute ([`GONE_AGE`]).
fn is_gone(process: u32) -> bool {
    Path::new("/proc/self").exists() && !Path::new("/proc").join(process.to_string()).exists()
}

#[cfg(test)]
mod tests;
