//! The native bounding volume hierarchy: what Embree answers, answered by our own code, for machines without
//! Embree and to keep Embree honest.
//!
//! Invariant: the answer to a ray depends on the ray and the primitives, never on the shape of the tree, its form
//! or the order of traversal: of all hits the nearest counts, and of those at one distance the one with the
//! smallest (instance, geometry, primitive). No ray passes between two triangles that share an edge.
//! Never: keeps a reference to vertices of triangles; they are copied into the leaves.

mod bins;
mod build;
mod collapse;
mod cut;
mod leaves;
mod memory;
mod nodes;
mod outline;
mod page;
mod part;
mod plain;
mod primitives;
mod query;
mod scene;
#[cfg(test)]
mod tests;
mod tree;
mod triangle;
#[cfg(target_arch = "x86_64")]
mod wide;

pub use build::BuildSettings;
pub use cut::{Centre, Spread, cut, left_of};
pub use nodes::Form;
pub use outline::Outline;
pub use page::{MAX_TRIANGLES, PageTree, PageView};
pub use query::Work;
pub use scene::BvhScene;
