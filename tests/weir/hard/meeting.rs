//! Triangles that are hard to meet and rays that are hard to answer, each answer judged in f64 by brute force
//! (`weir::study::compare::hold`: exact meetings, and the bounds of each backend's own arithmetic).
//!
//! Invariant: triangles are as rounded to f32; rays are finite and have a direction.

use super::leaving::direction;
use super::{Effort, Row, Table, Tracer};
use crate::closed::{Nothing, Random, point_of};
use glam::{DVec3, Vec3};
use weir::accel::{Accel, Geometry, Ray};
use weir::study::compare::{Held, Shapes, hold};

/// Triangles as backends get them.
#[derive(Clone)]
pub(super) struct Soup {
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) indices: Vec<[u32; 3]>,
}

impl Soup {
    pub(super) fn new(triangles: &[[DVec3; 3]]) -> Self {
        let mut positions: Vec<[f32; 3]> =
            triangles.iter().flatten().map(|p| p.as_vec3().to_array()).collect();
        // Embree reads 16 bytes at the last.
        positions.reserve(1);
        let indices = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        Self { positions, indices }
    }

    fn corners(&self, i: usize) -> [DVec3; 3] {
        self.indices[i].map(|v| Vec3::from(self.positions[v as usize]).as_dvec3())
    }

    pub(super) fn geometry(&self) -> Geometry<'_> {
        Geometry::Triangles { positions: &self.positions, indices: &self.indices, alpha: None }
    }

    pub(super) fn build(&self, tracer: Tracer) -> Box<dyn Accel + '_> {
        tracer.builder().build(&[self.geometry()], &[], &[], &Nothing, None).expect("few triangles")
    }
}

/// What kinds of triangles there are.
const SOUPS: [&str; 6] =
    ["any triangles", "slivers", "no area", "duplicates", "along axes", "a fan around a corner"];

/// `count` triangles of a kind within about one unit, scaled and moved, before rounding.
pub(super) fn soup(kind: usize, count: usize, scale: f64, offset: DVec3, random: &mut Random) -> Soup {
    let mut triangles: Vec<[DVec3; 3]> = Vec::with_capacity(count);
    for i in 0..count {
        let a = random.point();
        let (e, f) = (random.point() * 0.5, random.point() * 0.5);
        triangles.push(match kind {
            // From a thousandth to a hundred-millionth as high as long.
            1 => [a, a + e, a + e * random.unit() + f * 10f64.powf(-3.0 - 5.0 * random.unit())],
            2 => match i % 4 {
                // On a line, in multiples of 1/64, so that rounding keeps them there.
                0 => {
                    let [a, e] = [a, e].map(|v| (v * 64.0).round() / 64.0);
                    [a, a + e, a + e * 2.0]
                }
                1 => [a, a, a + e],
                2 => [a, a, a],
                _ => [a, a + e, a + f],
            },
            3 if i % 8 != 0 => triangles[i - 1],
            // With shared planes and edges: corners of a grid.
            4 => {
                let at = (a * 4.0).round() / 4.0;
                let (axis, step) = (i % 3, 0.25);
                let [mut u, mut v] = [DVec3::ZERO; 2];
                u[(axis + 1) % 3] = step;
                v[(axis + 2) % 3] = step;
                if i % 2 == 0 { [at, at + u, at + u + v] } else { [at, at + u + v, at + v] }
            }
            5 => {
                let spoke = |i: usize| {
                    let (s, c) = (std::f64::consts::TAU * i as f64 / count as f64).sin_cos();
                    DVec3::new(c, s, 0.3 * (3.0 * s).sin())
                };
                [DVec3::new(0.1, 0.2, 0.4), spoke(i), spoke(i + 1)]
            }
            _ => [a, a + e, a + f],
        });
    }
    let placed: Vec<[DVec3; 3]> = triangles.iter().map(|t| t.map(|p| p * scale + offset)).collect();
    Soup::new(&placed)
}

/// What rays are aimed at, and how.
const RAYS: [&str; 7] = [
    "at corners",
    "at edges",
    "at faces",
    "grazing under 0.6°",
    "with zeros of both signs",
    "from on faces",
    "of any length, ended at a corner",
];

fn ray(kind: usize, soup: &Soup, scale: f64, random: &mut Random) -> Ray {
    let corners = soup.corners(random.below(soup.indices.len()));
    let aim = if kind < 3 { kind } else { random.below(3) };
    let to = point_of(corners, random, aim);
    let away = direction(random) * (0.1 + 5.0 * random.unit()) * scale;
    let mut origin = (to + away).as_vec3();
    let mut d = (to - origin.as_dvec3()).as_vec3();
    let mut t_max = f32::INFINITY;
    match kind {
        3 => {
            let [a, b, c] = corners;
            let n = (b - a).cross(c - a).normalize_or_zero();
            let along = (away - n * n.dot(away)).normalize_or(DVec3::X);
            let sine = 0.01 * random.unit() * random.unit() * random.unit();
            let from = to + (along + n * sine) * away.length();
            origin = from.as_vec3();
            d = (to - origin.as_dvec3()).as_vec3();
        }
        4 => {
            let zero = |random: &mut Random| if random.unit() < 0.5 { 0.0 } else { -0.0 };
            let axis = random.below(3);
            d[axis] = zero(random);
            origin[axis] = to.as_vec3()[axis];
            if random.unit() < 0.5 {
                let axis = (axis + 1) % 3;
                d[axis] = zero(random);
                origin[axis] = to.as_vec3()[axis];
            }
        }
        5 => {
            origin = to.as_vec3();
            d = direction(random).as_vec3();
        }
        6 => {
            d *= 10f32.powf(12.0 * random.unit() as f32 - 6.0);
            let reach = (to - origin.as_dvec3()).length() / d.as_dvec3().length();
            t_max = if random.unit() < 0.5 { reach as f32 } else { (reach * random.unit() * 2.0) as f32 };
        }
        _ => {}
    }
    let d = if kind < 3 && random.unit() < 0.5 { d.normalize_or_zero() } else { d };
    let t_max = if t_max > 0.0 { t_max } else { f32::INFINITY };
    Ray {
        origin,
        direction: if d.length_squared() > 0.0 || d.abs().max_element() > 1e-30 { d } else { Vec3::X },
        t_min: 0.0,
        t_max,
    }
}

