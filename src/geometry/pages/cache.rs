//! The pages that are in memory, inside a number of bytes, each found by its name alone.
//!
//! A page is looked at where it lies, without a lock and without a count that threads share: the table of pages marks
//! what each thread looks at (`arc-swap`). Whoever takes a page out of the table waits with the use of its memory until
//! nobody looks at it any more.
//!
//! Invariants: the bytes of all pages, those being read and those that are gone but still looked at included, never
//! exceed the budget. No lock is held while a file is read. Of threads that miss the same page together one reads and
//! the others wait. A thread looks at one page at a time, and reads none meanwhile.

use super::files::PageFiles;
use super::looks::Looks;
use super::slots::{Slot, Slots};
use crate::clock::Room;
use crate::permits::{self, Promise, lock};
use crate::stats::{CacheRow, CacheStats, Gauge, KeyBuildHasher, References, nanoseconds};
use crate::texture::cache::FileCounts;
use arc_swap::ArcSwapOption;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// Pages that an eviction compares, drawn at random: the coldest of them has a seventeenth of all before it on average.
const COMPARED: usize = 16;
/// Parts of a cache's turnover that its time tells apart: a page is used in one or is not, however often.
const AGES: usize = 16;
/// Of those, after how many a use counts half.
const HALF: f32 = 6.0;

/// A page's place in the table.
struct Entry {
    page: ArcSwapOption<Slot>,
    /// How warm it was when it was last looked at, and when that was. Kept while it is away.
    heat: AtomicU64,
}

impl Entry {
    /// It is looked at in `now`.
    #[inline(always)]
    fn warm(&self, now: u32) {
        let heat = Heat::from_bits(self.heat.load(Ordering::Relaxed));
        if heat.at != now {
            self.heat.store(heat.warmed(now).to_bits(), Ordering::Relaxed);
        }
    }
}

/// How often a page has been looked at of late: each unit of the cache's time in which it was counts one, and half as much
/// when [`HALF`] units have passed (Lee et al. 2001, LRFU).
#[derive(Clone, Copy)]
struct Heat {
    at: u32,
    warmth: f32,
}

impl Heat {
    #[inline(always)]
    fn from_bits(bits: u64) -> Self {
        Self { at: (bits >> 32) as u32, warmth: f32::from_bits(bits as u32) }
    }

    #[inline(always)]
    fn to_bits(self) -> u64 {
        u64::from(self.at) << 32 | u64::from(self.warmth.to_bits())
    }

    /// At `now`.
    fn now(self, now: u32) -> f32 {
        self.warmth * (-(now.saturating_sub(self.at) as f32) / HALF).exp2()
    }

    /// Looked at in `now`.
    #[cold]
    fn warmed(self, now: u32) -> Self {
        Self { at: now, warmth: self.now(now) + 1.0 }
    }
}

/// What happens when pages come and go.
pub(super) struct Comings {
    loading: HashMap<u64, Arc<Promise<Arc<Slot>>>, KeyBuildHasher>,
    /// Pages in the table.
    resident: Vec<u32>,
    /// Gone from the table, and perhaps still looked at.
    gone: Vec<Arc<Slot>>,
    pub(super) slots: Slots,
    /// Makes what is drawn.
    random: u64,
    pub(super) reads: u64,
    /// Reads in a unit of the cache's time, and in the present one so far.
    pub(super) unit: u64,
    since: u64,
}

/// Reads in a unit of the time of a cache with room for so many pages.
pub(super) fn unit_of(room: usize) -> u64 {
    (room / AGES).max(1) as u64
}

/// The pages of a scene that are in memory.
pub(super) struct PageCache {
    entries: Box<[Entry]>,
    pub(super) budget: AtomicU64,
    /// The cache's time.
    now: AtomicU32,
    pub(super) used: Gauge,
    /// Most that was used.
    pub(super) peak: AtomicU64,
    /// Time spent reading, of all threads.
    pub(super) read_ns: AtomicU64,
    pub(super) comings: Mutex<Comings>,
    pub(super) references: References,
    totals: Mutex<FileCounts>,
    /// Largest read buffer of a thread.
    scratch: AtomicU64,
    /// Files of which a page could not be read, with a line each.
    failures: Mutex<Vec<(usize, String)>>,
}

/// Lets nobody wait for a thread that has panicked.
struct Abandon<'a>(&'a PageCache, u32);

impl Drop for Abandon<'_> {
    fn drop(&mut self) {
        let promise = self.0.comings().loading.remove(&u64::from(self.1));
        promise.into_iter().for_each(|promise| promise.keep(None));
    }
}

