//! Direct light on a diffuse plane against closed forms. The plane z = 0 is seen along +z from just
//! before it; lights stand at negative z, behind the camera, which casts no shadow.

use crate::significance::Runs;
use crate::support::{Frame, cross, dot, head, length, orthographic, over_pixels, picture, scene, sub, unit};
use std::f64::consts::PI;
use weir::settings::{Estimator, RenderSettings};

const SIDE: u32 = 16;
const HALF: f64 = 2.0;
const ALBEDO: f64 = 0.6;

/// The plane under `light`.
fn plane(light: &str, spp: u32) -> String {
    let frame = Frame { size: (SIDE, SIDE), spp, max_depth: 1 };
    head(&orthographic(-0.001, HALF), frame)
        + light
        + "\nAttributeBegin\nMaterial \"diffuse\" \"rgb reflectance\" [ .6 .6 .6 ]\nShape \"bilinearmesh\" \
           \"point3 P\" [ -20 -20 0  20 -20 0  -20 20 0  20 20 0 ]\nAttributeEnd\n"
}

fn emitter(radiance: f64, shape: &str) -> String {
    format!(
        "AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ {radiance} {radiance} {radiance} ]\n\
         Material \"diffuse\" \"rgb reflectance\" [ 0 0 0 ]\n{shape}\nAttributeEnd\n"
    )
}

/// Radiance leaving the plane for an irradiance.
fn seen(irradiance: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    over_pixels(SIDE, HALF, |x, y| ALBEDO / PI * irradiance(x, y))
}

/// Holds the three estimators against the closed form, each to a standard error that it can reach.
fn check(light: &str, expected: &[f64], what: &str) {
    let scene = scene(&plane(light, 16));
    for estimator in [Estimator::Both, Estimator::Lights, Estimator::Scattering] {
        let settings = RenderSettings { estimator, ..RenderSettings::default() };
        let what = format!("{what}, {estimator:?}");
        if estimator == Estimator::Scattering {
            // Where few samples find the light, a pixel's runs say little about its noise.
            let mean = expected.iter().sum::<f64>() / expected.len() as f64;
            Runs::of(&scene, &settings, 16).assert_mean(mean, 2e-2, &what);
        } else {
            Runs::of(&scene, &settings, 16).assert_is(expected, 4e-3, &what);
        }
    }
}

/// A parallel disk of radius `r` at height `h`, its axis `d` away (Howell's catalogue, B-13).
fn under_disk(radiance: f64, r: f64, h: f64, d: f64) -> f64 {
    let (d2, h2, r2) = (d * d, h * h, r * r);
    let root = ((d2 + h2 + r2).powi(2) - 4.0 * r2 * d2).sqrt();
    0.5 * PI * radiance * (1.0 - (d2 + h2 - r2) / root)
}

#[test]
fn a_disk() {
    let light = emitter(3.0, "Translate 0.5 -0.25 -1.5\nShape \"disk\" \"float radius\" 1");
    let expected = seen(|x, y| under_disk(3.0, 1.0, 1.5, (x - 0.5).hypot(y + 0.25)));
    check(&light, &expected, "disk");
}

#[test]
fn an_annulus_is_a_disk_less_a_disk() {
    let shape = "Translate 0.5 -0.25 -1.5\nShape \"disk\" \"float radius\" 1 \"float innerradius\" .6";
    let expected = seen(|x, y| {
        let d = (x - 0.5).hypot(y + 0.25);
        under_disk(3.0, 1.0, 1.5, d) - under_disk(3.0, 0.6, 1.5, d)
    });
    check(&emitter(3.0, shape), &expected, "annulus");
}

#[test]
fn a_sphere_wholly_above_the_plane() {
    let (r, h) = (0.8, 1.7);
    let light = emitter(3.0, &format!("Translate -0.4 0.3 {}\nShape \"sphere\" \"float radius\" {r}", -h));
    let expected = seen(|x, y| {
        let d2 = (x + 0.4).powi(2) + (y - 0.3).powi(2) + h * h;
        PI * 3.0 * r * r * h / (d2 * d2.sqrt())
    });
    check(&light, &expected, "sphere");
}

/// Lambert 1760: the irradiance of a polygon wholly above the horizon is a sum over its edges.
fn under_polygon(radiance: f64, corners: &[[f64; 3]], x: f64, y: f64) -> f64 {
    let to: Vec<[f64; 3]> = corners.iter().map(|&c| unit(sub(c, [x, y, 0.0]))).collect();
    let edges = (0..to.len()).map(|i| {
        let (a, b) = (to[i], to[(i + 1) % to.len()]);
        let c = cross(a, b);
        dot(a, b).clamp(-1.0, 1.0).acos() * c[2] / length(c)
    });
    0.5 * radiance * edges.sum::<f64>().abs()
}

