//! Divides triangles until their edges are short enough, breadth first.
//!
//! Invariant: whether an edge is divided depends on its two end points alone, and it is divided in its middle, so that
//! both of its triangles divide it alike: there are no cracks, whatever the rates on either side. The result does not
//! depend on the number of threads. Never moves what it divides.

use super::parts::MOST_NAMES;
use super::rule::{self, WHOLE, cut, normal_between};
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

/// A level of triangles while all are divided, and how many each of them becomes.
struct Level {
    triangles: Vec<[u32; 3]>,
    parts: Vec<u8>,
}

impl Refined {
    /// Divides edges in the middle that `middle` gives for their end points, in either order, into `most` triangles at most.
    /// What a triangle becomes stands together, and where it stood.
    pub(super) fn divide(
        mut self,
        most: usize,
        middle: impl Fn(Vec3, Vec3) -> Option<Vec3> + Sync,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self> {
        for seam in &self.seams {
            self.links.extend((0..2).map(|i| ([seam.a[i], seam.b[i]], seam.smooth)));
        }
        let mut active = std::mem::take(&mut self.triangles);
        let mut levels: Vec<Level> = Vec::new();
        let mut ready = 0;
        while !active.is_empty() {
            if stop() {
                return Err(Error::Interrupted);
            }
            let middles = self.middles(&active, &middle)?;
            let parts = |of: &[u32]| 1 + of.iter().filter(|&&m| m != WHOLE).count() as u8;
            let parts: Vec<u8> = middles.par_chunks_exact(3).map(parts).collect();
            if ready + parts.par_iter().map(|&n| n as usize).sum::<usize>() > most {
                return Err(too_many(None, most));
            }
            ready += parts.par_iter().filter(|&&n| n == 1).count();
            let at = |v: u32| Vec3::from(self.positions[v as usize]);
            let next = (0..active.len()).into_par_iter().filter(|&i| parts[i] > 1).flat_map_iter(|i| {
                let (four, n) = cut(active[i], [0, 1, 2].map(|k| middles[3 * i + k]), at);
                four.into_iter().take(n)
            });
            let next = next.collect();
            levels.push(Level { triangles: std::mem::replace(&mut active, next), parts });
        }
        self.triangles = in_order(&levels);
        Ok(self)
    }

    /// The vertex in the middle of each edge of `triangles` that is divided, made here.
    fn middles(
        &mut self,
        triangles: &[[u32; 3]],
        middle: &(impl Fn(Vec3, Vec3) -> Option<Vec3> + Sync),
    ) -> Result<Vec<u32>> {
        let at = |v: u32| Vec3::from(self.positions[v as usize]);
        let edges = |(i, t): (usize, &[u32; 3])| {
            let ends = [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
            let asked = move |(k, [a, b]): (usize, [u32; 2])| (([a.min(b), a.max(b)]), (3 * i + k) as u32);
            let wanted = |([a, b], _): &([u32; 2], u32)| middle(at(*a), at(*b)).is_some();
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
        let between = |column: &[[f32; 3]], how: fn(Vec3, Vec3) -> Vec3| -> Vec<[f32; 3]> {
            let ends = |[a, b]: &[u32; 2]| [*a, *b].map(|v| Vec3::from(column[v as usize]));
            keys.par_iter().map(ends).map(|[a, b]| how(a, b).to_array()).collect()
        };
        let new = between(positions, rule::middle);
        positions.extend(new);
        if !normals.is_empty() {
            let new = between(normals, normal_between);
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
        Ok(middles)
    }
}

/// The triangles that were not divided any further, those of one of `levels[0]` after those of the one before, and so on.
fn in_order(levels: &[Level]) -> Vec<[u32; 3]> {
    let mut counts: Vec<Vec<u32>> = Vec::with_capacity(levels.len());
    for level in levels.iter().rev() {
        let mut below = counts.last().map_or(&[][..], |counts| counts).iter();
        let count = |&parts: &u8| if parts == 1 { 1 } else { below.by_ref().take(parts.into()).sum() };
        counts.push(level.parts.iter().map(count).collect());
    }
    let mut starts: Vec<u32> = Vec::new();
    let mut next = 0;
    for count in counts.last().into_iter().flatten() {
        starts.push(next);
        next += count;
    }
    let mut out = vec![[WHOLE; 3]; next as usize];
    for level in levels {
        counts.pop();
        let mut below = counts.last().map_or(&[][..], |counts| counts).iter();
        let mut starts_below = Vec::with_capacity(below.len());
        for ((&t, &parts), mut start) in level.triangles.iter().zip(&level.parts).zip(starts) {
            if parts == 1 {
                out[start as usize] = t;
                continue;
            }
            for count in below.by_ref().take(parts.into()) {
                starts_below.push(start);
                start += count;
            }
        }
        starts = starts_below;
    }
    out
}

/// More than `most`: `at_least`, if that is known.
pub(super) fn too_many(at_least: Option<f64>, most: usize) -> Error {
    let wanted = at_least.map_or_else(String::new, |n| format!(" ({n:.0} at least)"));
    let named = [MAX_TRIANGLES, MOST_NAMES as usize].contains(&most);
    let room = if named { "" } else { ", as many as there is memory for" };
    Error::Resource(format!(
        "its displacement makes more than {most} triangles{room}{wanted}; a longer edge, by \
         \"displacement.edgelength\" or --tessellation, makes fewer"
    ))
}
