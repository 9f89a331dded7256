//! Turns hits into radiance and new rays. Never waits for I/O, never asks which scheduler called.

pub mod bsdf;
pub mod camera;
pub mod cone;
mod draws;
pub mod flight;
pub mod kernel;
pub mod light;
pub mod lights;
pub mod lights_build;
pub mod materials;
mod media;
pub mod path;
pub mod sampler;
mod shade;
pub mod units;
