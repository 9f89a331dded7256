//! Catmull and Clark's scheme (Catmull and Clark 1978): polygons into quadrangles, and these into four. Limit points and
//! normals are those of Halstead et al. (1993); boundaries and their corners follow the cubic B-spline of their own edges.

use super::Scheme;
use super::surface::{NONE, Sided, Sides, Surface};
use crate::error::Result;
use crate::math::Vec3;
use crate::scene::PolygonMesh;
use std::f32::consts::PI;
use std::ops::Range;

type Quads = Sided<4>;

/// Quadrangles into four.
pub(super) struct CatmullClark;

impl Scheme<4> for CatmullClark {
    fn divided(surface: &Surface<Quads>) -> Surface<Quads> {
        divided(surface)
    }

    fn limit(surface: &Surface<Quads>, vertex: usize, fan: &[u32]) -> (Vec3, [Vec3; 2]) {
        let p = surface.positions[vertex];
        if fan.is_empty() {
            return (p, [Vec3::ZERO; 2]);
        }
        if surface.boundary[vertex] {
            let ends @ [first, last] = surface.ends(fan);
            return ((4.0 * p + (first + last)) / 6.0, [first - last, across(p, ends, faces(surface, fan))]);
        }
        interior(p, faces(surface, fan))
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
    let edges = (0u32..).zip(twins).filter(|&(c, &twin)| c < twin).count();
    let vertices = surface.positions.len() + middles.len() + edges;
    let (mut positions, mut fan) = (Vec::with_capacity(vertices), Vec::new());
    for v in 0..surface.positions.len() {
        surface.fan(v, &mut fan);
        positions.push(smoothed(surface, v, &fan, middle));
    }
    let first_face = positions.len() as u32;
    positions.extend_from_slice(&middles);
    let edges = surface.on_edges(&mut positions, |ends, [c, d]| 0.25 * (ends + (middle(c) + middle(d))));
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
fn smoothed<S: Sides>(
    surface: &Surface<S>,
    vertex: usize,
    fan: &[u32],
    middle: impl Fn(u32) -> Vec3,
) -> Vec3 {
    let p = surface.positions[vertex];
    if fan.is_empty() {
        return p;
    }
    if surface.boundary[vertex] {
        return surface.on_boundary(vertex, fan, 1.0 / 8.0);
    }
    let n = fan.len() as f32;
    let around = |sum, &c: &u32| sum + (surface.at(surface.sides.next(c)) + middle(c));
    ((n - 2.0) * p + fan.iter().fold(Vec3::ZERO, around) / n) / n
}

/// Of each face around a vertex the neighbour that its edge leads to, and the vertex opposite.
fn faces<'a>(
    surface: &'a Surface<Quads>,
    fan: &'a [u32],
) -> impl ExactSizeIterator<Item = [Vec3; 2]> + use<'a> {
    let next = |c| surface.sides.next(c);
    fan.iter().map(move |&c| [surface.at(next(c)), surface.at(next(next(c)))])
}

/// Halstead et al. 1993, appendix A: a neighbour's weight on a tangent is A times the cosine (sine) of its angle, an opposite
/// vertex's the sum of those on both sides of it. Of two faces all of these are 0, and λ = 1/4 is that of two others.
fn interior(p: Vec3, ring: impl ExactSizeIterator<Item = [Vec3; 2]>) -> (Vec3, [Vec3; 2]) {
    let count = ring.len();
    let n = count as f32;
    let turn = |i: usize| (2.0 * PI * (i % count) as f32 / n).sin_cos();
    let cosine = turn(1).1;
    let a = 1.0 + cosine + (PI / n).cos() * (2.0 * (9.0 + cosine)).sqrt();
    let (mut sum, mut tangents) = (Vec3::ZERO, [Vec3::ZERO; 2]);
    for (i, [edge, face]) in ring.enumerate() {
        sum += 4.0 * edge + face;
        if count == 2 {
            let sign = 1.0 - 2.0 * i as f32;
            tangents[0] += sign * edge;
            tangents[1] += sign * face;
        } else {
            let ((s, c), (s_next, c_next)) = (turn(i), turn(i + 1));
            tangents[0] += a * c * edge + (c + c_next) * face;
            tangents[1] += a * s * edge + (s + s_next) * face;
        }
    }
    ((n * n * p + sum) / (n * (n + 5.0)), tangents)
}

/// Across a boundary at a vertex at `p` between two others, inwards where the faces fill less than half a turn; with
/// one face the diagonal.
///
/// The left eigenvector of the step that takes a vertex and the faces around it to the next level: with θ = π/faces, the
/// neighbour at angle iθ weighs 16 (λ − 1/4) sin iθ, the opposite vertex between two of them the sum of their sines, and λ =
/// (5 + cos θ + √((9 + cos θ)(1 + cos θ)))/16, as inside, where θ = 2π/faces. The weights of the ends and of the vertex
/// follow from their own columns. (Biermann et al. 2000 list those of other rules, made so that λ is a half.)
fn across(p: Vec3, [first, last]: [Vec3; 2], ring: impl ExactSizeIterator<Item = [Vec3; 2]>) -> Vec3 {
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
    for (i, [edge, face]) in ring.enumerate() {
        let (here, next) = ((i as f32 * theta).sin(), ((i + 1) as f32 * theta).sin());
        // The first neighbour lies on the boundary.
        let edge = if i == 0 { Vec3::ZERO } else { a * here * edge };
        sum += edge + (here + next) * face;
    }
    sum
}
