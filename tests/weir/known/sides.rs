//! Which side of a shape emits, and how much: pbrt-v4's rules for surfaces that a ray meets. The front
//! is where the shape's own normal points (+z for what is flat, outwards for what is round), carried
//! by the transform as normals are; `ReverseOrientation` turns it. A mirroring transform turns
//! spheres, disks and cylinders too, and meshes and patches not: pbrt flips a quadric's normal for
//! handedness before it transforms it. (pbrt's own light sampling does not flip, and so disagrees
//! with its hits; ours must agree with ours, which the three estimators show.)

use crate::support::{Frame, assert_flat, grey, head, image, mean, orthographic, scene};
use std::f32::consts::PI;
use weir::settings::{Estimator, RenderSettings};

/// Shapes whose front is +z.
const FLAT: [(&str, &str); 5] = [
    ("disk", "Shape \"disk\""),
    (
        "triangles",
        "Shape \"trianglemesh\" \"point3 P\" [ -1 -1 0 1 -1 0 1 1 0 -1 1 0 ] \"integer indices\" [ 0 1 2 0 2 3 ]",
    ),
    (
        "triangles wound the other way, with normals",
        "Shape \"trianglemesh\" \"point3 P\" [ -1 -1 0 1 -1 0 1 1 0 -1 1 0 ] \"integer indices\" [ 0 2 1 0 3 2 ] \
         \"normal N\" [ 0 0 1 0 0 1 0 0 1 0 0 1 ]",
    ),
    ("patch", "Shape \"bilinearmesh\" \"point3 P\" [ -1 -1 0 1 -1 0 -1 1 0 1 1 0 ]"),
    ("one triangle", "Shape \"trianglemesh\" \"point3 P\" [ -1 -1 0 1 -1 0 0 1 0 ]"),
];

const ROUND: [(&str, &str); 2] =
    [("sphere", "Shape \"sphere\""), ("cylinder", "Rotate 90 1 0 0\nShape \"cylinder\"")];

/// With whether it turns +z round.
const TRANSFORMS: [(&str, bool); 4] = [
    ("", false),
    ("Scale -1 1 1\n", false),
    ("Scale 1 1 -1\n", true),
    ("Rotate 90 0 0 1\nScale -2 -1 -1\n", true),
];

const FRAME: Frame = Frame { size: (4, 4), spp: 16, max_depth: 1 };

/// Mean of the image that `eye` sees, by each estimator.
fn look(eye: &str, world: &str) -> [f64; 3] {
    let scene = scene(&(head(eye, FRAME) + world));
    [Estimator::Both, Estimator::Lights, Estimator::Scattering].map(|estimator| {
        let settings = RenderSettings { estimator, ..RenderSettings::default() };
        mean(&grey(&image(&scene, &settings)))
    })
}

#[track_caller]
fn check(seen: [f64; 3], emits: bool, what: &str) {
    for (value, estimator) in seen.into_iter().zip(["both", "lights", "scattering"]) {
        assert_eq!(value > 0.0, emits, "{what}, {estimator}: {value}");
    }
}

fn emitter(reverse: bool, two_sided: bool) -> String {
    let reverse = if reverse { "ReverseOrientation\n" } else { "" };
    format!(
        "Material \"diffuse\" \"rgb reflectance\" [ 0 0 0 ]\n{reverse}\
         AreaLightSource \"diffuse\" \"rgb L\" [ 1 1 1 ] \"bool twosided\" {two_sided}\n"
    )
}