/// Where soups stand: scale and offset.
const PLACES: [(f64, f64); 7] =
    [(1.0, 0.0), (1e-8, 0.0), (1e-4, 0.0), (1e8, 0.0), (1.0, 1e3), (1e3, 1e7), (1e8, 1e7)];

/// **What must hold.** Every answer is one that the exact meeting allows: its primitive may be hit, its distance is
/// within the bound, and nothing that must be hit lies wholly before. `occluded` says what `closest` does.
///
/// **Why.** `study/compare/bounds.rs` derives the bounds from each operation of each backend's test, for the ray and the
/// triangle at hand (so that a grazing ray has a wide one, and it is known how wide); the worst distance is shown as
/// a share of its bound, which is 1. What has no area may be hit or not, where the bounds say that rounding gives it some.
///
/// Embree does not promise these bounds: it is counted.
pub(super) fn soups(effort: Effort) -> Table {
    let mut table = Table::default();
    let (rounds, rays) = (effort.of(1, 10), effort.of(40, 600));
    for (kind, name) in SOUPS.iter().enumerate() {
        for (aim, aimed) in RAYS.iter().enumerate() {
            let mut held = [Held::default(), Held::default()];
            for (i, (scale, offset)) in PLACES.iter().enumerate() {
                for round in 0..rounds {
                    let mut random = Random((kind * 1009 + aim * 101 + i * 11 + round * 100_003) as u64);
                    let offset = DVec3::new(0.8, -0.5, 0.33) * *offset;
                    let soup = soup(kind, 24 + 40 * (round % 3), *scale, offset, &mut random);
                    let rays: Vec<Ray> = (0..rays).map(|_| ray(aim, &soup, *scale, &mut random)).collect();
                    let native = soup.build(Tracer::Native);
                    for (robust, held) in held.iter_mut().enumerate() {
                        let other = soup.build([Tracer::Embree, Tracer::Robust][robust]);
                        let ground = Shapes {
                            world: vec![soup.geometry()],
                            objects: Vec::new(),
                            instances: Vec::new(),
                            custom: &Nothing,
                        };
                        held.join(hold(&ground, [&*native, &*other], robust == 1, &rays));
                    }
                }
            }
            let [embree, robust] = held;
            for what in [name.to_string(), format!("rays {aimed}")] {
                table.extend(rows(&what, Tracer::Native, &embree, 0));
                table.extend(rows(&what, Tracer::Embree, &embree, 1));
                table.extend(rows(&what, Tracer::Robust, &robust, 1));
            }
        }
    }
    table
}

/// What `held` says of its voice number `voice`.
pub(super) fn rows(what: &str, tracer: Tracer, held: &Held, voice: usize) -> [Row; 2] {
    let mut wrong = Row::new(format!("wrong answers: {what}"), tracer, 0.0, false);
    wrong.tried = held.rays;
    wrong.counted = true;
    wrong.worst = (held.faults[voice] + held.contradictions[voice]) as f64;
    wrong.example = held.examples[voice].clone().unwrap_or_default();
    let mut share = Row::new(format!("distance's share of its bound: {what}"), tracer, 1.0, false);
    share.tried = held.hits[voice].max(1);
    share.worst = held.worst[voice];
    [wrong, share]
}

#[test]
fn answers_are_those_that_exact_meetings_allow() {
    soups(Effort::Quick).assert_holds();
}

/// The test above must be able to fail: a triangle moved by a ten-thousandth after the tree was built over it.
#[test]
fn a_moved_triangle_is_found() {
    let mut random = Random(5);
    let soup = soup(0, 64, 1.0, DVec3::ZERO, &mut random);
    let rays: Vec<Ray> = (0..500).map(|_| ray(2, &soup, 1.0, &mut random)).collect();
    let mut moved = soup.clone();
    moved.positions.iter_mut().for_each(|p| p[0] += 1e-4);
    let ground = Shapes {
        world: vec![moved.geometry()],
        objects: Vec::new(),
        instances: Vec::new(),
        custom: &Nothing,
    };
    let (native, embree) = (soup.build(Tracer::Native), soup.build(Tracer::Embree));
    let held = hold(&ground, [&*native, &*embree], false, &rays);
    assert!(held.faults[0] > 100 && held.faults[1] > 100, "{held:?}");
}
