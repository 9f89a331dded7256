//! Where a mesh is one surface though its vertices are not shared: at seams of texture coordinates or normals.
//!
//! Invariant: what is joined has the same position to the bit, and one triangle on either side that run along it in
//! opposite directions, so that sheets that lie on one another stay apart. Never moves anything.

use rayon::prelude::*;

/// The same edge in the vertices of both of its triangles: `a[0]` and `b[0]` are one place, and so are the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Seam {
    pub(super) a: [u32; 2],
    pub(super) b: [u32; 2],
    /// Whether light does not see it.
    pub(super) smooth: bool,
}

/// A half of an edge: places of its ends in rising order, its vertices in that order, and whether it runs that way.
type Half = ([u32; 2], [u32; 2], bool);

/// All seams of a mesh; `smooth` says whether two vertices of one place have about the same normal.
pub(super) fn find(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    smooth: impl Fn(u32, u32) -> bool,
) -> Vec<Seam> {
    let places = places(positions);
    let Some(places) = places else { return Vec::new() };
    let halves = |t: &[u32; 3]| {
        let [a, b, c] = *t;
        [[a, b], [b, c], [c, a]].map(|[v, w]| {
            let (p, q) = (places[v as usize], places[w as usize]);
            if p < q { ([p, q], [v, w], true) } else { ([q, p], [w, v], false) }
        })
    };
    let mut all: Vec<Half> =
        triangles.par_iter().flat_map_iter(halves).filter(|h| h.0[0] != h.0[1]).collect();
    all.par_sort_unstable();
    let pair = |group: &[Half]| match *group {
        [(_, a, one_way), (_, b, other_way)] if one_way != other_way && a != b => {
            Some(Seam { a, b, smooth: smooth(a[0], b[0]) && smooth(a[1], b[1]) })
        }
        _ => None,
    };
    all.chunk_by(|a, b| a.0 == b.0).filter_map(pair).collect()
}

/// Of each vertex the first that stands where it does; `None` where no two do.
fn places(positions: &[[f32; 3]]) -> Option<Vec<u32>> {
    // Both zeros are one place.
    let bits = |v: u32| positions[v as usize].map(|c| (c + 0.0).to_bits());
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.par_sort_unstable_by_key(|&v| (bits(v), v));
    let mut places = vec![0; positions.len()];
    let mut shared = false;
    for group in order.chunk_by(|&a, &b| bits(a) == bits(b)) {
        shared |= group.len() > 1;
        group.iter().for_each(|&v| places[v as usize] = group[0]);
    }
    shared.then_some(places)
}

/// Vertices that are one, by links between them.
pub(super) struct Groups {
    parents: Vec<u32>,
    linked: Vec<u32>,
}

impl Groups {
    pub(super) fn new(vertices: usize, links: impl Iterator<Item = [u32; 2]>) -> Self {
        let mut groups = Self { parents: (0..vertices as u32).collect(), linked: Vec::new() };
        for [a, b] in links {
            if a != b {
                groups.linked.extend([a, b]);
                let (a, b) = (groups.root(a), groups.root(b));
                // The smaller is the root, whatever the order of the links.
                groups.parents[a.max(b) as usize] = a.min(b);
            }
        }
        groups.linked.sort_unstable();
        groups.linked.dedup();
        groups
    }

    fn root(&mut self, mut v: u32) -> u32 {
        while self.parents[v as usize] != v {
            let up = self.parents[self.parents[v as usize] as usize];
            self.parents[v as usize] = up;
            v = up;
        }
        v
    }

    /// Calls `each` with the vertices of every group of more than one, in rising order.
    pub(super) fn each(mut self, mut each: impl FnMut(&[u32])) {
        let linked = std::mem::take(&mut self.linked);
        let mut members: Vec<(u32, u32)> = linked.iter().map(|&v| (self.root(v), v)).collect();
        members.sort_unstable();
        let mut group = Vec::new();
        for same in members.chunk_by(|a, b| a.0 == b.0) {
            group.clear();
            group.extend(same.iter().map(|(_, v)| *v));
            each(&group);
        }
    }
}

/// Vertices that are one, to be asked about one by one.
pub(super) struct Linked {
    /// Of each vertex the first that is one with it; empty where no two are.
    firsts: Vec<u32>,
    /// The first and a member, of groups of more than one, in order.
    members: Vec<[u32; 2]>,
}

impl Linked {
    /// Of `vertices` vertices, by links between them.
    pub(super) fn new(vertices: usize, links: impl Iterator<Item = [u32; 2]>) -> Self {
        let mut members = Vec::new();
        Groups::new(vertices, links).each(|group| members.extend(group.iter().map(|&v| [group[0], v])));
        members.shrink_to_fit();
        let mut firsts = Vec::new();
        if !members.is_empty() {
            firsts.extend(0..vertices as u32);
            members.iter().for_each(|&[first, v]| firsts[v as usize] = first);
        }
        Self { firsts, members }
    }

    /// The first that is one with `v`.
    pub(super) fn first(&self, v: u32) -> u32 {
        self.firsts.get(v as usize).copied().unwrap_or(v)
    }

    /// All that are one with `v`, itself among them, in rising order; none where there is no other.
    pub(super) fn of(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        let first = self.first(v);
        let start = self.members.partition_point(|m| m[0] < first);
        self.members[start..].iter().take_while(move |m| m[0] == first).map(|m| m[1])
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.firsts[..]) + size_of_val(&self.members[..])
    }
}
