//! What parts of a render gave each other of their memory while it ran.
//!
//! Invariant: plain data; never decides.

use serde::{Deserialize, Serialize};

/// One gave and the other got.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MemoryMove {
    /// Seconds since rendering began.
    pub at_s: f64,
    /// Who got it: `textures` or `geometry`; the other of these gave it.
    pub to: String,
    /// How many bytes.
    pub bytes: u64,
    /// What tiles of textures may take since.
    pub textures: u64,
    /// What pages of geometry may take since.
    pub pages: u64,
    /// Seconds of reading that this was expected to save, in each second of rendering, of all threads together.
    pub saves: f64,
}
