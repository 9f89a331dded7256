//! The third voice: every primitive in f64, by brute force over boxes of 64 triangles and of 64 such boxes.
//!
//! Invariant: what it lists holds every primitive that either voice may say is hit, up to the distance asked for, and
//! whose box the ray comes near, within 64 roundings of its distance. (Where a sliver's edges are uncertain
//! farther out, no hierarchy asks; what is answered there all the same is looked at by name.)
//! Never: uses a hierarchy of either backend, nor f32.

use super::bounds::{LocalRay, Meeting, Placement, Voice};
use super::verdict::{Doubt, Verdict, triangle};
use crate::accel::{Custom, Geometry, Hit, InstanceOf, NONE, Ray};
use crate::math::DVec3;
use glam::Vec3;

const U: f64 = (f32::EPSILON / 2.0) as f64;
/// Triangles a box, and boxes a larger box.
const RUN: usize = 64;
/// How far a box is grown, per distance of its farthest corner.
const MARGIN: f64 = 64.0 * U;

/// Names a primitive; the native rule at one distance is the least of these.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Name {
    /// 0 for the world's own, else the instance and one.
    placed: u32,
    pub(super) geometry: u32,
    pub(super) primitive: u32,
}

impl Name {
    /// What a hit names; `None` for a miss.
    pub(super) fn of(hit: &Hit) -> Option<Self> {
        (hit.geometry != NONE).then_some(Self {
            placed: hit.instance.wrapping_add(1),
            geometry: hit.geometry,
            primitive: hit.primitive,
        })
    }

    pub(super) fn instance(&self) -> u32 {
        self.placed.wrapping_sub(1)
    }
}

/// What there is to hit, as the backends are given it.
pub struct Shapes<'a> {
    /// The world's own geometry.
    pub world: Vec<Geometry<'a>>,
    /// Objects.
    pub objects: Vec<Vec<Geometry<'a>>>,
    /// Instances of them.
    pub instances: Vec<InstanceOf>,
    /// Asked about what are no triangles, and about masks.
    pub custom: &'a dyn Custom,
}

/// A primitive that may be hit.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub(super) name: Name,
    /// Exact distance to a triangle's plane; the shape's own answer for others.
    pub(super) t: f64,
    /// What each voice may say, in the order they are given.
    pub(super) may: [Option<Verdict>; 2],
    /// Corners, and how near the ray passes its edges; `None` for other shapes.
    pub(super) triangle: Option<Seen>,
}

/// A triangle as the ray sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub(super) corners: [[f32; 3]; 3],
    /// Whether the first voice's rounding may carry the ray over the edge opposite each corner.
    pub(super) near_edge: [bool; 3],
    /// Sign of n·d: on which side of its edges the triangle lies.
    pub(super) facing: f64,
}

type Bounds = (Vec3, Vec3);

/// Boxes of one object.
struct Part {
    /// By geometry with triangles: its index, boxes of runs and of runs of runs.
    runs: Vec<(u32, Vec<Bounds>, Vec<Bounds>)>,
    others: Vec<(u32, u32, Bounds)>,
    all: Bounds,
}

/// See above.
pub(super) struct Arbiter<'a> {
    shapes: &'a Shapes<'a>,
    world: Part,
    objects: Vec<Part>,
    placements: Vec<Placement>,
    voices: [Voice; 2],
}

const EMPTY: Bounds = (Vec3::INFINITY, Vec3::NEG_INFINITY);

fn join(a: Bounds, b: Bounds) -> Bounds {
    (a.0.min(b.0), a.1.max(b.1))
}

