//! Shapes: parameters checked, arrays put into meshes. A mesh whose indices or counts do not fit is
//! an error at the parameter, so nothing later needs to check. Never opens a PLY file.

use super::curves::strand;
use super::params::{Params, Type};
use super::reader::{Item, Reader, index};
use super::state::MaterialRef;
use crate::error::{Error, Location, Result};
use crate::scene::{
    Cage, MaterialId, MeshId, MeshSource, PatchMesh, PatchMeshId, PolygonMesh, Shape, ShapeKind, TextureId,
    TriangleMesh,
};
use std::rc::Rc;
use std::sync::Arc;

const KINDS: [&str; 9] = [
    "sphere",
    "cylinder",
    "disk",
    "trianglemesh",
    "plymesh",
    "bilinearmesh",
    "loopsubdiv",
    "catmullclark",
    "curve",
];
const POINT3: &[Type] = &[Type::Point3];

/// Curves that are one surface, at most.
const MAX_STRANDS: usize = 1 << 16;

/// What a shape refers to by name, until the scene has been read.
pub(super) struct ShapeRefs {
    pub(super) material: MaterialRef,
    pub(super) inside: Rc<str>,
    pub(super) outside: Rc<str>,
    /// The list that holds `alpha`, without the arrays.
    pub(super) alpha: Option<Params>,
    /// Likewise `displacement`.
    pub(super) displacement: Option<Params>,
}

impl ShapeRefs {
    fn looks_like(&self, other: &Self) -> bool {
        let masked = self.alpha.is_some() || other.alpha.is_some();
        !masked
            && self.material == other.material
            && (&self.inside, &self.outside) == (&other.inside, &other.outside)
    }
}

/// Puts the curves of the last mesh to those of the one before, if `before` and `last` are these.
fn join(meshes: &mut Vec<MeshSource>, before: &ShapeKind, last: &ShapeKind) -> bool {
    let n = meshes.len();
    let at = |kind: &ShapeKind| if let ShapeKind::Mesh(id) = kind { Some(id.index() + 1) } else { None };
    if at(last) != Some(n) || at(before).map(|id| id + 1) != Some(n) {
        return false;
    }
    let [.., MeshSource::Curves(strands), MeshSource::Curves(more)] = &mut meshes[..] else { return false };
    let Some(strands) = Arc::get_mut(strands).filter(|strands| strands.len() < MAX_STRANDS) else {
        return false;
    };
    strands.extend_from_slice(more);
    meshes.pop();
    true
}

impl Reader {
    pub(super) fn shape(&mut self, item: Item) -> Result<()> {
        let p = &item.params;
        let mut kind = self.shape_kind(&item)?;
        let alpha = p.keep("alpha", &[Type::Float, Type::Texture]);
        let displacement = self.displaced(p, &mut kind)?;
        p.finish()?;
        let mut area_light = self.state.area_light;
        if area_light.is_some() && self.open_object.is_some() {
            let what =
                "area lights inside objects are not supported (pbrt-v4 has none either); the shape is dark";
            self.warnings.add(&p.at, what);
            area_light = None;
        }
        let shape = Shape {
            kind,
            object_to_world: *self.state.ctm,
            reverse_orientation: self.state.reverse_orientation,
            material: MaterialId(0),
            area_light,
            alpha: None,
            medium: None,
            at: p.at.clone(),
        };
        let refs = ShapeRefs {
            material: self.state.material.clone(),
            inside: self.state.inside.clone(),
            outside: self.state.outside.clone(),
            alpha,
            displacement,
        };
        let (shapes, all) = match self.open_object {
            Some(id) => (&mut self.scene.objects[id.index()], &mut self.object_refs[id.index()]),
            None => (&mut self.scene.shapes, &mut self.shape_refs),
        };
        // Hair is thousands of curves of one look: they are one surface.
        if let (Some(before), Some(refs_before)) = (shapes.last(), all.last())
            && refs.looks_like(refs_before)
            && before.object_to_world == shape.object_to_world
            && before.reverse_orientation == shape.reverse_orientation
            && before.area_light.is_none()
            && shape.area_light.is_none()
            && join(&mut self.scene.meshes, &before.kind, &shape.kind)
        {
            return Ok(());
        }
        shapes.push(shape);
        all.push(refs);
        Ok(())
    }

    fn subdivided(&mut self, p: &Params, cage: Cage, levels: u32) -> Result<ShapeKind> {
        let made = cage.triangles(levels);
        if made > Cage::MAX_TRIANGLES {
            let what = format!("{levels} levels make {made} triangles; choose fewer levels");
            return Err(p.error("levels", what));
        }
        Ok(ShapeKind::Mesh(self.mesh(MeshSource::Subdivision { cage, levels })?))
    }

