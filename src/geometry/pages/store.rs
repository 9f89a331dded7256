//! The pages of all paged meshes of a scene, inside a number of bytes.
//!
//! Invariant: bytes of pages never exceed what [`PageStore::open`] was given, and [`PageStore::give`] less
//! [`PageStore::take`] since.

use super::cache::PageCache;
use super::files::{PageFiles, PageSource, least_page_budget};
use super::format::read_triangle;
use super::looks::Looks;
use crate::accel::Pages;
use crate::accel::bvh::PageView;
use crate::error::{Error, Result};
use crate::geometry::Mesh;
use crate::stats::{CacheStats, Gauge};
use std::cell::RefCell;
use std::marker::PhantomData;
use std::sync::OnceLock;

thread_local! {
    /// What this thread counts of its looks into the store that lives at the address.
    static HELD: RefCell<Option<(usize, Looks)>> = const { RefCell::new(None) };
    /// The triangle that is shaded.
    static TRIANGLE: RefCell<Mesh> = RefCell::default();
}

/// All pages of a scene.
pub struct PageStore {
    files: PageFiles,
    cache: OnceLock<PageCache>,
}

/// While it lives, this thread counts for itself.
pub struct HeldPages<'a> {
    store: Option<&'a PageStore>,
    /// It belongs to the thread that made it.
    here: PhantomData<*const ()>,
}

impl PageStore {
    /// Of `files`, whose pages are named one after the other from 0.
    ///
    /// # Errors
    /// [`Error::Resource`] when there are more pages than names.
    pub(crate) fn new(files: Vec<PageSource>, page_bytes: usize) -> Result<Self> {
        Ok(Self { files: PageFiles::new(files, page_bytes)?, cache: OnceLock::new() })
    }

    /// Bytes of all pages.
    #[must_use]
    pub fn all_bytes(&self) -> u64 {
        (self.files.pages() * self.files.page_bytes) as u64
    }

    /// Bytes of what pages are made of, which stays.
    #[must_use]
    pub fn control_bytes(&self) -> u64 {
        self.files.control_bytes() as u64
    }

    /// Bytes of one page.
    #[must_use]
    pub fn page_bytes(&self) -> u64 {
        self.files.page_bytes as u64
    }

    /// Bytes that pages may take.
    #[must_use]
    pub fn budget(&self) -> u64 {
        self.cache().budget()
    }

    /// Counts what is in memory by `regions` regions from now on, given pairs of page and region. Once, before any page
    /// is read.
    pub fn watch(&self, pairs: Vec<(u32, u32)>, regions: usize) {
        self.files.residents.watch(pairs, regions);
    }

    /// Bytes of the tables that count.
    #[must_use]
    pub fn watch_bytes(&self) -> u64 {
        self.files.residents.bytes() as u64
    }

    /// Pages of `region` that have been in memory and are not now; `None` where nobody counts.
    #[must_use]
    pub fn gone(&self, region: u32) -> Option<u32> {
        self.files.residents.gone(region)
    }

    /// Least bytes that `threads` threads can work with.
    #[must_use]
    pub fn least(&self, threads: usize) -> u64 {
        least_page_budget(self.files.page_bytes, threads)
    }

    /// Gives it `budget` bytes; once, before any page is asked for.
    ///
    /// # Errors
    /// [`Error::Usage`] when that is less than [`Self::least`].
    pub fn open(&self, budget: u64, threads: usize) -> Result<()> {
        let least = self.least(threads);
        if budget < least {
            return Err(Error::Usage(format!(
                "{budget} bytes for pages of geometry are too few: {threads} threads need {least}, two pages each"
            )));
        }
        assert!(self.cache.set(PageCache::new(&self.files, budget)).is_ok(), "a page store is opened once");
        Ok(())
    }

    fn cache(&self) -> &PageCache {
        self.cache.get().expect("a page store is opened before rays are traced")
    }

    /// What pages cost, the curve of what other budgets would have, and a line for each file of which some page could
    /// not be read.
    #[must_use]
    pub fn stats(&self) -> (CacheStats, Vec<(u64, f64)>, Vec<String>) {
        let cache = self.cache();
        (cache.stats(&self.files), cache.miss_ratio_curve(), cache.failures())
    }

    /// Bytes that pages take now, for whoever watches.
    #[must_use]
    pub fn used(&self) -> Gauge {
        self.cache().used()
    }

    /// Most bytes that pages have taken at once.
    #[must_use]
    pub fn peak(&self) -> u64 {
        self.cache().peak()
    }

    /// Whether a page that comes makes another go.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.cache().is_full(&self.files)
    }

    /// Pages that have come, and the seconds that threads spent reading them.
    #[must_use]
    pub fn read(&self) -> (u64, f64) {
        self.cache().read()
    }

    /// Pages that caches of so many bytes would have read again, so far.
    #[must_use]
    pub fn again(&self, sizes: &[u64]) -> Vec<f64> {
        self.cache().again(sizes)
    }

    /// Lets pages take `bytes` more.
    pub fn give(&self, bytes: u64) {
        self.cache().give(bytes, &self.files);
    }

    /// Takes up to `bytes` from pages, but leaves what `threads` threads need; how many bytes it were, which nobody uses
    /// any more.
    #[must_use]
    pub fn take(&self, bytes: u64, threads: usize) -> u64 {
        self.cache().take(bytes, self.least(threads), &self.files)
    }

    /// Whether no page ever has to go.
    #[must_use]
    pub fn fits_all(&self) -> bool {
        self.files.pages() as u64 * self.files.cost() <= self.budget()
    }

    /// This thread counts its looks together until what is returned goes.
    #[must_use]
    pub fn hold(&self) -> HeldPages<'_> {
        let free = HELD.with_borrow_mut(|held| {
            let free = held.is_none();
            if free {
                *held = Some((self.name(), Looks::new(self.files.count())));
            }
            free
        });
        HeldPages { store: free.then_some(self), here: PhantomData }
    }

    fn name(&self) -> usize {
        std::ptr::from_ref(self).addr()
    }

    /// Calls `look` with a page, which stays for as long.
    #[inline(always)]
    fn with<R>(&self, page: u32, look: impl FnOnce(&[u8]) -> R) -> R {
        let (cache, files) = (self.cache(), &self.files);
        HELD.with_borrow_mut(|held| match held {
            Some((of, thread)) if *of == self.name() => cache.with(files, page, thread, look),
            _ => {
                let mut thread = Looks::new(files.count());
                let result = cache.with(files, page, &mut thread, look);
                cache.finish(thread, files);
                result
            }
        })
    }

    /// Calls `look` with the triangle at `place` of a hit, as a mesh of its own.
    pub(crate) fn with_triangle<R>(&self, place: u32, look: impl FnOnce(&Mesh) -> R) -> R {
        TRIANGLE.with_borrow_mut(|mesh| {
            self.with(PageView::page_of(place), |bytes| {
                read_triangle(bytes, PageView::slot_of(place), mesh);
            });
            look(mesh)
        })
    }
}

impl Pages for PageStore {
    fn visit(&self, page: u32, look: &mut dyn FnMut(&[u8])) {
        self.with(page, |bytes| look(bytes));
    }
}

impl Drop for HeldPages<'_> {
    fn drop(&mut self) {
        if let Some(store) = self.store
            && let Some((_, thread)) = HELD.with_borrow_mut(Option::take)
        {
            store.cache().finish(thread, &store.files);
        }
    }
}
