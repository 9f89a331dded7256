//! Fresnel reflectance of interfaces between dielectrics and of metals, unpolarised light.
//! Invariant: results lie in [0, 1]. Never decides a direction; cosines come in non-negative.

use crate::color::Rgb;
use crate::math::sqr;
use glam::Vec3A;

/// Reflectance and the cosine of the refracted direction. `cos_i` ≥ 0 is on the incident side,
/// `eta` is the far index over the near one. Total internal reflection gives (1, 0).
/// Fresnel's equations with both polarisations over one common denominator.
#[inline(always)]
#[must_use]
pub fn dielectric(cos_i: f32, eta: f32) -> (f32, f32) {
    if eta == 1.0 {
        return (0.0, cos_i);
    }
    let sin2_t = (1.0 - cos_i * cos_i) / (eta * eta);
    if sin2_t >= 1.0 {
        return (1.0, 0.0);
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    let (a, b) = (eta * cos_i, eta * cos_t);
    let (parallel, perpendicular) = (a + cos_t, cos_i + b);
    let reflected = sqr((a - cos_t) * perpendicular) + sqr((cos_i - b) * parallel);
    // min: at grazing incidence the quotient may round to just above 1.
    ((0.5 * reflected / sqr(parallel * perpendicular)).min(1.0), cos_t)
}

/// Reflectance of a metal of complex index `eta` − i·`k` from vacuum, channel by channel, in real
/// arithmetic: with a² + b² and a the moduli of the refracted normal component (Born and Wolf,
/// §14.2; the arrangement is Lagarde's 2013 memo).
#[inline(always)]
#[must_use]
pub fn conductor(cos_i: f32, eta: Rgb, k: Rgb) -> Rgb {
    let (eta, k) = (Vec3A::from(eta), Vec3A::from(k));
    let cos_i = cos_i.min(1.0);
    let cos2 = cos_i * cos_i;
    let sin2 = 1.0 - cos2;
    let (eta2, k2) = (eta * eta, k * k);
    let difference = eta2 - k2 - Vec3A::splat(sin2);
    let modulus2 = (difference * difference + 4.0 * eta2 * k2).sqrt();
    let a = (0.5 * (modulus2 + difference)).max(Vec3A::ZERO).sqrt();
    let cross = 2.0 * cos_i * a;
    let (s, p) = (modulus2 + Vec3A::splat(cos2), cos2 * modulus2 + Vec3A::splat(sin2 * sin2));
    // ½·Rs·(1 + Rp/Rs) with Rs = (s−c)/(s+c) and Rp/Rs = (p−c·sin²)/(p+c·sin²), one division.
    let reflected = (s - cross) * p / ((s + cross) * (p + cross * sin2));
    // max: where a metal reflects nothing, rounding may leave −1e-8.
    reflected.max(Vec3A::ZERO).into()
}
