//! Turns the plain form into the wide form, and runs of triangles into blocks.
//!
//! Invariant: both forms have the same leaves.

use super::memory::Frozen;
use super::primitives::Reference;
use super::tree::{Block, Child, LANES, Node, WIDTH, Wide};
use crate::accel::Geometry;
use rayon::prelude::*;

/// Leaves of `nodes` from runs of triangles to runs of blocks, which are filled with the vertices.
pub(super) fn into_blocks(
    nodes: &mut [Node],
    references: &[Reference],
    geometry: &[Geometry<'_>],
) -> Frozen<Block> {
    // The first triangle of each block: leaves are runs of triangles in order.
    let mut firsts = Vec::with_capacity(references.len() / 3);
    for node in nodes.iter_mut().filter(|n| n.count() > 0) {
        let (start, count) = (node.next, node.count());
        node.next = u32::try_from(firsts.len()).expect("no more blocks than triangles");
        node.count_axis = count.div_ceil(LANES as u32) << 2;
        firsts.extend((start..start + count).step_by(LANES));
    }
    let end = references.len() as u32;
    let fill = |(i, block): (usize, &mut Block)| {
        let first = firsts[i];
        let next = firsts.get(i + 1).copied().unwrap_or(end);
        *block = Block::empty();
        for (lane, r) in references[first as usize..next as usize].iter().enumerate() {
            let Geometry::Triangles { positions, indices, .. } = geometry[r.geometry as usize] else {
                unreachable!("triangles are referred to in geometries of triangles")
            };
            let corners = indices[r.primitive as usize].map(|c| positions[c as usize]);
            block.set(lane, corners, r.geometry, r.primitive);
        }
    };
    Frozen::filled(firsts.len(), |blocks: &mut [Block]| {
        blocks.par_iter_mut().enumerate().with_min_len(1024).for_each(fill);
    })
}

/// The wide form of `nodes`: of the children of a node the largest is opened until there are eight.
pub(super) fn widen(nodes: &[Node]) -> Vec<Wide> {
    let mut wide = Vec::with_capacity(nodes.len() / 8 + 1);
    if !nodes.is_empty() {
        emit(nodes, 0, &mut wide);
    }
    wide
}

fn half_area(node: &Node) -> f32 {
    let [x, y, z] = [0, 1, 2].map(|k| node.hi[k] - node.lo[k]);
    x * y + y * z + z * x
}

/// Up to `MOST` nodes that together are `root`, the largest of which is opened while there is room, and how many.
pub(super) fn open<const MOST: usize>(nodes: &[Node], root: usize) -> ([usize; MOST], usize) {
    let mut children = [0usize; MOST];
    children[0] = root;
    let mut count = 1;
    while count < MOST {
        let inner = (0..count).filter(|&i| nodes[children[i]].count() == 0);
        let Some(largest) =
            inner.max_by(|&a, &b| half_area(&nodes[children[a]]).total_cmp(&half_area(&nodes[children[b]])))
        else {
            break;
        };
        let at = children[largest];
        children[largest] = at + 1;
        children[count] = nodes[at].next as usize;
        count += 1;
    }
    (children, count)
}

fn emit(nodes: &[Node], root: usize, wide: &mut Vec<Wide>) -> usize {
    let (mut children, count) = open::<WIDTH>(nodes, root);
    // Rays that ask for any hit take the first that they meet: the largest, which is the likeliest.
    children[..count].sort_by(|&a, &b| half_area(&nodes[b]).total_cmp(&half_area(&nodes[a])));
    let place = wide.len();
    wide.push(Wide::empty());
    for (slot, &child) in children[..count].iter().enumerate() {
        let node = &nodes[child];
        let reference = if node.count() > 0 {
            Child::leaf(node.next, node.count())
        } else {
            Child::inner(emit(nodes, child, wide))
        };
        wide[place].set(slot, node.lo, node.hi, reference);
    }
    place
}
