//! Checks shared by the samplers' tests: directions against their density by a chi-squared test,
//! and irradiance against closed forms. Seeds are fixed, so a verdict never changes by itself.
//!
//! A right sampler fails one chi-squared test with probability 1e-5 (Wilson and Hilferty's normal
//! approximation beyond 4.27 standard deviations), one irradiance check with 6e-7 (5 deviations).

use super::ShapeSample;
use crate::math::Frame;
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// One-sided normal quantile of 1e-5.
pub(super) const Z_LIMIT: f64 = 4.27;

/// SplitMix64 (Steele et al. 2014): enough for tests.
pub(super) struct Rng(u64);

impl Rng {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(super) fn u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1), 24 bits.
    pub(super) fn f32(&mut self) -> f32 {
        (self.u64() >> 40) as f32 * (1.0 / 16_777_216.0)
    }

    pub(super) fn vec2(&mut self) -> Vec2 {
        Vec2::new(self.f32(), self.f32())
    }

    pub(super) fn direction(&mut self) -> Vec3 {
        crate::math::warp::uniform_sphere(self.vec2())
    }
}

/// Standard deviations by which counts exceed chance; bins of small expectation are pooled.
pub(super) fn chi_squared_z(observed: &[f64], expected: &[f64]) -> f64 {
    chi_squared_z_with(observed, expected, &vec![0.0; expected.len()])
}

/// As [`chi_squared_z`], where the expectations themselves have a variance.
fn chi_squared_z_with(observed: &[f64], expected: &[f64], variance: &[f64]) -> f64 {
    let mut order: Vec<usize> = (0..expected.len()).collect();
    order.sort_by(|&a, &b| expected[a].total_cmp(&expected[b]));
    let (mut chi2, mut cells, mut o, mut e, mut v) = (0.0, 0.0f64, 0.0, 0.0, 0.0);
    for i in order {
        o += observed[i];
        e += expected[i];
        v += variance[i];
        if e >= 10.0 {
            chi2 += (o - e) * (o - e) / (e + v);
            cells += 1.0;
            (o, e, v) = (0.0, 0.0, 0.0);
        }
    }
    if e > 0.0 || o > 0.0 {
        chi2 += (o - e) * (o - e) / (e + v).max(0.1);
        cells += 1.0;
    }
    let k = (cells - 1.0).max(1.0);
    let h = 2.0 / (9.0 * k);
    ((chi2 / k).cbrt() - (1.0 - h)) / h.sqrt()
}

const ROWS: usize = 16;
const COLUMNS: usize = 32;

/// Directions from `sample` against `pdf` [1/sr] over the cap around `axis` that holds them all.
pub(super) fn check_directions(
    name: &str,
    axis: Vec3,
    mut sample: impl FnMut(Vec2) -> Option<Vec3>,
    pdf: impl Fn(Vec3) -> f32,
) {
    const COUNT: usize = 200_000;
    const SUB: usize = 40;
    let frame = Frame::from_z(axis.normalize());
    let mut rng = Rng::new(7);
    let drawn: Vec<Option<Vec3>> =
        (0..COUNT).map(|_| sample(rng.vec2()).map(|w| frame.to_local(w))).collect();
    // 1 − cosθ without cancellation, so that a far, tiny shape still fills its bins.
    let height = |w: Vec3| {
        let s2 = (w.x * w.x + w.y * w.y) / w.length_squared();
        let c = (1.0 - s2).max(0.0).sqrt();
        if w.z >= 0.0 { s2 / (1.0 + c) } else { 1.0 + c }
    };
    let top = drawn.iter().flatten().fold(0f32, |m, &w| m.max(height(w))) * 1.02;
    let top = top.min(2.0);
    let mut observed = vec![0.0; ROWS * COLUMNS];
    for w in drawn.iter().flatten() {
        let row = ((height(*w) / top * ROWS as f32) as usize).min(ROWS - 1);
        let phi = (w.y.atan2(w.x) / (2.0 * PI) + 1.0).fract();
        observed[row * COLUMNS + ((phi * COLUMNS as f32) as usize).min(COLUMNS - 1)] += 1.0;
    }
    let mut expected = vec![0.0; ROWS * COLUMNS];
    let cell = f64::from(2.0 * PI * top) / (ROWS * COLUMNS) as f64;
    // The quadrature's own variance, bounded as if its points were not stratified: it matters in
    // bins that the shape's outline crosses.
    let mut variance = vec![0.0; ROWS * COLUMNS];
    for (i, (e, v)) in expected.iter_mut().zip(&mut variance).enumerate() {
        let (row, column) = (i / COLUMNS, i % COLUMNS);
        let (mut sum, mut squares) = (0.0, 0.0);
        for j in 0..SUB * SUB {
            let x = (column as f32 + ((j % SUB) as f32 + rng.f32()) / SUB as f32) / COLUMNS as f32;
            let y = (row as f32 + ((j / SUB) as f32 + rng.f32()) / SUB as f32) / ROWS as f32 * top;
            let r = (y * (2.0 - y)).sqrt();
            let (s, c) = (2.0 * PI * x).sin_cos();
            let value = f64::from(pdf(frame.to_world(Vec3::new(r * c, r * s, 1.0 - y))));
            sum += value;
            squares += value * value;
        }
        let n = (SUB * SUB) as f64;
        let scale = cell * COUNT as f64;
        *e = sum / n * scale;
        *v = (squares / n - (sum / n).powi(2)).max(0.0) / n * scale * scale;
    }
    let mass = expected.iter().sum::<f64>() / COUNT as f64;
    let doubt = variance.iter().sum::<f64>().sqrt() / COUNT as f64;
    assert!((mass - 1.0).abs() < 1e-3 + 5.0 * doubt, "{name}: the density integrates to {mass} ± {doubt}");
    // What was refused must be rounding, not mass.
    let lost = drawn.iter().filter(|w| w.is_none()).count();
    assert!(lost <= COUNT / 10_000, "{name}: {lost} of {COUNT} samples refused");
    let z = chi_squared_z_with(&observed, &expected, &variance);
    assert!(z < Z_LIMIT, "{name}: chi-squared {z:.2} deviations beyond chance");
}