impl PageCache {
    /// Of the pages of `files`, in `budget` bytes.
    pub(super) fn new(files: &PageFiles, budget: u64) -> Self {
        let room = Self::room_in(budget, files);
        let entry = || Entry { page: ArcSwapOption::empty(), heat: AtomicU64::new(0) };
        Self {
            entries: (0..files.pages()).map(|_| entry()).collect(),
            budget: AtomicU64::new(budget),
            now: AtomicU32::new(1),
            used: Gauge::default(),
            peak: AtomicU64::new(0),
            read_ns: AtomicU64::new(0),
            comings: Mutex::new(Comings {
                loading: HashMap::default(),
                resident: Vec::new(),
                gone: Vec::new(),
                slots: Slots::new(room, files.page_bytes),
                random: 0,
                reads: 0,
                unit: unit_of(room),
                since: 0,
            }),
            references: References::default(),
            totals: Mutex::new(FileCounts::new(files.count())),
            scratch: AtomicU64::new(0),
            failures: Mutex::default(),
        }
    }

    /// Pages that fit in `budget` bytes, and are.
    pub(super) fn room_in(budget: u64, files: &PageFiles) -> usize {
        usize::try_from(budget / files.cost()).unwrap_or(usize::MAX).min(files.pages())
    }

    /// Bytes that pages may take.
    pub(super) fn budget(&self) -> u64 {
        self.budget.load(Ordering::Relaxed)
    }

    /// Bytes that pages take now, for whoever watches.
    pub(super) fn used(&self) -> Gauge {
        Gauge::clone(&self.used)
    }

    /// One line for each file of which a page could not be read, in the order of the first time.
    pub(super) fn failures(&self) -> Vec<String> {
        lock(&self.failures).iter().map(|(_, line)| line.clone()).collect()
    }