    fn shape_kind(&mut self, item: &Item) -> Result<ShapeKind> {
        let p = &item.params;
        Ok(match &*item.name {
            "sphere" => {
                let radius = p.positive("radius", 1.0)?;
                let (z0, z1) = (p.float("zmin", -radius)?, p.float("zmax", radius)?);
                ShapeKind::Sphere {
                    radius,
                    z_min: z0.min(z1).clamp(-radius, radius),
                    z_max: z0.max(z1).clamp(-radius, radius),
                    phi_max_degrees: sweep(p)?,
                }
            }
            "cylinder" => {
                let (z0, z1) = (p.float("zmin", -1.0)?, p.float("zmax", 1.0)?);
                ShapeKind::Cylinder {
                    radius: p.positive("radius", 1.0)?,
                    z_min: z0.min(z1),
                    z_max: z0.max(z1),
                    phi_max_degrees: sweep(p)?,
                }
            }
            "disk" => ShapeKind::Disk {
                height: p.float("height", 0.0)?,
                radius: p.positive("radius", 1.0)?,
                inner_radius: p.float("innerradius", 0.0)?,
                phi_max_degrees: sweep(p)?,
            },
            "trianglemesh" => {
                let mesh = triangles(p)?;
                ShapeKind::Mesh(self.mesh(MeshSource::Inline(Arc::new(mesh)))?)
            }
            "loopsubdiv" => {
                p.choice("scheme", &[("loop", ())])?;
                let levels = p.int_in("levels", 3, 0..=14)?;
                let positions = positions(p)?;
                let Some((indices, at)) = p.ints("indices") else {
                    return Err(Error::at(
                        &p.at,
                        "loopsubdiv needs \"integer indices\"; give three a triangle",
                    ));
                };
                let indices = corners::<3>(indices, positions.len(), at)?;
                let mesh = TriangleMesh { positions, indices, ..TriangleMesh::default() };
                self.subdivided(p, Cage::Loop(Arc::new(mesh)), levels)?
            }
            "catmullclark" => {
                let levels = p.int_in("levels", 3, 1..=13)?;
                self.subdivided(p, Cage::CatmullClark(Arc::new(polygons(p)?)), levels)?
            }
            "plymesh" => {
                let Some((name, at)) = p.string("filename")? else {
                    return Err(Error::at(&p.at, "plymesh needs \"string filename\"; name a PLY file"));
                };
                let path = self.files.require(name, at)?;
                ShapeKind::Mesh(self.mesh(MeshSource::Ply(path))?)
            }
            "bilinearmesh" => {
                let mesh = patches(p)?;
                if p.string("emissionfilename")?.is_some() {
                    let what = "emission is not sampled by its image; uniform sampling stands in (noise, not brightness, differs)";
                    self.warnings.add(p.place("emissionfilename"), what);
                }
                let id = PatchMeshId(index(self.scene.patch_meshes.len())?);
                self.scene.patch_meshes.push(Arc::new(mesh));
                ShapeKind::Patches(id)
            }
            "curve" => {
                let strand = strand(p)?;
                ShapeKind::Mesh(self.mesh(MeshSource::Curves(Arc::new(vec![strand])))?)
            }
            _ => return Err(item.unknown("shape", "shapes", &KINDS)),
        })
    }

    /// Wraps the mesh of `kind` where the shape is displaced; pbrt-v4 displaces `plymesh` alone.
    fn displaced(&mut self, p: &Params, kind: &mut ShapeKind) -> Result<Option<Params>> {
        let ShapeKind::Mesh(id) = kind else { return Ok(None) };
        let source = &mut self.scene.meshes[id.index()];
        if matches!(source, MeshSource::Curves(_)) {
            return Ok(None);
        }
        let edge_length = match p.float_opt("displacement.edgelength")? {
            Some(length) if length.is_nan() || length <= 0.0 => {
                let what = format!("\"displacement.edgelength\" is {length}; it must be positive");
                return Err(p.error("displacement.edgelength", what));
            }
            length => length.map(|length| length * self.edge_scale),
        };
        let displacement = p.keep("displacement", &[Type::Texture]);
        if displacement.is_some() {
            let base = Box::new(std::mem::replace(source, MeshSource::Curves(Arc::default())));
            // The texture is not known before the scene ends.
            *source = MeshSource::Displaced { base, texture: TextureId(0), edge_length };
        }
        Ok(displacement)
    }

    fn mesh(&mut self, source: MeshSource) -> Result<MeshId> {
        let id = MeshId(index(self.scene.meshes.len())?);
        self.scene.meshes.push(source);
        Ok(id)
    }
}

fn sweep(p: &Params) -> Result<f32> {
    Ok(p.float("phimax", 360.0)?.clamp(0.0, 360.0))
}

