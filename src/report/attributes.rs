//! Settings and statistics as attributes of an image, so that a file says by itself what it is.
//! Invariant: every name begins with `weir.`, so that none clashes with the format's own.

use crate::film::write::Attribute;
use crate::stats::{EffectiveSettings, ImageStats, MemoryStats, PlanStats, RayStats, RenderStats, TimeStats};

/// What an image says about its own making. The time to write it is not known yet.
#[must_use]
pub fn attributes(stats: &RenderStats) -> Vec<(String, Attribute)> {
    // Destructured, so that a new setting or counter breaks the build until it is decided on.
    let RenderStats {
        weir,
        scene,
        command: _,
        settings,
        plan,
        time,
        image,
        rays,
        memory,
        texture_cache: _,
        geometry_cache: _,
        scheduler: _,
        miss_ratio: _,
        threads,
        busy,
        interrupted,
    } = stats;
    let EffectiveSettings {
        backend,
        spp: spp_asked,
        seed,
        max_depth,
        sampler,
        estimator,
        roulette,
        robust,
        strict: _,
        time_limit_s,
        noise,
        crop: _,
        full_size: _,
        memory: _,
        texture_memory: _,
        geometry_memory: _,
        texture_filter: _,
        footprint_spp: _,
        tessellation: _,
        texture_latency_s: _,
    } = settings;
    let PlanStats {
        effects: _,
        kernel: _,
        calls: _,
        schedule: _,
        because: _,
        backend: _,
        bytes: _,
        memory: _,
    } = plan;
    let TimeStats {
        parse_s,
        prepare_s,
        build_s,
        render_s,
        write_s: _,
        checkpoint_s: _,
        total_s: _,
        first_pixel_s: _,
        stall_s: _,
        rooms: _,
    } = *time;
    let ImageStats {
        width: _,
        height: _,
        spp,
        spp_min,
        spp_max,
        spp_mean: _,
        samples,
        resumed_samples,
        non_finite_samples,
        estimated_relmse,
        pixels_without_samples: _,
    } = *image;
    let RayStats { closest, occluded, per_second } = *rays;
    let MemoryStats {
        budget: _,
        peak_accounted: _,
        accounted: _,
        all_geometry: _,
        all_textures: _,
        peak_rss,
        unaccounted: _,
        timeline: _,
        moves: _,
    } = memory;

    let mut list = Vec::new();
    let mut text = |name: &str, value: &str| {
        list.push((format!("weir.{name}"), Attribute::Text(value.to_owned())));
    };
    let on_off = |on: bool| if on { "on" } else { "off" };
    text("version", weir);
    text("scene", scene);
    text("backend", backend);
    text("sampler", sampler);
    text("estimator", estimator);
    text("roulette", on_off(*roulette));
    text("robust", on_off(*robust));
    text("interrupted", if *interrupted { "yes" } else { "no" });
    // A double holds 53 bits, and a seed may have 64.
    text("seed", &seed.to_string());
    let mut number = |name: &str, value: f64| {
        list.push((format!("weir.{name}"), Attribute::Number(value)));
    };
    number("spp", f64::from(spp));
    number("spp_asked", f64::from(*spp_asked));
    number("max_depth", f64::from(*max_depth));
    number("threads", *threads as f64);
    number("busy", *busy);
    number("samples", samples as f64);
    number("non_finite_samples", non_finite_samples as f64);
    number("rays.closest", closest as f64);
    number("rays.occluded", occluded as f64);
    number("rays.per_second", per_second);
    number("time.parse_s", parse_s);
    number("time.prepare_s", prepare_s);
    number("time.build_s", build_s);
    number("time.render_s", render_s);
    if let Some(limit) = time_limit_s {
        number("time_limit_s", *limit);
    }
    for (name, value) in [
        ("noise", *noise),
        ("spp_min", spp_min.map(f64::from)),
        ("spp_max", spp_max.map(f64::from)),
        ("estimated_relmse", estimated_relmse),
        ("resumed_samples", Some(resumed_samples as f64).filter(|&samples| samples > 0.0)),
    ] {
        value.into_iter().for_each(|value| number(name, value));
    }
    if let Some(rss) = peak_rss {
        number("memory.peak_rss", *rss as f64);
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_says_what_it_is() {
        let mut stats = RenderStats { scene: "a.pbrt".to_owned(), ..RenderStats::default() };
        stats.settings.seed = u64::MAX;
        stats.settings.sampler = "sobol".to_owned();
        stats.image.spp = 64;
        let list = attributes(&stats);
        let find = |name: &str| list.iter().find(|(n, _)| n == name).map(|(_, v)| v.clone());
        assert_eq!(find("weir.scene"), Some(Attribute::Text("a.pbrt".to_owned())));
        assert_eq!(find("weir.seed"), Some(Attribute::Text("18446744073709551615".to_owned())));
        assert_eq!(find("weir.sampler"), Some(Attribute::Text("sobol".to_owned())));
        assert_eq!(find("weir.spp"), Some(Attribute::Number(64.0)));
        assert_eq!(find("weir.memory.peak_rss"), None);
        // 31 characters are what every reader of EXR 1 takes.
        assert!(list.iter().all(|(name, _)| name.starts_with("weir.") && name.len() <= 31));
    }
}
