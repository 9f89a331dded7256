//! A ray made ready for boxes and triangles, and the nearest hit so far.
//!
//! # Why no ray slips through
//!
//! With u = 2⁻²⁴, and for a ray that meets a triangle at distance t: `triangle.rs` decides on corners sheared into
//! the ray's frame, x' = (x − oₓ) − Sₓ·(z − o_z), whose rounding moves a corner sideways by at most 2u·|x − oₓ| +
//! 5u·|Sₓ·(z − o_z)|, which is no more than 7u of the way to the hit, plus 7u of the triangle's extent. The latter
//! is in the boxes ([`padding`]); the former is a relative error of the distance to a box's face, as are the rounding
//! of the reciprocal (u) and of the distance itself (u): 9u at the near and the far face each, which [`SLACK`]
//! covers. What is left is the error of the product of origin and reciprocal, 4u of it, which moves both
//! faces' offsets apart. So a box is entered wherever a triangle in it is hit, as tested (Ize 2013 derives the
//! bound for division in place of multiply-add, and without the error of the triangle's test).
//!
//! # Why order does not matter
//!
//! A hit's distance is held to the interval in which the ray is inside the triangle's own box, computed as for
//! nodes. Boxes of nodes contain it and rounding is monotone, so that no node that holds the nearest
//! hit begins beyond it.

use crate::accel::{Hit, NONE, Ray};
use glam::{Vec3, Vec3A};

/// Half a unit in the last place of one.
const U: f32 = f32::EPSILON / 2.0;

/// How much a far face is pushed away: 18u needed, its own rounding, and what is of second order.
pub(super) const SLACK: f32 = 1.0 + 24.0 * U;

/// Directions count as at least this much of the largest component, so that reciprocals stay finite. The ray moves
/// sideways by 2⁻⁴⁰ of its way, which is nothing beside its rounding; and where it lies within a face, by `beyond`.
const LEAST: f32 = 1.0 / (1u64 << 40) as f32;

/// Directions shorter than this part of what is farthest (or of one) meet nothing: times that, their reciprocals would
/// overflow, and infinity less infinity is inside every box, even of children that are none.
const SHORTEST: f32 = 1.0 / (1u128 << 85) as f32;

/// Coordinates beyond are not hit: their products would overflow.
pub(super) const LIMIT: f32 = (1u64 << 60) as f32;

/// By how much the box from `lo` to `hi` of a triangle whose largest extent is `extent` is grown on each side. The
/// rounding of growing it is in the second part.
#[inline(always)]
pub(super) fn padding(extent: f32, lo: Vec3A, hi: Vec3A) -> Vec3A {
    Vec3A::splat(8.0 * U * extent) + lo.abs().max(hi.abs()) * (2.0 * U)
}

/// A ray, ready.
#[derive(Clone, Copy)]
pub(super) struct Query {
    /// Reciprocal direction.
    pub(super) inverse: [f32; 3],
    /// Added to plane · reciprocal at faces that the ray enters through.
    pub(super) near: [f32; 3],
    /// Added at those that it leaves through.
    pub(super) far: [f32; 3],
    /// By axis: 1 where the ray runs towards smaller coordinates.
    pub(super) negative: [usize; 3],
    pub(super) t_min: f32,
    /// No hit is nearer: where the ray enters the box of the instance it is in.
    pub(super) floor: f32,
    /// Axes of the ray's frame; the last is that along which it runs fastest.
    axes: [usize; 3],
    /// Origin along `axes`.
    pub(super) origin: [f32; 3],
    /// Shear along the first two axes, scale along the third.
    pub(super) shear: [f32; 3],
}

impl Query {
    /// For trees whose coordinates are at most `reach`. `None` for rays that can meet nothing: not finite, beyond
    /// all limits or without direction.
    #[inline(always)]
    pub(super) fn new(ray: &Ray, reach: f32) -> Option<Self> {
        let (o, d) = (Vec3A::from(ray.origin), Vec3A::from(ray.direction));
        let size = d.abs();
        let largest = size.max_element();
        let away = o.abs().max_element();
        let limit = Vec3A::splat(LIMIT);
        let shortest = (away + reach).max(1.0) * SHORTEST;
        // By component, and not `>`, so that what is not a number ends here: it hides from a maximum, and two of three
        // axes that are none hide the third from the boxes.
        if !((size.cmple(limit) & o.abs().cmple(limit)).all() && largest > shortest) {
            return None;
        }
        // Without a branch: directions are random.
        let z = usize::from(size.x < largest) * (1 + usize::from(size.y < largest));
        let least = Vec3A::splat(largest * LEAST);
        let clamped = size.cmplt(least);
        let inverse = Vec3A::select(clamped, least.copysign(d), d).recip();
        let offset = o * inverse;
        let mut error = offset.abs() * (4.0 * U);
        if clamped.any() {
            // Farther than any hit.
            error += Vec3A::select(clamped, Vec3A::splat(2.0 * (away + reach) / largest), Vec3A::ZERO);
        }
        let axes = [[1, 2, 0], [2, 0, 1], [0, 1, 2]][z];
        let (o, d) = (ray.origin.to_array(), ray.direction.to_array());
        let inverse = inverse.to_array();
        let scale = inverse[z];
        Some(Self {
            inverse,
            near: (-offset - error).to_array(),
            far: (error - offset).to_array(),
            negative: inverse.map(|v| (v.to_bits() >> 31) as usize),
            t_min: ray.t_min,
            floor: f32::NEG_INFINITY,
            axes,
            origin: axes.map(|a| o[a]),
            shear: [d[axes[0]] * scale, d[axes[1]] * scale, scale],
        })
    }

