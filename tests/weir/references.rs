//! The pbrt scenes against pbrt-v4's own renders, by the rule of `references/README.md`: the ratio of
//! the means within 2 % (5 % in pbrt-veach-ajar), and 95 % of 16×16 blocks agree.
//!
//! The rule lets noise widen a block's tolerance, so at few samples it says less. The quick form, which
//! every test run does, therefore also looks at 64×64 blocks, whose own noise is a quarter of it. The
//! long form (`make references`) renders as many samples as the rule was made for.

use crate::support::shared;
use std::sync::atomic::AtomicBool;
use weir::color::luminance;
use weir::film::Image;
use weir::film::read::read_image;
use weir::math::Vec3;
use weir::render::{Control, Progress, render};
use weir::settings::RenderSettings;
use weir::study::diff::diff;

const SCENES: [(&str, f64); 7] = [
    ("pbrt-classroom", 0.02),
    ("pbrt-cornell-box", 0.02),
    ("pbrt-living-room", 0.02),
    ("pbrt-material-testball", 0.02),
    ("pbrt-staircase2", 0.02),
    ("pbrt-veach-ajar", 0.05),
    ("pbrt-veach-mis", 0.02),
];

/// Luminance as the rule has it.
fn clipped(image: &Image) -> Vec<f64> {
    image.pixels.iter().map(|&p| f64::from(luminance(Vec3::from(p)).min(50.0))).collect()
}

/// Mean and standard error of `values`.
fn statistics(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
    (mean, (variance / n).sqrt())
}

/// Share of whole `side`×`side` blocks that agree, as the rule has it for 16.
fn agreeing(a: &[f64], b: &[f64], width: usize, side: usize) -> f64 {
    let (across, down) = (width / side, a.len() / width / side);
    let agrees = |block: usize| {
        let at = |k: usize| (block / across * side + k / side) * width + block % across * side + k % side;
        let differences: Vec<f64> = (0..side * side).map(|k| a[at(k)] - b[at(k)]).collect();
        let reference = (0..side * side).map(|k| b[at(k)]).sum::<f64>() / (side * side) as f64;
        let (mean, error) = statistics(&differences);
        mean.abs() <= 0.05 * reference + 3.0 * error + 0.002
    };
    (0..across * down).filter(|&i| agrees(i)).count() as f64 / (across * down) as f64
}

/// `None` where the scene or its reference is absent.
fn compare(name: &str, tolerance: f64, spp: u32) -> Option<Vec<String>> {
    let scene = shared(name)?.join("scene-v4.pbrt");
    let reference =
        read_image(&shared("references")?.join(format!("{name}.exr"))).unwrap_or_else(|e| panic!("{e}"));
    let scene = weir::scene::load(&scene).unwrap_or_else(|e| panic!("{e}"));
    let settings = RenderSettings {
        spp: Some(spp),
        size: Some((reference.width, reference.height)),
        ..RenderSettings::default()
    };
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_: Progress| {}, watch: None };
    let image = render(&scene, &settings, &control).unwrap_or_else(|e| panic!("{e}")).image;
    let found = diff(&image, &reference).unwrap_or_else(|e| panic!("{e}")).agreement;
    let (a, b) = (clipped(&image), clipped(&reference));
    let differences: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a - b).collect();
    let (mean, error) = statistics(&differences);
    let scale = statistics(&b).0;
    let large = agreeing(&a, &b, image.width as usize, 64);
    eprintln!(
        "{name} at {spp}: ratio {:.4} ± {:.4}, {:.1} % of {} blocks of 16, {:.0} % of 64",
        found.luminance_ratio,
        error / scale,
        100.0 * found.share,
        found.blocks,
        100.0 * large
    );
    let mut wrong = Vec::new();
    let mut demand = |holds: bool, what: String| {
        if !holds {
            wrong.push(format!("{name} at {spp} samples: {what}"));
        }
    };
    assert!((found.luminance_ratio - 1.0 - mean / scale).abs() < 1e-3, "{name}: diff and the test disagree");
    assert!(
        (agreeing(&a, &b, image.width as usize, 16) - found.share).abs() < 0.01,
        "{name}: diff and the test disagree"
    );
    // The error of the mean is part of what 16 samples can say; three of them, one in 400 a scene.
    let allowed = tolerance + 3.0 * error / scale;
    demand(
        (found.luminance_ratio - 1.0).abs() <= allowed,
        format!("ratio of the means {:.4}, more than {allowed:.4} from 1", found.luminance_ratio),
    );
    demand(3.0 * error / scale <= tolerance, format!("the means are known to ± {:.4} only", error / scale));
    demand(found.share >= 0.95, format!("{:.1} % of the blocks agree", 100.0 * found.share));
    demand(large >= 0.9, format!("{:.1} % of the blocks of 64 agree", 100.0 * large));
    Some(wrong)
}

fn all(spp: u32) {
    let wrong: Vec<String> =
        SCENES.iter().filter_map(|&(name, tolerance)| compare(name, tolerance, spp)).flatten().collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn pbrt_scenes_look_like_pbrts_renders() {
    all(16);
}

#[test]
#[ignore = "minutes: make references"]
fn pbrt_scenes_look_like_pbrts_renders_at_256_samples() {
    all(256);
}
