//! Studies: what accuracy costs, what one image differs by from another, what one traversal does, and scenes to study
//! with. Never traces a path by itself.

pub mod compare;
pub mod cost;
pub mod diff;
pub mod generate;
