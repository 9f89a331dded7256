//! What is known of textures before they are evaluated.
//!
//! Invariant: a texture is made of earlier ones, so one walk along the table knows all.

use crate::color::Rgb;
use crate::scene::{Texture, TextureId};

/// What is known of a texture before it is evaluated.
#[derive(Clone, Copy, Debug, Default)]
pub struct KnownTexture {
    /// The value if it is the same everywhere.
    pub constant: Option<Rgb>,
    /// Whether anything below it filters over a footprint.
    pub wants_footprint: bool,
    /// Nodes that an evaluation visits.
    pub nodes: u64,
}

/// For each texture of the table.
#[must_use]
pub fn known_textures(nodes: &[Texture]) -> Vec<KnownTexture> {
    let mut known: Vec<KnownTexture> = Vec::with_capacity(nodes.len());
    for node in nodes {
        let of = |t: TextureId| known.get(t.index()).copied().unwrap_or_default();
        known.push(know(node, of));
    }
    known
}

fn know(node: &Texture, part: impl Fn(TextureId) -> KnownTexture) -> KnownTexture {
    let join = |parts: &[KnownTexture], own: bool, constant: Option<Rgb>| KnownTexture {
        constant,
        wants_footprint: own || parts.iter().any(|p| p.wants_footprint),
        nodes: parts.iter().fold(1, |n, p| n.saturating_add(p.nodes)),
    };
    match node {
        Texture::Constant(c) => join(&[], false, Some(*c)),
        Texture::Bilerp { .. } => join(&[], false, None),
        Texture::Image { .. } => join(&[], true, None),
        Texture::Scale { texture, scale } => {
            let (a, b) = (part(*texture), part(*scale));
            join(&[a, b], false, a.constant.zip(b.constant).map(|(a, b)| a * b))
        }
        Texture::Mix { a, b, amount } => {
            let parts = [part(*a), part(*b), part(*amount)];
            let constant = match parts.map(|p| p.constant) {
                [Some(a), Some(b), Some(t)] => Some(mix(a, b, t)),
                _ => None,
            };
            join(&parts, false, constant)
        }
        Texture::DirectionMix { a, b, .. } | Texture::Checkerboard3d { a, b, .. } => {
            join(&[part(*a), part(*b)], false, None)
        }
        // The checkerboard itself is filtered over the footprint.
        Texture::Checkerboard { a, b, .. } => join(&[part(*a), part(*b)], true, None),
    }
}

/// A blend of two values.
#[inline(always)]
#[must_use]
pub fn mix(a: Rgb, b: Rgb, amount: Rgb) -> Rgb {
    a * (Rgb::ONE - amount) + b * amount
}
