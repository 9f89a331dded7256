//! A displaced mesh part by part: triangles of the base are divided alone, since what divides an edge is known from its
//! ends, and as many of their neighbours with them as the normals at the border of a part want.
//!
//! A vertex is known by where it lies on its base triangle, in weights that are exact, so that two triangles which share an
//! edge agree on the vertices there.
//!
//! Invariant: see [`super::parts`]. Sums run in the order of the whole: triangles by name, versions of a vertex by number.

use super::displace::{Displaced, area_normal, mean, moved_normal};
use super::parts::{InPieces, Part, Parts, Piece};
use super::refine::too_many;
use super::rule::{Point, WHOLE, cut, middle, normal_between};
use super::seams::Linked;
use crate::error::{Error, Result};
use crate::math::DVec3;
use crate::stats::KeyBuildHasher;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;
use std::hash::{Hash, Hasher};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Most triangles of a mesh that is made part by part: there are no more names.
pub(super) const MOST: u64 = 1 << 30;
/// Levels that are looked at in parallel.
const PARALLEL: u32 = 6;
/// Vertices of a part and of what is around it, about.
const USUAL: usize = 1024;
/// So much is added around a part: many times the least number.
const MARGIN: f32 = 1e-42;
/// After so many levels it is asked whether to go on.
const ASK: u32 = 4;
/// The weight of a vertex of the base.
const ONE: u64 = 1 << 62;
/// Most levels: a vertex's weights are exact.
const DEEPEST: u32 = 62;

/// A triangle on the way from one of the base to what it becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Node {
    /// Which of up to four, level by level, from the highest bits on; the level in the lowest six.
    path: u64,
    triangle: u32,
}

impl Node {
    /// Levels that a path has room for.
    const LEVELS: u32 = 29;

    fn new(triangle: u32) -> Self {
        Self { path: 0, triangle }
    }

    fn level(self) -> u32 {
        self.path as u32 & 63
    }

    /// None is known by its path beyond the last level.
    fn child(self, which: usize) -> Self {
        let level = self.level();
        if level == Self::LEVELS {
            return self;
        }
        Self { path: (self.path | (which as u64) << (62 - 2 * level)) + 1, ..self }
    }

    /// Whether `other` is it, or comes of it.
    fn holds(self, other: Self) -> bool {
        let level = self.level();
        let apart = (self.path ^ other.path).checked_shr(64 - 2 * level).unwrap_or(0);
        self.triangle == other.triangle && level <= other.level() && apart == 0
    }

    fn which(self, level: u32) -> usize {
        (self.path >> (62 - 2 * level)) as usize & 3
    }
}

/// A displaced mesh in pieces.
pub(super) struct Patches {
    mesh: Displaced,
    /// By piece: where it is, and its first triangle's name.
    pieces: Vec<(Node, u32)>,
    /// Triangles at a vertex of the base, all its versions together, by the first of these.
    around: Vec<u32>,
    starts: Vec<u32>,
    /// Versions of one vertex, and those that light does not tell apart.
    versions: Linked,
    smooth: Linked,
    /// Triangles that have the vertices of one before them, and the first of these: they share what is inside.
    same: Vec<(u32, u32)>,
    /// Edges of the base that are two: the other's ends in the order of the rising numbers of this one's.
    seams: Vec<([u32; 2], [u32; 2], bool)>,
    not_numbers: AtomicBool,
}

