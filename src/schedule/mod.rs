//! Decides which rays run next. A ray is a name here: whoever made it says what it is when it is traced, and takes
//! what it met.
//!
//! Invariant: every ray is answered once, and what it met does not depend on when or in which parts it was traced
//! ([`Accel::closest_part`](crate::accel::Accel::closest_part)); so no decision here can change a picture.
//! Never knows a path, a material or a pixel.

mod grid;
mod sorted;
#[cfg(test)]
mod tests;
mod voxel;

pub use grid::Grid;
pub use sorted::Sorted;
pub use voxel::{Ledger, QUEUE_BYTES, Residency, Voxels};

use crate::accel::{Accel, Hit, Ray};
use std::ops::Range;

/// In a ray's name: it only asks whether anything is in its way.
pub const TEST: u32 = 1 << 31;

/// Names that can be given to rays of either kind.
pub const MOST_RAYS: u32 = TEST;

/// Rays by their names.
pub trait Rays: Sync {
    /// The ray called `name`.
    fn ray(&self, name: u32) -> Ray;
}

/// Takes answers. Each thread has its own.
pub trait Sink {
    /// What the ray `name` met.
    fn hit(&mut self, name: u32, hit: Hit);
    /// Whether anything is in the way of the ray `name` (without [`TEST`]).
    fn seen(&mut self, name: u32, occluded: bool);
    /// What was met so far lies together, and what comes next lies elsewhere.
    fn settle(&mut self);
}

/// Traces all rays of `requests`; called by every thread that takes part. What is on its way when `stop` says so is
/// not answered.
pub trait Schedule: Sync {
    /// Works until every ray is answered.
    fn work<A: Accel + ?Sized>(
        &self,
        accel: &A,
        rays: &impl Rays,
        requests: &Requests<'_>,
        sink: &mut impl Sink,
        stop: &(dyn Fn() -> bool + Sync),
    );
}

/// Names of rays to trace, handed out range by range.
pub struct Requests<'r> {
    ranges: &'r [Range<u32>],
    next: std::sync::atomic::AtomicUsize,
}

impl<'r> Requests<'r> {
    /// All of `ranges`.
    #[must_use]
    pub fn new(ranges: &'r [Range<u32>]) -> Self {
        Self { ranges, next: std::sync::atomic::AtomicUsize::new(0) }
    }

    fn take(&self) -> Option<Range<u32>> {
        let i = self.next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        self.ranges.get(i).cloned()
    }
}