impl Part {
    fn new(geometry: &[Geometry<'_>], custom: &dyn Custom) -> Self {
        let mut part = Self { runs: Vec::new(), others: Vec::new(), all: EMPTY };
        for (i, g) in geometry.iter().enumerate() {
            let i = i as u32;
            match *g {
                Geometry::Triangles { positions, indices, .. } => {
                    let of = |run: &[[u32; 3]]| {
                        run.iter().flatten().fold(EMPTY, |b, &v| {
                            let p = Vec3::from(positions[v as usize]);
                            (b.0.min(p), b.1.max(p))
                        })
                    };
                    let boxes: Vec<Bounds> = indices.chunks(RUN).map(of).collect();
                    let large: Vec<Bounds> =
                        boxes.chunks(RUN).map(|c| c.iter().copied().fold(EMPTY, join)).collect();
                    part.all = large.iter().copied().fold(part.all, join);
                    part.runs.push((i, boxes, large));
                }
                Geometry::Custom { count, user, .. } => {
                    for p in 0..count {
                        let b = custom.bounds(user, p);
                        part.all = join(part.all, b);
                        part.others.push((i, p, b));
                    }
                }
                // What is compared stays in memory.
                Geometry::Pages { .. } => {}
            }
        }
        part
    }
}

/// Whether the ray, up to `limit`, comes near a box.
fn near(ray: &LocalRay, t_min: f64, limit: f64, (lo, hi): Bounds) -> bool {
    if lo.x > hi.x {
        return false;
    }
    let (lo, hi) = (lo.as_dvec3(), hi.as_dvec3());
    let reach = (lo - ray.o).abs().max((hi - ray.o).abs());
    let along = reach.max_element() / ray.d.abs().max_element();
    // No point of the box is farther than `along`.
    let sideways = MARGIN * reach.max_element() + (ray.o_error + ray.d_error * along).max_element();
    let slack = sideways / ray.d.abs().max_element() + MARGIN * along;
    let (mut first, mut last) = (t_min - slack, limit + slack);
    for k in 0..3 {
        let (a, b) = (lo[k] - sideways - ray.o[k], hi[k] + sideways - ray.o[k]);
        if ray.d[k] == 0.0 {
            if a > 0.0 || b < 0.0 {
                return false;
            }
            continue;
        }
        let (a, b) = (a / ray.d[k], b / ray.d[k]);
        first = first.max(a.min(b));
        last = last.min(a.max(b));
    }
    first <= last
}

/// What lies farther away neither voice hits: its products would overflow. Embree's bound is 1.6 times ours.
const FARTHEST: f32 = (1u64 << 60) as f32;

impl<'a> Arbiter<'a> {
    pub(super) fn new(shapes: &'a Shapes<'a>, voices: [Voice; 2]) -> Self {
        let objects = shapes.objects.iter().map(|o| Part::new(o, shapes.custom)).collect();
        let placements = shapes.instances.iter().map(Placement::new).collect();
        Self { shapes, world: Part::new(&shapes.world, shapes.custom), objects, placements, voices }
    }

    /// Every primitive that either voice may say is hit before `limit`.
    pub(super) fn candidates(&self, ray: &Ray, limit: f64) -> Vec<Candidate> {
        let mut found = Vec::new();
        self.search(&self.world, ray, 0, limit, &mut found);
        for (i, instance) in self.shapes.instances.iter().enumerate() {
            let part = &self.objects[instance.object as usize];
            self.search(part, ray, i as u32 + 1, limit, &mut found);
        }
        found.sort_by(|a, b| a.t.total_cmp(&b.t));
        found
    }

    /// Steps that a ray takes at least, about.
    pub(super) fn steps(&self) -> usize {
        let large = |part: &Part| part.runs.iter().map(|r| r.2.len()).sum::<usize>() + part.others.len();
        large(&self.world) + self.placements.len()
    }

    fn placement(&self, placed: u32) -> Option<&Placement> {
        (placed > 0).then(|| &self.placements[placed as usize - 1])
    }

    fn search(&self, part: &Part, ray: &Ray, placed: u32, limit: f64, found: &mut Vec<Candidate>) {
        // Embree's transform errs the most.
        let local = LocalRay::new(Voice::Embree, ray, self.placement(placed));
        let t_min = f64::from(ray.t_min);
        if !near(&local, t_min, limit, part.all) {
            return;
        }
        for (geometry, boxes, large) in &part.runs {
            for (l, _) in large.iter().enumerate().filter(|(_, b)| near(&local, t_min, limit, **b)) {
                let runs = &boxes[l * RUN..boxes.len().min((l + 1) * RUN)];
                for (r, _) in runs.iter().enumerate().filter(|(_, b)| near(&local, t_min, limit, **b)) {
                    let first = (l * RUN + r) * RUN;
                    let count = self.count(placed, *geometry);
                    for p in first..count.min(first + RUN) {
                        let name = Name { placed, geometry: *geometry, primitive: p as u32 };
                        found.extend(self.look(name, ray));
                    }
                }
            }
        }
        for &(geometry, primitive, b) in &part.others {
            if near(&local, t_min, limit, b) {
                found.extend(self.look(Name { placed, geometry, primitive }, ray));
            }
        }
    }

    fn geometry(&self, placed: u32, geometry: u32) -> &Geometry<'a> {
        if placed == 0 {
            return &self.shapes.world[geometry as usize];
        }
        let object = self.shapes.instances[placed as usize - 1].object;
        &self.shapes.objects[object as usize][geometry as usize]
    }

    fn count(&self, placed: u32, geometry: u32) -> usize {
        match self.geometry(placed, geometry) {
            Geometry::Triangles { indices, .. } => indices.len(),
            Geometry::Custom { count, .. } => *count as usize,
            Geometry::Pages { .. } => 0,
        }
    }

