//! Which edges of a displaced mesh are divided, and where.
//!
//! Invariant: the answer depends on the two end points alone, in whatever order they are given.

use super::Place;
use super::view::{Seen, Spot, View};
use crate::math::{DVec3, Transform};
use glam::Vec3;
use rayon::prelude::*;

/// An edge is not divided into more than 2¹⁶ of the mesh's longest: a camera that touches the surface sees pixels of no
/// size there.
const LEAST_EDGE: f64 = 1.0 / 65536.0;

/// For the edges of one mesh.
pub(super) struct Rule {
    to_world: Transform,
    seen: Seen,
    /// Lengths in the world: none shorter is divided, and all longer.
    least: f64,
    most: f64,
}

impl Rule {
    /// For a mesh of `triangles`; no edge is to be longer than `most` in the world.
    pub(super) fn new(
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        place: &Place<'_>,
        view: &View,
        most: Option<f32>,
    ) -> Self {
        let at = |v: u32| place.to_world.point_f64(Vec3::from(positions[v as usize]).as_dvec3());
        let used = || triangles.par_iter().flatten().map(|&v| at(v)).filter(|p| p.is_finite());
        let low = used().reduce(|| DVec3::INFINITY, DVec3::min);
        let high = used().reduce(|| DVec3::NEG_INFINITY, DVec3::max);
        let seen = Seen::new(view, place.places, 0.5 * (low + high), 0.5 * (high - low).length());
        let longest = |t: &[u32; 3]| {
            let [a, b, c] = t.map(at);
            let lengths = [a.distance(b), b.distance(c), c.distance(a)];
            lengths.into_iter().filter(|l| l.is_finite()).fold(0.0, f64::max)
        };
        Self {
            to_world: *place.to_world,
            seen,
            least: triangles.par_iter().map(longest).reduce(|| 0.0, f64::max) * LEAST_EDGE,
            most: most.map_or(f64::INFINITY, f64::from),
        }
    }

    /// Triangles that are made of a mesh at least: none of such edges is larger than the equilateral one.
    pub(super) fn at_least(&self, positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> f64 {
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| self.world(Vec3::from(positions[v as usize])));
            Some(0.5 * (b - a).cross(c - a).length()).filter(|area| area.is_finite()).unwrap_or(0.0)
        };
        triangles.iter().map(area).sum::<f64>() / (0.25 * 3f64.sqrt() * self.most * self.most)
    }

    fn world(&self, p: Vec3) -> DVec3 {
        self.to_world.point_f64(p.as_dvec3())
    }

    /// A point that is asked about.
    #[inline]
    pub(super) fn point(&self, p: Vec3) -> Point {
        Point { p, spot: self.seen.spot(self.world(p)) }
    }

    /// Where the edge from `p` to `q` is divided, if it is.
    #[inline]
    pub(super) fn middle(&self, p: &Point, q: &Point) -> Option<Vec3> {
        let middle = middle(p.p, q.p);
        // Where numbers end, so does dividing.
        (middle != p.p && middle != q.p && middle.is_finite() && self.divides(p, q)).then_some(middle)
    }

    /// Where the edges of a triangle are divided, the one from its first corner to its second first.
    #[inline]
    pub(super) fn middles(&self, [a, b, c]: [&Point; 3]) -> [Option<Vec3>; 3] {
        [(a, b), (b, c), (c, a)].map(|(p, q)| self.middle(p, q))
    }

    fn divides(&self, p: &Point, q: &Point) -> bool {
        let length = p.spot.world.distance_squared(q.spot.world);
        length.is_finite()
            && length > self.least * self.least
            && (length > self.most * self.most || self.seen.edge(&p.spot, &q.spot) > 1.0)
    }
}

/// A point of a mesh, and where it is seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub(super) p: Vec3,
    spot: Spot,
}

/// The same whichever end is named first.
pub(super) fn middle(a: Vec3, b: Vec3) -> Vec3 {
    0.5 * a + 0.5 * b
}

/// Half-way from one normal to another; where they cancel out, one of the two, whichever is named first.
pub(super) fn normal_between(a: Vec3, b: Vec3) -> Vec3 {
    let one = |a: Vec3, b: Vec3| {
        if a.to_array().map(f32::to_bits) <= b.to_array().map(f32::to_bits) { a } else { b }
    };
    middle(a, b).try_normalize().unwrap_or_else(|| one(a, b))
}

/// No vertex in the middle of an edge.
pub(super) const WHOLE: u32 = u32::MAX;

/// What a triangle becomes by the middles of its edges: of its corners, 0 to 2, and of these, 3 to 5; and how many there are.
pub(super) fn split(corners: [Vec3; 3], middles: [Option<Vec3>; 3]) -> ([[u32; 3]; 4], usize) {
    let [a, b, c] = corners;
    let [d, e, f] = middles.map(|middle| middle.unwrap_or(Vec3::ZERO));
    let at = [a, b, c, d, e, f];
    let named = [3, 4, 5].map(|v| if middles[v - 3].is_some() { v as u32 } else { WHOLE });
    cut([0, 1, 2], named, |v| at[v as usize])
}

/// A triangle by the vertices in the middle of its edges; how many there are. Their order is that of the names of triangles.
pub(super) fn cut(
    [a, b, c]: [u32; 3],
    middles: [u32; 3],
    at: impl Fn(u32) -> Vec3,
) -> ([[u32; 3]; 4], usize) {
    let mut out = [[WHOLE; 3]; 4];
    let divided = middles.map(|m| m != WHOLE);
    // Turned so that the first edge is divided and the last is not, unless all are.
    let (t, m) = match divided {
        [true, _, false] | [true, true, true] | [false, false, false] => ([a, b, c], middles),
        [_, true, _] if !divided[0] => ([b, c, a], [middles[1], middles[2], middles[0]]),
        _ => ([c, a, b], [middles[2], middles[0], middles[1]]),
    };
    let [a, b, c] = t;
    let count = match m.map(|m| m != WHOLE) {
        [true, true, true] => {
            out = [[a, m[0], m[2]], [m[0], b, m[1]], [m[2], m[1], c], [m[0], m[1], m[2]]];
            4
        }
        [true, true, false] => {
            out[0] = [m[0], b, m[1]];
            // The shorter diagonal of what is left.
            if at(m[1]).distance_squared(at(a)) <= at(m[0]).distance_squared(at(c)) {
                out[1] = [a, m[0], m[1]];
                out[2] = [a, m[1], c];
            } else {
                out[1] = [a, m[0], c];
                out[2] = [m[0], m[1], c];
            }
            3
        }
        [true, false, _] => {
            out[0] = [a, m[0], c];
            out[1] = [m[0], b, c];
            2
        }
        _ => {
            out[0] = t;
            1
        }
    };
    (out, count)
}
