//! Primitives as the builder sees them: boxes with names.
//!
//! Invariant: a box contains its primitive and the error of the test for it (`query.rs`). What is not finite, or
//! beyond [`LIMIT`](super::query::LIMIT), is left out.

use super::query::{LIMIT, padding};
use super::triangle::padded_bounds;
use crate::accel::Geometry;
use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec3A, Vec4};
use rayon::prelude::*;

/// The box of a primitive, and its name.
#[repr(C, align(16))]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct Reference {
    lo: [f32; 3],
    /// Geometry.
    pub(super) geometry: u32,
    hi: [f32; 3],
    /// Primitive within it.
    pub(super) primitive: u32,
}

impl Reference {
    pub(super) fn new(lo: [f32; 3], hi: [f32; 3], geometry: u32, primitive: u32) -> Option<Self> {
        let fits = |v: f32| v.abs() <= LIMIT;
        (lo.into_iter().chain(hi).all(fits)).then_some(Self { lo, geometry, hi, primitive })
    }

    /// Of a triangle; `None` where a corner is not a number, or too far away.
    #[inline(always)]
    pub(super) fn triangle(corners: [[f32; 3]; 3], geometry: u32, primitive: u32) -> Option<Self> {
        // A box may hide what is not a number.
        corners.iter().flatten().all(|c| c.abs() <= LIMIT).then_some(())?;
        let (lo, hi) = padded_bounds(corners);
        Self::new(lo, hi, geometry, primitive)
    }

    /// The centre of its box, doubled; the fourth component means nothing.
    #[inline(always)]
    pub(super) fn centre(&self) -> Vec4 {
        let [lo, hi] = self.bounds();
        lo + hi
    }

    /// Its box; the fourth components mean nothing.
    #[inline(always)]
    pub(super) fn bounds(&self) -> [Vec4; 2] {
        bytemuck::cast(*self)
    }

    /// Its box.
    pub(super) fn corners(&self) -> ([f32; 3], [f32; 3]) {
        (self.lo, self.hi)
    }
}

/// The first of the axes along which a box of this size is longest.
pub(super) fn longest_axis(size: Vec4) -> usize {
    if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    }
}

/// Triangles a task of reading them takes.
const CHUNK: usize = 1 << 14;

/// References to all triangles of `geometry`.
pub(super) fn triangles(geometry: &[Geometry<'_>]) -> Vec<Reference> {
    let mut all = Vec::new();
    for (name, g) in geometry.iter().enumerate() {
        let Geometry::Triangles { positions, indices, .. } = g else { continue };
        let name = u32::try_from(name).expect("geometries are counted in u32");
        let read = |first: usize, corners: &[[u32; 3]]| -> Vec<Reference> {
            let reference = |(i, corners): (usize, &[u32; 3])| {
                let primitive = u32::try_from(first + i).expect("primitives are counted in u32");
                Reference::triangle(corners.map(|c| positions[c as usize]), name, primitive)
            };
            corners.iter().enumerate().filter_map(reference).collect()
        };
        if indices.len() <= CHUNK {
            all.extend(read(0, indices));
        } else {
            let parts: Vec<Vec<Reference>> =
                indices.par_chunks(CHUNK).enumerate().map(|(i, corners)| read(i * CHUNK, corners)).collect();
            all.reserve(parts.iter().map(Vec::len).sum());
            for part in parts {
                all.extend(part);
            }
        }
    }
    all
}

/// A box grown by what rounding may move a ray that is brought into an instance's space, or meets a primitive of
/// which only the bounds are known.
pub(super) fn grown((lo, hi): (Vec3, Vec3)) -> ([f32; 3], [f32; 3]) {
    let (lo, hi) = (Vec3A::from(lo), Vec3A::from(hi));
    let pad = padding((hi - lo).max_element() + lo.abs().max(hi.abs()).max_element(), lo, hi);
    ((lo - pad).to_array(), (hi + pad).to_array())
}
