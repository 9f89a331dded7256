//! The coated model's closed form against a random walk written apart from it: f64, analog
//! photons, visible normals by another method. Scores where light leaves, so it needs neither the
//! reciprocity nor the factorisation that the closed form rests on.

use super::*;
use glam::DVec3;
use std::f64::consts::{PI, TAU};

const BINS: usize = 10;
const PATHS: usize = 200_000;
const ALBEDOS: [f64; 3] = [0.2, 0.5, 0.9];

/// A GGX facet seen from `w` (z > 0) by Heitz 2018: a point on the projected half disk.
fn facet(w: DVec3, alpha: f64, rng: &mut Rng) -> DVec3 {
    let v = DVec3::new(alpha * w.x, alpha * w.y, w.z).normalize();
    let t1 = if v.z < 0.999_999 { DVec3::Z.cross(v).normalize() } else { DVec3::X };
    let t2 = v.cross(t1);
    let (r, phi) = (rng.f64().sqrt(), TAU * rng.f64());
    let (a, b) = (r * phi.cos(), r * phi.sin());
    let s = 0.5 * (1.0 + v.z);
    let b = (1.0 - s) * (1.0 - a * a).sqrt() + s * b;
    let n = t1 * a + t2 * b + v * (1.0 - a * a - b * b).max(0.0).sqrt();
    DVec3::new(alpha * n.x, alpha * n.y, n.z.max(0.0)).normalize()
}

fn lambda(w: DVec3, alpha: f64) -> f64 {
    let tan2 = (w.x * w.x + w.y * w.y) / (w.z * w.z);
    0.5 * ((1.0 + alpha * alpha * tan2).sqrt() - 1.0)
}

/// Fresnel by the textbook's amplitude ratios: (reflectance, cosθt).
fn fresnel_f64(cos_i: f64, eta: f64) -> (f64, f64) {
    let sin_t = (1.0 - cos_i * cos_i).max(0.0).sqrt() / eta;
    if sin_t >= 1.0 {
        return (1.0, 0.0);
    }
    let cos_t = (1.0 - sin_t * sin_t).sqrt();
    let s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    let p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    (0.5 * (s * s + p * p), cos_t)
}

/// One meeting with the interface from z > 0 of its own side: the direction and weight if the
/// facet lets the chosen event happen.
fn interface(
    w: DVec3,
    eta: f64,
    alpha: f64,
    reflect: Option<bool>,
    rng: &mut Rng,
) -> Option<(DVec3, f64, bool)> {
    let m = if alpha < 1e-3 { DVec3::Z } else { facet(w, alpha, rng) };
    let cos = w.dot(m);
    let (f, cos_t) = fresnel_f64(cos, eta);
    let (reflect, mut weight) = match reflect {
        Some(true) => (true, f),
        Some(false) => (false, 1.0 - f),
        None => (rng.f64() < f, 1.0),
    };
    let out = if reflect { 2.0 * cos * m - w } else { (cos / eta - cos_t) * m - w / eta };
    if (out.z > 0.0) != reflect || weight == 0.0 {
        return None;
    }
    if alpha >= 1e-3 {
        let (lo, li) = (lambda(w, alpha), lambda(out, alpha));
        weight *= (1.0 + lo) / (1.0 + lo + li);
    }
    Some((out, weight, reflect))
}

struct Layer {
    eta: f64,
    alpha: f64,
    thickness: f64,
    bounces: u32,
}

/// Follows one photon from outside; where it leaves after touching the base: cosine, weight, touches.
fn photon(wo: DVec3, layer: &Layer, rng: &mut Rng) -> Option<(f64, f64, u32)> {
    let through = |w: DVec3| (-layer.thickness / w.z.abs()).exp();
    let (mut w, mut weight, _) = interface(wo, layer.eta, layer.alpha, Some(false), rng)?;
    for touches in 1..=layer.bounces {
        weight *= through(w);
        let (r, phi) = (rng.f64().sqrt(), TAU * rng.f64());
        let up = DVec3::new(r * phi.cos(), r * phi.sin(), (1.0 - r * r).sqrt());
        weight *= through(up);
        // Seen from inside, the interface's own side is below: the mirrored frame is the same.
        let (out, factor, reflected) = interface(up, 1.0 / layer.eta, layer.alpha, None, rng)?;
        weight *= factor;
        if !reflected {
            return Some((-out.z, weight, touches));
        }
        w = out;
    }
    None
}

