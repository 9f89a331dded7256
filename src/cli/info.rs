//! `weir info`: what is in a scene, a mesh or an image. The kind follows from the extension.

mod image;
mod mesh;
mod scene;

use crate::cli::{End, print};
use clap::Args;
use std::path::PathBuf;
use weir::error::{Error, Result};

/// Options of `weir info`.
#[derive(Args)]
#[command(after_help = "Examples:\n  weir info scene.pbrt\n  weir info bunny.ply\n  weir info render.exr")]
pub(crate) struct Options {
    /// Scene (.pbrt, .pbrt.gz, .obj), mesh (.ply, .ply.gz) or image
    file: PathBuf,
}

/// Runs the command.
pub(crate) fn run(options: &Options) -> Result<End> {
    let path = &options.file;
    let name = path.to_string_lossy().to_ascii_lowercase();
    let kind = name.strip_suffix(".gz").unwrap_or(&name).rsplit('.').next().unwrap_or_default();
    let text = match kind {
        "pbrt" | "obj" => scene::describe(path)?,
        "ply" => mesh::describe(path)?,
        "exr" | "png" | "jpg" | "jpeg" | "tga" | "hdr" | "bmp" | "tif" | "tiff" | "tx" | "pfm" => {
            image::describe(path)?
        }
        _ => {
            // That it is missing says more than that its name is strange.
            std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
            return Err(Error::Usage(format!(
                "{}: not a kind that weir knows; a scene (.pbrt, .obj), a mesh (.ply) or an image (.exr, .png, \
                 .hdr, .pfm, .jpg, .tga, .bmp, .tif, .tx) is needed",
                path.display()
            )));
        }
    };
    print(&text)
}

/// Names with counts, in the order of first appearance: `3 sphere, 1 disk`.
fn tally<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let mut counts: Vec<(&str, usize)> = Vec::new();
    for name in names {
        match counts.iter_mut().find(|(n, _)| *n == name) {
            Some((_, count)) => *count += 1,
            None => counts.push((name, 1)),
        }
    }
    let parts: Vec<String> = counts.iter().map(|(name, count)| format!("{count} {name}")).collect();
    parts.join(", ")
}
