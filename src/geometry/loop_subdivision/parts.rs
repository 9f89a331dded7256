//! Loop subdivision part by part: a face needs those around it, level by level, and no more.
//!
//! Invariant: see [`crate::geometry::made`]. Faces keep their order, so that a ring begins where it begins in the whole.

use super::{NONE, Surface, check};
use crate::error::Result;
use crate::geometry::made::{Around, InPieces, Part, Parts, Piece};
use crate::math::Vec3;
use crate::scene::TriangleMesh;
use std::collections::HashMap;

/// A surface in pieces: the faces at a level, which are numbered as they are made.
struct Faces {
    control: Surface,
    levels: u32,
    /// Level of the pieces.
    level: u32,
    /// Of vertices of the control mesh.
    around: Around,
}

/// Some faces of a level, and what each is called there.
struct Local {
    surface: Surface,
    names: Vec<u32>,
}

/// [`super::subdivide`] in pieces of `most` triangles at most.
///
/// # Errors
/// As there.
pub fn divide(control: &TriangleMesh, levels: u32, most: u32) -> Result<InPieces> {
    check(control, levels)?;
    let control = Surface::new(control)?;
    let fits = |level: &u32| 4u64.saturating_pow(levels - level) <= u64::from(most.max(1));
    let level = (0..levels).find(fits).unwrap_or(levels);
    let count = control.corners.len() / 3;
    let around = Around::new(control.positions.len(), control.corners.iter().copied());
    let faces = Faces { control, levels, level, around };
    let pieces = (0..(count as u32) << (2 * level)).map(|piece| faces.piece(piece)).collect();
    Ok((Box::new(faces), pieces))
}

impl Faces {
    /// About where it is: on the control mesh.
    fn piece(&self, piece: u32) -> Piece {
        let face = (piece >> (2 * self.level)) as usize;
        let [mut a, mut b, mut c] =
            [0, 1, 2].map(|k| self.control.positions[self.control.corners[3 * face + k] as usize]);
        for level in (0..self.level).rev() {
            let [ab, bc, ca] = [0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)];
            [a, b, c] =
                [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]][(piece >> (2 * level)) as usize & 3];
        }
        let centre = ((a + b + c) / 3.0).to_array();
        Piece { triangles: 1 << (2 * (self.levels - self.level)), centre }
    }

    /// The faces of the control mesh that are in `faces`, which rise, or at a vertex of these.
    fn local(&self, faces: &[u32]) -> Local {
        let vertices = faces.iter().flat_map(|&f| &self.control.corners[3 * f as usize..3 * f as usize + 3]);
        let mut names: Vec<u32> = vertices.flat_map(|&v| self.around.at(v)).copied().collect();
        names.sort_unstable();
        names.dedup();
        Local { surface: self.control.part(&names), names }
    }
}

impl Local {
    /// Its faces divided, those of which are left that are `wanted` or at a vertex of one that is.
    fn refine(&self, wanted: impl Fn(u32) -> bool) -> Self {
        let surface = self.surface.divided();
        let name = |i: usize| 4 * self.names[i / 4] + i as u32 % 4;
        let mut marked = vec![false; surface.positions.len()];
        let faces = || surface.corners.chunks_exact(3).enumerate();
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

impl Surface {
    /// The `faces` of it, which rise, and their vertices.
    fn part(&self, faces: &[u32]) -> Self {
        let mut vertices: HashMap<u32, u32> = HashMap::with_capacity(faces.len());
        let mut positions: Vec<Vec3> = Vec::new();
        let (mut corners, mut twins) = (Vec::new(), Vec::new());
        for corner in faces.iter().flat_map(|&f| 3 * f..3 * f + 3) {
            let v = self.corners[corner as usize];
            corners.push(*vertices.entry(v).or_insert_with(|| {
                positions.push(self.positions[v as usize]);
                positions.len() as u32 - 1
            }));
            let twin = self.twins[corner as usize];
            let here = faces.binary_search(&(twin / 3)).ok().filter(|_| twin != NONE);
            twins.push(here.map_or(NONE, |face| 3 * face as u32 + twin % 3));
        }
        let mut part = Self { positions, corners, twins, first: Vec::new(), boundary: Vec::new() };
        part.find_first();
        part
    }
}

impl Parts for Faces {
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
            local = local.refine(|name| faces.binary_search(&(name >> (2 * (level - at)))).is_ok());
        }
        let mut mesh = local.surface.limit();
        let mut part = Part::default();
        for (t, &name) in std::mem::take(&mut mesh.indices).iter().zip(&local.names) {
            if pieces.binary_search(&(name >> (2 * (self.levels - self.level)))).is_ok() {
                mesh.indices.push(*t);
                part.names.push(name);
            }
        }
        part.mesh = mesh;
        part
    }

    fn bytes(&self) -> usize {
        let Surface { positions, corners, twins, first, boundary } = &self.control;
        size_of_val(&positions[..])
            + size_of_val(&corners[..])
            + size_of_val(&twins[..])
            + size_of_val(&first[..])
            + size_of_val(&boundary[..])
            + self.around.bytes()
    }
}
