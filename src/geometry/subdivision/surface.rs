//! Faces with neighbours: what every scheme of refinement stands on.
//!
//! Invariant: never welds vertices: only shared indices make an edge shared. Walks go round a vertex in the order of the
//! faces, from the same corner wherever the same faces are.

use super::fault;
use crate::error::Result;
use crate::math::Vec3;
use std::ops::Range;

/// No neighbour: a boundary edge.
pub(super) const NONE: u32 = u32::MAX;

/// How corners are divided among faces.
pub(super) trait Sides {
    /// The next corner of the same face.
    fn next(&self, corner: u32) -> u32;
    /// The one before.
    fn previous(&self, corner: u32) -> u32;
    /// The face that has it.
    fn face(&self, corner: u32) -> u32;
    /// Corners of a face.
    fn corners(&self, face: u32) -> Range<u32>;
}

/// `N` corners a face.
#[derive(Clone, Copy)]
pub(super) struct Sided<const N: u32>;

impl<const N: u32> Sided<N> {
    /// Of a face that is not divided further.
    pub(super) const TRIANGLES: u32 = N - 2;
}

impl<const N: u32> Sides for Sided<N> {
    fn next(&self, corner: u32) -> u32 {
        if corner % N == N - 1 { corner - (N - 1) } else { corner + 1 }
    }

    fn previous(&self, corner: u32) -> u32 {
        if corner.is_multiple_of(N) { corner + (N - 1) } else { corner - 1 }
    }

    fn face(&self, corner: u32) -> u32 {
        corner / N
    }

    fn corners(&self, face: u32) -> Range<u32> {
        N * face..N * (face + 1)
    }
}

/// Faces with neighbours. The edge of a corner runs to the next corner of its face.
pub(super) struct Surface<S> {
    pub(super) sides: S,
    pub(super) positions: Vec<Vec3>,
    pub(super) corners: Vec<u32>,
    /// For each edge, the same edge seen from the face across, or [`NONE`].
    pub(super) twins: Vec<u32>,
    /// A corner of each vertex; on a boundary the one whose edge is a boundary, so that walking
    /// from it meets all faces. [`NONE`] for a vertex that no face uses.
    pub(super) first: Vec<u32>,
    pub(super) boundary: Vec<bool>,
}

impl<S: Sides> Surface<S> {
    /// Of faces whose `corners` are vertices at `positions`, none twice in a face.
    pub(super) fn new(sides: S, positions: &[[f32; 3]], corners: Vec<u32>) -> Result<Self> {
        let count = positions.len();
        if let Some(i) = corners.iter().find(|&&i| i as usize >= count) {
            let message = format!("index {i} of a control mesh of {count} vertices; counted from 0");
            return Err(fault(message));
        }
        let twins = find_twins(&sides, &corners);
        let positions = positions.iter().map(|&p| Vec3::from(p)).collect();
        let mut surface = Self::unwalked(sides, positions, corners, twins);
        surface.find_first();
        surface.split_fans();
        Ok(surface)
    }

    /// Before rings are found.
    pub(super) fn unwalked(sides: S, positions: Vec<Vec3>, corners: Vec<u32>, twins: Vec<u32>) -> Self {
        Self { sides, positions, corners, twins, first: Vec::new(), boundary: Vec::new() }
    }

    pub(super) fn find_first(&mut self) {
        self.first = vec![NONE; self.positions.len()];
        self.boundary = vec![false; self.positions.len()];
        for corner in 0..self.corners.len() as u32 {
            let v = self.corners[corner as usize] as usize;
            if self.twins[corner as usize] == NONE {
                self.first[v] = corner;
                self.boundary[v] = true;
            } else if self.first[v] == NONE {
                self.first[v] = corner;
            }
        }
    }

    /// A vertex where several fans of faces meet (a bow tie) has no ring: each fan beyond the
    /// first gets a vertex of its own at the same place.
    fn split_fans(&mut self) {
        let mut seen = vec![false; self.corners.len()];
        for v in 0..self.first.len() {
            if self.first[v] != NONE {
                self.walk(self.first[v], |c| seen[c as usize] = true);
            }
        }
        let mut split = false;
        for corner in 0..self.corners.len() {
            if seen[corner] {
                continue;
            }
            split = true;
            // Back to where this fan begins, then all of it.
            let mut start = corner as u32;
            loop {
                let back = self.twins[start as usize];
                if back == NONE {
                    break;
                }
                start = self.sides.next(back);
                if start == corner as u32 {
                    break;
                }
            }
            let mut fan = Vec::new();
            self.walk(start, |c| fan.push(c));
            let old = self.corners[corner];
            let new = self.positions.len() as u32;
            self.positions.push(self.positions[old as usize]);
            for c in fan {
                seen[c as usize] = true;
                self.corners[c as usize] = new;
            }
        }
        if split {
            self.find_first();
        }
    }

