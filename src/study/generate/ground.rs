//! Uneven ground around a camera at the origin: one grid, or patches of it that meet exactly, and the
//! textures that lie on them. The grid is dense at the camera and wide far off, and texture
//! coordinates follow the grid, so texels do likewise. Invariant: a vertex on a seam is the same from
//! both sides. Never decides what ground looks like: a [`Land`] does.

use super::image_out::{TextureFormat, write_texture};
use super::mesh_out::{Vertex, write_grid};
use super::noise::{lerp, normalized};
use crate::error::Result;
use std::path::Path;

/// What stands where.
pub(super) trait Land: Send + Sync {
    /// Height in metres and a share of loose stone, 0 to 1. Detail below `finest` metres may be left
    /// out.
    fn height(&self, x: f64, y: f64, finest: f32) -> [f32; 2];
    /// Colours one row of texels in sRGB, 0 to 255.
    fn colour(&self, row: &Row<'_>, out: &mut [u8]);
}

/// A row of texels at one moment.
pub(super) struct Row<'a> {
    /// Metres, ascending.
    pub(super) xs: &'a [f32],
    /// Metres.
    pub(super) y: f32,
    /// Metres to the next row.
    pub(super) step: f32,
    /// Height in metres.
    pub(super) height: &'a [f32],
    /// Cosine of the slope's angle.
    pub(super) up: &'a [f32],
    /// Share of loose stone.
    pub(super) stone: &'a [f32],
}

/// Maps a grid's parameter to metres: `reach · (dense · t + (1 − dense) · t³)`.
#[derive(Clone, Copy)]
pub(super) struct Warp {
    pub(super) reach: f64,
    pub(super) dense: f64,
    /// Parameters at the two ends.
    pub(super) ends: [f64; 2],
}

impl Warp {
    /// Metres at `u`, 0 to 1 from end to end.
    pub(super) fn at(&self, u: f64) -> f64 {
        let t = self.ends[0] + (self.ends[1] - self.ends[0]) * u;
        self.reach * (self.dense * t + (1.0 - self.dense) * t * t * t)
    }

    /// Metres per unit of `u`.
    pub(super) fn stretch(&self, u: f64) -> f64 {
        let t = self.ends[0] + (self.ends[1] - self.ends[0]) * u;
        self.reach * (self.dense + 3.0 * (1.0 - self.dense) * t * t) * (self.ends[1] - self.ends[0])
    }
}

/// The whole ground: `side` × `side` patches of `cells` each, one texture of `texels` a patch.
#[derive(Clone, Copy)]
pub(super) struct Ground {
    pub(super) x: Warp,
    pub(super) y: Warp,
    pub(super) side: u32,
    pub(super) cells: [u32; 2],
    pub(super) texels: u32,
}

impl Ground {
    /// Triangles of all patches.
    pub(super) fn triangles(&self) -> u64 {
        2 * u64::from(self.cells[0]) * u64::from(self.cells[1]) * u64::from(self.side) * u64::from(self.side)
    }

    /// The parameter of a line of cells, counted over all patches: equal for both that share it.
    fn line(&self, axis: usize, index: i64) -> f64 {
        index as f64 / (f64::from(self.cells[axis]) * f64::from(self.side))
    }

    /// Writes the mesh of patch (`a`, `b`).
    pub(super) fn write_patch(&self, land: &dyn Land, (a, b): (u32, u32), path: &Path) -> Result<()> {
        let [nu, nv] = self.cells;
        let (first_i, first_j) = (i64::from(a) * i64::from(nu), i64::from(b) * i64::from(nv));
        write_grid(path, nu, nv, |rows| {
            // One line more on every side, for slopes.
            let columns = nu as usize + 3;
            let us: Vec<f64> = (0..columns as i64).map(|i| self.line(0, first_i + i - 1)).collect();
            let xs: Vec<f64> = us.iter().map(|&u| self.x.at(u)).collect();
            let line = |j: i64| -> (f64, Vec<f32>) {
                let v = self.line(1, first_j + j);
                let y = self.y.at(v);
                let dy = self.y.stretch(v) / (f64::from(nv) * f64::from(self.side));
                let heights = xs.iter().zip(&us).map(|(&x, &u)| {
                    let dx = self.x.stretch(u) / (f64::from(nu) * f64::from(self.side));
                    land.height(x, y, (dx * dy).sqrt() as f32)[0]
                });
                (y, heights.collect())
            };
            let mut vertices = Vec::with_capacity(rows.len() * (nu as usize + 1));
            let start = i64::from(rows.start);
            let (mut below, mut here) = (line(start - 1), line(start));
            for j in rows {
                let above = line(i64::from(j) + 1);
                for i in 1..=nu as usize + 1 {
                    let slope_x = (here.1[i + 1] - here.1[i - 1]) / (xs[i + 1] - xs[i - 1]) as f32;
                    let slope_y = (above.1[i] - below.1[i]) / (above.0 - below.0) as f32;
                    vertices.push(Vertex {
                        p: [xs[i] as f32, here.0 as f32, here.1[i]],
                        n: normalized([-slope_x, -slope_y, 1.0]),
                        uv: [(i - 1) as f32 / nu as f32, j as f32 / nv as f32],
                    });
                }
                below = std::mem::replace(&mut here, above);
            }
            vertices
        })
    }

