//! What the film does with samples: pixel filters, exposure, the bound on a sample's components.

use crate::significance::Runs;
use crate::support::{Frame, assert_flat, head, orthographic, picture, scene, window_point};
use weir::settings::RenderSettings;

const FILTERS: [(&str, &str); 6] = [
    ("box", "PixelFilter \"box\" \"float xradius\" 1 \"float yradius\" .5"),
    ("triangle", "PixelFilter \"triangle\""),
    ("gaussian", "PixelFilter \"gaussian\""),
    ("wide gaussian", "PixelFilter \"gaussian\" \"float xradius\" 3 \"float yradius\" 2 \"float sigma\" 1"),
    ("mitchell", "PixelFilter \"mitchell\""),
    ("sinc", "PixelFilter \"sinc\""),
];

fn filtered(filter: &str, spp: u32, world: &str) -> String {
    let frame = Frame { size: (16, 16), spp, max_depth: 1 };
    head(&orthographic(-5.0, 8.0), frame).replace("PixelFilter \"box\"", filter)
        + "LightSource \"infinite\" \"rgb L\" [ .7 .7 .7 ]\n"
        + world
}

#[test]
fn a_constant_scene_is_constant_under_every_filter() {
    for (name, filter) in FILTERS {
        for spp in [1, 16, 33] {
            assert_flat(&picture(&filtered(filter, spp, "")), 0.7, 2e-5, &format!("{name}, {spp}"));
        }
    }
}

/// The filters as pbrt defines them, along x.
fn filter_value(name: &str, x: f64) -> f64 {
    let gauss = |x: f64, s: f64| (-0.5 * (x / s).powi(2)).exp();
    let sinc =
        |x: f64| if x == 0.0 { 1.0 } else { (std::f64::consts::PI * x).sin() / (std::f64::consts::PI * x) };
    let x = x.abs();
    match name {
        "box" => f64::from(x < 1.0),
        "triangle" => (2.0 - x).max(0.0),
        "gaussian" => (gauss(x, 0.5) - gauss(1.5, 0.5)).max(0.0),
        "wide gaussian" => (gauss(x, 1.0) - gauss(3.0, 1.0)).max(0.0),
        // B = C = ⅓ (Mitchell and Netravali 1988, eq. 8), radius 2.
        "mitchell" if x < 1.0 => (7.0 * x.powi(3) - 12.0 * x * x + 16.0 / 3.0) / 6.0,
        "mitchell" if x < 2.0 => (-7.0 / 3.0 * x.powi(3) + 12.0 * x * x - 20.0 * x + 32.0 / 3.0) / 6.0,
        "mitchell" => 0.0,
        "sinc" if x < 4.0 => sinc(x) * sinc(x / 3.0),
        "sinc" => 0.0,
        _ => unreachable!(),
    }
}

const SPP: u32 = 1024;

/// A black half plane: pixels along x are the running integral of the filter. Edges stand where
/// no table of the filter has a seam.
#[test]
fn an_edge_shows_the_filters_integral() {
    for (name, filter) in FILTERS {
        let edge = 0.37;
        let half = format!(
            "Material \"diffuse\" \"rgb reflectance\" [ 0 0 0 ]\n\
             Shape \"bilinearmesh\" \"point3 P\" [ -99 -99 0 {edge} -99 0 -99 99 0 {edge} 99 0 ]\n"
        );
        // Two rows are enough.
        let text = filtered(filter, SPP, &half)
            .replace("\"integer yresolution\" 16", "\"integer yresolution\" 2")
            .replace("[ -8 8 -8 8 ]", "[ -8 8 -1 1 ]");
        const STEPS: usize = 40_000;
        let point = |k: usize| -4.0 + 8.0 * (k as f64 + 0.5) / STEPS as f64;
        let whole: f64 = (0..STEPS).map(|k| filter_value(name, point(k))).sum();
        let expected: Vec<f64> = (0..32)
            .map(|i| {
                let (x, _) = window_point(i % 16, 16, 8.0, (0.0, 0.0));
                let white: f64 =
                    (0..STEPS).map(point).filter(|t| x + t > edge).map(|t| filter_value(name, t)).sum();
                0.7 * white / whole
            })
            .collect();
        // A stratum of the sampler is decided as one, and the quadrature has 5000 steps a pixel. Where
        // a filter is negative the sum of signs divides, sample by sample, as pbrt does; the
        // quotient of two means is off by a variance over the sample count.
        let slack = if matches!(name, "mitchell" | "sinc") { 4.0 } else { 1.0 } / f64::from(SPP) + 4e-4;
        Runs::of(&scene(&text), &RenderSettings::default(), 8).assert_near(&expected, 1e-3, slack, name);
    }
}

#[test]
fn exposure_is_iso_times_time() {
    let plain = filtered("PixelFilter \"box\"", 1, "");
    let text = plain.replace("Film \"rgb\"", "Film \"rgb\" \"float iso\" 200");
    assert_flat(&picture(&text), 1.4, 1e-6, "iso 200");
    let text = plain
        .replace("\"orthographic\"", "\"orthographic\" \"float shutteropen\" .5 \"float shutterclose\" .75");
    assert_flat(&picture(&text), 0.175, 1e-6, "a quarter of a second");
    let text = text.replace("Film \"rgb\"", "Film \"rgb\" \"float iso\" 50");
    assert_flat(&picture(&text), 0.0875, 1e-6, "both");
}

#[test]
fn a_samples_largest_component_is_bounded_and_its_hue_kept() {
    let text = filtered("PixelFilter \"gaussian\"", 4, "").replace("[ .7 .7 .7 ]", "[ 8 4 1 ]");
    for (bound, expected) in [("2", [2.0, 1.0, 0.25]), ("16", [8.0, 4.0, 1.0])] {
        let text = text.replace("Film \"rgb\"", &format!("Film \"rgb\" \"float maxcomponentvalue\" {bound}"));
        for p in &picture(&text).pixels {
            assert!((0..3).all(|c| (p[c] - expected[c]).abs() < 1e-5), "{p:?} is not {expected:?}");
        }
    }
    // The bound is the sensor's: it holds after the exposure.
    let text = text.replace("Film \"rgb\"", "Film \"rgb\" \"float maxcomponentvalue\" 2 \"float iso\" 10");
    for p in &picture(&text).pixels {
        assert!((p[0] - 0.8).abs() < 1e-5, "{p:?}");
    }
}
