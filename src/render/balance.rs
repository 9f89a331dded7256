//! Moves memory between textures and geometry while a render runs: the next part of it goes to whoever saves the most
//! seconds of reading with it, by the curves of what caches of other sizes would have read again.
//!
//! Invariant: what both may take together never grows; what one gives is nobody's before the other has it.
//! Never changes the picture, and never takes what a person gave.

use super::meanwhile::meanwhile;
use crate::geometry::pages::PageStore;
use crate::permits::lock;
use crate::stats::MemoryMove;
use crate::texture::cache::TileCache;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Parts of the memory of both that are told apart.
const PARTS: usize = 64;
/// Looks are a share of the time so far apart: a short render has some, a long one not thousands.
const LOOKS: u32 = 16;
const FIRST_LOOK: Duration = Duration::from_millis(20);
/// What was read before the last look counts half, and so on.
const FADING: f64 = 0.5;
/// A move must save this part of the time of reading, and of all time: less is chance.
const WORTH_OF_READING: f64 = 0.05;
const WORTH_OF_TIME: f64 = 0.005;

/// Two caches and what they may take together.
pub(super) struct Balance<'a> {
    tiles: &'a TileCache,
    pages: &'a PageStore,
    /// Threads that look up at the same time, and those that compute.
    looking: usize,
    threads: usize,
    start: Instant,
    /// By part: what tiles could take, and what pages could.
    sizes: [Vec<u64>; 2],
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    looked: Duration,
    /// By part, tiles and pages: what would have been read again, all and of late.
    all: [Vec<f64>; 2],
    late: [Vec<f64>; 2],
    /// Seconds of late.
    late_s: f64,
    moves: Vec<MemoryMove>,
}

impl<'a> Balance<'a> {
    /// Between `tiles` and `pages`, in which `looking` threads look up at the same time while `threads` compute; its time
    /// begins now.
    pub(super) fn new(tiles: &'a TileCache, pages: &'a PageStore, looking: usize, threads: usize) -> Self {
        let all = tiles.budget() + pages.budget();
        let part = |i: usize| all / PARTS as u64 * i as u64;
        let of_tiles: Vec<u64> = (0..=PARTS).map(part).collect();
        let of_pages = of_tiles.iter().map(|bytes| all - bytes).collect();
        Self {
            tiles,
            pages,
            looking,
            threads,
            start: Instant::now(),
            sizes: [of_tiles, of_pages],
            state: Mutex::default(),
        }
    }

    /// Calls `work`, and looks now and then meanwhile. Where the system refuses a thread nothing is moved.
    pub(super) fn during<R>(&self, work: impl FnOnce() -> R) -> R {
        let wait = || (self.start.elapsed() / LOOKS).max(FIRST_LOOK);
        meanwhile("balance", wait, || self.look(&mut lock(&self.state)), work)
    }

    /// What was moved, and how many bytes less than the most of each both took together at any time.
    pub(super) fn finish(self) -> (Vec<MemoryMove>, u64) {
        let moves = self.state.into_inner().unwrap_or_else(PoisonError::into_inner).moves;
        let (tiles, pages) = (self.tiles.peak(), self.pages.peak());
        let both = |of_tiles: u64, of_pages: u64| tiles.min(of_tiles) + pages.min(of_pages);
        let now = both(self.tiles.budget(), self.pages.budget());
        // Before each move the giver had what was moved still.
        let before = moves.iter().map(|m| match m.to.as_str() {
            "textures" => both(m.textures - m.bytes, m.pages + m.bytes),
            _ => both(m.textures + m.bytes, m.pages - m.bytes),
        });
        let together = before.fold(now, u64::max);
        (moves, tiles + pages - together)
    }

    /// Counts what was read since the last look, and moves what that says.
    fn look(&self, state: &mut State) {
        let now = self.start.elapsed();
        let passed = (now - state.looked).as_secs_f64();
        state.looked = now;
        state.late_s = state.late_s * FADING + passed;
        let again = [self.tiles.again(&self.sizes[0]), self.pages.again(&self.sizes[1])];
        for (which, again) in again.into_iter().enumerate() {
            let all = std::mem::replace(&mut state.all[which], again);
            let (now, late) = (&state.all[which], &mut state.late[which]);
            late.resize(PARTS + 1, 0.0);
            for (i, late) in late.iter_mut().enumerate() {
                // Estimates, which may fall.
                let new = (now[i] - all.get(i).copied().unwrap_or(0.0)).max(0.0);
                *late = *late * FADING + new;
            }
        }
        let seconds = self.seconds(&state.late);
        let Some((to, bytes, saved)) = self.wanted(&seconds, state.late_s) else { return };
        let moved = match to {
            "textures" => {
                let moved = self.pages.take(bytes, self.looking);
                self.tiles.give(moved);
                moved
            }
            _ => {
                let moved = self.tiles.take(bytes);
                self.pages.give(moved);
                moved
            }
        };
        if moved > 0 {
            state.moves.push(MemoryMove {
                at_s: now.as_secs_f64(),
                to: to.to_owned(),
                bytes: moved,
                textures: self.tiles.budget(),
                pages: self.pages.budget(),
                saves: saved / state.late_s,
            });
        }
    }

