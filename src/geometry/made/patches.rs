//! A displaced mesh part by part: triangles of the base are divided alone, since what divides an edge is known from its
//! ends, and as many of their neighbours with them as the normals at the border of a part want.
//!
//! A vertex is known by where it lies on its base triangle, in weights that are exact, so that two triangles which share an
//! edge agree on the vertices there.
//!
//! Invariant: see [`super::parts`].

mod look;
mod names;
mod part;

use super::around::Around;
use super::displace::Displaced;
use super::parts::{InPieces, Part, Parts, Piece};
use super::refine::too_many;
use super::rule::middle;
use super::seams::Linked;
use crate::error::{Error, Result};
use glam::{Vec2, Vec3};
use look::{Found, Look, children};
use names::{Key, Kind, Node, ONE, Vertex};
use part::PartMaker;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// So much is added around a part: many times the least number.
const MARGIN: f32 = 1e-42;

/// A displaced mesh in pieces.
pub(super) struct Patches {
    mesh: Displaced,
    /// By piece: where it is, and its first triangle's name.
    pieces: Vec<(Node, u32)>,
    /// Of vertices of the base, all versions of one together, by the first of these.
    around: Around,
    /// Versions of one vertex, and those that light does not tell apart.
    versions: Linked,
    smooth: Linked,
    /// Triangles that have the vertices of one before them, and the first of these: they share what is inside.
    same: Vec<(u32, u32)>,
    /// Edges of the base that are two: the other's ends in the order of the rising numbers of this one's.
    seams: Vec<([u32; 2], [u32; 2], bool)>,
    not_numbers: AtomicBool,
}

