//! Catmull and Clark's scheme (Catmull and Clark 1978): polygons into quadrangles, and these into four. Limit points and
//! normals are those of Halstead et al. (1993); boundaries and their corners follow the cubic B-spline of their own edges.

use super::surface::{NONE, Sided, Sides, Surface};
use super::{Scheme, Stop, ask};
use crate::error::Result;
use crate::math::Vec3;
use crate::scene::{PolygonMesh, TriangleMesh};
use std::f32::consts::PI;
use std::ops::Range;

type Quads = Sided<4>;

/// Quadrangles into four.
pub(super) struct CatmullClark;

impl Scheme<4> for CatmullClark {
    const TRIANGLES: u32 = 2;

    fn divided(surface: &Surface<Quads>) -> Surface<Quads> {
        divided(surface)
    }

    fn limit(surface: &Surface<Quads>, stop: Stop<'_>) -> Result<TriangleMesh> {
        limit(surface, stop)
    }

    fn child(corners: &[Vec3], child: u32) -> Vec<Vec3> {
        let [here, next, far, before] = [0, 1, 2, 3].map(|k| corners[(child as usize + k) % 4]);
        let middle = 0.25 * ((here + far) + (next + before));
        vec![here, 0.5 * (here + next), middle, 0.5 * (here + before)]
    }
}

/// Faces of any number of corners.
struct Polygons {
    /// Where the corners of each face begin, and those of the last end.
    starts: Vec<u32>,
    /// Of each corner.
    faces: Vec<u32>,
}

impl Sides for Polygons {
    fn next(&self, corner: u32) -> u32 {
        let of = self.corners(self.face(corner));
        if corner + 1 == of.end { of.start } else { corner + 1 }
    }

    fn previous(&self, corner: u32) -> u32 {
        let of = self.corners(self.face(corner));
        if corner == of.start { of.end - 1 } else { corner - 1 }
    }

    fn face(&self, corner: u32) -> u32 {
        self.faces[corner as usize]
    }

    fn corners(&self, face: u32) -> Range<u32> {
        self.starts[face as usize]..self.starts[face as usize + 1]
    }
}

/// The surface of `control`, refined once: a quadrangle at each corner. A face that repeats a vertex has no edge ring, and
/// is left out.
///
/// # Errors
/// As [`Surface::new`].
pub(super) fn surface(control: &PolygonMesh) -> Result<Surface<Quads>> {
    let mut corners = Vec::with_capacity(control.corners.len());
    let mut sides = Polygons { starts: vec![0], faces: Vec::with_capacity(control.corners.len()) };
    let mut sorted = Vec::new();
    for face in control.faces() {
        sorted.clear();
        sorted.extend_from_slice(face);
        sorted.sort_unstable();
        if face.len() >= 3 && sorted.windows(2).all(|pair| pair[0] != pair[1]) {
            corners.extend_from_slice(face);
            sides.faces.resize(corners.len(), sides.starts.len() as u32 - 1);
            sides.starts.push(corners.len() as u32);
        }
    }
    let mut quads = divided(&Surface::new(sides, &control.positions, corners)?);
    quads.find_first();
    Ok(quads)
}

/// The mean of a face's vertices.
fn middle_of<S: Sides>(surface: &Surface<S>, face: u32) -> Vec3 {
    let corners = surface.sides.corners(face);
    let count = corners.len() as f32;
    corners.fold(Vec3::ZERO, |sum, c| sum + surface.at(c)) / count
}

