//! Light through absorbing media: Beer's law along what the ray has passed, whichever surfaces bound
//! it and whichever way the light was found.

use crate::significance::Runs;
use crate::support::{Frame, assert_flat, head, orthographic, picture, scene};
use std::f64::consts::PI;
use weir::settings::{Estimator, RenderSettings};

const FOG: &str = "MakeNamedMedium \"fog\" \"string type\" \"homogeneous\" \"rgb sigma_a\" [ .2 .5 1.3 ] \
                   \"rgb sigma_s\" [ 0 0 0 ]\n";
const SIGMA: [f64; 3] = [0.2, 0.5, 1.3];

/// A box of sides 8, 8 and `depth`, from z = 0, of interfaces around fog.
fn slab(depth: f64) -> String {
    format!(
        "AttributeBegin\nMediumInterface \"fog\" \"\"\nMaterial \"interface\"\nTranslate 0 0 {}\nScale 4 4 {}\n\
         Shape \"trianglemesh\" \"point3 P\" [ -1 -1 -1  1 -1 -1  -1 1 -1  1 1 -1  -1 -1 1  1 -1 1  -1 1 1  1 1 1 ]\n\
         \"integer indices\" [ 0 2 1  1 2 3   4 5 6  5 7 6   0 1 4  1 5 4   2 6 3  3 6 7   0 4 2  2 4 6   1 3 5  3 7 5 ]\n\
         AttributeEnd\n",
        0.5 * depth,
        0.5 * depth
    )
}

fn assert_color(text: &str, expected: [f64; 3], what: &str) {
    for p in &picture(text).pixels {
        for c in 0..3 {
            assert!((f64::from(p[c]) - expected[c]).abs() < 1e-5, "{what}: {p:?} is not {expected:?}");
        }
    }
}

const FRAME: Frame = Frame { size: (6, 6), spp: 4, max_depth: 3 };
const SKY: &str = "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n";

#[test]
fn a_slab_lets_through_what_beer_says() {
    for depth in [0.5, 2.0] {
        let text = head(&orthographic(-1.0, 1.0), FRAME) + SKY + FOG + &slab(depth);
        assert_color(&text, SIGMA.map(|s| (-s * depth).exp()), "slab");
        let beyond = text + &slab(depth).replace("Translate 0 0", "Translate 0 0 5\nTranslate 0 0");
        assert_color(&beyond, SIGMA.map(|s| (-2.0 * s * depth).exp()), "two slabs");
    }
    // At most no depth at all: the sky behind interfaces is still the sky.
    let text = head(&orthographic(-1.0, 1.0), Frame { max_depth: 0, ..FRAME }) + SKY + FOG + &slab(1.0);
    assert_color(&text, SIGMA.map(|s| (-s).exp()), "depth 0");
}

#[test]
fn a_camera_may_stand_in_a_medium() {
    let eye = FOG.to_owned() + "MediumInterface \"\" \"fog\"\n" + &orthographic(0.75, 1.0);
    let text = head(&eye, FRAME) + SKY + &slab(2.0);
    assert_color(&text, SIGMA.map(|s| (-s * 1.25).exp()), "inside");
    // And in one without end, up to a lit wall.
    let wall = "AttributeBegin\nReverseOrientation\nAreaLightSource \"diffuse\" \"rgb L\" [ 2 2 2 ]\n\
                Shape \"bilinearmesh\" \"point3 P\" [ -9 -9 3 9 -9 3 -9 9 3 9 9 3 ]\nAttributeEnd\n";
    let text = head(&eye, Frame { max_depth: 0, ..FRAME }) + wall;
    assert_color(&text, SIGMA.map(|s| 2.0 * (-s * 2.25).exp()), "wall");
}

#[test]
fn shadow_rays_are_absorbed_too() {
    let wall = "Material \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\n\
                Shape \"bilinearmesh\" \"point3 P\" [ -20 -20 3 20 -20 3 -20 20 3 20 20 3 ]\n";
    let camera = orthographic(2.9, 0.2);
    let light =
        "LightSource \"distant\" \"rgb L\" [ 1 1 1 ] \"point3 from\" [ 3 0 -4 ] \"point3 to\" [ 0 0 0 ]\n";
    let text = head(&camera, FRAME) + light + FOG + &slab(1.0) + wall;
    assert_color(&text, SIGMA.map(|s| 0.5 / PI * 0.8 * (-s * 1.25).exp()), "distant");
    // A point inside the slab, a quarter from its far side.
    let light = "LightSource \"point\" \"rgb I\" [ 9 9 9 ] \"point3 from\" [ 0 0 .75 ]\n";
    let camera = orthographic(2.9, 1e-3);
    let text = head(&camera, FRAME) + light + FOG + &slab(1.0) + wall;
    assert_color(&text, SIGMA.map(|s| 0.5 / PI * 9.0 / 2.25f64.powi(2) * (-s * 0.25).exp()), "point");
}

