//! Damaged and difficult files: every one becomes a mesh, image or scene, or one clear error, soon
//! (and within bounded memory: `corpora` bounds it, from outside). Corpora of others stand in `../shared/scenes` (or `$WEIR_SHARED`) and
//! are left out, by name, where they are absent; our own damage is made here from good files.

use crate::support::shared;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use weir::error::Error;
use weir::scene::obj::read_obj;
use weir::scene::pbrt::read_pbrt;
use weir::scene::ply::read_ply;
use weir::texture::read_image;

/// The largest file of the corpora is 2 MB; a reader that needs this long is broken.
const MOST_TIME: Duration = Duration::from_secs(20);

/// Files below `folder` by extension, sorted.
pub(crate) fn files(folder: &Path, extensions: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a readable folder") {
            let path = entry.expect("a readable entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.file_name().is_some_and(|n| n.to_string_lossy().starts_with("._")) {
                // Another system's resource forks.
            } else if path.extension().is_some_and(|e| extensions.iter().any(|x| e.eq_ignore_ascii_case(x))) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// Runs a reader and holds its time and error against the rules.
fn attempt<T>(what: &dyn Display, read: impl FnOnce() -> Result<T, Error>) -> Result<T, String> {
    let start = Instant::now();
    let result = read();
    assert!(start.elapsed() < MOST_TIME, "{what}: took {:?}", start.elapsed());
    result.map_err(|e| {
        let text = e.to_string();
        assert!(!text.contains('\n') && text.len() < 1000, "{what}: not one line: {text:?}");
        assert!(matches!(e, Error::Input { .. } | Error::Io { .. }), "{what}: {text}");
        assert_eq!(e.exit_code(), 2, "{what}: {text}");
        text
    })
}

/// Reads all files of a corpus; returns the names that gave an error, with the error.
fn survey<T>(paths: &[PathBuf], read: impl Fn(&Path) -> Result<T, Error>) -> Vec<(String, String)> {
    let mut refused = Vec::new();
    for path in paths {
        if let Err(e) = attempt(&path.display(), || read(path)) {
            let name = path.file_name().expect("a file").to_string_lossy().into_owned();
            eprintln!("{name}: {e}");
            refused.push((name, e));
        }
    }
    eprintln!("{} files, {} refused", paths.len(), refused.len());
    refused
}

fn names(refused: &[(String, String)]) -> Vec<&str> {
    refused.iter().map(|(name, _)| name.as_str()).collect()
}

#[test]
fn pngsuite_reads_whole_and_its_broken_files_are_refused() {
    let Some(folder) = shared("hard-pngsuite") else { return };
    let paths = files(&folder, &["png"]);
    assert!(paths.len() > 150);
    let refused = survey(&paths, read_image);
    // By the suite's own naming, x* are damaged, and nothing else is.
    assert!(refused.iter().all(|(name, _)| name.starts_with('x')), "{:?}", names(&refused));
    let damaged =
        paths.iter().filter(|p| p.file_name().is_some_and(|n| n.to_string_lossy().starts_with('x')));
    assert_eq!(refused.len(), damaged.count(), "{:?}", names(&refused));
}

#[test]
fn valid_exr_files_read_and_show_the_display_window() {
    let Some(folder) = shared("exr-valid") else { return };
    let paths = files(&folder, &["exr"]);
    assert!(paths.len() > 20);
    assert_eq!(names(&survey(&paths, read_image)), [""; 0]);
    for path in files(&folder.join("DisplayWindow"), &["exr"]) {
        // Beside each file stands a picture of what a viewer should show.
        let image = read_image(&path).expect("valid");
        let shown = read_image(&path.with_extension("jpg")).expect("valid");
        assert_eq!((image.width, image.height), (shown.width, shown.height), "{}", path.display());
        let encoding = weir::scene::Encoding::Srgb;
        let (ours, theirs) = (image.linear_rgb(encoding), shown.linear_rgb(encoding));
        let meta = exr::meta::MetaData::read_from_file(&path, false).expect("valid");
        let data = meta.headers[0].own_attributes.layer_position;
        let size = meta.headers[0].layer_size;
        let display = meta.headers[0].shared_attributes.display_window.position;
        let (mut sum, mut count) = (0.0, 0);
        for y in 0..image.height as i32 {
            for x in 0..image.width as i32 {
                let i = (y * image.width as i32 + x) as usize;
                let (dx, dy) = (x + display.0 - data.0, y + display.1 - data.1);
                if dx < 0 || dy < 0 || dx >= size.0 as i32 || dy >= size.1 as i32 {
                    // The viewer that made the pictures shows grey here.
                    assert_eq!(ours[i], [0.0; 3]);
                    continue;
                }
                count += 1;
                let gap = |c: usize| (ours[i][c].clamp(0.0, 1.0).powf(0.45) - theirs[i][c].powf(0.45)).abs();
                sum += (0..3).map(gap).sum::<f32>() / 3.0;
            }
        }
        // JPEG and a viewer's gamma make 0.02; a shift by a few pixels is far above.
        // Single pixels beside the grey are the JPEG's, not the image's.
        assert!(count < 2 || sum / (count as f32) < 0.03, "{}: {}", path.display(), sum / count as f32);
    }
}

#[test]
fn obj_corpora_give_scenes_or_one_error() {
    for folder in ["hard-obj-tinyobj", "hard-obj2gltf", "hard-assimp", "obj-cornell", "obj-spot"] {
        let Some(folder) = shared(folder) else { continue };
        let paths = files(&folder, &["obj"]);
        assert!(!paths.is_empty());
        let refused = survey(&paths, |path| {
            let scene = read_obj(path)?;
            assert!(!scene.shapes.is_empty());
            assert!(scene.camera.camera_to_world.m.is_finite());
            Ok(())
        });
        let share = refused.len() as f64 / paths.len() as f64;
        assert!(share < 0.5, "{:?}", names(&refused));
    }
}

#[test]
fn ply_corpora_give_meshes_or_one_error() {
    let Some(folder) = shared("hard-assimp") else { return };
    let mut paths = files(&folder, &["ply"]);
    paths.push(folder.join("PLY/payload_JVN42386607"));
    let refused = survey(&paths, read_ply);
    let mut names = names(&refused);
    names.sort_unstable();
    let expected = [
        "crash-30d6d0f7c529b3b66b4131700b7a4580cd7082df.ply",
        "empty.ply",
        // Its faces are a property of its vertices.
        "issue623.ply",
        "payload_JVN42386607",
        // Points without faces.
        "points.ply",
        "pond.0.ply",
    ];
    assert_eq!(names, expected);
}

/// Truncations and byte changes of `good`: `count` files in all, the same on every run.
fn damage(good: &[u8], count: usize, mut each: impl FnMut(&[u8])) {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut next = |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % below.max(1) as u64) as usize
    };
    for i in 0..count {
        let mut bytes = good.to_vec();
        match i % 4 {
            0 => bytes.truncate(next(good.len())),
            1 => {
                // Headers are where damage does most.
                let at = next(good.len().min(400));
                bytes[at] ^= 1 << next(8);
            }
            2 => {
                for _ in 0..1 + next(8) {
                    let at = next(good.len());
                    bytes[at] = [0, 0xff, 0x7f, 0x80, b'9', b'-', b' ', b'\n'][next(8)];
                }
            }
            _ => {
                let (from, to) = (next(good.len()), next(good.len()));
                let len = next(16).min(good.len() - from.max(to));
                bytes.copy_within(from..from + len, to);
            }
        }
        each(&bytes);
    }
}

