//! Displacement: a mesh is divided as finely as it is seen, and its vertices are moved along their normals by a
//! texture (pbrt-v4's `displacement` of `plymesh`).
//!
//! Invariant: vertices of one place stay at one place to the bit: where a texture's coordinates or normals begin anew,
//! all versions of the vertex move by the mean of what each would move by. Never moves a vertex by what is no number.

use super::refine::{Refined, too_many};
use super::rule::{Point, Rule};
use super::seams::{self, Groups};
use super::view::View;
use super::{MadeMesh, Place};
use crate::error::Result;
use crate::math::{DVec3, Transform};
use crate::scene::{TextureId, TriangleMesh};
use crate::texture::{TextureCoordinates, Textures};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Normals of two vertices of one place that are closer than 30° are of one smooth surface.
const SMOOTH_COSINE: f32 = 0.866;
/// Vertices that are moved by one thread at a time.
const AT_ONCE: usize = 4096;

/// What a mesh is displaced by, and how finely.
pub(super) struct Displacement<'a> {
    pub(super) texture: TextureId,
    pub(super) edge_length: Option<f32>,
    pub(super) textures: &'a Arc<Textures>,
    pub(super) place: Place<'a>,
    pub(super) view: &'a View,
}

/// A mesh that is to be divided and moved.
pub(super) struct Displaced {
    /// Not divided yet.
    pub(super) base: Refined,
    pub(super) rule: Rule,
    texture: TextureId,
    textures: Arc<Textures>,
    to_world: Transform,
}

impl Displacement<'_> {
    /// Why `base` cannot be displaced, if it cannot.
    pub(super) fn lack(&self, base: &TriangleMesh) -> Option<&'static str> {
        (base.uvs.is_empty() && self.textures.reads_uv(self.texture)).then_some(
            "the mesh has no texture coordinates, which its displacement reads; add them, or map the texture by position",
        )
    }

    /// Of `base`, which has what it needs; [`Error::Resource`] where it would become more than `most` triangles.
    pub(super) fn of(&self, base: TriangleMesh, most: usize) -> Result<Displaced> {
        let TriangleMesh { positions, normals, uvs, indices: triangles, .. } = base;
        let rule = Rule::new(&positions, &triangles, &self.place, self.view, self.edge_length);
        // What cannot be is said before it is tried.
        let at_least = rule.at_least(&positions, &triangles);
        if at_least > most as f64 {
            return Err(too_many(Some(at_least), most));
        }
        let given = normals.iter().map(|&n| Vec3::from(n).normalize_or_zero().to_array()).collect();
        let normals: Vec<[f32; 3]> =
            if normals.is_empty() { vertex_normals(&positions, &triangles) } else { given };
        let smooth = |a: u32, b: u32| {
            let [a, b] = [a, b].map(|v| Vec3::from(normals[v as usize]));
            a.dot(b) >= SMOOTH_COSINE
        };
        let seams = seams::find(&positions, &triangles, smooth);
        Ok(Displaced {
            base: Refined { positions, normals, uvs, triangles, seams, links: Vec::new() },
            rule,
            texture: self.texture,
            textures: Arc::clone(self.textures),
            to_world: *self.place.to_world,
        })
    }
}

impl Displaced {
    /// All of it, in `most` triangles at most.
    pub(super) fn whole(mut self, most: usize, stop: &(dyn Fn() -> bool + Sync)) -> Result<MadeMesh> {
        let base = std::mem::take(&mut self.base);
        let divided =
            base.divide(most, |p, q| self.rule.middle(&self.rule.point(p), &self.rule.point(q)), stop)?;
        Ok(self.displace(divided))
    }

    /// A vertex of the base.
    pub(super) fn point(&self, v: u32) -> Point {
        self.rule.point(Vec3::from(self.base.positions[v as usize]))
    }