/// Glass filled with something that absorbs, seen straight on: a geometric series of reflections.
#[test]
fn a_tinted_pane_has_its_series() {
    let grey = FOG.replace("[ .2 .5 1.3 ]", "[ .5 .5 .5 ]");
    let pane = slab(1.0).replace("\"interface\"", "\"dielectric\" \"float eta\" 1.5");
    let text =
        head(&orthographic(-1.0, 1.0), Frame { size: (8, 8), spp: 16, max_depth: 100 }) + SKY + &grey + &pane;
    let (r, a) = (0.04, (-0.5f64).exp());
    let expected = r + (1.0 - r) * (1.0 - r) * a / (1.0 - a * r);
    Runs::of(&scene(&text), &RenderSettings::default(), 12).assert_is(&[expected; 64], 5e-3, "pane");
}

/// A lamp in a case that changes nothing: interfaces count neither for the depth nor for weights.
#[test]
fn a_lamp_behind_clear_interfaces_is_the_lamp() {
    let clear = FOG.replace("[ .2 .5 1.3 ]", "[ 0 0 0 ]");
    let lamp = "AttributeBegin\nTranslate 0 0 .5\nMaterial \"diffuse\" \"rgb reflectance\" [ 0 0 0 ]\n\
                AreaLightSource \"diffuse\" \"rgb L\" [ 3 3 3 ]\nShape \"disk\"\nAttributeEnd\n";
    let wall = "Material \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\n\
                Shape \"bilinearmesh\" \"point3 P\" [ -20 -20 2 20 -20 2 -20 20 2 20 20 2 ]\n";
    let frame = Frame { size: (8, 8), spp: 16, max_depth: 1 };
    let scene = scene(&(head(&orthographic(1.99, 1.0), frame) + &clear + &slab(1.0) + lamp + wall));
    // A parallel disk of radius 1 at 1.5, see `direct`.
    let expected = crate::support::over_pixels(8, 1.0, |x, y| {
        let (d2, h2) = (x * x + y * y, 2.25);
        let root = ((d2 + h2 + 1.0).powi(2) - 4.0 * d2).sqrt();
        0.5 / PI * 0.5 * PI * 3.0 * (1.0 - (d2 + h2 - 1.0) / root)
    });
    for (estimator, resolution) in
        [(Estimator::Both, 2e-3), (Estimator::Lights, 2e-3), (Estimator::Scattering, 1e-2)]
    {
        let settings = RenderSettings { estimator, ..RenderSettings::default() };
        Runs::of(&scene, &settings, 16).assert_is(&expected, resolution, &format!("{estimator:?}"));
    }
}

/// Half there: a mask of alpha ½ before a white sky and, as a shadow caster, before a light.
#[test]
fn alpha_one_half_lets_half_through() {
    let mask = "AttributeBegin\nMaterial \"diffuse\" \"rgb reflectance\" [ 0 0 0 ]\nShape \"bilinearmesh\" \
                \"point3 P\" [ -9 -9 0 9 -9 0 -9 9 0 9 9 0 ] \"float alpha\" .5\nAttributeEnd\n";
    let frame = Frame { size: (8, 8), spp: 64, max_depth: 1 };
    for (name, mask) in [
        ("patch", mask.to_owned()),
        ("triangles", mask.replace("bilinearmesh\" ", "trianglemesh\" \"integer indices\" [ 0 1 2 1 3 2 ] ")),
        (
            "disk",
            mask.replace(
                "\"bilinearmesh\" \"point3 P\" [ -9 -9 0 9 -9 0 -9 9 0 9 9 0 ]",
                "\"disk\" \"float radius\" 9",
            ),
        ),
    ] {
        let seen = scene(&(head(&orthographic(-1.0, 1.0), frame) + SKY + &mask));
        Runs::of(&seen, &RenderSettings::default(), 12).assert_is(&[0.5; 64], 1e-2, &format!("{name} seen"));
        let light = "LightSource \"distant\" \"rgb L\" [ 1 1 1 ] \"point3 from\" [ 1 0 -1 ] \"point3 to\" [ 0 0 0 ]\n\
                     Shape \"bilinearmesh\" \"point3 P\" [ -9 -9 1 9 -9 1 -9 9 1 9 9 1 ]\n";
        let lit = scene(&(head(&orthographic(0.5, 1.0), frame) + light + &mask));
        let expected = 0.5 * 0.5 / PI * 0.5f64.sqrt();
        Runs::of(&lit, &RenderSettings::default(), 12).assert_is(
            &[expected; 64],
            1e-2,
            &format!("{name} in the way"),
        );
    }
    for (alpha, expected) in [("0", 1.0), ("1", 0.0)] {
        let text = head(&orthographic(-1.0, 1.0), frame)
            + SKY
            + &mask.replace("alpha\" .5", &format!("alpha\" {alpha}"));
        assert_flat(&picture(&text), expected, 0.0, &format!("alpha {alpha}"));
    }
}
