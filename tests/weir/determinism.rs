//! One seed, one picture: bit for bit on every run, with any number of threads, in any crop window.

use crate::support::{bits, head, icosphere, image, scene_beside};
use std::path::Path;
use weir::film::Image;
use weir::film::write::write_image;
use weir::scene::SceneDescription;
use weir::settings::RenderSettings;

/// Odd sizes, a filter wider than a pixel, passes that do not divide the samples.
pub(crate) fn everything(folder: &Path) -> SceneDescription {
    let mut sky = Image::new(8, 8);
    for (i, p) in sky.pixels.iter_mut().enumerate() {
        *p = [0.2, 0.3, 0.2 + 0.3 * (i % 5) as f32];
    }
    write_image(&folder.join("sky.pfm"), &sky, &[]).expect("writable");
    write_image(&folder.join("texture.png"), &sky, &[]).expect("writable");
    let frame = crate::support::Frame { size: (61, 43), spp: 33, max_depth: 6 };
    let text = head("LookAt 0 3 -6  0 .5 0  0 1 0\nCamera \"perspective\" \"float fov\" 45 \"float lensradius\" .05 \"float focaldistance\" 6", frame)
        .replace("PixelFilter \"box\"", "PixelFilter \"mitchell\"")
        + &format!(
            "MakeNamedMedium \"fog\" \"string type\" \"homogeneous\" \"rgb sigma_a\" [ .5 .2 .1 ] \"rgb sigma_s\" [ 0 0 0 ]\n\
             LightSource \"infinite\" \"string filename\" \"sky.pfm\"\n\
             LightSource \"infinite\" \"rgb L\" [ .1 .1 .1 ]\n\
             LightSource \"point\" \"rgb I\" [ 2 2 2 ] \"point3 from\" [ 1 4 -2 ]\n\
             LightSource \"distant\" \"rgb L\" [ 1 1 .5 ] \"point3 from\" [ 1 2 -2 ]\n\
             Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"texture.png\" \"string filter\" \"trilinear\" \"float uscale\" 5\n\
             Texture \"a\" \"float\" \"checkerboard\" \"float uscale\" 9 \"float vscale\" 9 \"float tex1\" 1 \"float tex2\" .3\n\
             Material \"diffuse\" \"texture reflectance\" \"t\"\n\
             Shape \"bilinearmesh\" \"point3 P\" [ -8 0 -8  8 0 -8  -8 0 8  8 0 8 ]\n\
             ObjectBegin \"ball\"\nMaterial \"conductor\" \"float roughness\" .05\nShape \"trianglemesh\" {}\n\
             Material \"diffuse\"\nTranslate 0 1.3 0\nShape \"sphere\" \"float radius\" .4 \"texture alpha\" \"a\"\nObjectEnd\n\
             AttributeBegin\nTranslate -2 1 1\nObjectInstance \"ball\"\nAttributeEnd\n\
             AttributeBegin\nTranslate 2 1 2\nScale -.7 1 .8\nObjectInstance \"ball\"\nAttributeEnd\n\
             AttributeBegin\nTranslate 0 1 0\nMaterial \"dielectric\"\nMediumInterface \"fog\" \"\"\nShape \"sphere\"\nAttributeEnd\n\
             AttributeBegin\nTranslate 2 .5 -1\nMaterial \"coateddiffuse\" \"float roughness\" .1\nShape \"cylinder\" \"float radius\" .3\nAttributeEnd\n\
             MakeNamedMaterial \"x\" \"string type\" \"diffuse\"\nMakeNamedMaterial \"y\" \"string type\" \"thindielectric\"\n\
             AttributeBegin\nMaterial \"mix\" \"string materials\" [ \"x\" \"y\" ]\nTranslate -2 .6 -1\nShape \"disk\" \"float radius\" .6\nAttributeEnd\n\
             AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ 4 5 6 ]\nTranslate -1 3 0\nShape \"sphere\" \"float radius\" .3\nAttributeEnd\n\
             AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ 6 5 4 ]\nShape \"trianglemesh\" \"point3 P\" [ 1 3 0 2 3 0 2 3 1 1 3.1 1 ] \
             \"integer indices\" [ 0 1 2 0 2 3 ]\nAttributeEnd\n",
            icosphere(2)
        );
    scene_beside(&text, folder)
}

#[test]
fn threads_and_runs_change_no_bit_and_seeds_do() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = everything(folder.path());
    let with = |threads, seed| {
        image(&scene, &RenderSettings { threads: Some(threads), seed, ..RenderSettings::default() })
    };
    let first = with(1, None);
    assert_eq!((first.width, first.height), (61, 43));
    let flat = first.pixels.iter().all(|p| *p == first.pixels[0]);
    assert!(!flat && first.pixels.iter().flatten().all(|c| c.is_finite()));
    for threads in [1, 2, 3, 2, 8] {
        assert!(bits(&with(threads, None)) == bits(&first), "{threads} threads: another picture");
    }
    // Loading the scene again changes nothing either.
    let again = everything(folder.path());
    let settings = RenderSettings { threads: Some(2), ..RenderSettings::default() };
    assert!(bits(&image(&again, &settings)) == bits(&first));
    let (a, b) = (with(2, Some(1)), with(2, Some(2)));
    let same = a.pixels.iter().zip(&b.pixels).filter(|(a, b)| a == b).count();
    // Of the sky's few flat texels no sample can be told from another.
    assert!(same * 10 < a.pixels.len(), "{same} pixels are the same with another seed");
}

#[test]
fn a_crop_window_has_the_pixels_of_the_whole() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = everything(folder.path());
    let whole = image(&scene, &RenderSettings::default());
    for crop in [[0, 0, 61, 43], [7, 5, 50, 30], [60, 42, 61, 43], [3, 0, 20, 43]] {
        let settings = RenderSettings { crop: Some(crop), threads: Some(2), ..RenderSettings::default() };
        let part = image(&scene, &settings);
        assert_eq!((part.width, part.height), (crop[2] - crop[0], crop[3] - crop[1]));
        assert_eq!((part.origin, part.full_size), ((crop[0], crop[1]), (61, 43)));
        for y in 0..part.height {
            for x in 0..part.width {
                let inside = part.pixels[part.index(x, y)].map(f32::to_bits);
                let at = whole.pixels[whole.index(crop[0] + x, crop[1] + y)].map(f32::to_bits);
                assert_eq!(inside, at, "{crop:?}: pixel {x},{y}");
            }
        }
    }
}

/// The number of samples changes noise, not the mean.
#[test]
fn more_samples_have_the_same_mean() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut scene = everything(folder.path());
    // Footprints of textures follow the number of samples, as pbrt's do.
    scene.textures.iter_mut().for_each(|t| {
        if let weir::scene::Texture::Image { filter, .. } = t {
            *filter = weir::scene::TextureFilter::Bilinear;
        }
    });
    scene.filter = weir::scene::Filter::Box { radius: [0.5, 0.5] };
    let with = |spp| {
        image(&scene, &RenderSettings { spp: Some(spp), threads: Some(2), ..RenderSettings::default() })
    };
    let (one, two) = (with(16), with(32));
    let differ = one.pixels.iter().zip(&two.pixels).filter(|(a, b)| a != b).count();
    assert!(differ * 2 > one.pixels.len());
    let mean = |i: &Image| crate::support::mean(&crate::support::grey(i));
    assert!((mean(&one) / mean(&two) - 1.0).abs() < 0.01, "{} {}", mean(&one), mean(&two));
}
