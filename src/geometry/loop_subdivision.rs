//! Loop subdivision (Loop 1987; limit rules as in pbrt 3rd ed., §3.8): refines a control mesh, then
//! pushes its vertices to the limit surface with the limit's normals. Boundaries follow the cubic
//! B-spline of their own edges.
//!
//! Invariant: a level multiplies the triangles by four exactly; more than [`MAX_TRIANGLES`] are
//! refused before any work (36 bytes a vertex and 24 a triangle at the peak: 2²⁸ triangles take some
//! 11 GB). Never welds vertices: only shared indices make an edge shared.

mod parts;

pub use parts::divide;

use crate::error::{Error, Result};
use crate::math::Vec3;
use crate::scene::TriangleMesh;
use std::f32::consts::PI;

/// Most triangles after refinement.
pub const MAX_TRIANGLES: u64 = 1 << 28;
/// No neighbour: a boundary edge.
const NONE: u32 = u32::MAX;

/// Refines `control` `levels` times and returns positions and normals on the limit surface, object
/// space. Texture coordinates and given normals of the control mesh are dropped, as in pbrt. With
/// 0 levels the control vertices themselves are pushed to the limit.
///
/// # Errors
/// [`Error::Input`] without a file when an index is out of range or the result would be larger than
/// [`MAX_TRIANGLES`]; the caller, who knows the place, names it.
pub fn subdivide(control: &TriangleMesh, levels: u32) -> Result<TriangleMesh> {
    check(control, levels)?;
    let mut surface = Surface::new(control)?;
    for _ in 0..levels {
        surface = surface.refine();
    }
    Ok(surface.limit())
}

fn check(control: &TriangleMesh, levels: u32) -> Result<()> {
    let wanted = (control.indices.len() as u64).saturating_mul(4u64.saturating_pow(levels));
    if wanted > MAX_TRIANGLES {
        return Err(fault(format!(
            "Loop subdivision to {levels} levels makes {wanted} triangles; {MAX_TRIANGLES} at most"
        )));
    }
    Ok(())
}

/// Triangles with neighbours. Corner c of triangle t is `3 t + c`; its edge runs to the next corner.
struct Surface {
    positions: Vec<Vec3>,
    corners: Vec<u32>,
    /// For each edge, the same edge seen from the triangle across, or [`NONE`].
    twins: Vec<u32>,
    /// A corner of each vertex; on a boundary the one whose edge is a boundary, so that walking
    /// from it meets all triangles. [`NONE`] for a vertex that no triangle uses.
    first: Vec<u32>,
    boundary: Vec<bool>,
}

fn next(corner: u32) -> u32 {
    if corner % 3 == 2 { corner - 2 } else { corner + 1 }
}

fn previous(corner: u32) -> u32 {
    if corner.is_multiple_of(3) { corner + 2 } else { corner - 1 }
}

fn fault(message: String) -> Error {
    Error::file("loop subdivision", message)
}

