//! Pages against the meshes that they were cut from.

use super::file::PageFile;
use super::files::PageSource;
use super::format::{encode, is_whole, read_triangle};
use super::make::{PageMaker, Source};
use super::store::PageStore;
use super::{LEAST_PAGE_BYTES, MOST_PAGE_BYTES, PagedMesh};
use crate::accel::bvh::{BvhScene, Centre, Form, PageView, cut};
use crate::accel::{Accel, Custom, Geometry, Hit, NONE, Pages, Ray};
use crate::geometry::Mesh;
use crate::math::Transform;
use glam::Vec3;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// Of the PLY file `path`, made in `folder`, where none were before.
fn made(folder: &Path, path: &Path, page_bytes: usize) -> (PagedMesh, PageFile) {
    let maker = PageMaker::new(Some(folder), page_bytes, u64::MAX).expect("a folder is given");
    let source = Source { path, to_world: &Transform::IDENTITY, reverse: false };
    let named = maker.name(&source).expect("the source is there");
    assert!(maker.find(&named).is_none(), "nothing is made yet");
    drop(maker.make(&source, &named, NEVER).expect("room in the folder"));
    maker.find(&named).expect("it has been made")
}

struct NoCustom;

impl Custom for NoCustom {
    fn bounds(&self, _: u32, _: u32) -> (Vec3, Vec3) {
        unreachable!("triangles only")
    }

    fn intersect(&self, _: u32, _: u32, _: &Ray) -> Option<(f32, f32, f32)> {
        unreachable!("triangles only")
    }

    /// Whatever has a mask is not there.
    fn is_opaque(&self, _: u32, _: u32, _: (f32, f32, f32), _: &Ray) -> bool {
        false
    }
}

/// A wavy sheet of 2·n² triangles with all attributes.
pub(super) fn sheet(n: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for y in 0..=n {
        for x in 0..=n {
            let (u, v) = (x as f32 / n as f32, y as f32 / n as f32);
            let h = 0.1 * (17.0 * u).sin() * (23.0 * v).cos();
            mesh.positions.push([u, v, h]);
            mesh.normals.push(Vec3::new(-h, h, 1.0).normalize().to_array());
            mesh.uvs.push([3.0 * u, 2.0 * v]);
            mesh.tangents.push([1.0, h, 0.0]);
            if x < n && y < n {
                let at = y * (n + 1) + x;
                mesh.indices.push([at, at + 1, at + n + 2]);
                mesh.indices.push([at, at + n + 2, at + n + 1]);
            }
        }
    }
    // Two that no ray can hit, and one twice.
    mesh.positions.push([1e30, 0.0, 0.0]);
    mesh.normals.push([0.0, 0.0, 1.0]);
    mesh.uvs.push([0.0; 2]);
    mesh.tangents.push([1.0, 0.0, 0.0]);
    let odd = mesh.positions.len() as u32 - 1;
    mesh.indices.extend([[0, 1, odd], [odd, 3, 4], mesh.indices[5]]);
    mesh
}

/// A PLY file of `faces` over the vertices of `mesh`.
pub(super) fn ply(mesh: &Mesh, faces: &[Vec<u32>], format: &str) -> Vec<u8> {
    let mut out = format!("ply\nformat {format} 1.0\nelement vertex {}\n", mesh.positions.len());
    let mut columns = vec!["x", "y", "z"];
    columns.extend(if mesh.normals.is_empty() { &[][..] } else { &["nx", "ny", "nz"] });
    columns.extend(if mesh.uvs.is_empty() { &[][..] } else { &["u", "v"] });
    columns.iter().for_each(|name| out += &format!("property float {name}\n"));
    out += &format!("element face {}\nproperty list uchar int vertex_indices\nend_header\n", faces.len());
    let mut out = out.into_bytes();
    let (text, big) = (format == "ascii", format == "binary_big_endian");
    let put = |out: &mut Vec<u8>, bits: u32, number: String| match (text, big) {
        (true, _) => out.extend_from_slice(format!("{number} ").as_bytes()),
        (_, true) => out.extend_from_slice(&bits.to_be_bytes()),
        (_, false) => out.extend_from_slice(&bits.to_le_bytes()),
    };
    for i in 0..mesh.positions.len() {
        let (normal, uv) = (mesh.normals.get(i), mesh.uvs.get(i));
        let attributes = normal.into_iter().flatten().chain(uv.into_iter().flatten());
        mesh.positions[i].iter().chain(attributes).for_each(|c| put(&mut out, c.to_bits(), c.to_string()));
    }
    for face in faces {
        let count = face.len() as u8;
        out.extend_from_slice(if text { format!("\n{count} ").into_bytes() } else { vec![count] }.as_slice());
        face.iter().for_each(|&c| put(&mut out, c, c.to_string()));
    }
    out
}

