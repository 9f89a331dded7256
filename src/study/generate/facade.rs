//! Paints a building's strip: walls with bricks, plaster, panels or mullions, windows lit or dark,
//! frames, dirt, and its roof. Invariant: a row needs nothing of other rows. Never decides where
//! windows are: [`Building`] does.

use super::building::{Building, FRAME, Opening, Style, brick};
use super::ground::byte;
use super::image_out::{TextureFormat, write_texture};
use super::noise::{Random, add_row, blend, hash, smoothstep, unit};
use crate::error::Result;
use std::path::Path;

const BRICKS: [[f32; 3]; 5] = [
    [150.0, 78.0, 58.0],
    [126.0, 62.0, 50.0],
    [170.0, 112.0, 78.0],
    [116.0, 84.0, 70.0],
    [178.0, 142.0, 108.0],
];
const PLASTERS: [[f32; 3]; 6] = [
    [222.0, 208.0, 178.0],
    [206.0, 188.0, 152.0],
    [200.0, 170.0, 146.0],
    [226.0, 218.0, 206.0],
    [178.0, 186.0, 178.0],
    [196.0, 164.0, 140.0],
];
const PANELS: [[f32; 3]; 4] =
    [[172.0, 166.0, 156.0], [150.0, 146.0, 142.0], [190.0, 178.0, 158.0], [136.0, 128.0, 122.0]];
const MULLIONS: [[f32; 3]; 4] =
    [[92.0, 98.0, 104.0], [62.0, 66.0, 72.0], [142.0, 146.0, 150.0], [96.0, 82.0, 66.0]];
const GLASS: [[f32; 3]; 4] = [[34.0, 46.0, 58.0], [30.0, 50.0, 54.0], [44.0, 46.0, 50.0], [52.0, 44.0, 36.0]];
const FRAMES: [[f32; 3]; 4] =
    [[226.0, 224.0, 216.0], [54.0, 50.0, 48.0], [104.0, 74.0, 50.0], [70.0, 84.0, 78.0]];

struct Paint<'a> {
    b: &'a Building,
    wall: [f32; 3],
    glass: [f32; 3],
    frame: [f32; 3],
    xs: Vec<f32>,
    /// Metres of a texel.
    texel: [f32; 2],
    fine: Vec<f32>,
    broad: Vec<f32>,
    streak: Vec<f32>,
}

/// Writes the texture of `b`, `size` texels.
pub(super) fn write(b: &Building, size: (u32, u32), path: &Path, format: TextureFormat) -> Result<()> {
    let mut r = Random::new(b.seed, 3);
    let wall = match b.style {
        Style::Brick => r.pick(&BRICKS),
        Style::Plaster => r.pick(&PLASTERS),
        Style::Panel => r.pick(&PANELS),
        Style::Curtain => r.pick(&MULLIONS),
    };
    let tint = r.range(0.88, 1.1);
    let (glass, frame) = (r.pick(&GLASS), r.pick(&FRAMES));
    let strip = b.strip();
    let texel = [strip[0] / size.0 as f32, strip[1] / size.1 as f32];
    let n = size.0 as usize;
    let mut paint = Paint {
        b,
        wall: wall.map(|c| (c * tint).min(240.0)),
        glass,
        frame: if b.style == Style::Curtain { wall } else { frame },
        xs: (0..size.0).map(|i| (i as f32 + 0.5) * texel[0]).collect(),
        texel,
        fine: vec![0.0; n],
        broad: vec![0.0; n],
        streak: vec![0.0; n],
    };
    write_texture(path, format, size, |y, out| {
        paint.row((size.1 - 1 - y) as f32 * texel[1] + 0.5 * texel[1], out)
    })
}

