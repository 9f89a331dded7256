//! Samples an emitting parallelogram seen from a point, such as a quad that came as two triangles.
//! Rectangles that look large are sampled uniformly in solid angle (Ureña et al. 2013), other
//! large parallelograms by the solid angles of their two triangles, small ones by area.

use super::triangle::{SMALL, Spherical};
use super::{ShapeSample, WideSample, at_distance, per_solid_angle};
use glam::{Vec2, Vec3, Vec3A};
use std::f32::consts::TAU;

/// |cos| of the corner up to which a parallelogram counts as a rectangle; the density is then
/// wrong by at most this, relatively. Vertices transformed in f32 reach about 1e-5.
const RIGHT_ANGLE: f32 = 1e-4;
/// Solid angles [sr] outside are sampled by area; see `triangle`.
const OMEGA_RANGE: std::ops::RangeInclusive<f32> = 3e-4..=6.22;

/// A corner and two edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parallelogram {
    corner: Vec3,
    e0: Vec3,
    e1: Vec3,
    n: Vec3,
    area: f32,
    l0: f32,
    l1: f32,
    rectangle: bool,
    /// What area sampling reads.
    wide: Wide,
}

/// Corner, edges, the way from corner to centre and the normal as SIMD registers take them.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Wide {
    corner: Vec3A,
    e0: Vec3A,
    e1: Vec3A,
    half: Vec3A,
    n: Vec3A,
    /// Square of the longer edge.
    longest2: f32,
    /// Density of area sampling.
    pdf_area: f32,
}

/// A rectangle around a point in its own frame: x along the first edge, z the distance.
struct Rect {
    x0: f32,
    x1: f32,
    y0: f32,
    y1: f32,
    z: f32,
    b0: f32,
    b1: f32,
    a0: f32,
    /// e^{i(γ₂ + γ₃)}, the two corner angles at the far end of x.
    far: Vec2,
    omega: f32,
}

#[inline]
fn complex(a: Vec2, b: Vec2) -> Vec2 {
    Vec2::new(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x)
}

enum Method {
    Area,
    Rect(Rect),
    Triangles(Spherical, Spherical),
}

impl Parallelogram {
    /// `corner`, `corner + e0`, `corner + e0 + e1`, `corner + e1`; the normal is `e0` × `e1`.
    /// `None` where the area is zero or not finite.
    #[must_use]
    pub fn new(corner: Vec3, e0: Vec3, e1: Vec3) -> Option<Self> {
        let cross = e0.cross(e1);
        let area = cross.length();
        let (l0, l1) = (e0.length(), e1.length());
        let valid = area > 0.0 && area.is_finite() && corner.is_finite() && l0.is_finite() && l1.is_finite();
        valid.then(|| {
            let rectangle = e0.dot(e1).abs() <= RIGHT_ANGLE * l0 * l1;
            let n = cross / area;
            let wide = Wide {
                corner: corner.into(),
                e0: e0.into(),
                e1: e1.into(),
                half: ((e0 + e1) * 0.5).into(),
                n: n.into(),
                longest2: l0.max(l1).powi(2),
                pdf_area: 1.0 / area,
            };
            Self { corner, e0, e1, n, area, l0, l1, rectangle, wide }
        })
    }

    /// Area.
    #[must_use]
    pub fn area(&self) -> f32 {
        self.area
    }

    /// Unit normal.
    #[must_use]
    pub fn n(&self) -> Vec3 {
        self.n
    }

    #[inline]
    fn method(&self, p: Vec3) -> Method {
        let d = self.corner - p;
        if self.is_small(p.into()) {
            return Method::Area;
        }
        if self.rectangle {
            let rect = self.rect(d);
            return if OMEGA_RANGE.contains(&rect.omega) { Method::Rect(rect) } else { Method::Area };
        }
        let cross = self.n * self.area;
        let (b, c) = (d + self.e0, d + self.e1);
        let halves = (Spherical::new([d, b, c], cross), Spherical::new([b, b + self.e1, c], cross));
        if halves.0.serves() && halves.1.serves() {
            Method::Triangles(halves.0, halves.1)
        } else {
            Method::Area
        }
    }

