use super::*;
use crate::color::Rgb;
use crate::scene::{CameraKind, Light, Material, Texture};
use glam::Vec3;

/// Writes files into a new folder and reads the first.
fn read(files: &[(&str, &str)]) -> Result<SceneDescription> {
    let dir = tempfile::tempdir().expect("directory");
    for (name, text) in files {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().expect("inside the folder")).expect("folder");
        std::fs::write(path, text).expect("written");
    }
    read_obj(&dir.path().join(files[0].0))
}

fn mesh(scene: &SceneDescription, i: usize) -> &TriangleMesh {
    match &scene.meshes[i] {
        MeshSource::Inline(m) => m,
        other => panic!("{other:?}"),
    }
}

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n";

#[test]
fn relative_indices_continued_lines_and_mixed_corners_are_resolved() {
    let scene = read(&[(
        "a.obj",
        "\u{feff}# c\r\nv 0 0 0 1 0 0\r\nv 1 0 0 0.5\nv 1 \\\n1 0\nv 0 1 0\nvt .5\nvn 0 0 1 # up\nf 1 2 3 4 # quad\n\
         f -4//-1 -3//-1 -2//-1\nf 1/1/1 2/1/1 3/1/1\nf 1/1 2 3\nf 1 1 2\nl 1 2\np 1\nf 1 2\ng x\ns 1\nwhatever 3\n",
    )])
    .expect("valid");
    let kinds: Vec<_> = (0..scene.meshes.len())
        .map(|i| mesh(&scene, i))
        .map(|m| (m.indices.len(), !m.uvs.is_empty(), !m.normals.is_empty()))
        .collect();
    // The quad, and the face whose corners disagree, have only positions.
    assert_eq!(kinds, [(3, false, false), (1, false, true), (1, true, true)]);
    let quad = mesh(&scene, 0);
    assert_eq!(quad.positions[quad.indices[1][2] as usize], [0., 1., 0.]);
    assert_eq!(mesh(&scene, 2).uvs, [[0.5, 0.0]; 3]);
    assert_eq!(scene.warnings.len(), 1);
    for i in 0..3 {
        let m = mesh(&scene, i);
        assert!(m.uvs.is_empty() || m.uvs.len() == m.positions.len());
        assert!(m.normals.is_empty() || m.normals.len() == m.positions.len());
        assert!(m.positions.capacity() > m.positions.len());
    }
}

#[test]
fn attributes_that_do_not_exist_are_left_out_with_a_warning() {
    let scene =
        read(&[("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1/1/1 2/0/1 3/9/1\nf 1//-2 2//1 3//1\n")])
            .expect("valid");
    assert_eq!(scene.meshes.len(), 2);
    assert!(mesh(&scene, 0).uvs.is_empty() && mesh(&scene, 0).normals.len() == 3);
    assert!(mesh(&scene, 1).normals.is_empty());
    assert_eq!(scene.warnings.len(), 2);
}

#[test]
fn a_concave_polygon_keeps_its_area() {
    // An L of area 3.
    let scene = read(&[("a.obj", "v 1 1 0\nv 1 2 0\nv 0 2 0\nv 0 0 0\nv 2 0 0\nv 2 1 0\nf 1 2 3 4 5 6\n")])
        .expect("valid");
    let m = mesh(&scene, 0);
    let areas: Vec<f32> = m
        .indices
        .iter()
        .map(|t| t.map(|i| Vec3::from(m.positions[i as usize])))
        .map(|[a, b, c]| 0.5 * (b - a).cross(c - a).z)
        .collect();
    assert!(areas.iter().all(|&a| a > 0.0) && (areas.iter().sum::<f32>() - 3.0).abs() < 1e-6, "{areas:?}");
}

#[test]
fn errors_have_line_and_column() {
    let at = |text: &str| {
        let e = read(&[("a.obj", text)]).expect_err(text).to_string();
        assert!(!e.contains('\n'));
        e.split_once("a.obj").map(|(_, rest)| rest.to_string()).expect("the file's name")
    };
    assert!(at("v 0 0\n").starts_with(":1:1: `v` needs 3 numbers"));
    assert!(at("\nv 0 x 0\n").starts_with(":2:5: `x` where a finite number"));
    assert!(at("v 0 nan 0\n").starts_with(":1:5: "));
    assert!(at("v 0 0 0\nf 1 1 2\n").starts_with(":2:7: `2` names vertex 2 of 1"));
    assert!(at("v 0 0 0\nf 0 1 1\n").starts_with(":2:3: "));
    assert!(at("v 0 0 0\nf 1 1 -2\n").starts_with(":2:7: "));
    assert!(at("v 0 0 0\nf 1 1 -9223372036854775808\n").starts_with(":2:7: "));
    assert!(at("v 0 0 0\nf 1/// 1 1\n").starts_with(":2:3: "));
    assert!(at("v 0 0 0\nf / 1 1\n").starts_with(":2:3: "));
    assert!(at("").contains("no faces"));
    assert!(at("v 0 0 0\nv 1 0 0\nf 1 2 1\n").contains("no faces"));
    assert!(at("v 0 0 0\0").contains("binary"));
}

