//! One picture however its parts are put in place: instances or the shapes themselves, one transform
//! or many, mirrored or not.

use crate::significance::{Runs, differing};
use crate::support::{Frame, head, icosphere, image, mean, scene};
use weir::settings::RenderSettings;

const FRAME: Frame = Frame { size: (48, 32), spp: 16, max_depth: 4 };

fn view(world: &str) -> String {
    head("LookAt 1 2 -7  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" 40", FRAME)
        + "Texture \"squares\" \"spectrum\" \"checkerboard\" \"float uscale\" 6 \"float vscale\" 6 \"rgb tex1\" [ .8 .2 .1 ] \
           \"rgb tex2\" [ .1 .3 .7 ]\n\
           LightSource \"infinite\" \"rgb L\" [ .4 .5 .6 ]\n\
           LightSource \"distant\" \"rgb L\" [ 2 1.8 1.5 ] \"point3 from\" [ -2 4 -3 ] \"point3 to\" [ 0 0 0 ]\n\
           AttributeBegin\nMaterial \"diffuse\" \"rgb reflectance\" [ .4 .4 .4 ]\nShape \"bilinearmesh\" \
           \"point3 P\" [ -9 -1.5 -9 9 -1.5 -9 -9 -1.5 9 9 -1.5 9 ]\nAttributeEnd\n"
        + world
}

/// Of everything that has a surface, textured by (u, v) so that a wrong coordinate shows.
fn things() -> String {
    format!(
        "Material \"diffuse\" \"texture reflectance\" \"squares\"\nShape \"sphere\" \"float radius\" .6\n\
         AttributeBegin\nTranslate 1.3 0 0\nRotate 40 1 1 0\nShape \"cylinder\" \"float radius\" .4\nAttributeEnd\n\
         AttributeBegin\nTranslate -1.3 0 0\nRotate 200 0 1 0\nScale 1 1.4 1\nShape \"disk\" \"float radius\" .5\nAttributeEnd\n\
         AttributeBegin\nMaterial \"conductor\" \"float roughness\" .2\nTranslate 0 1.2 0\nScale .5 .4 .5\nShape \"trianglemesh\" {}\nAttributeEnd\n\
         AttributeBegin\nMaterial \"dielectric\"\nTranslate -.6 -1 -.8\nScale .4 .4 .4\nShape \"trianglemesh\" {}\nAttributeEnd\n\
         AttributeBegin\nMaterial \"coateddiffuse\" \"rgb reflectance\" [ .2 .6 .3 ]\nTranslate .7 -1 -.8\n\
         Shape \"bilinearmesh\" \"point3 P\" [ -.4 -.4 0 .4 -.4 .1 -.4 .4 .1 .4 .4 0 ]\nAttributeEnd\n",
        icosphere(2),
        icosphere(1)
    )
}

/// The same picture from other samples: a mirrored quadric's normal is turned (see `sides`), and with
/// it the frame that directions are drawn in.
#[track_caller]
fn alike(a: &str, b: &str, what: &str) {
    let runs = |text: &str| {
        let settings = RenderSettings { spp: Some(64), ..RenderSettings::default() };
        Runs::of(&scene(text), &settings, 12)
    };
    runs(a).assert_agrees(&runs(b), 5e-3, what);
}

/// The same samples through another structure: rounding moves a few edges by a sample, no more.
#[track_caller]
fn same(a: &str, b: &str, what: &str) {
    let settings = RenderSettings::default();
    let (a, b) = (image(&scene(a), &settings), image(&scene(b), &settings));
    let far = differing(&a, &b, 1e-3);
    let (ma, mb) = (mean(&crate::support::grey(&a)), mean(&crate::support::grey(&b)));
    // Glass splits paths at rounding's whim where an edge is near; 16 samples a pixel show each.
    assert!(far * 50 <= a.pixels.len(), "{what}: {far} of {} pixels differ", a.pixels.len());
    assert!((ma / mb - 1.0).abs() < 1e-3, "{what}: means {ma} and {mb}");
    assert!(ma > 0.1);
}

const PLACES: [&str; 5] = [
    "",
    "Translate .3 .2 1\nRotate 75 0 1 0\n",
    "Rotate 20 1 0 1\nScale .8 1.3 .7\n",
    "Scale -1 1 1\n",
    "Translate .5 0 .5\nScale 1 1 -1\nRotate 33 0 0 1\nScale .7 .7 .7\n",
];

#[test]
fn an_instance_is_the_thing_itself() {
    let object = format!(
        "AttributeBegin\nTranslate 0 .1 0\nObjectBegin \"things\"\n{}ObjectEnd\nAttributeEnd\n",
        things()
    );
    for place in PLACES {
        let instance =
            view(&format!("{object}AttributeBegin\n{place}ObjectInstance \"things\"\nAttributeEnd\n"));
        // pbrt: an object's shapes carry the transform of its definition below that of its instance.
        let plain = view(&format!("AttributeBegin\n{place}Translate 0 .1 0\n{}AttributeEnd\n", things()));
        if place.contains('-') {
            alike(&instance, &plain, &format!("{place:?}"));
        } else {
            same(&instance, &plain, &format!("{place:?}"));
        }
    }
}

#[test]
fn many_instances_are_many_things() {
    let mut instances = format!("ObjectBegin \"things\"\n{}ObjectEnd\n", things());
    let mut plain = String::new();
    for (i, place) in PLACES.iter().enumerate() {
        let at = format!(
            "AttributeBegin\nTranslate {} {} 2\nScale .4 .4 .4\n{place}",
            i as f64 - 2.0,
            0.3 * i as f64
        );
        instances += &format!("{at}ObjectInstance \"things\"\nAttributeEnd\n");
        plain += &format!("{at}{}AttributeEnd\n", things());
    }
    alike(&view(&instances), &view(&plain), "five");
}

#[test]
fn transforms_compose_however_they_are_written() {
    let nested = "AttributeBegin\nTranslate 1 0 0\nTransformBegin\nRotate 30 0 1 0\nTransformEnd\nCoordinateSystem \"here\"\n\
                  AttributeBegin\nIdentity\nCoordSysTransform \"here\"\nRotate 30 0 1 0\nScale 1 .5 1\n";
    let (sin, cos) = 30f64.to_radians().sin_cos();
    // Column by column, as pbrt's Transform and ConcatTransform take it.
    let whole = format!(
        "AttributeBegin\nAttributeBegin\nTransform [ {cos} 0 {} 0  0 .5 0 0  {sin} 0 {cos} 0  1 0 0 1 ]\n",
        -sin
    );
    let concat = format!(
        "AttributeBegin\nAttributeBegin\nTranslate 1 0 0\nConcatTransform [ {cos} 0 {} 0  0 1 0 0  {sin} 0 {cos} 0  0 0 0 1 ]\nScale 1 .5 1\n",
        -sin
    );
    let end = format!("{}AttributeEnd\nAttributeEnd\n", things());
    let base = view(&(nested.to_owned() + &end));
    // pbrt's Transform is relative to the world: nothing else was in force.
    same(&view(&(whole + &end)), &base, "Transform");
    same(&view(&(concat + &end)), &base, "ConcatTransform");
}

/// A mirrored world under a mirrored light, seen by a mirrored camera, is the world.
#[test]
fn a_mirrored_world_in_a_mirror_is_the_world() {
    let plain = view(&things());
    let (before, after) = plain.split_once("WorldBegin\n").expect("a world");
    // camera ∘ mirror ∘ mirror: what the camera sees has been mirrored twice.
    let mirrored = format!("{}Scale -1 1 1\n{}", before.split_once("Camera").expect("a camera").0, "")
        + "Camera"
        + before.split_once("Camera").expect("a camera").1
        + "WorldBegin\nScale -1 1 1\n"
        + after;
    alike(&mirrored, &plain, "mirrored");
}

/// Emission, alpha and media in mirrored instances: surfaces keep their sides.
#[test]
fn glass_in_a_mirrored_instance_still_refracts_inwards() {
    let frame = Frame { size: (8, 8), spp: 64, max_depth: 50 };
    let camera = "LookAt 0 0 -4  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" 20";
    let fog = "MakeNamedMedium \"fog\" \"string type\" \"homogeneous\" \"rgb sigma_a\" [ .7 .7 .7 ] \"rgb sigma_s\" [ 0 0 0 ]\n\
               LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n";
    let ball = "AttributeBegin\nMediumInterface \"fog\" \"\"\nMaterial \"dielectric\"\nShape \"sphere\"\nAttributeEnd\n";
    let plain = scene(&(head(camera, frame) + fog + ball));
    for place in ["Scale -1 1 1", "Scale 1 1 -1", "Rotate 50 1 2 3"] {
        let text = format!(
            "{}{fog}ObjectBegin \"ball\"\n{ball}ObjectEnd\n{place}\nObjectInstance \"ball\"\n",
            head(camera, frame)
        );
        let runs = |s| Runs::of(s, &RenderSettings::default(), 12);
        runs(&scene(&text)).assert_agrees(&runs(&plain), 5e-3, place);
    }
}