impl Surface {
    fn new(mesh: &TriangleMesh) -> Result<Self> {
        let count = mesh.positions.len();
        if let Some(i) = mesh.indices.iter().flatten().find(|&&i| i as usize >= count) {
            let message = format!("index {i} of a control mesh of {count} vertices; counted from 0");
            return Err(fault(message));
        }
        // A triangle that repeats a vertex has no edge ring.
        let corners: Vec<u32> = mesh
            .indices
            .iter()
            .filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0])
            .flatten()
            .copied()
            .collect();
        let twins = find_twins(&corners);
        let positions = mesh.positions.iter().map(|&p| Vec3::from(p)).collect();
        let mut surface = Self { positions, corners, twins, first: Vec::new(), boundary: Vec::new() };
        surface.find_first();
        surface.split_fans();
        Ok(surface)
    }

    fn find_first(&mut self) {
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

    /// A vertex where several fans of triangles meet (a bow tie) has no ring: each fan beyond the
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
                start = next(back);
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
    fn walk(&self, start: u32, mut visit: impl FnMut(u32)) {
        let mut corner = start;
        loop {
            visit(corner);
            // The edge that ends in this vertex, seen from across, begins in it.
            corner = self.twins[previous(corner) as usize];
            if corner == NONE || corner == start {
                return;
            }
        }
    }

    /// Neighbours of a vertex in order; on a boundary the first and the last lie on it.
    fn ring(&self, vertex: usize, ring: &mut Vec<u32>) {
        ring.clear();
        let start = self.first[vertex];
        if start == NONE {
            return;
        }
        let mut last = start;
        self.walk(start, |c| {
            ring.push(self.corners[next(c) as usize]);
            last = c;
        });
        if self.boundary[vertex] {
            ring.push(self.corners[previous(last) as usize]);
        }
    }

    /// (1 − n w) p + w Σ ring, over the whole ring or over a boundary's two ends.
    fn smoothed(&self, vertex: usize, ring: &[u32], inner: impl Fn(f32) -> f32, edge: f32) -> Vec3 {
        let p = self.positions[vertex];
        let at = |i: u32| self.positions[i as usize];
        match ring {
            [] => p,
            [a, .., b] if self.boundary[vertex] => (1.0 - 2.0 * edge) * p + edge * (at(*a) + at(*b)),
            ring => {
                let n = ring.len() as f32;
                let w = inner(n);
                (1.0 - n * w) * p + w * ring.iter().fold(Vec3::ZERO, |s, &i| s + at(i))
            }
        }
    }

    fn refine(&self) -> Self {
        let mut fine = self.divided();
        fine.find_first();
        fine
    }

    /// Refined, before rings are found.
    fn divided(&self) -> Self {
        let mut ring = Vec::new();
        let old = self.positions.len();
        let mut positions = Vec::with_capacity(old + self.corners.len() / 2 + 1);
        for v in 0..old {
            self.ring(v, &mut ring);
            positions.push(self.smoothed(v, &ring, beta, 1.0 / 8.0));
        }
        // A vertex on each edge, numbered by the first corner that has it.
        let mut middle = vec![NONE; self.corners.len()];
        let at = |c: u32| self.positions[self.corners[c as usize] as usize];
        for c in 0..self.corners.len() as u32 {
            if middle[c as usize] != NONE {
                continue;
            }
            middle[c as usize] = positions.len() as u32;
            let ends = at(c) + at(next(c));
            positions.push(match self.twins[c as usize] {
                NONE => 0.5 * ends,
                twin => {
                    middle[twin as usize] = positions.len() as u32;
                    0.375 * ends + 0.125 * (at(previous(c)) + at(previous(twin)))
                }
            });
        }
        // Triangle t becomes 4t..4t+2, one at each corner with that corner first, and 4t+3 inside,
        // whose edge k faces child k + 1.
        let mut corners = Vec::with_capacity(4 * self.corners.len());
        let mut twins = Vec::with_capacity(4 * self.corners.len());
        let corner_child = |c: u32| 3 * (4 * (c / 3) + c % 3);
        for t in 0..self.corners.len() as u32 / 3 {
            let inside = 3 * (4 * t + 3);
            for k in 0..3 {
                let c = 3 * t + k;
                let before = previous(c);
                corners.extend([self.corners[c as usize], middle[c as usize], middle[before as usize]]);
                // Half of the edge to the next corner lies against the child at its far end.
                let out = self.twins[c as usize];
                let back = self.twins[before as usize];
                twins.push(if out == NONE { NONE } else { corner_child(next(out)) + 2 });
                twins.push(inside + (k + 2) % 3);
                twins.push(if back == NONE { NONE } else { corner_child(back) });
            }
            corners.extend((0..3).map(|k| middle[(3 * t + k) as usize]));
            twins.extend((0..3).map(|k| corner_child(3 * t + (k + 1) % 3) + 1));
        }
        Self { positions, corners, twins, first: Vec::new(), boundary: Vec::new() }
    }

    fn limit(&self) -> TriangleMesh {
        let mut mesh = TriangleMesh::default();
        mesh.positions.reserve_exact(self.positions.len() + 1);
        mesh.normals.reserve_exact(self.positions.len());
        let (mut indices, mut ring) = (Vec::new(), Vec::new());
        for v in 0..self.positions.len() {
            self.ring(v, &mut indices);
            let p = self.smoothed(v, &indices, |n| 1.0 / (n + 3.0 / (8.0 * beta(n))), 1.0 / 5.0);
            mesh.positions.push(p.to_array());
            ring.clear();
            ring.extend(indices.iter().map(|&i| self.positions[i as usize]));
            let (s, t) = if self.boundary[v] {
                boundary_tangents(self.positions[v], &ring)
            } else {
                interior_tangents(&ring)
            };
            mesh.normals.push(s.cross(t).normalize_or_zero().to_array());
        }
        mesh.indices = self.corners.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
        mesh.pad_positions();
        mesh
    }
}

/// Weight of each neighbour of an interior vertex of valence n (Warren's).
fn beta(n: f32) -> f32 {
    if n == 3.0 { 3.0 / 16.0 } else { 3.0 / (8.0 * n) }
}

/// The eigenvectors of the subdivision matrix: the ring runs counter-clockwise seen from outside, so
/// that first × second points outwards (pbrt walks the other way and its normals point inwards).
fn interior_tangents(ring: &[Vec3]) -> (Vec3, Vec3) {
    let mut tangents = (Vec3::ZERO, Vec3::ZERO);
    for (i, &p) in ring.iter().enumerate() {
        let (sin, cos) = (2.0 * PI * i as f32 / ring.len() as f32).sin_cos();
        tangents.0 += cos * p;
        tangents.1 += sin * p;
    }
    tangents
}

/// Along the boundary and across it (Hoppe et al. 1994; Zorin and Schröder's course, table).
fn boundary_tangents(p: Vec3, ring: &[Vec3]) -> (Vec3, Vec3) {
    let (Some(&first), Some(&last)) = (ring.first(), ring.last()) else {
        return (Vec3::ZERO, Vec3::ZERO);
    };
    let along = first - last;
    let across = match ring {
        [a, b] => *a + *b - 2.0 * p,
        [_, b, _] => *b - p,
        [a, b, c, d] => 2.0 * (*b + *c) - *a - *d - 2.0 * p,
        _ => {
            let theta = PI / (ring.len() - 1) as f32;
            let inner = ring[1..ring.len() - 1].iter().enumerate();
            inner.fold(-theta.sin() * (first + last), |sum, (k, &q)| {
                sum - (2.0 * theta.cos() - 2.0) * ((k + 1) as f32 * theta).sin() * q
            })
        }
    };
    (along, across)
}

/// Pairs edges by sorting them: no hash table, and the order of triangles does not matter. Edges of
/// three triangles and more, and of two that wind in opposite senses, become boundaries: the
/// surface opens there, where no smooth surface exists.
fn find_twins(corners: &[u32]) -> Vec<u32> {
    let mut edges: Vec<(u32, u32, u32)> = (0..corners.len() as u32)
        .map(|c| {
            let (a, b) = (corners[c as usize], corners[next(c) as usize]);
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

#[cfg(test)]
mod tests;