/// Damages `good` and reads it; good must read, and some of the damage must be noticed.
fn fuzz<T>(name: &str, good: &[u8], count: usize, read: impl Fn(&Path) -> Result<T, Error>) {
    let dir = tempfile::tempdir().expect("directory");
    let path = dir.path().join(name);
    std::fs::write(&path, good).expect("written");
    read(&path).expect("the good file reads");
    let (mut tried, mut refused) = (0, 0);
    damage(good, count, |bytes| {
        std::fs::write(&path, bytes).expect("written");
        tried += 1;
        refused += usize::from(attempt(&format!("{name}, mutation {tried}"), || read(&path)).is_err());
    });
    eprintln!("{name}: {tried} mutations, {refused} refused");
    assert!(refused > count / 20, "{name}: damage goes unnoticed");
}

#[test]
fn damaged_ply_files() {
    let header = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\n\
             property float u\nproperty float v\nelement face 8\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let faces = [[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 7, 6], [4, 5, 8, 7]];
    let mut text = header("ascii");
    let mut binary = header("binary_little_endian").into_bytes();
    for i in 0..9 {
        let v = [(i % 3) as f32, (i / 3) as f32, 0.0, 0.5, 0.25];
        text += &format!("{} {} {} {} {}\n", v[0], v[1], v[2], v[3], v[4]);
        binary.extend(v.iter().flat_map(|c| c.to_le_bytes()));
    }
    for f in faces {
        text += &format!("4 {} {} {} {}\n3 {} {} {}\n", f[0], f[1], f[2], f[3], f[0], f[1], f[2]);
        for n in [4, 3] {
            binary.push(n as u8);
            binary.extend(f[..n].iter().flat_map(|c: &i32| c.to_le_bytes()));
        }
    }
    fuzz("a.ply", text.as_bytes(), 800, read_ply);
    fuzz("b.ply", &binary, 800, read_ply);
}