impl Paint<'_> {
    /// The row at `t` metres of the strip.
    fn row(&mut self, t: f32, out: &mut [u8]) {
        let at = (t, self.texel[1]);
        let seed = self.b.seed;
        for field in [&mut self.fine, &mut self.broad, &mut self.streak] {
            field.fill(0.0);
        }
        add_row(seed ^ 0x1, 60.0, &self.xs, at, 0.55, &mut self.fine);
        add_row(seed ^ 0x2, 7.0, &self.xs, at, 0.45, &mut self.fine);
        add_row(seed ^ 0x3, 0.3, &self.xs, at, 0.6, &mut self.broad);
        add_row(seed ^ 0x4, 1.3, &self.xs, at, 0.4, &mut self.broad);
        // Drawn out downwards.
        add_row(seed ^ 0x5, 5.0, &self.xs, (t * 0.06, self.texel[1] * 0.06), 0.7, &mut self.streak);
        add_row(seed ^ 0x6, 19.0, &self.xs, (t * 0.04, self.texel[1] * 0.04), 0.3, &mut self.streak);
        if t >= self.b.roof_start() {
            return self.roof(t - self.b.roof_start(), out);
        }
        let tier = (0..self.b.tier_count).rev().find(|&k| t >= self.b.tiers[k].base).unwrap_or(0);
        let z = t - self.b.tiers[tier].base;
        let height = self.b.wall_height(tier);
        let grime = 0.30 * smoothstep(1.6, 0.0, t) + 0.22 * smoothstep(height - 2.2, height, z);
        self.wall(0..self.xs.len(), t, grime, 0.0, out);
        if z >= height {
            return;
        }
        let floors = self.b.tiers[tier].floors;
        let k = (0..floors).rev().find(|&k| z >= self.b.floor_at(tier, k).0).unwrap_or(0);
        let z = z - self.b.floor_at(tier, k).0;
        for side in self.b.sides(tier) {
            let bay = side.length / side.bays as f32;
            let o = self.b.opening(tier, k, bay);
            for n in 0..side.bays {
                let s = side.start + bay * n as f32;
                if z < o.t[0] {
                    // Rain carries dirt from the sill down the wall.
                    let below = o.t[0] - z;
                    if o.sill && below < 1.4 {
                        let dirt = 0.34 * smoothstep(1.4, 0.0, below);
                        self.wall(self.texels(s + o.s[0], s + o.s[1]), t, grime, dirt, out);
                    }
                } else if z < o.t[1] {
                    let h = hash(
                        seed ^ 0x99,
                        (tier as i32) << 14 | k as i32,
                        (side.start * 4.0) as i32 ^ (n as i32) << 9,
                    );
                    self.window(s, z, &o, h, k == 0 && tier == 0, out);
                } else if k == 0 && tier == 0 && z > o.t[1] + 0.12 && z < o.t[1] + 0.75 {
                    self.sign(s, bay, side.start, n, out);
                }
            }
        }
    }

    fn texels(&self, a: f32, b: f32) -> std::ops::Range<usize> {
        let at = |s: f32| ((s / self.texel[0] + 0.5).max(0.0) as usize).min(self.xs.len());
        at(a)..at(b)
    }

    fn wall(&self, range: std::ops::Range<usize>, t: f32, grime: f32, dirt: f32, out: &mut [u8]) {
        let seed = self.b.seed;
        let bricks = self.b.style == Style::Brick && t > self.b.ground_floor;
        let crisp = smoothstep(0.05, 0.02, self.texel[0].max(self.texel[1]));
        let row = brick(0.0, t)[0];
        let course = row.floor() as i32;
        let flat = row - row.floor();
        let joint = if bricks && !(0.08..0.92).contains(&flat) { crisp } else { 0.0 };
        let blocks = self.b.style == Style::Panel
            || !bricks && t < self.b.ground_floor && self.b.style != Style::Curtain;
        let block_row = (t / 0.9).floor();
        let block_joint = blocks && t / 0.9 - block_row < 0.03;
        for i in range {
            let x = self.xs[i];
            let (f, b) = (self.fine[i], self.broad[i]);
            let mut c = self.wall;
            let mut tone = 1.0 + 0.10 * b + 0.09 * f;
            if bricks {
                let place = brick(x, t)[1];
                let column = place.floor();
                let own = unit(hash(seed, column as i32, course)) - 0.5;
                tone *= 1.0 + 0.38 * own * (0.35 + 0.65 * crisp);
                let edge = place - column;
                if joint > 0.0 || crisp > 0.0 && !(0.03..0.97).contains(&edge) {
                    c = blend(c, [168.0, 158.0, 144.0], 0.8 * crisp);
                }
            } else if blocks {
                let column = (x / 1.4).floor();
                tone *= 1.0 + 0.06 * (unit(hash(seed ^ 8, column as i32, block_row as i32)) - 0.5);
                if block_joint || x / 1.4 - column < 0.02 {
                    tone *= 0.72;
                }
            }
            let s = self.streak[i].max(0.0);
            tone *= 1.0 - grime * (0.6 + 0.5 * b) - (dirt + 0.10) * s * 1.3;
            paint(out, i, c.map(|c| c * tone));
        }
    }

    fn window(&self, s: f32, z: f32, o: &Opening, h: u32, shop: bool, out: &mut [u8]) {
        let (wide, tall) = (o.s[1] - o.s[0], o.t[1] - o.t[0]);
        let (kind, depth) = (unit(h), unit(h.rotate_left(11)));
        let v = (z - o.t[0]) / tall;
        let door = shop && unit(h.rotate_left(5)) < 0.22;
        let border = z - o.t[0] < FRAME
            || o.t[1] - z < FRAME
            || !shop && self.b.style != Style::Curtain && (v - 0.66).abs() * tall < 0.025;
        let range = self.texels(s + o.s[0], s + o.s[1]);
        let pane = wide / (o.bars + 1) as f32;
        let blind = 1.0 - 0.75 * depth;
        let slat = 0.86 + 0.14 * smoothstep(0.2, 0.8, (z * 16.0).fract());
        for i in range {
            let x = self.xs[i] - s - o.s[0];
            let (f, b) = (self.fine[i], self.broad[i]);
            let bar = (x / pane + 0.5).floor() * pane;
            if border || x < FRAME || wide - x < FRAME || (x - bar).abs() < FRAME * 0.5 {
                paint(out, i, self.frame.map(|c| c * (1.0 + 0.08 * f)));
                continue;
            }
            let mut c = self.glass.map(|c| c * (0.75 + 0.4 * v + 0.15 * b));
            if door && (x / pane) < 1.0 {
                c = blend(self.frame, [90.0, 58.0, 38.0], 0.6).map(|c| c * (0.9 + 0.1 * f));
            } else if kind < if shop { 0.45 } else { 0.10 } {
                // Lit inside, brighter above.
                let glow = 0.55 + 0.45 * v + 0.25 * b;
                c = [238.0 * glow, 190.0 * glow, 118.0 * glow];
            } else if kind < 0.34 && v > blind {
                c = [176.0 * slat, 170.0 * slat, 156.0 * slat];
            } else if kind < 0.46 && !shop {
                // Curtains to both sides.
                let fold = 0.8 + 0.2 * (self.streak[i] * 3.0).clamp(-1.0, 1.0);
                let side = (x / wide - 0.5).abs();
                if side > 0.20 + 0.16 * depth {
                    c = [150.0 * fold, 138.0 * fold, 124.0 * fold];
                }
            }
            paint(out, i, c);
        }
    }

    /// A board above a shop, one colour for a few bays.
    fn sign(&self, s: f32, bay: f32, start: f32, n: u32, out: &mut [u8]) {
        let h = hash(self.b.seed ^ 0x3c, (start * 4.0) as i32, (n / 3) as i32);
        if unit(h) < 0.35 {
            return;
        }
        let channel = |k: u32| 30.0 + 150.0 * unit(h.rotate_left(7 * k + 3));
        let c = [channel(1), channel(2) * 0.8, channel(3) * 0.8];
        for i in self.texels(s, s + bay) {
            paint(out, i, c.map(|c| c * (1.0 + 0.1 * self.fine[i] + 0.1 * self.broad[i])));
        }
    }

    fn roof(&self, y: f32, out: &mut [u8]) {
        let [x0, _, x1, _] = self.b.tiers[0].area;
        let flat = self.texels(0.0, x1 - x0);
        let tar =
            if unit(hash(self.b.seed, 4, 4)) < 0.5 { [108.0, 102.0, 96.0] } else { [146.0, 140.0, 130.0] };
        let seam = (y / 3.0).fract() < 0.02;
        for i in flat.clone() {
            let tone = 1.0 + 0.22 * self.broad[i] + 0.20 * self.fine[i] - if seam { 0.2 } else { 0.0 };
            paint(out, i, tar.map(|c| c * tone));
        }
        for i in flat.end..self.xs.len() {
            let rib = 0.92 + 0.08 * ((self.xs[i] * 3.0).fract() * 4.0).min(1.0);
            let tone =
                rib * (1.0 + 0.10 * self.broad[i] + 0.06 * self.fine[i] - 0.2 * self.streak[i].max(0.0));
            paint(out, i, [160.0 * tone, 160.0 * tone, 156.0 * tone]);
        }
    }
}

#[inline]
fn paint(out: &mut [u8], i: usize, c: [f32; 3]) {
    let texel = &mut out[3 * i..3 * i + 3];
    (0..3).for_each(|k| texel[k] = byte(c[k].clamp(0.0, 255.0)));
}