/// A piece that was found.
struct Found {
    node: Node,
    triangles: u32,
    centre: [f32; 3],
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
        let limit = limit.min(MOST as usize);
        let look = Look { mesh: &mesh, most: most.into(), limit: limit as u64, stop, counted: &counted };
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
        let (starts, around) = around(&base.triangles, count, &versions);
        let not_numbers = AtomicBool::new(false);
        let same = same_vertices(&base.triangles);
        let patches =
            Self { mesh, pieces: nodes, same, around, starts, versions, smooth, seams, not_numbers };
        Ok((Box::new(patches), pieces))
    }

    /// Where a piece lies before it is moved.
    fn corners(&self, node: Node) -> [Vec3; 3] {
        let base = &self.mesh.base;
        let mut corners = base.triangles[node.triangle as usize].map(|v| self.mesh.point(v));
        for level in 0..node.level() {
            let (six, children, _) = children(&self.mesh, corners);
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

/// Of each vertex that comes first of its versions, the triangles there: where they begin in the second list, and that.
fn around(triangles: &[[u32; 3]], vertices: usize, versions: &Linked) -> (Vec<u32>, Vec<u32>) {
    let firsts = |t: &[u32; 3]| t.map(|v| versions.first(v) as usize);
    let mut starts = vec![0u32; vertices + 1];
    for t in triangles {
        firsts(t).into_iter().for_each(|v| starts[v + 1] += 1);
    }
    for i in 1..starts.len() {
        starts[i] += starts[i - 1];
    }
    let mut next = starts.clone();
    let mut around = vec![0; 3 * triangles.len()];
    for (i, t) in triangles.iter().enumerate() {
        for v in firsts(t) {
            around[next[v] as usize] = i as u32;
            next[v] += 1;
        }
    }
    (starts, around)
}

/// The corners of a triangle and the middles of its edges that are divided, what it becomes by these, and how many.
fn children(mesh: &Displaced, corners: [Point; 3]) -> ([Point; 6], [[u32; 3]; 4], usize) {
    let [a, b, c] = corners;
    let mut six = [a, b, c, a, a, a];
    let mut middles = [WHOLE; 3];
    for (k, [p, q]) in [[a, b], [b, c], [c, a]].iter().enumerate() {
        if let Some(middle) = mesh.rule.middle(p, q) {
            middles[k] = 3 + k as u32;
            six[3 + k] = mesh.rule.point(middle);
        }
    }
    let mut four = [[WHOLE; 3]; 4];
    let n = cut([0, 1, 2], middles, |v| six[v as usize].p, &mut four);
    (six, four, n)
}

/// Finds pieces.
struct Look<'a> {
    mesh: &'a Displaced,
    most: u64,
    limit: u64,
    stop: &'a (dyn Fn() -> bool + Sync),
    counted: &'a AtomicU64,
}

impl Look<'_> {
    /// All pieces of a triangle of the base.
    fn all(&self, node: Node, corners: [Point; 3]) -> Vec<Found> {
        let (triangles, mut found) = self.count(node, 0, corners);
        if found.is_empty() {
            found.push(self.found(node, triangles, corners));
        }
        found
    }

    /// How many triangles `node` becomes, and its pieces, unless all of it is one.
    fn count(&self, node: Node, level: u32, corners: [Point; 3]) -> (u64, Vec<Found>) {
        let (six, four, n) = children(self.mesh, corners);
        // More are not looked for than can be named.
        let enough = || (self.stop)() || self.counted.load(Ordering::Relaxed) > self.limit;
        if n == 1 || level == DEEPEST || (level.is_multiple_of(ASK) && enough()) {
            return (1, Vec::new());
        }
        let child = |i: usize| {
            let corners = four[i].map(|v| six[v as usize]);
            let node = node.child(i);
            (node, corners, self.count(node, level + 1, corners))
        };
        let below: Vec<_> = if level < PARALLEL {
            (0..n).into_par_iter().map(child).collect()
        } else {
            (0..n).map(child).collect()
        };
        let sum: u64 = below.iter().map(|(.., (count, _))| count).sum();
        if sum <= self.most || level >= Node::LEVELS {
            return (sum, Vec::new());
        }
        let mut out = Vec::new();
        for (node, corners, (count, found)) in below {
            if found.is_empty() {
                out.push(self.found(node, count, corners));
            } else {
                out.extend(found);
            }
        }
        (sum, out)
    }

    fn found(&self, node: Node, triangles: u64, corners: [Point; 3]) -> Found {
        let [a, b, c] = corners.map(|corner| corner.p);
        self.counted.fetch_add(triangles, Ordering::Relaxed);
        let triangles = u32::try_from(triangles).unwrap_or(u32::MAX);
        Found { node, triangles, centre: ((a + b + c) / 3.0).to_array() }
    }
}

