//! What stands in a page after its triangles: for each slot the vertices of its triangle, and the vertices' attributes.
//!
//! Invariant: a page whose checksum is right was made by [`encode`]; no other is ever looked into.

use crate::accel::bvh::{Outline, PageTree, PageView};
use crate::geometry::Mesh;
use crate::stats::KeyBuildHasher;
use bytemuck::{Pod, cast_slice};
use std::collections::HashMap;
use std::hash::Hasher;
use xxhash_rust::xxh3::Xxh3;

/// Changes whenever the same mesh would give other bytes.
pub(super) const VERSION: u32 = 3;

/// Places in the head of a page.
const VERTICES: usize = 0;
const ATTRIBUTES: usize = 1;
const USED: usize = 2;
/// Two words.
const CHECKSUM: usize = 4;

const NORMALS: u32 = 1;
const UVS: u32 = 2;
const TANGENTS: u32 = 4;

/// A page without padding, and its outline.
pub(super) type Page = (Vec<u8>, Outline);

/// The page of the triangles `names` of `mesh`, which may be a part of another, where they are `called` so.
pub(super) fn encode(mesh: &Mesh, names: &[u32], called: impl Fn(u32) -> u32) -> Page {
    let mut tree = PageTree::new(&mesh.positions, &mesh.indices, names);
    let mut local: HashMap<u64, u16, KeyBuildHasher> = HashMap::default();
    let mut vertices = Vec::new();
    let mut corners: Vec<[u16; 3]> = Vec::new();
    for name in tree.primitives() {
        let of = mesh.indices.get(name as usize).copied();
        corners.push(of.map_or([0; 3], |of| {
            of.map(|vertex| {
                *local.entry(vertex.into()).or_insert_with(|| {
                    vertices.push(vertex as usize);
                    u16::try_from(vertices.len() - 1).expect("a page has fewer than 2^16 vertices")
                })
            })
        }));
    }
    tree.rename(called);
    let mut free = [0; 14];
    free[VERTICES] = vertices.len() as u32;
    let mut bytes = tree.bytes(free);
    bytes.extend_from_slice(cast_slice(&corners));
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    append(&mut bytes, &vertices, &mesh.normals);
    append(&mut bytes, &vertices, &mesh.uvs);
    append(&mut bytes, &vertices, &mesh.tangents);
    let has = |present: bool, bit: u32| if present { bit } else { 0 };
    free[ATTRIBUTES] = has(!mesh.normals.is_empty(), NORMALS)
        | has(!mesh.uvs.is_empty(), UVS)
        | has(!mesh.tangents.is_empty(), TANGENTS);
    free[USED] = u32::try_from(bytes.len()).expect("pages are small");
    write_head(&mut bytes, &free);
    let sum = checksum(&bytes);
    free[CHECKSUM] = sum as u32;
    free[CHECKSUM + 1] = (sum >> 32) as u32;
    write_head(&mut bytes, &free);
    (bytes, tree.outline)
}

fn append<T: Pod>(bytes: &mut Vec<u8>, vertices: &[usize], column: &[T]) {
    if !column.is_empty() {
        vertices.iter().for_each(|&v| bytes.extend_from_slice(bytemuck::bytes_of(&column[v])));
    }
}

/// The words that are free for us lie after the two counts.
fn write_head(bytes: &mut [u8], free: &[u32; 14]) {
    bytes[8..64].copy_from_slice(cast_slice(free));
}

/// Of a page whose checksum is zero.
fn checksum(bytes: &[u8]) -> u64 {
    let mut hash = Xxh3::new();
    hash.write(&bytes[..8 + 4 * CHECKSUM]);
    hash.write(&bytes[8 + 4 * (CHECKSUM + 2)..]);
    hash.finish()
}

/// Whether `bytes`, a page and its padding, are as [`encode`] made them.
pub(super) fn is_whole(bytes: &[u8]) -> bool {
    let Some(head) = bytes.get(8..64) else { return false };
    let word =
        |i: usize| u32::from_le_bytes([head[4 * i], head[4 * i + 1], head[4 * i + 2], head[4 * i + 3]]);
    let sum = u64::from(word(CHECKSUM)) | u64::from(word(CHECKSUM + 1)) << 32;
    bytes.get(..word(USED) as usize).is_some_and(|used| used.len() >= 64 && checksum(used) == sum)
}

/// Copies the triangle in `slot` of a whole page into `out`, a mesh of one triangle.
pub(super) fn read_triangle(bytes: &[u8], slot: usize, out: &mut Mesh) {
    let view = PageView::new(bytes);
    if out.indices.is_empty() {
        out.indices.push([0, 1, 2]);
    }
    out.positions.clear();
    if slot >= view.slots() {
        // It was hit, left, and cannot be read again, which is reported: the image is wrong, but ends.
        out.positions.extend([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        out.normals.clear();
        out.uvs.clear();
        out.tangents.clear();
        return;
    }
    out.positions.extend(view.triangle(slot));
    let vertices = view.free[VERTICES] as usize;
    let attributes = view.free[ATTRIBUTES];
    let corners: &[[u16; 3]] = cast_slice(&bytes[view.end()..view.end() + 6 * view.slots()]);
    let corners = corners[slot].map(usize::from);
    let mut at = (view.end() + 6 * view.slots()).next_multiple_of(4);
    let mut has = |bit: u32, size: usize| {
        let here = attributes & bit != 0;
        let start = at;
        at += if here { vertices * size } else { 0 };
        here.then_some(start..at)
    };
    let (normals, uvs, tangents) = (has(NORMALS, 12), has(UVS, 8), has(TANGENTS, 12));
    pick(bytes, normals, corners, &mut out.normals);
    pick(bytes, uvs, corners, &mut out.uvs);
    pick(bytes, tangents, corners, &mut out.tangents);
}

fn pick<T: Pod>(bytes: &[u8], column: Option<std::ops::Range<usize>>, corners: [usize; 3], out: &mut Vec<T>) {
    out.clear();
    if let Some(range) = column {
        let column: &[T] = cast_slice(&bytes[range]);
        out.extend(corners.map(|c| column[c]));
    }
}
