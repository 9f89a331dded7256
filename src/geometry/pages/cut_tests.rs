//! Meshes cut in little memory against the same cut in much.

use super::make::{Made, PageMaker, Source};
use super::memory::CutMemory;
use super::tests::{NEVER, ply, sheet, triangles};
use super::{DEFAULT_PAGE_BYTES, LEAST_PAGE_BYTES, PagedMesh};
use crate::error::Error;
use crate::geometry::Mesh;
use crate::math::Transform;
use crate::texture::cache_dir::MakersLock;
use glam::{DMat4, DVec3};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

fn paged(made: Made) -> PagedMesh {
    match made {
        Made::Pages(mesh, _) => mesh,
        Made::Stays(mesh) => panic!("{} triangles stay", mesh.indices.len()),
    }
}

fn maker(root: &Path, page_bytes: usize, threads: usize, bytes: u64) -> PageMaker {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("few threads");
    pool.install(|| {
        PageMaker::new(Some(root), page_bytes, u64::MAX).expect("a folder is given").within(bytes)
    })
}

/// Quads of a sheet, of which every third is two triangles, and a dart.
fn quads(n: u32) -> Vec<Vec<u32>> {
    let mut faces = Vec::new();
    for at in (0..n * (n + 1)).filter(|at| at % (n + 1) < n) {
        let [a, b, c, d] = [at, at + 1, at + n + 2, at + n + 1];
        if at % 3 == 0 {
            faces.extend([vec![a, b, c], vec![a, c, d]]);
        } else {
            faces.push(vec![a, b, c, d]);
        }
    }
    // Concave: where it is split depends on where its corners are.
    faces.push(vec![0, 2 * (n + 1), n + 2, 2]);
    faces
}

/// Puts every vertex somewhere else.
fn shuffled(mut mesh: Mesh) -> Mesh {
    let n = mesh.positions.len();
    let to = |i: usize| i * 7919 % n;
    assert!(!n.is_multiple_of(7919), "the step meets every vertex");
    let moved = |column: &Vec<[f32; 3]>| {
        let mut out = column.clone();
        column.iter().enumerate().for_each(|(i, v)| out[to(i)] = *v);
        out
    };
    mesh.positions = moved(&mesh.positions);
    mesh.normals = moved(&mesh.normals);
    mesh.indices.iter_mut().flatten().for_each(|c| *c = to(*c as usize) as u32);
    mesh
}

#[test]
fn pages_do_not_depend_on_the_memory_or_the_threads_that_they_were_made_with() {
    let folder = tempfile::tempdir().expect("a folder");
    let turned = DMat4::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 1.0)
        * DMat4::from_scale(DVec3::new(3.0, 0.1, -7.0));
    let turned = Transform::from_matrix(turned).expect("no axis is lost");
    let plain = Mesh { normals: Vec::new(), uvs: Vec::new(), ..sheet(90) };
    let coordinates = Mesh { normals: Vec::new(), ..sheet(80) };
    let thrice: Vec<Vec<u32>> = [triangles(&plain), triangles(&plain), triangles(&plain)].concat();
    // All in one place: the names alone divide them.
    let flat = Mesh { positions: vec![[0.5, -0.0, 0.0]; plain.positions.len()], ..Mesh::default() };
    let cases = [
        ("all attributes", ply(&sheet(250), &triangles(&sheet(250)), "binary_little_endian"), &turned, true),
        ("quads, big-endian", ply(&plain, &quads(90), "binary_big_endian"), &Transform::IDENTITY, false),
        ("text", ply(&coordinates, &quads(80), "ascii"), &turned, false),
        (
            "no order",
            {
                let mesh = shuffled(Mesh { uvs: Vec::new(), ..sheet(110) });
                ply(&mesh, &triangles(&mesh), "binary_little_endian")
            },
            &Transform::IDENTITY,
            true,
        ),
        ("three of each", ply(&plain, &thrice, "binary_little_endian"), &Transform::IDENTITY, false),
        ("a point", ply(&flat, &triangles(&plain), "binary_little_endian"), &Transform::IDENTITY, false),
    ];
    for (case, (what, bytes, to_world, reverse)) in cases.into_iter().enumerate() {
        let path = folder.path().join(format!("{case}.ply"));
        fs::write(&path, bytes).expect("writable");
        let source = Source { path: &path, to_world, reverse };
        for page_bytes in [LEAST_PAGE_BYTES, DEFAULT_PAGE_BYTES] {
            let named = maker(folder.path(), page_bytes, 1, 1 << 30).name(&source).expect("it is there");
            let mut expected: Option<Vec<u8>> = None;
            for (threads, memory) in [(2, 1 << 30), (1, 1 << 30), (1, 10_000), (2, 400_000), (3, 4_000_000)] {
                let root = tempfile::tempdir().expect("a folder");
                let maker = maker(root.path(), page_bytes, threads, memory);
                let mesh =
                    paged(maker.make(&source, &named, NEVER).unwrap_or_else(|e| panic!("{what}: {e}")));
                assert!(mesh.outlines.len() > 10, "{what}: {} pages", mesh.outlines.len());
                let made = fs::read(maker.path(&named)).expect("it has been made");
                let pages = fs::read_dir(root.path().join("pages")).expect("there").count();
                assert_eq!(pages, 1, "nothing else is left");
                match &expected {
                    None => expected = Some(made),
                    Some(expected) => assert!(
                        *expected == made,
                        "{what}: {threads} threads and {memory} bytes make other pages of {page_bytes}"
                    ),
                }
            }
        }
    }
}

