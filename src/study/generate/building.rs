//! A building of the city: its size and style from a number, and its geometry. Walls stand in tiers;
//! a tier's wall unrolls to a strip, (s, t) in metres along the perimeter and upwards, which the
//! texture ([`super::facade`]) paints with the same openings. Invariant: geometry and texture ask the
//! same functions where a window is. Never writes a file.

use super::mesh_out::{Mesh, Vertex};
use super::noise::{Random, hash, smoothstep, unit, value};

/// What walls are made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Style {
    Brick,
    Plaster,
    Panel,
    Curtain,
}

/// A storey above each other tier, narrower by its inset.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tier {
    /// x0, y0, x1, y1 in metres.
    pub(super) area: [f32; 4],
    /// Where its wall begins, metres above ground; also its place in the unrolled strip.
    pub(super) base: f32,
    pub(super) floors: u32,
}

/// One wall of a tier, seen from outside from left to right.
#[derive(Clone, Copy)]
pub(super) struct Side {
    origin: [f32; 2],
    along: [f32; 2],
    out: [f32; 2],
    pub(super) length: f32,
    /// Where it begins on the perimeter.
    pub(super) start: f32,
    pub(super) bays: u32,
}

/// An opening in a bay, metres from the bay's left and from the floor.
#[derive(Clone, Copy)]
pub(super) struct Opening {
    pub(super) s: [f32; 2],
    pub(super) t: [f32; 2],
    pub(super) depth: f32,
    pub(super) sill: bool,
    /// Vertical bars.
    pub(super) bars: u32,
}

#[derive(Clone, Debug)]
pub(super) struct Building {
    pub(super) seed: u32,
    pub(super) style: Style,
    pub(super) tiers: [Tier; 3],
    pub(super) tier_count: usize,
    pub(super) ground_floor: f32,
    pub(super) floor: f32,
    bay: f32,
    window: [f32; 4],
    bars: u32,
}

/// Which of a building's two meshes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    Walls,
    Glass,
}

/// How finely walls are divided: `None` for plain boxes with painted windows, else metres of a cell.
pub(super) type Cell = Option<f32>;

const PARAPET: f32 = 0.9;
/// Width of frames and bars.
pub(super) const FRAME: f32 = 0.07;

impl Building {
    /// On the lot `area` with about `height` metres.
    pub(super) fn new(seed: u32, area: [f32; 4], height: f32) -> Self {
        let mut r = Random::new(seed, 1);
        let style = match (height, r.unit()) {
            (h, u) if h > 60.0 => {
                if u < 0.55 {
                    Style::Curtain
                } else {
                    Style::Panel
                }
            }
            (h, u) if h > 28.0 => {
                if u < 0.3 {
                    Style::Curtain
                } else if u < 0.6 {
                    Style::Panel
                } else {
                    Style::Brick
                }
            }
            (_, u) => {
                if u < 0.5 {
                    Style::Brick
                } else if u < 0.85 {
                    Style::Plaster
                } else {
                    Style::Panel
                }
            }
        };
        let floor = r.range(3.0, 3.7);
        let ground_floor = r.range(4.2, 5.4);
        let floors = (((height - ground_floor) / floor).round()).max(1.0) as u32;
        let (bay, window, bars) = match style {
            Style::Brick => {
                (r.range(2.3, 3.1), [r.range(0.22, 0.28), r.range(0.24, 0.3), 0.0, r.range(0.82, 0.9)], 1)
            }
            Style::Plaster => {
                (r.range(2.4, 3.4), [r.range(0.24, 0.3), r.range(0.14, 0.26), 0.0, r.range(0.84, 0.92)], 1)
            }
            Style::Panel => {
                (r.range(2.8, 4.0), [r.range(0.08, 0.16), r.range(0.28, 0.34), 0.0, r.range(0.84, 0.9)], 2)
            }
            Style::Curtain => (r.range(1.5, 2.4), [0.03, r.range(0.16, 0.3), 0.0, 0.97], 0),
        };
        let count = match height {
            h if h > 75.0 => 3,
            h if h > 42.0 && r.unit() < 0.6 => 2,
            _ => 1,
        };
        let mut tiers = [Tier::default(); 3];
        let shares: [&[f32]; 3] = [&[1.0], &[0.62, 1.0], &[0.3, 0.74, 1.0]];
        let (mut base, mut done, mut inner) = (0.0, 0, area);
        for (k, tier) in tiers.iter_mut().enumerate().take(count) {
            let until = ((floors as f32 * shares[count - 1][k]).round() as u32).max(done + 1);
            *tier = Tier { area: inner, base, floors: until - done };
            let own = tier.floors as f32 * floor + if k == 0 { ground_floor - floor } else { 0.0 };
            base += own;
            done = until;
            let inset = |a: f32, b: f32, t: f32| t * (b - a);
            let (l, b, rr, f) =
                (r.range(0.05, 0.16), r.range(0.05, 0.16), r.range(0.05, 0.16), r.range(0.05, 0.16));
            let [x0, y0, x1, y1] = inner;
            inner =
                [x0 + inset(x0, x1, l), y0 + inset(y0, y1, f), x1 - inset(x0, x1, rr), y1 - inset(y0, y1, b)];
        }
        Self { seed, style, tiers, tier_count: count, ground_floor, floor, bay, window, bars }
    }

