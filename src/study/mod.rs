//! Studies: what one image differs by from another, and scenes to study with. Never renders by itself.

pub mod diff;
pub mod generate;
