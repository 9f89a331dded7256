//! The pages of all paged meshes of a scene, inside a number of bytes.
//!
//! Invariant: bytes of pages never exceed what [`PageStore::open`] was given.

use super::file::PageFile;
use super::format::read_triangle;
use super::residents::Residents;
use crate::accel::Pages;
use crate::accel::bvh::PageView;
use crate::error::{Error, Result};
use crate::geometry::Mesh;
use crate::stats::{CacheStats, Gauge};
use crate::texture::cache::{CacheOptions, ThreadCache, TileCache, TileSource, least_budget};
use std::cell::RefCell;
use std::marker::PhantomData;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

thread_local! {
    /// What this thread holds of the store that lives at the address.
    static HELD: RefCell<Option<(usize, Thread)>> = const { RefCell::new(None) };
    /// The triangle that is shaded.
    static TRIANGLE: RefCell<Mesh> = RefCell::default();
}

/// Pages a thread holds at most: rays of a wave go to and fro among some hundreds.
const THREAD_PAGES: usize = 1024;

type Thread = ThreadCache<THREAD_PAGES>;

/// All pages of a scene.
pub struct PageStore {
    /// By page: the file and where its pages begin.
    files: Vec<u32>,
    firsts: Vec<u32>,
    names: Vec<PathBuf>,
    /// Until it is opened.
    sources: Mutex<Vec<Box<dyn TileSource>>>,
    page_bytes: usize,
    residents: Arc<Residents>,
    cache: OnceLock<TileCache>,
}

/// While it lives, this thread holds pages for itself.
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
    pub(crate) fn new(mut files: Vec<PageFile>, page_bytes: usize) -> Result<Self> {
        let mut firsts = Vec::with_capacity(files.len());
        let mut of = Vec::new();
        for (file, i) in files.iter().zip(0u32..) {
            firsts.push(of.len() as u32);
            of.resize(of.len() + file.tile_count() as usize, i);
        }
        if of.len() > PageView::MAX_PAGES as usize {
            return Err(Error::Resource(format!(
                "{} pages of geometry, and {} can be named; give larger ones with --page-size",
                of.len(),
                PageView::MAX_PAGES
            )));
        }
        let residents = Arc::new(Residents::new(of.len()));
        for (file, &first) in files.iter_mut().zip(&firsts) {
            file.report_to(Arc::clone(&residents), first);
        }
        Ok(Self {
            residents,
            files: of,
            firsts,
            names: files.iter().map(|f| f.path().to_path_buf()).collect(),
            sources: Mutex::new(files.into_iter().map(|f| Box::new(f) as Box<dyn TileSource>).collect()),
            page_bytes,
            cache: OnceLock::new(),
        })
    }

    /// Bytes of all pages.
    #[must_use]
    pub fn all_bytes(&self) -> u64 {
        (self.files.len() * self.page_bytes) as u64
    }

    /// Bytes of one page.
    #[must_use]
    pub fn page_bytes(&self) -> u64 {
        self.page_bytes as u64
    }

    /// Bytes that pages may take.
    #[must_use]
    pub fn budget(&self) -> u64 {
        self.cache().budget()
    }

    /// Counts what is in memory by `regions` regions from now on, given pairs of page and region. Once, before any page
    /// is read.
    pub fn watch(&self, pairs: Vec<(u32, u32)>, regions: usize) {
        self.residents.watch(pairs, regions);
    }

    /// Bytes of the tables that count.
    #[must_use]
    pub fn watch_bytes(&self) -> u64 {
        self.residents.bytes() as u64
    }

    /// Pages of `region` that have been in memory and are not now; `None` where nobody counts.
    #[must_use]
    pub fn gone(&self, region: u32) -> Option<u32> {
        self.residents.gone(region)
    }

    /// Least bytes that `threads` threads can work with.
    #[must_use]
    pub fn least(&self, threads: usize) -> u64 {
        least_budget(self.page_bytes, threads)
    }

    /// Gives it `budget` bytes; once, before any page is asked for.
    ///
    /// # Errors
    /// [`Error::Usage`] when that is less than [`Self::least`].
    pub fn open(&self, budget: u64, threads: usize) -> Result<()> {
        let sources = std::mem::take(&mut *self.sources.lock().unwrap_or_else(PoisonError::into_inner));
        let options = CacheOptions { budget, threads, latency: Duration::ZERO, thread_tiles: THREAD_PAGES };
        let cache = TileCache::new(sources, options)?;
        assert!(self.cache.set(cache).is_ok(), "a page store is opened once");
        Ok(())
    }

    fn cache(&self) -> &TileCache {
        self.cache.get().expect("a page store is opened before rays are traced")
    }

    /// What pages cost, the curve of what other budgets would have, and a line for each file of which some page could
    /// not be read.
    #[must_use]
    pub fn stats(&self) -> (CacheStats, Vec<(u64, f64)>, Vec<String>) {
        let cache = self.cache();
        (cache.stats(&self.names), cache.miss_ratio_curve(), cache.failures())
    }

    /// Bytes that pages take now, for whoever watches.
    #[must_use]
    pub fn used(&self) -> Gauge {
        self.cache().used()
    }

    /// Whether no page ever has to go.
    #[must_use]
    pub fn fits_all(&self) -> bool {
        self.cache().fits_all()
    }

    /// This thread holds pages until what is returned goes.
    #[must_use]
    pub fn hold(&self) -> HeldPages<'_> {
        let free = HELD.with_borrow_mut(|held| {
            let free = held.is_none();
            if free {
                *held = Some((self.name(), Thread::new(self.cache())));
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
        let file = self.files[page as usize];
        let tile = page - self.firsts[file as usize];
        HELD.with_borrow_mut(|held| match held {
            Some((of, thread)) if *of == self.name() => look(thread.tile(self.cache(), file, tile)),
            _ => {
                let mut thread = Thread::new(self.cache());
                let result = look(thread.tile(self.cache(), file, tile));
                thread.finish(self.cache());
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
            thread.finish(store.cache());
        }
    }
}
