//! Decides which rays run next, where rays wait: each in the queue of the voxel whose geometry it needs next, until
//! that is the voxel to run (Pharr et al. 1997). Without voxels there is one queue, whose rays are sorted (Eisenacher
//! et al. 2013).
//!
//! A ray travels by value, with whatever its owner gives it to carry; nothing else knows where it is.
//!
//! Invariant: every ray is answered once, and what it meets does not depend on when or in which parts it is traced
//! ([`Accel::closest_part`](crate::accel::Accel::closest_part)); so no decision here can change a picture.
//! Never knows a path, a material or a pixel.

mod bag;
mod grid;
mod ledger;
mod meter;
mod order;
mod queues;
mod spill;
#[cfg(test)]
mod spill_tests;
mod spilling;
#[cfg(test)]
mod tests;
mod worker;

pub use grid::Grid;
pub use ledger::{Ledger, Residency};
pub use meter::{Meter, PIECE_BYTES, Piece, WORDS};
pub use order::Order;
pub use queues::{Limits, Queues, Space};
pub use spill::Spill;

use crate::accel::{Hit, Ray};

/// Something that carries a ray: plain words, so that it can lie anywhere.
pub trait Traveller: bytemuck::Pod + Send {
    /// The ray.
    fn ray(&self) -> Ray;
}

/// Rays that have not been traced: those that look for what is nearest, and those that ask whether anything is in their
/// way.
#[derive(Debug)]
pub struct Fresh<P, T> {
    /// Nearest.
    pub paths: Vec<P>,
    /// Any.
    pub tests: Vec<T>,
}

impl<P, T> Default for Fresh<P, T> {
    fn default() -> Self {
        Self { paths: Vec::new(), tests: Vec::new() }
    }
}

/// Takes answers, and gives new rays for them. Each thread has its own.
pub trait Sink<P, T> {
    /// Adds some of the rays that all begins with. Keeps `pieces` ([`Limits::begun`] of them) until their last answer has
    /// come, and then gives them to the [`Meter`]; gives them back at once when there are no rays left.
    fn begin(&mut self, pieces: Vec<Piece>, fresh: &mut Fresh<P, T>) -> Option<Vec<Piece>>;
    /// What a path met.
    fn hit(&mut self, path: P, hit: Hit, fresh: &mut Fresh<P, T>);
    /// Whether anything was in the way of a test.
    fn seen(&mut self, test: T, occluded: bool);
    /// What was met so far lies together, and what comes next lies elsewhere: works on it, if it is worth while or if
    /// it must `all` be done. Whether there was anything.
    fn settle(&mut self, all: bool, fresh: &mut Fresh<P, T>) -> bool;
}