#[test]
fn the_front_emits_and_two_sided_lights_do_on_both() {
    for (transform, turns) in TRANSFORMS {
        let mirrors = transform.contains('-');
        for (reverse, two_sided) in [(false, false), (true, false), (false, true), (true, true)] {
            for (name, shape) in FLAT {
                let turns = turns != (mirrors && name == "disk");
                for from_front in [false, true] {
                    let what = format!(
                        "{name}, {transform:?} reverse {reverse} two-sided {two_sided}, front {from_front}"
                    );
                    // The eye looks along +z, so it sees what points to −z.
                    let turn = if from_front { "Rotate 180 1 0 0\n" } else { "" };
                    let light = format!(
                        "AttributeBegin\n{turn}{transform}{}{shape}\nAttributeEnd\n",
                        emitter(reverse, two_sided)
                    );
                    let emits = two_sided || (from_front != turns) != reverse;
                    check(look(&orthographic(-3.0, 0.3), &light), emits, &what);
                    // A plane at z = 2 sees what points to +z.
                    let plane = "Shape \"bilinearmesh\" \"point3 P\" [ -9 -9 2 9 -9 2 -9 9 2 9 9 2 ]\n";
                    let emits = two_sided || (from_front == turns) != reverse;
                    check(
                        look(&orthographic(1.99, 0.3), &(light + plane)),
                        emits,
                        &format!("{what}, lighting"),
                    );
                }
            }
            for (name, shape) in ROUND {
                let what = format!("{name}, {transform:?} reverse {reverse} two-sided {two_sided}");
                let light = format!(
                    "AttributeBegin\n{transform}{}{shape}\nAttributeEnd\n",
                    emitter(reverse, two_sided)
                );
                let (out, inside) = (two_sided || reverse == mirrors, two_sided || reverse != mirrors);
                check(look(&orthographic(-5.0, 0.3), &light), out, &format!("{what}, outside"));
                check(look(&orthographic(0.0, 0.3), &light), inside, &format!("{what}, inside"));
                let far = "Shape \"bilinearmesh\" \"point3 P\" [ -9 -9 3 9 -9 3 -9 9 3 9 9 3 ]\n";
                check(
                    look(&orthographic(2.99, 0.3), &(light.clone() + far)),
                    out,
                    &format!("{what}, lighting out"),
                );
                let near =
                    "Shape \"bilinearmesh\" \"point3 P\" [ -.4 -.4 .1 .4 -.4 .1 -.4 .4 .1 .4 .4 .1 ]\n";
                check(
                    look(&orthographic(0.09, 0.3), &(light + near)),
                    inside,
                    &format!("{what}, lighting in"),
                );
            }
        }
    }
}

/// `power` is shared out over the area that pbrt finds: of each shape, that is of each triangle, and
/// of both sides of a two-sided one. `L` stays as a factor.
#[test]
fn power_becomes_radiance_by_area() {
    let cases = [
        ("Shape \"disk\" \"float radius\" 2", 100.0 / (4.0 * PI * PI)),
        ("Shape \"disk\" \"float radius\" 2 \"float innerradius\" .1", 100.0 / (3.99 * PI * PI)),
        ("Shape \"sphere\" \"float radius\" 1.5\nReverseOrientation", 100.0 / (9.0 * PI * PI)),
        ("Scale 3 3 3\nShape \"sphere\"", 100.0 / (36.0 * PI * PI)),
        ("Rotate 90 1 0 0\nShape \"cylinder\" \"float radius\" 2", 100.0 / (8.0 * PI * PI)),
        (
            "Shape \"trianglemesh\" \"point3 P\" [ -1 -1 0 1 -1 0 1 1 0 -1 1 0 ] \"integer indices\" [ 0 1 2 0 2 3 ]",
            100.0 / (2.0 * PI),
        ),
        ("Shape \"bilinearmesh\" \"point3 P\" [ -1 -1 0 1 -1 0 -1 1 0 1 1 0 ]", 100.0 / (4.0 * PI)),
    ];
    let frame = Frame { max_depth: 0, ..FRAME };
    for (shape, radiance) in cases {
        for two_sided in [false, true] {
            let flat =
                if shape.contains("disk") || shape.contains("mesh") { "Rotate 180 1 0 0\n" } else { "" };
            let text = head(
                "LookAt .4 .3 -5  .4 .3 0  0 1 0\nCamera \"orthographic\" \"float screenwindow\" [ -.1 .1 -.1 .1 ]",
                frame,
            ) + &format!(
                "AreaLightSource \"diffuse\" \"rgb L\" [ 1 1 1 ] \"float scale\" 2 \"float power\" 100 \"bool twosided\" {two_sided}\n{flat}{shape}\n"
            );
            let expected = 2.0 * radiance / if two_sided { 2.0 } else { 1.0 };
            let image = image(&scene(&text), &RenderSettings::default());
            assert_flat(&image, expected, 1e-5 * expected, &format!("{shape}, two-sided {two_sided}"));
        }
    }
}
