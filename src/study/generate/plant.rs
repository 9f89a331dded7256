//! Plants and stones that scenes place by instances: grown from a number, in metres, standing at the
//! origin. Invariant: a plant has exactly the leaves it is told to have, so triangle counts are known
//! before anything is written. Never writes a file.

use super::mesh_out::{Mesh, Vertex};
use super::noise::{Random, along, cross, fbm, lerp, normalized, turn};

/// What grows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Species {
    Spruce,
    Oak,
    Birch,
    Bush,
}

/// A tree or a bush.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tree {
    pub(super) seed: u32,
    pub(super) species: Species,
    /// Metres.
    pub(super) height: f32,
    /// How often branches branch.
    pub(super) levels: u32,
    /// Leaves or sprays of needles, two triangles each.
    pub(super) leaves: u32,
}

enum Piece<'a> {
    /// Points with radii.
    Tube(&'a [([f32; 3], f32)], u32),
    /// Where leaves hang: middle, direction, reach.
    Tip([f32; 3], [f32; 3], f32),
}

const UP: [f32; 3] = [0.0, 0.0, 1.0];

fn random_direction(r: &mut Random) -> [f32; 3] {
    let z = r.range(-1.0, 1.0);
    let [c, s] = turn(f64::from(r.unit()));
    let around = (1.0 - z * z).max(0.0).sqrt();
    [c * around, s * around, z]
}

/// Two directions across `d`.
fn frame(d: [f32; 3]) -> [[f32; 3]; 2] {
    let other = if d[2].abs() < 0.9 { UP } else { [1.0, 0.0, 0.0] };
    let a = normalized(cross(other, d));
    [a, cross(d, a)]
}

impl Tree {
    /// Triangles of trunk and branches.
    pub(super) fn wood_triangles(&self) -> u64 {
        super::mesh_out::count(|mesh| self.wood(mesh))
    }

    /// Trunk and branches.
    pub(super) fn wood(&self, mesh: &mut Mesh) {
        self.grow(&mut |piece| {
            if let Piece::Tube(points, sides) = piece {
                tube(mesh, points, sides);
            }
        });
    }

    /// Leaves; texture coordinates choose one of 8 × 8 cells of colours.
    pub(super) fn foliage(&self, mesh: &mut Mesh) {
        if !mesh.wants_vertices() {
            return mesh.skip_quads(self.leaves);
        }
        let mut tips = 0u64;
        self.grow(&mut |piece| tips += u64::from(matches!(piece, Piece::Tip(..))));
        let (area, slim) = match self.species {
            Species::Spruce => (1.15 * self.height * self.height, 0.30),
            Species::Oak => (0.85 * self.height * self.height, 0.7),
            Species::Birch => (0.55 * self.height * self.height, 0.75),
            Species::Bush => (3.2 * self.height * self.height, 0.6),
        };
        // A diamond's area is half of length times width.
        let size = (2.0 * area / self.leaves.max(1) as f32 / slim).sqrt().min(0.6);
        let mut r = Random::new(self.seed, 11);
        let mut index = 0u64;
        self.grow(&mut |piece| {
            let Piece::Tip(p, dir, reach) = piece else { return };
            let share = |i: u64| i * u64::from(self.leaves) / tips.max(1);
            let own = share(index + 1) - share(index);
            index += 1;
            for _ in 0..own {
                self.leaf(mesh, &mut r, (p, dir, reach), size, slim);
            }
        });
    }

    fn leaf(
        &self,
        mesh: &mut Mesh,
        r: &mut Random,
        (p, dir, reach): ([f32; 3], [f32; 3], f32),
        size: f32,
        slim: f32,
    ) {
        let size = size * r.range(0.7, 1.3);
        let (at, axis) = if self.species == Species::Spruce {
            // Sprays lie along the branch, to both sides and hanging a little.
            let [side, _] = frame(dir);
            let t = r.range(-1.0, 1.0);
            let sign = if r.bits() & 1 == 0 { -1.0 } else { 1.0 };
            let axis = along(along(dir, side, sign * r.range(0.3, 1.4)), UP, r.range(-0.75, 0.05));
            (along(p, dir, t * reach), normalized(axis))
        } else {
            let out = random_direction(r);
            let spread = reach * r.unit().sqrt();
            (along(p, out, spread), normalized(along(along(out, dir, 0.5), UP, r.range(-0.9, 0.3))))
        };
        let facing = random_direction(r);
        let across = normalized(cross(axis, along(facing, UP, 1.2)));
        let fold = normalized(cross(across, axis));
        let (l, w) = (size, size * slim * 0.5);
        let cell = r.bits();
        let uv = |u: f32, v: f32| {
            [((cell & 7) as f32 + 0.08 + 0.84 * u) / 8.0, ((cell >> 3 & 7) as f32 + 0.08 + 0.84 * v) / 8.0]
        };
        let v = |p: [f32; 3], u: f32, w: f32| Vertex { p, n: [0.0; 3], uv: uv(u, w) };
        let mid = along(at, axis, 0.45 * l);
        let lift = along(mid, fold, 0.10 * l);
        mesh.quad([
            v(at, 0.5, 0.0),
            v(along(lift, across, w), 1.0, 0.5),
            v(along(at, axis, l), 0.5, 1.0),
            v(along(lift, across, -w), 0.0, 0.5),
        ]);
    }