/// Refined, before rings are found: a quadrangle at each corner, called as the corner is and beginning with it.
fn divided<S: Sides>(surface: &Surface<S>) -> Surface<Quads> {
    let Surface { sides, corners, twins, .. } = surface;
    let faces = corners.last().map_or(0, |_| sides.face(corners.len() as u32 - 1) + 1);
    let middles: Vec<Vec3> = (0..faces).map(|face| middle_of(surface, face)).collect();
    let middle = |corner: u32| middles[sides.face(corner) as usize];
    let mut positions: Vec<Vec3> =
        (0..surface.positions.len()).map(|v| smoothed(surface, v, middle)).collect();
    let first_face = positions.len() as u32;
    positions.extend_from_slice(&middles);
    // A vertex on each edge, numbered by the first corner that has it.
    let mut edges = vec![NONE; corners.len()];
    for c in 0..corners.len() as u32 {
        if edges[c as usize] != NONE {
            continue;
        }
        edges[c as usize] = positions.len() as u32;
        let ends = surface.at(c) + surface.at(sides.next(c));
        positions.push(match twins[c as usize] {
            NONE => 0.5 * ends,
            twin => {
                edges[twin as usize] = positions.len() as u32;
                0.25 * (ends + (middle(c) + middle(twin)))
            }
        });
    }
    let mut fine = Vec::with_capacity(4 * corners.len());
    let mut across = Vec::with_capacity(4 * corners.len());
    for c in 0..corners.len() as u32 {
        let before = sides.previous(c);
        let edge = |c: u32| edges[c as usize];
        fine.extend([corners[c as usize], edge(c), first_face + sides.face(c), edge(before)]);
        // Half of the edge to the next corner lies against the child at its far end, which ends with it.
        let out = twins[c as usize];
        let back = twins[before as usize];
        across.extend([
            if out == NONE { NONE } else { 4 * sides.next(out) + 3 },
            4 * sides.next(c) + 2,
            4 * before + 1,
            if back == NONE { NONE } else { 4 * back },
        ]);
    }
    Surface::unwalked(Sided, positions, fine, across)
}

/// Where a vertex goes: ((n − 2) p + Σ (neighbour + middle) / n) / n inside; on a boundary as its spline has it.
fn smoothed<S: Sides>(surface: &Surface<S>, vertex: usize, middle: impl Fn(u32) -> Vec3) -> Vec3 {
    let p = surface.positions[vertex];
    match ends(surface, vertex) {
        Ends::None => p,
        Ends::Boundary(first, last) => 0.75 * p + 0.125 * (first + last),
        Ends::Closed(start) => {
            let (mut sum, mut n) = (Vec3::ZERO, 0.0);
            surface.walk(start, |c| {
                sum += surface.at(surface.sides.next(c)) + middle(c);
                n += 1.0;
            });
            ((n - 2.0) * p + sum / n) / n
        }
    }
}

/// What bounds a vertex.
fn ends<S: Sides>(surface: &Surface<S>, vertex: usize) -> Ends {
    let start = surface.first[vertex];
    if start == NONE {
        return Ends::None;
    }
    if !surface.boundary[vertex] {
        return Ends::Closed(start);
    }
    let mut last = start;
    surface.walk(start, |c| last = c);
    Ends::Boundary(surface.at(surface.sides.next(start)), surface.at(surface.sides.previous(last)))
}

/// What bounds the faces around a vertex.
enum Ends {
    /// No face is there.
    None,
    /// Its neighbours on the boundary, the first and the last of a walk.
    Boundary(Vec3, Vec3),
    /// Nothing: a walk begins at this corner and comes back.
    Closed(u32),
}

fn limit(surface: &Surface<Quads>, stop: Stop<'_>) -> Result<TriangleMesh> {
    let mut mesh = TriangleMesh::default();
    mesh.positions.reserve_exact(surface.positions.len() + 1);
    mesh.normals.reserve_exact(surface.positions.len());
    let mut ring = Vec::new();
    for v in 0..surface.positions.len() {
        ask(stop, v)?;
        let (p, s, t) = limit_of(surface, v, &mut ring);
        mesh.positions.push(p.to_array());
        mesh.normals.push(s.cross(t).normalize_or_zero().to_array());
    }
    let quads = surface.corners.as_chunks::<4>().0.iter();
    mesh.indices = quads.flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    mesh.pad_positions();
    Ok(mesh)
}

