//! Locks of those who make files in the cache directory, so that two who want the same file make it once.
//!
//! Invariant: locks are the operating system's, so that a crash leaves none behind. Their files are bounded in number
//! and never deleted: one that is deleted while another process opens it would lock nothing.

use crate::open::open_entry;
use rustix::fs::OFlags;
use std::fs::{self, DirBuilder, File, OpenOptions, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::Path;
use std::time::Duration;

/// How often somebody who waits for a lock looks whether to give up.
pub(super) const PATIENCE: Duration = Duration::from_millis(20);

/// Held by one maker at a time, once it has waited for it, until it goes.
pub(crate) struct MakersLock(Option<File>);

impl MakersLock {
    /// The lock `name` of the cache directory `dir`; none where there can be none, in a directory that somebody else
    /// made: two may then make the same file, and whoever is last replaces it whole by its like.
    pub(crate) fn open(dir: &Path, name: &str) -> Self {
        Self(open_lock(&dir.join("locks"), name).ok())
    }

    /// Waits until nobody else has it, as long as `go_on` lets it.
    ///
    /// # Errors
    /// Those of `go_on`.
    pub(crate) fn wait<E>(&self, go_on: impl Fn() -> Result<(), E>) -> Result<(), E> {
        while let Some(Err(TryLockError::WouldBlock)) = self.0.as_ref().map(File::try_lock) {
            go_on()?;
            std::thread::sleep(PATIENCE);
        }
        Ok(())
    }
}

/// A directory of the cache's own, made if it is not there.
pub(super) fn own_directory(path: &Path) -> io::Result<()> {
    match DirBuilder::new().mode(0o700).create(path) {
        Err(e) if e.kind() != io::ErrorKind::AlreadyExists => return Err(e),
        _ => {}
    }
    // A link may lead anywhere.
    if fs::symlink_metadata(path)?.is_dir() { Ok(()) } else { Err(io::ErrorKind::NotADirectory.into()) }
}

/// Somebody else's lock may be readable and no more, which is enough to lock it.
fn open_lock(locks: &Path, name: &str) -> io::Result<File> {
    own_directory(locks)?;
    let path = locks.join(name);
    match open_entry(&path) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => {}
        opened => return opened,
    }
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32;
    OpenOptions::new().create(true).append(true).mode(0o600).custom_flags(flags).open(path)
}
