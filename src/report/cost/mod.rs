//! What accuracy costs: the record of a study, as text and as one page.
//!
//! Invariant: as for a render's page: nothing is asked for, and every number is in the record.
//! Never measures.

mod page;
mod record;
mod text;

pub use page::cost_page;
pub use record::{AtTarget, Check, CostStudy, LeftOut, Picture, Point, Reference, Spread};
pub use text::{per_cent, write_cost};