/// Of a vertex its place on the limit surface, and two tangents whose product points outwards. `ring` is scratch.
fn limit_of(surface: &Surface<Quads>, vertex: usize, ring: &mut Vec<[Vec3; 2]>) -> (Vec3, Vec3, Vec3) {
    let p = surface.positions[vertex];
    let start = surface.first[vertex];
    if start == NONE {
        return (p, Vec3::ZERO, Vec3::ZERO);
    }
    // Of each face in order the neighbour that its edge leads to, and the vertex opposite.
    ring.clear();
    surface.walk(start, |c| {
        let next = surface.sides.next(c);
        ring.push([surface.at(next), surface.at(surface.sides.next(next))]);
    });
    let n = ring.len() as f32;
    match ends(surface, vertex) {
        Ends::Boundary(first, last) => {
            let across = across(p, first, last, ring);
            ((4.0 * p + (first + last)) / 6.0, first - last, across)
        }
        _ => {
            let sum = ring.iter().fold(Vec3::ZERO, |sum, &[edge, face]| sum + (4.0 * edge + face));
            let (s, t) = interior_tangents(ring);
            ((n * n * p + sum) / (n * (n + 5.0)), s, t)
        }
    }
}

/// Halstead et al. 1993, appendix A: a neighbour's weight is A times the cosine (sine) of its angle, an opposite vertex's
/// the sum of those on both sides of it.
fn interior_tangents(ring: &[[Vec3; 2]]) -> (Vec3, Vec3) {
    // All of the weights are 0 there, and λ = 1/4 is that of two others.
    if let [[e0, f0], [e1, f1]] = *ring {
        return (e0 - e1, f0 - f1);
    }
    let n = ring.len();
    let turn = |i: usize| (2.0 * PI * (i % n) as f32 / n as f32).sin_cos();
    let cosine = turn(1).1;
    let a = 1.0 + cosine + (PI / n as f32).cos() * (2.0 * (9.0 + cosine)).sqrt();
    let mut tangents = (Vec3::ZERO, Vec3::ZERO);
    for (i, &[edge, face]) in ring.iter().enumerate() {
        let ((s, c), (s_next, c_next)) = (turn(i), turn(i + 1));
        tangents.0 += a * c * edge + (c + c_next) * face;
        tangents.1 += a * s * edge + (s + s_next) * face;
    }
    tangents
}

/// Across a boundary at a vertex at `p` between `first` and `last`, inwards where the faces fill less than half a turn; with
/// one face the diagonal.
///
/// The left eigenvector of the step that takes a vertex and the faces around it to the next level: with θ = π/faces, the
/// neighbour at angle iθ weighs 16 (λ − 1/4) sin iθ, the opposite vertex between two of them the sum of their sines, and λ =
/// (5 + cos θ + √((9 + cos θ)(1 + cos θ)))/16, as inside, where θ = 2π/faces. The weights of the ends and of the vertex
/// follow from their own columns. (Biermann et al. 2000 list those of other rules, made so that λ is a half.)
fn across(p: Vec3, first: Vec3, last: Vec3, ring: &[[Vec3; 2]]) -> Vec3 {
    if ring.len() == 1 {
        return first + last - 2.0 * p;
    }
    let theta = PI / ring.len() as f32;
    let (sin, cos) = theta.sin_cos();
    let lambda = (5.0 + cos + ((9.0 + cos) * (1.0 + cos)).sqrt()) / 16.0;
    let a = 16.0 * lambda - 4.0;
    // Σ sin iθ = cot θ/2.
    let all = (1.0 + cos) / sin * (0.375 * a + 0.5);
    let end = (all + 8.0 * (lambda - 0.75) * lambda * sin) / (8.0 * (lambda - 0.75) * (lambda - 0.5) - 1.0);
    let own = 8.0 * ((lambda - 0.5) * end - lambda * sin);
    let mut sum = own * p + end * (first + last);
    for (i, &[edge, face]) in ring.iter().enumerate() {
        let (here, next) = ((i as f32 * theta).sin(), ((i + 1) as f32 * theta).sin());
        // The first neighbour lies on the boundary.
        let edge = if i == 0 { Vec3::ZERO } else { a * here * edge };
        sum += edge + (here + next) * face;
    }
    sum
}