#[test]
fn materials_follow_their_users_expectations() {
    let mtl = "Kd 9 9 9\nnewmtl matte\nKd 0.2 0.4 0.6\nKs 0.9 0.9 0.9\nNs 0\n\
        newmtl gloss\nKd .2 .2 .2\nKs .5 .5 .5\nNs 98\nillum 2\nNi 1.45\n\
        newmtl mirror\nKd 0 0 0\nKs .9 .8 .7\nillum 3\n\
        newmtl glass\nKd 0 0 0\nillum 7\nNi 1.6\nd 0.5\n  newmtl  two words\nKd 0.25\nTr 0.75\n\
        newmtl lamp\nKe 3 2 1\nnewmtl metal\nKd 1 .5 .2\nPm 1\nPr .5\nKd\nKs spectral x.rfl\nillum\nillum -3\n";
    let names = ["matte", "gloss", "MIRROR", "glass", "two words ", "lamp", "metal", "missing"];
    let mut obj = format!("mtllib m.mtl other.mtl\n{TRIANGLE}");
    for n in names {
        obj += &format!("usemtl {n}\nf 1 2 3\n");
    }
    let scene = read(&[("a.obj", &obj), ("m.mtl", mtl)]).expect("valid");
    assert_eq!(scene.shapes.len(), names.len());
    let value = |id: crate::scene::TextureId| match scene.textures[id.index()] {
        Texture::Constant(c) => c,
        ref other => panic!("{other:?}"),
    };
    let material = |i: usize| &scene.materials[scene.shapes[i].material.index()];
    let Material::Diffuse { reflectance } = *material(0) else { panic!("{:?}", material(0)) };
    assert_eq!(value(reflectance), Rgb::new(0.2, 0.4, 0.6));
    let Material::CoatedDiffuse { eta, roughness, .. } = *material(1) else { panic!("{:?}", material(1)) };
    assert_eq!((eta, roughness.remap), (1.45, false));
    assert!((value(roughness.u).x - 0.02f32.sqrt()).abs() < 1e-6);
    let Material::ConductorReflectance { reflectance, roughness } = *material(2) else {
        panic!("{:?}", material(2))
    };
    assert_eq!((value(reflectance), value(roughness.u)), (Rgb::new(0.9, 0.8, 0.7), Rgb::ZERO));
    let Material::Dielectric { eta, .. } = *material(3) else { panic!("{:?}", material(3)) };
    assert_eq!(eta, 1.6);
    assert!(scene.shapes[3].alpha.is_none());
    assert_eq!(scene.shapes[4].alpha.map(value), Some(Rgb::splat(0.25)));
    let light = scene.shapes[5].area_light.expect("Ke emits");
    assert_eq!(scene.area_lights[light.index()].radiance, Rgb::new(3., 2., 1.));
    let Material::ConductorReflectance { reflectance, roughness } = *material(6) else {
        panic!("{:?}", material(6))
    };
    assert_eq!((value(reflectance), value(roughness.u).x), (Rgb::new(1., 0.5, 0.2), 0.25));
    assert!(matches!(material(7), Material::Diffuse { .. }));
    let all: Vec<&str> = scene.warnings.iter().map(|w| w.message.as_str()).collect();
    for part in ["other.mtl", "`missing`", "Kd needs", "Ks needs", "illum needs"] {
        assert!(all.iter().any(|w| w.contains(part)), "{part}: {all:?}");
    }
}