const QUAD: [[f64; 3]; 4] = [[-1.0, -0.5, -1.2], [0.6, -0.7, -1.4], [0.8, 0.9, -2.0], [-0.8, 1.1, -1.8]];

fn corners(list: &[[f64; 3]]) -> String {
    crate::support::list(list.iter().flatten())
}

#[test]
fn a_rectangle_a_parallelogram_and_a_triangle() {
    let [a, b, _, d] = QUAD;
    let c = [0, 1, 2].map(|i| b[i] + d[i] - a[i]);
    let expected = seen(|x, y| under_polygon(2.0, &[a, b, c, d], x, y));
    let mesh = format!(
        "Shape \"trianglemesh\" \"point3 P\" [ {} ] \"integer indices\" [ 0 1 2 0 2 3 ]",
        corners(&[a, b, c, d])
    );
    check(&emitter(2.0, &mesh), &expected, "parallelogram of two triangles");
    let patch =
        format!("ReverseOrientation\nShape \"bilinearmesh\" \"point3 P\" [ {} ]", corners(&[a, d, b, c]));
    check(&emitter(2.0, &patch), &expected, "parallelogram as a patch");
    let expected = seen(|x, y| under_polygon(2.0, &[a, b, d], x, y));
    check(
        &emitter(2.0, &format!("Shape \"trianglemesh\" \"point3 P\" [ {} ]", corners(&[a, b, d]))),
        &expected,
        "triangle",
    );
    let rectangle = [[-0.5, -1.0, -1.0], [0.5, -1.0, -1.0], [0.5, 1.0, -1.0], [-0.5, 1.0, -1.0]];
    let expected = seen(|x, y| under_polygon(2.0, &rectangle, x, y));
    let [a, b, c, d] = rectangle;
    let patch = format!("Shape \"bilinearmesh\" \"point3 P\" [ {} ]", corners(&[a, b, d, c]));
    check(&emitter(2.0, &patch), &expected, "rectangle");
}

/// A planar quadrilateral that is no parallelogram: the sum of two triangles.
#[test]
fn a_trapezium() {
    let corners_of = [[-1.0, -0.5, -1.2], [1.0, -0.5, -1.2], [0.4, 0.9, -1.2], [-0.4, 0.9, -1.2]];
    let expected = seen(|x, y| under_polygon(2.0, &corners_of, x, y));
    let [a, b, c, d] = corners_of;
    let patch = format!("Shape \"bilinearmesh\" \"point3 P\" [ {} ]", corners(&[a, b, d, c]));
    check(&emitter(2.0, &patch), &expected, "trapezium");
}

/// An open cylinder seen from outside and far away is a band; its light on the plane by quadrature of
/// the definition, ∫ L cos cos / r² dA over the side that faces the point.
#[test]
fn a_cylinder() {
    let (r, half, h) = (0.3, 0.7, 1.5);
    // Its axis is turned from z to y.
    let shape = format!(
        "Translate 0 0 {}\nRotate 90 1 0 0\nShape \"cylinder\" \"float radius\" {r} \"float zmin\" {} \"float zmax\" {half}",
        -h, -half
    );
    const AROUND: usize = 400;
    const ALONG: usize = 100;
    let expected: Vec<f64> = (0..SIDE * SIDE)
        .map(|i| {
            // The form is smooth at a pixel's size; its centre and four points are enough here.
            let at = |offset| crate::support::window_point(i as usize, SIDE, HALF, offset);
            let gauss = 0.5 / 3f64.sqrt();
            let points = [(gauss, gauss), (gauss, -gauss), (-gauss, gauss), (-gauss, -gauss)].map(at);
            let one = |(x, y): (f64, f64)| {
                let mut sum = 0.0;
                for a in 0..AROUND {
                    let phi = 2.0 * PI * (a as f64 + 0.5) / AROUND as f64;
                    let n = [phi.cos(), 0.0, phi.sin()];
                    for b in 0..ALONG {
                        let along = half * (2.0 * (b as f64 + 0.5) / ALONG as f64 - 1.0);
                        let to = sub([r * n[0], along, r * n[2] - h], [x, y, 0.0]);
                        let d2 = dot(to, to);
                        sum += (-dot(to, n)).max(0.0) * -to[2] / (d2 * d2);
                    }
                }
                sum * 2.0 * PI * r * 2.0 * half / (AROUND * ALONG) as f64
            };
            ALBEDO / PI * 4.0 * points.map(one).iter().sum::<f64>() / 4.0
        })
        .collect();
    check(&emitter(4.0, &shape), &expected, "cylinder");
}