/// The triangles of `mesh` as they stand.
pub(super) fn triangles(mesh: &Mesh) -> Vec<Vec<u32>> {
    mesh.indices.iter().map(|t| t.to_vec()).collect()
}

pub(super) const NEVER: &(dyn Fn() -> bool + Sync) = &|| false;

#[test]
fn every_triangle_that_can_be_hit_is_in_one_page_with_its_attributes() {
    let mut mesh = sheet(60);
    *mesh.positions.last_mut().expect("the odd one") = [f32::NAN, 0.0, 0.0];
    let mut seen = BTreeSet::new();
    let corners = |name: u32| mesh.indices[name as usize].map(|c| mesh.positions[c as usize]);
    let all = 0..mesh.indices.len() as u32;
    let mut centres: Vec<Centre> = all.filter_map(|name| Centre::of(corners(name), name)).collect();
    let ends = cut(&mut centres, 500);
    assert_eq!(ends.len(), mesh.indices.len().div_ceil(500), "pages are full");
    let mut start = 0;
    for end in ends {
        let names: Vec<u32> = centres[start..end].iter().map(|c| c.name).collect();
        start = end;
        let (bytes, _) = encode(&mesh, &names, |n| n);
        assert!(is_whole(&bytes));
        let mut room = vec![0u8; bytes.len() + 64];
        let start = room.as_ptr().align_offset(64);
        room[start..start + bytes.len()].copy_from_slice(&bytes);
        let page = &room[start..start + bytes.len()];
        let view = PageView::new(page);
        let mut one = Mesh::default();
        for slot in 0..view.slots() {
            let name = view.primitive(slot);
            if name == NONE {
                continue;
            }
            assert!(seen.insert(name), "triangle {name} is in two pages");
            read_triangle(page, slot, &mut one);
            let of = mesh.indices[name as usize].map(|i| i as usize);
            assert_eq!(one.positions, of.map(|i| mesh.positions[i]));
            assert_eq!(one.normals, of.map(|i| mesh.normals[i]));
            assert_eq!(one.uvs, of.map(|i| mesh.uvs[i]));
            assert_eq!(one.tangents, of.map(|i| mesh.tangents[i]));
        }
    }
    // All but the two with a corner that is not a number.
    assert_eq!(seen.len(), mesh.indices.len() - 2);
}

#[test]
fn a_damaged_page_is_known() {
    let mesh = sheet(8);
    let names: Vec<u32> = (0..100).collect();
    let (bytes, _) = encode(&mesh, &names, |n| n);
    for at in (0..bytes.len()).step_by(37) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 16;
        assert!(!is_whole(&damaged), "byte {at}");
    }
    for length in [0, 1, 8, 63, 64, bytes.len() - 1] {
        assert!(!is_whole(&bytes[..length]), "cut at {length}");
    }
}

fn bits(hit: &Hit) -> [u32; 6] {
    [hit.t.to_bits(), hit.u.to_bits(), hit.v.to_bits(), hit.geometry, hit.primitive, hit.instance]
}

#[test]
fn a_mesh_that_changes_while_it_is_read_is_not_cut() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("sheet.ply");
    std::fs::write(&path, "stands for a mesh").expect("writable");
    let maker = PageMaker::new(Some(folder.path()), LEAST_PAGE_BYTES, u64::MAX).expect("a folder is given");
    let source = Source { path: &path, to_world: &Transform::IDENTITY, reverse: false };
    let named = maker.name(&source).expect("the source is there");
    let mesh = sheet(30);
    std::fs::write(&path, ply(&mesh, &triangles(&mesh), "ascii")).expect("writable");
    let error = maker.make(&source, &named, NEVER).err().expect("it has changed");
    assert!(error.to_string().contains("changed while it was read"), "{error}");
    assert!(!folder.path().join("pages").exists());
}

#[test]
fn a_page_that_has_become_unreadable_is_no_panic() {
    let mut mesh = sheet(2);
    let room = [0u8; 4096 + 64];
    let start = room.as_ptr().align_offset(64);
    read_triangle(&room[start..start + 4096], 77, &mut mesh);
    assert_eq!(mesh.positions.len(), 3);
    assert!(mesh.normals.is_empty() && mesh.uvs.is_empty() && mesh.tangents.is_empty());
}

