//! Loop's scheme (Loop 1987; limit rules as in pbrt 3rd ed., §3.8): triangles into four. Boundaries follow the cubic
//! B-spline of their own edges.

use super::surface::{NONE, Sided, Sides, Surface};
use super::{Scheme, Stop, ask};
use crate::error::Result;
use crate::math::Vec3;
use crate::scene::TriangleMesh;
use std::f32::consts::PI;

type Triangles = Sided<3>;

/// Triangles into four.
pub(super) struct Loop;

impl Scheme<3> for Loop {
    const TRIANGLES: u32 = 1;

    fn divided(surface: &Surface<Triangles>) -> Surface<Triangles> {
        surface.divided()
    }

    fn limit(surface: &Surface<Triangles>, stop: Stop<'_>) -> Result<TriangleMesh> {
        surface.limit(stop)
    }

    fn child(corners: &[Vec3], child: u32) -> Vec<Vec3> {
        let [a, b, c] = [0, 1, 2].map(|k| corners[k]);
        let [ab, bc, ca] = [0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)];
        [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]][child as usize].to_vec()
    }
}

/// The surface of `control`, not yet refined. A triangle that repeats a vertex has no edge ring, and is left out.
///
/// # Errors
/// As [`Surface::new`].
pub(super) fn surface(control: &TriangleMesh) -> Result<Surface<Triangles>> {
    let whole = |t: &&[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
    Surface::new(Sided, &control.positions, control.indices.iter().filter(whole).flatten().copied().collect())
}

impl Surface<Triangles> {
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

    /// Refined, before rings are found.
    fn divided(&self) -> Self {
        let (next, previous) = (|c| self.sides.next(c), |c| self.sides.previous(c));
        let mut ring = Vec::new();
        let old = self.positions.len();
        let mut positions = Vec::with_capacity(old + self.corners.len() / 2 + 1);
        for v in 0..old {
            self.ring(v, &mut ring);
            positions.push(self.smoothed(v, &ring, beta, 1.0 / 8.0));
        }
        // A vertex on each edge, numbered by the first corner that has it.
        let mut middle = vec![NONE; self.corners.len()];
        for c in 0..self.corners.len() as u32 {
            if middle[c as usize] != NONE {
                continue;
            }
            middle[c as usize] = positions.len() as u32;
            let ends = self.at(c) + self.at(next(c));
            positions.push(match self.twins[c as usize] {
                NONE => 0.5 * ends,
                twin => {
                    middle[twin as usize] = positions.len() as u32;
                    0.375 * ends + 0.125 * (self.at(previous(c)) + self.at(previous(twin)))
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
        Self::unwalked(Sided, positions, corners, twins)
    }

    fn limit(&self, stop: Stop<'_>) -> Result<TriangleMesh> {
        let mut mesh = TriangleMesh::default();
        mesh.positions.reserve_exact(self.positions.len() + 1);
        mesh.normals.reserve_exact(self.positions.len());
        let (mut indices, mut ring) = (Vec::new(), Vec::new());
        for v in 0..self.positions.len() {
            ask(stop, v)?;
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
        Ok(mesh)
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
    // Two neighbours are on one line with the vertex: there is no second tangent.
    if ring.len() < 3 {
        return tangents;
    }
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