#[test]
fn damaged_obj_and_mtl_files() {
    let obj = "mtllib m.mtl\no thing\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 1e0\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\n\
               usemtl red\nf 1/1/1 2/2/1 3/3/1\nf -5//1 -2//1 -1//1\nusemtl blue\ng x\nf 1 2 3 4\nf 1/1 2/2 5/3 \\\n4/1\n";
    let mtl = "newmtl red\nKd 1 0 0\nKs 0.5 0.5 0.5\nNs 50\nmap_Kd -s 1 2 -o 0 0 a.png\nd 0.5\nillum 2\n\
               newmtl blue\nKd 0 0 1\nKe 1 1 1\nNi 1.5\nTr 0.25\nillum 4\n";
    let dir = tempfile::tempdir().expect("directory");
    std::fs::write(dir.path().join("m.mtl"), mtl).expect("written");
    fuzz("a.obj", obj.as_bytes(), 800, read_obj);
    // A damaged library gives warnings or an error, and never a panic.
    let path = dir.path().join("a.obj");
    std::fs::write(&path, obj).expect("written");
    let mut tried = 0;
    damage(mtl.as_bytes(), 800, |bytes| {
        std::fs::write(dir.path().join("m.mtl"), bytes).expect("written");
        tried += 1;
        let _ = attempt(&format!("m.mtl, mutation {tried}"), || read_obj(&path));
    });
}

#[test]
fn damaged_pbrt_files() {
    let text = "LookAt 0 0 -5  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" [ 40 ]\n\
                Film \"rgb\" \"integer xresolution\" 40 \"integer yresolution\" 30\nSampler \"zsobol\" \"integer pixelsamples\" 4\n\
                WorldBegin\nLightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\nAttributeBegin\nRotate 30 0 1 0\nScale 1 2 1\n\
                Texture \"t\" \"spectrum\" \"checkerboard\" \"rgb tex1\" [ .8 .2 .1 ]\n\
                MakeNamedMaterial \"m\" \"string type\" \"diffuse\" \"texture reflectance\" \"t\"\nNamedMaterial \"m\"\n\
                AreaLightSource \"diffuse\" \"blackbody L\" [ 4000 ]\nShape \"sphere\" \"float radius\" 2\nAttributeEnd\n\
                ObjectBegin \"o\"\nShape \"trianglemesh\" \"point3 P\" [ 0 0 0 1 0 0 0 1 0 ] \"integer indices\" [ 0 1 2 ]\nObjectEnd\n\
                ObjectInstance \"o\"\nTransform [ 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 ]\nMaterial \"conductor\" \"spectrum eta\" \"metal-Cu-eta\"\n\
                Shape \"loopsubdiv\" \"integer levels\" 1 \"point3 P\" [ 0 0 0 1 0 0 0 1 0 ] \"integer indices\" [ 0 1 2 ]\n\
                Shape \"catmullclark\" \"integer levels\" 1 \"point3 P\" [ 0 0 0 1 0 0 0 1 0 ] \"integer indices\" [ 0 1 2 ] \
                \"integer facevertexcounts\" [ 3 ]\n";
    fuzz("a.pbrt", text.as_bytes(), 2000, read_pbrt);
    let mut zipped = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    std::io::Write::write_all(&mut zipped, text.as_bytes()).expect("memory");
    fuzz("a.pbrt.gz", &zipped.finish().expect("memory"), 800, read_pbrt);
}

/// A small picture with detail in every channel.
fn picture() -> image::RgbaImage {
    image::RgbaImage::from_fn(37, 23, |x, y| {
        image::Rgba([(x * 7) as u8, (y * 11) as u8, (x * y) as u8, (255 - x) as u8])
    })
}

#[test]
fn damaged_png_jpeg_and_other_images() {
    use image::{DynamicImage, ImageFormat};
    let encode = |image: &DynamicImage, format| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).expect("encodes");
        bytes.into_inner()
    };
    let rgba = DynamicImage::ImageRgba8(picture());
    let rgb = DynamicImage::ImageRgb8(rgba.to_rgb8());
    fuzz("a.png", &encode(&rgba, ImageFormat::Png), 800, read_image);
    fuzz("b.png", &encode(&DynamicImage::ImageRgb16(rgba.to_rgb16()), ImageFormat::Png), 400, read_image);
    fuzz("a.jpg", &encode(&rgb, ImageFormat::Jpeg), 400, read_image);
    fuzz("a.tga", &encode(&rgba, ImageFormat::Tga), 400, read_image);
    fuzz("a.bmp", &encode(&rgb, ImageFormat::Bmp), 400, read_image);
    fuzz("a.tif", &encode(&rgb, ImageFormat::Tiff), 400, read_image);
    fuzz("a.hdr", &encode(&DynamicImage::ImageRgb32F(rgb.to_rgb32f()), ImageFormat::Hdr), 400, read_image);
}