#[test]
fn more_triangles_than_the_header_has_faces_go_to_disk() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fans.ply");
    let mut mesh = sheet(300);
    mesh.uvs.clear();
    // 200 corners each, along a row.
    let faces: Vec<Vec<u32>> =
        (0..600u32).map(|row| (0..200).map(|k| (row * 151 + k) % 90_000).collect()).collect();
    fs::write(&path, ply(&mesh, &faces, "binary_little_endian")).expect("writable");
    let source = Source { path: &path, to_world: &Transform::IDENTITY, reverse: false };
    let mut made = Vec::new();
    for memory in [1 << 30, 4 << 20] {
        let root = tempfile::tempdir().expect("a folder");
        let maker = maker(root.path(), LEAST_PAGE_BYTES, 1, memory);
        let named = maker.name(&source).expect("it is there");
        let mesh = paged(maker.make(&source, &named, NEVER).expect("room on the disk"));
        assert_eq!(mesh.triangles, 600 * 198);
        // The head names the source by the time.
        made.push(fs::read(maker.path(&named)).expect("it has been made").split_off(4096));
    }
    assert!(made[0] == made[1]);
}

#[test]
fn who_gives_up_leaves_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("sheet.ply");
    let mesh = sheet(100);
    fs::write(&path, ply(&mesh, &triangles(&mesh), "binary_little_endian")).expect("writable");
    let source = Source { path: &path, to_world: &Transform::IDENTITY, reverse: false };
    let mut asked_in_all = 0;
    for patience in 0.. {
        let maker = maker(folder.path(), LEAST_PAGE_BYTES, 2, 60_000);
        let named = maker.name(&source).expect("it is there");
        let asked = AtomicU32::new(0);
        let stop = || asked.fetch_add(1, Ordering::Relaxed) >= patience;
        match maker.make(&source, &named, &stop) {
            Err(Error::Interrupted) => {}
            Err(e) => panic!("{e}"),
            Ok(made) => {
                assert!(!paged(made).outlines.is_empty());
                asked_in_all = patience;
                break;
            }
        }
        let left = fs::read_dir(folder.path().join("pages")).map_or(0, Iterator::count);
        assert_eq!(left, 0, "given up at question {patience}");
    }
    assert!(asked_in_all > 20, "asked {asked_in_all} times only");
}

#[test]
fn who_waits_for_another_maker_takes_what_that_has_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let (ours, theirs) = (folder.path().join("ours"), folder.path().join("theirs"));
    let path = folder.path().join("sheet.ply");
    let mesh = sheet(40);
    fs::write(&path, ply(&mesh, &triangles(&mesh), "binary_little_endian")).expect("writable");
    let source = Source { path: &path, to_world: &Transform::IDENTITY, reverse: false };
    let other = maker(&theirs, LEAST_PAGE_BYTES, 1, 1 << 30);
    let named = other.name(&source).expect("it is there");
    paged(other.make(&source, &named, NEVER).expect("room on the disk"));
    let maker = maker(&ours, LEAST_PAGE_BYTES, 1, 1 << 30);
    fs::create_dir_all(ours.join("pages")).expect("writable");
    let lock = MakersLock::open(&ours, &named.lock_name());
    lock.wait(|| Ok::<_, Error>(())).expect("nobody has it");
    let waits = AtomicU32::new(0);
    let stop = || {
        waits.fetch_add(1, Ordering::Relaxed);
        false
    };
    std::thread::scope(|scope| {
        let waiter = scope.spawn(|| maker.make(&source, &named, &stop).map(paged));
        while waits.load(Ordering::Relaxed) < 3 {
            std::thread::sleep(Duration::from_millis(5));
        }
        assert!(!maker.path(&named).exists(), "it did not wait");
        fs::copy(other.path(&named), maker.path(&named)).expect("room on the disk");
        let before = fs::metadata(maker.path(&named)).expect("there").ino();
        drop(lock);
        waiter.join().expect("no panic").expect("room on the disk");
        assert_eq!(fs::metadata(maker.path(&named)).expect("there").ino(), before, "made again");
    });
}

#[test]
fn no_more_is_lent_than_there_is() {
    let memory = CutMemory::new(100);
    let now = AtomicU32::new(0);
    std::thread::scope(|scope| {
        for i in 0..8u32 {
            let (memory, now) = (&memory, &now);
            scope.spawn(move || {
                for k in 0..50 {
                    let share = memory.lend(u64::from(i * 17 + k), NEVER).expect("nobody gives up");
                    let bytes = share.bytes as u32;
                    assert!(now.fetch_add(bytes, Ordering::SeqCst) + bytes <= 100);
                    now.fetch_sub(bytes, Ordering::SeqCst);
                }
            });
        }
    });
    assert_eq!(memory.lend(u64::MAX, NEVER).expect("all is back").bytes, 100);
    assert_eq!(memory.most_lent(), 100);
    let _all = memory.lend(100, NEVER).expect("all is back");
    assert!(matches!(memory.lend(1, &|| true), Err(Error::Interrupted)));
}

#[test]
fn a_disk_that_takes_nothing_is_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("sheet.ply");
    let mesh = sheet(40);
    fs::write(&path, ply(&mesh, &triangles(&mesh), "binary_little_endian")).expect("writable");
    let source = Source { path: &path, to_world: &Transform::IDENTITY, reverse: false };
    for memory in [10_000, 1 << 30] {
        let root = tempfile::tempdir().expect("a folder");
        fs::write(root.path().join("pages"), b"stands in the way").expect("writable");
        let maker = maker(root.path(), LEAST_PAGE_BYTES, 1, memory);
        let named = maker.name(&source).expect("it is there");
        let error = maker.make(&source, &named, NEVER).err().expect("no room");
        assert!(matches!(error, Error::Resource(_)), "{error:?}");
        let line = error.to_string();
        assert!(line.contains("cannot keep the pages") && line.contains("--cache-dir"), "{line}");
        assert_eq!(line.lines().count(), 1);
    }
}
