//! What a scene file says: flat tables, typed ids, no pixels and no vertices beyond what a file
//! forces. Readers fill it; nothing here loads, traces or shades.

pub mod curve;
pub mod description;
pub mod mesh;
pub mod obj;
pub mod pbrt;
pub mod ply;
mod polygon;
mod view;

pub use curve::*;
pub use description::*;
pub use mesh::*;

use crate::error::{Error, Result};
use std::path::Path;

/// Reads a scene by what its name says it is.
///
/// # Errors
/// The reader's own, or that the name is none that Weir reads.
pub fn load(path: &Path) -> Result<SceneDescription> {
    let name = path.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    let named = |endings: &[&str]| endings.iter().any(|e| name.ends_with(e));
    if named(&[".pbrt", ".pbrt.gz"]) {
        pbrt::read_pbrt(path)
    } else if named(&[".obj"]) {
        obj::read_obj(path)
    } else if named(&[".ply", ".ply.gz"]) {
        ply::read_ply_scene(path)
    } else {
        Err(Error::file(path, "not a scene that Weir reads; .pbrt, .pbrt.gz, .obj, .ply and .ply.gz are"))
    }
}
