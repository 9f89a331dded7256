//! White furnaces: what neither absorbs nor emits cannot be seen in a world of radiance 1, and a
//! closed box that emits 1 and reflects half has a known sum for every depth.

use crate::significance::Runs;
use crate::support::{Frame, assert_flat, grey, head, icosphere, orthographic, over_pixels, picture, scene};
use weir::film::write::write_image;
use weir::settings::{Estimator, RenderSettings};

/// Rounding of some tens of vertices of a path: each multiplies the throughput by a few factors.
const ROUNDING: f32 = 5e-6;

fn furnace(material: &str, shape: &str, spp: u32, max_depth: u32) -> String {
    let frame = Frame { size: (16, 16), spp, max_depth };
    head("LookAt 0 0 -4  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" 35", frame)
        + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n"
        + material
        + "\n"
        + shape
}

fn shapes() -> [(&'static str, String); 2] {
    [
        ("sphere", "Shape \"sphere\"".to_owned()),
        ("icosphere", format!("Shape \"trianglemesh\" {}", icosphere(2))),
    ]
}

/// Every path of these materials carries its weight of 1 to the sky.
const LOSSLESS: [(&str, &str); 8] = [
    ("diffuse", "Material \"diffuse\" \"rgb reflectance\" [ 1 1 1 ]"),
    ("dielectric", "Material \"dielectric\" \"float eta\" 1.5"),
    ("dense dielectric", "Material \"dielectric\" \"float eta\" 2.4"),
    ("air in glass", "Material \"dielectric\" \"float eta\" 0.6667"),
    ("thin dielectric", "Material \"thindielectric\""),
    (
        "diffuse transmission",
        "Material \"diffusetransmission\" \"rgb reflectance\" [ .5 .5 .5 ] \"rgb transmittance\" [ .5 .5 .5 ]",
    ),
    ("interface", "Material \"interface\""),
    (
        "mix",
        "MakeNamedMaterial \"a\" \"string type\" \"diffuse\" \"rgb reflectance\" [ 1 1 1 ]\n\
         MakeNamedMaterial \"b\" \"string type\" \"diffusetransmission\" \"rgb reflectance\" [ .3 .3 .3 ] \
         \"rgb transmittance\" [ .7 .7 .7 ]\n\
         MakeNamedMaterial \"c\" \"string type\" \"thindielectric\"\n\
         MakeNamedMaterial \"d\" \"string type\" \"mix\" \"string materials\" [ \"a\" \"b\" ] \"float amount\" 0.4\n\
         Material \"mix\" \"string materials\" [ \"d\" \"c\" ] \"float amount\" 0.3",
    ),
];

#[test]
fn what_loses_no_energy_cannot_be_seen() {
    for (name, material) in LOSSLESS {
        for (shape, text) in &shapes() {
            let image = picture(&furnace(material, text, 16, 2000));
            assert_flat(&image, 1.0, ROUNDING, &format!("{name} {shape}"));
        }
    }
}

/// With throughputs at 1, up to rounding, roulette never ends a path that matters; without it the
/// image is the same.
#[test]
fn roulette_takes_nothing_from_a_white_furnace() {
    for (name, material) in LOSSLESS {
        let scene = scene(&furnace(material, &shapes()[1].1, 16, 2000));
        for roulette in [false, true] {
            let settings = RenderSettings { roulette: Some(roulette), ..RenderSettings::default() };
            let image = crate::support::image(&scene, &settings);
            assert_flat(&image, 1.0, ROUNDING, &format!("{name}, roulette {roulette}"));
        }
    }
}

/// pbrt gives a metal of reflectance r the index 1 and k = 2√r/√(1−r), with r at most 0.9999: its
/// Fresnel factor by the complex formula, on a sphere seen from infinitely far.
#[test]
fn a_mirror_of_reflectance_1_loses_what_its_index_does() {
    let k = 2.0 * 0.9999f64.sqrt() / (1.0 - 0.9999f64).sqrt();
    let fresnel = |cos: f64| {
        let (c2, s2) = (cos * cos, 1.0 - cos * cos);
        let t0 = 1.0 - k * k - s2;
        let ab = (t0 * t0 + 4.0 * k * k).sqrt();
        let a = (0.5 * (ab + t0)).max(0.0).sqrt();
        let s = (ab + c2 - 2.0 * a * cos) / (ab + c2 + 2.0 * a * cos);
        let p = s * (c2 * ab + s2 * s2 - 2.0 * a * cos * s2) / (c2 * ab + s2 * s2 + 2.0 * a * cos * s2);
        0.5 * (s + p)
    };
    let expected = over_pixels(16, 0.7, |x, y| fresnel((1.0 - x * x - y * y).sqrt()));
    let frame = Frame { size: (16, 16), spp: 16, max_depth: 3 };
    let text = head(&orthographic(-4.0, 0.7), frame)
        + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\nMaterial \"conductor\" \"rgb reflectance\" [ 1 1 1 ] \
           \"float roughness\" 0\nShape \"sphere\"";
    for (got, e) in grey(&picture(&text)).into_iter().zip(expected) {
        // 1 − F is 1e-4 at most, so a wrong formula would show.
        assert!((got - e).abs() < 1e-5, "{got} is not {e}");
    }
}

/// Its transmittances come from a table with errors up to 1e-3 (its own tests say so).
#[test]
fn a_white_base_under_a_clear_coat_cannot_be_seen() {
    let material = "Material \"coateddiffuse\" \"rgb reflectance\" [ 1 1 1 ] \"float roughness\" 0 \
                    \"float thickness\" 0 \"integer maxdepth\" 2000";
    for (shape, text) in &shapes() {
        let runs = Runs::of(&scene(&furnace(material, text, 64, 8)), &RenderSettings::default(), 8);
        let whole = runs.whole();
        assert!((whole.mean - 1.0).abs() < 1e-3 + 4.0 * whole.error(), "{shape}: {}", whole.mean);
        assert!(whole.error() < 1e-3, "{shape}: {}", whole.error());
    }
}

/// Single scattering off microfacets loses what would scatter twice: never gains, and a few per cent
/// at most at this roughness.
#[test]
fn rough_surfaces_lose_a_little_and_gain_nothing() {
    for material in [
        "Material \"conductor\" \"rgb reflectance\" [ 1 1 1 ] \"float roughness\" 0.01",
        "Material \"conductor\" \"rgb reflectance\" [ 1 1 1 ] \"float uroughness\" 0.005 \"float vroughness\" 0.02",
        "Material \"dielectric\" \"float roughness\" 0.01",
    ] {
        let runs =
            Runs::of(&scene(&furnace(material, "Shape \"sphere\"", 64, 200)), &RenderSettings::default(), 8);
        let whole = runs.whole();
        let (low, high) = (whole.mean - 4.0 * whole.error(), whole.mean + 4.0 * whole.error());
        assert!(
            high > 0.9 && low < 1.0 && whole.mean < 1.0 + 1e-3,
            "{material}: {} ± {}",
            whole.mean,
            whole.error()
        );
        assert!(whole.error() < 2e-3, "{material}: {}", whole.error());
    }
}

/// The furnace again, its light sampled: from an image by importance, and from six emitting walls.
#[test]
fn sampled_light_makes_the_same_furnace() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut sky = weir::film::Image::new(16, 16);
    sky.pixels.fill([1.0; 3]);
    write_image(&folder.path().join("white.pfm"), &sky, &[]).expect("writable");
    let frame = Frame { size: (12, 12), spp: 16, max_depth: 100 };
    let camera = "LookAt 0 0 -4  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" 35";
    let lights = [
        ("image", "LightSource \"infinite\" \"string filename\" \"white.pfm\"\n".to_owned()),
        (
            "walls",
            "AttributeBegin\nMaterial \"diffuse\" \"rgb reflectance\" [ 0 0 0 ]\nScale 6 6 6\nReverseOrientation\n\
             AreaLightSource \"diffuse\" \"rgb L\" [ 1 1 1 ]\n"
                .to_owned()
                + &cube()
                + "AttributeEnd\n",
        ),
    ];
    for (light, text) in &lights {
        for (name, material) in [LOSSLESS[0], LOSSLESS[5], LOSSLESS[7]] {
            let text = head(camera, frame) + text + material + "\nShape \"sphere\"";
            let scene = crate::support::scene_beside(&text, folder.path());
            let runs = Runs::of(&scene, &RenderSettings::default(), 16);
            runs.assert_is(&[1.0; 144], 2e-3, &format!("{name} lit by {light}"));
        }
    }
}

/// Six faces of [−1, 1]³ as one mesh, facing out.
fn cube() -> String {
    "Shape \"trianglemesh\" \"point3 P\" [ -1 -1 -1  1 -1 -1  -1 1 -1  1 1 -1  -1 -1 1  1 -1 1  -1 1 1  1 1 1 ]\n\
     \"integer indices\" [ 0 2 1  1 2 3   4 5 6  5 7 6   0 1 4  1 5 4   2 6 3  3 6 7   0 4 2  2 4 6   1 3 5  3 7 5 ]\n"
        .to_owned()
}

fn closed_box(depth: u32) -> String {
    let frame = Frame { size: (8, 8), spp: 16, max_depth: depth };
    head("LookAt .2 .1 -.3  .5 .4 1  0 1 0\nCamera \"perspective\" \"float fov\" 80", frame)
        + "Material \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\nReverseOrientation\n\
           AreaLightSource \"diffuse\" \"rgb L\" [ 1 1 1 ]\n"
        + &cube()
}

/// A path of D edges sees 1 + ½ + ¼ + … = 2 − 2^(1−D).
#[test]
fn a_closed_box_has_its_sum_at_every_depth() {
    for depth in 1..=8u32 {
        let expected = 2.0 - 0.5f64.powi(depth as i32 - 1);
        let scene = scene(&closed_box(depth - 1));
        for roulette in [false, true] {
            let settings = |estimator| RenderSettings {
                estimator,
                roulette: Some(roulette),
                ..RenderSettings::default()
            };
            let what = format!("{depth} edges, roulette {roulette}");
            if !roulette {
                let image = crate::support::image(&scene, &settings(Estimator::Scattering));
                assert_flat(&image, expected as f32, ROUNDING, &what);
            }
            for estimator in [Estimator::Both, Estimator::Lights, Estimator::Scattering] {
                let runs = Runs::of(&scene, &settings(estimator), 12);
                // Light sampling alone is noisy near the edges, where 1/r² grows without bound.
                runs.assert_is(&[expected; 64], 0.05, &format!("{what}, {estimator:?}"));
            }
        }
    }
}

#[test]
fn a_closed_box_without_end_reads_two() {
    let mut scene = scene(&closed_box(1000));
    for roulette in [false, true] {
        let settings = RenderSettings {
            estimator: Estimator::Scattering,
            roulette: Some(roulette),
            ..RenderSettings::default()
        };
        scene.integrator.max_depth = if roulette { 1000 } else { 60 };
        Runs::of(&scene, &settings, 16).assert_is(&[2.0; 64], 5e-3, &format!("roulette {roulette}"));
    }
}

/// Light through 400 panes, each passed by its own interface.
#[test]
fn an_orthographic_furnace_of_many_panes_stays_white() {
    let panes: String = (0..400)
        .map(|i| {
            format!(
                "AttributeBegin\nTranslate 0 0 {}\nShape \"disk\" \"float radius\" 2\nAttributeEnd\n",
                f64::from(i) * 0.01
            )
        })
        .collect();
    let frame = Frame { size: (4, 4), spp: 4, max_depth: 100_000 };
    let text = head(&orthographic(-1.0, 1.0), frame)
        + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\nMaterial \"thindielectric\"\n"
        + &panes;
    // Some thousands of vertices.
    assert_flat(&picture(&text), 1.0, 1e-3, "panes");
}
