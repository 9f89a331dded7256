//! Rounds of a render that goes on from a checkpoint or stops where its error is low enough: in each, tiles get as many
//! passes as they lack to the number that they are to reach, and when all have it a new number is set for each.
//!
//! Invariant: what is set depends on the film when a round has ended, and on nothing else, so that neither threads nor the
//! order of work nor an interruption change it.
//! Never traces.

use crate::film::{FilmBuffer, LEAST_PASSES, PASS};
use crate::permits::lock;
use crate::scene::SceneDescription;
use crate::settings::RenderSettings;
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Passes before anything is decided about a tile: 64 samples, of which one that is much too bright is one of many.
const DECIDING: u32 = 4;
const _: () = assert!(DECIDING >= LEAST_PASSES, "there is something to decide on");

/// What a tile's root mean square error is to be below, over what is asked for: 95 % of normal errors are within 1.96
/// deviations, and those are to be within 1.5 times of what is asked for.
const LOW_ENOUGH: f64 = 1.5 / 1.96;

/// A tile goes on, whatever its own error, while one beside it has an error so many times as large as is asked for: what
/// that one has met this one may have missed by chance.
const BESIDE: f64 = 2.0;

/// Samples a pixel at most where a noise is asked for and no number: some error that no picture needs lowered is then 1 %
/// of what it was after one.
const MOST_SAMPLES: u32 = 1 << 14;

/// Samples a pixel, at most where a noise is asked for: the scene's own number was made for pictures without.
pub(super) fn samples_asked(scene: &SceneDescription, settings: &RenderSettings) -> u32 {
    let own = if settings.noise.is_some() { MOST_SAMPLES } else { scene.spp };
    settings.spp.unwrap_or(own).max(1)
}

/// How a render goes by rounds.
pub(super) struct Rounds {
    /// Samples a pixel at most.
    spp: u32,
    /// Relative error of a tile that is low enough.
    low_enough: Option<f64>,
    /// Tiles in the order in which they are worked at.
    along: Vec<u32>,
    /// Passes that each tile is to reach.
    targets: Mutex<Vec<u32>>,
}

/// Tiles and the passes that they get.
pub(super) struct Round {
    items: Vec<(u32, Range<u32>)>,
    /// Passes in all items up to each, itself included.
    upto: Vec<u64>,
    next: AtomicUsize,
}

impl Rounds {
    /// From `targets`, those of a checkpoint; else from nothing.
    pub(super) fn new(spp: u32, noise: Option<f64>, film: &FilmBuffer, targets: Option<Vec<u32>>) -> Self {
        let targets = targets.unwrap_or_else(|| vec![0; film.tile_count() as usize]);
        let low_enough = noise.map(|noise| noise * LOW_ENOUGH);
        Self { spp, low_enough, along: film.along(), targets: Mutex::new(targets) }
    }

    /// The next round over `film`, in which nobody works; `None` when all is done.
    pub(super) fn next(&self, film: &FilmBuffer) -> Option<Round> {
        let mut targets = lock(&self.targets);
        loop {
            let round = self.round(film, &targets);
            if !round.items.is_empty() {
                return Some(round);
            }
            let new = self.decide(film);
            if *targets == new {
                return None;
            }
            *targets = new;
        }
    }

    /// Whether tiles stop at different numbers of samples, which nobody knows before.
    pub(super) fn by_error(&self) -> bool {
        self.low_enough.is_some()
    }

    /// Calls `with` with what tiles are to reach, which does not change meanwhile.
    pub(super) fn hold<R>(&self, with: impl FnOnce(&[u32]) -> R) -> R {
        with(&lock(&self.targets))
    }

    /// A line about tiles of `film` that have as many samples as they may, and yet a larger error than was asked for.
    pub(super) fn unmet(&self, film: &FilmBuffer) -> Option<String> {
        let asked = self.low_enough? / LOW_ENOUGH;
        let tiles = film.tile_count();
        let unmet = |&i: &u32| film.error(i).is_none_or(|error| error.worst.sqrt() > asked);
        let count = (0..tiles).filter(unmet).count();
        let share = count as f64 / f64::from(tiles) * 100.0;
        let spp = self.spp;
        (count > 0).then(|| {
            let regions = if count == 1 { "region is" } else { "regions are" };
            format!("{count} {regions} noisier than asked for ({share:.1} %) at {spp} samples per pixel; --spp lets them have more")
        })
    }

    fn round(&self, film: &FilmBuffer, targets: &[u32]) -> Round {
        let mut items = Vec::new();
        let mut upto = Vec::new();
        let mut passes = 0;
        for &tile in &self.along {
            let progress = film.progress(tile);
            let target = targets[tile as usize].min(self.spp.div_ceil(PASS));
            if progress.passes < target && progress.samples() < self.spp {
                passes += u64::from(target - progress.passes);
                items.push((tile, progress.passes..target));
                upto.push(passes);
            }
        }
        Round { items, upto, next: AtomicUsize::new(0) }
    }

