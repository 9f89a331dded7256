//! Where each camera sees things, and how far out of focus.

use crate::significance::Runs;
use crate::support::{Frame, grey, head, picture, scene};
use std::f64::consts::PI;
use weir::settings::RenderSettings;

const BLACK: &str = "Material \"diffuse\" \"rgb reflectance\" [ 0 0 0 ]\n";

/// A small shining sphere at `p`.
fn lamp(p: [f64; 3], radius: f64) -> String {
    format!(
        "AttributeBegin\nTranslate {} {} {}\n{BLACK}AreaLightSource \"diffuse\" \"rgb L\" [ 1 1 1 ]\n\
         Shape \"sphere\" \"float radius\" {radius}\nAttributeEnd\n",
        p[0], p[1], p[2]
    )
}

/// Centre of light in pixels, x right and y down.
fn centroid(text: &str) -> (f64, f64) {
    let image = picture(text);
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for (i, v) in grey(&image).into_iter().enumerate() {
        sum += v;
        x += v * (f64::from(i as u32 % image.width) + 0.5);
        y += v * (f64::from(i as u32 / image.width) + 0.5);
    }
    assert!(sum > 0.0, "nothing in view");
    (x / sum, y / sum)
}

#[track_caller]
fn check(camera: &str, size: (u32, u32), at: [f64; 3], radius: f64, expected: (f64, f64)) {
    let text = head(camera, Frame { size, spp: 64, max_depth: 0 }) + &lamp(at, radius);
    let got = centroid(&text);
    // A sphere off the axis is seen as an ellipse whose centre is a little outside its own.
    let near = (got.0 - expected.0).abs() < 0.1 && (got.1 - expected.1).abs() < 0.1;
    assert!(near, "{camera} {at:?}: {got:?} is not {expected:?}");
}

#[test]
fn perspective_spans_the_shorter_axis() {
    let camera = "Camera \"perspective\" \"float fov\" 90";
    for (at, to) in [([0.0, 0.0], (30.0, 20.0)), ([0.5, 0.25], (40.0, 15.0)), ([-1.2, 0.8], (6.0, 4.0))] {
        check(camera, (60, 40), [4.0 * at[0], 4.0 * at[1], 4.0], 0.1, to);
    }
    check(camera, (40, 60), [2.0, 4.0, 4.0], 0.1, (30.0, 10.0));
    let looking = "LookAt 1 2 3  5 2 3  0 1 0\nCamera \"perspective\" \"float fov\" 60";
    // pbrt is left-handed: looking along +x with y up, −z is to the right.
    let reach = 2.0 * 30f64.to_radians().tan();
    check(looking, (40, 40), [3.0, 2.0 + 0.5 * reach, 3.0 - 0.5 * reach], 0.05, (30.0, 10.0));
    check(
        "Scale -1 1 1\nCamera \"perspective\" \"float fov\" 90",
        (40, 40),
        [2.0, 1.0, 4.0],
        0.1,
        (10.0, 15.0),
    );
    let window = "Camera \"perspective\" \"float fov\" 90 \"float screenwindow\" [ 0 1 -1 0 ]";
    check(window, (40, 40), [2.0, -1.0, 4.0], 0.1, (20.0, 10.0));
    let wide = "Camera \"perspective\" \"float fov\" 90 \"float frameaspectratio\" 2";
    check(wide, (40, 40), [4.0, 2.0, 4.0], 0.1, (30.0, 10.0));
}

#[test]
fn orthographic_is_parallel() {
    for z in [1.0, 50.0] {
        check("Camera \"orthographic\"", (60, 40), [0.6, -0.4, z], 0.1, (42.0, 28.0));
        check("Scale .5 .5 1\nCamera \"orthographic\"", (40, 40), [0.8, 1.2, z], 0.1, (28.0, 8.0));
    }
}

/// pbrt: θ from the top and φ from +x towards +z, over the height and the width.
#[test]
fn equirectangular_positions() {
    let camera = "Camera \"spherical\" \"string mapping\" \"equirectangular\"";
    for (at, to) in [
        ([0.0, 0.0, 5.0], (16.0, 16.0)),
        ([-5.0, 0.0, 0.0], (32.0, 16.0)),
        ([0.0, 0.0, -5.0], (48.0, 16.0)),
        ([3.0, 3.0 * 2f64.sqrt(), 3.0], (8.0, 8.0)),
    ] {
        check(camera, (64, 32), at, 0.4, to);
    }
}

