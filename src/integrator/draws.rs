//! Random numbers of path vertices, for eight paths at a time: one path's numbers fill a register, and
//! so do eight paths' directions. Invariant: what a path gets does not depend on its company.

use super::kernel::Kernel;
use super::path::Path;
use super::sampler::{Octet, SetPair};
use crate::math::warp::cosine_hemisphere;
use glam::{Vec2, Vec3};

/// Paths drawn for together.
pub(super) const LANES: usize = 8;

/// What up to eight paths draw at their vertices.
pub(super) struct Draws {
    sets: SetPair,
    set: u32,
    octet: Octet,
    /// By path.
    numbers: [[f32; 8]; LANES],
    /// Cosine-weighted directions of each path's first two numbers, by coordinate.
    cosine: [[f32; LANES]; 3],
}

impl Draws {
    /// For vertices at `depth`.
    #[inline(always)]
    pub(super) fn new(depth: u32) -> Self {
        let set = 1 + 2 * depth;
        Self {
            sets: SetPair::new(0, set),
            set,
            octet: Octet::EMPTY,
            numbers: [[0.0; 8]; LANES],
            cosine: [[0.0; LANES]; 3],
        }
    }

    /// Draws for `paths`, at most eight.
    #[inline(always)]
    pub(super) fn draw<K: Kernel>(&mut self, paths: &[Path<K>]) {
        for (lane, path) in paths.iter().enumerate().take(LANES) {
            // The paths of a pixel follow each other.
            if path.key != self.sets.key() {
                self.sets = SetPair::new(path.key, self.set);
            }
            self.octet.set(lane, path.sample, &self.sets);
        }
        self.octet.sample(paths.len(), &mut self.numbers);
        for lane in 0..LANES {
            let w = cosine_hemisphere(Vec2::new(self.numbers[lane][0], self.numbers[lane][1]));
            self.cosine[0][lane] = w.x;
            self.cosine[1][lane] = w.y;
            self.cosine[2][lane] = w.z;
        }
    }

    /// Four numbers for the direction and four for the light of path `lane`.
    #[inline(always)]
    pub(super) fn numbers(&self, lane: usize) -> &[f32; 8] {
        &self.numbers[lane]
    }

    /// The direction, z up, that the first two numbers of path `lane` make with a cosine's density.
    #[inline(always)]
    pub(super) fn cosine(&self, lane: usize) -> Vec3 {
        Vec3::new(self.cosine[0][lane], self.cosine[1][lane], self.cosine[2][lane])
    }
}
