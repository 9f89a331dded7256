//! Sums of samples by tile. A tile's samples arrive pass by pass and in one order only, whoever
//! computes them, so the sums do not depend on who finished first.
//!
//! Invariant: a film that keeps more than sums has the same sums.

use super::kept::{Keeps, Kept, Progress};
use crate::clock::Room;
use crate::permits;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard};

/// Between two looks at whether the pass before has come, when it takes long.
const PATIENCE: std::time::Duration = std::time::Duration::from_micros(50);

/// Side of a tile in pixels.
pub const TILE: u32 = 8;

/// A tile's pixels: weighted RGB and weight.
pub(super) struct Tile {
    pub(super) sums: Box<[[f32; 4]]>,
    /// What only some films keep.
    pub(super) kept: Option<Box<Kept>>,
    pub(super) passes: u32,
}

/// The film while rendering: a crop window cut into tiles.
pub struct FilmBuffer {
    /// Window in pixels: x0, y0, x1, y1 (exclusive).
    crop: [u32; 4],
    pub(super) across: u32,
    pub(super) tiles: Vec<Mutex<Tile>>,
    pub(super) keeps: Keeps,
    /// A pass will never come: nobody waits for one any more.
    abandoned: AtomicBool,
}

/// Pixels of a tile: x0, y0, x1, y1 (exclusive).
pub type Rectangle = [u32; 4];

impl FilmBuffer {
    /// An empty film for the window `crop` (not empty).
    #[must_use]
    pub fn new(crop: [u32; 4]) -> Self {
        Self::keeping(crop, Keeps::default())
    }

    /// As [`Self::new`], of a film that keeps more than sums.
    #[must_use]
    pub fn keeping(crop: [u32; 4], keeps: Keeps) -> Self {
        let (w, h) = (crop[2] - crop[0], crop[3] - crop[1]);
        let (across, down) = (w.div_ceil(TILE), h.div_ceil(TILE));
        let abandoned = AtomicBool::new(false);
        let mut buffer = Self { crop, across, tiles: Vec::new(), keeps, abandoned };
        buffer.tiles = (0..across * down)
            .map(|i| {
                let pixels = buffer.pixels(i) as usize;
                let sums = vec![[0.0; 4]; pixels].into();
                Mutex::new(Tile { sums, kept: Kept::new(keeps, pixels), passes: 0 })
            })
            .collect();
        buffer
    }

    /// How many tiles there are.
    #[must_use]
    pub fn tile_count(&self) -> u32 {
        self.tiles.len() as u32
    }

    /// Pixels of tile `i`.
    #[must_use]
    pub fn rectangle(&self, i: u32) -> Rectangle {
        let (x, y) = (self.crop[0] + i % self.across * TILE, self.crop[1] + i / self.across * TILE);
        [x, y, (x + TILE).min(self.crop[2]), (y + TILE).min(self.crop[3])]
    }

    /// Pixels that no pass has reached.
    #[must_use]
    pub fn untouched_pixels(&self) -> u64 {
        let untouched = |i: &u32| self.progress(*i) == Progress::default();
        (0..self.tile_count()).filter(untouched).map(|i| self.pixels(i)).sum()
    }

    /// Pixels of tile `i`.
    pub(super) fn pixels(&self, i: u32) -> u64 {
        let [x0, y0, x1, y1] = self.rectangle(i);
        u64::from(x1 - x0) * u64::from(y1 - y0)
    }

    /// All tiles along a Z-order curve (Morton 1966), so that neighbours come soon after each other.
    #[must_use]
    pub fn along(&self) -> Vec<u32> {
        let spread = |v: u32| (0..16).fold(0u32, |out, bit| out | (v >> bit & 1) << (2 * bit));
        let mut tiles: Vec<u32> = (0..self.tile_count()).collect();
        tiles.sort_by_key(|&i| spread(i % self.across) | spread(i / self.across) << 1);
        tiles
    }

