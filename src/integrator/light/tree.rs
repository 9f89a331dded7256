//! Chooses among thousands of lights by what they may send to a point: a binary tree over the
//! lights' places, powers and emission cones (Conty Estevez and Kulla 2018; pbrt 4th ed., §12.6.3).
//!
//! Invariants: a light that can send anything to a point has a positive probability there, since
//! each node's sphere and cones contain its lights' after rounding; and `pmf` repeats the very
//! arithmetic of `sample`. Never holds lights at infinity.

use crate::math::safe_sqrt;
use glam::{Vec2, Vec3};

/// What the tree needs to know of a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightBounds {
    /// Least corner of the emitting surface's box.
    pub min: Vec3,
    /// Greatest corner.
    pub max: Vec3,
    /// Unit axis of the cone that holds all normals.
    pub axis: Vec3,
    /// Emitted power, up to a factor common to all lights.
    pub power: f32,
    /// Cosine of that cone's half angle; 1 for a flat light, −1 for all directions.
    pub cos_theta_o: f32,
    /// Cosine of the angle about each normal up to which it emits; 0 for a surface.
    pub cos_theta_e: f32,
    /// Emission also about the opposite normals.
    pub two_sided: bool,
}

impl LightBounds {
    /// A flat light with these corners.
    #[must_use]
    pub fn flat(corners: &[Vec3], n: Vec3, power: f32, two_sided: bool) -> Self {
        let min = corners.iter().fold(Vec3::INFINITY, |m, &c| m.min(c));
        let max = corners.iter().fold(Vec3::NEG_INFINITY, |m, &c| m.max(c));
        Self { min, max, axis: n, power, cos_theta_o: 1.0, cos_theta_e: 0.0, two_sided }
    }

    /// A light within a box whose normals point everywhere: a sphere, or a point (`min` = `max`).
    #[must_use]
    pub fn round(min: Vec3, max: Vec3, power: f32) -> Self {
        Self { min, max, axis: Vec3::Z, power, cos_theta_o: -1.0, cos_theta_e: 0.0, two_sided: false }
    }

    /// A spot light.
    #[must_use]
    pub fn spot(
        position: Vec3,
        axis: Vec3,
        power: f32,
        cos_falloff_start: f32,
        cos_total_width: f32,
    ) -> Self {
        let start = cos_falloff_start.clamp(-1.0, 1.0);
        let cos_theta_e = (cos_total_width.clamp(-1.0, 1.0).acos() - start.acos()).cos();
        Self { min: position, max: position, axis, power, cos_theta_o: start, cos_theta_e, two_sided: false }
    }

    fn usable(&self) -> bool {
        let boxed = self.min.is_finite() && self.max.is_finite();
        boxed && self.power > 0.0 && self.power.is_finite() && (self.axis.length_squared() - 1.0).abs() < 1e-2
    }

    pub(super) fn centroid(&self) -> Vec3 {
        (self.min + self.max) * 0.5
    }

    pub(super) fn union(&self, other: &Self) -> Self {
        // Lights that emit both ways may turn their axis.
        let flip = self.two_sided && other.two_sided && self.axis.dot(other.axis) < 0.0;
        let turned = if flip { -other.axis } else { other.axis };
        let (axis, cos_theta_o) = union_cones(self.axis, self.cos_theta_o, turned, other.cos_theta_o);
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
            axis,
            power: self.power + other.power,
            cos_theta_o,
            cos_theta_e: self.cos_theta_e.min(other.cos_theta_e),
            two_sided: self.two_sided || other.two_sided,
        }
    }
}

/// Angle between unit vectors, precise also when small.
fn angle(a: Vec3, b: Vec3) -> f32 {
    if a.dot(b) < 0.0 {
        std::f32::consts::PI - 2.0 * (0.5 * (a + b).length()).min(1.0).asin()
    } else {
        2.0 * (0.5 * (a - b).length()).min(1.0).asin()
    }
}

/// A cone that holds two cones (axis, cosine of the half angle).
fn union_cones(a: Vec3, cos_a: f32, b: Vec3, cos_b: f32) -> (Vec3, f32) {
    use std::f32::consts::PI;
    if cos_a <= -1.0 {
        return (a, -1.0);
    }
    if cos_b <= -1.0 {
        return (b, -1.0);
    }
    let (theta_a, theta_b, between) = (cos_a.min(1.0).acos(), cos_b.min(1.0).acos(), angle(a, b));
    if between + theta_b <= theta_a {
        return (a, cos_a);
    }
    if between + theta_a <= theta_b {
        return (b, cos_b);
    }
    let theta = 0.5 * (theta_a + between + theta_b);
    let across = a.cross(b);
    let length = across.length();
    if theta >= PI {
        return (a, -1.0);
    }
    if length < 1e-6 {
        // No plane to turn in: the same axis, or its opposite.
        return (a, (between + theta_a.max(theta_b)).min(PI).cos());
    }
    let (sin, cos) = (theta - theta_a).sin_cos();
    let axis = a * cos + (across / length).cross(a) * sin;
    (axis.normalize_or(a), theta.cos())
}