    /// By part: seconds of reading again, of all threads, that caches of these sizes would have had of late.
    fn seconds(&self, late: &[Vec<f64>; 2]) -> Vec<f64> {
        let each = |(count, seconds): (u64, f64)| if count > 0 { seconds / count as f64 } else { 0.0 };
        let (tile, page) = (each(self.tiles.read()), each(self.pages.read()));
        late[0].iter().zip(&late[1]).map(|(tiles, pages)| tiles * tile + pages * page).collect()
    }

    /// Who wants how many bytes of the other's, and the seconds that this would have saved.
    fn wanted(&self, seconds: &[f64], late_s: f64) -> Option<(&'static str, u64, f64)> {
        let part = self.sizes[0][1].max(1) as f64;
        let (parts, saved) = way(seconds, self.tiles.budget() as f64 / part, late_s * self.threads as f64)?;
        if parts > 0.0 {
            // Half of the way: the curves are of what was, and pages that go may have to come again.
            let bytes = parts.min((parts / 2.0).max(1.0)) * part;
            (self.tiles.left() < part as u64).then_some(("textures", bytes as u64, saved))
        } else {
            let idle = self.tiles.left() >= part as u64;
            (idle && self.pages.is_full()).then_some(("geometry", (-parts * part) as u64, saved))
        }
    }
}

/// From `at`, how many parts more for tiles would have cost the fewest `seconds`, of `late_s` in all, and how many fewer
/// those are; `None` where that is not worth it.
fn way(seconds: &[f64], at: f64, late_s: f64) -> Option<(f64, f64)> {
    let at = at.min((seconds.len() - 1) as f64);
    let share = at.fract();
    let here = seconds[at.floor() as usize] * (1.0 - share) + seconds[at.ceil() as usize] * share;
    // Of equals the nearest.
    let far = |i: usize| (i as f64 - at).abs();
    let order = |a: usize, b: usize| seconds[a].total_cmp(&seconds[b]).then(far(a).total_cmp(&far(b)));
    let best = (0..seconds.len()).min_by(|&a, &b| order(a, b))?;
    let saved = here - seconds[best];
    let is_worth = saved > here * WORTH_OF_READING && saved > late_s * WORTH_OF_TIME;
    is_worth.then_some((best as f64 - at, saved))
}

#[cfg(test)]
mod tests {
    use super::way;

    #[test]
    fn memory_goes_where_it_saves_the_most() {
        // Tiles read 60 s again with nothing and none with three parts; pages 10 s more for each that they lack.
        let tiles = |part: i32| 20.0 * f64::from((3 - part).max(0));
        let pages = |part: i32| 10.0 * f64::from(part);
        let both: Vec<f64> = (0..=8).map(|part| tiles(part) + pages(part)).collect();
        assert_eq!(way(&both, 0.0, 100.0), Some((3.0, 30.0)));
        assert_eq!(way(&both, 7.0, 100.0), Some((-4.0, 40.0)));
        assert_eq!(way(&both, 2.5, 100.0), Some((0.5, 5.0)));
        assert_eq!(way(&both, 3.0, 100.0), None);
        // Where one needs nothing the other gets all.
        let pages: Vec<f64> = (0..=8).map(|part| f64::from(part) * 10.0).collect();
        assert_eq!(way(&pages, 8.0, 100.0), Some((-8.0, 80.0)));
    }

    #[test]
    fn chance_moves_nothing() {
        // One part in a hundred of the reading, and a thousandth of the time.
        assert_eq!(way(&[100.0, 99.0, 100.0], 0.0, 100.0), None);
        assert_eq!(way(&[0.1, 0.0, 0.1], 0.0, 100.0), None);
        assert_eq!(way(&[0.0; 9], 4.5, 100.0), None, "where nothing is read again nothing is gained");
    }
}
