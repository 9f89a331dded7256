//! Images in memory and their filtered lookup. [`TextureStore::lookup`] is the only door that
//! shading uses: what is behind it (today whole decoded images, later a tiled cache) may change
//! without anyone noticing. Never decides what is needed; `prepare` says so by
//! [`ImageNeeds`](crate::prepare::ImageNeeds).

pub mod cache_dir;
mod contain;
pub mod convert;
mod encoding;
mod eval;
mod exr_in;
mod filter;
mod image_io;
mod pfm;
mod pyramid;
mod rules;
mod store;
mod texels;

pub use eval::{TextureCoordinates, Textures};
pub use filter::{Footprint, Sampler};
pub use image_io::{ImageData, MAX_DECODED_BYTES, MAX_SIDE, Pixels, read_image};
pub use store::TextureStore;
