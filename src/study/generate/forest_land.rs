//! The forest's floor, and the colours of what grows on it. Invariant: the path passes the origin,
//! where the camera stands. Never places a plant.

use super::ground::{Land, Row, byte};
use super::image_out::{TextureFormat, write_texture};
use super::noise::{add_row, blend, fbm, gradient, hash, lerp, smoothstep, unit, value};
use super::plant::Species;
use crate::error::Result;
use std::path::Path;

/// Ground with a path along +y.
pub(super) struct Floor {
    pub(super) seed: u32,
}

impl Floor {
    /// Metres from the middle of the path.
    pub(super) fn off_path(&self, x: f64, y: f64) -> f32 {
        let bend = |y: f64| 5.0 * f64::from(gradient(self.seed ^ 0x11, y / 38.0, 0.37)[0]);
        // Straight through the origin.
        let free = f64::from(smoothstep(0.0, 26.0, y.abs() as f32));
        (x - free * bend(y)).abs() as f32
    }

    /// Height of the ground without stones and leaves.
    pub(super) fn level(&self, x: f64, y: f64) -> f32 {
        let hill = 26.0 * smoothstep(110.0, 420.0, y as f32) + 5.0 * smoothstep(6.0, 60.0, (x.abs()) as f32);
        let rough = 3.2 * fbm(self.seed ^ 0x21, x / 46.0, y / 46.0, 3);
        let bank = smoothstep(0.7, 3.2, self.off_path(x, y));
        hill + rough + bank * (0.28 + 0.75 * fbm(self.seed ^ 0x22, x / 7.0, y / 7.0, 4)) - 0.06
    }
}

impl Land for Floor {
    fn height(&self, x: f64, y: f64, finest: f32) -> [f32; 2] {
        let mut h = self.level(x, y);
        let path = smoothstep(1.5, 0.7, self.off_path(x, y));
        let mut stone = 0.0;
        if finest < 0.5 {
            // Clods and litter; on the path, ruts and pebbles.
            h += lerp(0.07, 0.025, path) * fbm(self.seed ^ 0x23, x / 0.45, y / 0.45, 4);
            let size = 0.16;
            let (cx, cy) = ((x / size).floor(), (y / size).floor());
            let k = hash(self.seed ^ 0x24, cx as i32, cy as i32);
            if unit(k) < 0.10 + 0.25 * path {
                let r = 0.14 + 0.3 * unit(k.rotate_left(7));
                let (dx, dy) = ((x / size - cx - 0.5) as f32, (y / size - cy - 0.5) as f32);
                let d = (dx * dx + dy * dy) / (r * r);
                if d < 1.0 {
                    stone = path;
                    h += (1.0 - d) * r * size as f32 * 0.7;
                }
            }
        }
        [h, stone]
    }

    fn colour(&self, row: &Row<'_>, out: &mut [u8]) {
        let n = row.xs.len();
        let at = (row.y, row.step);
        let (mut broad, mut fine) = (vec![0.0; n], vec![0.0; n]);
        add_row(self.seed ^ 0x31, 1.0 / 6.0, row.xs, at, 0.6, &mut broad);
        add_row(self.seed ^ 0x32, 1.0 / 1.3, row.xs, at, 0.4, &mut broad);
        add_row(self.seed ^ 0x33, 1.0 / 0.19, row.xs, at, 0.5, &mut fine);
        add_row(self.seed ^ 0x34, 1.0 / 0.02, row.xs, at, 0.5, &mut fine);
        let leaf_row = (row.y / 0.05).floor() as i32;
        // The path's middle moves slowly: once a row is enough.
        let middle = {
            let free = smoothstep(0.0, 26.0, row.y.abs());
            f64::from(free) * 5.0 * f64::from(gradient(self.seed ^ 0x11, f64::from(row.y) / 38.0, 0.37)[0])
        };
        for (i, texel) in out.chunks_exact_mut(3).enumerate() {
            let (b, f) = (broad[i], fine[i]);
            let off = (f64::from(row.xs[i]) - middle).abs() as f32;
            let path = smoothstep(1.5, 0.8, off + 0.5 * b);
            let moss = smoothstep(0.05, 0.4, b) * (1.0 - path);
            let mut c = blend([104.0, 82.0, 56.0], [78.0, 86.0, 40.0], moss);
            // Fallen leaves, each of a colour.
            let h = hash(self.seed ^ 0x35, (row.xs[i] / 0.06).floor() as i32, leaf_row);
            let leaf = unit(h);
            if leaf < 0.34 * (1.0 - 0.7 * moss) * (1.0 - 0.75 * path) {
                let warm = unit(h.rotate_left(9));
                c = blend([128.0, 88.0, 44.0], [158.0, 118.0, 50.0], warm);
            }
            c = blend(c, [114.0, 96.0, 76.0], path * 0.9);
            c = blend(c, [124.0, 118.0, 110.0], row.stone[i]);
            let tone = 1.0 + 0.16 * b + 0.34 * f;
            (0..3).for_each(|k| texel[k] = byte((c[k] * tone).clamp(0.0, 255.0)));
        }
    }
}

