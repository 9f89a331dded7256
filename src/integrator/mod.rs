//! (empty room)

pub mod light;
