//! Rays against triangles, watertight: corners are sheared into the ray's frame, the same for every triangle that
//! shares a corner, and the signs of the edge functions there are exact (Woop, Benthin, Wald 2013; here every hit is
//! decided in f64, in which products of f32 are exact, so that no case is left over).
//!
//! Invariant: a ray through a shared edge or corner hits one of the triangles at least.

use super::query::{Met, Query, padding};
use super::tree::{Block, LANES};
use glam::{Vec3A, Vec4};

/// Four triangles in the ray's frame.
struct Sheared {
    /// Edge functions, or zero where those are nearly so. The sign of what is not zero is exact.
    edges: [Vec4; 3],
    /// Corners along the ray, not yet scaled to distances.
    depths: [Vec4; 3],
}

impl Sheared {
    #[inline(always)]
    fn new(query: &Query, block: &Block) -> Self {
        let [ox, oy, oz] = query.origin.map(Vec4::splat);
        let [sx, sy, _] = query.shear.map(Vec4::splat);
        let axes = query.axes();
        let sheared = |corner: usize| {
            let along = |k: usize| Vec4::from_array(block.corners[corner][axes[k]]);
            let (x, y, z) = (along(0) - ox, along(1) - oy, along(2) - oz);
            (x - sx * z, y - sy * z, z)
        };
        let (ax, ay, az) = sheared(0);
        let (bx, by, bz) = sheared(1);
        let (cx, cy, cz) = sheared(2);
        // Multiply, multiply, subtract: rounding is monotone, so the sign is right or zero. Fused it would not be.
        let edges = [cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax];
        Self { edges, depths: [az, bz, cz] }
    }

    /// The least and the largest of the edge functions.
    #[inline(always)]
    fn range(&self) -> (Vec4, Vec4) {
        let [u, v, w] = self.edges;
        (u.min(v).min(w), u.max(v).max(w))
    }
}

/// Lanes of `block` that the ray may hit: all that it does, and now and then one whose edge it misses by less than
/// rounding. No distance is looked at.
#[inline(always)]
pub(super) fn candidates(query: &Query, block: &Block) -> u32 {
    let (least, most) = Sheared::new(query, block).range();
    least.cmpge(Vec4::ZERO).bitmask() | most.cmple(Vec4::ZERO).bitmask()
}

/// Distances are compared with their limits less this share, which covers the rounding of either.
const CLEARLY: f32 = 32.0 * f32::EPSILON;

/// As [`candidates`], and lanes that are hit between the ray's start and `t_max` for certain: the ray passes inside
/// all edges, and all corners lie in between.
#[inline(always)]
pub(super) fn candidates_and_hits(query: &Query, block: &Block, t_max: f32) -> (u32, u32) {
    let sheared = Sheared::new(query, block);
    let (least, most) = sheared.range();
    let zero = Vec4::ZERO;
    let maybe = least.cmpge(zero).bitmask() | most.cmple(zero).bitmask();
    if maybe == 0 {
        return (0, 0);
    }
    let [a, b, c] = sheared.depths.map(|z| z * query.shear[2]);
    let (near, far) = (a.min(b).min(c), a.max(b).max(c));
    let after = near.cmpgt(Vec4::splat(query.t_min.max(query.floor) * (1.0 + CLEARLY)));
    let before = far.cmplt(Vec4::splat(t_max * (1.0 - CLEARLY)));
    let inside = least.cmpgt(zero).bitmask() | most.cmplt(zero).bitmask();
    (maybe, inside & after.bitmask() & before.bitmask())
}

/// The hit on lane `lane` of `block`, if there is one beyond the ray's start.
#[inline(always)]
pub(super) fn intersect(query: &Query, block: &Block, lane: usize) -> Option<Met> {
    debug_assert!(lane < LANES, "lanes are counted by `candidates`");
    let lane = lane % LANES;
    let axes = query.axes();
    let [sx, sy, sz] = query.shear;
    let [a, b, c] = [0, 1, 2].map(|corner| {
        let [x, y, z] = [0, 1, 2].map(|k| block.corners[corner][axes[k]][lane] - query.origin[k]);
        [f64::from(x - sx * z), f64::from(y - sy * z), f64::from(z) * f64::from(sz)]
    });
    let u = c[0] * b[1] - c[1] * b[0];
    let v = a[0] * c[1] - a[1] * c[0];
    let w = b[0] * a[1] - b[1] * a[0];
    if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
        return None;
    }
    let determinant = u + v + w;
    // Edge-on, or not a number.
    if determinant == 0.0 || determinant.is_nan() {
        return None;
    }
    let inverse = 1.0 / determinant;
    let t = ((u * a[2] + v * b[2] + w * c[2]) * inverse) as f32;
    let (lo, hi) = padded_bounds(block.triangle(lane));
    let (near, far) = query.inside(lo, hi, f32::INFINITY);
    let t = (if t < near {
        near
    } else if t > far {
        far
    } else {
        t
    })
    .max(query.floor);
    (t > query.t_min).then_some(Met { t, u: (v * inverse) as f32, v: (w * inverse) as f32 })
}

/// The box that a triangle's leaf is built over.
#[inline(always)]
pub(super) fn padded_bounds(corners: [[f32; 3]; 3]) -> ([f32; 3], [f32; 3]) {
    let [a, b, c] = corners.map(Vec3A::from_array);
    let (lo, hi) = (a.min(b).min(c), a.max(b).max(c));
    let pad = padding((hi - lo).max_element(), lo, hi);
    ((lo - pad).to_array(), (hi + pad).to_array())
}
