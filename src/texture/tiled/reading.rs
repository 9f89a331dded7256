//! Reads of open files at a position, by default so that no tile is kept a second time where no budget
//! counts it: out of the operating system's page cache if it has the file anyway, else past it.
//!
//! Whether it has is not asked, which costs as much as a look-up: a read through the page cache that
//! leaves nothing there (`RWF_DONTCACHE`, Linux 6.14) tells by its time. Where the kernel or the
//! filesystem knows no such read, all go past the page cache.
//!
//! Invariant: a file that changed since it was first opened is an error before a byte of it is used:
//! it is looked at after the read. Never reads beyond the 4 KiB blocks that cover what was asked for.

use super::blocks::{BLOCK_BYTES, Blocks};
use super::files::{Caching, Cause, Open, PooledFile};
use rustix::fs::{Advice, OFlags};
use std::fs::File;
use std::io;
use std::num::NonZeroU64;
use std::os::unix::fs::FileExt;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

type Result<T> = std::result::Result<T, Cause>;

#[cfg(target_os = "linux")]
pub(super) const DIRECT: OFlags = OFlags::DIRECT;
#[cfg(not(target_os = "linux"))]
pub(super) const DIRECT: OFlags = OFlags::empty();

/// Whether the filesystem said that it knows no direct reads.
pub(super) fn refuses_direct(e: &io::Error) -> bool {
    matches!(
        rustix::io::Errno::from_io_error(e),
        Some(rustix::io::Errno::INVAL | rustix::io::Errno::OPNOTSUPP | rustix::io::Errno::NOSYS)
    )
}

/// Reads jump about: nothing is to be read ahead, which would stay in the page cache. Advice only.
pub(super) fn expect_no_order(file: &File) {
    let _ = rustix::fs::fadvise(file, 0, None, Advice::Random);
}

/// Which way the next read of a file goes. Decides about time only: both ways bring the same bytes
/// and leave none behind.
pub(super) struct Way {
    /// Reads past the page cache before the next one through it.
    past: AtomicU32,
    /// Reads through it that came from the disk, since one that did not.
    slow: AtomicU32,
}

impl Default for Way {
    /// The first read tells.
    fn default() -> Self {
        Self { past: AtomicU32::new(0), slow: AtomicU32::new(1) }
    }
}

impl Way {
    /// A read from the disk through the page cache costs half as much again as one past it: less than
    /// a hundredth, when one of so many tries it.
    const PAST: u32 = 64;
    /// There is no way through it that leaves nothing.
    const NEVER: u32 = u32::MAX;

    fn is_through(&self) -> bool {
        let past = self.past.load(Ordering::Relaxed);
        if past != 0 && past != Self::NEVER {
            // Threads that take the same number lengthen the time a little.
            self.past.store(past - 1, Ordering::Relaxed);
        }
        past == 0
    }

    /// A read of `bytes` through the page cache took `time`. A copy runs at several bytes a nanosecond
    /// after a few microseconds; no disk answers so soon, a thread that was interrupted neither: the
    /// second slow read in a row counts.
    fn took(&self, bytes: usize, time: Duration) {
        let copied = Duration::from_nanos(8_000 + bytes as u64 / 4);
        if time <= copied {
            self.slow.store(0, Ordering::Relaxed);
        } else if self.slow.fetch_add(1, Ordering::Relaxed) > 0 {
            self.slow.store(1, Ordering::Relaxed);
            self.past.store(Self::PAST, Ordering::Relaxed);
        }
    }

    fn is_refused(&self) -> bool {
        self.past.load(Ordering::Relaxed) == Self::NEVER
    }

    fn refuse(&self) {
        self.past.store(Self::NEVER, Ordering::Relaxed);
    }
}

impl Open {
    /// Makes reads from now on go past the page cache, or not.
    fn turn(&self, direct: bool) -> Result<()> {
        if self.direct.load(Ordering::Relaxed) != direct {
            let flags = if direct { DIRECT } else { OFlags::empty() };
            rustix::fs::fcntl_setfl(&self.file, flags).map_err(|e| e.to_string())?;
            self.direct.store(direct, Ordering::Relaxed);
        }
        Ok(())
    }
}

