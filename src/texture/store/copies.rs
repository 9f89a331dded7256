//! Tiled copies of plain images, for scenes whose images do not all fit.
//!
//! Invariant: a copy stands for its source to the bit. Never decides which images need one.

use super::find::placed;
use super::{Found, TextureOptions};
use crate::error::{Error, Result};
use crate::scene::ImageSource;
use crate::texture::cache_dir::{self, Converted};
use crate::texture::convert::Watch;
use crate::texture::tiled::{FilePool, TiledFile};
use crate::texture::tiles::TiledImage;
use std::path::Path;
use std::sync::Arc;

/// Puts tiled copies in the place of the images in `copies`, making those that are not there. Each
/// conversion uses all of the render's threads.
pub(super) fn convert(
    mut found: Vec<Found>,
    copies: &[bool],
    sources: &[ImageSource],
    files: &Arc<FilePool>,
    options: &TextureOptions,
    watch: Watch<'_>,
) -> Result<(Vec<Found>, Vec<String>)> {
    if !copies.contains(&true) {
        return Ok((found, Vec::new()));
    }
    let dir = options.cache_dir.clone().map_or_else(cache_dir::default_dir, Ok)?;
    let total: u64 = found.iter().zip(copies).filter(|(_, copy)| **copy).map(|(f, _)| f.bytes()).sum();
    let mut before = 0;
    let mut notes = Vec::new();
    for ((found, source), _) in found.iter_mut().zip(sources).zip(copies).filter(|(_, copy)| **copy) {
        let own = found.bytes();
        let report = |rows: u64, of: u64| {
            (watch.progress)(before + (own as f64 * rows as f64 / of.max(1) as f64) as u64, total);
        };
        let Found::Plain { encoding, .. } = *found else { continue };
        let watch = Watch { progress: &report, ..watch };
        let copy = cache_dir::converted(&dir, &source.path, encoding, options.threads, watch);
        let copy = copy.map_err(placed(source))?;
        before += own;
        notes.extend(notes_on(&copy, &source.path));
        let file = match TiledFile::open(&copy.path, encoding, files) {
            Ok(Some(file)) if TiledImage::is_complete(&file) => Box::new(file),
            Err(e @ Error::Io { .. }) => return Err(e),
            // The scene is not to blame, and only a person may delete what is not ours for certain.
            Ok(_) | Err(_) => {
                let path = copy.path.display();
                let message = "this tiled copy is damaged; delete it, and the next render makes it again";
                return Err(Error::Resource(format!("{path}: {message}")));
            }
        };
        *found = Found::Tiled { file, opaque: false };
    }
    Ok((found, notes))
}

/// What a person should know of a copy.
fn notes_on(copy: &Converted, source: &Path) -> Vec<String> {
    let mut notes = Vec::new();
    if copy.remade {
        let (path, source) = (copy.path.display(), source.display());
        notes.push(format!("{path}: this tiled copy was damaged; made again from {source}"));
    }
    if copy.replaced > 0 {
        let (source, n) = (source.display(), copy.replaced);
        let texels = if n == 1 { "texel is" } else { "texels are" };
        notes.push(format!("{source}: {n} {texels} infinite or not a number; 0 or 65504 stands in"));
    }
    notes
}
