//! Meshes that do not stay: cut into pages on disk, or made page by page, which are resident while rays need them and memory
//! lasts. A page holds its triangles, their tree and their attributes, and is used as it lies in memory, without parsing.
//!
//! Invariant: a page's triangles are those of the mesh, bit for bit, so that the picture does not depend on what was
//! resident. Never decides which meshes are paged: the loader does.

mod cache;
mod collect;
#[cfg(test)]
mod cut_tests;
mod cutter;
mod disk;
mod file;
mod files;
mod format;
mod looks;
mod make;
mod memory;
mod residents;
mod scratch;
mod share;
mod slots;
mod sort;
mod store;
mod tessellate;
#[cfg(test)]
mod tests;

pub use files::least_page_budget;
pub use make::check_page_budget;
pub use store::{HeldPages, PageStore};

pub use file::PagedMesh;

pub(super) use files::PageSource;
pub(super) use make::{Made, PageMaker, Source};
pub(super) use tessellate::Tessellated;

/// Bytes of a page unless told otherwise: some 900 triangles, a read of 20 µs.
pub const DEFAULT_PAGE_BYTES: usize = 64 << 10;
/// Least bytes of a page.
pub const LEAST_PAGE_BYTES: usize = 4 << 10;
/// Most bytes of a page: more triangles than places can name would not fill it.
pub const MOST_PAGE_BYTES: usize = 128 << 10;
