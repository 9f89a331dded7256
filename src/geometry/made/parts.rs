//! Shapes that can be made part by part.
//!
//! Invariant: a part's triangles are those of the whole, in name, place and attributes, bit for bit, whatever else is made.

use crate::scene::TriangleMesh;

/// Most triangles of a shape that is made part by part: there are no more names.
pub(super) const MOST_NAMES: u64 = 1 << 30;

/// The least that is made by itself, and goes into one page.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    /// How many triangles it becomes.
    pub triangles: u32,
    /// Where it is, about, in the space of its control shape.
    pub centre: [f32; 3],
}

/// Triangles of some pieces, in rising order of their names.
#[derive(Default)]
pub struct Part {
    /// In the space of the control shape.
    pub mesh: TriangleMesh,
    /// What each is called in the whole.
    pub names: Vec<u32>,
}

/// A shape in pieces, which are numbered.
pub trait Parts: Send + Sync {
    /// The triangles of `pieces`, whose numbers rise.
    fn make(&self, pieces: &[u32]) -> Part;

    /// Bytes that it keeps beside the scene's description.
    fn bytes(&self) -> usize;

    /// Whether values of a texture were no numbers, in anything that has been made so far.
    fn not_numbers(&self) -> bool {
        false
    }
}

/// A shape in pieces, and all of these in the order of their numbers.
pub type InPieces = (Box<dyn Parts>, Vec<Piece>);