/// Lights without extent: one light has no variance but the pixel's own.
#[test]
fn point_spot_and_distant() {
    let from = [0.3, -0.2, -1.1];
    let point = |x: f64, y: f64| {
        let to = sub(from, [x, y, 0.0]);
        (dot(to, to), -to[2] / length(to))
    };
    let light = "LightSource \"point\" \"rgb I\" [ 2 2 2 ] \"point3 from\" [ .3 -.2 -1.1 ]";
    let settings = RenderSettings::default();
    let expected = seen(|x, y| {
        let (d2, cos) = point(x, y);
        2.0 * cos / d2
    });
    Runs::of(&scene(&plane(light, 16)), &settings, 8).assert_is(&expected, 1e-3, "point");
    let light =
        "LightSource \"point\" \"rgb I\" [ 1 1 1 ] \"float power\" 50 \"point3 from\" [ .3 -.2 -1.1 ]";
    let expected: Vec<f64> = expected.iter().map(|e| e / 2.0 * 50.0 / (4.0 * PI)).collect();
    Runs::of(&scene(&plane(light, 16)), &settings, 8).assert_is(&expected, 1e-3, "point of 50 W");

    let light = "LightSource \"spot\" \"rgb I\" [ 2 2 2 ] \"point3 from\" [ .3 -.2 -1.1 ] \"point3 to\" [ .1 .3 0 ] \
                 \"float coneangle\" 50 \"float conedeltaangle\" 30";
    let axis = unit(sub([0.1, 0.3, 0.0], from));
    let (wide, narrow) = (50f64.to_radians().cos(), 20f64.to_radians().cos());
    let expected = seen(|x, y| {
        let (d2, cos) = point(x, y);
        let t = ((dot(axis, unit(sub([x, y, 0.0], from))) - wide) / (narrow - wide)).clamp(0.0, 1.0);
        2.0 * cos / d2 * t * t * (3.0 - 2.0 * t)
    });
    Runs::of(&scene(&plane(light, 16)), &settings, 8).assert_is(&expected, 1e-3, "spot");

    let light =
        "LightSource \"distant\" \"rgb L\" [ 2 2 2 ] \"point3 from\" [ 1 2 -2 ] \"point3 to\" [ 0 0 0 ]";
    let expected = (ALBEDO / PI * 2.0 * 2.0 / 3.0) as f32;
    crate::support::assert_flat(&picture(&plane(light, 1)), expected, 1e-6, "distant");
    let light = "LightSource \"distant\" \"rgb L\" [ 1 1 1 ] \"float illuminance\" 5 \"point3 from\" [ 0 0 -1 ] \
                 \"point3 to\" [ 0 0 0 ]";
    crate::support::assert_flat(
        &picture(&plane(light, 1)),
        (ALBEDO / PI * 5.0) as f32,
        2e-6,
        "distant, 5 lx",
    );
}

/// All at once: choosing among lights must not change their sum.
#[test]
fn many_lights_add_up() {
    let mut lights = String::new();
    let mut forms: Vec<(f64, f64, f64, f64, f64)> = Vec::new();
    for i in 0..30 {
        let t = f64::from(i);
        // One height for all: none hides another, and the point below them is hidden by none.
        let (x, y, h) = (2.5 * (t * 1.7).sin(), 2.5 * (t * 2.9).cos(), 1.5);
        let (r, l) = (0.05 + 0.02 * (t * 0.8).sin().abs(), 1.0 + t);
        lights += &emitter(l, &format!("Translate {x} {y} {}\nShape \"disk\" \"float radius\" {r}", -h));
        forms.push((x, y, h, r, l));
    }
    lights += "LightSource \"point\" \"rgb I\" [ .3 .3 .3 ] \"point3 from\" [ 0 0 -1 ]\n\
               LightSource \"infinite\" \"rgb L\" [ .1 .1 .1 ]\n";
    let expected = seen(|x, y| {
        let disks: f64 = forms.iter().map(|&(a, b, h, r, l)| under_disk(l, r, h, (x - a).hypot(y - b))).sum();
        // A disk also hides its part of the sky.
        let hidden: f64 =
            forms.iter().map(|&(a, b, h, r, _)| under_disk(0.1, r, h, (x - a).hypot(y - b))).sum();
        let d2 = x * x + y * y + 1.0;
        disks - hidden + 0.3 / (d2 * d2.sqrt()) + PI * 0.1
    });
    let scene = scene(&plane(&lights, 64));
    for (estimator, resolution) in [(Estimator::Both, 5e-3), (Estimator::Lights, 5e-3)] {
        let settings = RenderSettings { estimator, ..RenderSettings::default() };
        Runs::of(&scene, &settings, 16).assert_is(
            &expected,
            resolution,
            &format!("many lights, {estimator:?}"),
        );
    }
}
