//! Options that say how to render, for all subcommands that render or plan to.
//!
//! Never decides what they mean: the library does.

use crate::cli::values;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use weir::settings::{Backend, Estimator, RenderSettings, Sampler, Schedule, TextureFilter};

/// Options that say how to render.
#[derive(Args)]
pub(super) struct SettingsOptions {
    /// Samples per pixel
    #[arg(long, value_name = "N", value_parser = values::samples, allow_negative_numbers = true)]
    spp: Option<u32>,
    /// Stop each region when its estimated relative error is below this: 0.02 or 2%. Then --spp is the most that a pixel
    /// gets, 16384 if not given
    #[arg(long, value_name = "T", value_parser = values::noise, allow_hyphen_values = true)]
    noise: Option<f64>,
    /// Stop after so much rendering time: 60s, 1.5m, 2h
    #[arg(long, value_name = "TIME", value_parser = values::seconds, allow_hyphen_values = true)]
    time: Option<f64>,
    /// Size of the whole image in pixels
    #[arg(long, value_name = "WxH", value_parser = values::size, allow_hyphen_values = true)]
    size: Option<(u32, u32)>,
    /// Window to render, in pixels; x1 and y1 are the first outside
    #[arg(long, value_name = "x0,y0,x1,y1", value_parser = values::crop, allow_hyphen_values = true)]
    crop: Option<[u32; 4]>,
    /// Scattering events of a path; 0 shows lights only
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    max_depth: Option<u32>,
    /// End unimportant paths early, at random
    #[arg(long, value_name = "on|off")]
    roulette: Option<Switch>,
    /// Random numbers: scrambled Sobol points, or samples that know nothing of each other (to compare)
    #[arg(long, value_name = "NAME", default_value = "sobol", value_parser = values::named(&Sampler::ALL, Sampler::name))]
    sampler: Sampler,
    /// Direct light: by light and BSDF sampling together, or by one alone (to compare)
    #[arg(long, value_name = "NAME", default_value = "both", value_parser = values::named(&Estimator::ALL, Estimator::name))]
    estimator: Estimator,
    /// Seed of the random numbers
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Worker threads; all processors if not given
    #[arg(long, value_name = "N", value_parser = values::threads, allow_negative_numbers = true)]
    threads: Option<usize>,
    /// What traces rays: embree where it was built in, else native
    #[arg(long, value_name = "NAME", value_parser = values::named(&Backend::ALL, Backend::name))]
    backend: Option<Backend>,
    /// Fewer rays slip between triangles; 15 to 30 % slower
    #[arg(long)]
    robust: bool,
    /// Bytes of everything together: geometry, textures, rays that wait, film and tables; the plan divides them
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, allow_negative_numbers = true)]
    memory: Option<u64>,
    /// Bytes of textures in memory: 512M, 2G; half of what is free if not given
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, allow_negative_numbers = true)]
    texture_memory: Option<u64>,
    /// Bytes of geometry in memory while rendering, its trees included; meshes that do not fit come and go in
    /// pages, which needs the native backend
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, allow_negative_numbers = true)]
    geometry_memory: Option<u64>,
    /// Bytes of a page of geometry, 4K to 128K
    #[arg(long, value_name = "BYTES", default_value = "64K", value_parser = values::page_bytes, allow_negative_numbers = true)]
    page_size: u64,
    /// Which rays run next: auto chooses depth, but voxel where pages of geometry have room for less than a twelfth of them
    #[arg(long, value_name = "NAME", default_value = "auto", value_parser = values::named(&Schedule::ALL, Schedule::name))]
    schedule: Schedule,
    /// Bytes of paths in flight and their rays where they wait (schedules sorted and voxel); 256M if not given
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, allow_negative_numbers = true)]
    ray_memory: Option<u64>,
    /// Bytes of a file in the cache directory for rays that have no room in --ray-memory, 4G for example; no file if not given
    #[arg(long, value_name = "BYTES", value_parser = values::bytes_or_none, allow_negative_numbers = true)]
    ray_disk: Option<u64>,
    /// Voxels of the scheduling grid, about; a number that follows from what fits in memory if not given
    #[arg(long, value_name = "N", value_parser = values::voxels, allow_negative_numbers = true)]
    voxels: Option<u32>,
    /// A read of a texture tile takes at least so many milliseconds (slow storage, simulated)
    #[arg(long, value_name = "N", default_value = "0", value_parser = values::milliseconds, allow_negative_numbers = true)]
    texture_latency_ms: f64,
    /// Where tiled copies of textures and pages of geometry are kept; ~/.cache/weir if not given
    #[arg(long, value_name = "DIR")]
    cache_dir: Option<PathBuf>,
    /// Filter image textures as for so many samples per pixel; as many as are asked for if not given
    #[arg(long, value_name = "N", value_parser = values::samples, allow_negative_numbers = true)]
    footprint_spp: Option<u32>,
    /// Filter of all image textures; else what the scene says. Alpha masks always read the finest level
    #[arg(long, value_name = "NAME", value_parser = values::named(&TextureFilter::ALL, TextureFilter::name))]
    texture_filter: Option<TextureFilter>,
    /// Pixels of an edge of what is displaced, at most; curves are drawn to an eighth of it. 2 if not given
    #[arg(long, value_name = "PIXELS", value_parser = values::edge_pixels, allow_negative_numbers = true)]
    tessellation: Option<f32>,
    /// Compute paths with effects that nothing may ask for: all, or names of `weir plan`, separated by commas. The
    /// picture is the same
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = values::effect)]
    force_effects: Vec<String>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Switch {
    On,
    Off,
}

impl SettingsOptions {
    /// Limit on the rendering time, in seconds.
    pub(super) fn time(&self) -> Option<f64> {
        self.time
    }

    /// As the library takes them.
    pub(super) fn settings(&self) -> RenderSettings {
        RenderSettings {
            estimator: self.estimator,
            sampler: self.sampler,
            footprint_spp: self.footprint_spp,
            noise: self.noise,
            checkpoint: None,
            spp: self.spp,
            size: self.size,
            crop: self.crop,
            max_depth: self.max_depth,
            roulette: self.roulette.map(|switch| matches!(switch, Switch::On)),
            seed: self.seed,
            threads: self.threads,
            backend: match self.backend {
                // Embree cannot let go of a part of a scene.
                None if self.geometry_memory.is_some() => Backend::Native,
                None => Backend::default(),
                Some(named) => named,
            },
            backend_named: self.backend.is_some(),
            memory: self.memory,
            robust: self.robust,
            time_limit_seconds: self.time,
            outputs: Vec::new(),
            texture_memory: self.texture_memory,
            geometry_memory: self.geometry_memory,
            page_bytes: Some(usize::try_from(self.page_size).unwrap_or(usize::MAX)),
            schedule: self.schedule,
            ray_memory: self.ray_memory,
            ray_disk: self.ray_disk,
            voxels: self.voxels,
            texture_latency_seconds: self.texture_latency_ms * 1e-3,
            cache_dir: self.cache_dir.clone(),
            strict: false,
            texture_filter: self.texture_filter,
            tessellation: self.tessellation,
            force_effects: self.force_effects.clone(),
        }
    }
}
