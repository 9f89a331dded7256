//! Where a light tree's node is split: Conty Estevez and Kulla's surface area orientation
//! heuristic over 12 buckets a dimension. Never keeps state.

use super::tree::LightBounds;
use crate::math::safe_sqrt;
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

const BUCKETS: usize = 12;
/// Below this many lights the middle of the longest side serves: the heuristic would cost more
/// than the node is worth.
const FEW: usize = 4;
/// Below this many only the widest axis is tried: most nodes are small, and so a third of the time
/// is saved where the choice matters least.
const SOME: usize = 32;

/// Measure of the directions that a cone of normals emits into (Conty Estevez and Kulla 2018,
/// eq. 1).
fn orientation(b: &LightBounds) -> f32 {
    let theta_o = b.cos_theta_o.clamp(-1.0, 1.0).acos();
    let theta_e = b.cos_theta_e.clamp(-1.0, 1.0).acos();
    let theta_w = (theta_o + theta_e).min(PI);
    let sin_o = safe_sqrt(1.0 - b.cos_theta_o * b.cos_theta_o);
    TAU * (1.0 - b.cos_theta_o)
        + FRAC_PI_2
            * (2.0 * theta_w * sin_o - (theta_o - 2.0 * theta_w).cos() - 2.0 * theta_o * sin_o
                + b.cos_theta_o)
}

fn cost(b: &LightBounds, regularity: f32) -> f32 {
    let d = b.max - b.min;
    b.power * orientation(b) * regularity * 2.0 * (d.x * d.y + d.y * d.z + d.z * d.x)
}

fn union(a: Option<LightBounds>, b: &LightBounds) -> Option<LightBounds> {
    Some(a.map_or(*b, |a| a.union(b)))
}

/// Reorders two or more `items` and returns where the second part begins and the bounds of both;
/// `halve` forces equal halves, which bounds the depth.
pub(super) fn split(
    lights: &[LightBounds],
    items: &mut [u32],
    bounds: &LightBounds,
    halve: bool,
) -> (usize, LightBounds, LightBounds) {
    let centroid = |i: u32| lights[i as usize].centroid();
    let low = items.iter().fold(Vec3::INFINITY, |m, &i| m.min(centroid(i)));
    let high = items.iter().fold(Vec3::NEG_INFINITY, |m, &i| m.max(centroid(i)));
    let extent = high - low;
    let bucket = |i: u32, axis: usize| {
        let t = (centroid(i)[axis] - low[axis]) / extent[axis];
        ((t * BUCKETS as f32) as usize).min(BUCKETS - 1)
    };
    let widest = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(0);
    let mut best: Option<(f32, usize, usize, LightBounds, LightBounds)> = None;
    if items.len() > FEW && !halve {
        let diagonal = bounds.max - bounds.min;
        for axis in 0..3 {
            let skip = items.len() < SOME && axis != widest;
            if skip || extent[axis] <= 0.0 || !extent[axis].is_finite() {
                continue;
            }
            let mut bins = [None; BUCKETS];
            for &i in items.iter() {
                let bin = &mut bins[bucket(i, axis)];
                *bin = union(*bin, &lights[i as usize]);
            }
            // Thin slabs cost more along their thin side.
            let regularity = diagonal.max_element() / diagonal[axis].max(f32::MIN_POSITIVE);
            let mut below = [None; BUCKETS];
            let mut sum = None;
            for (b, bin) in below.iter_mut().zip(&bins) {
                *b = sum;
                sum = bin.as_ref().map_or(sum, |bin| union(sum, bin));
            }
            let mut above = None;
            for at in (1..BUCKETS).rev() {
                above = bins[at].as_ref().map_or(above, |bin| union(above, bin));
                if let (Some(a), Some(b)) = (&below[at], &above) {
                    let cost = cost(a, regularity) + cost(b, regularity);
                    if best.is_none_or(|(least, ..)| cost < least) {
                        best = Some((cost, axis, at, *a, *b));
                    }
                }
            }
        }
    }
    if let Some((_, axis, at, low, high)) = best.filter(|b| b.0.is_finite()) {
        // Stable, so that the tree does not depend on how a partition happens to swap.
        items.sort_by_key(|&i| bucket(i, axis) >= at);
        return (items.partition_point(|&i| bucket(i, axis) < at), low, high);
    }
    let half = items.len() / 2;
    items.select_nth_unstable_by(half, |&a, &b| {
        centroid(a)[widest].total_cmp(&centroid(b)[widest]).then(a.cmp(&b))
    });
    let all = |items: &[u32]| {
        let first = lights[items[0] as usize];
        items[1..].iter().fold(first, |b, &i| b.union(&lights[i as usize]))
    };
    (half, all(&items[..half]), all(&items[half..]))
}
