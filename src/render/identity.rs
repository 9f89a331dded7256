//! What a picture depends on, by name: two renders of the same names and values have the same samples.
//!
//! The number of samples is none of it, but where regions stop by their error. Files that the scene names count by their
//! length and the time at which they were changed, the scene file itself by what it says, and none by the directory that
//! it is in.

use crate::scene::{Film, MeshSource, SceneDescription};
use crate::settings::{Backend, RenderSettings};
use std::fmt::{self, Debug, Write};
use std::path::Path;
use std::time::UNIX_EPOCH;
use xxhash_rust::xxh3::Xxh3;

/// What was found while loading.
pub(super) struct Found {
    /// What traces.
    pub(super) backend: Backend,
    /// Scale of texture footprints, where anything asks for it.
    pub(super) footprints: Option<f32>,
    pub(super) max_depth: u32,
    pub(super) seed: u64,
    pub(super) spp: u32,
}

/// Name and value of each thing that the picture depends on.
pub(super) fn identity(
    scene: &SceneDescription,
    settings: &RenderSettings,
    film: &Film,
    found: &Found,
) -> Vec<(String, String)> {
    // Destructured, so that what may be set anew breaks the build until it is decided on.
    let RenderSettings {
        // Told by what was found, or by the film.
        spp: _,
        size: _,
        crop: _,
        max_depth: _,
        seed: _,
        backend: _,
        backend_named: _,
        footprint_spp: _,
        // Of the picture.
        roulette,
        robust,
        estimator,
        sampler,
        noise,
        texture_filter,
        tessellation,
        // The picture is the same.
        threads: _,
        memory: _,
        time_limit_seconds: _,
        outputs: _,
        texture_memory: _,
        geometry_memory: _,
        page_bytes: _,
        schedule: _,
        ray_memory: _,
        ray_disk: _,
        voxels: _,
        texture_latency_seconds: _,
        cache_dir: _,
        strict: _,
        force_effects: _,
        checkpoint: _,
    } = settings;
    let on_off = |on: bool| if on { "on" } else { "off" };
    let [x0, y0, x1, y1] = film.crop;
    let mut list = vec![
        ("version of Weir", env!("CARGO_PKG_VERSION").to_owned()),
        ("size", format!("{}x{}", film.size.0, film.size.1)),
        ("crop", format!("{x0},{y0},{x1},{y1}")),
        ("seed", found.seed.to_string()),
        ("depth", found.max_depth.to_string()),
        ("roulette", on_off(roulette.unwrap_or(true)).to_owned()),
        ("sampler", sampler.name().to_owned()),
        ("estimator", estimator.name().to_owned()),
        ("backend", found.backend.name().to_owned()),
        ("robust traversal", on_off(*robust).to_owned()),
    ];
    if let Some(filter) = texture_filter {
        list.push(("texture filter", filter.name().to_owned()));
    }
    if let Some(pixels) = tessellation {
        list.push(("count of pixels of an edge (--tessellation)", pixels.to_string()));
    }
    if let Some(scale) = found.footprints {
        // As many samples as have footprints of that size, 64 for all above.
        list.push(("count of samples that textures are filtered for (--footprint-spp)", {
            let spp = (1.0 / (scale * scale)).round();
            if spp >= 64.0 { "64 or more".to_owned() } else { spp.to_string() }
        }));
    }
    if let Some(noise) = noise {
        list.push(("noise", noise.to_string()));
        // How far a tile may go decides with whom it goes on.
        list.push(("limit of samples per pixel", found.spp.to_string()));
    }
    list.push(("scene", format!("{:016x}", of_scene(scene, film))));
    list.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

/// A hash that can be written to.
struct Text(Xxh3);

impl Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.update(text.as_bytes());
        Ok(())
    }
}

/// Of all that the scene says, but for samples, seed and file names of images to write.
fn of_scene(scene: &SceneDescription, film: &Film) -> u64 {
    // Destructured, so that what a scene says anew breaks the build until it is decided on.
    let SceneDescription {
        path,
        camera,
        film: _,
        filter,
        spp: _,
        seed: _,
        integrator,
        meshes,
        patch_meshes,
        shapes,
        objects,
        instances,
        materials,
        textures,
        images,
        area_lights,
        lights,
        media,
        camera_medium,
        warnings: _,
    } = scene;
    let beside = beside(path);
    let mut hash = Text(Xxh3::new());
    // Hashing cannot fail.
    let mut add = |what: &dyn Debug| {
        let text = format!("{what:?};");
        let _ = hash.write_str(&match &beside {
            Some(beside) => text.replace(beside, "\""),
            None => text,
        });
    };
    add(&Film { filename: None, ..film.clone() });
    add(&(camera, filter, integrator, camera_medium));
    shapes.iter().for_each(|shape| add(shape));
    objects.iter().for_each(|object| add(object));
    instances.iter().for_each(|instance| add(instance));
    materials.iter().for_each(|material| add(material));
    textures.iter().for_each(|texture| add(texture));
    area_lights.iter().for_each(|light| add(light));
    lights.iter().for_each(|light| add(light));
    media.iter().for_each(|medium| add(medium));
    for image in images {
        add(image);
        add(&stamp(&image.path));
    }
    for mesh in meshes {
        if let Some(path) = file_of(mesh) {
            add(&stamp(path));
            add(mesh);
        }
    }
    // What stands in the file may be long: never a text of its own.
    for mesh in meshes.iter().filter(|mesh| file_of(mesh).is_none()) {
        let _ = write!(hash, "{mesh:?};");
    }
    for mesh in patch_meshes {
        let _ = write!(hash, "{mesh:?};");
    }
    hash.0.digest()
}

/// How names of files in the directory of `path` begin where they are printed, the quote included: what follows a quote is no number,
/// so that nothing but names is taken for one. `None` where they have no directory.
fn beside(path: &Path) -> Option<String> {
    let directory = path.parent().filter(|directory| !directory.as_os_str().is_empty())?;
    let mut beside = format!("{directory:?}");
    // The quote at its end.
    beside.pop();
    if !beside.ends_with('/') {
        beside.push('/');
    }
    Some(beside)
}

/// The file that a mesh is made of.
fn file_of(mesh: &MeshSource) -> Option<&Path> {
    match mesh {
        MeshSource::Ply(path) => Some(path),
        MeshSource::Displaced { base, .. } => file_of(base),
        MeshSource::Inline(_) | MeshSource::Subdivision { .. } | MeshSource::Curves(_) => None,
    }
}

/// Length of a file and when it was changed, in nanoseconds.
fn stamp(path: &Path) -> Option<(u64, Option<u128>)> {
    let there = std::fs::metadata(path).ok()?;
    let changed = there.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    Some((there.len(), changed.map(|time| time.as_nanos())))
}

#[cfg(test)]
mod tests {
    use super::beside;
    use std::path::{Path, PathBuf};

    #[test]
    fn a_directory_is_no_part_of_a_number() {
        for (scene, image, number) in [
            ("./a.pbrt", "./t.png", "1.25"),
            ("3/a.pbrt", "3/t.png", "0.312"),
            ("/tmp/x/a.pbrt", "/tmp/x/t.png", "1"),
            ("a.pbrt", "t.png", "2"),
        ] {
            let what = (PathBuf::from(image), number.parse::<f32>().expect("a number"));
            let text = format!("{what:?}");
            let text = beside(Path::new(scene)).map_or(text.clone(), |beside| text.replace(&beside, "\""));
            assert_eq!(text, format!("(\"t.png\", {:?})", what.1), "{scene}");
        }
    }
}
