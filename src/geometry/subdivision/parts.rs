//! Subdivision part by part: a face needs those around it, level by level, and no more.
//!
//! Invariant: see [`crate::geometry::made`]. Faces keep their order, so that a ring begins where it begins in the whole.

use super::surface::{NONE, Sided, Sides, Surface};
use super::{Scheme, limit};
use crate::geometry::made::{Around, InPieces, Part, Parts, Piece};
use crate::math::Vec3;
use crate::stats::KeyBuildHasher;
use std::collections::HashMap;
use std::marker::PhantomData;

/// A surface in pieces: the faces at a level, which are numbered as they are made.
struct Faces<const N: u32, S> {
    control: Surface<Sided<N>>,
    levels: u32,
    /// Level of the pieces.
    level: u32,
    /// Of vertices of the control mesh.
    around: Around,
    scheme: PhantomData<fn() -> S>,
}

/// Some faces of a level, and what each is called there.
struct Local<const N: u32> {
    surface: Surface<Sided<N>>,
    names: Vec<u32>,
}

/// `control` refined `levels` times in pieces of `most` triangles at most, or of one face.
pub(super) fn divide<const N: u32, S: Scheme<N> + 'static>(
    control: Surface<Sided<N>>,
    levels: u32,
    most: u32,
) -> InPieces {
    let triangles = |level: u32| 4u64.saturating_pow(levels - level) * u64::from(Sided::<N>::TRIANGLES);
    let level = (0..levels).find(|&level| triangles(level) <= u64::from(most)).unwrap_or(levels);
    let count = control.corners.len() as u32 / N;
    let around = Around::new(control.positions.len(), N, control.corners.iter().copied());
    let faces = Faces::<N, S> { control, levels, level, around, scheme: PhantomData };
    let pieces = (0..count << (2 * level)).map(|piece| faces.piece(piece)).collect();
    (Box::new(faces), pieces)
}

impl<const N: u32, S: Scheme<N>> Faces<N, S> {
    /// About where it is: on the control mesh.
    fn piece(&self, piece: u32) -> Piece {
        let mut corners: Vec<Vec3> =
            self.control.sides.corners(piece >> (2 * self.level)).map(|c| self.control.at(c)).collect();
        for level in (0..self.level).rev() {
            corners = S::child(&corners, (piece >> (2 * level)) & 3);
        }
        let centre = (corners.iter().sum::<Vec3>() / N as f32).to_array();
        Piece { triangles: Sided::<N>::TRIANGLES << (2 * (self.levels - self.level)), centre }
    }

    /// The faces of the control mesh that are in `faces`, which rise, or at a vertex of these.
    fn local(&self, faces: &[u32]) -> Local<N> {
        let vertices = faces
            .iter()
            .flat_map(|&f| self.control.sides.corners(f))
            .map(|c| self.control.corners[c as usize]);
        let mut names: Vec<u32> = vertices.flat_map(|v| self.around.at(v)).copied().collect();
        names.sort_unstable();
        names.dedup();
        Local { surface: self.control.part(&names), names }
    }
}

impl<const N: u32> Local<N> {
    /// Its faces divided, those of which are left that are `wanted` or at a vertex of one that is.
    fn refine<S: Scheme<N>>(&self, wanted: impl Fn(u32) -> bool) -> Self {
        let surface = S::divided(&self.surface);
        let name = |i: usize| 4 * self.names[i / 4] + i as u32 % 4;
        let mut marked = vec![false; surface.positions.len()];
        let faces = || surface.corners.chunks_exact(N as usize).enumerate();
        for (_, corners) in faces().filter(|&(i, _)| wanted(name(i))) {
            corners.iter().for_each(|&v| marked[v as usize] = true);
        }
        let left: Vec<u32> = faces()
            .filter(|(_, corners)| corners.iter().any(|&v| marked[v as usize]))
            .map(|(i, _)| i as u32)
            .collect();
        Self { surface: surface.part(&left), names: left.iter().map(|&i| name(i as usize)).collect() }
    }
}

impl<const N: u32> Surface<Sided<N>> {
    /// The `faces` of it, which rise, and their vertices.
    fn part(&self, faces: &[u32]) -> Self {
        let mut vertices: HashMap<u64, u32, KeyBuildHasher> =
            HashMap::with_capacity_and_hasher(faces.len(), KeyBuildHasher::default());
        let mut positions: Vec<Vec3> = Vec::new();
        let (mut corners, mut twins) = (Vec::new(), Vec::new());
        for corner in faces.iter().flat_map(|&f| self.sides.corners(f)) {
            let v = self.corners[corner as usize];
            corners.push(*vertices.entry(v.into()).or_insert_with(|| {
                positions.push(self.positions[v as usize]);
                positions.len() as u32 - 1
            }));
            let twin = self.twins[corner as usize];
            let here = faces.binary_search(&(twin / N)).ok().filter(|_| twin != NONE);
            twins.push(here.map_or(NONE, |face| N * face as u32 + twin % N));
        }
        let mut part = Self::unwalked(Sided, positions, corners, twins);
        part.find_first();
        part
    }
}

impl<const N: u32, S: Scheme<N>> Parts for Faces<N, S> {
    fn make(&self, pieces: &[u32]) -> Part {
        // Faces of a level above the pieces', or of theirs.
        let above = |level: u32| {
            let mut faces: Vec<u32> =
                pieces.iter().map(|piece| piece >> (2 * (self.level - level))).collect();
            faces.dedup();
            faces
        };
        let mut local = self.local(&above(0));
        for level in 1..=self.levels {
            let at = level.min(self.level);
            let faces = above(at);
            local = local.refine::<S>(|name| faces.binary_search(&(name >> (2 * (level - at)))).is_ok());
        }
        let mut mesh = limit::<N, S>(&local.surface, &|| false).expect("nobody stops it");
        let mut part = Part::default();
        let each = Sided::<N>::TRIANGLES;
        let triangles = std::mem::take(&mut mesh.indices);
        for (of_face, &name) in triangles.chunks_exact(each as usize).zip(&local.names) {
            if pieces.binary_search(&(name >> (2 * (self.levels - self.level)))).is_ok() {
                mesh.indices.extend_from_slice(of_face);
                part.names.extend((0..each).map(|t| each * name + t));
            }
        }
        part.mesh = mesh;
        part
    }

    fn bytes(&self) -> usize {
        self.control.bytes() + self.around.bytes()
    }
}