    /// Metres from the ground to the highest roof.
    pub(super) fn height(&self) -> f32 {
        let top = &self.tiers[self.tier_count - 1];
        top.base + self.wall_height(self.tier_count - 1)
    }

    pub(super) fn wall_height(&self, tier: usize) -> f32 {
        let first = if tier == 0 { self.ground_floor - self.floor } else { 0.0 };
        self.tiers[tier].floors as f32 * self.floor + first
    }

    /// Metres of the unrolled strip: the perimeter, and the walls with the roof above them.
    pub(super) fn strip(&self) -> [f32; 2] {
        let [x0, y0, x1, y1] = self.tiers[0].area;
        [2.0 * (x1 - x0 + y1 - y0), self.height() + PARAPET + (y1 - y0)]
    }

    /// Where the roof begins on the strip.
    pub(super) fn roof_start(&self) -> f32 {
        self.height() + PARAPET
    }

    pub(super) fn sides(&self, tier: usize) -> [Side; 4] {
        let [x0, y0, x1, y1] = self.tiers[tier].area;
        let (w, d) = (x1 - x0, y1 - y0);
        let bays = |length: f32| ((length / self.bay).round() as u32).max(1);
        let side = |origin, along: [f32; 2], length, start| Side {
            origin,
            along,
            out: [along[1], -along[0]],
            length,
            start,
            bays: bays(length),
        };
        [
            side([x0, y0], [1.0, 0.0], w, 0.0),
            side([x1, y0], [0.0, 1.0], d, w),
            side([x1, y1], [-1.0, 0.0], w, w + d),
            side([x0, y1], [0.0, -1.0], d, 2.0 * w + d),
        ]
    }

    /// Height of floor `k` of a tier above the tier's base, and its own height.
    pub(super) fn floor_at(&self, tier: usize, k: u32) -> (f32, f32) {
        match (tier, k) {
            (0, 0) => (0.0, self.ground_floor),
            (0, k) => (self.ground_floor + (k - 1) as f32 * self.floor, self.floor),
            (_, k) => (k as f32 * self.floor, self.floor),
        }
    }

    /// The opening of every bay of a floor.
    pub(super) fn opening(&self, tier: usize, k: u32, bay: f32) -> Opening {
        let [s, t0, _, t1] = self.window;
        if tier == 0 && k == 0 {
            let h = self.ground_floor;
            return Opening {
                s: [0.08 * bay, 0.92 * bay],
                t: [0.35, h - 1.0],
                depth: 0.35,
                sill: false,
                bars: 1,
            };
        }
        let depth = match self.style {
            Style::Brick => 0.16,
            Style::Plaster => 0.22,
            Style::Panel => 0.28,
            Style::Curtain => 0.07,
        };
        let sill = matches!(self.style, Style::Brick | Style::Plaster);
        Opening {
            s: [s * bay, (1.0 - s) * bay],
            t: [t0 * self.floor, t1 * self.floor],
            depth,
            sill,
            bars: self.bars,
        }
    }

    /// Describes one part.
    pub(super) fn build(&self, part: Part, cell: Cell, mesh: &mut Mesh) {
        let draw = Draw { b: self, cell: cell.unwrap_or(f32::INFINITY), strip: self.strip() };
        for tier in 0..self.tier_count {
            for side in self.sides(tier) {
                let base = self.tiers[tier].base;
                let height = self.wall_height(tier);
                match (cell, part) {
                    (None, Part::Walls) => {
                        draw.panel(mesh, &side, [0.0, side.length], [base, base + height], 0.0);
                    }
                    (None, Part::Glass) => {}
                    (Some(_), _) => draw.wall(mesh, tier, &side, part),
                }
                if part == Part::Walls {
                    draw.crown(mesh, &side, base + height, cell.is_some());
                }
            }
            if part == Part::Walls {
                draw.roof(mesh, tier, cell.is_some());
            }
        }
    }
}

struct Draw<'a> {
    b: &'a Building,
    cell: f32,
    strip: [f32; 2],
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
    fn panel(&self, mesh: &mut Mesh, side: &Side, s: [f32; 2], z: [f32; 2], out: f32) {
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

    fn wall(&self, mesh: &mut Mesh, tier: usize, side: &Side, part: Part) {
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
    fn crown(&self, mesh: &mut Mesh, side: &Side, z: f32, full: bool) {
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

    fn roof(&self, mesh: &mut Mesh, tier: usize, full: bool) {
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
        for k in 0..3 + (r.unit() * 6.0) as u32 {
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

/// Row and place of a brick at a point of the wall, both counted in bricks.
pub(super) fn brick(s: f32, z: f32) -> [f32; 2] {
    let row = z / 0.085;
    let shift = if (row.floor() as i32) & 1 == 0 { 0.0 } else { 0.5 };
    [row, s / 0.26 + shift]
}
