use super::*;
use std::io::Write;

fn read(bytes: &[u8]) -> Result<TriangleMesh> {
    let mut file = tempfile::NamedTempFile::new().expect("temporary file");
    file.write_all(bytes).expect("written");
    read_ply(file.path())
}

fn header(format: &str, vertices: usize, faces: usize, list: &str) -> Vec<u8> {
    format!(
        "ply\nformat {format} 1.0\ncomment made here\nelement vertex {vertices}\nproperty float x\n\
         property float y\nproperty float z\nelement face {faces}\nproperty list {list} vertex_indices\nend_header\n"
    )
    .into_bytes()
}

const SQUARE: [[f32; 3]; 4] = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];

/// A square in binary; one face a list.
fn square(big: bool, faces: &[&[u32]]) -> Vec<u8> {
    let order = if big { "binary_big_endian" } else { "binary_little_endian" };
    let mut f = header(order, 4, faces.len(), "uchar int");
    for c in SQUARE.iter().flatten() {
        f.extend(if big { c.to_be_bytes() } else { c.to_le_bytes() });
    }
    for face in faces {
        f.push(face.len() as u8);
        for i in *face {
            f.extend(if big { i.to_be_bytes() } else { i.to_le_bytes() });
        }
    }
    f
}

#[test]
fn both_byte_orders_and_text_give_the_same_mesh() {
    let faces: &[&[u32]] = &[&[0, 1, 2], &[0, 2, 3], &[0, 1, 2, 3], &[3, 2, 1], &[0, 0, 1], &[], &[1, 2]];
    let want = vec![[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [3, 2, 1]];
    let mut text = header("ascii", 4, faces.len(), "uchar int");
    for p in SQUARE {
        text.extend(format!("{} {}\t{:e}\r\n", p[0], p[1], p[2]).bytes());
    }
    for face in faces {
        let words: Vec<String> = face.iter().map(u32::to_string).collect();
        text.extend(format!("{} {}\n", face.len(), words.join(" ")).bytes());
    }
    for bytes in [square(false, faces), square(true, faces), text] {
        let mesh = read(&bytes).expect("valid");
        assert_eq!(mesh.positions, SQUARE);
        assert_eq!(mesh.indices, want);
        assert!(mesh.positions.capacity() > mesh.positions.len());
    }
}

#[test]
fn attributes_of_all_types_and_strange_company_are_read_in_any_order() {
    let mut f = b"ply\r\nformat binary_big_endian 1.0\r\nobj_info x\r\nelement camera 2\r\nproperty list ushort \
        double d\r\nproperty char c\r\nelement vertex 3\r\nproperty double s\r\nproperty uchar red\r\n\
        property short z\r\nproperty float nx\r\nproperty list uchar float w\r\nproperty int x\r\nproperty float ny\r\n\
        property double y\r\nproperty float nz\r\nproperty float t\r\nelement face 1\r\nproperty uchar flags\r\n\
        property list uint ushort vertex_index\r\nproperty list uchar float texcoord\r\nelement edge 99\r\nproperty int a\r\nend_header\r\n"
        .to_vec();
    for n in [1u16, 0] {
        f.extend(n.to_be_bytes());
        f.extend((0..n).flat_map(|_| 1.5f64.to_be_bytes()));
        f.push(7);
    }
    for i in 0..3i32 {
        f.extend((f64::from(i) * 0.5).to_be_bytes());
        f.push(255);
        f.extend((-(i as i16)).to_be_bytes());
        f.extend(1f32.to_be_bytes());
        f.push(2);
        f.extend([0u8; 8]);
        f.extend((i * i).to_be_bytes());
        f.extend(2f32.to_be_bytes());
        f.extend((f64::from(i) + 0.25).to_be_bytes());
        f.extend(3f32.to_be_bytes());
        f.extend(0.75f32.to_be_bytes());
    }
    f.push(1);
    f.extend(3u32.to_be_bytes());
    f.extend([0u16, 1, 2].iter().flat_map(|i| i.to_be_bytes()));
    f.push(1);
    f.extend([0u8; 4]);
    // The edges are missing: nobody reads them.
    let mesh = read(&f).expect("valid");
    assert_eq!(mesh.positions, [[0., 0.25, 0.], [1., 1.25, -1.], [4., 2.25, -2.]]);
    assert_eq!(mesh.normals, [[1., 2., 3.]; 3]);
    assert_eq!(mesh.uvs, [[0., 0.75], [0.5, 0.75], [1.0, 0.75]]);
    assert_eq!(mesh.indices, [[0, 1, 2]]);
}

#[test]
fn a_gzipped_file_reads_as_the_plain_one() {
    let plain = square(false, &[&[0, 1, 2]]);
    let dir = tempfile::tempdir().expect("directory");
    let path = dir.path().join("a.ply.gz");
    let mut zip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    zip.write_all(&plain).expect("memory");
    let mut bytes = zip.finish().expect("memory");
    std::fs::write(&path, &bytes).expect("written");
    assert_eq!(read_ply(&path).expect("valid"), read(&plain).expect("valid"));
    bytes.truncate(bytes.len() - 12);
    std::fs::write(&path, &bytes).expect("written");
    assert!(read_ply(&path).is_err());
}

#[test]
fn long_meshes_cross_buffers_without_loss() {
    // Sizes such that records straddle the 256 KiB buffer; a quad in the middle breaks the fast loop.
    let n = 100_003u32;
    let mut f = header("binary_little_endian", n as usize, n as usize, "uchar uint");
    for i in 0..n {
        f.extend([i as f32, 0.5, -(i as f32)].iter().flat_map(|c| c.to_le_bytes()));
    }
    let mut want = Vec::new();
    for i in 0..n {
        let corners: Vec<u32> = (0..if i == 60_000 { 4 } else { 3 }).map(|k| (i + k) % n).collect();
        want.push([corners[0], corners[1], corners[2]]);
        if let Some(&last) = corners.get(3) {
            want.push([corners[0], corners[2], last]);
        }
        f.push(corners.len() as u8);
        f.extend(corners.iter().flat_map(|c| c.to_le_bytes()));
    }
    let mesh = read(&f).expect("valid");
    assert!(mesh.positions.iter().enumerate().all(|(i, p)| *p == [i as f32, 0.5, -(i as f32)]));
    assert_eq!(mesh.indices, want);
}

#[test]
fn errors_say_where_and_what() {
    let path_free = |bytes: &[u8]| {
        let e = read(bytes).expect_err("damaged").to_string();
        assert!(!e.contains('\n'));
        e.split_once(':').map(|(_, rest)| rest.to_string()).unwrap_or(e)
    };
    let text = |body: &str| {
        let mut f = header("ascii", 3, 1, "uchar int");
        f.extend(body.bytes());
        path_free(&f)
    };
    assert!(path_free(b"").contains("empty"));
    assert!(path_free(b"solid x").contains("not a PLY"));
    assert!(path_free(b"ply\nformat ascii 1.0\nelement vertex x\n").starts_with("3: element vertex"));
    assert!(path_free(b"ply\nformat ascii 1.0\nproperty float x\n").starts_with("3: "));
    assert!(path_free(b"ply\nformat ascii 2.0\nend_header\n").starts_with("2: "));
    assert!(path_free(b"ply\nformat ascii 1.0\n").contains("end_header"));
    assert!(text("0 0 0\n1 0 0\n0 x 0\n3 0 1 2\n").starts_with("13: `x`"));
    assert!(text("0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n").starts_with("14: face 0 names vertex 3"));
    assert!(text("0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n").starts_with("14: face 0 names vertex -1"));
    assert!(text("0 0 0\n1 0 0\n0 1 0\n-3 0 1 2\n").starts_with("14: face 0: a list of length -3"));
    assert!(text("0 0 0\n1 0 0\n0 nan 0\n3 0 1 2\n").contains("vertex 2: its position is not finite"));
    assert!(text("0 0 0\n1 0 0\n0 1 0\n").contains("ends"));
    assert!(path_free(&square(false, &[&[0, 1, 4]])).contains("face 0 names vertex 4"));
    assert!(path_free(&header("ascii", 0, 0, "uchar int")).contains("no vertices"));
    let whole = square(false, &[&[0, 1, 2], &[0, 2, 3]]);
    assert!(path_free(&whole[..whole.len() - 1]).contains("byte"));
}

#[test]
fn counts_that_the_file_cannot_hold_are_refused_before_anything_is_allocated() {
    for n in [5_000_000_000u64, 4_000_000_000, 1 << 20] {
        for (v, f) in [(n, 1), (1, n)] {
            let mut bytes = header("binary_little_endian", v as usize, f as usize, "uchar int");
            bytes.extend([0; 200]);
            assert!(read(&bytes).is_err());
        }
    }
    let mut f = header("binary_little_endian", 4, 1, "uint int");
    f.extend([0; 48]);
    f.extend(u32::MAX.to_le_bytes());
    assert!(read(&f).is_err());
}

#[test]
#[ignore = "a measurement: cargo test --release ply_speed -- --ignored --nocapture"]
fn ply_speed() {
    let (w, h) = (500u32, 400u32);
    let mut f =
        header("binary_little_endian", (w * h) as usize, (2 * (w - 1) * (h - 1)) as usize, "uchar int");
    for i in 0..w * h {
        f.extend([(i % w) as f32, (i / w) as f32, 0.0].iter().flat_map(|c| c.to_le_bytes()));
    }
    for y in 0..h - 1 {
        for x in 0..w - 1 {
            let i = y * w + x;
            for t in [[i, i + 1, i + w], [i + 1, i + w + 1, i + w]] {
                f.push(3);
                f.extend(t.iter().flat_map(|c| c.to_le_bytes()));
            }
        }
    }
    let dir = tempfile::tempdir().expect("directory");
    let path = dir.path().join("grid.ply");
    std::fs::write(&path, &f).expect("written");
    for _ in 0..5 {
        let start = std::time::Instant::now();
        let mesh = read_ply(&path).expect("valid");
        let ms = start.elapsed().as_secs_f64() * 1e3;
        println!("{:.1} MB, {} triangles: {ms:.2} ms", f.len() as f64 / 1e6, mesh.indices.len());
    }
}