    fn rect(&self, d: Vec3) -> Rect {
        let x0 = d.dot(self.e0) / self.l0;
        let y0 = d.dot(self.e1) / self.l1;
        let (x1, y1) = (x0 + self.l0, y0 + self.l1);
        let z = d.dot(self.n).abs();
        let z2 = z * z;
        // Each side's plane through the point: z component of its normal, and one minus its square.
        let side = |x: f32| {
            let l2 = x * x + z2;
            (x / l2.sqrt(), z2 / l2)
        };
        let ((s0, a0), (s1, a1), (s2, a2), (s3, a3)) = (side(-y0), side(x1), side(y1), side(-x0));
        // A corner's angle γ between two sides, as e^{iγ}.
        let corner = |s: f32, a: f32, t: f32, b: f32| Vec2::new(-s * t, (a + b - a * b).max(0.0).sqrt());
        let near = complex(corner(s0, a0, s1, a1), corner(s1, a1, s2, a2));
        let far = complex(corner(s2, a2, s3, a3), corner(s3, a3, s0, a0));
        let turn = complex(near, far);
        let angle = turn.y.atan2(turn.x);
        let omega = if angle < 0.0 { angle + TAU } else { angle };
        Rect { x0, x1, y0, y1, z, b0: s0, b1: s2, a0, far, omega }
    }

    /// A point of the parallelogram as seen from `p`; it is `corner + b0 e0 + b1 e1`. `None` where
    /// it is seen edge-on.
    #[inline]
    #[must_use]
    pub fn sample(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        self.sample_wide(p.into(), u).map(ShapeSample::from)
    }

    /// As [`Self::sample`].
    #[inline(always)]
    pub(in crate::integrator) fn sample_wide(&self, p: Vec3A, u: Vec2) -> Option<WideSample> {
        if !self.is_small(p) {
            return self.sample_large(p.into(), u).map(WideSample::from);
        }
        let Wide { corner, e0, e1, n, pdf_area, .. } = self.wide;
        let point = corner + e0 * u.x + e1 * u.y;
        let towards = point - p;
        let pdf_solid_angle = at_distance(pdf_area, towards.length_squared(), n.dot(towards).abs())?;
        Some(WideSample { point, n, pdf_solid_angle, b0: u.x, b1: u.y })
    }

    /// Whether it is so small or far that area sampling serves.
    #[inline(always)]
    fn is_small(&self, p: Vec3A) -> bool {
        let centre = self.wide.corner - p + self.wide.half;
        self.wide.longest2 < SMALL * centre.length_squared()
    }

    #[inline(never)]
    fn sample_large(&self, p: Vec3, u: Vec2) -> Option<ShapeSample> {
        let (b, pdf) = match self.method(p) {
            Method::Area => (u, None),
            Method::Rect(rect) => {
                let at = rect.sample(u);
                let b = (at - Vec2::new(rect.x0, rect.y0)) / Vec2::new(self.l0, self.l1);
                (b.clamp(Vec2::ZERO, Vec2::ONE), Some(1.0 / rect.omega))
            }
            Method::Triangles(first, second) => {
                let omega = first.omega + second.omega;
                let split = first.omega / omega;
                let b = if u.x < split {
                    let w = first.sample(Vec2::new((u.x / split).min(1.0), u.y));
                    Vec2::new(w.y, w.z)
                } else {
                    let w = second.sample(Vec2::new(((u.x - split) / (1.0 - split)).min(1.0), u.y));
                    Vec2::new(w.x + w.y, w.y + w.z)
                };
                (b, Some(1.0 / omega))
            }
        };
        let point = self.corner + self.e0 * b.x + self.e1 * b.y;
        let pdf_solid_angle = match pdf {
            Some(pdf) => pdf,
            None => per_solid_angle(self.wide.pdf_area, point - p, self.n)?,
        };
        Some(ShapeSample { point, n: self.n, pdf_solid_angle, b0: b.x, b1: b.y })
    }

    /// Density [1/sr] with which [`Parallelogram::sample`] chooses, from `p`, the direction that
    /// meets it at `distance` under the cosine `cos` (of either sign).
    #[inline]
    #[must_use]
    pub fn pdf(&self, p: Vec3, distance: f32, cos: f32) -> f32 {
        match self.method(p) {
            Method::Area => distance * distance / (cos.abs() * self.area),
            Method::Rect(rect) => 1.0 / rect.omega,
            Method::Triangles(first, second) => 1.0 / (first.omega + second.omega),
        }
    }
}