    /// Adds the sums of one pass over tile `i`, in pixel order: a whole one, or one that was `cut` after so many samples,
    /// which is a tile's last. Passes of a tile must come in order; whoever is early waits, which happens only where a
    /// pass ends. False when the pass before was abandoned: nothing is added then.
    pub fn add(&self, i: u32, pass: u32, cut: Option<u32>, sums: &[[f32; 4]]) -> bool {
        let mut tries = 0;
        loop {
            {
                let mut tile = self.tile(i);
                if tile.passes == pass {
                    if let Tile { kept: Some(kept), .. } = &mut *tile
                        && kept.take(cut, sums)
                    {
                        return true;
                    }
                    for (sum, add) in tile.sums.iter_mut().zip(sums) {
                        for (s, a) in sum.iter_mut().zip(add) {
                            *s += a;
                        }
                    }
                    tile.passes += 1;
                    return true;
                }
            }
            if self.abandoned.load(Ordering::Relaxed) {
                return false;
            }
            // Whoever comes before may want the permit.
            tries += 1;
            permits::lend(Room::Idle, || match tries {
                ..100 => std::thread::yield_now(),
                _ => std::thread::sleep(PATIENCE),
            });
        }
    }

    /// Passes that have been added to tile `i`.
    #[must_use]
    pub fn passes(&self, i: u32) -> u32 {
        self.tile(i).passes
    }

    pub(super) fn tile(&self, i: u32) -> MutexGuard<'_, Tile> {
        self.tiles[i as usize].lock().expect("no thread panics while it adds")
    }

    /// Says that some pass will not come.
    pub fn abandon(&self) {
        self.abandoned.store(true, Ordering::Relaxed);
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let pixels = u64::from(self.crop[2] - self.crop[0]) * u64::from(self.crop[3] - self.crop[1]);
        pixels * (16 + self.keeps.pixel_bytes())
            + self.tiles.len() as u64 * (size_of::<Mutex<Tile>>() as u64 + self.keeps.tile_bytes())
    }

    /// Weighted means in rows over the window; black where there is no weight.
    #[must_use]
    pub fn resolve(&self) -> Vec<[f32; 3]> {
        let width = (self.crop[2] - self.crop[0]) as usize;
        let mut image = vec![[0.0; 3]; width * (self.crop[3] - self.crop[1]) as usize];
        for i in 0..self.tile_count() {
            let [x0, y0, x1, y1] = self.rectangle(i);
            let tile = self.tile(i);
            let mut sums = tile.sums.iter();
            let mut cut = tile.kept.iter().flat_map(|kept| kept.cut_sums());
            for y in y0 - self.crop[1]..y1 - self.crop[1] {
                for x in x0 - self.crop[0]..x1 - self.crop[0] {
                    let mut sum = *sums.next().expect("a tile has as many sums as pixels");
                    // What came last is added last.
                    for (s, c) in sum.iter_mut().zip(cut.next().into_iter().flatten()) {
                        *s += c;
                    }
                    let [r, g, b, w] = sum;
                    if w != 0.0 {
                        image[y as usize * width + x as usize] = [r / w, g / w, b / w];
                    }
                }
            }
        }
        image
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_an_odd_window_once() {
        let film = FilmBuffer::new([3, 5, 20, 30]);
        let mut seen = vec![0; 17 * 25];
        for i in 0..film.tile_count() {
            let [x0, y0, x1, y1] = film.rectangle(i);
            for y in y0..y1 {
                for x in x0..x1 {
                    seen[((y - 5) * 17 + x - 3) as usize] += 1;
                }
            }
        }
        assert!(seen.iter().all(|&n| n == 1));
    }

    #[test]
    fn the_order_of_threads_does_not_change_the_sum() {
        // Three passes whose f32 sum depends on the order; the film keeps theirs.
        let film = FilmBuffer::new([0, 0, 1, 1]);
        std::thread::scope(|s| {
            for pass in (0..3).rev() {
                let film = &film;
                s.spawn(move || {
                    assert!(film.add(0, pass, None, &[[[1e8, 1.0, -1e8][pass as usize], 0.0, 0.0, 1.0]]))
                });
            }
        });
        assert_eq!(film.resolve()[0][0], ((1e8f32 + 1.0) - 1e8) / 3.0);
    }
}
