//! A building of the city: its size and style from a number, and its geometry. Walls stand in tiers;
//! a tier's wall unrolls to a strip, (s, t) in metres along the perimeter and upwards, which the
//! texture ([`super::facade`]) paints with the same openings. Invariant: geometry and texture ask the
//! same functions where a window is. Never writes a file.

use super::mesh_out::Mesh;
use super::noise::Random;
use super::walls::Draw;

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
    pub(super) origin: [f32; 2],
    pub(super) along: [f32; 2],
    pub(super) out: [f32; 2],
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

/// Height of the wall around a roof.
pub(super) const PARAPET: f32 = 0.9;
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

/// Row and place of a brick at a point of the wall, both counted in bricks.
pub(super) fn brick(s: f32, z: f32) -> [f32; 2] {
    let row = z / 0.085;
    let shift = if (row.floor() as i32) & 1 == 0 { 0.0 } else { 0.5 };
    [row, s / 0.26 + shift]
}