/// 1,200 z-tests with a false-alarm rate of 1e-3 together (Šidák: |z| < 4.93), plus what the
/// table may err, 1e-3 of the bin's light.
#[test]
fn closed_form_is_the_expectation_of_the_walk() {
    let (mut worst, mut seed) = (0f64, 0);
    for (eta, thickness, max_depth) in [(1.5f32, 0.01f32, 10u32), (1.33, 0.3, 3)] {
        for alpha in [0.0f32, 0.001, 0.05, 0.1, 0.3] {
            let table = CoatedTable::new(eta, alpha, alpha, thickness, max_depth);
            let ggx = Ggx::new(alpha, alpha);
            let layer = Layer {
                eta: eta.into(),
                alpha: alpha.into(),
                thickness: thickness.into(),
                bounces: max_depth.div_ceil(2),
            };
            for cos in [1.0f32, 0.6, 0.2, 0.03] {
                let wo = direction(cos, 0.0);
                seed += 1;
                let mut rng = Rng(seed);
                let mut sums = [[[0f64; 2]; BINS]; ALBEDOS.len()];
                for _ in 0..PATHS {
                    let Some((cos, weight, touches)) = photon(wo.as_dvec3().normalize(), &layer, &mut rng)
                    else {
                        continue;
                    };
                    let bin = ((cos * BINS as f64) as usize).min(BINS - 1);
                    for (sum, albedo) in sums.iter_mut().zip(ALBEDOS) {
                        let score = weight * albedo.powi(touches as i32);
                        sum[bin][0] += score;
                        sum[bin][1] += score * score;
                    }
                }
                for (sum, albedo) in sums.iter().zip(ALBEDOS) {
                    let coated = Bsdf::CoatedDiffuse(CoatedDiffuse::with_table(
                        &table,
                        Rgb::splat(albedo as f32),
                        ggx,
                    ));
                    let coat = Bsdf::Dielectric(Dielectric::new(eta, ggx));
                    for (bin, [sum, square]) in sum.iter().enumerate() {
                        // The base's part does not depend on azimuth: Simpson over the cosine, at
                        // an azimuth far from the interface's lobe, which is taken off.
                        let f = |x: f64| {
                            let wi = direction(((bin as f64 + x) / BINS as f64).max(1e-7) as f32, 1.7);
                            f64::from(coated.eval(wo, wi).0.x - coat.eval(wo, wi).0.x)
                        };
                        let nodes = 20;
                        let expected: f64 = (0..nodes)
                            .map(|i| {
                                let (a, h) = (f64::from(i) / f64::from(nodes), 1.0 / f64::from(nodes));
                                f(a) + 4.0 * f(a + 0.5 * h) + f(a + h)
                            })
                            .sum::<f64>()
                            * TAU
                            / (6.0 * f64::from(nodes) * BINS as f64);
                        let n = PATHS as f64;
                        let mean = sum / n;
                        let sigma = ((square / n - mean * mean).max(0.0) / n).sqrt();
                        let allowed = 1e-3 * expected;
                        let z = ((mean - expected).abs() - allowed).max(0.0) / sigma;
                        worst = worst.max(z);
                        assert!(
                            z < 4.93,
                            "eta {eta} alpha {alpha} cos {cos} albedo {albedo} bin {bin}: walk {mean} ± {sigma}, closed form {expected}"
                        );
                    }
                }
            }
        }
    }
    println!("largest |z| {worst:.2}");
}

/// pbrt-v4's `LayeredBxDF::f` joins two strategies for leaving the layer by the power heuristic,
/// but weighs the second by the density of wi given the inner direction, where the first has that
/// of the inner direction given wi. The weights then do not sum to 1 for a rough interface. This
/// prints by how much its base term exceeds the expectation; it is no part of our model.
#[test]
#[ignore = "prints a known difference from pbrt-v4, judges nothing"]
fn weights_of_the_original_estimator() {
    let eta = 1.5f32;
    for alpha in [0.001f32, 0.05, 0.1, 0.3, 0.6] {
        let coat = Bsdf::Dielectric(Dielectric::new(eta, Ggx::new(alpha, alpha)));
        for cos in [1.0f32, 0.6, 0.2] {
            let wi = direction(cos, 0.0);
            let mut rng = Rng(77);
            let (mut exact, mut mixed) = (0f64, 0f64);
            // Restricted to transmission, the interface's density loses its factor 1 − F.
            let transmission_pdf = |o: Vec3, i: Vec3| {
                let ratio = if o.z > 0.0 { eta } else { 1.0 / eta };
                let h = (o + i * ratio).normalize();
                let f = fresnel_f64(f64::from(o.dot(h).abs()), ratio.into()).0;
                f64::from(coat.eval(o, i).1) / (1.0 - f).max(1e-9)
            };
            let heuristic = |a: f64, b: f64| a * a / (a * a + b * b);
            for _ in 0..PATHS {
                if let Some((inner, weight, _)) =
                    interface(wi.as_dvec3(), eta.into(), alpha.into(), Some(false), &mut rng)
                {
                    let base = -inner.z / PI;
                    exact += weight;
                    mixed += weight * heuristic(transmission_pdf(wi, inner.as_vec3()), base);
                }
                let inner = crate::math::warp::cosine_hemisphere(rng.vec2());
                let f = f64::from(coat.eval(-inner, wi).0.x / wi.z) * PI;
                let base = f64::from(inner.z) / PI;
                if f > 0.0 {
                    mixed += f * heuristic(base, transmission_pdf(-inner, wi));
                }
            }
            println!("alpha {alpha} cos {cos}: original / expectation = {:.4}", mixed / exact);
        }
    }
}
