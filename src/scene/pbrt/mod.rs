//! The pbrt-v4 scene language: text in, [`SceneDescription`] out, with pbrt's names, defaults and
//! units. The format: <https://pbrt.org/fileformat-v4>; where the document is silent, the sources of
//! pbrt-v4 decided. An error names file, line, column and what would be right; what the format
//! knows and Weir does not is a warning that names what stands in for it.
//!
//! Bounds, beyond which an error is given: 16 GiB of text a file, gzip at 400:1 (past 16 MiB), 64
//! files inside one another and 100,000 includes in all, 65,536 nested blocks, 1024 attributes in
//! force, 1024 parameters a directive. Memory is proportional to the text. Never loads a mesh or an
//! image, but a file that is named must exist.

mod curves;
mod directives;
mod film;
mod finish;
mod lexer;
mod lights;
mod materials;
mod media;
mod number;
mod options;
mod params;
mod reader;
mod shapes;
mod source;
mod spectra;
mod state;
mod suggest;
#[cfg(test)]
mod tests;
mod textures;
mod transforms;
mod warnings;

use crate::error::Result;
use crate::scene::SceneDescription;
use reader::Reader;
use source::Source;
use std::path::Path;

/// Reads a scene file, plain or gzip, and all that it includes.
///
/// # Errors
/// The file cannot be read, or what it says is wrong: then with file, line and column.
pub fn read_pbrt(path: &Path) -> Result<SceneDescription> {
    Reader::new(path).read(&Source::read(path, None)?)
}

/// Reads a scene from text; `path` names it in errors, and files it names are looked for beside that.
///
/// # Errors
/// As [`read_pbrt`].
pub fn parse_str(text: &str, path: &Path) -> Result<SceneDescription> {
    Reader::new(path).read(&Source::new(path, text.as_bytes().to_vec())?)
}
