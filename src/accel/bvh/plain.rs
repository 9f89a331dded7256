//! Traversal one box at a time: of the plain form, depth first and nearer child first, and of the wide form for
//! processors without its instructions.
//!
//! Invariant: never misses a leaf that the wide form would enter; both compute boxes alike.

use super::query::{Query, Work};
use super::tree::{Child, Node, WIDTH, Wide};

/// What happens at leaves.
pub(super) trait Leaves {
    /// Looks at `count` primitives (blocks) from `start` on; the farthest distance that counts from here on.
    /// Below every distance: nothing does.
    fn visit(&mut self, start: usize, count: usize, t_max: f32) -> f32;

    /// Told what may soon be visited: `count` primitives (blocks) from `start` on.
    fn prefetcher(&self) -> impl Fn(usize, usize) + use<Self> {
        |_, _| {}
    }
}

/// Deepest plain tree that a builder makes.
pub(super) const MAX_DEPTH: usize = 96;

/// Visits the leaves that `query` meets within `t_max`.
#[inline(always)]
pub(super) fn traverse<const COUNT: bool>(
    nodes: &[Node],
    query: &Query,
    mut t_max: f32,
    work: &mut Work,
    leaves: &mut impl Leaves,
) {
    let mut stack = [0u32; MAX_DEPTH];
    let mut height = 0;
    let mut at = 0usize;
    if nodes.is_empty() {
        return;
    }
    loop {
        let node = &nodes[at];
        if COUNT {
            work.nodes += 1;
        }
        let (near, far) = query.inside(node.lo, node.hi, t_max);
        if near <= far {
            if node.count() == 0 {
                let (first, second) = (at + 1, node.next as usize);
                let turned = query.negative[node.axis()] == 1;
                at = if turned { second } else { first };
                stack[height] = if turned { first as u32 } else { second as u32 };
                height += 1;
                continue;
            }
            if COUNT {
                work.leaves += 1;
            }
            t_max = leaves.visit(node.next as usize, node.count() as usize, t_max);
            if t_max == f32::NEG_INFINITY {
                return;
            }
        }
        if height == 0 {
            return;
        }
        height -= 1;
        at = stack[height] as usize;
    }
}

/// [`traverse`] compiled for processors that multiply and add at once; others call a function for it.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
pub(super) fn traverse_fma<const COUNT: bool>(
    nodes: &[Node],
    query: &Query,
    t_max: f32,
    work: &mut Work,
    leaves: &mut impl Leaves,
) {
    traverse::<COUNT>(nodes, query, t_max, work, leaves);
}

/// The wide form, one box at a time.
pub(super) fn traverse_wide<const COUNT: bool>(
    nodes: &[Wide],
    query: &Query,
    mut t_max: f32,
    work: &mut Work,
    leaves: &mut impl Leaves,
) {
    let mut stack = [(0.0, Child::inner(0)); MAX_DEPTH * (WIDTH - 1) + 1];
    let mut height = usize::from(!nodes.is_empty());
    while height > 0 {
        height -= 1;
        let (near, at) = stack[height];
        if near > t_max {
            continue;
        }
        if at.is_leaf() {
            if COUNT {
                work.leaves += 1;
            }
            let (start, count) = at.run();
            t_max = leaves.visit(start, count, t_max);
            if t_max == f32::NEG_INFINITY {
                return;
            }
            continue;
        }
        let node = &nodes[at.node()];
        if COUNT {
            work.nodes += 1;
        }
        let bottom = height;
        for slot in 0..WIDTH {
            let face = |upper: usize| [0, 1, 2].map(|k| node.planes[2 * k + upper][slot]);
            let (near, far) = query.inside(face(0), face(1), t_max);
            if near <= far {
                stack[height] = (near, node.children[slot]);
                height += 1;
            }
        }
        // The nearest is taken up first.
        stack[bottom..height].sort_by(|a, b| b.0.total_cmp(&a.0));
    }
}
