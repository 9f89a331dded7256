//! The one loop that joins the rooms. Holds no algorithm of its own.
//!
//! Invariant: the picture depends on the scene, the settings and the seed, never on the number of
//! threads or on which of them was faster.

mod balance;
mod frame;
mod identity;
mod job;
mod keeper;
mod load;
mod meanwhile;
pub(crate) mod plan;
mod rounds;
pub(crate) mod stage;
mod stream;

pub use frame::{Frames, with_frames};
pub use plan::plan;

use crate::error::Result;
use crate::film::Image;
use crate::scene::SceneDescription;
use crate::settings::RenderSettings;
use crate::stats::{MemoryWatch, RenderStats};
use std::sync::atomic::AtomicBool;

/// How a caller watches and stops a render.
pub struct Control<'a> {
    /// Set to stop at the next tile; what is done by then is the image.
    pub cancel: &'a AtomicBool,
    /// Told about progress, from any thread, a few times a second at most.
    pub progress: &'a (dyn Fn(Progress<'_>) + Sync),
    /// Told what memory to look at, if anybody wants it over time.
    pub watch: Option<&'a MemoryWatch>,
}

/// What is going on.
#[derive(Clone, Copy, Debug)]
pub enum Progress<'a> {
    /// A phase begins.
    Phase(&'static str),
    /// Bytes of tiled texture copies made, of how many.
    Converting {
        /// Done.
        done: u64,
        /// To do.
        total: u64,
    },
    /// Regions that have few enough errors or as many samples as they may, of how many; of rounds that decide who goes on.
    Regions {
        /// They get no more, unless one beside them turns out to be noisy.
        done: u64,
        /// All.
        total: u64,
        /// Camera samples so far.
        samples: u64,
    },
    /// A line that a person should read now, and not only when all is done.
    Warning(&'a str),
    /// Camera samples done, of how many.
    Samples {
        /// Done.
        done: u64,
        /// To do.
        total: u64,
    },
}

/// A finished (or interrupted) render.
pub struct Outcome {
    /// The image.
    pub image: Image,
    /// What it cost.
    pub stats: RenderStats,
    /// Whether it was stopped before its last sample.
    pub interrupted: bool,
    /// One line each: what a person should know though the image is as the scene wants it, such as
    /// textures' copies that were damaged and were made again.
    pub notes: Vec<String>,
    /// One line for each texture file of which some tile could not be read, and is magenta.
    pub unreadable: Vec<String>,
    /// Why there is no checkpoint of the picture, where one was asked for.
    pub unsaved: Option<String>,
}

/// Renders `scene`.
///
/// # Errors
/// A mesh or image that cannot be read, a crop outside the film, a backend that is not in this program
/// or runs out of memory.
pub fn render(scene: &SceneDescription, settings: &RenderSettings, control: &Control<'_>) -> Result<Outcome> {
    frame::render(scene, settings, control)
}
