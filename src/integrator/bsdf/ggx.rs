//! The anisotropic GGX (Trowbridge–Reitz) distribution of microfacet normals, its Smith masking,
//! and sampling of visible normals. Invariant: all functions are even in w and in m, finite, and
//! need no division by a macroscopic cosine. Never knows what the facets are made of.
//!
//! With s(w) = √(αx²x² + αy²y² + z²), Smith's functions for GGX become
//! G1(w) = 2|z| / (|z| + s) and, height-correlated, G2(o, i) = 2|zo||zi| / (so|zi| + si|zo|),
//! so the cosines in the microfacet denominators cancel (pbrt 4th ed., §9.6; Heitz 2014).

use crate::math::warp::sin_cos_turns;
use crate::math::{INV_PI, Vec2, Vec3, safe_sqrt, sqr};
use crate::scene::Roughness;

/// A distribution of microfacet normals by its two widths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ggx {
    alpha_x: f32,
    alpha_y: f32,
}

/// A rough surface's smaller α is raised to this (pbrt-v4): below it single precision cannot
/// resolve the lobe.
const MIN_ALPHA: f32 = 1e-4;

impl Ggx {
    /// From α along x and y of the shading frame.
    #[inline]
    #[must_use]
    pub fn new(alpha_x: f32, alpha_y: f32) -> Self {
        if alpha_x.max(alpha_y) < Roughness::SMOOTH_BELOW {
            return Self { alpha_x, alpha_y };
        }
        Self { alpha_x: alpha_x.max(MIN_ALPHA), alpha_y: alpha_y.max(MIN_ALPHA) }
    }

    /// Whether the surface counts as a perfect mirror.
    #[inline(always)]
    #[must_use]
    pub fn is_smooth(&self) -> bool {
        self.alpha_x.max(self.alpha_y) < Roughness::SMOOTH_BELOW
    }

    /// Density of normals D(m) for a unit `m` [1/sr]: 1 / (π αx αy (x²/αx² + y²/αy² + z²)²).
    #[inline(always)]
    #[must_use]
    pub fn d(&self, m: Vec3) -> f32 {
        self.d_scaled(m, 1.0)
    }

    /// D of the direction of `h`, given 1/|h|².
    #[inline(always)]
    pub(super) fn d_scaled(&self, h: Vec3, inv_length2: f32) -> f32 {
        let a = self.alpha_x * self.alpha_y;
        let e = sqr(h.x * self.alpha_y) + sqr(h.y * self.alpha_x) + sqr(h.z * a);
        INV_PI * a * a * a / sqr(e * inv_length2)
    }

    /// s(w), the length of `w` stretched to the unit-roughness configuration.
    #[inline(always)]
    pub(super) fn stretch(&self, w: Vec3) -> f32 {
        (sqr(w.x * self.alpha_x) + sqr(w.y * self.alpha_y) + sqr(w.z)).sqrt()
    }

    /// Smith masking G1(w).
    #[inline(always)]
    #[must_use]
    pub fn g1(&self, w: Vec3) -> f32 {
        let z = w.z.abs();
        2.0 * z / (z + self.stretch(w))
    }

    /// A unit normal visible from `wo` (z > 0), density G1(o)·(o·m)₊·D(m)/zo [1/sr]; `None` at
    /// the one point where it is undefined. Dupuy and Benyoub 2023: a spherical cap, shifted by
    /// the stretched direction, is uniform on the visible half of the sphere.
    #[inline(always)]
    #[must_use]
    pub fn sample_visible(&self, wo: Vec3, u: Vec2) -> Option<Vec3> {
        self.sample_visible_from(wo, self.stretch(wo), u)
    }

    /// The same, given s(wo).
    #[inline(always)]
    pub(super) fn sample_visible_from(&self, wo: Vec3, stretch: f32, u: Vec2) -> Option<Vec3> {
        let w = Vec3::new(wo.x * self.alpha_x, wo.y * self.alpha_y, wo.z) * (1.0 / stretch);
        // The cap's z plus w.z, before their cancellation.
        let hz = (1.0 - u.y) * (1.0 + w.z);
        let r = safe_sqrt(1.0 - sqr(hz - w.z));
        let (s, c) = sin_cos_turns(u.x);
        let m = Vec3::new((r * c + w.x) * self.alpha_x, (r * s + w.y) * self.alpha_y, hz);
        let l2 = m.length_squared();
        // Also false for NaN. The bound only keeps 1/l² in range.
        (l2 > 1e-30).then(|| m * (1.0 / l2.sqrt()))
    }
}
