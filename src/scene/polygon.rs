//! Polygons into triangles, for readers. A convex polygon becomes a fan from its first corner
//! (a quad splits as (0,1,2), (0,2,3)); a concave one loses ears. The triangles always cover the
//! corners' count minus two, keep the winding, and never add a vertex. Never judges flatness.

use glam::{DVec2, DVec3};

/// Ear clipping looks at every reflex corner for every ear; above this many corners a fan stands in,
/// so that a hostile file cannot buy quadratic time with linear bytes.
const MAX_CLIPPED_CORNERS: usize = 128;

/// Appends the triangles of a polygon to `out` as positions in the polygon (0 ≤ i < corners.len()).
/// `corners` are the corners' positions in order. Fewer than three corners give nothing.
pub(crate) fn triangulate(corners: &[[f32; 3]], out: &mut Vec<[u32; 3]>) {
    let n = corners.len();
    let fan = |out: &mut Vec<[u32; 3]>| out.extend((2..n as u32).map(|i| [0, i - 1, i]));
    if n <= 3 || n > MAX_CLIPPED_CORNERS {
        return fan(out);
    }
    let Some(flat) = project(corners) else { return fan(out) };
    let turn = |a: usize, b: usize, c: usize| (flat[b] - flat[a]).perp_dot(flat[c] - flat[b]);
    if (0..n).all(|i| turn((i + n - 1) % n, i, (i + 1) % n) >= 0.0) {
        return fan(out);
    }
    clip_ears(&flat, out);
}

/// The polygon in the plane of its Newell normal, counter-clockwise; `None` without area.
fn project(corners: &[[f32; 3]]) -> Option<Vec<DVec2>> {
    let p: Vec<DVec3> = corners.iter().map(|c| glam::Vec3::from(*c).as_dvec3()).collect();
    // Newell's method: the area vector, insensitive to concavity and to slight warping.
    let normal = (0..p.len()).fold(DVec3::ZERO, |n, i| n + (p[i] - p[0]).cross(p[(i + 1) % p.len()] - p[0]));
    let a = normal.abs();
    let sign = |v: f64| if v < 0.0 { -1.0 } else { 1.0 };
    if normal == DVec3::ZERO || !normal.is_finite() {
        return None;
    }
    // Dropping the largest axis keeps the order of corners up to a mirror, which `sign` undoes.
    Some(if a.x >= a.y && a.x >= a.z {
        p.iter().map(|q| DVec2::new(q.y * sign(normal.x), q.z)).collect()
    } else if a.y >= a.z {
        p.iter().map(|q| DVec2::new(q.z * sign(normal.y), q.x)).collect()
    } else {
        p.iter().map(|q| DVec2::new(q.x * sign(normal.z), q.y)).collect()
    })
}

fn clip_ears(p: &[DVec2], out: &mut Vec<[u32; 3]>) {
    let mut left: Vec<usize> = (0..p.len()).collect();
    let turn = |a: usize, b: usize, c: usize| (p[b] - p[a]).perp_dot(p[c] - p[b]);
    while left.len() > 3 {
        let m = left.len();
        let corner = |i: usize| (left[(i + m - 1) % m], left[i], left[(i + 1) % m]);
        let reflex: Vec<usize> = (0..m)
            .filter(|&i| {
                let (a, b, c) = corner(i);
                turn(a, b, c) <= 0.0
            })
            .map(|i| left[i])
            .collect();
        let is_ear = |i: usize| {
            let (a, b, c) = corner(i);
            turn(a, b, c) > 0.0
                && reflex.iter().all(|&r| {
                    // A corner that coincides with the ear's own (a bridge to a hole) is outside.
                    let own = p[r] == p[a] || p[r] == p[b] || p[r] == p[c];
                    own || turn(a, b, r) < 0.0 || turn(b, c, r) < 0.0 || turn(c, a, r) < 0.0
                })
        };
        // A self-crossing polygon may have no ear; then any corner goes, so that the loop ends.
        let ear = (0..m).find(|&i| is_ear(i)).unwrap_or(0);
        let (a, b, c) = corner(ear);
        out.push([a as u32, b as u32, c as u32]);
        left.remove(ear);
    }
    out.push([left[0] as u32, left[1] as u32, left[2] as u32]);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(p: &[[f32; 3]], t: &[[u32; 3]]) -> Vec<f32> {
        let v = |i: u32| glam::Vec3::from(p[i as usize]);
        t.iter().map(|t| 0.5 * (v(t[1]) - v(t[0])).cross(v(t[2]) - v(t[0])).z).collect()
    }

    #[test]
    fn convex_polygons_are_fans() {
        let p = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
        let mut t = Vec::new();
        triangulate(&p, &mut t);
        assert_eq!(t, [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn a_concave_quad_and_a_comb_keep_area_and_winding_in_every_plane() {
        let dart = vec![[0., 0., 0.], [2., -1., 0.], [0.5, 0., 0.], [2., 1., 0.]];
        let mut comb = vec![[0., -1., 0.], [12., -1., 0.]];
        for k in (0..6).rev() {
            let x = 2.0 * k as f32;
            comb.extend([[x + 2., 0., 0.], [x + 1., 5., 0.]]);
        }
        for shape in [dart, comb] {
            for start in 0..shape.len() {
                let mut p = shape.clone();
                p.rotate_left(start);
                let mut t = Vec::new();
                triangulate(&p, &mut t);
                assert_eq!(t.len(), p.len() - 2);
                let whole: f32 = (0..p.len())
                    .map(|i| (p[i], p[(i + 1) % p.len()]))
                    .map(|(a, b)| 0.5 * (a[0] * b[1] - a[1] * b[0]))
                    .sum();
                let parts = area(&p, &t);
                assert!(parts.iter().all(|&a| a > 0.0), "{parts:?}");
                assert!((parts.iter().sum::<f32>() - whole).abs() < 1e-5 * whole);
                // The same shape in another plane and mirrored triangulates with the same count.
                let turned: Vec<[f32; 3]> = p.iter().map(|q| [q[2], -q[0], q[1]]).collect();
                let mut u = Vec::new();
                triangulate(&turned, &mut u);
                let n = |t: &[u32; 3]| {
                    let v = |i: u32| glam::Vec3::from(turned[i as usize]);
                    (v(t[1]) - v(t[0])).cross(v(t[2]) - v(t[0])).x
                };
                assert!(u.iter().all(|t| n(t) < 0.0));
            }
        }
    }

    #[test]
    fn a_self_crossing_or_flat_polygon_ends() {
        for p in [
            vec![[0., 0., 0.], [1., 1., 0.], [1., 0., 0.], [0., 1., 0.], [0.5, 2., 0.]],
            vec![[0., 0., 0.]; 7],
            vec![[f32::MAX, 0., 0.], [0., f32::MAX, 0.], [f32::MAX; 3], [0., 0., f32::MAX]],
        ] {
            let mut t = Vec::new();
            triangulate(&p, &mut t);
            assert_eq!(t.len(), p.len() - 2);
        }
    }
}
