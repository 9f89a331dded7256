//! Rays against triangles, watertight: corners are sheared into the ray's frame, the same for every triangle that
//! shares a corner, and the signs of the edge functions there are exact (Woop, Benthin, Wald 2013; here every hit is
//! decided in f64, in which products of f32 are exact, so that no case is left over).
//!
//! Invariant: a ray through a shared edge or corner hits one of the triangles at least.

use super::query::{Met, Query, padding};
use super::tree::{Block, LANES};
use glam::Vec4;

/// Lanes of `block` that the ray may hit: all that it does, and now and then one whose edge it misses by less than
/// rounding. No distance is looked at.
#[inline(always)]
pub(super) fn candidates(query: &Query, block: &Block) -> u32 {
    let [ox, oy, oz] = query.origin.map(Vec4::splat);
    let [sx, sy, _] = query.shear.map(Vec4::splat);
    let sheared = |corner: usize| {
        let along = |k: usize| Vec4::from_array(block.corners[corner][query.axes[k]]);
        let (x, y, z) = (along(0) - ox, along(1) - oy, along(2) - oz);
        (x - sx * z, y - sy * z)
    };
    let (ax, ay) = sheared(0);
    let (bx, by) = sheared(1);
    let (cx, cy) = sheared(2);
    // Multiply, multiply, subtract: rounding is monotone, so the sign is right or zero. Fused it would not be.
    let u = cx * by - cy * bx;
    let v = ax * cy - ay * cx;
    let w = bx * ay - by * ax;
    let least = u.min(v).min(w);
    let most = u.max(v).max(w);
    least.cmpge(Vec4::ZERO).bitmask() | most.cmple(Vec4::ZERO).bitmask()
}

/// The hit on lane `lane` of `block`, if there is one beyond the ray's start.
#[inline(always)]
pub(super) fn intersect(query: &Query, block: &Block, lane: usize) -> Option<Met> {
    debug_assert!(lane < LANES, "lanes are counted by `candidates`");
    let corners = block.triangle(lane);
    let [sx, sy, sz] = query.shear;
    let [a, b, c] = corners.map(|p| {
        let [x, y, z] = [0, 1, 2].map(|k| p[query.axes[k]] - query.origin[k]);
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
    if !(determinant > 0.0 || determinant < 0.0) {
        return None;
    }
    let inverse = 1.0 / determinant;
    let t = ((u * a[2] + v * b[2] + w * c[2]) * inverse) as f32;
    let (lo, hi) = padded_bounds(corners);
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
pub(super) fn padded_bounds([a, b, c]: [[f32; 3]; 3]) -> ([f32; 3], [f32; 3]) {
    let (mut lo, mut hi) = ([0.0; 3], [0.0; 3]);
    let mut extent = 0.0f32;
    for k in 0..3 {
        lo[k] = a[k].min(b[k]).min(c[k]);
        hi[k] = a[k].max(b[k]).max(c[k]);
        extent = extent.max(hi[k] - lo[k]);
    }
    let pad = padding(extent);
    for k in 0..3 {
        // Outwards, also where the padding is less than half a unit in the last place.
        lo[k] = (lo[k] - pad).next_down();
        hi[k] = (hi[k] + pad).next_up();
    }
    (lo, hi)
}
