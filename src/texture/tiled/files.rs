//! Open files: at most so many at a time, closed in the order of their use, read at positions by
//! many threads (`reading`).
//!
//! Invariant: a file that was replaced or rewritten since it was first opened is told from what it
//! was. Never opens, reads or closes a file inside the lock.

use super::reading::{self, Way};
use crate::error::{Error, Result};
use lru::LruCache;
use rustix::fs::OFlags;
use std::fs::{File, Metadata};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Files that are open at a time unless told otherwise: well below the usual limit of 1024.
pub const DEFAULT_OPEN_FILES: usize = 128;

/// Files that may be open at a time: [`DEFAULT_OPEN_FILES`], or half of what this process may open, so
/// that the other half is left for everything else.
#[must_use]
pub fn open_file_limit() -> usize {
    let most = rustix::process::getrlimit(rustix::process::Resource::Nofile).current.unwrap_or(u64::MAX);
    usize::try_from(most / 2).unwrap_or(usize::MAX).min(DEFAULT_OPEN_FILES)
}

/// What becomes of the bytes that are read, in the operating system's memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Caching {
    /// They bypass its page cache, or are dropped from there at once where the filesystem knows no
    /// direct reads.
    Direct,
    /// As `Direct`, but files that its page cache has anyway are copied from there: reads add
    /// nothing to it.
    Borrow,
    /// They stay in its page cache as long as it likes. For measuring.
    System,
}

/// What tells one file from another of the same name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stamp {
    device: u64,
    inode: u64,
    bytes: u64,
    modified_seconds: i64,
    modified_nanoseconds: i64,
}

impl Stamp {
    fn of(meta: &Metadata) -> Self {
        Self {
            device: meta.dev(),
            inode: meta.ino(),
            bytes: meta.len(),
            modified_seconds: meta.mtime(),
            modified_nanoseconds: meta.mtime_nsec(),
        }
    }
}

/// An open file; counts itself while it lives.
pub(super) struct Open {
    pub(super) file: File,
    /// What is read of it now goes past the page cache.
    pub(super) direct: AtomicBool,
    now: Arc<AtomicUsize>,
}

impl Drop for Open {
    fn drop(&mut self) {
        self.now.fetch_sub(1, Ordering::Relaxed);
    }
}

struct State {
    open: LruCache<u64, Arc<Open>>,
    /// Places promised to threads that are opening a file.
    opening: usize,
}

/// At most so many open files for any number of `PooledFile`s.
pub struct FilePool {
    limit: usize,
    caching: Caching,
    state: Mutex<State>,
    next_id: AtomicU64,
    opens: AtomicU64,
    now: Arc<AtomicUsize>,
    peak: AtomicUsize,
}

impl FilePool {
    /// A pool of `limit` open files, at least one. Threads that read more different files than
    /// that in the same instant exceed it by what they hold.
    #[must_use]
    pub fn new(limit: usize, caching: Caching) -> Self {
        Self {
            limit: limit.max(1),
            caching,
            state: Mutex::new(State { open: LruCache::unbounded(), opening: 0 }),
            next_id: AtomicU64::new(0),
            opens: AtomicU64::new(0),
            now: Arc::new(AtomicUsize::new(0)),
            peak: AtomicUsize::new(0),
        }
    }

    /// How often a file was opened.
    #[must_use]
    pub fn opens(&self) -> u64 {
        self.opens.load(Ordering::Relaxed)
    }

