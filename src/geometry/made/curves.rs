//! Curves as triangles, as a whole or part by part: tubes for `flat` and `cylinder`, strips for `ribbon`.
//!
//! A flat curve of pbrt turns to every ray, which no fixed triangle can: a tube has the same outline from everywhere,
//! and is shaded as round. A tube of k sides is as wide as the curve in the mean over all directions.
//!
//! Invariant: centre line and outline are within an eighth of the pixels that an edge may have (a quarter of a pixel, as
//! long as nobody asks for another) of the curve's own, up to 63 sides and 1024 pieces a segment. u runs along each
//! segment, v around or across it, from 0 to 1. Never closes an end, as pbrt does not.

use super::Place;
use super::parts::{InPieces, MOST_NAMES, Part, Parts, Piece};
use super::refine::MAX_TRIANGLES;
use super::view::{Seen, View, stretch};
use crate::error::{Error, Result};
use crate::math::DVec3;
use crate::scene::{CurveKind, Strand, TriangleMesh};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

/// Of an edge's pixels: how far what is drawn may be from the curve.
const OUTLINE: f64 = 1.0 / 8.0;
/// Fewest and most sides of a tube. With an odd number widths differ least between directions.
const SIDES: [f64; 2] = [3.0, 63.0];
/// Most pieces of a segment.
const MOST_PIECES: f64 = 1024.0;
/// Spheres around a segment, to know how near it is.
const SPHERES: u32 = 8;
/// Tubes go on where segments meet within about 5°; else there is a kink, open as in pbrt.
const STRAIGHT_COSINE: f64 = 0.996;

/// How finely a strand is drawn.
struct Rates {
    /// Of its tube; 1 for a ribbon.
    sides: u32,
    /// Pieces of each segment.
    pieces: Vec<u32>,
}

/// All `strands` in one mesh, in their own space.
pub(super) fn draw(strands: &[Strand], place: &Place<'_>, view: &View) -> Result<TriangleMesh> {
    let rates = all_rates(strands, place, view);
    check(&rates, strands, MAX_TRIANGLES as u64)?;
    let drawn: Vec<TriangleMesh> =
        strands.par_iter().zip(&rates).map(|(strand, rates)| draw_one(strand, rates)).collect();
    let mut mesh = TriangleMesh::default();
    for TriangleMesh { positions, normals, uvs, indices, .. } in drawn {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(positions);
        mesh.normals.extend(normals);
        mesh.uvs.extend(uvs);
        mesh.indices.extend(indices.into_iter().map(|t| t.map(|v| v + first)));
    }
    Ok(mesh)
}

/// Refuses more than `most` triangles.
fn check(rates: &[Rates], strands: &[Strand], most: u64) -> Result<()> {
    let triangles: u64 = rates.iter().zip(strands).map(|(rates, strand)| rates.count(strand).1).sum();
    if triangles > most {
        return Err(Error::Resource(format!(
            "{triangles} triangles would be made of its curves, and {most} can be; a larger --tessellation makes fewer"
        )));
    }
    Ok(())
}

/// Vertices and triangles that [`draw`] makes.
pub(super) fn count(strands: &[Strand], place: &Place<'_>, view: &View) -> (u64, u64) {
    let rates = all_rates(strands, place, view);
    let counts = rates.iter().zip(strands).map(|(rates, strand)| rates.count(strand));
    counts.fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
}

fn all_rates(strands: &[Strand], place: &Place<'_>, view: &View) -> Vec<Rates> {
    let points = || strands.iter().flat_map(|s| s.points.iter().flatten());
    let points = points().map(|&p| place.to_world.point_f64(vector(p))).filter(|p| p.is_finite());
    let (low, high) =
        points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), p| (lo.min(p), hi.max(p)));
    let seen = Seen::new(view, place.places, 0.5 * (low + high), 0.5 * (high - low).length());
    strands.par_iter().map(|strand| Rates::new(strand, place, &seen, view.edge_pixels() * OUTLINE)).collect()
}

fn vector(p: [f32; 3]) -> DVec3 {
    glam::Vec3::from(p).as_dvec3()
}