    fn grow(&self, visit: &mut dyn FnMut(Piece<'_>)) {
        let mut r = Random::new(self.seed, 10);
        match self.species {
            Species::Spruce => self.grow_spruce(&mut r, visit),
            Species::Bush => {
                for _ in 0..7 {
                    let d = random_direction(&mut r);
                    let d = normalized([d[0], d[1], d[2].abs() + 0.7]);
                    self.grow_branch(
                        &mut r,
                        visit,
                        ([0.0; 3], d),
                        (self.height * 0.6, 0.02),
                        self.levels.saturating_sub(1),
                    );
                }
            }
            Species::Oak | Species::Birch => {
                let (share, girth) = if self.species == Species::Oak { (0.62, 0.026) } else { (0.88, 0.012) };
                let lean = random_direction(&mut r);
                let d = normalized(along(UP, lean, 0.06));
                let start = [0.0, 0.0, -0.3];
                self.grow_branch(
                    &mut r,
                    visit,
                    (start, d),
                    (self.height * share, self.height * girth),
                    self.levels,
                );
            }
        }
    }

    fn grow_spruce(&self, r: &mut Random, visit: &mut dyn FnMut(Piece<'_>)) {
        let h = self.height;
        let points: Vec<_> = (0..=10)
            .map(|i| i as f32 / 10.0)
            .map(|t| ([0.0, 0.0, h * t - 0.3], h * 0.016 * (1.0 - 0.96 * t)))
            .collect();
        visit(Piece::Tube(&points, 8));
        let whorls = (h * (0.7 + 0.7 * self.levels as f32)) as u32;
        for k in 0..whorls {
            let t = 0.10 + 0.88 * (k as f32 + r.unit()) / whorls as f32;
            let length = h * (0.035 + 0.20 * (1.0 - t)) * r.range(0.7, 1.15);
            let turns = r.unit();
            let arms = 4 + (r.unit() * 2.5) as u32;
            for a in 0..arms {
                let [c, s] = turn(f64::from(turns) + f64::from(a) / f64::from(arms));
                let length = length * r.range(0.75, 1.1);
                let droop = lerp(0.42, -0.35, t);
                let start = [0.0, 0.0, h * t];
                let at = |u: f32| {
                    let out = length * u;
                    [c * out, s * out, start[2] - length * droop * u * (1.0 - 0.35 * u * u)]
                };
                let radius = length * 0.014 + 0.004;
                let branch: Vec<_> =
                    (0..4).map(|i| i as f32 / 3.0).map(|u| (at(u), radius * (1.0 - 0.8 * u))).collect();
                visit(Piece::Tube(&branch, 4));
                let tips = 2 + (length * 1.6) as u32;
                for i in 0..tips {
                    let u = 0.22 + 0.75 * (i as f32 + 0.5) / tips as f32;
                    let (p, q) = (at(u), at(u + 0.05));
                    let d = normalized([q[0] - p[0], q[1] - p[1], q[2] - p[2]]);
                    visit(Piece::Tip(p, d, 0.5 * length / tips as f32));
                }
            }
        }
    }

    fn grow_branch(
        &self,
        r: &mut Random,
        visit: &mut dyn FnMut(Piece<'_>),
        (start, mut dir): ([f32; 3], [f32; 3]),
        (length, radius): (f32, f32),
        level: u32,
    ) {
        let trunk = level == self.levels && self.species != Species::Bush;
        let segments = if trunk { 7u32 } else { 3 };
        let wander = if trunk { 0.07 } else { 0.22 };
        let mut points = vec![(start, radius * if trunk { 1.35 } else { 1.0 })];
        for i in 1..=segments {
            let away = random_direction(r);
            dir = normalized(along(along(dir, away, wander), UP, if trunk { 0.03 } else { 0.07 }));
            let t = i as f32 / segments as f32;
            let last = points[points.len() - 1].0;
            points.push((along(last, dir, length / segments as f32), radius * (1.0 - 0.72 * t)));
        }
        visit(Piece::Tube(&points, if trunk { 9 } else { 3 + level }));
        let end = points[segments as usize].0;
        if level == 0 {
            let reach = 0.05 * self.height.min(9.0) + 0.35 * length;
            visit(Piece::Tip(end, dir, reach));
            visit(Piece::Tip(points[segments as usize / 2 + 1].0, dir, reach * 0.8));
            return;
        }
        let birch = self.species == Species::Birch;
        let children = if trunk { if birch { 16 } else { 9 } } else { 5 };
        for k in 0..children {
            let from = if trunk { if birch { 0.28 } else { 0.42 } } else { 0.3 };
            let t = from + (1.0 - from) * (k as f32 + 0.5) / children as f32;
            let place = t * segments as f32;
            let i = (place as usize).min(segments as usize - 1);
            let (a, b) = (points[i], points[i + 1]);
            let f = place - i as f32;
            let p = [0, 1, 2].map(|c| lerp(a.0[c], b.0[c], f));
            let [x, y] = frame(dir);
            // By the golden angle, so that no side is bare.
            let [c, s] = turn(0.381_966 * f64::from(k) + f64::from(r.range(-0.06, 0.06)));
            let side = [0, 1, 2].map(|i| x[i] * c + y[i] * s);
            let open = if birch && trunk { r.range(0.55, 1.0) } else { r.range(0.7, 1.35) };
            let d = normalized(along(dir, side, open));
            let shrink = if trunk && birch {
                0.34 * (1.25 - t)
            } else if trunk {
                0.72 * (1.3 - 0.6 * t)
            } else {
                0.52
            };
            let own = lerp(a.1, b.1, f) * if trunk { 0.55 } else { 0.7 };
            let reach = length * shrink * r.range(0.75, 1.15);
            self.grow_branch(r, visit, (p, d), (reach, own), level - 1);
        }
    }
}

/// A tube through points, without caps.
pub(super) fn tube(mesh: &mut Mesh, points: &[([f32; 3], f32)], sides: u32) {
    let n = points.len();
    let mut around = 0.0;
    mesh.grid(sides, n as u32 - 1, |i, j| {
        let (j, (p, radius)) = (j as usize, points[j as usize]);
        let (a, b) = (points[j.saturating_sub(1)].0, points[(j + 1).min(n - 1)].0);
        let d = normalized([b[0] - a[0], b[1] - a[1], b[2] - a[2]]);
        let [x, y] = frame(d);
        let t = i as f32 / sides as f32;
        let [c, s] = turn(f64::from(t));
        let out = [0, 1, 2].map(|k| x[k] * c + y[k] * s);
        if i == 0 && j > 0 {
            let q = points[j - 1].0;
            let step = [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
            around += (step[0] * step[0] + step[1] * step[1] + step[2] * step[2]).sqrt();
        }
        Vertex { p: along(p, out, radius), n: out, uv: [t, around * 0.25] }
    });
}

/// A stone of about a metre, `2 n²` triangles twice.
pub(super) fn stone(seed: u32, n: u32, mesh: &mut Mesh) {
    mesh.grid(2 * n, n, |i, j| {
        let [c, s] = turn(f64::from(i % (2 * n)) / f64::from(2 * n));
        let [cz, sz] = turn(f64::from(j) / f64::from(2 * n) - 0.25);
        let d = [c * cz, s * cz, sz];
        let at = |k: usize| f64::from(d[k]);
        let big = fbm(seed, 1.1 * at(0) + 0.7 * at(2), 1.1 * at(1) - 0.6 * at(2), 2);
        let small = fbm(seed ^ 9, 4.0 * at(0) + 2.0 * at(2), 4.0 * at(1) - 3.0 * at(2), 5);
        let radius = 0.5 * (1.0 + 0.5 * big + 0.16 * small);
        let flat = if d[2] < 0.0 { 0.5 } else { 0.75 };
        Vertex {
            p: [d[0] * radius, d[1] * radius * 0.8, d[2] * radius * flat],
            n: d,
            uv: [i as f32 / (2 * n) as f32, j as f32 / n as f32],
        }
    });
}

/// A tuft of grass of about `radius` metres: blades of `4` triangles each.
pub(super) fn tuft(seed: u32, blades: u32, (radius, tall): (f32, f32), mesh: &mut Mesh) {
    let mut r = Random::new(seed, 12);
    for _ in 0..blades {
        let [c, s] = turn(f64::from(r.unit()));
        let away = radius * r.unit();
        let root = [c * away, s * away, -0.02];
        let [bc, bs] = turn(f64::from(r.unit()));
        let length = tall * r.range(0.45, 1.1);
        let bend = r.range(0.15, 0.75);
        let width = 0.004 + 0.05 * tall * r.range(0.1, 0.35);
        let cell = r.bits();
        mesh.grid(1, 2, |i, j| {
            let t = j as f32 / 2.0;
            let out = bend * t * t * length;
            let w = width * (1.0 - 0.92 * t) * (i as f32 - 0.5);
            Vertex {
                p: [
                    root[0] + bc * out - bs * w,
                    root[1] + bs * out + bc * w,
                    root[2] + length * t * (1.0 - 0.25 * bend * t),
                ],
                n: UP,
                uv: [
                    ((cell & 7) as f32 + 0.1 + 0.8 * i as f32) / 8.0,
                    ((cell >> 3 & 7) as f32 + 0.1 + 0.8 * t) / 8.0,
                ],
            }
        });
    }
}