/// A vertex by where it is on the base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Key {
    kind: Kind,
    /// Twice a vertex of the base; the ends of an edge, the smaller first; twice the first triangle of its corners.
    ends: [u32; 2],
    /// Of the ends; of the two corners of the smallest numbers.
    weights: [u64; 2],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Corner,
    Edge,
    Inside,
}

impl Hash for Key {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let [a, b] = self.ends.map(u64::from);
        state.write_u64(a << 32 | b);
        // The highest bits are those that differ.
        state.write_u64(self.weights[0].rotate_left(24) ^ self.weights[1].rotate_left(3) ^ self.kind as u64);
    }
}

impl Key {
    fn corner(v: u32) -> Self {
        Self { kind: Kind::Corner, ends: [v; 2], weights: [ONE, 0] }
    }

    fn edge(ends: [u32; 2], weights: [u64; 2]) -> Self {
        let [[a, b], [v, w]] = [ends, ends];
        if a < b {
            Self { kind: Kind::Edge, ends: [a, b], weights }
        } else {
            Self { kind: Kind::Edge, ends: [w, v], weights: [weights[1], weights[0]] }
        }
    }

    /// At `weights` of the `corners` of a triangle, which is none of these; `first` is the first triangle of these corners.
    fn of(first: u32, corners: [u32; 3], weights: [u64; 3]) -> Self {
        let [a, b, c] = corners;
        match weights {
            [wa, wb, 0] => Self::edge([a, b], [wa, wb]),
            [0, wb, wc] => Self::edge([b, c], [wb, wc]),
            [wa, 0, wc] => Self::edge([a, c], [wa, wc]),
            _ => {
                let mut by_number = [0, 1, 2].map(|i| (corners[i], weights[i]));
                by_number.sort_unstable();
                let weights = [by_number[0].1, by_number[1].1];
                Self { kind: Kind::Inside, ends: [first; 2], weights }
            }
        }
    }
}

/// A vertex before it is moved.
#[derive(Clone, Copy, Debug)]
struct Vertex {
    key: Key,
    p: Point,
    n: Vec3,
    uv: Vec2,
}

impl Vertex {
    /// Half-way, at `p`.
    fn between(key: Key, p: Point, [a, b]: [&Self; 2]) -> Self {
        Self { key, p, n: normal_between(a.n, b.n), uv: 0.5 * a.uv + 0.5 * b.uv }
    }
}

/// A corner of a triangle: its vertex, and its weights on the triangle of the base.
#[derive(Clone, Copy)]
struct Corner {
    vertex: u32,
    weights: [u64; 3],
}

/// A part in the maker.
struct PartMaker<'a> {
    of: &'a Patches,
    /// Pieces that are still to come.
    pieces: &'a [u32],
    /// Around all pieces, before they are moved.
    low: Vec3,
    high: Vec3,
    found: HashMap<Key, u32, KeyBuildHasher>,
    vertices: Vec<Vertex>,
    /// Triangles of the part, with their names, and those around it.
    triangles: Vec<([u32; 3], Option<u32>)>,
}