impl Rates {
    /// So that nothing is off by more than `pixels`.
    fn new(strand: &Strand, place: &Place<'_>, seen: &Seen, pixels: f64) -> Self {
        let scale = stretch(&place.to_world.m);
        let radius = 0.5 * f64::from(strand.widths[0].abs().max(strand.widths[1].abs()));
        let of_segment = |points: &[[f32; 3]; 4]| {
            let points = points.map(vector);
            let spheres = (0..SPHERES).map(|i| {
                let part =
                    part(&points, f64::from(i) / f64::from(SPHERES), f64::from(i + 1) / f64::from(SPHERES));
                let centre = 0.5 * (part[0] + part[3]);
                let reach = part.iter().map(|p| p.distance(centre)).fold(0.0, f64::max) + radius;
                seen.pixels_per_unit(place.to_world.point_f64(centre), scale * reach) * scale
            });
            spheres.fold(0.0, f64::max)
        };
        let units: Vec<f64> = strand.points.iter().map(of_segment).collect();
        let most = units.iter().copied().fold(0.0, f64::max);
        // A regular polygon is within r (1 - cos(π / k)) of its circle.
        let half = |radius_pixels: f64| (1.0 - pixels / radius_pixels).max(0.0).acos();
        let sides = if strand.kind == CurveKind::Ribbon {
            1
        } else {
            (PI / half(most * radius)).ceil().clamp(SIDES[0], SIDES[1]) as u32 | 1
        };
        let pieces = strand.points.iter().zip(&units).map(|(points, unit)| {
            let [a, b, c, d] = points.map(vector);
            // A cubic's second derivative is six times its second differences at most, and a chord is off by an eighth
            // of that over the square of their number.
            let bend = (a - 2.0 * b + c).length().max((b - 2.0 * c + d).length());
            let along = (0.75 * bend * unit / pixels).sqrt();
            // The outer side of a bend is as far from its chords as a circle is.
            let angle =
                |p: DVec3, q: DVec3| if p.length() * q.length() > 0.0 { p.angle_between(q) } else { 0.0 };
            let turn = angle(b - a, c - b) + angle(c - b, d - c);
            let around = turn / (2.0 * half(unit * radius)).min(FRAC_PI_2);
            // Where the eye is on the curve, what is straight has no number of its own.
            let wanted = along.max(around);
            if wanted.is_nan() { 1 } else { wanted.ceil().clamp(1.0, MOST_PIECES) as u32 }
        });
        Self { sides, pieces: pieces.collect() }
    }

    /// The segments that have a width anywhere, and their pieces.
    fn drawn(&self, strand: &Strand) -> impl Iterator<Item = (usize, &u32)> {
        let has_width = |&(segment, &pieces): &(usize, &u32)| {
            (0..=pieces).any(|i| width(strand, segment, i, pieces) != 0.0)
        };
        self.pieces.iter().enumerate().filter(has_width)
    }

    /// Vertices and triangles.
    fn count(&self, strand: &Strand) -> (u64, u64) {
        let (mut vertices, mut triangles) = (0, 0);
        for (segment, &pieces) in self.drawn(strand) {
            let empty = (0..=pieces).filter(|&i| width(strand, segment, i, pieces) == 0.0).count() as u64;
            vertices += u64::from(pieces + 1) * u64::from(self.sides + 1);
            // Where the curve has no width, one triangle of each quadrilateral on either side is none.
            let inner = (1..pieces).filter(|&i| width(strand, segment, i, pieces) == 0.0).count() as u64;
            triangles += u64::from(self.sides) * (2 * u64::from(pieces) - empty - inner);
        }
        (vertices, triangles)
    }
}

/// The control points of a part of a cubic.
fn part(p: &[DVec3; 4], from: f64, to: f64) -> [DVec3; 4] {
    let blossom = |s: f64, t: f64, u: f64| {
        let [a, b, c] = [p[0].lerp(p[1], s), p[1].lerp(p[2], s), p[2].lerp(p[3], s)];
        let [a, b] = [a.lerp(b, t), b.lerp(c, t)];
        a.lerp(b, u)
    };
    [blossom(from, from, from), blossom(from, from, to), blossom(from, to, to), blossom(to, to, to)]
}

/// Width of a strand before piece `i` of `pieces` of a segment.
fn width(strand: &Strand, segment: usize, i: u32, pieces: u32) -> f64 {
    let [w0, w1] = strand.widths.map(f64::from);
    let t = (segment as f64 + f64::from(i) / f64::from(pieces)) / strand.points.len() as f64;
    (w0 + (w1 - w0) * t).abs()
}