impl Patches {
    /// `mesh` in pieces of `most` triangles at most.
    ///
    /// # Errors
    /// [`Error::Resource`] when it becomes more than `limit` triangles.
    pub(super) fn divide(
        mesh: Displaced,
        most: u32,
        limit: usize,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<InPieces> {
        let counted = AtomicU64::new(0);
        let look = Look { rule: &mesh.rule, most: most.into(), limit: limit as u64, stop, counted: &counted };
        let base = &mesh.base;
        let of = |(i, t): (usize, &[u32; 3])| look.all(Node::new(i as u32), t.map(|v| mesh.point(v)));
        let found: Vec<Vec<Found>> = base.triangles.par_iter().enumerate().map(of).collect();
        if stop() {
            return Err(Error::Interrupted);
        }
        if counted.into_inner() > limit as u64 {
            return Err(too_many(None, limit));
        }
        let count = found.iter().map(Vec::len).sum();
        let (mut nodes, mut pieces) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let mut first = 0;
        for Found { node, triangles, centre } in found.into_iter().flatten() {
            nodes.push((node, first));
            first += triangles;
            pieces.push(Piece { triangles, centre });
        }
        let corners = |smooth_only: bool| {
            let seams = base.seams.iter().filter(move |s| s.smooth || !smooth_only);
            seams.flat_map(|s| (0..2).map(|i| [s.a[i], s.b[i]]))
        };
        let count = base.positions.len();
        let versions = Linked::new(count, corners(false));
        let smooth = Linked::new(count, corners(true));
        let mut seams: Vec<([u32; 2], [u32; 2], bool)> = Vec::with_capacity(2 * base.seams.len());
        for seam in &base.seams {
            for (a, b) in [(seam.a, seam.b), (seam.b, seam.a)] {
                let (a, b) = if a[0] < a[1] { (a, b) } else { ([a[1], a[0]], [b[1], b[0]]) };
                seams.push((a, b, seam.smooth));
            }
        }
        seams.sort_unstable();
        let around = Around::new(count, 3, base.triangles.iter().flatten().map(|&v| versions.first(v)));
        let not_numbers = AtomicBool::new(false);
        let same = same_vertices(&base.triangles);
        let patches = Self { mesh, pieces: nodes, same, around, versions, smooth, seams, not_numbers };
        Ok((Box::new(patches), pieces))
    }

    /// Where a piece lies before it is moved.
    fn corners(&self, node: Node) -> [Vec3; 3] {
        let base = &self.mesh.base;
        let mut corners = base.triangles[node.triangle as usize].map(|v| self.mesh.point(v));
        for level in 0..node.level() {
            let (six, children, _) = children(&self.mesh.rule, corners);
            corners = children[node.which(level)].map(|i| six[i as usize]);
        }
        corners.map(|corner| corner.p)
    }

    /// All versions of the vertex `key`, itself among them, in the order in which they are summed; none where there is
    /// but one.
    fn versions(&self, key: Key, smooth_only: bool, out: &mut Vec<Key>) {
        out.clear();
        match key {
            Key { kind: Kind::Corner, ends: [v, _], .. } => {
                let linked = if smooth_only { &self.smooth } else { &self.versions };
                out.extend(linked.of(v).map(Key::corner));
            }
            Key { kind: Kind::Edge, ends, weights } => {
                if let Ok(at) = self.seams.binary_search_by_key(&ends, |seam| seam.0)
                    && let (_, other, smooth) = self.seams[at]
                    && (smooth || !smooth_only)
                {
                    out.extend([key, Key::edge(other, weights)]);
                }
            }
            Key { kind: Kind::Inside, .. } => {}
        }
    }

    /// A vertex of the base, or one on an edge of it, before it is moved.
    fn vertex(&self, key: Key) -> Vertex {
        let corner = |v: u32| {
            let base = &self.mesh.base;
            let (key, v) = (Key::corner(v), v as usize);
            Vertex {
                key,
                p: self.mesh.point(v as u32),
                n: base.normals[v].into(),
                uv: base.uvs.get(v).map_or(Vec2::ZERO, |&uv| uv.into()),
            }
        };
        let [mut a, mut b] = key.ends.map(corner);
        if key.kind == Kind::Corner {
            return a;
        }
        // As the edge was divided: by halves.
        let (mut low, mut high) = (ONE, 0);
        loop {
            let weight = low / 2 + high / 2;
            let p = self.mesh.rule.point(middle(a.p.p, b.p.p));
            let between = Vertex::between(key, p, [&a, &b]);
            match key.weights[0].cmp(&weight) {
                std::cmp::Ordering::Equal => return between,
                std::cmp::Ordering::Greater => (b, high) = (between, weight),
                std::cmp::Ordering::Less => (a, low) = (between, weight),
            }
        }
    }
}

/// Triangles that have the vertices of one before them, and the first of these.
fn same_vertices(triangles: &[[u32; 3]]) -> Vec<(u32, u32)> {
    let sorted = |(i, t): (usize, &[u32; 3])| {
        let mut t = *t;
        t.sort_unstable();
        (t, i as u32)
    };
    let mut all: Vec<([u32; 3], u32)> = triangles.iter().enumerate().map(sorted).collect();
    all.par_sort_unstable();
    let later =
        |group: &[([u32; 3], u32)]| group[1..].iter().map(|of| (of.1, group[0].1)).collect::<Vec<_>>();
    let mut same: Vec<(u32, u32)> = all.chunk_by(|a, b| a.0 == b.0).flat_map(later).collect();
    same.sort_unstable();
    same
}

impl Parts for Patches {
    fn make(&self, pieces: &[u32]) -> Part {
        let nodes = || pieces.iter().map(|&piece| self.pieces[piece as usize].0);
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for p in nodes().flat_map(|node| self.corners(node)) {
            (low, high) = (low.min(p), high.max(p));
        }
        // The middle of numbers without all their digits may be beside both.
        let (low, high) = (low - Vec3::splat(MARGIN), high + Vec3::splat(MARGIN));
        let base = &self.mesh.base;
        let mut own: Vec<u32> = nodes().map(|node| node.triangle).collect();
        own.dedup();
        let corners = own.iter().flat_map(|&t| base.triangles[t as usize]);
        let mut firsts: Vec<u32> = corners.map(|v| self.versions.first(v)).collect();
        firsts.sort_unstable();
        firsts.dedup();
        let near = |&triangle: &u32| {
            let at = |v: u32| Vec3::from(base.positions[v as usize]);
            let [a, b, c] = base.triangles[triangle as usize].map(at);
            !(a.min(b).min(c).cmpgt(high).any() || a.max(b).max(c).cmplt(low).any())
        };
        let around = firsts.iter().flat_map(|&v| self.around.at(v)).copied();
        let mut triangles: Vec<u32> = around.filter(near).chain(own).collect();
        triangles.sort_unstable();
        triangles.dedup();
        let mut maker = PartMaker::new(self, pieces, [low, high]);
        triangles.into_iter().for_each(|triangle| maker.add(triangle));
        maker.finish()
    }

    fn bytes(&self) -> usize {
        let base = &self.mesh.base;
        size_of_val(&self.pieces[..])
            + self.around.bytes()
            + size_of_val(&self.seams[..])
            + size_of_val(&self.same[..])
            + self.versions.bytes()
            + self.smooth.bytes()
            + size_of_val(&base.positions[..])
            + size_of_val(&base.normals[..])
            + size_of_val(&base.uvs[..])
            + size_of_val(&base.triangles[..])
            + size_of_val(&base.seams[..])
    }

    fn not_numbers(&self) -> bool {
        self.not_numbers.load(Ordering::Relaxed)
    }
}
