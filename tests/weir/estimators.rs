//! Light sampling, scattering sampling and their combination are three ways to one picture.

use crate::significance::Runs;
use crate::support::{Frame, head, scene_beside};
use weir::film::Image;
use weir::film::write::write_image;
use weir::scene::SceneDescription;
use weir::settings::{Estimator, RenderSettings};

/// A dim sky with a bright patch that is wide enough for scattering sampling to find.
fn sky() -> Image {
    let mut image = Image::new(32, 32);
    for y in 0..32u32 {
        for x in 0..32 {
            let at = image.index(x, y);
            let sun = x.abs_diff(11) < 3 && y.abs_diff(20) < 3;
            image.pixels[at] = if sun { [6.0, 5.0, 4.0] } else { [0.2, 0.3 + 0.01 * x as f32, 0.5] };
        }
    }
    image
}

/// A rough plate on a diffuse floor under lamps of every shape and many sizes, and a sky.
fn world(folder: &std::path::Path) -> SceneDescription {
    write_image(&folder.join("sky.exr"), &sky(), &[]).expect("writable");
    let frame = Frame { size: (20, 14), spp: 32, max_depth: 3 };
    let text = head("LookAt 0 3 -6  0 .5 0  0 1 0\nCamera \"perspective\" \"float fov\" 45", frame)
        + "AttributeBegin\nRotate -90 1 0 0\nLightSource \"infinite\" \"string filename\" \"sky.exr\"\nAttributeEnd\n\
           Material \"diffuse\" \"rgb reflectance\" [ .5 .4 .3 ]\n\
           Shape \"bilinearmesh\" \"point3 P\" [ -8 0 -8  8 0 -8  -8 0 8  8 0 8 ]\n\
           AttributeBegin\nMaterial \"conductor\" \"spectrum eta\" \"metal-Cu-eta\" \"spectrum k\" \"metal-Cu-k\" \"float roughness\" .15\n\
           Shape \"trianglemesh\" \"point3 P\" [ -2 .2 2  2 .2 2  2 2.2 3.2  -2 2.2 3.2 ] \"integer indices\" [ 0 1 2 0 2 3 ]\nAttributeEnd\n\
           AttributeBegin\nTranslate -2 1 1\nMaterial \"coateddiffuse\" \"rgb reflectance\" [ .2 .3 .6 ] \"float roughness\" .2\n\
           Shape \"sphere\" \"float radius\" .7\nAttributeEnd\n\
           AttributeBegin\nTranslate 2 .8 .5\nMaterial \"dielectric\" \"float roughness\" .3\nShape \"sphere\" \"float radius\" .7\nAttributeEnd\n\
           AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ 4 5 6 ]\nTranslate -1 3 0\nShape \"sphere\" \"float radius\" .6\nAttributeEnd\n\
           AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ 2 2 2 ]\n\
           Shape \"trianglemesh\" \"point3 P\" [ 1 3 -2  3 3 -2  3 3.4 1  1 3.4 1 ] \"integer indices\" [ 0 1 2 0 2 3 ]\nAttributeEnd\n\
           AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ 5 3 2 ] \"bool twosided\" true\nTranslate -3 2 0\nRotate 60 1 1 0\n\
           Shape \"disk\" \"float radius\" .7\nAttributeEnd\n\
           AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ 2 4 2 ]\nTranslate 0 1.2 -1\nRotate 80 0 1 0\n\
           Shape \"cylinder\" \"float radius\" .2 \"float zmin\" -.8 \"float zmax\" .8\nAttributeEnd\n\
           AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ 3 3 1 ] \"bool twosided\" true\n\
           Shape \"bilinearmesh\" \"point3 P\" [ 3 .3 1  4 .3 2  3 1.6 2.2  4 1.8 1.5 ]\nAttributeEnd\n";
    scene_beside(&text, folder)
}

/// Every pixel by a Z-test, Šidák-corrected; false alarm 1e-3 for each pair of images.
#[test]
fn three_estimators_agree_pixel_by_pixel() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = world(folder.path());
    let runs = |estimator, count| {
        let settings = RenderSettings { estimator, ..RenderSettings::default() };
        Runs::of(&scene, &settings, count)
    };
    let both = runs(Estimator::Both, 24);
    let lights = runs(Estimator::Lights, 48);
    let scattering = runs(Estimator::Scattering, 48);
    lights.assert_agrees(&both, 1e-2, "lights and both");
    scattering.assert_agrees(&both, 1e-2, "scattering and both");
    // What makes the combination worth having: neither alone is as good.
    let noise = |r: &Runs, count: u64| r.noise() * count as f64;
    assert!(noise(&both, 24) < 0.7 * noise(&lights, 48), "{} {}", noise(&both, 24), noise(&lights, 48));
    assert!(
        noise(&both, 24) < 0.7 * noise(&scattering, 48),
        "{} {}",
        noise(&both, 24),
        noise(&scattering, 48)
    );
}

/// Roulette changes the noise and nothing else.
#[test]
fn roulette_keeps_the_mean() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut scene = world(folder.path());
    scene.integrator.max_depth = 12;
    let runs = |roulette| {
        let settings = RenderSettings { roulette: Some(roulette), ..RenderSettings::default() };
        Runs::of(&scene, &settings, 24)
    };
    runs(true).assert_agrees(&runs(false), 5e-3, "roulette");
}