    /// The most files that were open at a time.
    #[must_use]
    pub fn open_peak(&self) -> usize {
        self.peak.load(Ordering::Relaxed)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing that can panic runs between two consistent states.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Opens the file at the system's door, counted.
    fn open_new(&self, path: &Path, direct: bool) -> std::io::Result<Open> {
        let open = |flags: OFlags| {
            let flags = i32::try_from(flags.bits()).unwrap_or(0);
            std::fs::OpenOptions::new().read(true).custom_flags(flags).open(path)
        };
        // NONBLOCK: to open a pipe must not wait for a writer. Files do not mind.
        let (file, direct) = match direct.then(|| open(reading::DIRECT | OFlags::NONBLOCK)) {
            Some(Ok(file)) => (file, true),
            Some(Err(e)) if !reading::refuses_direct(&e) => return Err(e),
            Some(Err(_)) | None => (open(OFlags::NONBLOCK)?, false),
        };
        if self.caching == Caching::Borrow {
            reading::expect_no_order(&file);
        }
        let now = self.now.fetch_add(1, Ordering::Relaxed) + 1;
        self.peak.fetch_max(now, Ordering::Relaxed);
        self.opens.fetch_add(1, Ordering::Relaxed);
        Ok(Open { file, direct: AtomicBool::new(direct), now: Arc::clone(&self.now) })
    }

    /// Promises a place for one more file; whatever made room is closed after the lock.
    fn make_room(&self) {
        let mut evicted = Vec::new();
        let mut state = self.lock();
        while !state.open.is_empty() && state.open.len() + state.opening >= self.limit {
            // A file that someone reads stays open anyway: better one that closes now.
            let idle =
                state.open.iter().rev().find(|(_, open)| Arc::strong_count(open) == 1).map(|(&id, _)| id);
            evicted.push(match idle {
                Some(id) => state.open.pop(&id),
                None => state.open.pop_lru().map(|(_, open)| open),
            });
        }
        state.opening += 1;
        drop(state);
    }

    /// Opens `path` for the first time.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be opened, [`Error::Input`] when it is no regular file.
    pub(super) fn open(self: &Arc<Self>, path: &Path) -> Result<PooledFile> {
        self.make_room();
        let opened = self.open_new(path, self.caching != Caching::System).and_then(|open| {
            let meta = open.file.metadata()?;
            Ok((open, meta))
        });
        let id = self.next_id.fetch_add(1, Ordering::Relaxed);
        let mut state = self.lock();
        state.opening -= 1;
        let (open, meta) = match opened {
            Ok(opened) => opened,
            Err(e) => {
                drop(state);
                return Err(Error::io(path, e));
            }
        };
        if !meta.is_file() {
            drop(state);
            return Err(Error::file(path, "not a regular file; an image is needed"));
        }
        let direct_refused = !open.direct.load(Ordering::Relaxed);
        state.open.put(id, Arc::new(open));
        drop(state);
        Ok(PooledFile {
            pool: Arc::clone(self),
            id,
            path: path.to_path_buf(),
            stamp: Stamp::of(&meta),
            direct_refused: AtomicBool::new(direct_refused),
            way: Way::default(),
        })
    }
}

/// A file of a pool, open or not; what it was when first opened.
pub(super) struct PooledFile {
    pool: Arc<FilePool>,
    id: u64,
    path: PathBuf,
    stamp: Stamp,
    /// The filesystem refused direct reads of this file.
    pub(super) direct_refused: AtomicBool,
    /// Whether the page cache has it anyway, as far as reads have told.
    pub(super) way: Way,
}

/// Why a read failed, for people; without the file's name.
pub(super) type Cause = String;

impl PooledFile {
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Length in bytes when it was first opened.
    pub(super) fn bytes(&self) -> u64 {
        self.stamp.bytes
    }

    pub(super) fn caching(&self) -> Caching {
        self.pool.caching
    }

    /// Its open file, which may be another of the same name by now.
    pub(super) fn get(&self) -> std::result::Result<Arc<Open>, Cause> {
        let open = self.pool.lock().open.get(&self.id).map(Arc::clone);
        match open {
            Some(open) => Ok(open),
            None => self.reopen().map_err(|e| format!("cannot be opened again: {e}")),
        }
    }

    /// An error unless `open` is what the file was when first opened.
    pub(super) fn unchanged(&self, open: &Open) -> std::result::Result<(), Cause> {
        let meta = open.file.metadata().map_err(|e| e.to_string())?;
        if Stamp::of(&meta) != self.stamp {
            return Err("the file changed while rendering; keep files as they are until the end".into());
        }
        Ok(())
    }

    fn reopen(&self) -> std::io::Result<Arc<Open>> {
        let pool = &*self.pool;
        pool.make_room();
        let direct = pool.caching != Caching::System && !self.direct_refused.load(Ordering::Relaxed);
        let opened = pool.open_new(&self.path, direct);
        let mut state = pool.lock();
        state.opening -= 1;
        // Two threads may have opened it: the first one's is kept, the other's closes after the lock.
        let (kept, spare) = match (state.open.get(&self.id).map(Arc::clone), opened) {
            (Some(first), second) => (Ok(first), second.ok()),
            (None, Ok(open)) => {
                let open = Arc::new(open);
                state.open.put(self.id, Arc::clone(&open));
                (Ok(open), None)
            }
            (None, Err(e)) => (Err(e), None),
        };
        drop(state);
        drop(spare);
        kept
    }
}

impl Drop for PooledFile {
    fn drop(&mut self) {
        let open = self.pool.lock().open.pop(&self.id);
        drop(open);
    }
}
