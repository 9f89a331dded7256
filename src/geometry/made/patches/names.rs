//! What triangles and vertices of a displaced mesh are known by, whoever makes them.
//!
//! Invariant: a vertex has one key, whichever triangle it is a corner of; what is between two vertices follows from these alone.

use crate::geometry::made::rule::{Point, normal_between};
use glam::{Vec2, Vec3};
use std::hash::{Hash, Hasher};

/// The weight of a vertex of the base.
pub(super) const ONE: u64 = 1 << 62;
/// Most levels: a vertex's weights are exact.
pub(super) const DEEPEST: u32 = 62;

/// A triangle on the way from one of the base to what it becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Node {
    /// Which of up to four, level by level, from the highest bits on; the level in the lowest six.
    path: u64,
    pub(super) triangle: u32,
}

impl Node {
    /// Levels that a path has room for.
    pub(super) const LEVELS: u32 = 29;

    pub(super) fn new(triangle: u32) -> Self {
        Self { path: 0, triangle }
    }

    pub(super) fn level(self) -> u32 {
        self.path as u32 & 63
    }

    /// None is known by its path beyond the last level.
    pub(super) fn child(self, which: usize) -> Self {
        let level = self.level();
        if level == Self::LEVELS {
            return self;
        }
        Self { path: (self.path | (which as u64) << (62 - 2 * level)) + 1, ..self }
    }

    /// Whether `other` is it, or comes of it.
    pub(super) fn holds(self, other: Self) -> bool {
        let level = self.level();
        let apart = (self.path ^ other.path).checked_shr(64 - 2 * level).unwrap_or(0);
        self.triangle == other.triangle && level <= other.level() && apart == 0
    }

    pub(super) fn which(self, level: u32) -> usize {
        (self.path >> (62 - 2 * level)) as usize & 3
    }
}

/// A vertex by where it is on the base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Key {
    pub(super) kind: Kind,
    /// Twice a vertex of the base; the ends of an edge, the smaller first; twice the first triangle of its corners.
    pub(super) ends: [u32; 2],
    /// Of the ends; of the two corners of the smallest numbers.
    pub(super) weights: [u64; 2],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Corner,
    Edge,
    Inside,
}

impl Hash for Key {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let [a, b] = self.ends.map(u64::from);
        state.write_u64(a << 32 | b);
        // The highest bits are those that differ.
        state.write_u64(self.weights[0].rotate_left(24) ^ self.weights[1].rotate_left(3) ^ self.kind as u64);
    }
}

impl Key {
    pub(super) fn corner(v: u32) -> Self {
        Self { kind: Kind::Corner, ends: [v; 2], weights: [ONE, 0] }
    }

    pub(super) fn edge(ends: [u32; 2], weights: [u64; 2]) -> Self {
        let [[a, b], [v, w]] = [ends, ends];
        if a < b {
            Self { kind: Kind::Edge, ends: [a, b], weights }
        } else {
            Self { kind: Kind::Edge, ends: [w, v], weights: [weights[1], weights[0]] }
        }
    }

    /// At `weights` of the `corners` of a triangle, which is none of these; `first` is the first triangle of these corners.
    pub(super) fn of(first: u32, corners: [u32; 3], weights: [u64; 3]) -> Self {
        let [a, b, c] = corners;
        match weights {
            [wa, wb, 0] => Self::edge([a, b], [wa, wb]),
            [0, wb, wc] => Self::edge([b, c], [wb, wc]),
            [wa, 0, wc] => Self::edge([a, c], [wa, wc]),
            _ => {
                let mut by_number = [0, 1, 2].map(|i| (corners[i], weights[i]));
                by_number.sort_unstable();
                let weights = [by_number[0].1, by_number[1].1];
                Self { kind: Kind::Inside, ends: [first; 2], weights }
            }
        }
    }
}

/// A vertex before it is moved.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vertex {
    pub(super) key: Key,
    pub(super) p: Point,
    pub(super) n: Vec3,
    pub(super) uv: Vec2,
}

impl Vertex {
    /// Half-way, at `p`.
    pub(super) fn between(key: Key, p: Point, [a, b]: [&Self; 2]) -> Self {
        Self { key, p, n: normal_between(a.n, b.n), uv: 0.5 * a.uv + 0.5 * b.uv }
    }
}
