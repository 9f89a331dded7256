//! How far an answer may be from the truth: bounds on the rounding of each voice's triangle test, for the ray and the
//! triangle at hand, from the analysis of its operations in f32 (u = 2⁻²⁴, γₙ of `math`).
//!
//! A hit of corners c₀, c₁, c₂ (seen from the ray's origin) is decided by w₀ = d·(c₁ × c₂) and its like, and lies at
//! t = n·c₀ / n·d, where n is the normal and n·d = w₀ + w₁ + w₂. The bounds are on what is computed for w, n·d and t.
//!
//! - **Native** shears corners into the ray's frame. That moves a corner sideways by δ = 2u·|x| + 5u·|S·z| (a
//!   difference, a quotient, two products, a difference), and is exact from there on: the test answers exactly for a
//!   triangle with moved corners. So its t differs by Σ bᵢ·n·eᵢ / n·d, with bᵢ in [0, 1], whatever the angle; two
//!   roundings of each corner's own distance and one of the sum come on top. Then t is held to the box.
//! - **Embree, fast** (Möller-Trumbore on stored edges): w has 1 rounding of c₀, 2 of the cross product c₀ × d, 1 of the
//!   edge, 3 of the dot product: γ₇ of the sum of absolute products. n has 4, n·d so 7, n·c₀ 8. The reciprocal is
//!   (1.5·2⁻¹²)² = 2.25u off, after one Newton step of two roundings, and multiplied: γ₆.
//! - **Embree, robust** (Plücker on corners seen from the origin): as fast, with corners moved by u·|c|, and a
//!   tolerance of 2u·|w₀ + w₁ + w₂| on each w.
//! - **Instances**: the ray in the object's space is off by the rounding of its transform. The native inverse is rounded
//!   once from f64; Embree's is the adjoint over the determinant, in f32.
//!
//! Products of two such errors are left out of each formula and covered by [`SECOND_ORDER`].
//! Never guesses, and never looks at an answer.

use crate::accel::{InstanceOf, Ray};
use crate::math::{DMat4, DVec3, gamma};
use glam::DMat3;

/// Half a unit in the last place of one.
const U: f64 = (f32::EPSILON / 2.0) as f64;
/// As [`U`] for the arbiter's own arithmetic.
const U64: f64 = f64::EPSILON / 2.0;
/// While each error is below 2⁻¹¹ of what it is an error of, products of two add less than this.
const SECOND_ORDER: f64 = 1.0 + 1.0 / 1024.0;

fn g(n: u32) -> f64 {
    f64::from(gamma(n))
}

/// Whose arithmetic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Voice {
    /// Our hierarchy.
    Native,
    /// Embree as it is by default.
    Embree,
    /// Embree with `RTC_SCENE_FLAG_ROBUST`.
    EmbreeRobust,
}

/// A ray in the space of an object, and by how much a voice's own may be off, by component.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalRay {
    pub(super) o: DVec3,
    pub(super) d: DVec3,
    pub(super) o_error: DVec3,
    pub(super) d_error: DVec3,
}

/// What is wrong with w₀, w₁, w₂, with their sum and with t, at most.
#[derive(Clone, Copy, Debug)]
pub(super) struct Errors {
    pub(super) w: [f64; 3],
    pub(super) den: f64,
    pub(super) t: f64,
}

/// A ray and a triangle in f64, whose coordinates came from f32: differences are exact or nearly so.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meeting {
    /// Corners seen from the origin.
    pub(super) c: [DVec3; 3],
    pub(super) d: DVec3,
    /// Not of unit length.
    pub(super) n: DVec3,
    pub(super) w: [f64; 3],
    /// n·d.
    pub(super) den: f64,
    /// Where the ray meets the plane; not finite where it does not.
    pub(super) t: f64,
}

/// The cross product of two vectors without signs, with plus in place of minus.
fn cross_abs(a: DVec3, b: DVec3) -> DVec3 {
    DVec3::new(a.y * b.z + a.z * b.y, a.z * b.x + a.x * b.z, a.x * b.y + a.y * b.x)
}

fn to_world(instance: &InstanceOf) -> (DMat3, DVec3) {
    let t = instance.transform.map(f64::from);
    let column = |c: usize| DVec3::new(t[3 * c], t[3 * c + 1], t[3 * c + 2]);
    (DMat3::from_cols(column(0), column(1), column(2)), column(3))
}

/// A point of an instance in the world.
pub(super) fn place(instance: &InstanceOf, p: DVec3) -> DVec3 {
    let (m, c) = to_world(instance);
    m * p + c
}

/// An instance's way into its object's space, and by how much a voice's own may be off, element by element.
pub(super) struct Placement {
    linear: DMat3,
    moved: DVec3,
    size: DMat3,
    /// Of the native inverse, and of Embree's.
    errors: [(DMat3, DVec3); 2],
}

