//! Texture filters in whole renders: what they may change, and what light sampling and scattering
//! must both see whatever they are.

use crate::significance::Runs;
use crate::support::{Frame, head, image, scene_beside};
use std::path::Path;
use weir::film::Image;
use weir::film::write::write_image;
use weir::scene::SceneDescription;
use weir::settings::{Estimator, RenderSettings, TextureFilter};

const FILTERS: [TextureFilter; 5] = [
    TextureFilter::Point,
    TextureFilter::Bilinear,
    TextureFilter::Trilinear,
    TextureFilter::Ewa,
    TextureFilter::Stochastic,
];

/// An image of single bright texels, which every filter sees differently.
fn specks(folder: &Path) {
    let mut image = Image::new(64, 64);
    for y in 0..64u32 {
        for x in 0..64 {
            let at = image.index(x, y);
            let h = (x * 7919 + y * 104_729) % 97;
            image.pixels[at] = if h < 30 { [0.9, 0.8, 0.1] } else { [0.05, 0.1, 0.3] };
        }
    }
    write_image(&folder.join("specks.exr"), &image, &[]).expect("writable");
}

/// A floor with material `floor` under a lamp that shows an image and is masked by another.
fn world(folder: &Path, floor: &str) -> SceneDescription {
    specks(folder);
    let frame = Frame { size: (20, 14), spp: 64, max_depth: 1 };
    let text = head("LookAt 0 3 -6  0 .5 0  0 1 0\nCamera \"perspective\" \"float fov\" 45", frame)
        + "Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"specks.exr\" \"float uscale\" 4 \"float vscale\" 4\n\
           Texture \"mask\" \"float\" \"imagemap\" \"string filename\" \"specks.exr\"\n"
        + floor
        + "Shape \"trianglemesh\" \"point3 P\" [ -8 0 -8  8 0 -8  8 0 8  -8 0 8 ] \"integer indices\" [ 0 2 1 0 3 2 ] \
           \"point2 uv\" [ 0 0 1 0 1 1 0 1 ]\n\
           AttributeBegin\nAreaLightSource \"diffuse\" \"string filename\" \"specks.exr\" \"float scale\" 2 \"bool twosided\" true\n\
           Shape \"bilinearmesh\" \"point3 P\" [ -7 .1 3  7 .1 2  -6 7 3.5  6 6 2 ] \"texture alpha\" \"mask\"\nAttributeEnd\n";
    scene_beside(&text, folder)
}

fn with(filter: TextureFilter, estimator: Estimator) -> RenderSettings {
    RenderSettings { texture_filter: Some(filter), estimator, ..RenderSettings::default() }
}

/// Lights are read at one place, with no footprint, by light sampling and by the ray that runs into
/// them: no filter changes a bit of their picture. Masks too are read at one place; there the
/// point filter alone differs from interpolation.
#[test]
fn filters_do_not_change_lights_or_masks() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = world(folder.path(), "Material \"diffuse\"\n");
    let picture = |filter| image(&scene, &with(filter, Estimator::Both)).pixels;
    let bilinear = picture(TextureFilter::Bilinear);
    for filter in [TextureFilter::Trilinear, TextureFilter::Ewa, TextureFilter::Stochastic] {
        assert!(picture(filter) == bilinear, "{filter:?} changes a lamp");
    }
    assert!(picture(TextureFilter::Point) != bilinear, "the mask has no influence: nothing was tested");
}

/// On a textured floor that several filters really see differently. False alarm 1e-2 a pair and
/// filter, of seeds that do not change.
#[test]
fn light_sampling_and_scattering_agree_with_every_filter() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = world(folder.path(), "Material \"diffuse\" \"texture reflectance\" \"t\"\n");
    let mut means = Vec::new();
    for filter in FILTERS {
        let lights = Runs::of(&scene, &with(filter, Estimator::Lights), 32);
        let scattering = Runs::of(&scene, &with(filter, Estimator::Scattering), 64);
        lights.assert_agrees(&scattering, 1e-2, &format!("{filter:?}: lights and scattering"));
        means.push(image(&scene, &with(filter, Estimator::Lights)).pixels);
    }
    for (i, a) in means.iter().enumerate() {
        assert!(means[..i].iter().all(|b| a != b), "{:?} is another filter's picture", FILTERS[i]);
    }
}
