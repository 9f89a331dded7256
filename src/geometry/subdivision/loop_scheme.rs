//! Loop's scheme (Loop 1987; limit rules as in pbrt 3rd ed., §3.8): triangles into four. Boundaries follow the cubic
//! B-spline of their own edges.

use super::Scheme;
use super::surface::{NONE, Sided, Sides, Surface};
use crate::error::Result;
use crate::math::Vec3;
use crate::scene::TriangleMesh;
use std::f32::consts::PI;

type Triangles = Sided<3>;

/// Triangles into four.
pub(super) struct Loop;

impl Scheme<3> for Loop {
    fn divided(surface: &Surface<Triangles>) -> Surface<Triangles> {
        let Surface { sides, .. } = surface;
        let (next, previous) = (|c| sides.next(c), |c| sides.previous(c));
        let mut fan = Vec::new();
        let old = surface.positions.len();
        let mut positions = Vec::with_capacity(old + surface.corners.len() / 2 + 1);
        for v in 0..old {
            surface.fan(v, &mut fan);
            positions.push(smoothed(surface, v, &fan, beta, 1.0 / 8.0));
        }
        let middle = surface.on_edges(&mut positions, |ends, faces| {
            let [c, d] = faces.map(|c| surface.at(previous(c)));
            0.375 * ends + 0.125 * (c + d)
        });
        // Triangle t becomes 4t..4t+2, one at each corner with that corner first, and 4t+3 inside,
        // whose edge k faces child k + 1.
        let mut corners = Vec::with_capacity(4 * surface.corners.len());
        let mut twins = Vec::with_capacity(4 * surface.corners.len());
        let corner_child = |c: u32| 3 * (4 * (c / 3) + c % 3);
        for t in 0..surface.corners.len() as u32 / 3 {
            let inside = 3 * (4 * t + 3);
            for k in 0..3 {
                let c = 3 * t + k;
                let before = previous(c);
                corners.extend([surface.corners[c as usize], middle[c as usize], middle[before as usize]]);
                // Half of the edge to the next corner lies against the child at its far end.
                let out = surface.twins[c as usize];
                let back = surface.twins[before as usize];
                twins.push(if out == NONE { NONE } else { corner_child(next(out)) + 2 });
                twins.push(inside + (k + 2) % 3);
                twins.push(if back == NONE { NONE } else { corner_child(back) });
            }
            corners.extend((0..3).map(|k| middle[(3 * t + k) as usize]));
            twins.extend((0..3).map(|k| corner_child(3 * t + (k + 1) % 3) + 1));
        }
        Surface::unwalked(Sided, positions, corners, twins)
    }

    fn limit(surface: &Surface<Triangles>, vertex: usize, fan: &[u32]) -> (Vec3, [Vec3; 2]) {
        let p = smoothed(surface, vertex, fan, |n| 1.0 / (n + 3.0 / (8.0 * beta(n))), 1.0 / 5.0);
        let ring = neighbours(surface, fan);
        if !surface.boundary[vertex] {
            return (p, interior_tangents(ring));
        }
        let last = surface.ends(fan)[1];
        let ring: Vec<Vec3> = ring.chain([last]).collect();
        (p, boundary_tangents(surface.positions[vertex], &ring))
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

/// In the order of a walk; on a boundary all but the last.
fn neighbours<'a>(
    surface: &'a Surface<Triangles>,
    fan: &'a [u32],
) -> impl ExactSizeIterator<Item = Vec3> + use<'a> {
    fan.iter().map(|&c| surface.at(surface.sides.next(c)))
}

/// (1 − n w) p + w Σ ring, over all neighbours or over a boundary's two ends.
fn smoothed(
    surface: &Surface<Triangles>,
    vertex: usize,
    fan: &[u32],
    inner: impl Fn(f32) -> f32,
    edge: f32,
) -> Vec3 {
    let p = surface.positions[vertex];
    if fan.is_empty() {
        return p;
    }
    if surface.boundary[vertex] {
        return surface.on_boundary(vertex, fan, edge);
    }
    let n = fan.len() as f32;
    let w = inner(n);
    (1.0 - n * w) * p + w * neighbours(surface, fan).fold(Vec3::ZERO, |sum, q| sum + q)
}

/// Weight of each neighbour of an interior vertex of valence n (Warren's).
fn beta(n: f32) -> f32 {
    if n == 3.0 { 3.0 / 16.0 } else { 3.0 / (8.0 * n) }
}

/// The eigenvectors of the subdivision matrix: the ring runs counter-clockwise seen from outside, so
/// that first × second points outwards (pbrt walks the other way and its normals point inwards).
fn interior_tangents(ring: impl ExactSizeIterator<Item = Vec3>) -> [Vec3; 2] {
    let mut tangents = [Vec3::ZERO; 2];
    let n = ring.len();
    // Two neighbours are on one line with the vertex: there is no second tangent.
    if n < 3 {
        return tangents;
    }
    for (i, p) in ring.enumerate() {
        let (sin, cos) = (2.0 * PI * i as f32 / n as f32).sin_cos();
        tangents[0] += cos * p;
        tangents[1] += sin * p;
    }
    tangents
}

/// Along the boundary and across it (Hoppe et al. 1994; Zorin and Schröder's course, table).
fn boundary_tangents(p: Vec3, ring: &[Vec3]) -> [Vec3; 2] {
    let [first, last] = [ring[0], ring[ring.len() - 1]];
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
    [first - last, across]
}