fn positions(p: &Params) -> Result<Vec<[f32; 3]>> {
    match p.tuples::<3>("P", POINT3)? {
        Some((positions, _)) => Ok(positions),
        None => Err(Error::at(&p.at, "the shape needs \"point3 P\"; give its vertices")),
    }
}

/// Faces of four corners each, or of as many as "facevertexcounts" says.
fn polygons(p: &Params) -> Result<PolygonMesh> {
    let positions = positions(p)?;
    let Some((indices, at)) = p.ints("indices") else {
        return Err(Error::at(
            &p.at,
            "catmullclark needs \"integer indices\"; give the corners of each face",
        ));
    };
    let Some((counts, counts_at)) = p.ints("facevertexcounts") else {
        let quads = corners::<4>(indices, positions.len(), at)?;
        let ends = (1..=quads.len() as u32).map(|n| 4 * n).collect();
        return Ok(PolygonMesh { positions, corners: quads.into_flattened(), ends });
    };
    let corners = corners::<1>(indices, positions.len(), at)?.into_flattened();
    let mut end = 0u64;
    let mut ends = Vec::with_capacity(counts.len());
    for &count in counts {
        let count = u64::try_from(count).ok().filter(|n| *n >= 3).ok_or_else(|| {
            Error::at(counts_at, format!("a face of {count} corners; \"facevertexcounts\" are 3 or more"))
        })?;
        end += count;
        ends.push(end as u32);
    }
    if end != corners.len() as u64 {
        let what = format!(
            "\"facevertexcounts\" sum to {end}, and \"indices\" are {}; make them equal",
            corners.len()
        );
        return Err(Error::at(counts_at, what));
    }
    Ok(PolygonMesh { positions, corners, ends })
}

/// Indices by `N`, each below `vertices`.
fn corners<const N: usize>(indices: &[i32], vertices: usize, at: &Location) -> Result<Vec<[u32; N]>> {
    let (faces, rest) = indices.as_chunks::<N>();
    if !rest.is_empty() || faces.is_empty() {
        let n = indices.len();
        return Err(Error::at(at, format!("{n} indices; {N}, or a multiple of it, are needed")));
    }
    // One comparison finds both ends: a negative index is a huge unsigned one.
    let bound = u32::try_from(vertices).unwrap_or(u32::MAX);
    if let Some(bad) = indices.iter().find(|&&i| i.cast_unsigned() >= bound) {
        let last = vertices.saturating_sub(1);
        return Err(Error::at(at, format!("index {bad} is out of range; \"P\" has 0 to {last}")));
    }
    Ok(faces.iter().map(|f| f.map(i32::cast_unsigned)).collect())
}

/// Values a vertex each; empty when not given.
fn per_vertex<const N: usize>(
    p: &Params,
    name: &'static str,
    kinds: &'static [Type],
    vertices: usize,
) -> Result<Vec<[f32; N]>> {
    let Some((values, at)) = p.tuples::<N>(name, kinds)? else { return Ok(Vec::new()) };
    if values.len() != vertices {
        let n = values.len();
        return Err(Error::at(
            &at,
            format!("\"{name}\" has {n} entries and \"P\" has {vertices}; give as many"),
        ));
    }
    Ok(values)
}

fn triangles(p: &Params) -> Result<TriangleMesh> {
    p.accept(&["faceIndices"]);
    let positions = positions(p)?;
    let n = positions.len();
    let indices = match p.ints("indices") {
        Some((indices, at)) => corners::<3>(indices, n, at)?,
        None if n == 3 => vec![[0, 1, 2]],
        None => {
            return Err(Error::at(&p.at, "trianglemesh needs \"integer indices\"; give three a triangle"));
        }
    };
    Ok(TriangleMesh {
        normals: per_vertex(p, "N", &[Type::Normal], n)?,
        uvs: per_vertex(p, "uv", &[Type::Point2], n)?,
        tangents: per_vertex(p, "S", &[Type::Vector3], n)?,
        positions,
        indices,
    })
}

fn patches(p: &Params) -> Result<PatchMesh> {
    p.accept(&["faceIndices"]);
    let positions = positions(p)?;
    let n = positions.len();
    let indices = match p.ints("indices") {
        Some((indices, at)) => corners::<4>(indices, n, at)?,
        None if n == 4 => vec![[0, 1, 2, 3]],
        None => return Err(Error::at(&p.at, "bilinearmesh needs \"integer indices\"; give four a patch")),
    };
    Ok(PatchMesh {
        normals: per_vertex(p, "N", &[Type::Normal], n)?,
        uvs: per_vertex(p, "uv", &[Type::Point2], n)?,
        positions,
        indices,
    })
}
