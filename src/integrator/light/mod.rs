//! Choosing a light and a point or direction on it, with densities. Pure routines: no scene, no
//! rays, no allocation while sampling.
//!
//! Invariant of every shape here: `pdf` makes the choices `sample` made, from the geometry alone,
//! so that both agree to rounding and multiple importance sampling stays unbiased.

use glam::{Vec3, Vec3A};

pub mod cylinder;
pub mod delta;
pub mod disk;
pub mod distribution;
pub mod env;
pub mod octahedral;
pub mod parallelogram;
pub mod patch;
mod placed;
pub mod select;
pub mod sphere;
pub mod tree;
mod tree_build;
pub mod triangle;

#[cfg(test)]
pub(crate) mod analytic;
#[cfg(test)]
mod bench;
#[cfg(test)]
mod testing;

/// A point chosen on an emitting shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapeSample {
    /// The point, world space.
    pub point: Vec3,
    /// Unit geometric normal there: by winding for triangles, outwards for closed shapes.
    pub n: Vec3,
    /// Density [1/sr] as seen from the point it was chosen for; positive and finite.
    pub pdf_solid_angle: f32,
    /// First surface parameter; each shape says which.
    pub b0: f32,
    /// Second surface parameter.
    pub b1: f32,
}

/// As [`ShapeSample`], its vectors in SIMD registers.
#[derive(Clone, Copy, Debug)]
pub(super) struct WideSample {
    pub(super) point: Vec3A,
    pub(super) n: Vec3A,
    pub(super) pdf_solid_angle: f32,
    pub(super) b0: f32,
    pub(super) b1: f32,
}

impl From<ShapeSample> for WideSample {
    #[inline(always)]
    fn from(s: ShapeSample) -> Self {
        let ShapeSample { point, n, pdf_solid_angle, b0, b1 } = s;
        Self { point: point.into(), n: n.into(), pdf_solid_angle, b0, b1 }
    }
}

impl From<WideSample> for ShapeSample {
    #[inline(always)]
    fn from(s: WideSample) -> Self {
        let WideSample { point, n, pdf_solid_angle, b0, b1 } = s;
        Self { point: point.into(), n: n.into(), pdf_solid_angle, b0, b1 }
    }
}

/// A density per area as one per solid angle: `pdf_area` d² / |cosθ|. `None` where the shape is
/// seen edge-on or touched, so that no ray could tell the point from its neighbours.
#[inline(always)]
fn per_solid_angle(pdf_area: f32, towards: Vec3, n: Vec3) -> Option<f32> {
    // |cosθ| d, so that one division serves.
    at_distance(pdf_area, towards.length_squared(), n.dot(towards).abs())
}

/// [`per_solid_angle`] from the squared distance and the distance times the cosine.
#[inline(always)]
fn at_distance(pdf_area: f32, d2: f32, cos_d: f32) -> Option<f32> {
    let pdf = pdf_area * d2 * d2.sqrt() / cos_d;
    // Two comparisons, which NaN fails; asked as `is_finite`, it becomes twenty instructions.
    (pdf > 0.0 && pdf < f32::INFINITY).then_some(pdf)
}
