//! Materials, lights and shapes at the ends of their ranges: radiance of 1e±30, worlds of other sizes, no roughness, an index
//! of 1, singular uvs, total reflection a thousand times over, a globe under a pebble.
//!
//! Invariant: what a sample must be is known before anything is rendered; no sample may be lost.

use super::crowds::{U, flat, render};
use super::leaving::CUBE;
use super::{Effort, Row, Table, Tracer};
use crate::support::{Frame, head};
use weir::settings::Estimator;

/// A scene of many parts, as large as `size`, whose lights shine `power` times as bright.
fn world(side: u32, size: f64, power: f64) -> String {
    let frame = Frame { size: (side, side), spp: 2, max_depth: 5 };
    let camera = format!(
        "LookAt 0 {} {}  0 {} 0  0 1 0\nCamera \"perspective\" \"float fov\" 45",
        2.0 * size,
        -6.0 * size,
        0.5 * size
    );
    head(&camera, frame)
        + &format!(
            "LightSource \"infinite\" \"rgb L\" [ {0} {0} {0} ]\n\
             Scale {size} {size} {size}\nMaterial \"diffuse\" \"rgb reflectance\" [ .5 .4 .3 ]\n\
             Shape \"bilinearmesh\" \"point3 P\" [ -4 0 -4  4 0 -4  -4 0 4  4 0 4 ]\n\
             AttributeBegin\nTranslate -1 .5 0\nMaterial \"dielectric\"\nShape \"sphere\" \"float radius\" .5\nAttributeEnd\n\
             AttributeBegin\nTranslate 1 .5 0\nScale .5 .5 .5\nRotate 20 0 1 0\nMaterial \"conductor\" \"float roughness\" .2\n{CUBE}AttributeEnd\n\
             AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ {1} {1} {0} ]\n\
             Shape \"trianglemesh\" \"point3 P\" [ -1 3 -1  1 3 -1  1 3 1  -1 3 1 ] \"integer indices\" [ 0 1 2 0 2 3 ]\n\
             Translate 2 2 0\nShape \"sphere\" \"float radius\" .25\nAttributeEnd\n",
            power,
            8.0 * power
        )
}

/// **What must hold.** With all lights 2ᵏ as bright the picture is 2ᵏ as bright, and in a world 2ᵏ as large it is the same,
/// bit for bit: for k of ±99 (1.6e-30 to 6.3e29) and of ±26 (1.5e-8 to 6.7e7).
///
/// **Why.** Multiplying by a power of two commutes with rounding while nothing over- or underflows, and no decision
/// depends on a length or a brightness but through ratios.
fn powers_of_two(effort: Effort) -> Table {
    let mut table = Table::default();
    let side = effort.of(16, 128) as u32;
    for tracer in Tracer::ALL {
        let reference = render(&world(side, 1.0, 1.0), tracer, Estimator::Both);
        let mut compare = |what: &str, text: &str, factor: f32| {
            let mut row = Row::new(format!("pixels that differ in {what}"), tracer, 0.0, false);
            let image = render(text, tracer, Estimator::Both);
            for (i, (a, b)) in reference.pixels.iter().zip(&image.pixels).enumerate() {
                let expected = a.map(|c| c * factor);
                row.count(expected != *b, || format!("pixel {i} is {b:?}, not {expected:?}"));
            }
            table.extend([row]);
        };
        for k in [-99, 99] {
            compare(&format!("light of 2^{k}"), &world(side, 1.0, 2f64.powi(k)), 2f32.powi(k));
        }
        for k in [-26, 26] {
            compare(&format!("a world of 2^{k}"), &world(side, 2f64.powi(k), 1.0), 1.0);
        }
    }
    table
}