/// A point of a cubic and the unit direction there; none where all control points are one.
fn at(p: &[DVec3; 4], u: f64) -> (DVec3, Option<DVec3>) {
    // The ends are the control points themselves, so that segments meet.
    let v = 1.0 - u;
    let point = v * v * v * p[0] + 3.0 * v * v * u * p[1] + 3.0 * v * u * u * p[2] + u * u * u * p[3];
    let slope = v * v * (p[1] - p[0]) + 2.0 * v * u * (p[2] - p[1]) + u * u * (p[3] - p[2]);
    // At an end where control points coincide, towards the next that does not.
    let towards = || {
        let (from, others) = if u < 0.5 { (p[0], [p[1], p[2], p[3]]) } else { (p[3], [p[2], p[1], p[0]]) };
        let sign = if u < 0.5 { 1.0 } else { -1.0 };
        others.into_iter().find_map(|other| ((other - from) * sign).try_normalize())
    };
    (point, slope.try_normalize().or_else(towards))
}

fn across(direction: DVec3, before: DVec3) -> DVec3 {
    (before - direction * before.dot(direction))
        .try_normalize()
        .unwrap_or_else(|| direction.any_orthonormal_vector())
}

/// Where a curve was last, along which direction, and what was beside it.
type Frame = (DVec3, DVec3, DVec3);

fn draw_one(strand: &Strand, rates: &Rates) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let mut frame = None;
    for (segment, &pieces) in rates.drawn(strand) {
        let run = Run::whole(segment, pieces, rates.sides);
        run.draw(strand, &mut frame, &mut mesh);
    }
    mesh
}

/// Some of the pieces of a segment.
#[derive(Clone, Copy)]
struct Run {
    segment: u32,
    from: u32,
    to: u32,
    /// Of the whole segment.
    pieces: u32,
    /// Of the tube, and those of them that are drawn: all, where there is more than one piece.
    sides: u32,
    first_side: u32,
    end_side: u32,
}

impl Run {
    /// A segment.
    fn whole(segment: usize, pieces: u32, sides: u32) -> Self {
        Self { segment: segment as u32, from: 0, to: pieces, pieces, sides, first_side: 0, end_side: sides }
    }

    /// The point before piece `i`, and the frame there. `frame` is what was before it, and then that.
    fn step(&self, strand: &Strand, i: u32, frame: &mut Option<Frame>) -> Frame {
        let points = strand.points[self.segment as usize].map(vector);
        let (point, direction) = at(&points, f64::from(i) / f64::from(self.pieces));
        let (mut direction, mut side) = match (direction, *frame) {
            (Some(direction), Some((_, _, side))) => (direction, across(direction, side)),
            (None, Some((_, direction, side))) => (direction, side),
            (direction, None) => {
                let direction = direction.unwrap_or(DVec3::Z);
                (direction, direction.any_orthonormal_vector())
            }
        };
        // The first ring of a segment is the last of the one before.
        if let Some((end, along, last)) = *frame
            && i == 0
            && end == point
            && along.dot(direction) >= STRAIGHT_COSINE
        {
            (direction, side) = (along, last);
        }
        *frame.insert((point, direction, side))
    }

    fn draw(&self, strand: &Strand, frame: &mut Option<Frame>, mesh: &mut TriangleMesh) {
        let segment = self.segment as usize;
        let first = mesh.positions.len() as u32;
        for i in self.from..=self.to {
            let u = f64::from(i) / f64::from(self.pieces);
            let (point, direction, side) = self.step(strand, i, frame);
            let half = 0.5 * width(strand, segment, i, self.pieces);
            if strand.kind == CurveKind::Ribbon {
                ribbon(mesh, point, direction, half, u, normal(strand, segment, u));
            } else {
                ring(mesh, [point, direction, side], half, u, self);
            }
        }
        let row = self.end_side - self.first_side + 1;
        for i in self.from..self.to {
            let [closed, closes] = self.ends(strand, i);
            for j in 0..self.end_side - self.first_side {
                let a = first + (i - self.from) * row + j;
                let (b, c, d) = (a + row, a + 1, a + row + 1);
                if !closes {
                    mesh.indices.push([a, b, d]);
                }
                if !closed {
                    mesh.indices.push([a, d, c]);
                }
            }
        }
    }

    /// Whether piece `i` begins and ends without width.
    fn ends(&self, strand: &Strand, i: u32) -> [bool; 2] {
        [i, i + 1].map(|i| width(strand, self.segment as usize, i, self.pieces) == 0.0)
    }

    fn triangles(&self, strand: &Strand) -> u32 {
        let open = |i| self.ends(strand, i).iter().filter(|&&empty| !empty).count() as u32;
        (self.end_side - self.first_side) * (self.from..self.to).map(open).sum::<u32>()
    }
}

/// Curves in pieces: runs of their segments.
struct Runs {
    strands: Arc<Vec<Strand>>,
    /// Each with its strand, its first triangle's name, and where its frame is.
    runs: Vec<(Run, u32, u32, u32)>,
    /// What was before a run, where something was.
    frames: Vec<Frame>,
}