/// A node: half a cache line, its sibling beside it.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
struct Node {
    center: [f32; 3],
    radius: f32,
    power: f32,
    /// Octahedral axis, 16 bits each.
    axis: u32,
    /// sin(θₒ/2) in 16 bits, sin(θₑ/2) in 15, two-sidedness on top; rounded up.
    cones: u32,
    /// A light with the top bit set, or a pair of children.
    child: u32,
}

/// Two siblings.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
struct Pair([Node; 2]);

const _: () = assert!(size_of::<Node>() == 32, "two siblings per cache line");
const _: () = assert!(size_of::<Pair>() == 64, "two siblings per cache line");

const LEAF: u32 = 1 << 31;
const TWO_SIDED: u32 = 1 << 31;
/// Widening of the stored cones [rad]: 16-bit octahedral axes are off by at most 7e-5.
const AXIS_SLACK: f32 = 1e-4;
/// Widening of the emission angle [rad], for the roundings of [`Node::importance`].
const EMISSION_SLACK: f32 = 5e-4;

fn pack_axis(w: Vec3) -> u32 {
    let o = w / (w.x.abs() + w.y.abs() + w.z.abs());
    let mut p = Vec2::new(o.x, o.y);
    if o.z < 0.0 {
        p = Vec2::new((1.0 - o.y.abs()).copysign(o.x), (1.0 - o.x.abs()).copysign(o.y));
    }
    let q = ((p * 0.5 + 0.5) * 65534.0).round();
    q.x as u32 | (q.y as u32) << 16
}

#[inline]
fn unpack_axis(packed: u32) -> Vec3 {
    let x = (packed & 0xffff) as f32 * (2.0 / 65534.0) - 1.0;
    let y = (packed >> 16) as f32 * (2.0 / 65534.0) - 1.0;
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    Vec3::new(x - fold.copysign(x), y - fold.copysign(y), z).normalize()
}

/// sin(θ/2) rounded up to `steps`, θ given by its cosine and widened.
fn pack_angle(cos: f32, slack: f32, steps: f32) -> u32 {
    let theta = (cos.clamp(-1.0, 1.0).acos() + slack).min(std::f32::consts::PI);
    ((0.5 * theta).sin() * steps).ceil().min(steps) as u32
}

/// cos and sin of max(a − b, 0) for angles in [0, π].
#[inline]
fn subtract(sin_a: f32, cos_a: f32, sin_b: f32, cos_b: f32) -> (f32, f32) {
    if cos_a > cos_b { (1.0, 0.0) } else { (cos_a * cos_b + sin_a * sin_b, sin_a * cos_b - cos_a * sin_b) }
}

impl Node {
    fn new(b: &LightBounds, child: u32) -> Self {
        let radius = 0.5 * (b.max - b.min).length();
        let o = pack_angle(b.cos_theta_o, AXIS_SLACK, 65535.0);
        let e = pack_angle(b.cos_theta_e, EMISSION_SLACK, 32767.0);
        Self {
            center: b.centroid().to_array(),
            // Upwards, past the roundings of centre and length.
            radius: radius * (1.0 + 4.0 * f32::EPSILON) + b.centroid().abs().max_element() * f32::EPSILON,
            power: b.power,
            axis: pack_axis(b.axis),
            cones: o | e << 16 | if b.two_sided { TWO_SIDED } else { 0 },
            child,
        }
    }

    /// A bound-like estimate of what the node sends to `p` with normal `n` (zero: no normal): power
    /// over squared distance, times the cosine of the least angle between the emission cone and the
    /// point, times the greatest cosine at the point. Positive wherever a light of it contributes.
    #[inline]
    fn importance(&self, p: Vec3, n: Vec3) -> f32 {
        let to = p - Vec3::from_array(self.center);
        let d2 = to.length_squared();
        let r2 = self.radius * self.radius;
        if d2 == 0.0 && r2 == 0.0 {
            return 0.0;
        }
        let inverse = if d2 > 0.0 { 1.0 / d2.sqrt() } else { 0.0 };
        let w = to * inverse;
        // The cone from the point around the node's sphere.
        let (sin_b, cos_b) = if d2 > r2 {
            let sin = self.radius * inverse;
            (sin, safe_sqrt(1.0 - sin * sin))
        } else {
            (0.0, -1.0)
        };
        let cos_w = unpack_axis(self.axis).dot(w);
        let cos_w = if self.cones & TWO_SIDED != 0 { cos_w.abs() } else { cos_w };
        let sin_w = safe_sqrt(1.0 - cos_w * cos_w);
        let half_o = (self.cones & 0xffff) as f32 * (1.0 / 65535.0);
        let half_e = ((self.cones >> 16) & 0x7fff) as f32 * (1.0 / 32767.0);
        let (cos_o, sin_o) = (1.0 - 2.0 * half_o * half_o, 2.0 * half_o * safe_sqrt(1.0 - half_o * half_o));
        let cos_e = 1.0 - 2.0 * half_e * half_e;
        let (cos_x, sin_x) = subtract(sin_w, cos_w, sin_o, cos_o);
        let (cos_emit, _) = subtract(sin_x, cos_x, sin_b, cos_b);
        if cos_emit <= cos_e {
            return 0.0;
        }
        // Within the slack of a right angle the cosine may be negative: a light seen edge-on.
        let mut importance = self.power * cos_emit.max(1e-4) / d2.max(r2);
        if n != Vec3::ZERO {
            let cos_i = w.dot(n).abs();
            let (cos_i, _) = subtract(safe_sqrt(1.0 - cos_i * cos_i), cos_i, sin_b, cos_b);
            importance *= cos_i.max(1e-6);
        }
        // Two infinities would make no ratio; a NaN becomes the bound too.
        importance.min(1e30)
    }
}