impl PartMaker<'_> {
    fn add(&mut self, vertex: Vertex) -> u32 {
        let next = self.vertices.len() as u32;
        let at = *self.found.entry(vertex.key).or_insert(next);
        if at == next {
            self.vertices.push(vertex);
        }
        at
    }

    fn point(&self, corner: Corner) -> &Point {
        &self.vertices[corner.vertex as usize].p
    }

    /// What `node` becomes, as far as it matters; `name` is that of its first triangle where it belongs to a piece. The name
    /// after its last.
    fn visit(&mut self, node: Node, level: u32, corners: [Corner; 3], mut name: Option<u32>) -> Option<u32> {
        let patches = self.of;
        let [a, b, c] = corners.map(|corner| self.point(corner).p);
        if name.is_none() {
            let next = self.pieces.first().map(|&next| patches.pieces[next as usize]);
            if let Some((_, first)) = next.filter(|(next, _)| *next == node) {
                self.pieces = &self.pieces[1..];
                self.visit(node, level, corners, Some(first));
                return None;
            }
            let holds = level <= Node::LEVELS && next.is_some_and(|(next, _)| node.holds(next));
            let (low, high) = (a.min(b).min(c), a.max(b).max(c));
            // What is no number is never beside anything.
            if !holds && (low.cmpgt(self.high).any() || high.cmplt(self.low).any()) {
                return None;
            }
        }
        let mut six = [corners[0]; 6];
        six[..3].copy_from_slice(&corners);
        let mut middles = [WHOLE; 3];
        if level < DEEPEST {
            for k in 0..3 {
                let ends = [corners[k], corners[(k + 1) % 3]];
                let [p, q] = ends.map(|corner| self.point(corner));
                if let Some(middle) = patches.mesh.rule.middle(p, q) {
                    middles[k] = 3 + k as u32;
                    six[3 + k] = self.half_way(node.triangle, middle, ends);
                }
            }
        }
        let mut four = [[WHOLE; 3]; 4];
        let n = cut([0, 1, 2], middles, |v| self.point(six[v as usize]).p, &mut four);
        if n == 1 {
            self.triangles.push((corners.map(|c| c.vertex), name));
            return name.map(|name| name + 1);
        }
        for (i, child) in four[..n].iter().enumerate() {
            name = self.visit(node.child(i), level + 1, child.map(|v| six[v as usize]), name);
        }
        name
    }

    /// The middle `p` of an edge.
    fn half_way(&mut self, triangle: u32, p: Vec3, [a, b]: [Corner; 2]) -> Corner {
        let weights = [0, 1, 2].map(|i| a.weights[i] / 2 + b.weights[i] / 2);
        let first = match self.of.same.binary_search_by_key(&triangle, |same| same.0) {
            Ok(at) => self.of.same[at].1,
            Err(_) => triangle,
        };
        let key = Key::of(first, self.of.mesh.base.triangles[triangle as usize], weights);
        let next = self.vertices.len() as u32;
        let vertex = *self.found.entry(key).or_insert(next);
        if vertex == next {
            let ends = [a, b].map(|c| &self.vertices[c.vertex as usize]);
            let new = Vertex::between(key, self.of.mesh.rule.point(p), ends);
            self.vertices.push(new);
        }
        Corner { vertex, weights }
    }

    /// Marks the corners of the part, and the versions of them that light does not tell apart.
    fn marked(&self) -> Vec<bool> {
        let mut marked = vec![false; self.vertices.len()];
        let mut versions = Vec::new();
        for v in self.triangles.iter().filter(|(_, name)| name.is_some()).flat_map(|(t, _)| *t) {
            if !std::mem::replace(&mut marked[v as usize], true) {
                self.of.versions(self.vertices[v as usize].key, true, &mut versions);
                versions
                    .iter()
                    .filter_map(|key| self.found.get(key))
                    .for_each(|&v| marked[v as usize] = true);
            }
        }
        marked
    }

    /// Where the corners of `triangles` come to.
    fn moved(&self, triangles: &[([u32; 3], Option<u32>)]) -> Vec<Vec3> {
        let mesh = &self.of.mesh;
        let _held = mesh.attach();
        let not_numbers = &self.of.not_numbers;
        let own = |vertex: &Vertex| {
            mesh.moved(vertex.p.p, vertex.n, vertex.uv).unwrap_or_else(|| {
                not_numbers.store(true, Ordering::Relaxed);
                Vec3::ZERO
            })
        };
        let mut known = vec![false; self.vertices.len()];
        let mut out: Vec<Vec3> = self.vertices.iter().map(|v| v.p.p).collect();
        let mut versions = Vec::new();
        for v in triangles.iter().flat_map(|(t, _)| t.map(|v| v as usize)) {
            if std::mem::replace(&mut known[v], true) {
                continue;
            }
            let vertex = &self.vertices[v];
            self.of.versions(vertex.key, false, &mut versions);
            let by = if versions.is_empty() {
                own(vertex)
            } else {
                mean(versions.iter().map(|&key| own(&self.of.vertex(key))))
            };
            out[v] = vertex.p.p + by;
        }
        out
    }

    /// What has been found, as a mesh.
    fn finish(mut self) -> Part {
        let marked = self.marked();
        let mut triangles = std::mem::take(&mut self.triangles);
        triangles.retain(|(t, _)| t.iter().any(|&v| marked[v as usize]));
        let moved = self.moved(&triangles);
        let mut sums = vec![DVec3::ZERO; self.vertices.len()];
        for (t, _) in &triangles {
            if let Some(normal) = area_normal(t.map(|v| moved[v as usize])) {
                t.iter().for_each(|&v| sums[v as usize] += normal);
            }
        }
        let mut part = Part::default();
        let has_uvs = !self.of.mesh.base.uvs.is_empty();
        let mut places = vec![WHOLE; self.vertices.len()];
        let mut versions = Vec::new();
        for (t, name) in triangles {
            let Some(name) = name else { continue };
            part.names.push(name);
            part.mesh.indices.push(t.map(|v| {
                let place = &mut places[v as usize];
                if *place == WHOLE {
                    *place = part.mesh.positions.len() as u32;
                    let vertex = &self.vertices[v as usize];
                    self.of.versions(vertex.key, true, &mut versions);
                    let sum = if versions.is_empty() {
                        sums[v as usize]
                    } else {
                        let sum = |key| self.found.get(key).map_or(DVec3::ZERO, |&v| sums[v as usize]);
                        versions.iter().map(sum).sum()
                    };
                    part.mesh.positions.push(moved[v as usize].to_array());
                    part.mesh.normals.push(moved_normal(sum, vertex.n.to_array()));
                    if has_uvs {
                        part.mesh.uvs.push(vertex.uv.to_array());
                    }
                }
                *place
            }));
        }
        part
    }
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
        let mut firsts: Vec<usize> = corners.map(|v| self.versions.first(v) as usize).collect();
        firsts.sort_unstable();
        firsts.dedup();
        let ranges = firsts.iter().map(|&v| self.starts[v] as usize..self.starts[v + 1] as usize);
        let near = |&triangle: &u32| {
            let at = |v: u32| Vec3::from(base.positions[v as usize]);
            let [a, b, c] = base.triangles[triangle as usize].map(at);
            !(a.min(b).min(c).cmpgt(high).any() || a.max(b).max(c).cmplt(low).any())
        };
        let mut triangles: Vec<u32> =
            ranges.flat_map(|range| &self.around[range]).copied().filter(near).chain(own).collect();
        triangles.sort_unstable();
        triangles.dedup();
        let mut maker = PartMaker {
            of: self,
            pieces,
            low,
            high,
            found: HashMap::with_capacity_and_hasher(USUAL, KeyBuildHasher::default()),
            vertices: Vec::with_capacity(USUAL),
            triangles: Vec::with_capacity(2 * USUAL),
        };
        for triangle in triangles {
            let mut weights = [[ONE, 0, 0], [0, ONE, 0], [0, 0, ONE]].into_iter();
            let corners = base.triangles[triangle as usize].map(|v| {
                let vertex = maker.add(self.vertex(Key::corner(v)));
                Corner { vertex, weights: weights.next().expect("three corners") }
            });
            maker.visit(Node::new(triangle), 0, corners, None);
        }
        assert!(maker.pieces.is_empty(), "a piece was not found where it was counted");
        maker.finish()
    }

    fn bytes(&self) -> usize {
        let base = &self.mesh.base;
        size_of_val(&self.pieces[..])
            + size_of_val(&self.around[..])
            + size_of_val(&self.starts[..])
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