    /// One primitive; `None` where neither voice may say that it is hit.
    pub(super) fn look(&self, name: Name, ray: &Ray) -> Option<Candidate> {
        let locals = self.voices.map(|v| LocalRay::new(v, ray, self.placement(name.placed)));
        match *self.geometry(name.placed, name.geometry) {
            Geometry::Triangles { positions, indices, alpha } => {
                // A voice may name what is not there.
                let corners = indices.get(name.primitive as usize)?.map(|i| positions[i as usize]);
                if corners.iter().flatten().any(|c| c.is_nan() || c.abs() > FARTHEST) {
                    return None;
                }
                let p = corners.map(|c| Vec3::from(c).as_dvec3());
                let meeting = Meeting::new(&locals[0], p);
                let mut may = [0, 1].map(|v: usize| triangle(self.voices[v], ray, &locals[v], &meeting, p));
                if may.iter().all(Option::is_none) {
                    return None;
                }
                let e = meeting.errors(self.voices[0], &locals[0]);
                if let Some(user) = alpha {
                    for (v, may) in may.iter_mut().enumerate() {
                        let e = meeting.errors(self.voices[v], &locals[v]);
                        let bary =
                            |i: usize| (meeting.w[i] / meeting.den, (e.w[i] + e.den) / meeting.den.abs());
                        *may =
                            may.and_then(|m| self.masked(m, user, name, ray, &locals[v], [bary(1), bary(2)]));
                    }
                }
                let near_edge = [0, 1, 2].map(|i| meeting.w[i].abs() <= e.w[i]);
                let seen = Seen { corners, near_edge, facing: meeting.den };
                Some(Candidate { name, t: meeting.t, may, triangle: Some(seen) })
            }
            Geometry::Custom { user, alpha, .. } => {
                let verdict = |local: &LocalRay| self.other(user, name, ray, local, alpha);
                let may = [verdict(&locals[0]), verdict(&locals[1])];
                let t = may.iter().flatten().map(|m| 0.5 * (m.lo + m.hi)).next()?;
                Some(Candidate { name, t, may, triangle: None })
            }
            Geometry::Pages { .. } => None,
        }
    }

    /// Rays that a voice may make of `local`: itself where it is exact, else at the corners of its error too.
    fn variants(ray: &Ray, local: &LocalRay) -> Vec<Ray> {
        if local.o_error == DVec3::ZERO && local.d_error == DVec3::ZERO {
            return vec![*ray];
        }
        let make = |s: DVec3| Ray {
            origin: (local.o + s * local.o_error).as_vec3(),
            direction: (local.d + s * local.d_error).as_vec3(),
            ..*ray
        };
        let corner = |i: i32| DVec3::new(sign(i & 1), sign(i >> 1 & 1), sign(i >> 2 & 1));
        std::iter::once(make(DVec3::ZERO)).chain((0..8).map(|i| make(corner(i)))).collect()
    }

    /// A triangle with a mask: looked at where the hit may be, by all rays that a voice may ask with.
    fn masked(
        &self,
        verdict: Verdict,
        user: u32,
        name: Name,
        ray: &Ray,
        local: &LocalRay,
        bary: [(f64, f64); 2],
    ) -> Option<Verdict> {
        let (mut opaque, mut clear) = (false, false);
        for ray in Self::variants(ray, local) {
            for i in 0..5 {
                let shift = |k: usize, s: f64| (bary[k].0 + s * bary[k].1).clamp(0.0, 1.0) as f32;
                let (a, b) = [(0.0, 0.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)][i];
                let hit = (verdict.lo as f32, shift(0, a), shift(1, b));
                let is = self.shapes.custom.is_opaque(user, name.primitive, hit, &ray);
                opaque |= is;
                clear |= !is;
            }
        }
        let doubt = if clear { Some(Doubt::Alpha) } else { verdict.doubt };
        opaque.then_some(Verdict { doubt, ..verdict })
    }

    /// A shape that intersects itself, in f64; the result is rounded once, and a native query may push it to its box.
    fn other(&self, user: u32, name: Name, ray: &Ray, local: &LocalRay, alpha: bool) -> Option<Verdict> {
        let custom = self.shapes.custom;
        let (mut lo, mut hi) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut missed, mut clear) = (false, false);
        // A hit just beyond the range may be rounded into it.
        let range = Ray { t_min: ray.t_min.next_down(), t_max: ray.t_max.next_up(), ..*ray };
        let variants = Self::variants(&range, local);
        for r in &variants {
            let Some((t, u, v)) = custom.intersect(user, name.primitive, r) else {
                missed = true;
                continue;
            };
            if alpha && !custom.is_opaque(user, name.primitive, (t, u, v), r) {
                clear = true;
                continue;
            }
            lo = lo.min(f64::from(t));
            hi = hi.max(f64::from(t));
        }
        if lo > hi {
            return None;
        }
        // Corners of the error give the range to first order; twice it covers the curvature of a shape.
        let room = (hi - lo) + 4.0 * U * hi.abs().max(lo.abs());
        let (lo, hi) = (lo - room, hi + room);
        let (t_min, t_max) = (f64::from(ray.t_min), f64::from(ray.t_max));
        if hi <= t_min || lo > t_max {
            return None;
        }
        let doubt = if clear {
            Some(Doubt::Alpha)
        } else if lo <= t_min || hi >= t_max {
            Some(Doubt::Range)
        } else if missed {
            Some(Doubt::Silhouette)
        } else {
            None
        };
        Some(Verdict { lo: lo.max(t_min), hi: hi.min(t_max), doubt })
    }
}

fn sign(bit: i32) -> f64 {
    if bit == 0 { -1.0 } else { 1.0 }
}

#[cfg(test)]
#[path = "arbiter_tests.rs"]
mod tests;