    /// Passes that each tile of `film` is to have.
    fn decide(&self, film: &FilmBuffer) -> Vec<u32> {
        let tiles = film.tile_count();
        let all = self.spp.div_ceil(PASS);
        let passes: Vec<u32> = (0..tiles).map(|i| film.progress(i).samples().div_ceil(PASS)).collect();
        let Some(low_enough) = self.low_enough else {
            // All alike: whoever stops the render finds no tile far behind.
            let level = passes.iter().copied().min().map_or(all, next_level).min(all);
            return passes.into_iter().map(|passes| passes.max(level)).collect();
        };
        let errors: Vec<f64> =
            (0..tiles).map(|i| film.error(i).map_or(f64::INFINITY, |e| e.worst.sqrt())).collect();
        let goes_on = |i: u32| {
            passes[i as usize] < DECIDING
                || errors[i as usize] > low_enough
                || film.beside(i).any(|j| errors[j as usize] > BESIDE * low_enough)
        };
        let target = |i: u32| {
            let passes = passes[i as usize];
            if goes_on(i) { next_level(passes).min(all) } else { passes }
        };
        (0..tiles).map(target).collect()
    }
}

/// After so many passes, the number at which is decided again: 1, 2, 3, 4, 6, 8, 12, 16 and so on.
fn next_level(passes: u32) -> u32 {
    if passes < 2 {
        return passes + 1;
    }
    let power = 1 << passes.ilog2();
    if passes < power + power / 2 { power + power / 2 } else { 2 * power }
}

impl Round {
    /// The next tile and its passes, for whoever works at one tile at a time.
    pub(super) fn take(&self) -> Option<(u32, Range<u32>)> {
        self.items.get(self.next.fetch_add(1, Ordering::Relaxed)).cloned()
    }

    /// Tiles that get some.
    pub(super) fn tiles(&self) -> u64 {
        self.items.len() as u64
    }

    /// Passes in all.
    pub(super) fn passes(&self) -> u64 {
        self.upto.last().copied().unwrap_or(0)
    }

    /// Tile and pass of pass `i` of all.
    pub(super) fn unit(&self, i: u64) -> (u32, u32) {
        let at = self.upto.partition_point(|&upto| upto <= i);
        let (tile, passes) = &self.items[at];
        // Counted from the last, since that is what is known.
        (*tile, passes.end - (self.upto[at] - i) as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::Keeps;

    #[test]
    fn levels_grow_by_a_half_or_a_third() {
        let levels: Vec<u32> =
            std::iter::successors(Some(0), |&passes| Some(next_level(passes))).take(10).collect();
        assert_eq!(levels, [0, 1, 2, 3, 4, 6, 8, 12, 16, 24]);
        // From a number that is no level, to the one above it.
        assert_eq!([5, 7, 9, 13, 23].map(next_level), [6, 8, 12, 16, 24]);
    }

    /// Renders rounds until none is left, each pass a constant that depends on `noise(tile, pass)`.
    fn run(rounds: &Rounds, film: &FilmBuffer, noise: impl Fn(u32, u32) -> f32) -> usize {
        let mut count = 0;
        while let Some(round) = rounds.next(film) {
            count += 1;
            let all: Vec<_> = (0..round.passes()).map(|i| round.unit(i)).collect();
            let mut taken = Vec::new();
            while let Some((tile, passes)) = round.take() {
                taken.extend(passes.map(|pass| (tile, pass)));
            }
            assert_eq!(all, taken, "both ways tell the same work");
            for (tile, pass) in taken {
                let samples = (rounds.spp - pass * PASS).min(PASS);
                let value = noise(tile, pass) * samples as f32;
                let sums = [[value, value, value, samples as f32]; 64];
                assert!(film.add(tile, pass, (samples < PASS).then_some(samples), &sums));
            }
        }
        count
    }

    #[test]
    fn where_it_is_noisy_there_are_more_samples() {
        let film = FilmBuffer::keeping([0, 0, 64, 8], Keeps { cut: true, squares: true });
        let rounds = Rounds::new(1000, Some(0.02 / LOW_ENOUGH), &film, None);
        run(&rounds, &film, |tile, pass| if tile == 0 { 1.0 + 0.2 * (pass % 2) as f32 } else { 1.0 });
        let samples: Vec<u32> = (0..8).map(|tile| film.progress(tile).samples()).collect();
        // Passes differ by 0.1 from their mean of 1.1: a relative error of 1/11 at one pass, 2 % at 21.
        assert_eq!(samples[0], 24 * PASS);
        // The tile beside it goes on until that is at twice 2 %.
        assert_eq!(samples[1], 8 * PASS);
        assert!(samples[2..].iter().all(|&s| s == DECIDING * PASS), "{samples:?}");
        assert!(film.error(0).is_some_and(|e| e.worst.sqrt() <= 0.02));
    }

    #[test]
    fn never_more_than_was_asked_for() {
        let film = FilmBuffer::keeping([0, 0, 16, 8], Keeps { cut: true, squares: true });
        run(&Rounds::new(100, Some(0.001), &film, None), &film, |_, pass| (pass % 2) as f32);
        assert_eq!(film.samples(100), (100, 100, 100 * 128));
        assert_eq!(film.progress(0).cut, 4);
    }

    #[test]
    fn more_samples_go_on_from_what_is_there() {
        let film = FilmBuffer::keeping([0, 0, 16, 8], Keeps { cut: true, squares: false });
        let constant = |_, _| 1.0;
        let rounds = run(&Rounds::new(33, None, &film, None), &film, constant);
        assert_eq!((rounds, film.samples(33).2), (3, 33 * 128));
        assert_eq!(run(&Rounds::new(33, None, &film, Some(vec![3, 3])), &film, constant), 0);
        // The third pass is taken up where it was cut, and two more come.
        assert_eq!(run(&Rounds::new(80, None, &film, Some(vec![3, 3])), &film, constant), 3);
        assert_eq!(film.progress(1).passes, 5);
    }
}
