//! Studies: what one image differs by from another. Never renders by itself.

pub mod diff;