impl Rect {
    /// Ureña et al. 2013, listing 1, with angles kept as complex numbers and 1 − cos² resolved, so
    /// that neither small nor grazing rectangles cancel.
    #[inline]
    fn sample(&self, u: Vec2) -> Vec2 {
        let (sin, cos) = (u.x * self.omega).sin_cos();
        // φ = u Ω − (γ₂ + γ₃).
        let phi = complex(Vec2::new(cos, sin), Vec2::new(self.far.x, -self.far.y));
        let f = phi.x * self.b0 - self.b1;
        let root = (f * f - self.a0 * phi.y * phi.y).max(f32::MIN_POSITIVE).sqrt();
        let x = (self.z * phi.y * 1f32.copysign(f) / root).clamp(self.x0, self.x1);
        let d2 = x * x + self.z * self.z;
        let h0 = self.y0 / (d2 + self.y0 * self.y0).sqrt();
        let h1 = self.y1 / (d2 + self.y1 * self.y1).sqrt();
        let h = h0 + u.y * (h1 - h0);
        let y = h * (d2 / (1.0 - h * h).max(f32::MIN_POSITIVE)).sqrt();
        Vec2::new(x, y.clamp(self.y0, self.y1))
    }
}

/// The parallelogram that two triangles make by sharing an edge, if they do, lie in one plane,
/// and face the same way. Its corner is the first triangle's vertex off the shared edge, so that
/// (b0, b1) with b0 + b1 ≤ 1 are that triangle's barycentric weights of its next two vertices.
#[must_use]
pub fn merge_triangles(t0: [Vec3; 3], t1: [Vec3; 3]) -> Option<Parallelogram> {
    let size = (t0[1] - t0[0]).abs().max((t0[2] - t0[0]).abs()).max_element();
    let far = t0.iter().chain(&t1).fold(0f32, |m, v| m.max(v.abs().max_element()));
    // Vertices that met before a transform in f32 still meet within a few ulps of the coordinates.
    let near = |a: Vec3, b: Vec3| (a - b).abs().max_element() <= 1e-5 * size + 4.0 * f32::EPSILON * far;
    let n0 = (t0[1] - t0[0]).cross(t0[2] - t0[0]);
    let n1 = (t1[1] - t1[0]).cross(t1[2] - t1[0]);
    if n0.dot(n1) <= 0.0 {
        return None;
    }
    for i in 0..3 {
        let (a, b, c) = (t0[i], t0[(i + 1) % 3], t0[(i + 2) % 3]);
        for j in 0..3 {
            // The neighbour runs along the shared edge the other way.
            let (d, e, f) = (t1[j], t1[(j + 1) % 3], t1[(j + 2) % 3]);
            if near(b, f) && near(c, e) && near(d - b, c - a) {
                return Parallelogram::new(a, b - a, c - a);
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::super::analytic::polygon_irradiance;
    use super::super::testing::{Rng, check_irradiance, check_shape, triangle_coordinates};
    use super::*;

    fn directions(p: Vec3, q: Parallelogram) -> impl Fn(Vec3) -> f32 {
        move |w| {
            let t = [q.corner, q.corner + q.e0, q.corner + q.e1];
            triangle_coordinates(p, w, t).map_or(0.0, |(b0, b1, t)| {
                let inside = (0.0..=1.0).contains(&b0) && (0.0..=1.0).contains(&b1);
                if inside { q.pdf(p, t, q.n.dot(w)) } else { 0.0 }
            })
        }
    }

    fn cases() -> Vec<(Vec3, Parallelogram)> {
        let corner = Vec3::new(-1.0, -0.5, 0.3);
        let e0 = Vec3::new(2.0, 0.5, 0.1);
        let square = Vec3::new(-0.2, 1.0, -1.0);
        let right = Parallelogram::new(corner, e0, square - e0 * (square.dot(e0) / e0.length_squared()));
        let skew = Parallelogram::new(corner, e0, Vec3::new(0.9, 1.0, 0.2));
        let (right, skew) = (right.expect("area"), skew.expect("area"));
        assert!(right.rectangle && !skew.rectangle);
        let mut cases = Vec::new();
        for q in [right, skew] {
            let centre = q.corner + (q.e0 + q.e1) * 0.5;
            for distance in [20.0, 2.0, 0.5, 0.05, -1.0] {
                cases.push((centre + q.n * distance, q));
            }
            // Beside it, and grazing.
            cases.push((centre + q.e0 * 2.0 + q.n * 0.7, q));
            cases.push((centre + q.e0 * 0.8 - q.e1 * 0.7 + q.n * 0.02, q));
            cases.push((q.corner + q.n * 0.6, q));
        }
        cases
    }

    #[test]
    fn directions_follow_the_density() {
        for (i, (p, q)) in cases().into_iter().enumerate() {
            check_shape(&format!("parallelogram {i}"), p, |u| q.sample(p, u), directions(p, q));
        }
    }

    #[test]
    fn irradiance_is_lamberts() {
        for (i, (p, q)) in cases().into_iter().enumerate() {
            let n = q.n * q.n.dot(q.corner - p).signum();
            let v = [q.corner, q.corner + q.e0, q.corner + q.e0 + q.e1, q.corner + q.e1];
            let known = polygon_irradiance(p, n, &v);
            check_irradiance(&format!("parallelogram {i}"), p, n, known, |u| q.sample(p, u));
        }
    }

    #[test]
    fn the_solid_angle_of_a_cube_face_is_two_thirds_pi() {
        let q = Parallelogram::new(Vec3::new(-1.0, -1.0, 1.0), Vec3::X * 2.0, Vec3::Y * 2.0).expect("area");
        assert!((1.0 / q.pdf(Vec3::ZERO, 1.0, 1.0) - TAU / 3.0).abs() < 1e-5);
    }

    #[test]
    fn extreme_rectangles_stay_finite_and_consistent() {
        let mut rng = Rng::new(23);
        for i in 0..200_000 {
            let scale = |u: f32| 10f32.powf(u * 8.0 - 4.0);
            let e0 = rng.direction() * scale(rng.f32());
            let mut e1 = rng.direction() * scale(rng.f32());
            if i % 4 != 0 {
                e1 = e0.cross(e1).normalize() * scale(rng.f32());
            }
            let p = rng.direction() * scale(rng.f32());
            let Some(q) = Parallelogram::new(rng.direction(), e0, e1) else { continue };
            if let Some(s) = q.sample(p, rng.vec2()) {
                let d = s.point - p;
                let again = q.pdf(p, d.length(), s.n.dot(d.normalize()));
                assert!(s.point.is_finite() && s.pdf_solid_angle > 0.0 && s.pdf_solid_angle.is_finite());
                // Edge-on, the cosine itself is rounding.
                let edge_on = s.n.dot(d.normalize()).abs() < 1e-3;
                assert!(edge_on || (again / s.pdf_solid_angle - 1.0).abs() < 1e-3, "{again} {s:?}");
                assert!((0.0..=1.0).contains(&s.b0) && (0.0..=1.0).contains(&s.b1));
            }
        }
    }

    #[test]
    fn two_triangles_merge_only_into_a_flat_parallelogram() {
        let [a, b, c, d] = [Vec3::ZERO, Vec3::X, Vec3::new(1.2, 1.0, 0.0), Vec3::new(0.2, 1.0, 0.0)];
        let whole = merge_triangles([a, b, c], [a, c, d]).expect("one parallelogram");
        assert!((whole.area() - 1.0).abs() < 1e-6 && (whole.n() - Vec3::Z).length() < 1e-6);
        assert_eq!(whole.corner, b);
        for k in 0..9 {
            let (mut t0, mut t1) = ([a, b, c], [c, d, a]);
            t0.rotate_left(k % 3);
            t1.rotate_left(k / 3);
            assert!(merge_triangles(t0, t1).is_some(), "rotation {k}");
        }
        // Another diagonal; facing apart; folded; a mere quadrilateral; the same triangle twice.
        assert!(merge_triangles([b, c, d], [b, d, a]).is_some());
        assert!(merge_triangles([a, b, c], [a, d, c]).is_none());
        assert!(merge_triangles([a, b, c], [a, c, d + Vec3::Z * 0.1]).is_none());
        assert!(merge_triangles([a, b, c], [a, c, d + Vec3::Y * 0.01]).is_none());
        assert!(merge_triangles([a, b, c], [a, b, c]).is_none());
        assert!(merge_triangles([a, a, a], [a, a, a]).is_none());
    }
}
