//! Image-based light comes from where pbrt says: the equal-area octahedral square, its centre +z, its
//! right +x, its bottom +y, and its corners −z, in the light's space.

use crate::significance::Runs;
use crate::support::{Frame, dot, head, orthographic, scene_beside, unit};
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;
use weir::film::Image;
use weir::film::write::write_image;
use weir::settings::{Estimator, RenderSettings};

/// Clarberg 2008, from a direction to the square, y down: written from the paper and not from our code,
/// and the other way round from what the renderer samples with.
fn to_square([x, y, z]: [f64; 3]) -> (f64, f64) {
    let r = (1.0 - z.abs()).max(0.0).sqrt();
    let turn = y.abs().atan2(x.abs()) / FRAC_PI_2;
    let (mut u, mut v) = (r * (1.0 - turn), r * turn);
    if z < 0.0 {
        (u, v) = (1.0 - v, 1.0 - u);
    }
    (0.5 + 0.5 * u.copysign(x), 0.5 + 0.5 * v.copysign(y))
}

fn rotated(axis: [f64; 3], degrees: f64, v: [f64; 3]) -> [f64; 3] {
    // Rodrigues.
    let (k, (sin, cos)) = (unit(axis), degrees.to_radians().sin_cos());
    let c = crate::support::cross(k, v);
    [0, 1, 2].map(|i| v[i] * cos + c[i] * sin + k[i] * dot(k, v) * (1.0 - cos))
}

const SIDE: u32 = 8;

/// Irradiance on a plane facing −z under a sky whose texel (`i`, `j`) is 1, the light turned.
fn irradiance(texel: (u32, u32), axis: [f64; 3], degrees: f64) -> f64 {
    const ROWS: usize = 400;
    let mut sum = 0.0;
    for a in 0..ROWS {
        let cos = (a as f64 + 0.5) / ROWS as f64;
        for b in 0..4 * ROWS {
            let phi = 2.0 * PI * (b as f64 + 0.5) / (4 * ROWS) as f64;
            let sin = (1.0 - cos * cos).sqrt();
            let w = [sin * phi.cos(), sin * phi.sin(), -cos];
            let (u, v) = to_square(rotated(axis, -degrees, w));
            if ((u * f64::from(SIDE)) as u32, (v * f64::from(SIDE)) as u32) == texel {
                sum += cos;
            }
        }
    }
    sum * 2.0 * PI / (4 * ROWS * ROWS) as f64
}

fn sky(folder: &Path, name: &str, texel: (u32, u32)) {
    let mut image = Image::new(SIDE, SIDE);
    let at = image.index(texel.0, texel.1);
    image.pixels[at] = [1.0; 3];
    write_image(&folder.join(name), &image, &[]).expect("writable");
}

#[test]
fn each_texel_lights_from_its_own_direction() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let turns = [
        ([0.0, 0.0, 1.0], 0.0),
        ([1.0, 0.0, 0.0], 180.0),
        ([1.0, 2.0, 3.0], 70.0),
        ([-2.0, 0.5, 1.0], 130.0),
    ];
    let (mut lit, mut dark) = (0, 0);
    for (k, texel) in
        [(4, 4), (6, 4), (4, 6), (2, 3), (3, 1), (0, 0), (7, 0), (7, 4), (1, 6)].into_iter().enumerate()
    {
        let name = format!("sky{k}.{}", if k % 2 == 0 { "exr" } else { "pfm" });
        sky(folder.path(), &name, texel);
        for (axis, degrees) in turns {
            let frame = Frame { size: (4, 4), spp: 64, max_depth: 1 };
            let text = head(&orthographic(-0.001, 1.0), frame)
                + &format!(
                    "AttributeBegin\nRotate {degrees} {}\nLightSource \"infinite\" \"string filename\" \"{name}\" \"float scale\" 2\n\
                     AttributeEnd\nMaterial \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\n\
                     Shape \"bilinearmesh\" \"point3 P\" [ -9 -9 0 9 -9 0 -9 9 0 9 9 0 ]\n",
                    crate::support::list(axis)
                );
            let expected = 2.0 * 0.5 / PI * irradiance(texel, axis, degrees);
            let scene = scene_beside(&text, folder.path());
            let what = format!("texel {texel:?} turned by {degrees} about {axis:?}");
            let runs = Runs::of(&scene, &RenderSettings::default(), 12);
            if expected < 1e-4 {
                // At the horizon the plane's own pixels differ.
                dark += 1;
                runs.assert_near(&[expected; 16], f64::INFINITY, 1e-4, &what);
                continue;
            }
            lit += 1;
            // The sum over 640,000 directions is good to about a hundredth of a texel's edge.
            runs.assert_near(&[expected; 16], 2e-2, 5e-5 + 2e-2 * expected, &what);
            let settings = RenderSettings { estimator: Estimator::Lights, ..RenderSettings::default() };
            Runs::of(&scene, &settings, 12).assert_near(&[expected; 16], 2e-2, 5e-5 + 2e-2 * expected, &what);
        }
    }
    assert!(lit > 8 && dark > 4, "{lit} lit, {dark} dark");
}

/// `illuminance` asks for the light that falls on a plane facing the light's +z.
#[test]
fn illuminance_scales_the_image() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut image = Image::new(16, 16);
    for (i, p) in image.pixels.iter_mut().enumerate() {
        *p = [0.2 + (i % 7) as f32; 3];
    }
    write_image(&folder.path().join("sky.exr"), &image, &[]).expect("writable");
    let frame = Frame { size: (4, 4), spp: 64, max_depth: 1 };
    // Turned, so that the light's +z is the plane's −z.
    let text = head(&orthographic(-0.001, 1.0), frame)
        + "AttributeBegin\nRotate 180 1 0 0\nLightSource \"infinite\" \"string filename\" \"sky.exr\" \"float illuminance\" 3\n\
           AttributeEnd\nMaterial \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\n\
           Shape \"bilinearmesh\" \"point3 P\" [ -9 -9 0 9 -9 0 -9 9 0 9 9 0 ]\n";
    let scene = scene_beside(&text, folder.path());
    Runs::of(&scene, &RenderSettings::default(), 12).assert_near(&[1.5 / PI; 16], 5e-3, 3e-3, "3 lx");
}
