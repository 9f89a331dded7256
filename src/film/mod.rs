//! Pixels: where in a pixel a sample falls (`filter`), the sums it leaves (`image`), and the files
//! they become (`write`). Never traces, never asks who rendered the samples.

pub mod buffer;
pub mod checkpoint;
mod error;
pub mod filter;
pub mod image;
mod kept;
pub mod read;
pub mod write;

pub use crate::replace;
pub use buffer::{FilmBuffer, TILE};
pub use error::{LEAST_PASSES, REL_MSE_EPSILON, TileError};
pub use filter::FilterSampler;
pub use image::Image;
pub use kept::{Keeps, PASS, Progress};
