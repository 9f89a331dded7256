//! Masks, mixes and texture coordinates where light sampling and scattering must agree about them.

use crate::support::{Frame, assert_flat, grey, head, mean, picture};

const CAMERA: &str = "LookAt 0 2 -6 0 .5 0 0 1 0\nCamera \"perspective\" \"float fov\" 45\n";
const FLOOR: &str = "Shape \"trianglemesh\" \"point3 P\" [ -8 0 -8 8 0 -8 8 0 8 -8 0 8 ] \
                     \"integer indices\" [ 0 2 1 0 3 2 ]\n";

/// A floor under `light`, which emits 4 on both sides; direct light only.
fn lit_by(light: &str) -> f64 {
    let frame = Frame { size: (24, 24), spp: 256, max_depth: 1 };
    let emitter = "AreaLightSource \"diffuse\" \"rgb L\" [ 4 4 4 ] \"bool twosided\" true\n";
    let text = head(CAMERA, frame) + FLOOR + "AttributeBegin\n" + emitter + light + "\nAttributeEnd\n";
    // The lower half of the picture is floor.
    let values = grey(&picture(&text));
    mean(&values[values.len() / 2..])
}

/// Same samples, same floats: what must not matter must not matter at all.
#[test]
fn texture_coordinates_of_a_patch_do_not_change_its_light() {
    let patch = "Shape \"bilinearmesh\" \"point3 P\" [ -2 .5 2 2 .5 2 -1 2.5 2.5 1 2.5 2.5 ]";
    let plain = lit_by(patch);
    let mapped = lit_by(&format!("{patch} \"point2 uv\" [ 0 0 8 0 0 8 8 8 ]"));
    assert!(plain > 0.01, "the patch lights the floor: {plain}");
    assert_eq!(plain, mapped);
}

/// Half a light is half as bright, whichever way it is found; light sampling alone has no noise
/// from the mask, scattering has, and 1 % is six of its standard errors here.
#[test]
fn a_light_half_there_gives_half_the_light() {
    let quad = "Shape \"trianglemesh\" \"point3 P\" [ -2 .5 2 2 .5 2 2 3 2 -2 3 2 ] \
                \"integer indices\" [ 0 1 2 0 2 3 ]";
    let whole = lit_by(quad);
    let half = lit_by(&format!("{quad} \"float alpha\" .5"));
    assert!((half / whole - 0.5).abs() < 0.005, "{half} of {whole}");
    // pbrt's way to hide a light: alpha 0 is never hit, and lights all the same.
    let hidden = lit_by(&format!("{quad} \"float alpha\" 0"));
    assert!((hidden / whole - 1.0).abs() < 0.01, "{hidden} of {whole}");
}

/// A checkerboard mask over texture coordinates hides the same half of a patch and of triangles.
#[test]
fn masks_read_the_coordinates_of_patches() {
    let frame = Frame { size: (16, 16), spp: 16, max_depth: 0 };
    let mask = "Texture \"m\" \"float\" \"checkerboard\" \"float tex1\" 0 \"float tex2\" 1\n";
    let light = "AreaLightSource \"diffuse\" \"rgb L\" [ 1 1 1 ] \"bool twosided\" true\n";
    let look = "LookAt 0 0 -2 0 0 0 0 1 0\nCamera \"orthographic\"\n";
    let with = |shape: &str| {
        let text = head(look, frame) + mask + light + shape + " \"texture alpha\" \"m\"\n";
        mean(&grey(&picture(&text)))
    };
    let patch = with(
        "Shape \"bilinearmesh\" \"point3 P\" [ -1 -1 0 1 -1 0 -1 1 0 1 1 0 ] \"point2 uv\" [ 0 0 4 0 0 4 4 4 ]",
    );
    let triangles = with(
        "Shape \"trianglemesh\" \"point3 P\" [ -1 -1 0 1 -1 0 -1 1 0 1 1 0 ] \"integer indices\" [ 0 1 2 1 3 2 ] \
         \"point2 uv\" [ 0 0 4 0 0 4 4 4 ]",
    );
    assert!((patch - 0.5).abs() < 0.02 && (patch - triangles).abs() < 0.02, "{patch} and {triangles}");
}

/// A mix that chooses an interface is no event: the sky behind any number of them is the sky.
#[test]
fn mixed_interfaces_cost_no_depth() {
    let frame = Frame { size: (16, 16), spp: 4, max_depth: 1 };
    let mut text = head(CAMERA, frame)
        + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n\
           MakeNamedMaterial \"i\" \"string type\" \"interface\"\n\
           MakeNamedMaterial \"x\" \"string type\" \"mix\" \"string materials\" [ \"i\" \"i\" ]\n\
           NamedMaterial \"x\"\n";
    for radius in [0.5, 0.6, 0.7, 0.8] {
        text += &format!("Shape \"sphere\" \"float radius\" {radius}\n");
    }
    assert_flat(&picture(&text), 1.0, 1e-6, "sky through mixed interfaces");
}
