//! Weir: an out-of-core CPU path tracer that shows what it cost.
//!
//! `ARCHITECTURE.md` beside this file is the map: the life of a ray, the rooms, and which may
//! import which. This file only opens the doors.

pub mod accel;
pub mod clock;
pub mod color;
pub mod error;
pub mod film;
pub mod geometry;
pub mod integrator;
pub mod math;
pub mod open;
pub mod permits;
pub mod prepare;
pub mod render;
pub mod replace;
pub mod report;
pub mod scene;
pub mod schedule;
pub mod settings;
pub mod stats;
pub mod study;
pub mod texture;
