//! Displacement: a mesh is divided as finely as it is seen, and its vertices are moved along their normals by a
//! texture (pbrt-v4's `displacement` of `plymesh`).
//!
//! Invariant: vertices of one place stay at one place to the bit: where a texture's coordinates or normals begin anew,
//! all versions of the vertex move by the mean of what each would move by. Never moves a vertex by what is no number.

use super::refine::{Refined, too_many};
use super::seams::{self, Groups};
use super::view::{Seen, View};
use super::{MadeMesh, Place};
use crate::error::{Error, Result};
use crate::math::DVec3;
use crate::scene::{TextureId, TriangleMesh};
use crate::texture::{TextureCoordinates, Textures};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// An edge is not divided into more than 2¹⁶ of the mesh's longest: a camera that touches the surface sees pixels of no
/// size there.
const LEAST_EDGE: f64 = 1.0 / 65536.0;
/// Normals of two vertices of one place that are closer than 30° are of one smooth surface.
const SMOOTH_COSINE: f32 = 0.866;
/// Vertices that are moved by one thread at a time.
const AT_ONCE: usize = 4096;

/// What moves a mesh.
pub(super) struct Displacement<'a> {
    pub(super) texture: TextureId,
    pub(super) edge_length: Option<f32>,
    pub(super) textures: &'a Textures,
    /// Triangles that may be made.
    pub(super) most: usize,
    pub(super) place: Place<'a>,
    pub(super) view: &'a View,
    pub(super) stop: &'a (dyn Fn() -> bool + Sync),
}

impl Displacement<'_> {
    /// `base`, divided and moved.
    pub(super) fn apply(&self, base: TriangleMesh) -> Result<MadeMesh> {
        if base.uvs.is_empty() && self.textures.reads_uv(self.texture) {
            return Err(Error::Resource(
                "the mesh has no texture coordinates, which its displacement reads; add them, or map the texture by \
                 position"
                    .to_owned(),
            ));
        }
        let TriangleMesh { positions, normals, uvs, indices: triangles, .. } = base;
        let given = normals.iter().map(|&n| Vec3::from(n).normalize_or_zero().to_array()).collect();
        let normals: Vec<[f32; 3]> =
            if normals.is_empty() { vertex_normals(&positions, &triangles) } else { given };
        let smooth = |a: u32, b: u32| {
            let [a, b] = [a, b].map(|v| Vec3::from(normals[v as usize]));
            a.dot(b) >= SMOOTH_COSINE
        };
        let seams = seams::find(&positions, &triangles, smooth);
        let refined = Refined { positions, normals, uvs, triangles, seams, links: Vec::new() };
        let refined = self.divide(refined)?;
        Ok(self.displace(refined))
    }

    pub(super) fn divide(&self, mesh: Refined) -> Result<Refined> {
        let place = &self.place;
        let to_world = |p: Vec3| place.to_world.point_f64(p.as_dvec3());
        let at = |v: u32| to_world(Vec3::from(mesh.positions[v as usize]));
        let used = || mesh.triangles.par_iter().flatten().map(|&v| at(v)).filter(|p| p.is_finite());
        let low = used().reduce(|| DVec3::INFINITY, DVec3::min);
        let high = used().reduce(|| DVec3::NEG_INFINITY, DVec3::max);
        let centre = 0.5 * (low + high);
        let seen = Seen::new(self.view, place.places, centre, 0.5 * (high - low).length());
        let longest = |t: &[u32; 3]| {
            let [a, b, c] = t.map(at);
            let lengths = [a.distance(b), b.distance(c), c.distance(a)];
            lengths.into_iter().filter(|l| l.is_finite()).fold(0.0, f64::max)
        };
        let least = mesh.triangles.par_iter().map(longest).reduce(|| 0.0, f64::max) * LEAST_EDGE;
        let most = self.edge_length.map_or(f64::INFINITY, f64::from);
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(at);
            Some(0.5 * (b - a).cross(c - a).length()).filter(|area| area.is_finite()).unwrap_or(0.0)
        };
        let areas: f64 = mesh.triangles.iter().map(area).sum();
        // No triangle of such edges is larger than the equilateral one: what cannot be is said before it is tried.
        let at_least = areas / (0.25 * 3f64.sqrt() * most * most);
        if at_least > self.most as f64 {
            return Err(too_many(Some(at_least), self.most));
        }
        let splits = |p: Vec3, q: Vec3| {
            let (p, q) = (to_world(p), to_world(q));
            let length = p.distance(q);
            length.is_finite() && length > least && (length > most || seen.edge(p, q) > 1.0)
        };
        mesh.divide(self.most, splits, self.stop)
    }

    pub(super) fn displace(&self, mesh: Refined) -> MadeMesh {
        let place = &self.place;
        let Refined { mut positions, normals, uvs, triangles, links, .. } = mesh;
        let not_numbers = AtomicU64::new(0);
        let mut moves = vec![Vec3::ZERO; positions.len()];
        moves.par_chunks_mut(AT_ONCE).enumerate().for_each(|(chunk, moves)| {
            let _held = self.textures.store().attach();
            for (i, moved) in moves.iter_mut().enumerate() {
                let v = chunk * AT_ONCE + i;
                let uv = uvs.get(v).map_or(Vec2::ZERO, |&uv| Vec2::from(uv));
                let normal = Vec3::from(normals[v]);
                // pbrt-v4 asks in object space, which is another place for textures that are mapped by position.
                let p = place.to_world.point(Vec3::from(positions[v]));
                let n = place.to_world.normal(normal).normalize_or_zero();
                let height = self.textures.eval(self.texture, &TextureCoordinates::at(uv, p, n)).x;
                if height.is_finite() {
                    *moved = height * normal;
                } else {
                    not_numbers.fetch_add(1, Ordering::Relaxed);
                }
            }
        });
        Groups::new(positions.len(), links.iter().map(|(link, _)| *link)).each(|group| {
            let sum: DVec3 = group.iter().map(|&v| moves[v as usize].as_dvec3()).sum();
            let mean = (sum / group.len() as f64).as_vec3();
            group.iter().for_each(|&v| moves[v as usize] = mean);
        });
        positions.par_iter_mut().zip(&moves).for_each(|(p, moved)| *p = (Vec3::from(*p) + *moved).to_array());
        let smooth = links.iter().filter(|(_, smooth)| *smooth).map(|(link, _)| *link);
        let mut sums = normal_sums(&positions, &triangles);
        Groups::new(positions.len(), smooth).each(|group| {
            let sum: DVec3 = group.iter().map(|&v| sums[v as usize]).sum();
            group.iter().for_each(|&v| sums[v as usize] = sum);
        });
        let unit = |(sum, before): (&DVec3, &[f32; 3])| {
            sum.try_normalize().map_or(*before, |n| n.as_vec3().to_array())
        };
        let normals = sums.par_iter().zip(&normals).map(unit).collect();
        let mesh = TriangleMesh { positions, normals, uvs, tangents: Vec::new(), indices: triangles };
        MadeMesh { mesh, not_numbers: not_numbers.into_inner() }
    }
}

/// Of each vertex, the sum of its triangles' normals, each as long as its area.
fn normal_sums(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|v| Vec3::from(positions[v as usize]).as_dvec3());
        let normal = (b - a).cross(c - a);
        if normal.is_finite() {
            t.iter().for_each(|&v| sums[v as usize] += normal);
        }
    }
    sums
}

fn vertex_normals(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let sums = normal_sums(positions, triangles).into_iter();
    sums.map(|n| n.normalize_or_zero().as_vec3().to_array()).collect()
}
