//! What can be turned: settings that trade accuracy for time, one at a time.
//!
//! Invariant: a variant differs from the scene's own settings in one thing.

use crate::report::cost::LeftOut;
use crate::scene::{SceneDescription, Texture};
use crate::settings::{Backend, Estimator, RenderSettings, Sampler, TextureFilter};

/// One setting of one knob.
#[derive(Clone)]
pub(super) struct Variant {
    pub(super) knob: &'static str,
    pub(super) value: String,
    /// The options that do so.
    pub(super) options: String,
    pub(super) settings: RenderSettings,
    /// The scene has to be loaded again.
    pub(super) reloads: bool,
}

/// Knobs whose value changes what a long render converges to.
pub(super) fn changes_the_limit(knob: &str) -> bool {
    matches!(knob, "depth" | "filter")
}

/// Where random numbers come from, as a knob.
pub(super) const SAMPLER: &str = "sampler";

/// All variants of `own`, which are the scene's settings.
pub(super) fn variants(scene: &SceneDescription, own: &RenderSettings) -> Vec<Variant> {
    let mut all = Vec::new();
    let mut add = |knob, value: String, options: String, reloads, change: &dyn Fn(&mut RenderSettings)| {
        let mut settings = own.clone();
        change(&mut settings);
        all.push(Variant { knob, value, options, settings, reloads });
    };
    let depth = own.max_depth.unwrap_or(scene.integrator.max_depth);
    let quarters = |n: u64| u32::try_from(u64::from(depth.max(1)) * n / 4).unwrap_or(u32::MAX);
    let mut depths: Vec<u32> = [1, 2, 3, 8, 16].map(quarters).to_vec();
    depths.retain(|&d| d > 0 && d != depth);
    depths.sort_unstable();
    depths.dedup();
    for d in depths {
        add("depth", d.to_string(), format!("--max-depth {d}"), false, &|s| s.max_depth = Some(d));
    }
    let roulette = own.roulette.unwrap_or(true);
    let other = if roulette { "off" } else { "on" };
    add("roulette", other.into(), format!("--roulette {other}"), false, &|s| s.roulette = Some(!roulette));
    for sampler in Sampler::ALL.into_iter().filter(|s| *s != own.sampler) {
        let name = sampler.name();
        add(SAMPLER, name.into(), format!("--sampler {name}"), false, &|s| s.sampler = sampler);
    }
    for (estimator, value) in
        [(Estimator::Both, "both"), (Estimator::Lights, "lights only"), (Estimator::Scattering, "BSDF only")]
    {
        if estimator != own.estimator {
            let options = format!("--estimator {}", estimator.name());
            add("direct light", value.into(), options, false, &|s| s.estimator = estimator);
        }
    }
    if scene.textures.iter().any(|t| matches!(t, Texture::Image { .. })) {
        for filter in TextureFilter::ALL.into_iter().filter(|f| own.texture_filter != Some(*f)) {
            let name = filter.name();
            let options = format!("--texture-filter {name}");
            add("filter", name.into(), options, true, &|s| s.texture_filter = Some(filter));
        }
    }
    if cfg!(feature = "embree") && own.backend == Backend::Embree {
        let robust = !own.robust;
        let value = if robust { "Embree robust" } else { "Embree fast" };
        let options = if robust { "--robust" } else { "" };
        add("traversal", value.into(), options.into(), true, &|s| s.robust = robust);
        add("traversal", "native".into(), "--backend native".into(), true, &|s| s.backend = Backend::Native);
    }
    all
}

/// Knobs that other renderers have.
pub(super) fn missing() -> Vec<LeftOut> {
    [
        ("light selection", "Weir has one for few lights and one for many, and takes the right one"),
        ("mip bias", "Weir has none"),
        ("tessellation rate", "--tessellation is not turned yet"),
        ("precision", "Weir intersects in f32 with f64 where signs decide, and has nothing else"),
        ("texel depth", "Weir keeps texels as their files have them"),
        ("denoising", "Weir has none"),
        (
            "noise threshold",
            "--noise chooses samples region by region; docs/noise.md has what it asks and keeps",
        ),
    ]
    .map(|(knob, because)| LeftOut { knob: knob.to_owned(), because: because.to_owned() })
    .to_vec()
}