/// Clarberg's square (see `environment`): its centre is the camera's +y, the right is +x, the bottom +z.
#[test]
fn equal_area_positions() {
    // Off the square's diagonals' folds: where x and z are alike, u = v = √(1 − y)/2.
    let (up, out) = (4.0f64, (0.5 * (25.0f64 - 16.0)).sqrt());
    let step = 64.0 * 0.5 * (1.0 - up / 5.0).sqrt();
    check("Camera \"spherical\"", (128, 128), [0.0, 5.0, 0.0], 0.2, (64.0, 64.0));
    for (x, z) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        let above = (64.0 + x * step, 64.0 + z * step);
        check("Camera \"spherical\"", (128, 128), [x * out, up, z * out], 0.2, above);
        // Below the horizon the square is folded outwards.
        let below = (64.0 + x * (64.0 - step), 64.0 + z * (64.0 - step));
        check("Camera \"spherical\"", (128, 128), [x * out, -up, z * out], 0.2, below);
    }
    // All directions have the same weight: a cap's share of the image is its share of the sphere.
    let (distance, radius) = (5.0, 2.0);
    for at in [[0.0, 5.0, 0.0], [3.0, 0.0, -4.0], [0.0, -5.0, 0.0], [-3.0, 0.0, 4.0]] {
        let text =
            head("Camera \"spherical\"", Frame { size: (24, 24), spp: 16, max_depth: 0 }) + &lamp(at, radius);
        let sin2: f64 = (radius / distance) * (radius / distance);
        let share = 0.5 * (1.0 - (1.0 - sin2).sqrt());
        Runs::of(&scene(&text), &RenderSettings::default(), 12).assert_mean(
            share,
            6e-3,
            &format!("cap at {at:?}"),
        );
    }
}

/// A shining half plane x < 0 at depth `z`.
fn half_plane(z: f64) -> String {
    format!(
        "{BLACK}ReverseOrientation\nAreaLightSource \"diffuse\" \"rgb L\" [ 1 1 1 ]\nShape \"bilinearmesh\" \
         \"point3 P\" [ -99 -99 {z} 0 -99 {z} -99 99 {z} 0 99 {z} ]\n"
    )
}

/// Share of the unit disk to the left of `x`.
fn disk_left_of(x: f64) -> f64 {
    let x = x.clamp(-1.0, 1.0);
    0.5 + (x * (1.0 - x * x).sqrt() + x.asin()) / PI
}

#[test]
fn what_is_in_focus_is_sharp_and_the_rest_blurs_by_the_lens() {
    let (lens, focus) = (0.3, 4.0);
    for (kind, perspective) in
        [("perspective\" \"float fov\" [ 90 ] \"float shutterclose\" [ 1 ]", true), ("orthographic\"", false)]
    {
        let camera = format!("Camera \"{kind} \"float lensradius\" {lens} \"float focaldistance\" {focus}");
        let frame = Frame { size: (32, 2), spp: 1024, max_depth: 0 };
        let window = "\"float screenwindow\" [ -1 1 -.0625 .0625 ]";
        for z in [focus, 2.0, 8.0] {
            let scene = scene(&(head(&format!("{camera} {window}"), frame) + &half_plane(z)));
            let runs = Runs::of(&scene, &RenderSettings::default(), 8);
            let expected: Vec<f64> = (0..64)
                .map(|i| {
                    const STEPS: usize = 64;
                    let one = |k: usize| {
                        let screen = (f64::from(i % 32) + (k as f64 + 0.5) / STEPS as f64) / 16.0 - 1.0;
                        // The ray from lens point l meets depth z at s + (l/lens) · radius.
                        let s = if perspective { screen * z } else { screen };
                        let radius = lens * (1.0 - z / focus).abs();
                        if radius == 0.0 { f64::from(s < 0.0) } else { disk_left_of(-s / radius) }
                    };
                    (0..STEPS).map(one).sum::<f64>() / STEPS as f64
                })
                .collect();
            if z == focus {
                // The edge is the border of two pixels: they are white and black.
                for (i, e) in expected.iter().enumerate() {
                    assert!((runs.mean_of(i) - e).abs() < 1e-3, "{kind}: pixel {i} is {}", runs.mean_of(i));
                }
            } else {
                runs.assert_near(&expected, 1e-3, 2e-3, &format!("{kind} at {z}"));
            }
        }
    }
}