    pub(super) fn comings(&self) -> MutexGuard<'_, Comings> {
        lock(&self.comings)
    }

    /// Calls `look` with the bytes of `page`.
    #[inline(always)]
    pub(super) fn with<R>(
        &self,
        files: &PageFiles,
        page: u32,
        thread: &mut Looks,
        look: impl FnOnce(&[u8]) -> R,
    ) -> R {
        let entry = &self.entries[page as usize];
        let now = self.now.load(Ordering::Relaxed);
        // Written only where it changes: the line is every thread's.
        entry.warm(now);
        let known = thread.again(page);
        let guard = entry.page.load();
        if let Some(slot) = &*guard
            && known
        {
            return look(slot);
        }
        drop(guard);
        let slot = self.refer(files, page, thread);
        look(&slot)
    }

    /// A page that this thread has not looked at lately, or that has left since.
    #[cold]
    #[inline(never)]
    fn refer(&self, files: &PageFiles, page: u32, thread: &mut Looks) -> Arc<Slot> {
        thread.refer(page, files, &self.references);
        if let Some(slot) = self.entries[page as usize].page.load_full() {
            thread.book(page, files, |c| c.hits += 1);
            return slot;
        }
        self.fetch(files, page, thread)
    }

    fn fetch(&self, files: &PageFiles, page: u32, thread: &mut Looks) -> Arc<Slot> {
        loop {
            let promise = {
                let mut comings = self.comings();
                // Pages come and go under this lock.
                if let Some(slot) = self.entries[page as usize].page.load_full() {
                    thread.book(page, files, |c| c.hits += 1);
                    return slot;
                }
                let promise = comings.loading.get(&u64::from(page)).map(Arc::clone);
                if promise.is_none() {
                    comings.loading.insert(page.into(), Arc::default());
                }
                promise
            };
            let Some(promise) = promise else { return self.load(files, page, thread) };
            let start = Instant::now();
            if let Some(slot) = promise.wait() {
                thread.book(page, files, |c| {
                    c.misses_duplicate += 1;
                    c.stall_ns += nanoseconds(start);
                });
                return slot;
            }
        }
    }

    /// Reads a page that this thread has promised.
    fn load(&self, files: &PageFiles, page: u32, thread: &mut Looks) -> Arc<Slot> {
        let abandon = Abandon(self, page);
        let start = Instant::now();
        let mut slot = self.room(files);
        let ready = Instant::now();
        let read = files.bring(page, &mut slot, &mut thread.scratch);
        let read_ns = nanoseconds(ready);
        self.read_ns.fetch_add(read_ns, Ordering::Relaxed);
        let failed = u64::from(read.is_err());
        let bytes_read = read.unwrap_or_else(|error| {
            // A page without nodes.
            slot.fill(0);
            self.fail(files.file_of(page), error.to_string());
            0
        });
        let slot = Arc::new(slot);
        // Before it can be found, and so before it can go.
        let first = files.residents.came(page);
        let promise = {
            let mut comings = self.comings();
            let entry = &self.entries[page as usize];
            entry.page.store(Some(Arc::clone(&slot)));
            comings.resident.push(page);
            comings.reads += 1;
            comings.since += 1;
            // Never back, whatever becomes of the unit.
            if comings.since >= comings.unit {
                comings.since = 0;
                self.now.fetch_add(1, Ordering::Relaxed);
            }
            let now = self.now.load(Ordering::Relaxed);
            entry.warm(now);
            comings.loading.remove(&u64::from(page))
        };
        std::mem::forget(abandon);
        promise.into_iter().for_each(|promise| promise.keep(Some(Arc::clone(&slot))));
        let size = slot.len() as u64;
        thread.book(page, files, |c| {
            *(if first { &mut c.misses_compulsory } else { &mut c.misses_capacity }) += 1;
            c.bytes_read += bytes_read;
            c.bytes_loaded += size;
            c.footprint_bytes += if first { size } else { 0 };
            c.stall_ns += ready.duration_since(start).as_nanos() as u64;
            c.read_ns += read_ns;
            c.failed += failed;
        });
        slot
    }

    fn fail(&self, file: usize, line: String) {
        let mut failures = lock(&self.failures);
        if failures.iter().all(|(of, _)| *of != file) {
            failures.push((file, line));
        }
    }

    /// Room for a page: new, or that of one that goes.
    fn room(&self, files: &PageFiles) -> Slot {
        loop {
            {
                let mut comings = self.comings();
                if let Some(slot) = comings.slots.take() {
                    let used = self.used.fetch_add(files.cost(), Ordering::Relaxed) + files.cost();
                    self.peak.fetch_max(used, Ordering::Relaxed);
                    return slot;
                }
                if let Some(slot) = self.evict(&mut comings, files) {
                    return slot;
                }
            }
            // All that is in memory is being read or looked at; that ends, in the time of a read.
            permits::lend(Room::Idle, || std::thread::sleep(Duration::from_micros(20)));
        }
    }

    /// Takes old pages out until one of them is nobody's; `None` when all are in use.
    pub(super) fn evict(&self, comings: &mut Comings, files: &PageFiles) -> Option<Slot> {
        let unused = |slot: &Arc<Slot>| Arc::strong_count(slot) == 1;
        if let Some(at) = comings.gone.iter().position(unused) {
            // Nobody can begin to look at what is in no table.
            return Arc::into_inner(comings.gone.swap_remove(at));
        }
        let now = self.now.load(Ordering::Relaxed);
        while !comings.resident.is_empty() {
            let Comings { resident, random, .. } = &mut *comings;
            let warmth = |at: usize| {
                let heat = self.entries[resident[at] as usize].heat.load(Ordering::Relaxed);
                Heat::from_bits(heat).now(now)
            };
            let drawn = (0..COMPARED).map(|_| {
                // Knuth's multiplier; the high bits are the random ones.
                *random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (((*random >> 32) * resident.len() as u64) >> 32) as usize
            });
            let at = drawn.min_by(|&a, &b| warmth(a).total_cmp(&warmth(b)))?;
            let page = resident.swap_remove(at);
            let slot = self.entries[page as usize].page.swap(None)?;
            files.residents.went(page);
            match Arc::try_unwrap(slot) {
                Ok(slot) => return Some(slot),
                Err(slot) => comings.gone.push(slot),
            }
        }
        None
    }

    /// Takes what a thread has counted, when it is done.
    pub(super) fn finish(&self, thread: Looks, files: &PageFiles) {
        self.scratch.fetch_max(thread.scratch.bytes() as u64, Ordering::Relaxed);
        lock(&self.totals).merge(&thread.finish(files, &self.references));
    }

    /// What it cost.
    pub(super) fn stats(&self, files: &PageFiles) -> CacheStats {
        let counts = lock(&self.totals).clone();
        let total = counts.total();
        let misses = |bytes| self.references.misses(bytes, total.misses_compulsory);
        CacheStats {
            budget: self.budget(),
            peak: self.peak(),
            index_bytes: (files.index_bytes() + size_of_val(&self.entries[..])) as u64,
            buffer_bytes: self.scratch.load(Ordering::Relaxed),
            making_bytes: 0,
            total: CacheRow::from(&total),
            knee: self.references.knee(total.misses_compulsory, misses),
            by_depth: Vec::new(),
            by_file: counts.by_file(&files.names()),
        }
    }

    /// Predicted misses over look-ups for caches of other sizes, in rising order of bytes.
    pub(super) fn miss_ratio_curve(&self) -> Vec<(u64, f64)> {
        let total = lock(&self.totals).total();
        self.references.curve(total.lookups, |bytes| self.references.misses(bytes, total.misses_compulsory))
    }
}
