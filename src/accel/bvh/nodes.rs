//! The nodes of a tree in either form, and the traversal that fits the processor.
//!
//! Invariant: nothing compiled for AVX2 runs before a look at the processor.

use super::collapse::widen;
use super::memory::Frozen;
use super::plain::{self, Leaves};
use super::query::{Query, Work};
use super::tree::{Node, Wide};
#[cfg(target_arch = "x86_64")]
use super::wide;

/// How a tree is laid out. The answers are the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Two children a node, any processor.
    Plain,
    /// Eight, for x86-64 with AVX2 and FMA.
    Wide,
}

impl Form {
    /// The fastest that this processor runs.
    #[must_use]
    pub fn best() -> Self {
        if Fma::detect().is_some() { Self::Wide } else { Self::Plain }
    }
}

/// Says that the processor has all that [`wide::traverse`] and [`plain::traverse_fma`] are compiled for.
#[derive(Clone, Copy)]
pub(super) struct Fma(());

impl Fma {
    /// If it is so.
    pub(super) fn detect() -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            let all = has!("avx2")
                && has!("fma")
                && has!("bmi1")
                && has!("bmi2")
                && has!("lzcnt")
                && has!("popcnt");
            all.then_some(Self(()))
        }
        #[cfg(not(target_arch = "x86_64"))]
        None
    }
}

/// Nodes.
pub(super) enum Nodes {
    Plain(Frozen<Node>),
    Wide(Frozen<Wide>),
}

impl Nodes {
    pub(super) fn new(nodes: Vec<Node>, form: Form) -> Self {
        match form {
            Form::Plain => Self::Plain(Frozen::new(nodes)),
            Form::Wide => Self::Wide(Frozen::new(widen(&nodes))),
        }
    }

    pub(super) fn bytes(&self) -> usize {
        match self {
            Self::Plain(nodes) => nodes.bytes(),
            Self::Wide(nodes) => nodes.bytes(),
        }
    }

    #[cfg(test)]
    pub(super) fn image(&self) -> &[u8] {
        match self {
            Self::Plain(nodes) => bytemuck::cast_slice(nodes.elements()),
            Self::Wide(nodes) => bytemuck::cast_slice(nodes.elements()),
        }
    }

    /// Visits the leaves that `query` meets within `t_max`.
    #[inline(always)]
    pub(super) fn traverse<const COUNT: bool, const ORDERED: bool>(
        &self,
        fma: Option<Fma>,
        query: &Query,
        t_max: f32,
        work: &mut Work,
        leaves: &mut impl Leaves,
    ) {
        match self {
            Self::Wide(nodes) => {
                traverse_wide::<COUNT, ORDERED>(fma, nodes.elements(), query, t_max, work, leaves);
            }
            #[cfg(target_arch = "x86_64")]
            Self::Plain(nodes) if fma.is_some() => {
                // SAFETY: `Fma` is made only where every feature has been found.
                unsafe { plain::traverse_fma::<COUNT>(nodes.elements(), query, t_max, work, leaves) }
            }
            Self::Plain(nodes) => plain::traverse::<COUNT>(nodes.elements(), query, t_max, work, leaves),
        }
    }
}

/// [`Nodes::traverse`] of wide nodes that lie anywhere.
#[inline(always)]
pub(super) fn traverse_wide<const COUNT: bool, const ORDERED: bool>(
    fma: Option<Fma>,
    nodes: &[Wide],
    query: &Query,
    t_max: f32,
    work: &mut Work,
    leaves: &mut impl Leaves,
) {
    #[cfg(target_arch = "x86_64")]
    if fma.is_some() {
        // SAFETY: `Fma` is made only where every feature has been found.
        return unsafe { wide::traverse::<COUNT, ORDERED>(nodes, query, t_max, work, leaves) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = fma;
    plain::traverse_wide::<COUNT>(nodes, query, t_max, work, leaves);
}