#[test]
fn damaged_pfm_files() {
    let mut pfm = b"PF\n9 7\n-1.0\n".to_vec();
    pfm.extend((0..9 * 7 * 3).flat_map(|i| (i as f32).to_le_bytes()));
    fuzz("a.pfm", &pfm, 800, read_image);
}

#[test]
fn damaged_exr_files() {
    use exr::prelude::*;
    let dir = tempfile::tempdir().expect("directory");
    let path = dir.path().join("good.exr");
    let pixel =
        |p: Vec2<usize>| (f16::from_f32(p.x() as f32 * 0.1), f16::from_f32(p.y() as f32), f16::from_f32(0.5));
    let half = SpecificChannels::rgb(pixel);
    for (compression, blocks) in [
        (Compression::ZIP16, Blocks::ScanLines),
        (Compression::PIZ, Blocks::Tiles(Vec2(16, 16))),
        (Compression::RLE, Blocks::Tiles(Vec2(8, 32))),
        (Compression::Uncompressed, Blocks::ScanLines),
        (Compression::B44, Blocks::ScanLines),
        (Compression::PXR24, Blocks::ScanLines),
    ] {
        let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
        let layer = Layer::new((45, 37), LayerAttributes::named("main"), encoding, half.clone());
        Image::from_layer(layer).write().to_file(&path).expect("written");
        let good = std::fs::read(&path).expect("readable");
        fuzz("a.exr", &good, 300, read_image);
    }
}

#[test]
fn an_exr_comes_back_as_written_in_every_window() {
    use exr::prelude::*;
    let dir = tempfile::tempdir().expect("directory");
    let path = dir.path().join("a.exr");
    let value = |x: i32, y: i32, c: usize| (x * 100 + y * 10) as f32 + c as f32 * 0.25;
    // The data window begins at (−3, 5), the display window at (0, 0): it cuts left and bottom.
    let channels = SpecificChannels::rgb(move |p: Vec2<usize>| {
        let (x, y) = (p.x() as i32 - 3, p.y() as i32 + 5);
        (value(x, y, 0), value(x, y, 1), value(x, y, 2))
    });
    let mut layer = Layer::new((10, 8), LayerAttributes::named("main"), Encoding::FAST_LOSSLESS, channels);
    layer.attributes.layer_position = Vec2(-3, 5);
    let window = IntegerBounds::new(Vec2(0, 0), Vec2(9, 11));
    Image::new(ImageAttributes::new(window), layer).write().to_file(&path).expect("written");
    let image = read_image(&path).expect("valid");
    assert_eq!((image.width, image.height, image.channels), (9, 11, 3));
    let rgb = image.linear_rgb(weir::scene::Encoding::Srgb);
    for y in 0..11 {
        for x in 0..9 {
            let inside = x < 7 && y >= 5;
            let want = if inside { [0, 1, 2].map(|c| value(x, y, c)) } else { [0.0; 3] };
            assert_eq!(rgb[(y * 9 + x) as usize], want, "{x} {y}");
        }
    }
}

#[test]
fn an_exr_that_claims_more_than_it_holds_is_refused_before_decoding() {
    use exr::prelude::*;
    let dir = tempfile::tempdir().expect("directory");
    let path = dir.path().join("a.exr");
    let channels = SpecificChannels::rgb(|_: Vec2<usize>| (1f32, 1f32, 1f32));
    let layer = Layer::new((16, 16), LayerAttributes::named("main"), Encoding::UNCOMPRESSED, channels);
    Image::from_layer(layer).write().to_file(&path).expect("written");
    let good = std::fs::read(&path).expect("readable");
    // Both windows are boxes of four i32; 15 is their last coordinate.
    for large in [70_000i32, 1 << 20, i32::MAX - 1] {
        let mut bytes = good.clone();
        for name in [b"dataWindow\0box2i\0".as_slice(), b"displayWindow\0box2i\0"] {
            let at = bytes.windows(name.len()).position(|w| w == name).expect("a window") + name.len() + 4;
            bytes[at + 8..at + 12].copy_from_slice(&large.to_le_bytes());
            bytes[at + 12..at + 16].copy_from_slice(&large.to_le_bytes());
        }
        std::fs::write(&path, &bytes).expect("written");
        assert!(attempt(&large, || read_image(&path)).is_err());
    }
}
