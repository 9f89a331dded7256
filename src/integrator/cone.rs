//! Ray cones: how wide a path is where it meets a surface, for texture footprints (Amanatides 1984;
//! Akenine-Möller et al. 2021, "Improved Shader and Texture Level of Detail Using Ray Cones").
//!
//! A cone has a signed width and a signed spread, so that it may narrow to a focus and widen behind
//! it; a footprint takes the absolute. Never decides what is sampled: it only says how far apart
//! neighbouring samples are.

use crate::geometry::FootprintEllipse;
use crate::math::Frame;
use bytemuck::{Pod, Zeroable};
use glam::Vec3A;

/// The cone about a ray.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Cone {
    /// Width where the last event was.
    pub width: f32,
    /// Growth of the width per unit of distance.
    pub spread: f32,
}

/// What happened to the ray, as far as its cone cares.
#[derive(Clone, Copy, Debug)]
pub struct Event {
    /// Mean curvature of the surface [1/length], positive where it bulges towards the ray.
    pub curvature: f32,
    /// Cosines of the ray's angles to the surface before and after, positive.
    pub cos_in: f32,
    /// After.
    pub cos_out: f32,
    /// Index of refraction behind the surface over that before it, if the ray went through.
    pub through: Option<f32>,
    /// Angle that one sample stands for where directions were drawn from a density; else 0.
    pub rough: f32,
}

/// Grazing rays see an ellipse no longer than this many widths: as long as the filters take them.
const MAX_STRETCH: f32 = 32.0;

impl Cone {
    /// Signed width after `distance`.
    #[inline(always)]
    #[must_use]
    pub fn width_at(self, distance: f32) -> f32 {
        self.width + self.spread * distance
    }

    /// The cone behind a surface that it meets after `distance`.
    #[inline(always)]
    #[must_use]
    pub fn after(self, distance: f32, event: &Event) -> Self {
        let width = self.width_at(distance);
        // How far the normal turns over the footprint: the geometric mean of its two axes.
        let turn = event.curvature * width;
        let spread = match event.through {
            // A mirror turns twice as far as its normal.
            None => self.spread + 2.0 * turn,
            // Snell's law by first differences. In the plane of incidence angles change by
            // cos θ₁/(η cos θ₂), across it by 1/η; again the geometric mean.
            Some(eta) => {
                let bend = (event.cos_in / event.cos_out.max(1.0 / MAX_STRETCH)).sqrt() / eta;
                self.spread * bend - turn * (1.0 - bend)
            }
        };
        if event.rough > spread.abs() {
            return Self { width: width.abs(), spread: event.rough };
        }
        Self { width, spread }
    }
}

/// Angle of the cone that holds 1/(`pdf` · n) of solid angle, where n samples share the density and
/// `scale` is 1/√n: Ω = π (α/2)².
#[inline(always)]
#[must_use]
pub fn sample_angle(pdf: f32, scale: f32) -> f32 {
    // π bounds what linear growth can stand for.
    (2.0 * scale / (std::f32::consts::PI * pdf).sqrt()).min(std::f32::consts::PI)
}

/// The ellipse that a cone of `width` about the unit direction `d` cuts from the plane with unit
/// normal `n`: its axes along the view and across it.
#[inline(always)]
#[must_use]
pub fn ellipse(width: f32, d: Vec3A, n: Vec3A) -> FootprintEllipse {
    let cos = d.dot(n);
    let mut along = d - n * cos;
    let mut length2 = along.length_squared();
    if length2 <= 1e-10 {
        (along, length2) = (Frame::from_z(n.into()).x.into(), 1.0);
    }
    let across = width.abs() / length2.sqrt();
    let stretched = across / cos.abs().max(1.0 / MAX_STRETCH);
    FootprintEllipse { n, along, scale: [stretched, across] }
}

#[cfg(test)]
mod tests;
