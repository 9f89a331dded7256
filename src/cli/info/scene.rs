//! A scene for `weir info`: how much of what, before anything is loaded.

use super::mesh::face_count;
use super::tally;
use crate::cli::render::note_warnings;
use std::fmt::Write;
use std::path::Path;
use weir::error::Result;
use weir::scene::{
    self, CameraKind, Filter, Light, Material, MeshSource, SceneDescription, Shape, ShapeKind, Texture,
};

/// Describes the scene in `path`; its warnings go to stderr.
pub(super) fn describe(path: &Path) -> Result<String> {
    let scene = scene::load(path)?;
    note_warnings(&scene);
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_scene(&scene, &mut out);
    Ok(out)
}

fn write_scene(scene: &SceneDescription, out: &mut String) -> std::fmt::Result {
    let film = &scene.film;
    writeln!(out, "scene      {}", scene.path.display())?;
    writeln!(out, "camera     {}", camera(scene))?;
    write!(out, "film       {} x {} pixels", film.size.0, film.size.1)?;
    if film.crop != [0, 0, film.size.0, film.size.1] {
        write!(out, ", crop {:?}", film.crop)?;
    }
    match &film.filename {
        Some(name) => writeln!(out, ", for {}", name.display())?,
        None => writeln!(out)?,
    }
    writeln!(out, "filter     {}", filter(&scene.filter))?;
    writeln!(
        out,
        "samples    {} per pixel, depth {}, seed {}",
        scene.spp, scene.integrator.max_depth, scene.seed
    )?;
    write_counted(out, "shapes", scene.shapes.len(), &tally(scene.shapes.iter().map(shape)))?;
    let placed = scene.objects.iter().flatten();
    let inside = tally(placed.map(shape));
    let inside = if inside.is_empty() { inside } else { format!("with {inside}") };
    write_counted(out, "objects", scene.objects.len(), &inside)?;
    writeln!(out, "instances  {}", scene.instances.len())?;
    writeln!(out, "triangles  {}", triangles(scene))?;
    write_counted(out, "materials", scene.materials.len(), &tally(scene.materials.iter().map(material)))?;
    write_counted(out, "textures", scene.textures.len(), &tally(scene.textures.iter().map(texture)))?;
    let missing = scene.images.iter().filter(|image| !image.path.exists()).count();
    let missing = if missing > 0 { format!("{missing} not there") } else { String::new() };
    write_counted(out, "images", scene.images.len(), &missing)?;
    let lights = scene.lights.iter().map(light);
    let area = scene.shapes.iter().chain(scene.objects.iter().flatten());
    let area = area.filter(|shape| shape.area_light.is_some()).map(|_| "area");
    let count = scene.lights.len() + area.clone().count();
    write_counted(out, "lights", count, &tally(lights.chain(area)))?;
    writeln!(out, "media      {}", scene.media.len())?;
    writeln!(out, "warnings   {}", scene.warnings.len())
}

fn write_counted(out: &mut String, name: &str, count: usize, detail: &str) -> std::fmt::Result {
    if detail.is_empty() {
        writeln!(out, "{name:<10} {count}")
    } else {
        writeln!(out, "{name:<10} {count}: {detail}")
    }
}

fn camera(scene: &SceneDescription) -> String {
    let camera = &scene.camera;
    let kind = match camera.kind {
        CameraKind::Perspective { fov_degrees } => {
            format!("perspective, {fov_degrees} degrees across the shorter side")
        }
        CameraKind::Orthographic => "orthographic".to_owned(),
        CameraKind::Spherical { equal_area: true } => "spherical, equal-area".to_owned(),
        CameraKind::Spherical { equal_area: false } => "spherical, latitude-longitude".to_owned(),
    };
    if camera.lens_radius > 0.0 {
        format!("{kind}; lens radius {}, in focus at {}", camera.lens_radius, camera.focal_distance)
    } else {
        kind
    }
}

fn filter(filter: &Filter) -> String {
    match *filter {
        Filter::Box { radius: [x, y] } => format!("box, radius {x} x {y}"),
        Filter::Triangle { radius: [x, y] } => format!("triangle, radius {x} x {y}"),
        Filter::Gaussian { radius: [x, y], sigma } => format!("gaussian, radius {x} x {y}, sigma {sigma}"),
        Filter::Mitchell { radius: [x, y], b, c } => format!("mitchell, radius {x} x {y}, B {b}, C {c}"),
        Filter::Sinc { radius: [x, y], tau } => format!("sinc, radius {x} x {y}, tau {tau}"),
    }
}

/// Of the mesh tables, each once however often it is placed.
fn triangles(scene: &SceneDescription) -> String {
    let (mut known, mut files, mut faces, mut unknown) = (0u64, 0u64, 0u64, 0u64);
    let mut made = 0u64;
    for mesh in &scene.meshes {
        let mesh = match mesh {
            MeshSource::Displaced { base, .. } => {
                made += 1;
                base
            }
            mesh => mesh,
        };
        match mesh {
            MeshSource::Curves(_) | MeshSource::Displaced { .. } => made += 1,
            MeshSource::Inline(mesh) => known += mesh.indices.len() as u64,
            MeshSource::Subdivision { cage, levels } => known = known.saturating_add(cage.triangles(*levels)),
            MeshSource::Ply(path) => {
                files += 1;
                match face_count(path) {
                    Some(count) => faces = faces.saturating_add(count),
                    None => unknown += 1,
                }
            }
        }
    }
    let mut text = format!("{known} in the scene file");
    if files > 0 {
        text += &format!(", {faces} faces in {files} PLY files");
    }
    if made > 0 {
        text += &format!(", more as seen of {made} that are displaced or curves");
    }
    if unknown > 0 {
        text += &format!(" ({unknown} of them unreadable)");
    }
    text
}

fn shape(shape: &Shape) -> &'static str {
    match shape.kind {
        ShapeKind::Mesh(_) => "mesh",
        ShapeKind::Patches(_) => "patch mesh",
        ShapeKind::Sphere { .. } => "sphere",
        ShapeKind::Disk { .. } => "disk",
        ShapeKind::Cylinder { .. } => "cylinder",
    }
}

fn material(material: &Material) -> &'static str {
    match material {
        Material::Diffuse { .. } => "diffuse",
        Material::CoatedDiffuse { .. } => "coateddiffuse",
        Material::Conductor { .. } | Material::ConductorReflectance { .. } => "conductor",
        Material::Dielectric { .. } => "dielectric",
        Material::ThinDielectric { .. } => "thindielectric",
        Material::DiffuseTransmission { .. } => "diffusetransmission",
        Material::Mix { .. } => "mix",
        Material::Interface => "interface",
    }
}

fn texture(texture: &Texture) -> &'static str {
    match texture {
        Texture::Constant(_) => "constant",
        Texture::Image { .. } => "image",
        Texture::Scale { .. } => "scale",
        Texture::Mix { .. } => "mix",
        Texture::DirectionMix { .. } => "directionmix",
        Texture::Checkerboard { .. } => "checkerboard",
        Texture::Checkerboard3d { .. } => "3D checkerboard",
        Texture::Bilerp { .. } => "bilerp",
    }
}

fn light(light: &Light) -> &'static str {
    match light {
        Light::Distant { .. } => "distant",
        Light::Point { .. } => "point",
        Light::Spot { .. } => "spot",
        Light::Constant { .. } => "constant sky",
        Light::Image { .. } => "image sky",
    }
}