impl PooledFile {
    /// The `len` bytes at `offset`, in `buffer`, and how many bytes were read for them.
    pub(super) fn read<'b>(
        &self,
        offset: u64,
        len: usize,
        buffer: &'b mut Blocks,
    ) -> Result<(&'b [u8], u64)> {
        let open = self.get()?;
        let skip = (offset % BLOCK_BYTES as u64) as usize;
        // The same for every kind of read, so that scratch does not grow when a file is refused.
        let covering = buffer.bytes_mut((skip + len).next_multiple_of(BLOCK_BYTES));
        let read = self.fill(&open, offset, skip, len, covering);
        // First, since it says more than that a tile ends too early.
        self.unchanged(&open)?;
        Ok((&covering[skip..skip + len], read?))
    }

    fn fill(&self, open: &Open, offset: u64, skip: usize, len: usize, covering: &mut [u8]) -> Result<u64> {
        if let Some(read) = self.through(open, offset, &mut covering[skip..skip + len])? {
            return Ok(read);
        }
        if let Some(read) = self.past(open, offset - skip as u64, covering, skip + len)? {
            return Ok(read);
        }
        self.dropped(open, offset, &mut covering[skip..skip + len])
    }

    /// Reads at `offset` until `out` is full; returns how many bytes were read for it. `scratch` is
    /// used when the bytes cannot be read to where they belong.
    pub(super) fn read_into(&self, offset: u64, out: &mut [u8], scratch: &mut Blocks) -> Result<u64> {
        let open = self.get()?;
        let read = self.fill_out(&open, offset, out, scratch);
        self.unchanged(&open)?;
        read
    }

    fn fill_out(&self, open: &Open, offset: u64, out: &mut [u8], scratch: &mut Blocks) -> Result<u64> {
        if let Some(read) = self.through(open, offset, out)? {
            return Ok(read);
        }
        let (skip, len) = ((offset % BLOCK_BYTES as u64) as usize, out.len());
        if skip == 0 && len.is_multiple_of(BLOCK_BYTES) && out.as_ptr().addr().is_multiple_of(BLOCK_BYTES) {
            return match self.past(open, offset, out, len)? {
                Some(read) => Ok(read),
                None => self.dropped(open, offset, out),
            };
        }
        let covering = scratch.bytes_mut((skip + len).next_multiple_of(BLOCK_BYTES));
        if let Some(read) = self.past(open, offset - skip as u64, covering, skip + len)? {
            out.copy_from_slice(&covering[skip..skip + len]);
            return Ok(read);
        }
        self.dropped(open, offset, out)
    }

    /// Reads through the page cache until `out` is full, if that is this read's way.
    fn through(&self, open: &Open, offset: u64, out: &mut [u8]) -> Result<Option<u64>> {
        match self.caching() {
            Caching::System => self.plain(open, offset, out).map(Some),
            Caching::Direct => Ok(None),
            Caching::Borrow if !self.way.is_through() => Ok(None),
            Caching::Borrow => {
                open.turn(false)?;
                let (mut got, start) = (0, Instant::now());
                while got < out.len() {
                    match read_uncached(&open.file, &mut out[got..], offset + got as u64) {
                        Ok(0) => return Err(cut_short()),
                        Ok(n) => got += n,
                        Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                        Err(e) if rustix::io::Errno::from_io_error(&e) == Some(rustix::io::Errno::INVAL) => {
                            // Another thread has just made it direct.
                            return Ok(None);
                        }
                        Err(e) if refuses_direct(&e) => {
                            self.way.refuse();
                            return Ok(None);
                        }
                        Err(e) => return Err(e.to_string()),
                    }
                }
                self.way.took(got, start.elapsed());
                Ok(Some(got as u64))
            }
        }
    }

    /// Reads whole blocks past the page cache until the first `needed` bytes of `out` are there;
    /// `None` where that is not done.
    fn past(&self, open: &Open, offset: u64, out: &mut [u8], needed: usize) -> Result<Option<u64>> {
        if self.direct_refused.load(Ordering::Relaxed) {
            return Ok(None);
        }
        open.turn(true)?;
        let mut got = 0;
        while got < needed {
            let (rest, at) = (&mut out[got..], offset + got as u64);
            // Another thread may have turned it in this moment; then nothing must stay either.
            let read = if self.way.is_refused() || self.caching() == Caching::Direct {
                open.file.read_at(rest, at)
            } else {
                read_uncached(&open.file, rest, at)
            };
            match read {
                Ok(0) => return Err(cut_short()),
                Ok(n) => got += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) if refuses_direct(&e) && got % BLOCK_BYTES == 0 => {
                    // It let us open the file so and will not read it so.
                    open.turn(false)?;
                    self.direct_refused.store(true, Ordering::Relaxed);
                    return Ok(None);
                }
                Err(e) => return Err(e.to_string()),
            }
            if got < needed && got % BLOCK_BYTES != 0 {
                return Err(cut_short());
            }
        }
        Ok(Some(got as u64))
    }

    fn plain(&self, open: &Open, offset: u64, out: &mut [u8]) -> Result<u64> {
        open.file.read_exact_at(out, offset).map_err(|e| match e.kind() {
            io::ErrorKind::UnexpectedEof => cut_short(),
            _ => e.to_string(),
        })?;
        Ok(out.len() as u64)
    }

    /// Reads through the page cache, and drops from it what was read.
    fn dropped(&self, open: &Open, offset: u64, out: &mut [u8]) -> Result<u64> {
        let read = self.plain(open, offset, out)?;
        // Advice: where it is not taken, the system keeps a copy and nothing else is wrong. Only
        // whole pages are dropped, hence the covering ones.
        let start = offset - offset % BLOCK_BYTES as u64;
        let end = (offset + out.len() as u64).next_multiple_of(BLOCK_BYTES as u64);
        let _ = rustix::fs::fadvise(&open.file, start, NonZeroU64::new(end - start), Advice::DontNeed);
        Ok(read)
    }
}

/// Reads through the page cache what it has, and from the disk the rest, which does not stay there.
#[cfg(target_os = "linux")]
fn read_uncached(file: &File, out: &mut [u8], offset: u64) -> io::Result<usize> {
    use rustix::io::ReadWriteFlags;
    /// Not in the crate's list yet.
    const DONTCACHE: ReadWriteFlags = ReadWriteFlags::from_bits_retain(0x80);
    Ok(rustix::io::preadv2(file, &mut [io::IoSliceMut::new(out)], offset, DONTCACHE)?)
}

#[cfg(not(target_os = "linux"))]
fn read_uncached(_: &File, _: &mut [u8], _: u64) -> io::Result<usize> {
    Err(io::ErrorKind::Unsupported.into())
}

fn cut_short() -> Cause {
    "the file ends within it".into()
}
