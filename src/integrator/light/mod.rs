//! Choosing a light and a point or direction on it, with densities. Pure routines: no scene, no
//! rays, no allocation while sampling.
//!
//! Invariant of every shape here: `pdf` makes the choices `sample` made, from the geometry alone,
//! so that both agree to rounding and multiple importance sampling stays unbiased.

use glam::Vec3;

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

/// A density per area as one per solid angle: `pdf_area` d² / |cosθ|. `None` where the shape is
/// seen edge-on or touched, so that no ray could tell the point from its neighbours.
#[inline(always)]
fn per_solid_angle(pdf_area: f32, towards: Vec3, n: Vec3) -> Option<f32> {
    let d2 = towards.length_squared();
    // |cosθ| d, so that one division serves.
    let cos_d = n.dot(towards).abs();
    let pdf = pdf_area * d2 * d2.sqrt() / cos_d;
    (pdf > 0.0 && pdf.is_finite()).then_some(pdf)
}
