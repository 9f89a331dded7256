//! A part of a ray: what it enters between two distances, so that a query can be put down and taken up.
//!
//! Invariant: parts that follow each other without a gap ask about every primitive once, whatever the distances
//! are, because what decides is the distance at which the ray enters the primitive's own box.

use super::primitives::Reference;
use super::query::Query;

/// What the ray enters at `from` or beyond, and before `to`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub(super) from: f32,
    pub(super) to: f32,
}

impl Part {
    /// Everything.
    pub(super) const ALL: Self = Self { from: f32::NEG_INFINITY, to: f32::INFINITY };

    /// Whether nothing comes before it. Triangles that stay belong to the first part.
    #[inline(always)]
    pub(super) fn is_first(self) -> bool {
        self.from == f32::NEG_INFINITY
    }

    /// Whether the ray enters the box of `r` here.
    #[inline(always)]
    pub(super) fn has(self, r: &Reference, query: &Query) -> bool {
        if self.is_first() && self.to == f32::INFINITY {
            return true;
        }
        let (lo, hi) = r.corners();
        let (near, _) = query.inside(lo, hi, f32::INFINITY);
        self.from <= near && near < self.to
    }

    /// The farthest distance that counts where `t_max` does for the whole ray.
    #[inline(always)]
    pub(super) fn until(self, t_max: f32) -> f32 {
        if t_max < self.to { t_max } else { self.to }
    }

    /// For trees over what the part has: a box that holds the box of something entered here is itself left at
    /// `from` or beyond, and entered by `to`, since both distances round alike.
    #[inline(always)]
    pub(super) fn of(self, query: &Query) -> Query {
        query.starting(query.t_min.max(self.from))
    }
}