    /// Writes the texture of patch (`a`, `b`).
    pub(super) fn write_texture(
        &self,
        land: &dyn Land,
        (a, b): (u32, u32),
        path: &Path,
        format: TextureFormat,
    ) -> Result<()> {
        /// Texels between points where the land is asked for its height.
        const COARSE: usize = 8;
        let n = self.texels as usize;
        let whole = f64::from(self.texels) * f64::from(self.side);
        let u_of = |texel: f64| (f64::from(a) * f64::from(self.texels) + texel) / whole;
        // Rows go from the top: v falls.
        let v_of = |row: f64| (f64::from(b + 1) * f64::from(self.texels) - row) / whole;
        let xs: Vec<f32> = (0..n).map(|i| self.x.at(u_of(i as f64 + 0.5)) as f32).collect();
        let columns = n.div_ceil(COARSE) + 1;
        let nodes: Vec<(f64, f64)> = (0..columns)
            .map(|i| u_of((i * COARSE) as f64))
            .map(|u| (self.x.at(u), self.x.stretch(u) / whole))
            .collect();
        let edges: Vec<f32> = nodes.iter().map(|&(x, _)| x as f32).collect();
        // Slopes come from the neighbours: along the line, and from the line before.
        let line = |row: usize, before: Option<&[[f32; 3]]>| -> Vec<[f32; 3]> {
            let v = v_of(row as f64);
            let (y, dy) = (self.y.at(v), self.y.stretch(v) / whole);
            let above =
                row.checked_sub(COARSE).map_or(y + COARSE as f64 * dy, |row| self.y.at(v_of(row as f64)));
            let mut nodes: Vec<[f32; 3]> = nodes
                .iter()
                .map(|&(x, dx)| {
                    let [h, stone] = land.height(x, y, (COARSE as f64 * (dx * dy).sqrt()) as f32);
                    [h, 1.0, stone]
                })
                .collect();
            for i in 0..nodes.len() {
                let (a, b) = (i.saturating_sub(1), (i + 1).min(nodes.len() - 1));
                let sx = (nodes[b][0] - nodes[a][0]) / (edges[b] - edges[a]);
                let sy = before.map_or(0.0, |line| (line[i][0] - nodes[i][0]) / (above - y) as f32);
                nodes[i][1] = normalized([-sx, -sy, 1.0])[2];
            }
            nodes
        };
        let (mut upper, mut lower, mut band) = (Vec::new(), Vec::new(), usize::MAX);
        let mut fields = [vec![0.0f32; n], vec![0.0f32; n], vec![0.0f32; n]];
        write_texture(path, format, (self.texels, self.texels), |j, bytes| {
            let j = j as usize;
            if j / COARSE != band {
                band = j / COARSE;
                upper = if lower.is_empty() { line(band * COARSE, None) } else { std::mem::take(&mut lower) };
                lower = line((band + 1) * COARSE, Some(&upper));
            }
            let t = ((j % COARSE) as f32 + 0.5) / COARSE as f32;
            for (k, field) in fields.iter_mut().enumerate() {
                for (c, texels) in field.chunks_mut(COARSE).enumerate() {
                    let left = lerp(upper[c][k], lower[c][k], t);
                    let right = lerp(upper[c + 1][k], lower[c + 1][k], t);
                    for (i, texel) in texels.iter_mut().enumerate() {
                        *texel = lerp(left, right, (i as f32 + 0.5) / COARSE as f32);
                    }
                }
            }
            let v = v_of(j as f64 + 0.5);
            land.colour(
                &Row {
                    xs: &xs,
                    y: self.y.at(v) as f32,
                    step: (self.y.stretch(v) / whole) as f32,
                    height: &fields[0],
                    up: &fields[1],
                    stone: &fields[2],
                },
                bytes,
            );
        })
    }
}

/// A colour as texels hold it.
#[inline]
pub(super) fn byte(c: f32) -> u8 {
    (c + 0.5) as u8
}
