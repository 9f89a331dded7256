//! How much memory textures may take, and what stands in for the rest. Plain data.

use crate::texture::tiled::Caching;
use std::path::PathBuf;
use std::time::Duration;

/// How much memory textures may take, and what stands in for the rest.
#[derive(Clone, Debug)]
pub struct TextureOptions {
    /// Bytes of all texels in memory. Environment maps are read elsewhere and do not count.
    pub budget: u64,
    /// Threads that look up at the same time, at most.
    pub threads: usize,
    /// Where tiled copies of plain images are kept.
    pub cache_dir: Option<PathBuf>,
    /// A read takes at least so long: slow storage, simulated.
    pub latency: Duration,
    /// What becomes of the bytes that are read, in the operating system's memory.
    pub caching: Caching,
}

impl Default for TextureOptions {
    fn default() -> Self {
        Self {
            budget: u64::MAX,
            threads: 1,
            cache_dir: None,
            latency: Duration::ZERO,
            caching: Caching::Borrow,
        }
    }
}