/// All `strands` in pieces of about `most` triangles.
pub(super) fn divide(
    strands: &Arc<Vec<Strand>>,
    place: &Place<'_>,
    view: &View,
    most: u32,
) -> Result<InPieces> {
    let rates = all_rates(strands, place, view);
    check(&rates, strands, MOST_NAMES)?;
    let of = |(strand, rates): (&Strand, &Rates)| {
        let each = (most / (2 * rates.sides)).max(1);
        let strip = if 2 * rates.sides <= most { rates.sides } else { (most / 2).max(1) };
        let mut frame = None;
        let mut out: Vec<(Run, Option<Frame>)> = Vec::new();
        for (segment, &pieces) in rates.drawn(strand) {
            let whole = Run::whole(segment, pieces, rates.sides);
            for i in 0..=pieces {
                if i.is_multiple_of(each) && i < pieces {
                    let run = Run { from: i, to: (i + each).min(pieces), ..whole };
                    for first_side in (0..rates.sides).step_by(strip as usize) {
                        let end_side = (first_side + strip).min(rates.sides);
                        out.push((Run { first_side, end_side, ..run }, frame));
                    }
                }
                whole.step(strand, i, &mut frame);
            }
        }
        out
    };
    let found: Vec<Vec<(Run, Option<Frame>)>> = strands.par_iter().zip(&rates).map(of).collect();
    let (mut runs, mut frames, mut pieces) = (Vec::new(), Vec::new(), Vec::new());
    let mut first = 0;
    for (i, (found, strand)) in found.into_iter().zip(&**strands).enumerate() {
        for (run, frame) in found {
            let triangles = run.triangles(strand);
            runs.push((run, i as u32, first, frame.map_or(u32::MAX, |_| frames.len() as u32)));
            frames.extend(frame);
            first += triangles;
            let middle = 0.5 * f64::from(run.from + run.to) / f64::from(run.pieces);
            let (centre, _) = at(&strand.points[run.segment as usize].map(vector), middle);
            pieces.push(Piece { triangles, centre: centre.as_vec3().to_array() });
        }
    }
    runs.shrink_to_fit();
    frames.shrink_to_fit();
    Ok((Box::new(Runs { strands: Arc::clone(strands), runs, frames }), pieces))
}

impl Parts for Runs {
    fn make(&self, pieces: &[u32]) -> Part {
        let mut part = Part::default();
        for &piece in pieces {
            let (run, strand, first, frame) = self.runs[piece as usize];
            let mut frame = self.frames.get(frame as usize).copied();
            let before = part.mesh.indices.len();
            run.draw(&self.strands[strand as usize], &mut frame, &mut part.mesh);
            part.names.extend((first..).take(part.mesh.indices.len() - before));
        }
        part
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.runs[..]) + size_of_val(&self.frames[..])
    }
}

fn push(mesh: &mut TriangleMesh, p: DVec3, n: DVec3, uv: [f64; 2]) {
    mesh.positions.push(p.as_vec3().to_array());
    mesh.normals.push(n.as_vec3().to_array());
    mesh.uvs.push(uv.map(|c| c as f32));
}

fn ring(mesh: &mut TriangleMesh, [point, direction, side]: [DVec3; 3], half: f64, u: f64, run: &Run) {
    let other = side.cross(direction);
    // The mean width of a convex outline is its length over π.
    let k = f64::from(run.sides);
    let radius = half * PI / (k * (PI / k).sin());
    for j in run.first_side..=run.end_side {
        // The seam of v is one place to the bit.
        let (sin, cos) = (2.0 * PI * f64::from(j % run.sides) / k).sin_cos();
        let out = side * cos + other * sin;
        push(mesh, point + radius * out, out, [u, f64::from(j) / k]);
    }
}

fn ribbon(mesh: &mut TriangleMesh, point: DVec3, direction: DVec3, half: f64, u: f64, normal: DVec3) {
    let across = normal.cross(direction).normalize_or_zero();
    let n = direction.cross(across);
    push(mesh, point - half * across, n, [u, 0.0]);
    push(mesh, point + half * across, n, [u, 1.0]);
}

/// Between those at the ends of a segment, at constant speed.
fn normal(strand: &Strand, segment: usize, u: f64) -> DVec3 {
    let [a, b] = [0, 1].map(|i| vector(strand.normals[segment + i]).normalize_or_zero());
    let angle = a.angle_between(b);
    if angle.sin() > 0.0 { (a * ((1.0 - u) * angle).sin() + b * (u * angle).sin()) / angle.sin() } else { a }
}