#[test]
fn rays_through_pages_find_what_rays_through_the_mesh_find() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("sheet.ply");
    let mut mesh = sheet(70);
    mesh.tangents.clear();
    std::fs::write(&path, ply(&mesh, &triangles(&mesh), "binary_little_endian")).expect("writable");
    let indices = &mesh.indices[..];
    let whole = [
        Geometry::Triangles { positions: &mesh.positions, indices: &[], alpha: None },
        Geometry::Triangles { positions: &mesh.positions, indices, alpha: None },
    ];
    let whole = BvhScene::new(&whole, &[], &[], &NoCustom, None, Form::best()).expect("few triangles");
    for page_bytes in [LEAST_PAGE_BYTES, 16 << 10, MOST_PAGE_BYTES] {
        let (paged, file) = made(folder.path(), &path, page_bytes);
        assert_eq!(paged.triangles, mesh.indices.len() as u64);
        let store = PageStore::new(vec![PageSource::File(file)], page_bytes).expect("few pages");
        let budget = store.least(1) + 2 * page_bytes as u64;
        store.open(budget, 1).expect("the least and more");
        // Beside a mesh that has a mask, which is no matter of theirs.
        let all = (&mesh.positions[..], &mesh.indices[..]);
        let masked = Geometry::Triangles { positions: all.0, indices: all.1, alpha: Some(0) };
        let geometry = [masked, Geometry::Pages { first: 0, outlines: &paged.outlines }];
        let pages: Option<&dyn Pages> = Some(&store);
        let paged = BvhScene::new(&geometry, &[], &[], &NoCustom, pages, Form::best()).expect("few pages");
        let held = store.hold();
        let mut hits = 0;
        for i in 0..4000u32 {
            let r = |k: u32| {
                (i.wrapping_mul(747_796_405).wrapping_add(k * 277_803_737) >> 8) as f32 / (1 << 24) as f32
            };
            let from = Vec3::new(r(1) * 1.4 - 0.2, r(2) * 1.4 - 0.2, if i % 2 == 0 { 1.0 } else { 0.05 });
            let ray = Ray::new(from, Vec3::new(r(3), r(4), r(5) - 0.3) - from);
            let (a, b) = (whole.closest(&ray), paged.closest(&ray));
            assert_eq!(bits(&a), bits(&b), "{ray:?}: {a:?} {b:?}");
            assert_eq!(whole.occluded(&ray), paged.occluded(&ray), "{ray:?}");
            if a.geometry == NONE {
                continue;
            }
            hits += 1;
            store.with_triangle(b.place, |one| {
                let of = mesh.indices[a.primitive as usize].map(|i| mesh.positions[i as usize]);
                assert_eq!(one.positions, of);
            });
        }
        assert!(hits > 1000, "{hits} hits");
        drop(held);
        let (cost, _, failures) = store.stats();
        assert!(failures.is_empty(), "{failures:?}");
        assert!(cost.peak <= budget, "{} bytes of {budget}", cost.peak);
        assert!(
            page_bytes == MOST_PAGE_BYTES || cost.total.counts.misses_capacity > 0,
            "pages came and went"
        );
    }
}

/// Two threads look while a third takes and gives: what they see is right, and what is counted stays within what is
/// allowed at the time, and is given back.
#[test]
fn memory_comes_and_goes_while_pages_are_looked_at() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("sheet.ply");
    let mut mesh = sheet(100);
    mesh.tangents.clear();
    std::fs::write(&path, ply(&mesh, &triangles(&mesh), "binary_little_endian")).expect("writable");
    let page_bytes = LEAST_PAGE_BYTES;
    let (paged, file) = made(folder.path(), &path, page_bytes);
    let pages = paged.outlines.len() as u32;
    let store = PageStore::new(vec![PageSource::File(file)], page_bytes).expect("few pages");
    let all = 150 * (page_bytes as u64 + 256);
    store.open(all, 2).expect("the least and more");
    assert!(pages > 200 && !store.is_full(), "{pages}");
    let sum = |page: u32| {
        let mut sum = 0u64;
        store.visit(page, &mut |bytes| sum = bytes.iter().map(|b| u64::from(*b)).sum());
        sum
    };
    let sums: Vec<u64> = (0..pages).map(sum).collect();
    assert!(store.is_full());
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for start in [1u32, 2] {
            let (store, sums, done) = (&store, &sums, &done);
            scope.spawn(move || {
                let _held = store.hold();
                let mut page = start;
                while !done.load(Ordering::Relaxed) {
                    page = page.wrapping_mul(747_796_405).wrapping_add(start);
                    let page = page >> 8;
                    let page = page % sums.len() as u32;
                    store.visit(page, &mut |bytes| {
                        let sum: u64 = bytes.iter().map(|b| u64::from(*b)).sum();
                        assert_eq!(sum, sums[page as usize]);
                    });
                }
            });
        }
        let used = store.used();
        for round in 0..200u64 {
            let taken = store.take(all / 4 * (round % 5), 2);
            assert_eq!(store.budget(), all - taken);
            assert!(used.load(Ordering::Relaxed) <= store.budget(), "{taken} taken");
            store.give(taken);
        }
        // Ten times what there is: they keep what they need.
        let taken = store.take(10 * all, 2);
        assert!(taken > all / 2 && store.budget() >= store.least(2), "{taken} of {all}");
        assert!(used.load(Ordering::Relaxed) <= store.budget());
        done.store(true, Ordering::Relaxed);
    });
    let (cost, _, failures) = store.stats();
    assert!(failures.is_empty() && cost.peak <= all, "{failures:?}");
}
