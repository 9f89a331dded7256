//! What some films keep beside the sums of their pixels: the sums of a pass that was cut short, so that a later render can
//! take its missing samples, and what tells how far passes differ from each other.
//!
//! Invariant: sums of whole passes are never mixed with those of a cut one.

use super::FilmBuffer;

/// Samples of a pixel that are traced together and summed before they are added to its sum.
pub const PASS: u32 = 16;

/// What a film keeps beside sums.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Keeps {
    /// The sums of a cut pass apart, so that it can be continued.
    pub cut: bool,
    /// The squares of the sums of passes, which tell the error of their mean.
    pub squares: bool,
}

impl Keeps {
    fn any(self) -> bool {
        self.cut || self.squares
    }

    /// Bytes a pixel beside its sums, at most.
    #[must_use]
    pub fn pixel_bytes(self) -> u64 {
        if self.any() { 16 + if self.squares { 12 } else { 0 } } else { 0 }
    }

    /// Bytes a tile beside its own.
    #[must_use]
    pub fn tile_bytes(self) -> u64 {
        if self.any() { size_of::<Kept>() as u64 } else { 0 }
    }
}

/// How far a tile is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Whole passes.
    pub passes: u32,
    /// Samples of a cut pass after them, where the film keeps those apart.
    pub cut: u32,
}

impl Progress {
    /// Samples of each pixel.
    #[must_use]
    pub fn samples(self) -> u32 {
        self.passes * PASS + self.cut
    }
}

/// Beside the sums of a tile.
pub(super) struct Kept {
    /// By pixel and channel, over whole passes: the square of the sum over its weight. None where nobody asks.
    pub(super) squares: Box<[[f32; 3]]>,
    /// Sums of the cut pass, and how many samples they are; empty without one.
    pub(super) cut: Box<[[f32; 4]]>,
    pub(super) cut_samples: u32,
}

impl Kept {
    pub(super) fn new(keeps: Keeps, pixels: usize) -> Option<Box<Self>> {
        let squares = vec![[0.0; 3]; if keeps.squares { pixels } else { 0 }].into();
        keeps.any().then(|| Box::new(Self { squares, cut: Box::default(), cut_samples: 0 }))
    }

    /// Takes the sums of a pass; true when they are to be added to no others.
    pub(super) fn take(&mut self, cut: Option<u32>, sums: &[[f32; 4]]) -> bool {
        if let Some(samples) = cut {
            self.cut = sums.into();
            self.cut_samples = samples;
            return true;
        }
        self.cut = Box::default();
        self.cut_samples = 0;
        for (squares, &[r, g, b, w]) in self.squares.iter_mut().zip(sums) {
            // Filters with lobes below zero may, were there few samples, leave no weight.
            let over = 1.0 / w.abs().max(1.0);
            for (square, x) in squares.iter_mut().zip([r, g, b]) {
                *square += x * x * over;
            }
        }
        false
    }

    /// The sums of the cut pass, if there is one.
    pub(super) fn cut_sums(&self) -> &[[f32; 4]] {
        &self.cut
    }
}

impl FilmBuffer {
    /// How far tile `i` is.
    #[must_use]
    pub fn progress(&self, i: u32) -> Progress {
        let tile = self.tile(i);
        Progress { passes: tile.passes, cut: tile.kept.as_ref().map_or(0, |kept| kept.cut_samples) }
    }

    /// Samples of pass `pass` over tile `i` that there are already: of a cut pass that is to be continued.
    #[must_use]
    pub fn begun(&self, i: u32, pass: u32) -> u32 {
        if !self.keeps.cut {
            return 0;
        }
        let progress = self.progress(i);
        if progress.passes == pass { progress.cut } else { 0 }
    }

    /// The sums of what [`Self::begun`] counts, in pixel order; none where that is nothing.
    #[must_use]
    pub fn begun_sums(&self, i: u32, pass: u32) -> Box<[[f32; 4]]> {
        let tile = self.tile(i);
        let cut = tile.kept.as_ref().filter(|_| tile.passes == pass);
        cut.map(|kept| kept.cut.clone()).unwrap_or_default()
    }

    /// The tiles that touch tile `i`, at corners too.
    pub fn beside(&self, i: u32) -> impl Iterator<Item = u32> {
        let (across, down) = (self.across, self.tile_count() / self.across);
        let (x, y) = (i % across, i / across);
        let rows = y.saturating_sub(1)..(y + 2).min(down);
        let columns = x.saturating_sub(1)..(x + 2).min(across);
        rows.flat_map(move |v| columns.clone().map(move |u| v * across + u)).filter(move |&j| j != i)
    }

    /// Samples of the pixels that have fewest and most, and of all pixels, where none has more than `spp`.
    #[must_use]
    pub fn samples(&self, spp: u32) -> (u32, u32, u64) {
        let mut all = (u32::MAX, 0, 0);
        for i in 0..self.tile_count() {
            // Where a cut pass is not kept apart it counts as a whole one.
            let samples = self.progress(i).samples().min(spp);
            all = (all.0.min(samples), all.1.max(samples), all.2 + self.pixels(i) * u64::from(samples));
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pass of so many samples of a pixel whose sum is `value`.
    fn pass(value: f32, samples: f32) -> [[f32; 4]; 1] {
        [[value, 2.0 * value, 0.0, samples]]
    }

    #[test]
    fn a_cut_pass_is_in_the_picture_and_not_in_the_sums() {
        let keeps = Keeps { cut: true, squares: true };
        let (plain, film) = (FilmBuffer::new([0, 0, 1, 1]), FilmBuffer::keeping([0, 0, 1, 1], keeps));
        for film in [&plain, &film] {
            assert!(film.add(0, 0, None, &pass(1e8, 16.0)) && film.add(0, 1, Some(5), &pass(3.0, 5.0)));
        }
        assert_eq!(plain.resolve(), film.resolve(), "what is kept apart changes no bit");
        assert_eq!(film.progress(0), Progress { passes: 1, cut: 5 });
        assert_eq!((film.begun(0, 1), film.begun(0, 0), plain.begun(0, 1)), (5, 0, 0));
        assert_eq!(*film.begun_sums(0, 1), pass(3.0, 5.0));
        assert!(film.begun_sums(0, 2).is_empty());
        assert_eq!(film.samples(64), (21, 21, 21));
        assert!(film.add(0, 1, None, &pass(9.0, 16.0)), "the whole pass takes its place");
        assert_eq!(film.progress(0), Progress { passes: 2, cut: 0 });
        assert_eq!(film.resolve()[0][0], (1e8 + 9.0) / 32.0);
    }
}
