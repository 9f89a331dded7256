//! Counters for people: text, and the attributes an image carries. Never measures anything.

mod attributes;
mod cache;
mod text;

pub use attributes::attributes;
pub use text::{bytes, count, seconds, write_text};
