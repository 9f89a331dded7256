//! Turns hits into radiance and new rays. Never waits for I/O, never asks which scheduler called.

pub mod bsdf;