fn furnace(side: u32, depth: u32, body: &str) -> String {
    let frame = Frame { size: (side, side), spp: 1, max_depth: depth };
    head("LookAt .4 1.1 -4  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" 32", frame)
        + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n"
        + body
}

const UVS: [(&str, &str); 4] = [
    ("all one", "[ .5 .5  .5 .5  .5 .5  .5 .5 ]"),
    ("on a line", "[ 0 0  1 1  2 2  3 3 ]"),
    ("of 1e30", "[ 0 0  1e30 0  1e30 1e30  0 1e30 ]"),
    ("of 1e-30", "[ 0 0  1e-30 0  1e-30 1e-30  0 1e-30 ]"),
];

/// **What must hold.** Whatever the roughness, and whatever the uvs that turn an anisotropic one: no sample under a sky of 1 is
/// above 1 by more than 64 roundings, none is below 0, and none is lost. Glass of index 1 is not seen.
///
/// **Why.** A sample's weight is F·G₂/G₁ of visible normals, both of which are at most 1, once for each of few vertices;
/// at an index of 1, F is 0 and light goes straight.
fn roughness_and_uvs(effort: Effort) -> Table {
    let mut table = Table::default();
    let side = effort.of(12, 64) as u32;
    for tracer in Tracer::TWO {
        let mut gain = Row::new("gain at roughness 0 to 1", tracer, 64.0 * U, true);
        let measure = |text: &str, row: &mut Row, what: &str| {
            let image = render(text, tracer, Estimator::Scattering);
            for (i, p) in image.pixels.iter().enumerate() {
                let most = p.iter().fold(0.0f32, |m, c| m.max(*c));
                let least = p.iter().fold(f32::INFINITY, |m, c| m.min(*c));
                let error = if least < 0.0 { f64::INFINITY } else { f64::from(most) - 1.0 };
                row.measure(error.max(0.0), || format!("{what}: pixel {i} is {p:?}"));
            }
        };
        for kind in ["conductor\" \"rgb reflectance\" [ 1 1 1 ]", "dielectric\""] {
            for alpha in ["0", "1e-45", "1e-30", "1e-10", "1e-6", "1e-4", "1e-3", ".01", ".1", "1"] {
                for remap in ["false", "true"] {
                    let material = format!(
                        "Material \"{kind} \"float roughness\" {alpha} \"bool remaproughness\" {remap}\n"
                    );
                    let text = furnace(side, 8, &format!("{material}Shape \"sphere\"\n"));
                    measure(&text, &mut gain, &material);
                }
            }
        }
        let mut singular = Row::new("gain at singular uvs", tracer, 64.0 * U, true);
        for (name, uv) in UVS {
            for transform in ["", "Scale 1 1e-3 1\n"] {
                let text = furnace(
                    side,
                    4,
                    &format!(
                        "{transform}Material \"conductor\" \"rgb reflectance\" [ 1 1 1 ] \"float uroughness\" .05 \
                         \"float vroughness\" .5\nShape \"trianglemesh\" \"point3 P\" [ -1 -1 0  -1 1 0  1 1 0  1 -1 0 ] \
                         \"integer indices\" [ 0 1 2 0 2 3 ] \"point2 uv\" {uv}\n"
                    ),
                );
                measure(&text, &mut singular, name);
            }
        }
        let mut index = Row::new("error of glass of index 1", tracer, 64.0 * U, true);
        for (body, rough) in [("Shape \"sphere\"\n", "0"), (CUBE, "0"), (CUBE, ".3")] {
            let text = furnace(
                side,
                8,
                &format!("Material \"dielectric\" \"float eta\" 1 \"float roughness\" {rough}\n{body}"),
            );
            flat(&mut index, &render(&text, tracer, Estimator::Scattering), 1.0, body);
        }
        table.extend([gain, singular, index]);
    }
    table
}

/// **What must hold.** Light that is totally reflected within glass stays there for a thousand bounces: under a bright sky the
/// picture from inside is black.
///
/// **Why.** In a cube a direction whose components are all below cos 41.8° = 0.745 keeps them, up to signs and a few
/// roundings a bounce: 1000·4u, far from the angle. In a sphere the angle stays. A moved origin leaves the cube only
/// from within X = 2√3·error of an edge (`leaving::acne_and_leaks`), of which at most 2·X/s of all vertices are; the
/// bound on what may leak is six standard deviations above their number, and of samples, those that do. In the sphere none.
fn total_reflection(effort: Effort) -> Table {
    let mut table = Table::default();
    let side = effort.of(8, 64) as u32;
    let cube = "LookAt .1 .2 -.15  1.1 1.15 .9  0 1 0\nCamera \"perspective\" \"float fov\" 6";
    let sphere = "LookAt .9 0 0  .9 .01 1  0 1 0\nCamera \"perspective\" \"float fov\" 6";
    let error = (8.0 * 1.0 + 10.0 * 2.0) * U;
    let expected = f64::from(side * side) * 1000.0 * 2.0 * 2.0 * 3f64.sqrt() * error;
    let most = (expected + 6.0 * expected.sqrt()).floor();
    for tracer in Tracer::ALL {
        for (name, camera, body, bound) in
            [("cube", cube, CUBE, most), ("sphere", sphere, "Shape \"sphere\"\n", 0.0)]
        {
            let mut row = Row::new(
                format!("samples that leave a glass {name} in 1000 reflections"),
                tracer,
                bound,
                false,
            );
            let text = trapped(camera, body, side, 1.5);
            let image = render(&text, tracer, Estimator::Both);
            for (i, p) in image.pixels.iter().enumerate() {
                row.count(p[0] != 0.0, || format!("pixel {i} is {p:?}"));
            }
            table.extend([row]);
        }
    }
    table
}

/// A view from inside glass of index `eta`, under a bright sky.
fn trapped(camera: &str, body: &str, side: u32, eta: f32) -> String {
    let frame = Frame { size: (side, side), spp: 1, max_depth: 1000 };
    head(camera, frame)
        + &format!(
            "LightSource \"infinite\" \"rgb L\" [ 1e6 1e6 1e6 ]\nMaterial \"dielectric\" \"float eta\" {eta}\n{body}"
        )
}

/// **What must hold.** On a sphere of radius 1e6 that reflects one half, under a black pebble the size of a pixel and a sky of
/// 1, every sample is 0 (it meets the pebble) or one half, and the pebble is seen.
///
/// **Why.** Outside a sphere no ray that leaves it meets it again (`leaving::acne_and_leaks`).
fn globe(effort: Effort) -> Table {
    let mut table = Table::default();
    let side = effort.of(33, 255) as u32;
    for tracer in Tracer::ALL {
        let mut row = Row::new("samples with acne on a globe of 1e6", tracer, 0.0, false);
        let frame = Frame { size: (side, side), spp: 1, max_depth: 4 };
        let window = f64::from(side);
        let camera = format!(
            "LookAt 0 50 0  0 0 0  0 0 1\nCamera \"orthographic\" \"float screenwindow\" [ {} {window} {} {window} ]",
            -window, -window
        );
        let text = head(&camera, frame)
            + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n\
               AttributeBegin\nTranslate 0 -1e6 0\nMaterial \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\n\
               Shape \"sphere\" \"float radius\" 1e6\nAttributeEnd\n\
               Material \"diffuse\" \"rgb reflectance\" [ 0 0 0 ]\nTranslate 0 1.5 0\nShape \"sphere\" \"float radius\" 1.5\n";
        let image = render(&text, tracer, Estimator::Scattering);
        for (i, p) in image.pixels.iter().enumerate() {
            let good = p[0] == 0.0 || (f64::from(p[0]) - 0.5).abs() <= 16.0 * U;
            row.count(!good, || format!("pixel {i} is {p:?}"));
        }
        let middle = image.pixels[(side * (side / 2) + side / 2) as usize];
        assert!(middle[0] == 0.0, "the pebble is not seen: {middle:?}");
        table.extend([row]);
    }
    table
}

/// **What must hold.** Lamps that cannot be sampled (without area, or black) change nothing: the picture is that without
/// them within the roundings of another order of lights, and no sample is lost.
///
/// **Why.** They have no power, so no probability; and emission that is met is weighted by a density that is then none.
fn lamps_without_power(effort: Effort) -> Table {
    let mut table = Table::default();
    let side = effort.of(32, 64) as u32;
    for tracer in Tracer::TWO {
        let mut row = Row::new("error by lamps without area or power", tracer, 64.0 * U, true);
        let bodies = "Material \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\nShape \"sphere\"\n";
        for lamp in [
            "AreaLightSource \"diffuse\"\nShape \"trianglemesh\" \"point3 P\" [ 0 2 0  1 2 0  2 2 0 ] \"integer indices\" [ 0 1 2 ]\n",
            "AreaLightSource \"diffuse\"\nShape \"trianglemesh\" \"point3 P\" [ 0 2 0  0 2 0  0 2 0 ] \"integer indices\" [ 0 1 2 ]\n",
            "AreaLightSource \"diffuse\" \"rgb L\" [ 0 0 0 ]\nTranslate 0 4 0\nShape \"sphere\"\n",
            "AreaLightSource \"diffuse\" \"float scale\" 0\nTranslate 0 4 0\nShape \"disk\"\n",
            "LightSource \"point\" \"rgb I\" [ 0 0 0 ]\n",
        ] {
            let text = furnace(side, 1, &format!("AttributeBegin\n{lamp}AttributeEnd\n{bodies}"));
            // All estimators must take it; one has no noise, and is compared with the bodies alone.
            render(&text, tracer, Estimator::Both);
            render(&text, tracer, Estimator::Lights);
            let body = lamp.find("Translate").or(lamp.find("Shape")).map_or("", |at| &lamp[at..]);
            let dark = furnace(side, 1, &format!("AttributeBegin\n{body}AttributeEnd\n{bodies}"));
            let [plain, image] = [&dark, &text].map(|text| render(text, tracer, Estimator::Scattering));
            for (i, (a, b)) in plain.pixels.iter().zip(&image.pixels).enumerate() {
                row.measure(f64::from((a[0] - b[0]).abs()), || format!("{lamp}: pixel {i}: {a:?}, {b:?}"));
            }
        }
        table.extend([row]);
    }
    table
}

pub(super) fn all(effort: Effort) -> Table {
    let mut table = powers_of_two(effort);
    for case in [roughness_and_uvs, total_reflection, globe, lamps_without_power] {
        table.extend(case(effort).0);
    }
    table
}

#[test]
fn brightness_and_size_are_ratios() {
    powers_of_two(Effort::Quick).assert_holds();
}

#[test]
fn no_roughness_and_no_uv_gains_light() {
    roughness_and_uvs(Effort::Quick).assert_holds();
}

#[test]
fn what_is_totally_reflected_stays() {
    total_reflection(Effort::Quick).assert_holds();
}

#[test]
fn a_globe_has_no_acne() {
    globe(Effort::Quick).assert_holds();
}

#[test]
fn lamps_without_power_change_nothing() {
    lamps_without_power(Effort::Quick).assert_holds();
}

/// The tests above must be able to fail: glass of a lower index lets its light out, and a lamp with power is seen.
#[test]
fn what_is_not_totally_reflected_is_found() {
    let sphere = "LookAt .6 0 0  .6 .01 1  0 1 0\nCamera \"perspective\" \"float fov\" 6";
    let text = trapped(sphere, "Shape \"sphere\"\n", 8, 1.5);
    let image = render(&text, Tracer::Native, Estimator::Both);
    assert!(image.pixels.iter().all(|p| p[0] > 0.0));
    let [plain, lit] = [0.0, 1.0].map(|scale| {
        let lamp = format!("AttributeBegin\nAreaLightSource \"diffuse\" \"float scale\" {scale}\nTranslate 0 4 0\nShape \"sphere\"\nAttributeEnd\n");
        let bodies = "Material \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\nShape \"sphere\"\n";
        render(&furnace(48, 1, &(lamp + bodies)), Tracer::Native, Estimator::Scattering)
    });
    assert!(plain.pixels != lit.pixels);
}
