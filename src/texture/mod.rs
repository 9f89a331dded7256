//! Images and their filtered look-up. [`TextureStore::lookup`] is the only door that shading uses:
//! behind it are whole images in memory, or tiles that come and go inside a number of bytes. Never
//! decides what is needed; `prepare` says so by [`ImageNeeds`](crate::prepare::ImageNeeds).

mod attached;
pub mod cache;
pub mod cache_dir;
mod contain;
pub mod convert;
mod encoding;
mod eval;
mod exr_in;
mod filter;
mod image_io;
mod open;
mod pfm;
mod pyramid;
mod rules;
mod store;
mod texels;
mod tiled;
mod tiles;

pub use attached::Attached;
pub use eval::{TextureCoordinates, Textures};
pub use filter::{Footprint, Sampler, random_bits};
pub use image_io::{ImageData, MAX_DECODED_BYTES, MAX_SIDE, Pixels, read_image};
pub use store::{Survey, TextureOptions, TextureStore, image_size};
pub(crate) use tiled::RawFile;
pub use tiled::{
    Caching, Component, DEFAULT_OPEN_FILES, FilePool, TileLevel, TileScratch, TiledFile, open_file_limit,
};
pub use tiles::Probe;
