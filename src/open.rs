//! Opens files for reading.
//!
//! Invariant: what is opened is a regular file, and nothing is waited for: a pipe that nobody writes to
//! would otherwise hold the program before it can be asked what it is.
//! Never reads.

use rustix::fs::OFlags;
use std::fs::{File, OpenOptions, metadata};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Opens the regular file `path`, through symbolic links; `None` where something else stands there.
///
/// # Errors
/// The operating system's, where nothing stands there or it may not be read.
pub fn open_regular(path: &Path) -> io::Result<Option<File>> {
    match open_at_once(path, OFlags::empty()) {
        Ok(file) => Ok(file.metadata()?.is_file().then_some(file)),
        // A socket cannot be opened at all.
        Err(_) if metadata(path).is_ok_and(|there| !there.is_file()) => Ok(None),
        Err(e) => Err(e),
    }
}

/// Opens what is at `path` itself if that is a regular file: not what a symbolic link there names.
///
/// # Errors
/// The operating system's; and where something else stands there.
pub(crate) fn open_entry(path: &Path) -> io::Result<File> {
    let file = open_at_once(path, OFlags::NOFOLLOW)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(io::Error::other("not a regular file")) }
}

fn open_at_once(path: &Path, flags: OFlags) -> io::Result<File> {
    let flags = flags | OFlags::NONBLOCK;
    OpenOptions::new().read(true).custom_flags(flags.bits() as i32).open(path)
}
