//! Counters for people: text, a page, and the attributes an image carries. Never measures anything.

mod attributes;
mod cache;
mod chart;
pub mod cost;
mod escape;
mod html;
mod text;

pub use attributes::attributes;
pub use html::html_page;
pub use text::{bytes, count, seconds, write_division, write_text};