/// [`check_directions`], and that each sample's own density is the one its direction has.
pub(super) fn check_shape(
    name: &str,
    p: Vec3,
    sample: impl Fn(Vec2) -> Option<ShapeSample>,
    pdf: impl Fn(Vec3) -> f32,
) {
    let mut rng = Rng::new(3);
    let (mut axis, mut disagree) = (Vec3::ZERO, 0);
    for _ in 0..2000 {
        let s = sample(rng.vec2()).expect(name);
        let w = (s.point - p).normalize();
        assert!((s.n.length() - 1.0).abs() < 1e-5, "{name}: normal {}", s.n);
        axis += w;
        // At an outline the ray may miss by rounding; elsewhere the densities must agree.
        let again = pdf(w);
        disagree += usize::from((again / s.pdf_solid_angle - 1.0).abs() > 5e-3);
    }
    assert!(disagree <= 20, "{name}: {disagree} of 2000 densities differ between sample and pdf");
    check_directions(name, axis, |u| sample(u).map(|s| (s.point - p).normalize()), pdf);
}

/// Irradiance at `p` with normal `n` from unit radiance, against a `known` one.
pub(super) fn check_irradiance(
    name: &str,
    p: Vec3,
    n: Vec3,
    known: f64,
    sample: impl Fn(Vec2) -> Option<ShapeSample>,
) {
    const COUNT: usize = 200_000;
    let mut rng = Rng::new(5);
    let (mut sum, mut squares) = (0.0, 0.0);
    for _ in 0..COUNT {
        let x = sample(rng.vec2()).map_or(0.0, |s| {
            f64::from((s.point - p).normalize().dot(n).max(0.0)) / f64::from(s.pdf_solid_angle)
        });
        sum += x;
        squares += x * x;
    }
    let mean = sum / COUNT as f64;
    let deviation = ((squares / COUNT as f64 - mean * mean).max(0.0) / COUNT as f64).sqrt();
    // The second term is the f32 rounding of geometry and density.
    let allowed = 5.0 * deviation + 2e-5 * known;
    assert!((mean - known).abs() <= allowed, "{name}: irradiance {mean}, not {known} (±{allowed})");
}

/// Distance at which a ray meets a triangle, both sides; in f64.
pub(super) fn hit_triangle(p: Vec3, w: Vec3, v: [Vec3; 3]) -> Option<f32> {
    let (b0, b1, t) = triangle_coordinates(p, w, v)?;
    (b0 >= 0.0 && b1 >= 0.0 && b0 + b1 <= 1.0).then_some(t)
}

/// (weight of v1, weight of v2, distance) where a ray meets a triangle's plane ahead.
pub(super) fn triangle_coordinates(p: Vec3, w: Vec3, v: [Vec3; 3]) -> Option<(f64, f64, f32)> {
    let [v0, v1, v2] = v.map(|v| v.as_dvec3());
    let (p, w) = (p.as_dvec3(), w.as_dvec3());
    let (e1, e2) = (v1 - v0, v2 - v0);
    let q = w.cross(e2);
    let det = q.dot(e1);
    let s = p - v0;
    let r = s.cross(e1);
    let t = e2.dot(r) / det;
    (t > 0.0 && t.is_finite()).then_some((s.dot(q) / det, w.dot(r) / det, t as f32))
}
