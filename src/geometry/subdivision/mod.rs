//! Subdivision surfaces: refines a control mesh by Loop's scheme or by Catmull and Clark's, then pushes its vertices to the
//! limit surface with the limit's normals.
//!
//! Invariant: a level multiplies the triangles by four exactly; more than [`MAX_TRIANGLES`] are
//! refused before any work (36 bytes a vertex and 24 a triangle at the peak: 2²⁸ triangles take some
//! 11 GB). Never welds vertices: only shared indices make an edge shared.

mod catmull_clark;
mod loop_scheme;
mod parts;
mod surface;

use crate::error::{Error, Result};
use crate::geometry::made::{self, InPieces};
use crate::math::Vec3;
use crate::scene::{Cage, TriangleMesh};
use catmull_clark::CatmullClark;
use loop_scheme::Loop;
use surface::{Sided, Surface};

/// Most triangles after refinement.
pub const MAX_TRIANGLES: u64 = 1 << 28;

/// How faces of `N` corners are refined.
trait Scheme<const N: u32> {
    /// Of a face, when there are no more levels.
    const TRIANGLES: u32;

    /// Each face in four, in order, before rings are found.
    fn divided(surface: &Surface<Sided<N>>) -> Surface<Sided<N>>;

    /// Vertices on the limit surface, with its normals; the triangles of each face in order.
    fn limit(surface: &Surface<Sided<N>>) -> TriangleMesh;

    /// About where the child `child` of the face with these `corners` is.
    fn child(corners: &[Vec3], child: u32) -> Vec<Vec3>;
}

/// Refines `cage` `levels` times and returns positions and normals on the limit surface, object
/// space. Texture coordinates and given normals of the control mesh are dropped, as in pbrt. With
/// 0 levels the control vertices themselves are pushed to the limit, which Catmull and Clark's scheme has for quadrangles
/// alone: it refines once at least.
///
/// # Errors
/// [`Error::Input`] without a file when an index is out of range or the result would be larger than
/// [`MAX_TRIANGLES`]; the caller, who knows the place, names it.
pub fn subdivide(cage: &Cage, levels: u32) -> Result<TriangleMesh> {
    check(cage, levels)?;
    Ok(match cage {
        Cage::Loop(mesh) => refined::<3, Loop>(loop_scheme::surface(mesh)?, levels),
        Cage::CatmullClark(mesh) => {
            refined::<4, CatmullClark>(catmull_clark::surface(mesh)?, levels.saturating_sub(1))
        }
    })
}

/// [`subdivide`] in pieces of `most` triangles at most.
///
/// # Errors
/// As there.
pub fn divide(cage: &Cage, levels: u32, most: u32) -> Result<InPieces> {
    check(cage, levels)?;
    Ok(match cage {
        Cage::Loop(mesh) => parts::divide::<3, Loop>(loop_scheme::surface(mesh)?, levels, most),
        Cage::CatmullClark(mesh) => {
            parts::divide::<4, CatmullClark>(catmull_clark::surface(mesh)?, levels.saturating_sub(1), most)
        }
    })
}

/// Most faces that meet at a vertex of `cage`, or will at the next level.
#[must_use]
pub fn most_at_a_vertex(cage: &Cage) -> usize {
    match cage {
        Cage::Loop(mesh) => {
            made::most_at_a_vertex(mesh.positions.len(), mesh.indices.iter().flatten().copied())
        }
        // A face becomes a vertex with a quadrangle at each corner.
        Cage::CatmullClark(mesh) => {
            let sides = mesh.faces().map(<[u32]>::len).max().unwrap_or(0);
            made::most_at_a_vertex(mesh.positions.len(), mesh.corners.iter().copied()).max(sides)
        }
    }
}

fn refined<const N: u32, S: Scheme<N>>(mut surface: Surface<Sided<N>>, levels: u32) -> TriangleMesh {
    for _ in 0..levels {
        surface = S::divided(&surface);
        surface.find_first();
    }
    S::limit(&surface)
}

fn check(cage: &Cage, levels: u32) -> Result<()> {
    let wanted = cage.triangles(levels);
    if wanted > MAX_TRIANGLES {
        return Err(fault(format!(
            "subdivision to {levels} levels makes {wanted} triangles; {MAX_TRIANGLES} at most"
        )));
    }
    Ok(())
}

fn fault(message: String) -> Error {
    Error::file("subdivision", message)
}

#[cfg(test)]
mod tests;
