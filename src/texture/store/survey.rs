//! What the headers of a scene's images tell, before any texel is read.
//!
//! Invariant: each file is looked at once; who loads the images afterwards takes what was found from here.
//! Never decodes an image, never makes a copy of one.

use super::find::{self, Found};
use crate::error::Result;
use crate::prepare::ImageNeeds;
use crate::scene::ImageSource;
use crate::texture::cache::least_budget;
use crate::texture::convert::TILE;
use crate::texture::image_io::{self, Kept};
use crate::texture::tiled::{Caching, FilePool, open_file_limit};
use crate::texture::tiles::TiledImage;
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;

/// Images by id, looked at and not loaded.
pub struct Survey {
    pub(super) found: Vec<Found>,
    /// What a person should know of a file.
    pub(super) said: Vec<Option<String>>,
    pub(super) files: Arc<FilePool>,
}

impl Survey {
    /// Looks at the images that are used. `sources` and `needs` are parallel tables.
    ///
    /// # Errors
    /// The first image, in the order of `sources`, that cannot be read.
    ///
    /// # Panics
    /// If the tables differ in length.
    pub fn new(sources: &[ImageSource], needs: &[ImageNeeds], caching: Caching) -> Result<Self> {
        assert_eq!(sources.len(), needs.len(), "one need per image");
        let files = Arc::new(FilePool::new(open_file_limit(), caching));
        let found: Vec<Result<(Found, Option<String>)>> =
            sources.par_iter().zip(needs).map(|(source, need)| find::find(source, *need, &files)).collect();
        let (found, said) = found.into_iter().collect::<Result<Vec<_>>>()?.into_iter().unzip();
        Ok(Self { found, said, files })
    }

    /// Bytes of all levels of all images, decoded: of plain images as they are in memory. Where only the texels tell
    /// how an image is kept (floats that are halves, grey with an alpha that says nothing), the most.
    #[must_use]
    pub fn all_bytes(&self) -> u64 {
        let bytes = |found: &Found| match found {
            Found::Tiled { file, .. } => TiledImage::bytes_of(file),
            other => other.bytes(),
        };
        self.found.iter().map(bytes).fold(0, u64::saturating_add)
    }

    /// Whether some of them are tiled files.
    #[must_use]
    pub fn has_tiled_files(&self) -> bool {
        self.found.iter().any(|found| matches!(found, Found::Tiled { .. }))
    }

    /// Whether they can be had in `budget` bytes with `threads` that look up at once, as far as is known before any is
    /// decoded: where a tiled copy is to be made of one, nothing is said, since only its texels tell how large its tiles are.
    ///
    /// # Errors
    /// That of [`TextureStore::load`](crate::texture::TextureStore::load) when `budget` is too small.
    pub fn check(&self, budget: u64, threads: usize) -> Result<()> {
        let (whole, room) = (find::whole_bytes(&self.found), find::tile_room(&self.found, threads));
        let may_tile = |found: &Found| matches!(found, Found::Plain { may_tile: true, .. });
        if budget >= whole.saturating_add(room) || self.found.iter().any(may_tile) {
            return Ok(());
        }
        Err(find::too_small(budget, threads, whole, room))
    }

    /// Least bytes that they work in, with `threads` that look up at once: what is needed whole, and tiles of the rest.
    #[must_use]
    pub fn least_bytes(&self, threads: usize) -> u64 {
        let tile = |found: &Found| match found {
            Found::Unused | Found::Plain { may_tile: false, .. } => None,
            Found::Plain { texel_bytes, .. } => Some((TILE * TILE) as usize * texel_bytes),
            Found::Tiled { file, .. } => Some(file.tile_bytes()),
        };
        let whole = |found: &Found| if tile(found).is_none() { found.bytes() } else { 0 };
        let whole = self.found.iter().map(whole).fold(0, u64::saturating_add);
        let tiles = self.found.iter().filter_map(tile).max().map_or(0, |tile| least_budget(tile, threads));
        whole.saturating_add(tiles)
    }
}

/// Width and height in pixels of the image in `path`; `None` where its header does not say.
#[must_use]
pub fn image_size(path: &Path) -> Option<(u32, u32)> {
    image_io::kept(path).ok()?.map(|Kept { width, height, .. }| (width, height))
}
