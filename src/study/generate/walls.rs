//! A building's walls, ledges, windows and roofs as grids. Invariant: what a part has of triangles
//! depends on the building and the size of cells alone. Never decides where a window is.

use super::building::{Building, FRAME, PARAPET, Part, Side, Style, brick};
use super::mesh_out::{Mesh, Vertex};
use super::noise::{Random, hash, smoothstep, unit, value};

/// A building being described.
pub(super) struct Draw<'a> {
    pub(super) b: &'a Building,
    pub(super) cell: f32,
    pub(super) strip: [f32; 2],
}

impl Draw<'_> {
    fn uv(&self, s: f32, t: f32) -> [f32; 2] {
        [s / self.strip[0], t / self.strip[1]]
    }

    fn at(&self, side: &Side, s: f32, z: f32, out: f32) -> Vertex {
        let p = |k: usize| side.origin[k] + side.along[k] * s + side.out[k] * out;
        Vertex { p: [p(0), p(1), z], n: [0.0; 3], uv: self.uv(side.start + s, z) }
    }

    /// Part of a wall, uneven where cells are fine enough to show it.
    pub(super) fn panel(&self, mesh: &mut Mesh, side: &Side, s: [f32; 2], z: [f32; 2], out: f32) {
        let cells = |length: f32| ((length / self.cell).round() as u32).clamp(1, 4096);
        let (nu, nv) = (cells(s[1] - s[0]), cells(z[1] - z[0]));
        mesh.grid(nu, nv, |i, j| {
            let ss = s[0] + (s[1] - s[0]) * (i as f32 / nu as f32);
            let zz = z[0] + (z[1] - z[0]) * (j as f32 / nv as f32);
            // Even at the edges, where panels meet.
            let inner = i > 0 && j > 0 && i < nu && j < nv;
            let relief = if inner { self.relief(side.start + ss, zz) } else { 0.0 };
            self.at(side, ss, zz, out + relief)
        });
    }

    fn relief(&self, s: f32, z: f32) -> f32 {
        let uneven = 0.008 * value(self.b.seed, f64::from(s) * 2.5, f64::from(z) * 2.5);
        if self.b.style != Style::Brick {
            return uneven;
        }
        let [row, x] = brick(s, z);
        let (fx, fz) = (x - x.floor(), row - row.floor());
        let face = smoothstep(0.0, 0.05, fx.min(1.0 - fx)) * smoothstep(0.0, 0.14, fz.min(1.0 - fz));
        uneven + 0.006 * face * (0.7 + 0.6 * unit(hash(self.b.seed, x.floor() as i32, row.floor() as i32)))
    }

    /// A box on a wall without its back: five quads.
    fn ledge(&self, mesh: &mut Mesh, side: &Side, s: [f32; 2], z: [f32; 2], out: [f32; 2]) {
        let v = |s: f32, z: f32, o: f32| self.at(side, s, z, o);
        let ([a, b], [c, d], [o, p]) = (s, z, out);
        mesh.quad([v(a, c, p), v(b, c, p), v(b, d, p), v(a, d, p)]);
        mesh.quad([v(a, d, p), v(b, d, p), v(b, d, o), v(a, d, o)]);
        mesh.quad([v(a, c, o), v(b, c, o), v(b, c, p), v(a, c, p)]);
        mesh.quad([v(a, c, o), v(a, c, p), v(a, d, p), v(a, d, o)]);
        mesh.quad([v(b, c, p), v(b, c, o), v(b, d, o), v(b, d, p)]);
    }

    pub(super) fn wall(&self, mesh: &mut Mesh, tier: usize, side: &Side, part: Part) {
        let bay = side.length / side.bays as f32;
        let base = self.b.tiers[tier].base;
        for k in 0..self.b.tiers[tier].floors {
            let (z, height) = self.b.floor_at(tier, k);
            let z = base + z;
            let o = self.b.opening(tier, k, bay);
            for n in 0..side.bays {
                let s = bay * n as f32;
                let (a, b, c, d) = (s + o.s[0], s + o.s[1], z + o.t[0], z + o.t[1]);
                if part == Part::Glass {
                    // Panes lean a little, each its own way: reflections break from window to window.
                    let h = hash(
                        self.b.seed ^ 0x77,
                        (tier as i32) << 12 | k as i32,
                        (side.start * 8.0) as i32 + n as i32 * 977,
                    );
                    let lean = [(unit(h) - 0.5) * 0.016, (unit(h.rotate_left(13)) - 0.5) * 0.016];
                    let v = |s: f32, z: f32, i: f32, j: f32| {
                        self.at(side, s, z, -o.depth + lean[0] * i + lean[1] * j)
                    };
                    mesh.quad([
                        v(a, c, -0.5, -0.5),
                        v(b, c, 0.5, -0.5),
                        v(b, d, 0.5, 0.5),
                        v(a, d, -0.5, 0.5),
                    ]);
                    continue;
                }
                self.panel(mesh, side, [s, s + bay], [z, c], 0.0);
                self.panel(mesh, side, [s, s + bay], [d, z + height], 0.0);
                self.panel(mesh, side, [s, a], [c, d], 0.0);
                self.panel(mesh, side, [b, s + bay], [c, d], 0.0);
                self.reveal(mesh, side, [a, b], [c, d], o.depth);
                if o.sill {
                    self.ledge(mesh, side, [a - 0.08, b + 0.08], [c - 0.1, c], [0.0, 0.1]);
                }
                let width = (b - a) / (o.bars + 1) as f32;
                for bar in 1..=o.bars {
                    let m = a + width * bar as f32;
                    self.ledge(
                        mesh,
                        side,
                        [m - FRAME * 0.5, m + FRAME * 0.5],
                        [c, d],
                        [-o.depth, -o.depth + 0.05],
                    );
                }
            }
            // A band between floors.
            let (reach, low) = match self.b.style {
                Style::Brick => (0.04, -0.1),
                Style::Plaster => (0.06, -0.12),
                Style::Panel => (0.03, -0.05),
                Style::Curtain => (0.05, -0.04),
            };
            let strong = if k == 0 && tier == 0 { 4.0 } else { 1.0 };
            if part == Part::Walls {
                let top = z + height;
                self.ledge(mesh, side, [0.0, side.length], [top + low, top + 0.04], [0.0, reach * strong]);
            }
        }
        if part == Part::Walls && self.b.style == Style::Curtain {
            let [c, d] = [base, base + self.b.wall_height(tier)];
            for n in 0..=side.bays {
                let m = (bay * n as f32).clamp(0.04, side.length - 0.04);
                self.ledge(mesh, side, [m - 0.035, m + 0.035], [c, d], [0.0, 0.12]);
            }
        }
    }

    /// The four faces between a wall and its window.
    fn reveal(&self, mesh: &mut Mesh, side: &Side, [a, b]: [f32; 2], [c, d]: [f32; 2], depth: f32) {
        let v = |s: f32, z: f32, o: f32, ds: f32, dz: f32| {
            let mut v = self.at(side, s, z, o);
            // The wall's colour, not the window's.
            v.uv = self.uv(side.start + s + ds, z + dz);
            v
        };
        let e = 0.03;
        mesh.quad([
            v(a, c, 0.0, -e, 0.0),
            v(a, c, -depth, -e, 0.0),
            v(a, d, -depth, -e, 0.0),
            v(a, d, 0.0, -e, 0.0),
        ]);
        mesh.quad([
            v(b, c, -depth, e, 0.0),
            v(b, c, 0.0, e, 0.0),
            v(b, d, 0.0, e, 0.0),
            v(b, d, -depth, e, 0.0),
        ]);
        mesh.quad([
            v(a, c, 0.0, 0.0, -e),
            v(b, c, 0.0, 0.0, -e),
            v(b, c, -depth, 0.0, -e),
            v(a, c, -depth, 0.0, -e),
        ]);
        mesh.quad([
            v(a, d, -depth, 0.0, e),
            v(b, d, -depth, 0.0, e),
            v(b, d, 0.0, 0.0, e),
            v(a, d, 0.0, 0.0, e),
        ]);
    }

    /// Cornice and parapet at the top of a wall.
    pub(super) fn crown(&self, mesh: &mut Mesh, side: &Side, z: f32, full: bool) {
        let reach = match self.b.style {
            Style::Plaster | Style::Brick => 0.35,
            Style::Panel => 0.12,
            Style::Curtain => 0.06,
        };
        self.panel(mesh, side, [0.0, side.length], [z, z + PARAPET], 0.0);
        let inner = |s: f32, zz: f32| self.at(side, s, zz, -0.3);
        let (l, top) = (side.length, z + PARAPET);
        mesh.quad([inner(l, z), inner(0.0, z), inner(0.0, top), inner(l, top)]);
        mesh.quad([self.at(side, 0.0, top, 0.0), self.at(side, l, top, 0.0), inner(l, top), inner(0.0, top)]);
        if full {
            self.ledge(mesh, side, [-reach, l + reach], [z - 0.3, z + 0.05], [0.0, reach]);
            self.ledge(mesh, side, [-reach * 0.5, l + reach * 0.5], [z - 0.6, z - 0.3], [0.0, reach * 0.5]);
        }
    }

    pub(super) fn roof(&self, mesh: &mut Mesh, tier: usize, full: bool) {
        let [x0, y0, x1, y1] = self.b.tiers[tier].area;
        let z = self.b.tiers[tier].base + self.b.wall_height(tier) + 0.02;
        let start = self.b.roof_start();
        let [bx, by] = [self.b.tiers[0].area[0], self.b.tiers[0].area[1]];
        let v = |x: f32, y: f32, z: f32| Vertex {
            p: [x, y, z],
            n: [0.0; 3],
            uv: self.uv(x - bx, start + y - by),
        };
        let cells = |length: f32| ((length / self.cell).round() as u32).clamp(1, 4096);
        let (nu, nv) = (cells(x1 - x0), cells(y1 - y0));
        mesh.grid(nu, nv, |i, j| {
            let (x, y) = (x0 + (x1 - x0) * (i as f32 / nu as f32), y0 + (y1 - y0) * (j as f32 / nv as f32));
            v(x, y, z + 0.03 * value(self.b.seed ^ 5, f64::from(x), f64::from(y)))
        });
        if !full || tier + 1 < self.b.tier_count {
            return;
        }
        // Stairs, lifts and machines.
        let mut r = Random::new(self.b.seed, 2);
        let (w, d) = (x1 - x0, y1 - y0);
        let count = 3 + (w * d / 45.0 * r.range(0.4, 1.3)) as u32;
        for k in 0..count.min(40) {
            let large = k == 0;
            let size = |r: &mut Random| if large { r.range(3.0, 5.5) } else { r.range(0.8, 2.2) };
            let (a, b) = (size(&mut r).min(w * 0.4), size(&mut r).min(d * 0.4));
            let tall = if large { r.range(2.4, 4.2) } else { r.range(0.6, 1.6) };
            let (x, y) = (r.range(x0 + 0.8, x1 - a - 0.8), r.range(y0 + 0.8, y1 - b - 0.8));
            let top = |i: u32, j: u32| v(x + a * i as f32, y + b * j as f32, z + tall);
            mesh.grid(1, 1, top);
            let around = [[x, y], [x + a, y], [x + a, y + b], [x, y + b], [x, y]];
            let (u0, t0) = (self.strip[0] * 0.62 + k as f32, start + 0.5);
            mesh.grid(4, 1, |i, j| {
                let [px, py] = around[i as usize];
                Vertex {
                    p: [px, py, z + tall * j as f32],
                    n: [0.0; 3],
                    uv: self.uv(u0 + i as f32 * 0.5, t0 + tall * j as f32),
                }
            });
        }
    }
}
