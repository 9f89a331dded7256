//! Chooses among thousands of lights by what they may send to a point: a binary tree over the
//! lights' places, powers and emission cones (Conty Estevez and Kulla 2018; pbrt 4th ed., §12.6.3),
//! two levels of which are stored as one node of four children.
//!
//! Invariants: a light that can send anything to a point has a positive probability there, since
//! each node's sphere and cones contain its lights' after rounding; and `pmf` repeats the very
//! arithmetic of `sample`. Never holds lights at infinity.

use super::tree_build::split;
use glam::{Vec3, Vec4};

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

/// Four siblings, by columns: one pass of 4-wide arithmetic weighs them all. An absent one has no
/// power.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Quad {
    x: Vec4,
    y: Vec4,
    z: Vec4,
    /// Of the sphere around the node's box.
    radius: Vec4,
    /// Negative where emission is two-sided.
    power: Vec4,
    axis_x: Vec4,
    axis_y: Vec4,
    axis_z: Vec4,
    cos_o: Vec4,
    sin_o: Vec4,
    cos_e: Vec4,
    /// A light with the top bit set, or four children.
    child: [u32; 4],
}

const _: () = assert!(size_of::<Quad>() == 192, "three cache lines for four children");

const LEAF: u32 = 1 << 31;
/// Widening of the normals' cones [rad]: a cosine near 1 knows its angle to 3.5e-4.
const CONE_SLACK: f32 = 4e-4;
/// Widening of the emission angle [rad], for the roundings of [`Quad::importance`].
const EMISSION_SLACK: f32 = 5e-4;
/// Splits of the binary tree after which halves are forced; 64 bits of turns then serve 2³¹ lights.
const FREE_DEPTH: u32 = 32;

/// cos and sin of max(a − b, 0) for angles in [0, π].
#[inline(always)]
fn subtract(sin_a: Vec4, cos_a: Vec4, sin_b: Vec4, cos_b: Vec4) -> (Vec4, Vec4) {
    let inside = cos_a.cmpgt(cos_b);
    (
        Vec4::select(inside, Vec4::ONE, cos_a * cos_b + sin_a * sin_b),
        Vec4::select(inside, Vec4::ZERO, sin_a * cos_b - cos_a * sin_b),
    )
}

/// The sine of an angle in [0, π] from its cosine.
#[inline(always)]
fn sine(cos: Vec4) -> Vec4 {
    (Vec4::ONE - cos * cos).max(Vec4::ZERO).sqrt()
}

impl Quad {
    fn new(nodes: &[LightBounds]) -> Self {
        let column = |f: &dyn Fn(&LightBounds) -> f32, absent: f32| {
            Vec4::from_array(std::array::from_fn(|i| nodes.get(i).map_or(absent, f)))
        };
        let widened = |cos: f32, slack: f32| (cos.clamp(-1.0, 1.0).acos() + slack).min(std::f32::consts::PI);
        let theta_o = |b: &LightBounds| widened(b.cos_theta_o, CONE_SLACK);
        // Upwards, past the roundings of centre and length.
        let radius = |b: &LightBounds| {
            let off = b.centroid().abs().max_element() * f32::EPSILON;
            0.5 * (b.max - b.min).length() * (1.0 + 4.0 * f32::EPSILON) + off
        };
        Self {
            x: column(&|b| b.centroid().x, 0.0),
            y: column(&|b| b.centroid().y, 0.0),
            z: column(&|b| b.centroid().z, 0.0),
            radius: column(&radius, 1.0),
            power: column(&|b| if b.two_sided { -b.power } else { b.power }, 0.0),
            axis_x: column(&|b| b.axis.x, 0.0),
            axis_y: column(&|b| b.axis.y, 0.0),
            axis_z: column(&|b| b.axis.z, 0.0),
            cos_o: column(&|b| theta_o(b).cos(), 1.0),
            sin_o: column(&|b| theta_o(b).sin().max(0.0), 0.0),
            cos_e: column(&|b| widened(b.cos_theta_e, EMISSION_SLACK).cos(), 1.0),
            child: [LEAF; 4],
        }
    }

    /// An estimate, for each node, of what it sends to `p` with normal `n` (zero: no normal): power
    /// over squared distance, times the cosine of the least angle between the emission cone and the
    /// point, times the greatest cosine at the point. Positive wherever a light of it contributes.
    #[inline]
    fn importance(&self, p: Vec3, n: Vec3) -> Vec4 {
        let (x, y, z) = (Vec4::splat(p.x) - self.x, Vec4::splat(p.y) - self.y, Vec4::splat(p.z) - self.z);
        let d2 = x * x + y * y + z * z;
        let r2 = self.radius * self.radius;
        let inverse = d2.max(Vec4::splat(f32::MIN_POSITIVE)).sqrt().recip();
        // The cone from the point around the node's sphere; everything, from within it.
        let outside = d2.cmpgt(r2);
        let sin_b = self.radius * inverse;
        let cos_b = Vec4::select(outside, sine(sin_b), Vec4::NEG_ONE);
        let sin_b = Vec4::select(outside, sin_b, Vec4::ZERO);
        let cos_w = (self.axis_x * x + self.axis_y * y + self.axis_z * z) * inverse;
        let cos_w = Vec4::select(self.power.cmplt(Vec4::ZERO), cos_w.abs(), cos_w);
        let (cos_x, sin_x) = subtract(sine(cos_w), cos_w, self.sin_o, self.cos_o);
        let (cos_emit, _) = subtract(sin_x, cos_x, sin_b, cos_b);
        // Within the slack of a right angle the cosine may be negative: a light seen edge-on.
        let near = d2.max(r2).max(Vec4::splat(f32::MIN_POSITIVE));
        let mut importance = self.power.abs() * cos_emit.max(Vec4::splat(1e-4)) / near;
        if n != Vec3::ZERO {
            let cos_i = ((x * n.x + y * n.y + z * n.z) * inverse).abs();
            let (cos_i, _) = subtract(sine(cos_i), cos_i, sin_b, cos_b);
            importance *= cos_i.max(Vec4::splat(1e-6));
        }
        // Two infinities would make no ratio.
        let bounded = importance.min(Vec4::splat(1e30));
        Vec4::select(cos_emit.cmpgt(self.cos_e), bounded, Vec4::ZERO)
    }
}

