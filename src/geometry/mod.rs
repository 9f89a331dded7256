//! (empty room)

pub mod loop_subdivision;
