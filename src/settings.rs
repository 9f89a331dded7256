//! Budgets, samples, seed: plain data that a person may set. Nothing here computes.

use std::path::PathBuf;

/// What traverses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Backend {
    /// Embree through FFI.
    #[cfg_attr(feature = "embree", default)]
    Embree,
    /// Our own bounding volume hierarchy.
    #[cfg_attr(not(feature = "embree"), default)]
    Native,
}

impl Backend {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Embree, Self::Native];

    /// What it is called on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Embree => "embree",
            Self::Native => "native",
        }
    }
}

/// How direct light is estimated. All three have the same expectation where lights have extent and
/// surfaces are rough; they are here so that each can be held against the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Estimator {
    /// Light sampling and scattering sampling, weighted (Veach 1997).
    #[default]
    Both,
    /// Light sampling alone wherever lights can be sampled.
    Lights,
    /// Scattering sampling alone; lights without extent are not seen.
    Scattering,
}

impl Estimator {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Both, Self::Lights, Self::Scattering];

    /// What it is called on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Both => "both",
            Self::Lights => "lights",
            Self::Scattering => "scattering",
        }
    }
}

/// Where random numbers come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Sampler {
    /// Owen-scrambled Sobol points: the samples of a pixel know of each other.
    #[default]
    Sobol,
    /// Samples that know nothing of each other; here so that the other can be held against it.
    Independent,
}

impl Sampler {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Sobol, Self::Independent];

    /// What it is called on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Sobol => "sobol",
            Self::Independent => "independent",
        }
    }
}

/// Filter of an image texture between texels and levels. Scenes say which; here because a person
/// may say it for all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum TextureFilter {
    /// Nearest texel of one level.
    Point,
    /// Four texels of one level (pbrt's default).
    #[default]
    Bilinear,
    /// Eight texels of two levels.
    Trilinear,
    /// Elliptically weighted average: all texels of the footprint.
    Ewa,
    /// One texel of the footprint at random, which is [`Self::Ewa`] in the mean.
    Stochastic,
}

impl TextureFilter {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Point, Self::Bilinear, Self::Trilinear, Self::Ewa, Self::Stochastic];

    /// What it is called on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Point => "point",
            Self::Bilinear => "bilinear",
            Self::Trilinear => "trilinear",
            Self::Ewa => "ewa",
            Self::Stochastic => "stochastic",
        }
    }
}

/// What decides which rays run next. The picture is the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Schedule {
    /// Chosen from what fits in memory.
    #[default]
    Auto,
    /// A wave of paths at a time on each thread: the fastest where everything fits.
    Depth,
    /// Large batches, whose rays are sorted before they are traced and whose hits before they are shaded.
    Sorted,
    /// Large batches, whose rays wait in the voxels of a grid.
    Voxel,
}

impl Schedule {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Auto, Self::Depth, Self::Sorted, Self::Voxel];

    /// What it is called on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Depth => "depth",
            Self::Sorted => "sorted",
            Self::Voxel => "voxel",
        }
    }
}

/// Where a render half done is kept, so that another can go on with it.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpointing {
    /// The file: continued where it is there, and written.
    pub path: PathBuf,
    /// Seconds from one writing to the next.
    pub every_seconds: f64,
}

/// What the command line may override; `None` keeps what the scene file says.
#[derive(Clone, Debug, Default)]
pub struct RenderSettings {
    /// Samples per pixel.
    pub spp: Option<u32>,
    /// Film size in pixels.
    pub size: Option<(u32, u32)>,
    /// Crop window in pixels: x0, y0, x1, y1 (exclusive).
    pub crop: Option<[u32; 4]>,
    /// Scattering events (pbrt's `maxdepth`).
    pub max_depth: Option<u32>,
    /// Russian roulette; `None` means on.
    pub roulette: Option<bool>,
    /// Seed of every random number.
    pub seed: Option<u64>,
    /// Worker threads; `None` means all.
    pub threads: Option<usize>,
    /// Traversal.
    pub backend: Backend,
    /// Whether [`Self::backend`] was asked for by name; else another may take its place where memory wants it.
    pub backend_named: bool,
    /// Bytes of everything together: geometry, its acceleration structures, textures, rays that wait, film, images of
    /// lights and the scene's own tables; `None` means no bound.
    pub memory: Option<u64>,
    /// Embree's robust mode (the native hierarchy knows no other): fewer misses at edges, 15 to 30 % slower.
    pub robust: bool,
    /// Stop after so many seconds of rendering.
    pub time_limit_seconds: Option<f64>,
    /// Each region stops when its estimated relative error is below this, 0.02 for 2 %.
    pub noise: Option<f64>,
    /// Where the render is kept while it goes on; `None` keeps nothing.
    pub checkpoint: Option<Checkpointing>,
    /// Where images go; empty keeps the scene's own file name.
    pub outputs: Vec<PathBuf>,
    /// How direct light is estimated.
    pub estimator: Estimator,
    /// Where random numbers come from.
    pub sampler: Sampler,
    /// Texture footprints as for so many samples per pixel; `None` means as many as are taken. Here so that renders of
    /// different counts can be compared.
    pub footprint_spp: Option<u32>,
    /// Bytes of textures in memory; `None` means half of what is free.
    pub texture_memory: Option<u64>,
    /// Bytes of geometry in memory, its acceleration structures included; `None` means that all of it stays.
    pub geometry_memory: Option<u64>,
    /// Bytes of a page of geometry; `None` means 64 KiB.
    pub page_bytes: Option<usize>,
    /// Which rays run next.
    pub schedule: Schedule,
    /// Bytes of paths in flight and their rays, where they wait; `None` means 256 MiB.
    pub ray_memory: Option<u64>,
    /// Bytes of a file in the cache directory for rays that wait and have no room in memory; `None` means 0, no file.
    pub ray_disk: Option<u64>,
    /// Voxels of the scheduling grid that have geometry in them, about; `None` means a number that follows from what
    /// fits in memory.
    pub voxels: Option<u32>,
    /// A read of a texture tile takes at least so long \[s\]: slow storage, simulated.
    pub texture_latency_seconds: f64,
    /// Where tiled copies of textures are kept; `None` means the user's cache directory.
    pub cache_dir: Option<PathBuf>,
    /// Effects that paths are computed with though nothing may ask for them, by name; `all` stands for all.
    pub force_effects: Vec<String>,
    /// Filter of all image textures.
    pub texture_filter: Option<TextureFilter>,
    /// Pixels on the film that an edge of a displaced mesh may have, at most (`displacement.edgelength` of the scene bounds
    /// it in world units besides); an eighth of it is how far drawn curves may be from their own. `None` means 2.
    pub tessellation: Option<f32>,
    /// Warnings about what stands in for unsupported features become errors.
    pub strict: bool,
}