/// `lights` with powers that are times one power of two what they were, the largest between 1 and 2: only their ratios count,
/// and those of powers of 1e30 would be lost at the bounds of what is made of them. Ratios keep every bit.
fn comparable(lights: &[LightBounds]) -> Vec<LightBounds> {
    let usable = lights.iter().filter(|l| l.usable());
    let largest = usable.map(|l| l.power).fold(f32::MIN_POSITIVE, f32::max);
    let exponent = (largest.to_bits() >> 23) as i32 - 127;
    // What is left out stays without power, and all else keeps some.
    let power = |l: &LightBounds| {
        if l.usable() { (l.power * 2f32.powi(-exponent)).max(f32::MIN_POSITIVE) } else { 0.0 }
    };
    lights.iter().map(|l| LightBounds { power: power(l), ..*l }).collect()
}

/// A tree over lights.
pub struct LightTree {
    quads: Vec<Quad>,
    /// For each light the turns from the root, two bits each, lowest first; `None` for one without
    /// power.
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
        let lights = &comparable(lights)[..];
        let bounds = items.iter().map(|&i| lights[i as usize]).reduce(|a, b| a.union(&b))?;
        let mut trails = vec![None; lights.len()];
        let mut quads: Vec<Quad> = Vec::with_capacity(items.len() / 2 + 1);
        // (range, its bounds, whose child it is, turns so far, depth in quads)
        let mut tasks = vec![(0..items.len(), bounds, None::<(usize, usize)>, 0u64, 0u32)];
        while let Some((range, bounds, parent, trail, depth)) = tasks.pop() {
            let halve = 2 * depth >= FREE_DEPTH;
            // Two levels of binary splits make four children.
            let mut parts = vec![(range, bounds)];
            for _ in 0..2 {
                parts = parts
                    .into_iter()
                    .flat_map(|(range, bounds)| {
                        if range.len() == 1 {
                            return vec![(range, bounds)];
                        }
                        let (at, low, high) = split(lights, &mut items[range.clone()], &bounds, halve);
                        let at = range.start + at;
                        vec![(range.start..at, low), (at..range.end, high)]
                    })
                    .collect();
            }
            let quad = quads.len();
            if let Some((above, lane)) = parent {
                quads[above].child[lane] = quad as u32;
            }
            let nodes: Vec<LightBounds> = parts.iter().map(|part| part.1).collect();
            quads.push(Quad::new(&nodes));
            for (lane, (range, bounds)) in parts.into_iter().enumerate() {
                let trail = trail | (lane as u64) << (2 * depth);
                if range.len() == 1 {
                    let light = items[range.start];
                    trails[light as usize] = Some(trail);
                    quads[quad].child[lane] = LEAF | light;
                } else {
                    tasks.push((range, bounds, Some((quad, lane)), trail, depth + 1));
                }
            }
        }
        Some(Self { quads, trails })
    }

    /// Memory held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.quads.len() * size_of::<Quad>() + self.trails.len() * size_of::<Option<u64>>()
    }

    /// (light, its probability) by importance at `p` with unit normal `n`, either side of which may
    /// be lit; a zero `n` for a point in a medium. `None` where no light is left that could
    /// contribute: what the probabilities lack to 1.
    #[inline]
    #[must_use]
    pub fn sample(&self, p: Vec3, n: Vec3, mut u: f32) -> Option<(usize, f32)> {
        let (mut child, mut pmf) = (0, 1.0);
        while child & LEAF == 0 {
            let quad = &self.quads[child as usize];
            let weights = quad.importance(p, n);
            let sum = weights.element_sum();
            if sum <= 0.0 {
                return None;
            }
            let weights = weights.to_array();
            // The last positive one takes what rounding leaves over.
            let (mut target, mut lane, mut rest) = (u * sum, 0, 0.0);
            for (i, &w) in weights.iter().enumerate() {
                if w > 0.0 {
                    (lane, rest) = (i, target);
                    if target < w {
                        break;
                    }
                    target -= w;
                }
            }
            u = (rest / weights[lane]).clamp(0.0, 1.0 - f32::EPSILON / 2.0);
            pmf *= weights[lane] / sum;
            child = quad.child[lane];
        }
        Some(((child & !LEAF) as usize, pmf))
    }

    /// The probability with which [`LightTree::sample`] chooses `light`.
    #[inline]
    #[must_use]
    pub fn pmf(&self, p: Vec3, n: Vec3, light: usize) -> f32 {
        let Some(mut trail) = self.trails.get(light).copied().flatten() else { return 0.0 };
        let (mut child, mut pmf) = (0, 1.0);
        while child & LEAF == 0 {
            let quad = &self.quads[child as usize];
            let weights = quad.importance(p, n);
            let lane = (trail & 3) as usize;
            // A positive weight never meets a zero sum.
            if weights[lane] <= 0.0 {
                return 0.0;
            }
            pmf *= weights[lane] / weights.element_sum();
            child = quad.child[lane];
            trail >>= 2;
        }
        pmf
    }
}

#[cfg(test)]
#[path = "tree_tests.rs"]
mod tests;
