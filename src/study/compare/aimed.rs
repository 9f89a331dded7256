//! Rays at what is hard to hit: corners, edges, faces of boxes (along them too) and the thinnest of triangles, from a
//! sphere around the scene, from the camera, and from within.
//!
//! Invariant: the same shapes, count and seed give the same rays. All are finite and have a direction.

use super::arbiter::Shapes;
use super::bounds::place;
use crate::accel::{Geometry, Ray};
use crate::math::DVec3;
use glam::Vec3;

/// SplitMix64 (Steele et al. 2014).
pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub(super) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn below(&mut self, n: usize) -> usize {
        (self.unit() * n as f64) as usize
    }

    /// On the unit sphere.
    fn direction(&mut self) -> DVec3 {
        let z = 2.0 * self.unit() - 1.0;
        let (s, c) = (std::f64::consts::TAU * self.unit()).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        DVec3::new(r * c, r * s, z)
    }
}

/// Of this many triangles the thinnest is a sliver.
const THINNEST_OF: usize = 16;

/// Primitives of one geometry in one place.
struct Span {
    instance: Option<usize>,
    geometry: usize,
    /// Primitives in all spans up to and with this one.
    end: usize,
}

struct Targets<'a> {
    shapes: &'a Shapes<'a>,
    spans: Vec<Span>,
}

impl<'a> Targets<'a> {
    fn new(shapes: &'a Shapes<'a>) -> Self {
        let mut spans = Vec::new();
        let mut end = 0;
        let mut add = |instance: Option<usize>, list: &[Geometry<'_>]| {
            for (geometry, g) in list.iter().enumerate() {
                end += match g {
                    Geometry::Triangles { indices, .. } => indices.len(),
                    Geometry::Custom { count, .. } => *count as usize,
                    // What is compared stays in memory.
                    Geometry::Pages { .. } => 0,
                };
                spans.push(Span { instance, geometry, end });
            }
        };
        add(None, &shapes.world);
        for (i, instance) in shapes.instances.iter().enumerate() {
            add(Some(i), &shapes.objects[instance.object as usize]);
        }
        Self { shapes, spans }
    }

    /// Corners in the world of a random primitive: three of a triangle, eight of another's box.
    fn corners(&self, random: &mut Random) -> Option<Vec<DVec3>> {
        let at = random.below(self.spans.last()?.end);
        let s = self.spans.partition_point(|span| span.end <= at);
        let span = self.spans.get(s)?;
        let first = if s == 0 { 0 } else { self.spans[s - 1].end };
        let primitive = at - first;
        let list = match span.instance {
            Some(i) => &self.shapes.objects[self.shapes.instances[i].object as usize],
            None => &self.shapes.world,
        };
        let mut corners: Vec<DVec3> = match list[span.geometry] {
            Geometry::Triangles { positions, indices, .. } => {
                indices[primitive].iter().map(|&v| Vec3::from(positions[v as usize]).as_dvec3()).collect()
            }
            Geometry::Custom { user, .. } => {
                let (lo, hi) = self.shapes.custom.bounds(user, primitive as u32);
                let pick = |i: usize, k: usize| f64::from(if i >> k & 1 == 0 { lo[k] } else { hi[k] });
                (0..8).map(|i| DVec3::new(pick(i, 0), pick(i, 1), pick(i, 2))).collect()
            }
            Geometry::Pages { .. } => unreachable!("pages count as nothing to aim at"),
        };
        if let Some(i) = span.instance {
            corners.iter_mut().for_each(|c| *c = place(&self.shapes.instances[i], *c));
        }
        corners.iter().all(|c| c.is_finite()).then_some(corners)
    }

    /// Twice the area over the square of the longest edge; no number for what has none.
    fn thinness(c: &[DVec3]) -> f64 {
        let longest = (0..3).map(|i| (c[(i + 1) % 3] - c[i]).length_squared()).fold(0.0, f64::max);
        (c[1] - c[0]).cross(c[2] - c[0]).length() / longest
    }

    fn sliver(&self, random: &mut Random) -> Option<Vec<DVec3>> {
        let candidates: Vec<Vec<DVec3>> = (0..THINNEST_OF)
            .filter_map(|_| self.corners(random))
            .filter(|c| c.len() == 3 && Self::thinness(c) > 0.0)
            .collect();
        candidates.into_iter().min_by(|a, b| Self::thinness(a).total_cmp(&Self::thinness(b)))
    }
}

/// `count` rays, or fewer where a scene has nothing to aim at. `bounds` are the world's, `eye` is the camera.
pub(super) fn aimed(
    shapes: &Shapes<'_>,
    count: usize,
    seed: u64,
    (lo, hi): (Vec3, Vec3),
    eye: Vec3,
) -> Vec<Ray> {
    let targets = Targets::new(shapes);
    let mut random = Random(seed);
    let (lo, hi) = (lo.as_dvec3(), hi.as_dvec3());
    let (centre, radius) = ((lo + hi) * 0.5, (hi - lo).length());
    let mut rays = Vec::with_capacity(count);
    // A primitive that is not finite gives no ray.
    for turn in 0..4 * count {
        if rays.len() == count {
            break;
        }
        let origin = match turn / 4 % 3 {
            0 => centre + random.direction() * radius,
            1 => eye.as_dvec3(),
            _ => lo + (hi - lo) * DVec3::new(random.unit(), random.unit(), random.unit()),
        };
        let Some((origin, target)) = target(&targets, turn % 4, origin, &mut random) else { continue };
        let origin = origin.as_vec3();
        let direction = target.as_vec3() - origin;
        // One in eight ends at what it is aimed at; one in four more has a direction of any length.
        let (direction, t_max) = match random.next() % 8 {
            0 => (direction, 1.0),
            1 | 2 => (direction, f32::INFINITY),
            _ => (direction.normalize_or_zero(), f32::INFINITY),
        };
        if origin.is_finite() && direction.is_finite() && direction != Vec3::ZERO {
            rays.push(Ray { origin, direction, t_min: 0.0, t_max });
        }
    }
    rays
}

/// A point to aim at, and where from.
fn target(targets: &Targets<'_>, what: usize, origin: DVec3, random: &mut Random) -> Option<(DVec3, DVec3)> {
    let between = |a: DVec3, b: DVec3, s: f64| a + (b - a) * s;
    let corners = if what == 3 { targets.sliver(random)? } else { targets.corners(random)? };
    let n = corners.len();
    let a = random.below(n);
    match what {
        0 => Some((origin, corners[a])),
        1 => Some((origin, between(corners[a], corners[(a + 1) % n], random.unit()))),
        2 => {
            let lo = corners.iter().copied().fold(DVec3::INFINITY, DVec3::min);
            let hi = corners.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
            let k = random.below(3);
            let mut point = lo + (hi - lo) * DVec3::new(random.unit(), random.unit(), random.unit());
            point[k] = if random.next() & 1 == 0 { lo[k] } else { hi[k] };
            if random.next() & 1 == 0 {
                return Some((origin, point));
            }
            // Within the face, along an axis.
            let mut start = point;
            start[(k + 1) % 3] = origin[(k + 1) % 3];
            Some((start, point))
        }
        _ => {
            let s = random.unit();
            let t = random.unit().sqrt();
            Some((origin, between(corners[0], between(corners[1], corners[2], s), t)))
        }
    }
}