impl Placement {
    pub(super) fn new(instance: &InstanceOf) -> Self {
        let (m, p) = to_world(instance);
        let inverse = DMat4::from_mat3_translation(m, p).inverse();
        let (linear, moved) = (DMat3::from_mat4(inverse), inverse.w_axis.truncate());
        let size = linear.abs();
        // In f64, and rounded once.
        let native = (size * U, moved.abs() * U);
        // Adjoint: γ₂ of its absolute products; determinant: γ₅; their quotient: γ₆.
        let a = m.abs();
        let rows =
            [cross_abs(a.y_axis, a.z_axis), cross_abs(a.z_axis, a.x_axis), cross_abs(a.x_axis, a.y_axis)];
        let adjoint = DMat3::from_cols(rows[0], rows[1], rows[2]).transpose();
        let det = m.determinant().abs();
        let element = adjoint * (g(2) / det) + size * (g(5) * a.x_axis.dot(rows[0]) / det + g(6));
        let embree = (element, (element + size * g(3)) * p.abs());
        Self { linear, moved, size, errors: [native, embree] }
    }
}

impl LocalRay {
    /// `ray` as it is, or in the space of an instance.
    pub(super) fn new(voice: Voice, ray: &Ray, placement: Option<&Placement>) -> Self {
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let Some(Placement { linear, moved, size, errors }) = placement else {
            return Self { o, d, o_error: DVec3::ZERO, d_error: DVec3::ZERO };
        };
        let (element, shift) = &errors[usize::from(voice != Voice::Native)];
        // Three products and their sum.
        let each = *element + *size * g(4);
        Self {
            o: *linear * o + *moved,
            d: *linear * d,
            o_error: each * o.abs() + *shift + moved.abs() * g(1),
            d_error: each * d.abs(),
        }
    }
}

impl Meeting {
    pub(super) fn new(ray: &LocalRay, corners: [DVec3; 3]) -> Self {
        let [p0, p1, p2] = corners;
        let c = corners.map(|p| p - ray.o);
        let d = ray.d;
        let n = (p1 - p0).cross(p2 - p0);
        // With an edge in place of a second corner: nothing cancels that need not.
        let w = [d.dot(c[1].cross(p2 - p1)), d.dot(c[2].cross(p0 - p2)), d.dot(c[0].cross(p1 - p0))];
        let den = n.dot(d);
        Self { c, d, n, w, den, t: n.dot(c[0]) / den }
    }

    /// What `voice` may get wrong.
    pub(super) fn errors(&self, voice: Voice, ray: &LocalRay) -> Errors {
        let mut e = match voice {
            Voice::Native => self.native(ray),
            Voice::Embree => self.embree(ray, false),
            Voice::EmbreeRobust => self.embree(ray, true),
        };
        for i in 0..3 {
            let [_, b, c] = self.from(i);
            e.w[i] += 16.0 * U64 * self.d.abs().dot(cross_abs(b.abs(), (c - b).abs()));
            e.w[i] *= SECOND_ORDER;
        }
        e.den *= SECOND_ORDER;
        e.t *= SECOND_ORDER;
        e
    }

    /// Corners in turn, from `i` on.
    fn from(&self, i: usize) -> [DVec3; 3] {
        [self.c[i], self.c[(i + 1) % 3], self.c[(i + 2) % 3]]
    }

    /// What the transform into an instance adds to w, n·d, and n·d·t.
    fn placing(&self, ray: &LocalRay) -> ([f64; 3], f64, f64) {
        let w = [0, 1, 2].map(|i| {
            let [_, b, c] = self.from(i);
            self.d.cross(b - c).abs().dot(ray.o_error) + b.cross(c).abs().dot(ray.d_error)
        });
        let n = self.n.abs();
        (w, n.dot(ray.d_error), n.dot(ray.o_error + ray.d_error * self.t.abs()))
    }

    fn native(&self, ray: &LocalRay) -> Errors {
        let size = self.d.abs().to_array();
        // The first of the largest, as the query takes it.
        let largest = size.into_iter().fold(0.0, f64::max);
        let z = size.iter().position(|s| *s == largest).unwrap_or(2);
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let (sx, sy) = (self.d[x] / self.d[z], self.d[y] / self.d[z]);
        let sheared = self.c.map(|c| ((c[x] - sx * c[z]).abs(), (c[y] - sy * c[z]).abs()));
        let delta = self.c.map(|c| {
            (
                U * (2.0 * c[x].abs() + 5.0 * (sx * c[z]).abs()),
                U * (2.0 * c[y].abs() + 5.0 * (sy * c[z]).abs()),
            )
        });
        let (placed_w, placed_den, placed_t) = self.placing(ray);
        let mut w = [0.0; 3];
        for (i, w) in w.iter_mut().enumerate() {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            let ((bx, by), (cx, cy)) = (sheared[j], sheared[k]);
            let ((ebx, eby), (ecx, ecy)) = (delta[j], delta[k]);
            *w = size[z] * (bx * ecy + cy * ebx + by * ecx + cx * eby + ebx * ecy + eby * ecx) + placed_w[i];
        }
        let den = (self.den.abs() - placed_den).max(0.0);
        let corner = |i: usize| {
            let (ex, ey) = delta[i];
            (self.n[x].abs() * ex + self.n[y].abs() * ey) / den + g(2) * (self.c[i][z] / self.d[z]).abs()
        };
        let t = corner(0).max(corner(1)).max(corner(2)) + placed_t / den + g(1) * self.t.abs();
        Errors { w, den: w.iter().sum(), t }
    }

