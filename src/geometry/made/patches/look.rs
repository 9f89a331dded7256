//! How a displaced mesh falls into pieces: what becomes of each triangle of the base is counted, and as much of it as may be one
//! piece is one.
//!
//! Invariant: pieces depend on the base and the size of pieces alone. Keeps no triangle.

use super::names::{DEEPEST, Node};
use crate::geometry::made::rule::{Point, Rule, split};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Levels that are looked at in parallel.
const PARALLEL: u32 = 6;
/// After so many levels it is asked whether to go on.
const ASK: u32 = 4;

/// The corners of a triangle and the middles of its edges, as far as there are any; what it becomes by these, and how many.
pub(super) fn children(rule: &Rule, corners: [Point; 3]) -> ([Point; 6], [[u32; 3]; 4], usize) {
    let [a, b, c] = corners;
    let middles = rule.middles([&a, &b, &c]);
    let (four, n) = split(corners.map(|corner| corner.p), middles);
    let [d, e, f] = middles.map(|middle| middle.map_or(a, |p| rule.point(p)));
    ([a, b, c, d, e, f], four, n)
}

/// A piece that was found.
pub(super) struct Found {
    pub(super) node: Node,
    pub(super) triangles: u32,
    pub(super) centre: [f32; 3],
}

/// Finds pieces.
pub(super) struct Look<'a> {
    pub(super) rule: &'a Rule,
    pub(super) most: u64,
    pub(super) limit: u64,
    pub(super) stop: &'a (dyn Fn() -> bool + Sync),
    pub(super) counted: &'a AtomicU64,
}

impl Look<'_> {
    /// All pieces of a triangle of the base.
    pub(super) fn all(&self, node: Node, corners: [Point; 3]) -> Vec<Found> {
        let (triangles, mut found) = self.count(node, 0, corners);
        if found.is_empty() {
            found.push(self.found(node, triangles, corners));
        }
        found
    }

    /// How many triangles `node` becomes, and its pieces, unless all of it is one.
    fn count(&self, node: Node, level: u32, corners: [Point; 3]) -> (u64, Vec<Found>) {
        let (six, four, n) = children(self.rule, corners);
        // More are not looked for than can be named.
        let enough = || (self.stop)() || self.counted.load(Ordering::Relaxed) > self.limit;
        if n == 1 || level == DEEPEST || (level.is_multiple_of(ASK) && enough()) {
            return (1, Vec::new());
        }
        let child = |i: usize| {
            let corners = four[i].map(|v| six[v as usize]);
            let node = node.child(i);
            (node, corners, self.count(node, level + 1, corners))
        };
        let below: Vec<_> = if level < PARALLEL {
            (0..n).into_par_iter().map(child).collect()
        } else {
            (0..n).map(child).collect()
        };
        let sum: u64 = below.iter().map(|(.., (count, _))| count).sum();
        if sum <= self.most || level >= Node::LEVELS {
            return (sum, Vec::new());
        }
        let mut out = Vec::new();
        for (node, corners, (count, found)) in below {
            if found.is_empty() {
                out.push(self.found(node, count, corners));
            } else {
                out.extend(found);
            }
        }
        (sum, out)
    }

    fn found(&self, node: Node, triangles: u64, corners: [Point; 3]) -> Found {
        let [a, b, c] = corners.map(|corner| corner.p);
        self.counted.fetch_add(triangles, Ordering::Relaxed);
        let triangles = u32::try_from(triangles).unwrap_or(u32::MAX);
        Found { node, triangles, centre: ((a + b + c) / 3.0).to_array() }
    }
}
