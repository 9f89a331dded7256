//! Subdivision surfaces: refines a control mesh by Loop's scheme or by Catmull and Clark's, then pushes its vertices to the
//! limit surface with the limit's normals.
//!
//! Invariant: a level multiplies the triangles by four exactly, but for the first of polygons, which makes two at each
//! corner; more than [`Cage::MAX_TRIANGLES`] are refused before any work (41 bytes a vertex, and 28 to 36 a triangle, at the
//! peak: 2²⁸ triangles take some 13 to 15 GB). Never welds vertices: only shared indices make an edge shared.

mod catmull_clark;
mod loop_scheme;
mod parts;
mod surface;

use crate::error::{Error, Result};
use crate::geometry::made::InPieces;
use crate::math::Vec3;
use crate::scene::{Cage, TriangleMesh};
use catmull_clark::CatmullClark;
use loop_scheme::Loop;
use surface::{Sided, Surface};

/// Whether to give up.
type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// Vertices after which somebody is asked whether to give up.
const BETWEEN_QUESTIONS: usize = 1 << 16;

/// Asks at some vertices.
fn ask(stop: Stop<'_>, vertex: usize) -> Result<()> {
    if vertex.is_multiple_of(BETWEEN_QUESTIONS) && stop() { Err(Error::Interrupted) } else { Ok(()) }
}

/// How faces of `N` corners are refined.
trait Scheme<const N: u32> {
    /// Each face in four, in order, before rings are found.
    fn divided(surface: &Surface<Sided<N>>) -> Surface<Sided<N>>;

    /// Where a vertex with this [fan](Surface::fan) is on the limit surface, and two tangents there whose product points
    /// outwards.
    fn limit(surface: &Surface<Sided<N>>, vertex: usize, fan: &[u32]) -> (Vec3, [Vec3; 2]);

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
/// [`Cage::MAX_TRIANGLES`]; the caller, who knows the place, names it. [`Error::Interrupted`] when `stop` says so, which is
/// asked between levels and now and then in the last.
pub fn subdivide(cage: &Cage, levels: u32, stop: Stop<'_>) -> Result<TriangleMesh> {
    check(cage, levels)?;
    match cage {
        Cage::Loop(mesh) => refined::<3, Loop>(loop_scheme::surface(mesh)?, levels, stop),
        Cage::CatmullClark(mesh) => {
            refined::<4, CatmullClark>(catmull_clark::surface(mesh)?, levels.saturating_sub(1), stop)
        }
    }
}

/// [`subdivide`] in pieces of `most` triangles at most, or of one face.
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

fn refined<const N: u32, S: Scheme<N>>(
    mut surface: Surface<Sided<N>>,
    levels: u32,
    stop: Stop<'_>,
) -> Result<TriangleMesh> {
    for _ in 0..levels {
        ask(stop, 0)?;
        surface = S::divided(&surface);
        surface.find_first();
    }
    limit::<N, S>(&surface, stop)
}

/// The vertices of `surface` on the limit surface, with its normals; the triangles of each face in order.
fn limit<const N: u32, S: Scheme<N>>(surface: &Surface<Sided<N>>, stop: Stop<'_>) -> Result<TriangleMesh> {
    let mut mesh = TriangleMesh::default();
    let vertices = surface.positions.len();
    mesh.positions.reserve_exact(vertices + 1);
    mesh.normals.reserve_exact(vertices);
    let mut fan = Vec::new();
    for v in 0..vertices {
        ask(stop, v)?;
        surface.fan(v, &mut fan);
        let (p, [s, t]) = S::limit(surface, v, &fan);
        mesh.positions.push(p.to_array());
        mesh.normals.push(s.cross(t).normalize_or_zero().to_array());
    }
    let faces = surface.corners.chunks_exact(N as usize);
    mesh.indices.reserve_exact(faces.len() * Sided::<N>::TRIANGLES as usize);
    mesh.indices.extend(faces.flat_map(|f| (2..f.len()).map(|k| [f[0], f[k - 1], f[k]])));
    mesh.pad_positions();
    Ok(mesh)
}

fn check(cage: &Cage, levels: u32) -> Result<()> {
    let wanted = cage.triangles(levels);
    if wanted > Cage::MAX_TRIANGLES {
        return Err(fault(format!(
            "subdivision to {levels} levels makes {wanted} triangles; {} at most",
            Cage::MAX_TRIANGLES
        )));
    }
    Ok(())
}

fn fault(message: String) -> Error {
    Error::file("subdivision", message)
}

#[cfg(test)]
mod tests;