    /// How far a vertex is moved by itself; `None` where its texture's value is no number.
    pub(super) fn moved(&self, p: Vec3, normal: Vec3, uv: Vec2) -> Option<Vec3> {
        // pbrt-v4 asks in object space, which is another place for textures that are mapped by position.
        let p = self.to_world.point(p);
        let n = self.to_world.normal(normal).normalize_or_zero();
        let height = self.textures.eval(self.texture, &TextureCoordinates::at(uv, p, n)).x;
        height.is_finite().then(|| height * normal)
    }

    /// While what is returned lives, this thread keeps tiles from one look-up to the next.
    pub(super) fn attach(&self) -> impl Sized + '_ {
        self.textures.store().attach()
    }

    pub(super) fn displace(&self, mesh: Refined) -> MadeMesh {
        let Refined { mut positions, normals, uvs, triangles, links, .. } = mesh;
        let not_numbers = AtomicU64::new(0);
        let mut moves = vec![Vec3::ZERO; positions.len()];
        moves.par_chunks_mut(AT_ONCE).enumerate().for_each(|(chunk, moves)| {
            let _held = self.attach();
            for (i, moved) in moves.iter_mut().enumerate() {
                let v = chunk * AT_ONCE + i;
                let uv = uvs.get(v).map_or(Vec2::ZERO, |&uv| Vec2::from(uv));
                match self.moved(Vec3::from(positions[v]), Vec3::from(normals[v]), uv) {
                    Some(by) => *moved = by,
                    None => _ = not_numbers.fetch_add(1, Ordering::Relaxed),
                }
            }
        });
        Groups::new(positions.len(), links.iter().map(|(link, _)| *link)).each(|group| {
            let mean = mean(group.iter().map(|&v| moves[v as usize]));
            group.iter().for_each(|&v| moves[v as usize] = mean);
        });
        positions.par_iter_mut().zip(&moves).for_each(|(p, moved)| *p = (Vec3::from(*p) + *moved).to_array());
        let smooth = links.iter().filter(|(_, smooth)| *smooth).map(|(link, _)| *link);
        let mut sums = normal_sums(&positions, &triangles);
        Groups::new(positions.len(), smooth).each(|group| {
            let sum: DVec3 = group.iter().map(|&v| sums[v as usize]).sum();
            group.iter().for_each(|&v| sums[v as usize] = sum);
        });
        let normals =
            sums.par_iter().zip(&normals).map(|(sum, &before)| moved_normal(*sum, before)).collect();
        let mesh = TriangleMesh { positions, normals, uvs, tangents: Vec::new(), indices: triangles };
        MadeMesh { mesh, not_numbers: not_numbers.into_inner() }
    }
}

/// Of what the versions of a vertex move by.
pub(super) fn mean(moves: impl ExactSizeIterator<Item = Vec3>) -> Vec3 {
    let count = moves.len() as f64;
    (moves.map(|m| m.as_dvec3()).sum::<DVec3>() / count).as_vec3()
}

/// Of a vertex, by the normals of its triangles and the one it had.
pub(super) fn moved_normal(sum: DVec3, before: [f32; 3]) -> [f32; 3] {
    sum.try_normalize().map_or(before, |n| n.as_vec3().to_array())
}

/// A triangle's normal, as long as twice its area; `None` where that is no number.
pub(super) fn area_normal([a, b, c]: [Vec3; 3]) -> Option<DVec3> {
    let [a, b, c] = [a, b, c].map(|p| p.as_dvec3());
    Some((b - a).cross(c - a)).filter(|normal| normal.is_finite())
}

/// Of each vertex, the sum of its triangles' normals, each as long as its area.
fn normal_sums(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for t in triangles {
        if let Some(normal) = area_normal(t.map(|v| Vec3::from(positions[v as usize]))) {
            t.iter().for_each(|&v| sums[v as usize] += normal);
        }
    }
    sums
}

fn vertex_normals(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let sums = normal_sums(positions, triangles).into_iter();
    sums.map(|n| n.normalize_or_zero().as_vec3().to_array()).collect()
}