    fn embree(&self, ray: &LocalRay, robust: bool) -> Errors {
        let d = self.d.abs();
        let [c0, c1, c2] = self.c;
        let (e1, e2) = ((c1 - c0).abs(), (c2 - c0).abs());
        let products = cross_abs(e1, e2);
        let (placed_w, placed_den, placed_t) = self.placing(ray);
        let mut den = g(7) * products.dot(d) + placed_den;
        let mut over = g(8) * products.dot(c0.abs()) + placed_t;
        let mut w;
        if robust {
            // Each corner seen from the origin is rounded.
            let moved = self.c.map(|c| c.abs() * U);
            w = [0, 1, 2].map(|i| {
                let [_, b, c] = self.from(i);
                let [_, eb, ec] = [moved[i], moved[(i + 1) % 3], moved[(i + 2) % 3]];
                let computed = 0.5 * g(7) * cross_abs((c - b).abs(), b.abs() + c.abs()).dot(d);
                let moving = self.d.cross(b).abs().dot(ec) + self.d.cross(c).abs().dot(eb);
                computed + moving + 2.0 * U * self.den.abs()
            });
            for (i, moved) in moved.iter().enumerate() {
                let [_, b, c] = self.from(i);
                den += self.d.cross(c - b).abs().dot(*moved);
            }
            let n = self.n.abs();
            over += moved.map(|m| n.dot(m)).into_iter().fold(0.0, f64::max);
        } else {
            let side = cross_abs(c0.abs(), d);
            let (u, v) = (g(7) * side.dot(e2), g(7) * side.dot(e1));
            // The third is what the others leave of the sum.
            w = [den + u + v + g(1) * (self.w[1].abs() + self.w[2].abs()), u, v];
        }
        for (w, placed) in w.iter_mut().zip(placed_w) {
            *w += placed;
        }
        let left = self.den.abs() - den;
        let t =
            if left > 0.0 { (over + self.t.abs() * den) / left + g(6) * self.t.abs() } else { f64::INFINITY };
        Errors { w, den, t }
    }
}

/// Where a native query may hold a hit's distance to: the least and the most of where the ray enters and of where it
/// leaves the padded box of a triangle, with the rounding of the slabs: 9u of the origin's and 27u of the face's distance.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoxInterval {
    enter: [f64; 2],
    leave: [f64; 2],
}

impl BoxInterval {
    pub(super) fn new(ray: &LocalRay, corners: [DVec3; 3]) -> Self {
        let [p0, p1, p2] = corners;
        let (lo, hi) = (p0.min(p1).min(p2), p0.max(p1).max(p2));
        // Eight roundings of the extent and three of the coordinates, at most; no less than nothing.
        let extent = (hi - lo).max_element();
        let largest = ray.d.abs().max_element();
        let mut interval = Self { enter: [f64::NEG_INFINITY; 2], leave: [f64::INFINITY; 2] };
        for k in 0..3 {
            let (d, o) = (ray.d[k], ray.o[k]);
            // Directions below this share of the largest are not looked at by the boxes (`accel/bvh/query.rs`).
            if d.abs() <= largest * (0.5f64).powi(39) {
                continue;
            }
            let pad = U * (8.0 * extent + 3.0 * lo[k].abs().max(hi[k].abs()));
            let error = |t: f64| {
                10.0 * U * (o / d).abs()
                    + 28.0 * U * t.abs()
                    + (ray.o_error[k] + t.abs() * ray.d_error[k]) / d.abs()
            };
            let faces = |pad: f64| {
                let (a, b) = ((lo[k] - pad - o) / d, (hi[k] + pad - o) / d);
                (a.min(b), a.max(b))
            };
            let ((near, far), (tight_near, tight_far)) = (faces(pad), faces(0.0));
            interval.enter[0] = interval.enter[0].max(near - error(near));
            interval.enter[1] = interval.enter[1].max(tight_near + error(tight_near));
            interval.leave[0] = interval.leave[0].min(tight_far - error(tight_far));
            interval.leave[1] = interval.leave[1].min(far + error(far));
        }
        interval
    }

    /// Distances between `lo` and `hi` may become these.
    pub(super) fn hold(&self, lo: f64, hi: f64) -> (f64, f64) {
        (lo.max(self.enter[0]).min(self.leave[0]), hi.min(self.leave[1]).max(self.enter[1]))
    }
}

#[cfg(test)]
#[path = "bounds_tests.rs"]
mod tests;
