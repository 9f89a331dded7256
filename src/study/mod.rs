//! Studies: what one image differs by from another, what one traversal does, and scenes to study with. Never renders an
//! image by itself.

pub mod compare;
pub mod diff;
pub mod generate;
