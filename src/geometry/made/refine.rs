//! Divides triangles until their edges are short enough, breadth first.
//!
//! Invariant: whether an edge is divided depends on its two end points alone, and it is divided in its middle, so that
//! both of its triangles divide it alike: there are no cracks, whatever the rates on either side. The result does not
//! depend on the number of threads. Never moves what it divides.

use super::seams::Seam;
use crate::error::{Error, Result};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// Most triangles that are made of one shape: what is made stays in memory. On the way there it takes some 2 GB.
pub const MAX_TRIANGLES: usize = 1 << 26;

/// A mesh while it is divided. Columns are empty or as long as `positions`.
#[derive(Clone, Debug, Default)]
pub(super) struct Refined {
    pub(super) positions: Vec<[f32; 3]>,
    /// Of unit length.
    pub(super) normals: Vec<[f32; 3]>,
    pub(super) uvs: Vec<[f32; 2]>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Edges that are two though they are one place; those of the last level that was divided.
    pub(super) seams: Vec<Seam>,
    /// Pairs of vertices that are one place, and whether they are smooth.
    pub(super) links: Vec<([u32; 2], bool)>,
}

/// No middle.
const WHOLE: u32 = u32::MAX;

impl Refined {
    /// Divides edges while `splits` says so of their end points, in either order, into `most` triangles at most.
    pub(super) fn divide(
        mut self,
        most: usize,
        splits: impl Fn(Vec3, Vec3) -> bool + Sync,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self> {
        for seam in &self.seams {
            self.links.extend((0..2).map(|i| ([seam.a[i], seam.b[i]], seam.smooth)));
        }
        let mut active = std::mem::take(&mut self.triangles);
        loop {
            if stop() {
                return Err(Error::Interrupted);
            }
            let (middles, count) = self.middles(&active, &splits)?;
            if count == 0 {
                self.triangles.append(&mut active);
                return Ok(self);
            }
            let parts =
                |i: usize| -> usize { 1 + middles[3 * i..3 * i + 3].iter().filter(|&&m| m != WHOLE).count() };
            let made: usize = (0..active.len()).into_par_iter().map(parts).sum();
            if self.triangles.len() + made > most {
                return Err(too_many(None, most));
            }
            let (ready, divided): (Vec<_>, Vec<_>) =
                (0..active.len()).into_par_iter().partition(|&i| parts(i) == 1);
            self.triangles.par_extend(ready.par_iter().map(|&i| active[i]));
            let at = |v: u32| Vec3::from(self.positions[v as usize]);
            active = divided
                .par_iter()
                .flat_map_iter(|&i| {
                    let mut four = [[WHOLE; 3]; 4];
                    let n = cut(active[i], [0, 1, 2].map(|k| middles[3 * i + k]), at, &mut four);
                    four.into_iter().take(n)
                })
                .collect();
        }
    }

    /// The vertex in the middle of each edge of `triangles` that is to be divided, made here, and their number.
    fn middles(
        &mut self,
        triangles: &[[u32; 3]],
        splits: &(impl Fn(Vec3, Vec3) -> bool + Sync),
    ) -> Result<(Vec<u32>, usize)> {
        let at = |v: u32| Vec3::from(self.positions[v as usize]);
        let edges = |(i, t): (usize, &[u32; 3])| {
            let ends = [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
            let asked = move |(k, [a, b]): (usize, [u32; 2])| (([a.min(b), a.max(b)]), (3 * i + k) as u32);
            let wanted = |([a, b], _): &([u32; 2], u32)| {
                let (p, q) = (at(*a), at(*b));
                let middle = middle(p, q);
                // Where numbers end, so does dividing.
                middle != p && middle != q && middle.is_finite() && splits(p, q)
            };
            ends.into_iter().enumerate().map(asked).filter(wanted)
        };
        let mut asked: Vec<([u32; 2], u32)> = triangles.par_iter().enumerate().flat_map_iter(edges).collect();
        asked.par_sort_unstable();
        let mut middles = vec![WHOLE; 3 * triangles.len()];
        let mut keys: Vec<[u32; 2]> = Vec::new();
        let first = self.positions.len();
        for same in asked.chunk_by(|a, b| a.0 == b.0) {
            let vertex = (first + keys.len()) as u32;
            keys.push(same[0].0);
            same.iter().for_each(|(_, slot)| middles[*slot as usize] = vertex);
        }
        if first + keys.len() > WHOLE as usize {
            return Err(too_many(None, MAX_TRIANGLES));
        }
        let Self { positions, normals, uvs, seams, links, .. } = self;
        let both = |column: &[[f32; 3]], [a, b]: [u32; 2]| {
            middle(Vec3::from(column[a as usize]), Vec3::from(column[b as usize]))
        };
        let new: Vec<[f32; 3]> = keys.par_iter().map(|&k| both(positions, k).to_array()).collect();
        positions.extend(new);
        if !normals.is_empty() {
            let unit =
                |n: Vec3, [a, _]: [u32; 2]| n.try_normalize().map_or(normals[a as usize], |n| n.to_array());
            let new: Vec<[f32; 3]> = keys.par_iter().map(|&k| unit(both(normals, k), k)).collect();
            normals.extend(new);
        }
        if !uvs.is_empty() {
            let uv = |v: u32| Vec2::from(uvs[v as usize]);
            let new: Vec<[f32; 2]> =
                keys.par_iter().map(|&[a, b]| (0.5 * uv(a) + 0.5 * uv(b)).to_array()).collect();
            uvs.extend(new);
        }
        let made =
            |[a, b]: [u32; 2]| keys.binary_search(&[a.min(b), a.max(b)]).ok().map(|i| (first + i) as u32);
        let halves = |seam: &Seam| {
            // Both are divided or neither is, since their ends are the same.
            let (m, n) = (made(seam.a)?, made(seam.b)?);
            let Seam { a, b, smooth } = *seam;
            Some([Seam { a: [a[0], m], b: [b[0], n], smooth }, Seam { a: [m, a[1]], b: [n, b[1]], smooth }])
        };
        let divided: Vec<[Seam; 2]> = seams.iter().filter_map(halves).collect();
        links.extend(divided.iter().map(|[half, _]| ([half.a[1], half.b[1]], half.smooth)));
        *seams = divided.into_iter().flatten().collect();
        Ok((middles, keys.len()))
    }
}

/// The same whichever end is named first.
fn middle(a: Vec3, b: Vec3) -> Vec3 {
    0.5 * a + 0.5 * b
}

/// A triangle by the vertices in the middle of its edges; how many there are.
fn cut([a, b, c]: [u32; 3], middles: [u32; 3], at: impl Fn(u32) -> Vec3, out: &mut [[u32; 3]; 4]) -> usize {
    let divided = middles.map(|m| m != WHOLE);
    // Turned so that the first edge is divided and the last is not, unless all are.
    let (t, m) = match divided {
        [true, _, false] | [true, true, true] | [false, false, false] => ([a, b, c], middles),
        [_, true, _] if !divided[0] => ([b, c, a], [middles[1], middles[2], middles[0]]),
        _ => ([c, a, b], [middles[2], middles[0], middles[1]]),
    };
    let [a, b, c] = t;
    match m.map(|m| m != WHOLE) {
        [true, true, true] => {
            *out = [[a, m[0], m[2]], [m[0], b, m[1]], [m[2], m[1], c], [m[0], m[1], m[2]]];
            4
        }
        [true, true, false] => {
            out[0] = [m[0], b, m[1]];
            // The shorter diagonal of what is left.
            if at(m[1]).distance_squared(at(a)) <= at(m[0]).distance_squared(at(c)) {
                out[1] = [a, m[0], m[1]];
                out[2] = [a, m[1], c];
            } else {
                out[1] = [a, m[0], c];
                out[2] = [m[0], m[1], c];
            }
            3
        }
        [true, false, _] => {
            out[0] = [a, m[0], c];
            out[1] = [m[0], b, c];
            2
        }
        _ => {
            out[0] = t;
            1
        }
    }
}

/// More than `most`: `at_least`, if that is known.
pub(super) fn too_many(at_least: Option<f64>, most: usize) -> Error {
    let wanted = at_least.map_or_else(String::new, |n| format!(" ({n:.0} at least)"));
    let room = if most < MAX_TRIANGLES { ", as many as there is memory for" } else { "" };
    Error::Resource(format!(
        "its displacement makes more than {most} triangles{room}{wanted}; a longer edge, by \
         \"displacement.edgelength\" or --tessellation, makes fewer"
    ))
}