#[test]
fn textures_are_found_through_options_backslashes_case_and_foreign_folders() {
    let mtl = "newmtl a\nKd 0.5 0.5 0.5\nmap_Kd -s 2 3 1 -o 0.25 -blendu on .\\IMAGES\\Wood Grain.PNG\n\
        newmtl b\nKd 0 0 0\nmap_Kd C:\\work\\leaf.png -bm 2\nmap_d -imfchan m leaf.png\n\
        newmtl c\nmap_kd /nowhere/none.png\nmap_bump x.png\nmap_Ke glow.gif\n";
    let obj = format!(
        "mtllib sub\\My Materials.mtl\n{TRIANGLE}usemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 1/1 2/2 3/3\nusemtl c\nf 1 2 3\n"
    );
    let scene = read(&[
        ("a.obj", &obj),
        ("sub/my materials.mtl", mtl),
        ("sub/images/wood grain.png", ""),
        ("leaf.png", ""),
        ("glow.gif", ""),
    ])
    .expect("valid");
    let files: Vec<String> = scene
        .images
        .iter()
        .map(|i| i.path.file_name().expect("a name").to_string_lossy().into_owned())
        .collect();
    assert_eq!(files, ["wood grain.png", "leaf.png", "leaf.png"]);
    let texture = |i: usize| match scene.materials[scene.shapes[i].material.index()] {
        Material::Diffuse { reflectance } => &scene.textures[reflectance.index()],
        ref other => panic!("{other:?}"),
    };
    let Texture::Scale { texture: image, scale } = texture(0) else { panic!("{:?}", texture(0)) };
    assert_eq!(scene.textures[scale.index()], Texture::Constant(Rgb::splat(0.5)));
    let Texture::Image { mapping, .. } = &scene.textures[image.index()] else { panic!() };
    assert_eq!(*mapping, crate::scene::Mapping::Uv { scale: [2., 3.], delta: [0.25, 0.] });
    assert!(matches!(texture(1), Texture::Image { .. }), "black Kd counts as white");
    assert!(scene.shapes[1].alpha.is_some());
    assert_eq!(*texture(2), Texture::Constant(Rgb::splat(0.5)));
    let all: Vec<&str> = scene.warnings.iter().map(|w| w.message.as_str()).collect();
    assert_eq!(all.len(), 3, "{all:?}");
}

/// A unit box; `inward` normals, without the faces whose number is in `without` (−x +x −y +y −z +z).
fn cube(inward: bool, without: &[usize]) -> String {
    let mut text = String::new();
    for i in 0..8 {
        text += &format!("v {} {} {}\n", i & 1, i >> 1 & 1, i >> 2 & 1);
    }
    let faces = [[1, 5, 7, 3], [2, 4, 8, 6], [1, 2, 6, 5], [3, 7, 8, 4], [1, 3, 4, 2], [5, 6, 8, 7]];
    for (_, f) in faces.iter().enumerate().filter(|(i, _)| !without.contains(i)) {
        let mut f = *f;
        if inward {
            f.reverse();
        }
        text += &format!("f {} {} {} {}\n", f[0], f[1], f[2], f[3]);
    }
    text
}

/// Camera position and direction.
fn camera(scene: &SceneDescription) -> (Vec3, Vec3) {
    let t = scene.camera.camera_to_world;
    (t.point(Vec3::ZERO), t.vector(Vec3::Z))
}

#[test]
fn a_model_fills_four_fifths_of_the_frame_upright() {
    let scene = read(&[("a.obj", &cube(false, &[]))]).expect("valid");
    let to_camera = scene.camera.camera_to_world.inverse();
    let CameraKind::Perspective { fov_degrees } = scene.camera.kind else { panic!("{:?}", scene.camera) };
    let tan = (0.5 * fov_degrees.to_radians()).tan();
    let mut most = 0f32;
    for p in &mesh(&scene, 0).positions {
        let q = to_camera.point(Vec3::from(*p));
        assert!(q.z > 0.0);
        most = most.max(q.y.abs() / (q.z * tan)).max(q.x.abs() / (q.z * tan * 16.0 / 9.0));
    }
    assert!((most - 0.8).abs() < 1e-3, "{most}");
    let up = scene.camera.camera_to_world.vector(Vec3::Y);
    assert!(up.y > 0.8);
    // Not mirrored: what is right of the view direction in a right-handed world is right in camera space.
    let (_, dir) = camera(&scene);
    assert!(scene.camera.camera_to_world.vector(Vec3::X).dot(dir.cross(Vec3::Y)) > 0.8);
    assert_eq!(scene.lights.len(), 2);
}

#[test]
fn an_open_box_is_seen_through_its_opening_and_a_room_from_inside() {
    let scene = read(&[("a.obj", &cube(true, &[4]))]).expect("valid");
    let (eye, dir) = camera(&scene);
    assert!(eye.z < 0.0 && dir.z > 0.999, "{eye} {dir}");
    let lamp = format!(
        "mtllib m.mtl\n{}v .4 .99 .4\nv .6 .99 .4\nv .5 .99 .6\nusemtl lamp\nf 9 10 11\n",
        cube(true, &[])
    );
    let scene = read(&[("a.obj", &lamp), ("m.mtl", "newmtl lamp\nKe 5 5 5\n")]).expect("valid");
    let (eye, _) = camera(&scene);
    assert!(eye.min_element() > 0.0 && eye.max_element() < 1.0, "{eye}");
    assert!(scene.lights.is_empty(), "a room with a lamp needs no sky");
    // A lamp of its own does not darken a model in the open.
    let lamp = lamp.replace(&cube(true, &[]), &cube(false, &[]));
    let scene = read(&[("a.obj", &lamp), ("m.mtl", "newmtl lamp\nKe 1 1 1\n")]).expect("valid");
    assert!(scene.lights.iter().any(|l| matches!(l, Light::Constant { .. })));
}