    /// Visits the corners around a vertex, from `start`, against the winding of boundary edges,
    /// until the fan ends or closes.
    pub(super) fn walk(&self, start: u32, mut visit: impl FnMut(u32)) {
        let mut corner = start;
        loop {
            visit(corner);
            // The edge that ends in this vertex, seen from across, begins in it.
            corner = self.twins[self.sides.previous(corner) as usize];
            if corner == NONE || corner == start {
                return;
            }
        }
    }

    /// The corners around a vertex in the order of a walk; on a boundary the first has its edge there. None where no face is.
    pub(super) fn fan(&self, vertex: usize, fan: &mut Vec<u32>) {
        fan.clear();
        if self.first[vertex] != NONE {
            self.walk(self.first[vertex], |c| fan.push(c));
        }
    }

    /// Where the neighbours on the boundary are of a vertex with this `fan`: the first and the last.
    pub(super) fn ends(&self, fan: &[u32]) -> [Vec3; 2] {
        let [first, last] = [fan[0], fan[fan.len() - 1]];
        [self.at(self.sides.next(first)), self.at(self.sides.previous(last))]
    }

    /// (1 − 2 w) p + w Σ of a boundary vertex and its neighbours there.
    pub(super) fn on_boundary(&self, vertex: usize, fan: &[u32], weight: f32) -> Vec3 {
        let [first, last] = self.ends(fan);
        (1.0 - 2.0 * weight) * self.positions[vertex] + weight * (first + last)
    }

    /// Adds a vertex on each edge to `positions`, half-way on a boundary; elsewhere where `inside` says, given the sum of the
    /// ends, and the edge as seen from both its faces. Of each corner, the vertex on its edge.
    pub(super) fn on_edges(
        &self,
        positions: &mut Vec<Vec3>,
        inside: impl Fn(Vec3, [u32; 2]) -> Vec3,
    ) -> Vec<u32> {
        let mut middles = vec![NONE; self.corners.len()];
        for c in 0..self.corners.len() as u32 {
            if middles[c as usize] != NONE {
                continue;
            }
            middles[c as usize] = positions.len() as u32;
            let ends = self.at(c) + self.at(self.sides.next(c));
            positions.push(match self.twins[c as usize] {
                NONE => 0.5 * ends,
                twin => {
                    middles[twin as usize] = positions.len() as u32;
                    inside(ends, [c, twin])
                }
            });
        }
        middles
    }

    /// Where the vertex of a corner is.
    pub(super) fn at(&self, corner: u32) -> Vec3 {
        self.positions[self.corners[corner as usize] as usize]
    }

    /// Bytes that it takes.
    pub(super) fn bytes(&self) -> usize {
        let Self { sides: _, positions, corners, twins, first, boundary } = self;
        size_of_val(&positions[..])
            + size_of_val(&corners[..])
            + size_of_val(&twins[..])
            + size_of_val(&first[..])
            + size_of_val(&boundary[..])
    }
}

/// Pairs edges by sorting them: no hash table, and the order of faces does not matter. Edges of
/// three faces and more, and of two that wind in opposite senses, become boundaries: the
/// surface opens there, where no smooth surface exists.
fn find_twins(sides: &impl Sides, corners: &[u32]) -> Vec<u32> {
    let mut edges: Vec<(u32, u32, u32)> = (0..corners.len() as u32)
        .map(|c| {
            let (a, b) = (corners[c as usize], corners[sides.next(c) as usize]);
            (a.min(b), a.max(b), c)
        })
        .collect();
    edges.sort_unstable();
    let mut twins = vec![NONE; corners.len()];
    for group in edges.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)) {
        if let [(.., c), (.., d)] = *group
            && corners[c as usize] != corners[d as usize]
        {
            twins[c as usize] = d;
            twins[d as usize] = c;
        }
    }
    twins
}
