//! Memory over time: a thread that looks some times a second and writes down what it saw.
//!
//! Invariant: at most [`MemoryWatch::MOST`] samples are kept, over however long a time: when there are more,
//! every second one goes, and looks become half as frequent.
//! Never asks the threads that work for anything: it reads numbers that they count in any case. Never keeps
//! the process from ending: nobody waits for it but [`MemoryWatch::finish`], which wakes it.

use super::process::rss_bytes;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time between looks, while few have been taken.
const PERIOD: Duration = Duration::from_millis(100);

/// What one look saw. Bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MemorySample {
    /// Seconds since the start.
    pub at_s: f64,
    /// What the process held, by the operating system; `None` when it does not say.
    pub rss: Option<u64>,
    /// Tiles of textures in their cache.
    pub texture_cache: u64,
    /// Pages of geometry in their cache.
    pub geometry_cache: u64,
    /// Geometry that stays, its acceleration structures included.
    pub geometry_staying: u64,
}

/// A number of bytes that somebody else keeps up to date.
pub type Gauge = Arc<AtomicU64>;

#[derive(Default)]
struct Watched {
    textures: OnceLock<Gauge>,
    pages: OnceLock<Gauge>,
    staying: AtomicU64,
    ended: Mutex<bool>,
    end: Condvar,
}

/// Watches memory from when it is made until [`MemoryWatch::finish`] or its own end.
pub struct MemoryWatch {
    watched: Arc<Watched>,
    thread: Option<JoinHandle<Vec<MemorySample>>>,
}

impl MemoryWatch {
    /// Samples that are kept at most.
    pub const MOST: usize = 512;

    /// Watches from now on; `start` is when time begins. Where the system refuses a thread there are no samples.
    #[must_use]
    pub fn new(start: Instant) -> Self {
        let watched = Arc::new(Watched::default());
        let shared = Arc::clone(&watched);
        let look = move || watch(&shared, start, PERIOD);
        let thread = std::thread::Builder::new().name("memory watch".to_owned()).spawn(look).ok();
        Self { watched, thread }
    }

    /// From now on counts these too: caches of textures and pages, where there are any, and what stays.
    pub fn follow(&self, textures: Option<Gauge>, pages: Option<Gauge>, staying_bytes: u64) {
        let Watched { textures: t, pages: p, staying, .. } = &*self.watched;
        // A second scene would change nothing: a watch is for one render.
        for (place, gauge) in [(t, textures), (p, pages)] {
            let _ = gauge.map(|gauge| place.set(gauge));
        }
        staying.store(staying_bytes, Ordering::Relaxed);
    }

    /// Takes a last look and gives back all samples, by time.
    #[must_use]
    pub fn finish(mut self) -> Vec<MemorySample> {
        self.wake();
        self.thread.take().and_then(|thread| thread.join().ok()).unwrap_or_default()
    }

    fn wake(&self) {
        *self.watched.ended.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.watched.end.notify_all();
    }
}

impl Drop for MemoryWatch {
    /// Not joined: an error must not wait.
    fn drop(&mut self) {
        self.wake();
    }
}

fn watch(watched: &Watched, start: Instant, mut period: Duration) -> Vec<MemorySample> {
    let mut samples = Vec::with_capacity(MemoryWatch::MOST);
    loop {
        let guard = watched.ended.lock().unwrap_or_else(PoisonError::into_inner);
        // The first look is at once.
        let wait = if samples.is_empty() { Duration::ZERO } else { period };
        let woken = watched.end.wait_timeout_while(guard, wait, |ended| !*ended);
        let ended = *woken.unwrap_or_else(PoisonError::into_inner).0;
        if samples.len() == MemoryWatch::MOST {
            thin(&mut samples);
            period *= 2;
        }
        samples.push(look(watched, start));
        if ended {
            return samples;
        }
    }
}

fn look(watched: &Watched, start: Instant) -> MemorySample {
    let read = |gauge: &OnceLock<Gauge>| gauge.get().map_or(0, |bytes| bytes.load(Ordering::Relaxed));
    MemorySample {
        at_s: start.elapsed().as_secs_f64(),
        rss: rss_bytes(),
        texture_cache: read(&watched.textures),
        geometry_cache: read(&watched.pages),
        geometry_staying: watched.staying.load(Ordering::Relaxed),
    }
}

/// Every second sample goes, the first stays.
fn thin(samples: &mut Vec<MemorySample>) {
    let mut odd = true;
    samples.retain(|_| {
        odd = !odd;
        !odd
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_the_first_and_every_second() {
        let mut samples: Vec<MemorySample> =
            (0..7).map(|i| MemorySample { at_s: f64::from(i), ..MemorySample::default() }).collect();
        thin(&mut samples);
        assert_eq!(samples.iter().map(|s| s.at_s).collect::<Vec<_>>(), [0.0, 2.0, 4.0, 6.0]);
    }

    #[test]
    fn sees_what_it_follows_and_ends_at_once() {
        let start = Instant::now();
        let watch = MemoryWatch::new(start);
        let (tiles, pages) = (Gauge::default(), Gauge::default());
        tiles.store(7, Ordering::Relaxed);
        pages.store(8, Ordering::Relaxed);
        watch.follow(Some(Arc::clone(&tiles)), Some(pages), 9);
        let asked = Instant::now();
        let samples = watch.finish();
        // Woken, not waited for: a period may well pass on a crowded machine, an hour does not.
        assert!(asked.elapsed() < Duration::from_secs(10));
        let last = samples.last().expect("the last look");
        assert_eq!((last.texture_cache, last.geometry_cache, last.geometry_staying), (7, 8, 9));
        assert!(samples.windows(2).all(|w| w[0].at_s <= w[1].at_s));
        #[cfg(target_os = "linux")]
        assert!(last.rss.expect("Linux tells") > 100_000);
    }

    #[test]
    fn a_long_watch_stays_bounded() {
        let watched = Arc::new(Watched::default());
        let shared = Arc::clone(&watched);
        let thread = std::thread::spawn(move || watch(&shared, Instant::now(), Duration::from_micros(10)));
        // Twice as many looks as are kept, and some.
        std::thread::sleep(Duration::from_millis(300));
        *watched.ended.lock().expect("ours") = true;
        watched.end.notify_all();
        let samples = thread.join().expect("it ends");
        assert!(samples.len() <= MemoryWatch::MOST);
        assert!(samples.windows(2).all(|w| w[0].at_s <= w[1].at_s));
    }
}
