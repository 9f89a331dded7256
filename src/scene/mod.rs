//! What a scene file says: flat tables, typed ids, no pixels and no vertices beyond what a file
//! forces. Readers fill it; nothing here loads, traces or shades.

pub mod description;
pub mod mesh;
pub mod obj;
pub mod pbrt;
pub mod ply;
mod polygon;

pub use description::*;
pub use mesh::*;
