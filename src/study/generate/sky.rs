//! A clear evening sky with thin clouds as a light, and its low sun. Invariant: radiance is below 1.6
//! away from the sun, so that a film exposed for the ground keeps the sky. Never contains the sun's
//! disc: the sun is a distant light.

use super::image_out::write_float_map;
use super::noise::{blend, fbm, normalized, smoothstep, turn};
use super::{Job, Recipe, directory};
use std::io::{self, Write};
use std::path::Path;

/// Sun and sky of a scene.
#[derive(Clone, Copy)]
pub(super) struct Sky {
    /// Unit, towards the sun.
    pub(super) sun: [f32; 3],
    /// What a surface facing the sun receives.
    pub(super) irradiance: [f32; 3],
    /// Share of the sky that clouds take, 0 to 1.
    pub(super) cloud: f32,
    /// Factor of the sky's radiance.
    pub(super) scale: f32,
}

impl Sky {
    /// From the sun's azimuth in turns from +x towards +y, and its height (rise over run).
    pub(super) fn new(azimuth: f64, rise: f32, irradiance: [f32; 3], cloud: f32) -> Self {
        let [c, s] = turn(azimuth);
        Self { sun: normalized([c, s, rise]), irradiance, cloud, scale: 1.2 }
    }

    fn radiance(&self, seed: u32, d: [f32; 3]) -> [f32; 3] {
        let up = d[2].max(0.0);
        let mu = (d[0] * self.sun[0] + d[1] * self.sun[1] + d[2] * self.sun[2]).max(0.0);
        let low = (1.0 - up) * (1.0 - up);
        let haze = low * low * low;
        let sky = blend([0.09, 0.20, 0.50], [0.30, 0.45, 0.70], low);
        let sky = blend(sky, [0.66, 0.66, 0.66], haze * 0.85);
        let (mu2, mu8) = (mu * mu, mu * mu * mu * mu * mu * mu * mu * mu);
        let mu32 = mu8 * mu8 * mu8 * mu8;
        let warm = haze * (0.35 * mu2 + 0.5 * mu8) + 0.12 * mu8 + 0.35 * mu32;
        let mut colour = [sky[0] + 0.95 * warm, sky[1] + 0.55 * warm, sky[2] + 0.22 * warm];
        if d[2] > 0.0 {
            // Clouds on a plane that the horizon's curve brings down.
            let scale = 1.0 / (f64::from(d[2]) + 0.14);
            let (x, y) = (f64::from(d[0]) * scale, f64::from(d[1]) * scale);
            let shift = f64::from(fbm(seed ^ 0x51, 0.7 * x, 0.7 * y, 3));
            let n = fbm(seed ^ 0x52, 0.9 * x + 0.8 * shift, 1.7 * y - 0.6 * shift, 6);
            let edge = 0.42 - 0.5 * self.cloud;
            let cover = smoothstep(edge, edge + 0.42, n) * smoothstep(0.01, 0.16, d[2]);
            let lit = blend([0.80, 0.80, 0.86], [1.25, 1.02, 0.80], 0.25 + 0.75 * mu2);
            colour = blend(colour, lit, 0.8 * cover);
        } else {
            let ground = [0.16, 0.15, 0.14];
            colour = blend(colour, ground, smoothstep(0.0, -0.12, d[2]).clamp(0.0, 1.0));
        }
        colour
    }

    /// Writes the sky as a square image in pbrt's equal-area mapping, +z in the middle.
    fn write(&self, seed: u32, side: u32, path: &Path) -> crate::error::Result<()> {
        write_float_map(path, (side, side), |y, texels| {
            for (x, t) in texels.iter_mut().enumerate() {
                let at = |k: u32| (f64::from(k) + 0.5) / f64::from(side);
                *t = self.radiance(seed, direction(at(x as u32), at(y)));
            }
        })
    }

    /// The file, its size by what textures the scene has.
    pub(super) fn job(self, recipe: &Recipe) -> Job {
        let side = match recipe.texture_bytes {
            0..=9_999_999 => 128,
            10_000_000..=199_999_999 => 512,
            _ => 1536,
        };
        let seed = recipe.hash_seed();
        let name = format!("{}/sky.pfm", directory::TEXTURES);
        Job::new(name, u64::from(side) * u64::from(side) * 12, move |path| self.write(seed, side, path))
    }

    /// Both lights.
    pub(super) fn write_text(&self, out: &mut dyn Write) -> io::Result<()> {
        let [x, y, z] = self.sun;
        let [r, g, b] = self.irradiance;
        writeln!(
            out,
            "LightSource \"infinite\" \"string filename\" \"{}/sky.pfm\" \"float scale\" {}",
            directory::TEXTURES,
            self.scale
        )?;
        writeln!(
            out,
            "LightSource \"distant\" \"rgb L\" [ {r} {g} {b} ] \"point3 from\" [ {x} {y} {z} ] \
             \"point3 to\" [ 0 0 0 ]"
        )
    }
}

/// The direction of a point of the unit square (Clarberg 2008, as pbrt-v4 lays it out).
fn direction(x: f64, y: f64) -> [f32; 3] {
    let (u, v) = (2.0 * x - 1.0, 2.0 * y - 1.0);
    let (up, vp) = (u.abs(), v.abs());
    let inside = 1.0 - (up + vp);
    let r = 1.0 - inside.abs();
    let turns = if r == 0.0 { 0.125 } else { ((vp - up) / r + 1.0) * 0.125 };
    let z = (1.0 - r * r) * if inside < 0.0 { -1.0 } else { 1.0 };
    let around = r * (2.0 - r * r).max(0.0).sqrt();
    let [c, s] = turn(turns).map(f64::from);
    let signed = |value: f64, sign: f64| if sign < 0.0 { -value } else { value };
    [(around * signed(c, u)) as f32, (around * signed(s, v)) as f32, z as f32]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_of_length_one_and_cover_the_sphere_evenly() {
        let side = 64;
        let mut sum = [0.0f64; 3];
        for i in 0..side * side {
            let at = |k: i32| (f64::from(k) + 0.5) / f64::from(side);
            let d = direction(at(i % side), at(i / side)).map(f64::from);
            let length: f64 = d.iter().map(|c| c * c).sum();
            assert!((length - 1.0).abs() < 1e-6);
            (0..3).for_each(|k| sum[k] += d[k] * d[k]);
        }
        // Equal areas: each coordinate's mean square is a third.
        for s in sum {
            assert!((s / f64::from(side * side) - 1.0 / 3.0).abs() < 2e-3, "{sum:?}");
        }
    }
}
