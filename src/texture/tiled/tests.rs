//! Tiled files.
