//! A part of a displaced mesh: its pieces and what is around them, vertex by vertex.
//!
//! Invariant: sums run in the order of the whole: triangles by name, versions of a vertex by number.

use super::Patches;
use super::names::{DEEPEST, Key, Node, ONE, Vertex};
use crate::geometry::made::displace::{area_normal, mean, moved_normal};
use crate::geometry::made::parts::Part;
use crate::geometry::made::rule::{Point, WHOLE, split};
use crate::math::DVec3;
use crate::stats::KeyBuildHasher;
use glam::Vec3;
use std::collections::HashMap;
use std::sync::atomic::Ordering;

/// Vertices of a part and of what is around it, about.
const USUAL: usize = 1024;

/// A corner of a triangle: its vertex, and its weights on the triangle of the base.
#[derive(Clone, Copy)]
struct Corner {
    vertex: u32,
    weights: [u64; 3],
}

/// A part in the making.
pub(super) struct PartMaker<'a> {
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

impl<'a> PartMaker<'a> {
    /// Of `pieces`, which lie between `low` and `high`.
    pub(super) fn new(of: &'a Patches, pieces: &'a [u32], [low, high]: [Vec3; 2]) -> Self {
        Self {
            of,
            pieces,
            low,
            high,
            found: HashMap::with_capacity_and_hasher(USUAL, KeyBuildHasher::default()),
            vertices: Vec::with_capacity(USUAL),
            triangles: Vec::with_capacity(2 * USUAL),
        }
    }

    /// What `triangle` of the base becomes, as far as it matters; those that hold pieces come in rising order.
    pub(super) fn add(&mut self, triangle: u32) {
        let base = &self.of.mesh.base;
        let mut weights = [[ONE, 0, 0], [0, ONE, 0], [0, 0, ONE]].into_iter();
        let corners = base.triangles[triangle as usize].map(|v| {
            let key = Key::corner(v);
            let vertex = self.vertex(key, |maker| maker.of.vertex(key));
            Corner { vertex, weights: weights.next().expect("three corners") }
        });
        self.visit(Node::new(triangle), 0, corners, None);
    }

    /// The vertex `key`, which is as `make` says when it is new.
    fn vertex(&mut self, key: Key, make: impl FnOnce(&Self) -> Vertex) -> u32 {
        let next = self.vertices.len() as u32;
        let at = *self.found.entry(key).or_insert(next);
        if at == next {
            let new = make(self);
            self.vertices.push(new);
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
        let points = corners.map(|corner| self.point(corner));
        let middles = if level < DEEPEST { patches.mesh.rule.middles(points) } else { [None; 3] };
        let (four, n) = split([a, b, c], middles);
        if n == 1 {
            self.triangles.push((corners.map(|c| c.vertex), name));
            return name.map(|name| name + 1);
        }
        let mut six = [corners[0]; 6];
        six[..3].copy_from_slice(&corners);
        for (k, middle) in middles.into_iter().enumerate() {
            if let Some(p) = middle {
                six[3 + k] = self.half_way(node.triangle, p, [corners[k], corners[(k + 1) % 3]]);
            }
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
        let vertex = self.vertex(key, |maker| {
            let ends = [a, b].map(|c| &maker.vertices[c.vertex as usize]);
            Vertex::between(key, maker.of.mesh.rule.point(p), ends)
        });
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
    pub(super) fn finish(mut self) -> Part {
        assert!(self.pieces.is_empty(), "a piece was not found where it was counted");
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
