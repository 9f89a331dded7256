//! Streets of the city: tiles from the middle of a street to the middle of the next, with asphalt,
//! markings, kerbs and pavement; and what stands on them. Invariant: tiles meet exactly. Never
//! decides where streets run.

use super::ground::byte;
use super::image_out::{TextureFormat, write_texture};
use super::mesh_out::{Mesh, Vertex};
use super::noise::{add_row, blend, hash, smoothstep, turn, unit, value};
use super::plant::tube;
use crate::error::Result;
use std::path::Path;

/// Height of the kerb.
pub(super) const KERB: f32 = 0.15;

/// A block and the halves of the streets around it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tile {
    pub(super) seed: u32,
    /// x0, y0, x1, y1: middles of streets.
    pub(super) area: [f32; 4],
    /// Kerbs.
    pub(super) block: [f32; 4],
    /// A park instead of buildings.
    pub(super) park: bool,
}

impl Tile {
    /// Describes the surface with cells of about `cell` metres.
    pub(super) fn build(&self, cell: f32, mesh: &mut Mesh) {
        let ([x0, y0, x1, y1], [a0, b0, a1, b1]) = (self.area, self.block);
        let cells = |length: f32| ((length / cell).round() as u32).clamp(1, 8192);
        let vertex = |x: f32, y: f32, z: f32| Vertex {
            p: [x, y, z],
            n: [0.0; 3],
            uv: [(x - x0) / (x1 - x0), (y - y0) / (y1 - y0)],
        };
        let mut sheet = |x: [f32; 2], y: [f32; 2], z: f32| {
            let (nu, nv) = (cells(x[1] - x[0]), cells(y[1] - y[0]));
            mesh.grid(nu, nv, |i, j| {
                let px = x[0] + (x[1] - x[0]) * (i as f32 / nu as f32);
                let py = y[0] + (y[1] - y[0]) * (j as f32 / nv as f32);
                let edge = i == 0 || j == 0 || i == nu || j == nv;
                let bump =
                    if edge { 0.0 } else { 0.012 * value(9, f64::from(px) * 1.5, f64::from(py) * 1.5) };
                vertex(px, py, z + bump)
            });
        };
        sheet([x0, x1], [y0, b0], 0.0);
        sheet([x0, x1], [b1, y1], 0.0);
        sheet([x0, a0], [b0, b1], 0.0);
        sheet([a1, x1], [b0, b1], 0.0);
        sheet([a0, a1], [b0, b1], KERB);
        let corners = [[a0, b0], [a1, b0], [a1, b1], [a0, b1], [a0, b0]];
        mesh.grid(4, 1, |i, j| {
            let [x, y] = corners[i as usize];
            vertex(x, y, KERB * j as f32)
        });
    }

    /// Writes its texture, `size` texels.
    pub(super) fn write_texture(&self, size: (u32, u32), path: &Path, format: TextureFormat) -> Result<()> {
        let [x0, y0, x1, y1] = self.area;
        let (dx, dy) = ((x1 - x0) / size.0 as f32, (y1 - y0) / size.1 as f32);
        let xs: Vec<f32> = (0..size.0).map(|i| x0 + (i as f32 + 0.5) * dx).collect();
        let n = xs.len();
        let (mut fine, mut broad) = (vec![0.0; n], vec![0.0; n]);
        write_texture(path, format, size, |row, out| {
            let y = y1 - (row as f32 + 0.5) * dy;
            fine.fill(0.0);
            broad.fill(0.0);
            add_row(0x11, 45.0, &xs, (y, dy), 0.6, &mut fine);
            add_row(0x12, 6.0, &xs, (y, dy), 0.4, &mut fine);
            add_row(0x13, 0.25, &xs, (y, dy), 0.6, &mut broad);
            add_row(0x14, 1.1, &xs, (y, dy), 0.4, &mut broad);
            for (i, texel) in out.chunks_exact_mut(3).enumerate() {
                let c = self.colour(xs[i], y, fine[i], broad[i]);
                (0..3).for_each(|k| texel[k] = byte(c[k].clamp(0.0, 255.0)));
            }
        })
    }

    fn colour(&self, x: f32, y: f32, fine: f32, broad: f32) -> [f32; 3] {
        let ([x0, y0, x1, y1], [a0, b0, a1, b1]) = (self.area, self.block);
        let inside = (x - a0).min(a1 - x).min(y - b0).min(b1 - y);
        if inside > 0.0 {
            if self.park && inside > 3.5 {
                let c = blend([74.0, 88.0, 40.0], [112.0, 106.0, 58.0], (0.5 + 0.7 * broad).clamp(0.0, 1.0));
                return c.map(|c| c * (1.0 + 0.3 * fine));
            }
            // Slabs.
            let (sx, sy) = ((x / 0.9).floor(), (y / 0.9).floor());
            let joint = x / 0.9 - sx < 0.03 || y / 0.9 - sy < 0.03;
            let own = unit(hash(self.seed, sx as i32, sy as i32)) - 0.5;
            let tone = (1.0 + 0.14 * own + 0.16 * broad + 0.10 * fine) * if joint { 0.75 } else { 1.0 };
            let base = if inside < 0.28 { [178.0, 174.0, 166.0] } else { [158.0, 150.0, 138.0] };
            return base.map(|c| c * tone);
        }
        let mut c = [84.0, 83.0, 84.0].map(|c| c * (1.0 + 0.16 * broad + 0.22 * fine));
        // Repairs, darker.
        let (px, py) = ((x / 7.0).floor(), (y / 4.0).floor());
        let h = hash(31, px as i32, py as i32);
        if unit(h) < 0.13 {
            let (fx, fy) = (x / 7.0 - px, y / 4.0 - py);
            if (0.15..0.5 + 0.4 * unit(h.rotate_left(8))).contains(&fx) && (0.2..0.8).contains(&fy) {
                c = c.map(|c| c * 0.78);
            }
        }
        let worn = (0.82 + 0.35 * fine + 0.2 * broad).clamp(0.0, 1.0);
        let white = [206.0, 204.0, 196.0];
        let (to_x, to_y) = ((x - x0).min(x1 - x), (y - y0).min(y1 - y));
        let (half_x, half_y) = (
            if x - x0 < x1 - x { a0 - x0 } else { x1 - a1 },
            if y - y0 < y1 - y { b0 - y0 } else { y1 - b1 },
        );
        let (in_y_street, in_x_street) = (to_x < half_x, to_y < half_y);
        let paint = match (in_y_street, in_x_street) {
            (true, true) => false,
            (true, false) => markings(to_x, half_x, y, (y - b0).min(b1 - y), x),
            _ => markings(to_y, half_y, x, (x - a0).min(a1 - x), y),
        };
        if paint {
            c = blend(c, white, worn);
        }
        // Oil where wheels do not run, dust at the kerb.
        let gutter = smoothstep(0.5, 0.0, -inside);
        blend(c, [112.0, 104.0, 92.0], 0.5 * gutter)
    }
}

