//! Wavefront OBJ with MTL into a whole scene: `tobj` parses, we make its input safe and exact.
//! `clean` checks every line (so that errors have line and column, which tobj's have not),
//! triangulates concave polygons, and splits faces that have normals or texture coordinates from
//! those that have none; `material` turns MTL into our materials; `scene::view` adds what OBJ cannot
//! say: camera, sky and sun.
//!
//! MTL is read the way its users expect:
//! - `Kd` × `map_Kd` is the albedo; black `Kd` beside a texture counts as white.
//! - `Ks` with `Ns` ≥ 10 and illum ≥ 2 is a clear coat over it, α = √(2/(Ns+2)); with black `Kd`,
//!   or illum 3 or 5, or `Pm` ≥ ½ it is a metal. `Pr` overrides `Ns`.
//! - illum 6, 7, 9, illum 4 with `d` < 1 or black `Kd`, or `d` < 0.1 is smooth glass of index `Ni`.
//! - Else `d` (or 1 − `Tr`) and `map_d` are opacity. `Ke` and `map_Ke` emit on both sides.
//! - What is missing or unknown is a warning, and grey stands in.
//!
//! Invariant: memory stays within a constant times the file's bytes. Never reads pixels.

mod clean;
mod material;

use crate::error::{Error, Location, Result};
use crate::open::open_regular;
use crate::scene::{
    AreaLightId, MaterialId, MeshId, MeshSource, SceneDescription, Shape, ShapeKind, TriangleMesh, Warning,
    view,
};
use clean::Cleaner;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Most bytes of an OBJ or MTL file.
const MAX_FILE_BYTES: u64 = 4 << 30;

/// Reads the scene in `path`, a model with a camera that frames it and a soft sky.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Input`] with line and column when it is
/// damaged, has no faces, or is not text.
pub fn read_obj(path: &Path) -> Result<SceneDescription> {
    let bytes = read_bounded(path)?;
    let mut warnings = Vec::new();
    let libraries = clean::find_libraries(path, &bytes, &mut warnings);
    let mut library = material::Library::default();
    for file in &libraries {
        match read_bounded(file) {
            Ok(text) => library.add(file, &text, &mut warnings)?,
            Err(e) => warn(&mut warnings, path, format!("material library {e}; grey stands in")),
        }
    }
    let mut cleaner = Cleaner::new(path, &bytes, &library);
    let options =
        tobj::LoadOptions { single_index: true, triangulate: true, ignore_points: true, ignore_lines: true };
    // The cleaner writes `usemtl NUMBER`; tobj is to hand the number back as the material's index.
    let names = cleaner.material_numbers();
    let parsed = tobj::load_obj_buf(&mut cleaner, &options, |_| Ok(names.clone()));
    if let Some(error) = cleaner.error.take() {
        return Err(error);
    }
    let (models, _) = parsed.map_err(|e| Error::file(path, format!("damaged: {e}")))?;
    warnings.append(&mut cleaner.warnings);
    let groups = merge(models);
    if groups.is_empty() {
        return Err(Error::file(path, "no faces; a face is `f` and three or more vertex numbers"));
    }

    let mut scene = SceneDescription { path: path.to_path_buf(), ..SceneDescription::default() };
    let mut used = vec![None; library.len() + 1];
    for (number, mesh) in groups {
        let number = number.min(library.len());
        let surface =
            *used[number].get_or_insert_with(|| library.realise(number, path, &mut scene, &mut warnings));
        let mesh_id = MeshId(scene.meshes.len() as u32);
        scene.meshes.push(MeshSource::Inline(Arc::new(mesh)));
        scene.shapes.push(Shape {
            kind: ShapeKind::Mesh(mesh_id),
            object_to_world: crate::math::Transform::IDENTITY,
            reverse_orientation: false,
            material: surface.material,
            area_light: surface.area_light,
            alpha: surface.alpha,
            medium: None,
            at: Location::whole(path),
        });
    }
    view::add_camera_and_lights(&mut scene);
    scene.warnings = warnings;
    Ok(scene)
}

/// What a material number became.
#[derive(Clone, Copy)]
struct Surface {
    material: MaterialId,
    area_light: Option<AreaLightId>,
    alpha: Option<crate::scene::TextureId>,
}

