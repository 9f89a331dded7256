//! Ray against bilinear patch, in f64, in geometric form: the ray and the patch's lines of
//! constant u meet where a scalar triple product vanishes, which is a quadratic in u
//! (Reshetov 2019, "Cool Patches").

use super::Patches;
use glam::{DVec3, Vec2, Vec3};

/// Corners of a patch in f64, p00 p10 p01 p11.
fn corners(patches: &Patches, i: u32) -> [DVec3; 4] {
    patches.indices[i as usize].map(|k| Vec3::from_array(patches.positions[k as usize]).as_dvec3())
}

/// What a patch has at (u, v) of what its corners have, p00 p10 p01 p11.
#[inline]
#[must_use]
pub fn blend_corners([t00, t10, t01, t11]: [Vec2; 4], u: f32, v: f32) -> Vec2 {
    (t00 * (1.0 - u) + t10 * u) * (1.0 - v) + (t01 * (1.0 - u) + t11 * u) * v
}

impl Patches {
    /// Bounds of patch `i`: a bilinear patch lies in the hull of its corners.
    #[must_use]
    pub fn bounds(&self, i: u32) -> (Vec3, Vec3) {
        let c = self.indices[i as usize].map(|k| Vec3::from_array(self.positions[k as usize]));
        (c[0].min(c[1]).min(c[2]).min(c[3]), c[0].max(c[1]).max(c[2]).max(c[3]))
    }

    /// Texture coordinates at (u, v): the mesh's, or (u, v) itself.
    #[must_use]
    pub fn uv(&self, i: u32, u: f32, v: f32) -> Vec2 {
        if self.uvs.is_empty() {
            return Vec2::new(u, v);
        }
        blend_corners(self.indices[i as usize].map(|k| Vec2::from(self.uvs[k as usize])), u, v)
    }

    /// Position and partial derivatives at (u, v).
    #[must_use]
    pub fn at(&self, i: u32, u: f64, v: f64) -> (DVec3, DVec3, DVec3) {
        let [p00, p10, p01, p11] = corners(self, i);
        let p = (p00 * (1.0 - u) + p10 * u) * (1.0 - v) + (p01 * (1.0 - u) + p11 * u) * v;
        let dpdu = (p10 - p00) * (1.0 - v) + (p11 - p01) * v;
        let dpdv = (p01 - p00) * (1.0 - u) + (p11 - p10) * u;
        (p, dpdu, dpdv)
    }

    /// Nearest (t, u, v) with t in (t_min, t_max).
    #[must_use]
    pub fn intersect(&self, i: u32, o: DVec3, d: DVec3, t_min: f64, t_max: f64) -> Option<(f64, f64, f64)> {
        let [p00, p10, p01, p11] = corners(self, i);
        // Line of constant u: a + v·b with a = lerp(p00, p10), b = lerp(p01 − p00, p11 − p10).
        let (a0, a1) = (p00 - o, p10 - p00);
        let (b0, b1) = (p01 - p00, (p11 - p10) - (p01 - p00));
        // (a × b)·d = 0 as c0 + c1 u + c2 u².
        let c0 = a0.cross(b0).dot(d);
        let c1 = (a1.cross(b0) + a0.cross(b1)).dot(d);
        let c2 = a1.cross(b1).dot(d);
        let mut best: Option<(f64, f64, f64)> = None;
        for u in quadratic(c2, c1, c0).into_iter().flatten() {
            if !(0.0..=1.0).contains(&u) {
                continue;
            }
            let (a, b) = (a0 + a1 * u, b0 + b1 * u);
            let n = d.cross(b);
            let n2 = n.length_squared();
            if n2 == 0.0 {
                continue;
            }
            // Solve t·d = a + v·b in the plane both lie in.
            let t = a.cross(b).dot(n) / n2;
            let v = a.cross(d).dot(n) / n2;
            if (0.0..=1.0).contains(&v) && t > t_min && t < best.map_or(t_max, |h| h.0) {
                best = Some((t, u, v));
            }
        }
        best
    }
}

/// Real roots of a·x² + b·x + c, stable against cancellation; a may vanish.
fn quadratic(a: f64, b: f64, c: f64) -> [Option<f64>; 2] {
    if a == 0.0 {
        return [(b != 0.0).then(|| -c / b), None];
    }
    let discriminant = b * b - 4.0 * a * c;
    if discriminant.is_nan() || discriminant < 0.0 {
        return [None, None];
    }
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    [Some(q / a), (q != 0.0).then(|| c / q)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn saddle() -> Patches {
        Patches {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 0.0]],
            indices: vec![[0, 1, 2, 3]],
            ..Default::default()
        }
    }

    #[test]
    fn a_saddle_is_hit_at_its_own_height() {
        // z = u + v − 2uv on this patch.
        let p = saddle();
        for (u, v) in [(0.5, 0.5), (0.1, 0.9), (0.25, 0.3), (0.999, 0.001)] {
            let h = p
                .intersect(0, DVec3::new(u, v, 5.0), -DVec3::Z, 0.0, f64::INFINITY)
                .expect("above the patch");
            assert!((h.0 - (5.0 - (u + v - 2.0 * u * v))).abs() < 1e-12);
            assert!((h.1 - u).abs() < 1e-9 && (h.2 - v).abs() < 1e-9);
        }
        assert!(p.intersect(0, DVec3::new(1.1, 0.5, 5.0), -DVec3::Z, 0.0, f64::INFINITY).is_none());
    }

    #[test]
    fn a_slanted_ray_agrees_with_the_surface_it_names() {
        let p = saddle();
        let (o, d) = (DVec3::new(-1.0, 0.4, 0.9), DVec3::new(1.0, 0.1, -0.4));
        let (t, u, v) = p.intersect(0, o, d, 0.0, f64::INFINITY).expect("crosses the patch");
        assert!((p.at(0, u, v).0 - (o + d * t)).length() < 1e-12);
    }
}