/// Writes bark: across the trunk and along it.
pub(super) fn write_bark(
    seed: u32,
    species: Species,
    (width, height): (u32, u32),
    path: &Path,
    format: TextureFormat,
) -> Result<()> {
    let xs: Vec<f32> = (0..width).map(|i| (i as f32 + 0.5) / width as f32).collect();
    let step = 2.0 / height as f32;
    let n = width as usize;
    let (mut furrow, mut fine) = (vec![0.0; n], vec![0.0; n]);
    write_texture(path, format, (width, height), |row, out| {
        let y = (row as f32 + 0.5) * step;
        furrow.fill(0.0);
        fine.fill(0.0);
        let birch = species == Species::Birch;
        // Furrows run up a trunk; a birch's marks run around it.
        let stretch = if birch { 40.0 } else { 4.0 };
        add_row(
            seed ^ 1,
            if birch { 3.0 } else { 22.0 },
            &xs,
            (y * stretch, step * stretch),
            0.7,
            &mut furrow,
        );
        add_row(
            seed ^ 2,
            if birch { 7.0 } else { 50.0 },
            &xs,
            (y * stretch, step * stretch),
            0.5,
            &mut furrow,
        );
        add_row(seed ^ 3, 160.0, &xs, (y, step), 0.5, &mut fine);
        add_row(seed ^ 4, 9.0, &xs, (y, step), 0.5, &mut fine);
        let (dark, light) = match species {
            Species::Birch => ([58.0, 50.0, 46.0], [222.0, 216.0, 204.0]),
            Species::Spruce => ([72.0, 54.0, 42.0], [132.0, 104.0, 82.0]),
            _ => ([62.0, 52.0, 42.0], [124.0, 110.0, 92.0]),
        };
        for (i, texel) in out.chunks_exact_mut(3).enumerate() {
            let ridge =
                if birch { smoothstep(-0.75, -0.45, furrow[i]) } else { smoothstep(-0.5, 0.5, furrow[i]) };
            let c = blend(dark, light, ridge).map(|c| c * (1.0 + 0.2 * fine[i]));
            (0..3).for_each(|k| texel[k] = byte(c[k].clamp(0.0, 255.0)));
        }
    })
}

/// Writes leaves: 8 × 8 of them, each of its own tint with its veins.
pub(super) fn write_leaves(
    seed: u32,
    (low, high): ([f32; 3], [f32; 3]),
    side: u32,
    path: &Path,
    format: TextureFormat,
) -> Result<()> {
    let xs: Vec<f32> = (0..side).map(|i| (i as f32 + 0.5) / side as f32).collect();
    let step = 1.0 / side as f32;
    let mut fine = vec![0.0; side as usize];
    write_texture(path, format, (side, side), |row, out| {
        let y = (row as f32 + 0.5) * step;
        fine.fill(0.0);
        add_row(seed ^ 5, 60.0, &xs, (y, step), 0.6, &mut fine);
        add_row(seed ^ 6, 400.0, &xs, (y, step), 0.4, &mut fine);
        let v = (y * 8.0).fract();
        for (i, texel) in out.chunks_exact_mut(3).enumerate() {
            let u = (xs[i] * 8.0).fract();
            let h = hash(seed ^ 7, (xs[i] * 8.0) as i32, (y * 8.0) as i32);
            let mut tone = (0.82 + 0.36 * unit(h.rotate_left(5))) * (1.0 + 0.16 * fine[i]);
            let side = (u - 0.5).abs();
            let vein = ((v + side * 0.8) * 7.0).fract();
            if side < 0.035 || vein < 0.12 {
                tone *= 1.14;
            }
            let c = blend(low, high, unit(h) * (0.7 + 0.6 * v)).map(|c| c * tone);
            (0..3).for_each(|k| texel[k] = byte(c[k].clamp(0.0, 255.0)));
        }
    })
}

/// How crowded plants stand, 0 to 1.
pub(super) fn crowd(seed: u32, x: f32, y: f32, size: f32) -> f32 {
    value(seed, f64::from(x / size), f64::from(y / size))
}
