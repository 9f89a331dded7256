//! Converted textures kept from render to render, named by the content they were made of. A file
//! there is whole or absent; it is used after a look at its header and length, and made again when
//! either is not what it should be.
//!
//! Two Weirs, or two threads, that want the same file make it once: whoever has the lock makes it,
//! the others wait and use it. Locks are the operating system's, so that a crash leaves none behind.
//! Conversions run on threads of their own: a thread of rayon's that waited for one might otherwise
//! be handed the very job that it waits for.
//!
//! Invariant: what a name says a file was made of, it was made of. Never deletes a converted file
//! that is whole; to make room, a person deletes the directory.

use super::convert::fingerprint::{self, Stamp, VERSION, encoding_text};
use super::convert::{self, Compression, Container, Failure, Settings, WrapMode};
use crate::error::{Error, Result};
use crate::replace::try_replace_file;
use crate::scene::Encoding;
use rayon::ThreadPool;
use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::{Duration, SystemTime};
use tiff::decoder::Decoder;
use tiff::tags::Tag;

/// A temporary file that nobody has touched for so long has no owner any more.
const LEFTOVER_AGE: Duration = Duration::from_secs(24 * 3600);
/// A file that changed within this time may change again without a new time stamp: clocks of file
/// systems are as coarse as two seconds (FAT).
const UNSETTLED: Duration = Duration::from_secs(3);

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
/// `progress(done, total)` counts rows of a conversion, from any thread. May be called from any thread, also
/// several times at once; each conversion uses all cores.
///
/// # Errors
/// [`Error::Input`] or [`Error::Io`] when the source cannot be read; [`Error::Resource`] naming
/// `--cache-dir` when the directory cannot take the file.
pub fn converted(
    dir: &Path,
    source: &Path,
    encoding: Encoding,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<Converted> {
    let stamp = Stamp::of(source)?;
    let index = dir.join("index").join(index_name(source));
    let hash = match remembered(&index, &stamp) {
        Some(hash) => hash,
        None => fingerprint::of_file(source)?,
    };
    let path = dir.join(format!("{hash}-{}-v{VERSION}.tx", encoding_text(encoding)));
    let existing = look(&path, &hash, encoding);
    if existing == Look::Whole {
        remember(&index, &stamp, &hash);
        return Ok(Converted { path, made: false, remade: false, replaced: 0 });
    }
    let cannot = |e: io::Error| {
        Error::Resource(format!(
            "{}: cannot keep the converted texture {}: {e}; make room there or name another directory with --cache-dir",
            dir.display(),
            source.display()
        ))
    };
    fs::create_dir_all(dir.join("locks")).map_err(cannot)?;
    // A bounded number of lock files, which are never deleted: one that is deleted while another
    // process opens it would lock nothing.
    let lock = dir.join("locks").join(&hash[..2]);
    let lock = OpenOptions::new().create(true).append(true).open(lock).map_err(cannot)?;
    let settings = Settings {
        container: Container::Tiff,
        // A miss then costs one read and no inflating.
        compression: Compression::None,
        wrap: WrapMode::Periodic,
        encoding: Some(encoding),
    };
    let pool = pool()?;
    let work = || -> std::result::Result<Converted, Failure> {
        match lock.lock() {
            // Without locks two may make the same file; whoever is last replaces it whole by its like.
            Err(e) if e.kind() == io::ErrorKind::Unsupported => {}
            locked => locked?,
        }
        // Whoever had the lock before may have made it.
        let existing = look(&path, &hash, encoding);
        if existing == Look::Whole {
            return Ok(Converted { path: path.clone(), made: false, remade: false, replaced: 0 });
        }
        remove_leftovers(dir);
        let summary = try_replace_file(&path, |out| {
            let summary = pool.install(|| convert::convert(source, &settings, &hash, out, progress))?;
            if Stamp::of(source)? != stamp {
                let message = "the file changed while it was converted; try again when it is at rest";
                return Err(Failure::Source(Error::file(source, message)));
            }
            Ok(summary)
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

/// Threads for conversions alone.
fn pool() -> Result<&'static ThreadPool> {
    static POOL: OnceLock<ThreadPool> = OnceLock::new();
    if let Some(pool) = POOL.get() {
        return Ok(pool);
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .thread_name(|i| format!("convert-{i}"))
        .build()
        .map_err(|e| Error::Resource(format!("no threads to convert textures: {e}")))?;
    Ok(POOL.get_or_init(|| pool))
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
    let Ok(file) = File::open(path) else {
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
    let text = fs::read_to_string(index).ok()?;
    let (known, hash) = text.trim_end().split_once(' ')?;
    let sound = hash.len() == 32 && hash.bytes().all(|b| b.is_ascii_hexdigit());
    (sound && known == stamp.text()?).then(|| hash.to_owned())
}

/// Failing to remember costs time only.
fn remember(index: &Path, stamp: &Stamp, hash: &str) {
    let Some(text) = stamp.text().filter(|_| stamp.settled(UNSETTLED)) else { return };
    let line = format!("{text} {hash}\n");
    if fs::read_to_string(index).is_ok_and(|old| old == line) {
        return;
    }
    let Some(parent) = index.parent() else { return };
    let _ = fs::create_dir_all(parent);
    let _ = try_replace_file(index, |out| out.write_all(line.as_bytes()));
}

/// Removes what crashed conversions left. Whoever writes one now has touched it within the day.
fn remove_leftovers(dir: &Path) {
    let Ok(entries) = fs::read_dir(dir) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let ours = name.to_str().is_some_and(|n| n.starts_with(".weir-") && n.ends_with(".part"));
        let age = entry.metadata().and_then(|m| m.modified()).ok();
        let old =
            age.and_then(|t| SystemTime::now().duration_since(t).ok()).is_some_and(|d| d > LEFTOVER_AGE);
        if ours && old {
            let _ = fs::remove_file(entry.path());
        }
    }
}

#[cfg(test)]
mod tests;