/// A tree over lights.
pub struct LightTree {
    root: Node,
    pairs: Vec<Pair>,
    /// For each light the turns from the root, lowest bit first; `None` for one without power.
    trails: Vec<Option<u64>>,
}

impl LightTree {
    /// Over `lights`; what has no power or no finite place is left out. `None` where nothing is left,
    /// or for 2³¹ lights and more.
    #[must_use]
    pub fn new(lights: &[LightBounds]) -> Option<Self> {
        let mut items: Vec<u32> = Vec::new();
        for (i, light) in lights.iter().enumerate() {
            if light.usable() {
                items.push(u32::try_from(i).ok().filter(|i| i & LEAF == 0)?);
            }
        }
        let bounds = items.iter().map(|&i| lights[i as usize]).reduce(|a, b| a.union(&b))?;
        let mut trails = vec![None; lights.len()];
        let mut pairs = Vec::with_capacity(items.len().saturating_sub(1));
        let mut root = Node::new(&bounds, 0);
        // (range, its bounds, where the node's child link goes, turns so far, depth)
        let mut tasks = vec![(0..items.len(), bounds, None::<(usize, usize)>, 0u64, 0u32)];
        while let Some((range, bounds, place, trail, depth)) = tasks.pop() {
            let link = if range.len() == 1 {
                let light = items[range.start];
                trails[light as usize] = Some(trail);
                LEAF | light
            } else {
                let (middle, low, high) =
                    super::tree_build::split(lights, &mut items[range.clone()], &bounds, depth >= 32);
                let middle = range.start + middle;
                let pair = pairs.len();
                pairs.push(Pair([Node::new(&low, 0), Node::new(&high, 0)]));
                tasks.push((middle..range.end, high, Some((pair, 1)), trail | 1 << depth, depth + 1));
                tasks.push((range.start..middle, low, Some((pair, 0)), trail, depth + 1));
                pair as u32
            };
            match place {
                Some((pair, side)) => pairs[pair].0[side].child = link,
                None => root.child = link,
            }
        }
        Some(Self { root, pairs, trails })
    }

    /// Memory held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.pairs.len() * size_of::<Pair>() + self.trails.len() * size_of::<Option<u64>>()
    }

    /// (light, its probability) by importance at `p` with unit normal `n`, either side of which may
    /// be lit; a zero `n` for a point in a medium. `None` where no light is left that could
    /// contribute: what the probabilities lack to 1.
    #[inline]
    #[must_use]
    pub fn sample(&self, p: Vec3, n: Vec3, mut u: f32) -> Option<(usize, f32)> {
        let (mut child, mut pmf) = (self.root.child, 1.0);
        if child & LEAF != 0 && self.root.importance(p, n) <= 0.0 {
            return None;
        }
        while child & LEAF == 0 {
            let Pair([low, high]) = &self.pairs[child as usize];
            let (a, b) = (low.importance(p, n), high.importance(p, n));
            let sum = a + b;
            if sum <= 0.0 {
                return None;
            }
            let share = a / sum;
            if u < share {
                u /= share;
                pmf *= share;
                child = low.child;
            } else {
                u = (u - share) / (1.0 - share);
                pmf *= b / sum;
                child = high.child;
            }
            u = u.min(1.0 - f32::EPSILON / 2.0);
        }
        Some(((child & !LEAF) as usize, pmf))
    }

    /// The probability with which [`LightTree::sample`] chooses `light`.
    #[inline]
    #[must_use]
    pub fn pmf(&self, p: Vec3, n: Vec3, light: usize) -> f32 {
        let Some(mut trail) = self.trails.get(light).copied().flatten() else { return 0.0 };
        let (mut child, mut pmf) = (self.root.child, 1.0);
        if child & LEAF != 0 {
            return if self.root.importance(p, n) > 0.0 { 1.0 } else { 0.0 };
        }
        while child & LEAF == 0 {
            let Pair(pair) = &self.pairs[child as usize];
            let both = [pair[0].importance(p, n), pair[1].importance(p, n)];
            let side = (trail & 1) as usize;
            // A positive share never meets a zero sum.
            if both[side] <= 0.0 {
                return 0.0;
            }
            pmf *= both[side] / (both[0] + both[1]);
            child = pair[side].child;
            trail >>= 1;
        }
        pmf
    }
}

#[cfg(test)]
#[path = "tree_tests.rs"]
mod tests;