/// Whether there is paint: `across` from the middle of a street of `half` width, `along` it, `before`
/// the crossing, `place` in world metres across.
fn markings(across: f32, half: f32, along: f32, before: f32, place: f32) -> bool {
    if before < 4.2 {
        // Zebra, and a line to stop at.
        return (0.6..3.4).contains(&before) && (place / 0.55).floor() as i32 & 1 == 0 && half - across > 0.4;
    }
    if before < 5.4 && before > 4.9 {
        return across < half - 0.5;
    }
    let dashed = (along / 3.0).floor() as i32 % 3 == 0;
    let lane = half / ((half / 3.3).floor().max(1.0));
    let in_lane = across / lane - (across / lane).floor();
    let line = 0.075 / lane;
    across < 0.30 && across > 0.12 && half > 9.0
        || half <= 9.0 && across < 0.08 && dashed
        || half > 9.0
            && across > lane * 0.5
            && half - across > lane * 0.5
            && dashed
            && (in_lane < line || in_lane > 1.0 - line)
}

/// A lamp: a post with an arm towards −y.
pub(super) fn lamp(mesh: &mut Mesh) {
    let post = [
        ([0.0, 0.0, 0.0], 0.11),
        ([0.0, 0.0, 1.0], 0.10),
        ([0.0, 0.0, 1.05], 0.065),
        ([0.0, 0.0, 7.6], 0.05),
    ];
    tube(mesh, &post, 10);
    tube(mesh, &[([0.0, 0.0, 7.5], 0.05), ([0.0, -0.9, 8.1], 0.045), ([0.0, -2.0, 8.2], 0.04)], 8);
    tube(
        mesh,
        &[
            ([0.0, -1.7, 8.2], 0.02),
            ([0.0, -1.72, 8.2], 0.13),
            ([0.0, -2.4, 8.18], 0.14),
            ([0.0, -2.42, 8.18], 0.01),
        ],
        10,
    );
}

/// Parts of a car.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum CarPart {
    Body,
    Glass,
    Wheels,
}

/// A car along +y, standing on z = 0.
pub(super) fn car(part: CarPart, mesh: &mut Mesh) {
    if part == CarPart::Wheels {
        for (x, y) in [(-0.78, -1.35), (0.78, -1.35), (-0.78, 1.35), (0.78, 1.35)] {
            let ring = |o: f32, r: f32| ([x + o, y, 0.33], r);
            tube(mesh, &[ring(-0.11, 0.02), ring(-0.11, 0.32), ring(0.11, 0.32), ring(0.11, 0.02)], 20);
        }
        return;
    }
    // Half width and height limits along the car, from behind to the front.
    let body: [(f32, f32, f32, f32); 8] = [
        (-2.15, 0.70, 0.45, 0.70),
        (-2.10, 0.82, 0.30, 0.88),
        (-1.6, 0.88, 0.24, 0.94),
        (-0.6, 0.89, 0.22, 0.92),
        (0.7, 0.89, 0.22, 0.90),
        (1.5, 0.86, 0.24, 0.80),
        (2.05, 0.78, 0.30, 0.68),
        (2.15, 0.66, 0.40, 0.58),
    ];
    let cabin: [(f32, f32, f32, f32); 5] = [
        (-1.75, 0.66, 0.90, 0.92),
        (-1.15, 0.64, 0.88, 1.38),
        (-0.1, 0.62, 0.88, 1.46),
        (0.45, 0.62, 0.88, 1.36),
        (1.15, 0.70, 0.86, 0.90),
    ];
    let mut loft = |rings: &[(f32, f32, f32, f32)]| {
        const AROUND: u32 = 16;
        mesh.grid(AROUND, rings.len() as u32 - 1, |i, j| {
            let (y, w, low, high) = rings[j as usize];
            let [c, s] = turn(f64::from(i) / f64::from(AROUND));
            // Between a circle and a square.
            let square = |t: f32| (t * 1.32).clamp(-1.0, 1.0);
            let z = 0.5 * (low + high) + 0.5 * (high - low) * square(s);
            Vertex { p: [w * square(c), y, z], n: [0.0; 3], uv: [0.5, 0.5] }
        });
    };
    match part {
        CarPart::Body => loft(&body),
        _ => loft(&cabin),
    }
}
