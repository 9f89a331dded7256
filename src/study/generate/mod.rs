//! Large procedural scenes from a seed, as pbrt-v4 files with binary PLY meshes and textures.
//!
//! Invariants: a seed gives the same bytes on every machine and for any number of threads (each file
//! depends on its index alone; see `noise`); memory is a few rows or bands a thread, never a mesh
//! or an image; `scene.pbrt` comes last, so a broken run has none. Never renders.

mod building;
mod city;
mod city_text;
mod directory;
mod facade;
mod forest;
mod forest_land;
mod ground;
mod image_out;
mod mesh_out;
mod noise;
mod plant;
mod sky;
mod street;
mod terrain;
mod walls;

pub use image_out::TextureFormat;

use crate::error::{Error, Result};
use crate::film::replace::replace_file;
use rayon::prelude::*;
use std::fmt;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Which scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Buildings along streets, each with a façade of its own.
    City,
    /// Instances of trees, bushes, grass and stones on uneven ground.
    Forest,
    /// Mountains around a lake: one mesh.
    Terrain,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::City => "city",
            Self::Forest => "forest",
            Self::Terrain => "terrain",
        })
    }
}

/// What to make.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// Which scene.
    pub kind: Kind,
    /// Triangles stored; instances do not count. Met within 5 %.
    pub triangles: u64,
    /// Bytes of all textures decoded at their stored depth with all mip levels. Met within 5 %.
    pub texture_bytes: u64,
    /// What varies the scene.
    pub seed: u64,
    /// Pixels of the film.
    pub size: (u32, u32),
    /// How textures are stored.
    pub format: TextureFormat,
    /// Where to. Empty, new, or with an earlier scene of ours, which is replaced.
    pub directory: PathBuf,
}

impl Recipe {
    /// The seed as hashes take it.
    fn hash_seed(&self) -> u32 {
        (self.seed ^ self.seed >> 32) as u32
    }
}

/// Fewest and most triangles.
pub const TRIANGLES: std::ops::RangeInclusive<u64> = 1_000..=1_000_000_000;
/// Fewest and most bytes of textures.
pub const TEXTURE_BYTES: std::ops::RangeInclusive<u64> = 100_000..=1_000_000_000_000;

/// What was made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Written {
    /// The scene file.
    pub scene: PathBuf,
    /// Triangles stored.
    pub triangles: u64,
    /// Triangles seen by rays, instances multiplied.
    pub instanced_triangles: u64,
    /// Bytes of textures, decoded, with mip levels; without the sky.
    pub texture_bytes: u64,
    /// Files.
    pub meshes: u64,
    /// Files.
    pub textures: u64,
    /// Bytes of all files on disk.
    pub disk_bytes: u64,
}

/// Writes one file at a path.
type WriteFile = Box<dyn Fn(&Path) -> Result<()> + Send + Sync>;

/// One file.
struct Job {
    /// Below the directory.
    name: String,
    /// About what it costs: bytes of a mesh, decoded bytes of a texture.
    work: u64,
    write: WriteFile,
}

impl Job {
    fn new(name: String, work: u64, write: impl Fn(&Path) -> Result<()> + Send + Sync + 'static) -> Self {
        Self { name, work, write: Box::new(write) }
    }
}

/// Writes the directives of a scene.
type SceneText = Box<dyn Fn(&mut dyn Write) -> io::Result<()>>;

/// A scene, decided and not yet written.
struct Plan {
    jobs: Vec<Job>,
    triangles: u64,
    instanced_triangles: u64,
    texture_bytes: u64,
    text: SceneText,
}

/// Progress: work done, of how much.
pub type Progress<'a> = &'a (dyn Fn(u64, u64) + Sync);

/// Makes a scene on the current thread pool. Memory: about 20 MB a thread, and 200 bytes a file.
///
/// # Errors
/// [`Error::Usage`] for a count out of range, or a directory that holds something else;
/// [`Error::Io`] for a file that cannot be written (a full disk among others).
pub fn generate(recipe: &Recipe, progress: Progress<'_>) -> Result<Written> {
    let within = |what: &str, n: u64, range: &std::ops::RangeInclusive<u64>| {
        if range.contains(&n) {
            return Ok(());
        }
        Err(Error::Usage(format!("{n} {what}; from {} to {} are possible", range.start(), range.end())))
    };
    within("triangles", recipe.triangles, &TRIANGLES)?;
    within("bytes of textures", recipe.texture_bytes, &TEXTURE_BYTES)?;
    let plan = match recipe.kind {
        Kind::Terrain => terrain::plan(recipe)?,
        Kind::City => city::plan(recipe)?,
        Kind::Forest => forest::plan(recipe)?,
    };
    directory::prepare(recipe)?;
    let total = plan.jobs.iter().map(|j| j.work).sum::<u64>();
    let done = AtomicU64::new(0);
    let disk = AtomicU64::new(0);
    progress(0, total);
    // Largest first, so that no thread begins a large one when the others are done.
    let mut order: Vec<&Job> = plan.jobs.iter().collect();
    order.sort_by(|a, b| b.work.cmp(&a.work).then_with(|| a.name.cmp(&b.name)));
    order.par_iter().with_max_len(1).try_for_each(|job| {
        let path = recipe.directory.join(&job.name);
        (job.write)(&path)?;
        disk.fetch_add(directory::size_of_file(&path)?, Ordering::Relaxed);
        let before = done.fetch_add(job.work, Ordering::Relaxed);
        progress(before + job.work, total);
        Ok(())
    })?;
    let scene = recipe.directory.join(directory::SCENE);
    replace_file(&scene, |out| write_scene(recipe, &plan, out))?;
    let in_folder = |folder: &str| plan.jobs.iter().filter(|j| j.name.starts_with(folder)).count() as u64;
    Ok(Written {
        triangles: plan.triangles,
        instanced_triangles: plan.instanced_triangles,
        texture_bytes: plan.texture_bytes,
        meshes: in_folder(directory::MESHES),
        textures: in_folder(directory::TEXTURES),
        disk_bytes: disk.into_inner() + directory::size_of_file(&scene)?,
        scene,
    })
}

fn write_scene(recipe: &Recipe, plan: &Plan, out: &mut dyn Write) -> io::Result<()> {
    let (w, h) = recipe.size;
    writeln!(out, "# {}", directory::origin(recipe))?;
    writeln!(
        out,
        "# {} triangles, {} with instances; {} bytes of textures, decoded, with mip levels. Metres, z up.",
        plan.triangles, plan.instanced_triangles, plan.texture_bytes
    )?;
    writeln!(
        out,
        "Film \"rgb\" \"integer xresolution\" {w} \"integer yresolution\" {h} \"string filename\" \"{}.exr\"",
        recipe.kind
    )?;
    writeln!(out, "Sampler \"zsobol\" \"integer pixelsamples\" 64")?;
    writeln!(out, "Integrator \"volpath\" \"integer maxdepth\" 8")?;
    (plan.text)(out)
}