fn warn(warnings: &mut Vec<Warning>, file: &Path, message: impl Into<String>) {
    let warning = Warning { at: Location::whole(file), message: message.into() };
    // Hundreds of materials may share one cause.
    if !warnings.contains(&warning) && warnings.len() < 1000 {
        warnings.push(warning);
    }
}

fn read_bounded(path: &Path) -> Result<Vec<u8>> {
    let io = |e| Error::io(path, e);
    let Some(file) = open_regular(path).map_err(io)? else {
        return Err(Error::file(path, "not a regular file; an OBJ or MTL file is needed"));
    };
    let size = file.metadata().map_err(io)?.len();
    if size > MAX_FILE_BYTES {
        return Err(Error::file(path, format!("larger than {MAX_FILE_BYTES} bytes")));
    }
    let mut bytes = Vec::with_capacity(size as usize);
    file.take(MAX_FILE_BYTES).read_to_end(&mut bytes).map_err(io)?;
    Ok(bytes)
}

/// One mesh for each material and kind of vertex, in the order of first use.
fn merge(models: Vec<tobj::Model>) -> Vec<(usize, TriangleMesh)> {
    let mut slots = std::collections::HashMap::new();
    let mut groups: Vec<(usize, TriangleMesh)> = Vec::new();
    for tobj::Mesh { positions, normals, texcoords, indices, material_id, .. } in
        models.into_iter().map(|m| m.mesh)
    {
        if indices.is_empty() {
            continue;
        }
        let number = material_id.unwrap_or(usize::MAX);
        let key = (number, normals.is_empty(), texcoords.is_empty());
        let slot = *slots.entry(key).or_insert_with(|| {
            groups.push((number, TriangleMesh::default()));
            groups.len() - 1
        });
        let mesh = &mut groups[slot].1;
        let base = mesh.positions.len() as u32;
        // tobj's columns are flat; `clean` has made sure that each vertex has all or none.
        mesh.positions.extend_from_slice(bytemuck::cast_slice(&positions));
        mesh.normals.extend_from_slice(bytemuck::cast_slice(&normals));
        mesh.uvs.extend_from_slice(bytemuck::cast_slice(&texcoords));
        mesh.indices.extend(indices.chunks_exact(3).map(|t| [t[0] + base, t[1] + base, t[2] + base]));
    }
    for (_, mesh) in &mut groups {
        mesh.pad_positions();
    }
    groups
}

/// Finds `name`, as written by any system, in one of `folders`: as it stands, then its last part
/// alone, each also with other upper and lower case.
fn find_file(name: &str, folders: &[&Path]) -> Option<PathBuf> {
    let name = name.trim().trim_matches('"').replace('\\', "/");
    // A Windows drive is a folder nobody has here.
    let name = name.split_once(":/").map_or(name.as_str(), |(_, rest)| rest);
    if name.is_empty() || name.contains('\0') {
        return None;
    }
    let last = name.rsplit('/').next().unwrap_or(name);
    let absolute = Path::new(name);
    if absolute.is_absolute() && absolute.is_file() {
        return Some(absolute.to_path_buf());
    }
    for candidate in [name.trim_start_matches('/'), last] {
        for folder in folders {
            let path = folder.join(candidate);
            if path.is_file() {
                return Some(path);
            }
            if let Some(path) = ignoring_case(folder, candidate) {
                return Some(path);
            }
        }
    }
    None
}

fn ignoring_case(folder: &Path, relative: &str) -> Option<PathBuf> {
    let mut path = folder.to_path_buf();
    for part in relative.split('/').filter(|p| !p.is_empty() && *p != ".") {
        if part == ".." || path.join(part).exists() {
            path.push(part);
            continue;
        }
        let here = if path.as_os_str().is_empty() { Path::new(".") } else { &path };
        let mut names: Vec<_> = std::fs::read_dir(here)
            .ok()?
            .filter_map(|entry| Some(entry.ok()?.file_name()))
            .filter(|n| n.to_string_lossy().to_lowercase() == part.to_lowercase())
            .collect();
        // The folder's own order is not repeatable.
        names.sort();
        path.push(names.first()?);
    }
    path.is_file().then_some(path)
}

#[cfg(test)]
mod tests;