    /// The same ray from `t_min` on.
    #[inline(always)]
    pub(super) fn starting(&self, t_min: f32) -> Self {
        Self { t_min, ..*self }
    }

    /// Axes of the ray's frame.
    #[inline(always)]
    pub(super) fn axes(&self) -> [usize; 3] {
        let [x, y, z] = self.axes;
        // SAFETY: `new` is the only maker, and gives each of 0, 1 and 2 once.
        unsafe { std::hint::assert_unchecked(x < 3 && y < 3 && z < 3) };
        self.axes
    }

    /// Where the ray is inside a box; empty when the first exceeds the second.
    #[inline(always)]
    pub(super) fn inside(&self, lo: [f32; 3], hi: [f32; 3], t_max: f32) -> (f32, f32) {
        let faces = [lo, hi];
        let (mut near, mut far) = (self.t_min, f32::INFINITY);
        for axis in 0..3 {
            let enter = faces[self.negative[axis]][axis];
            let leave = faces[1 - self.negative[axis]][axis];
            let a = enter.mul_add(self.inverse[axis], self.near[axis]);
            let b = leave.mul_add(self.inverse[axis], self.far[axis]);
            near = if a > near { a } else { near };
            far = if b < far { b } else { far };
        }
        let far = far * SLACK;
        (near, if far < t_max { far } else { t_max })
    }
}

/// The nearest hit so far.
#[derive(Clone, Copy)]
pub(super) struct Best {
    pub(super) hit: Hit,
    found: bool,
}

impl Best {
    /// None yet, nearer than `t_max`.
    pub(super) fn before(t_max: f32) -> Self {
        Self { hit: Hit { t: t_max, ..Hit::MISS }, found: false }
    }

    /// `hit`, or none yet nearer than `t_max`.
    pub(super) fn after(hit: &Hit, t_max: f32) -> Self {
        if hit.geometry == NONE { Self::before(t_max) } else { Self { hit: *hit, found: true } }
    }

    /// Whether a hit at `t` of the primitive with this name would be nearer.
    #[inline(always)]
    pub(super) fn is_beaten_by(&self, t: f32, instance: u32, geometry: u32, primitive: u32) -> bool {
        // The world's own come before instances.
        let name = |i: u32, g: u32, p: u32| (i.wrapping_add(1), g, p);
        let best = &self.hit;
        t < best.t
            || (t == best.t
                && self.found
                && name(instance, geometry, primitive) < name(best.instance, best.geometry, best.primitive))
    }

    /// Takes a hit that is nearer.
    #[inline(always)]
    pub(super) fn take(&mut self, hit: Hit) {
        self.hit = hit;
        self.found = true;
    }

    /// What was found.
    pub(super) fn into_hit(self) -> Hit {
        if self.found { self.hit } else { Hit::MISS }
    }
}

/// A hit on a primitive, not yet named.
#[derive(Clone, Copy, Debug)]
pub(super) struct Met {
    pub(super) t: f32,
    pub(super) u: f32,
    pub(super) v: f32,
}

/// What a query touched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Nodes whose children's boxes were tested.
    pub nodes: u64,
    /// Leaves.
    pub leaves: u64,
}

/// A ray through an instance: into its object's space.
#[inline(always)]
pub(super) fn into_object(ray: &Ray, inverse: &[f32; 12], t_max: f32) -> Ray {
    let columns: [Vec3; 4] =
        std::array::from_fn(|c| Vec3::new(inverse[3 * c], inverse[3 * c + 1], inverse[3 * c + 2]));
    let turn = |v: Vec3| columns[0] * v.x + columns[1] * v.y + columns[2] * v.z;
    Ray { origin: turn(ray.origin) + columns[3], direction: turn(ray.direction), t_min: ray.t_min, t_max }
}
