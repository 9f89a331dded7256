//! Where bad numbers are put: scenes with one `@` each.
//!
//! Invariant: with its good value each is a good scene. What stands left of x = −1 is the subject; where `Neighbours` is
//! kept, no number in place of `@` brings it in front of what stands right of x = 0.

/// What the rest of the picture has to do with the subject.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Neighbours {
    /// Pixels of the right half do not see it.
    Apart,
    /// They may: a light, the camera, a shape that may grow over them.
    Touched,
    /// Only numbers below zero keep it away from them.
    ApartBelowZero,
}

use Neighbours::{Apart, ApartBelowZero, Touched};

/// A scene with a place for a number.
pub(super) struct Place {
    pub(super) group: &'static str,
    pub(super) text: String,
    pub(super) good: &'static str,
    pub(super) neighbours: Neighbours,
}

const CAMERA: &str = "LookAt 0 0 -3  0 0 0  0 1 0\n\
    Camera \"orthographic\" \"float screenwindow\" [ -2 2 -1 1 ]\n";
const FILM: &str = "Film \"rgb\" \"integer xresolution\" 24 \"integer yresolution\" 12\n\
    Sampler \"zsobol\" \"integer pixelsamples\" 2\nPixelFilter \"box\"\nIntegrator \"path\" \"integer maxdepth\" 1\n";
/// The light shines along the camera's rays, so that no pixel has to do with what stands beside it.
const SUN: &str = "LightSource \"distant\" \"point3 from\" [ 0 0 -1 ] \"point3 to\" [ 0 0 0 ]\n";
const RIGHT: &str = "AttributeBegin\nMaterial \"diffuse\" \"rgb reflectance\" [ .6 .5 .4 ]\n\
    Shape \"trianglemesh\" \"point3 P\" [ 0 -1 1  2 -1 1  2 1 1.5  0 1 1.5 ] \"integer indices\" [ 0 1 2 0 2 3 ]\n\
    Translate 1 0 .5\nShape \"sphere\" \"float radius\" .4\nAttributeEnd\n";
const QUAD: &str =
    "\"point3 P\" [ -1.9 -.9 1  -1.1 -.9 1  -1.1 .9 1  -1.9 .9 1 ] \"integer indices\" [ 0 1 2 0 2 3 ]";

fn scene(subject: &str) -> String {
    format!("{CAMERA}{FILM}WorldBegin\n{SUN}{RIGHT}AttributeBegin\n{subject}\nAttributeEnd\n")
}

/// All places in scene files; `images` is what texture files are called.
pub(super) fn places() -> Vec<Place> {
    let mut all = Vec::new();
    let mut add = |group, good, neighbours, text: String| {
        assert_eq!(text.matches('@').count(), 1, "{text}");
        all.push(Place { group, text, good, neighbours });
    };
    for (vertex, neighbours) in [("-1.9 @ 1", Apart), ("-1.9 -.9 @", Apart), ("@ -.9 1", ApartBelowZero)] {
        let triangle =
            format!("\"point3 P\" [ {vertex}  -1.1 -.9 1  -1.1 .9 1 ] \"integer indices\" [ 0 1 2 ]");
        add("vertices", "-1.5", neighbours, scene(&format!("Shape \"trianglemesh\" {triangle}")));
        let loops = format!("Shape \"loopsubdiv\" \"integer levels\" 2 {triangle}");
        add("vertices", "-1.5", neighbours, scene(&loops));
        let squares = format!(
            "Shape \"catmullclark\" \"integer levels\" 2 {triangle} \"integer facevertexcounts\" [ 3 ]"
        );
        add("vertices", "-1.5", neighbours, scene(&squares));
        let patch =
            format!("Shape \"bilinearmesh\" \"point3 P\" [ {vertex}  -1.1 -.9 1  -1.9 .9 1  -1.1 .9 1 ]");
        add("vertices", "-1.5", neighbours, scene(&patch));
        let lamp = format!("AreaLightSource \"diffuse\"\nShape \"trianglemesh\" {triangle}");
        add("vertices", "-1.5", Touched, scene(&lamp));
    }
    // Beside a good triangle of the same mesh, whose pixels must not change.
    let beside = "\"point3 P\" [ -1.9 -.9 1  -1.1 @ 1  -1.9 .9 1  .1 -.9 .2  1 -.9 .2  1 .9 .2 ]";
    add(
        "vertices",
        "-.9",
        Apart,
        scene(&format!("Shape \"trianglemesh\" {beside} \"integer indices\" [ 0 1 2 3 4 5 ]")),
    );
    for attribute in [
        "\"normal N\" [ 0 0 -1  0 @ -1  0 0 -1  0 0 -1 ]",
        "\"normal N\" [ @ 0 0  @2 0 0  0 0 -1  0 0 -1 ]",
        "\"point2 uv\" [ @ 0  1 0  1 1  0 1 ]",
        "\"point2 uv\" [ 0 0  1 0  1 1  0 @ ]",
        "\"vector3 S\" [ 1 0 @  1 0 0  1 0 0  1 0 0 ]",
    ] {
        let attribute = attribute.replace("@2", "1");
        for material in [
            "Material \"diffuse\"",
            "Material \"conductor\" \"float uroughness\" .1 \"float vroughness\" .3",
            "Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"good.pfm\" \"string filter\" \"ewa\"\n\
             Material \"diffuse\" \"texture reflectance\" \"t\"",
            "Texture \"t\" \"spectrum\" \"checkerboard\" \"float uscale\" 3\nMaterial \"diffuse\" \"texture reflectance\" \"t\"",
        ] {
            let subject = format!("{material}\nShape \"trianglemesh\" {QUAD} {attribute}");
            add("normals, uvs and tangents", ".3", Apart, scene(&subject));
        }
    }
    for transform in [
        "Translate 0 @ 0",
        "Translate 0 0 @",
        "Scale 1 @ 1",
        "Scale 1 1 @",
        "Rotate 20 @ 0 0",
        "Transform [ 1 0 0 0  0 1 0 0  0 0 @ 0  0 0 0 1 ]",
        "ConcatTransform [ 1 0 0 0  0 1 0 0  0 0 1 0  0 @ 0 1 ]",
        "ConcatTransform [ 1 0 0 0  0 1 @ 0  0 0 1 0  0 0 0 1 ]",
        "ConcatTransform [ 1 0 0 0  0 1 0 0  0 0 1 0  0 0 0 @ ]",
    ] {
        let neighbours = if transform.ends_with("@ ]") { Touched } else { Apart };
        let sphere = "Translate -1.5 0 1\nShape \"sphere\" \"float radius\" .4";
        for shape in [format!("Shape \"trianglemesh\" {QUAD}"), sphere.to_owned()] {
            add("transforms", "1", neighbours, scene(&format!("{transform}\n{shape}")));
            let object = format!("ObjectBegin \"o\"\nAttributeBegin\n{shape}\nAttributeEnd\nObjectEnd");
            let placed = format!("{object}\n{transform}\nObjectInstance \"o\"");
            add("transforms", "1", neighbours, scene(&placed));
        }
    }
    add(
        "transforms",
        "1",
        Touched,
        scene(&format!("LookAt 0 0 -1  @ 0 0  0 1 0\nShape \"trianglemesh\" {QUAD}")),
    );
    for shape in [
        "Shape \"sphere\" \"float radius\" @",
        "Shape \"sphere\" \"float radius\" .4 \"float zmin\" @",
        "Shape \"sphere\" \"float radius\" .4 \"float phimax\" @",
        "Shape \"disk\" \"float radius\" @",
        "Shape \"disk\" \"float radius\" .4 \"float height\" @",
        "Shape \"disk\" \"float radius\" .4 \"float innerradius\" @",
        "Shape \"cylinder\" \"float radius\" @",
        "Shape \"cylinder\" \"float radius\" .4 \"float zmax\" @",
    ] {
        add("radii, heights and sweeps", ".3", Touched, scene(&format!("Translate -1.5 0 1\n{shape}")));
        add(
            "radii, heights and sweeps",
            ".3",
            Touched,
            scene(&format!("Translate -1.5 0 1\nAreaLightSource \"diffuse\"\n{shape}")),
        );
    }
    for material in [
        "\"diffuse\" \"rgb reflectance\" [ .5 @ .5 ]",
        "\"conductor\" \"float roughness\" @",
        "\"conductor\" \"rgb eta\" [ 1 @ 1 ] \"rgb k\" [ 1 1 1 ]",
        "\"conductor\" \"rgb eta\" [ 1 1 1 ] \"rgb k\" [ @ 1 1 ]",
        "\"conductor\" \"rgb reflectance\" [ @ .5 .5 ]",
        "\"dielectric\" \"float eta\" @",
        "\"dielectric\" \"float roughness\" @",
        "\"thindielectric\" \"float eta\" @",
        "\"coateddiffuse\" \"float roughness\" @",
        "\"coateddiffuse\" \"float eta\" @",
        "\"coateddiffuse\" \"float thickness\" @",
        "\"diffusetransmission\" \"rgb transmittance\" [ @ .2 .2 ]",
        "\"diffusetransmission\" \"float scale\" @",
        "\"coatedconductor\" \"float conductor.roughness\" @",
    ] {
        add("materials", ".3", Apart, scene(&format!("Material {material}\nShape \"trianglemesh\" {QUAD}")));
    }
    for texture in [
        "\"spectrum\" \"checkerboard\" \"float uscale\" @",
        "\"spectrum\" \"checkerboard\" \"float vdelta\" @",
        "\"spectrum\" \"imagemap\" \"string filename\" \"good.pfm\" \"float uscale\" @",
        "\"spectrum\" \"imagemap\" \"string filename\" \"good.pfm\" \"float scale\" @",
        "\"spectrum\" \"constant\" \"rgb value\" [ .1 @ .1 ]",
        "\"spectrum\" \"scale\" \"rgb tex\" [ 1 1 1 ] \"float scale\" @",
        "\"spectrum\" \"mix\" \"float amount\" @",
    ] {
        let material = "Material \"diffuse\" \"texture reflectance\" \"t\"";
        add(
            "textures",
            ".3",
            Apart,
            scene(&format!("Texture \"t\" {texture}\n{material}\nShape \"trianglemesh\" {QUAD}")),
        );
    }
    add("textures", ".3", Apart, scene(&format!("Shape \"trianglemesh\" {QUAD} \"float alpha\" @")));
    for light in [
        "LightSource \"point\" \"rgb I\" [ @ 1 1 ]",
        "LightSource \"point\" \"point3 from\" [ 0 @ 0 ]",
        "LightSource \"point\" \"float power\" @",
        "LightSource \"spot\" \"float coneangle\" @",
        "LightSource \"spot\" \"float conedeltaangle\" @",
        "LightSource \"spot\" \"point3 from\" [ 0 0 0 ] \"point3 to\" [ 0 0 @ ]",
        "LightSource \"distant\" \"rgb L\" [ @ 1 1 ]",
        "LightSource \"distant\" \"float scale\" @",
        "LightSource \"distant\" \"float illuminance\" @",
        "LightSource \"distant\" \"point3 from\" [ 0 @ -1 ]",
        "LightSource \"infinite\" \"rgb L\" [ 1 @ 1 ]",
        "LightSource \"infinite\" \"float illuminance\" @",
        "LightSource \"infinite\" \"blackbody L\" @",
        "Scale @ 1 1\nLightSource \"infinite\" \"string filename\" \"good.pfm\"",
    ] {
        add("lights", "1", Touched, scene(light));
    }
    for lamp in ["\"rgb L\" [ 1 @ 1 ]", "\"float scale\" @", "\"float power\" @", "\"blackbody L\" @"] {
        for shape in [format!("\"trianglemesh\" {QUAD}"), "\"sphere\"".to_owned(), "\"disk\"".to_owned()] {
            add("lights", "1", Touched, scene(&format!("AreaLightSource \"diffuse\" {lamp}\nShape {shape}")));
        }
    }
    let world = format!("WorldBegin\n{SUN}{RIGHT}");
    for camera in [
        "LookAt 0 0 @  0 0 1  0 1 0\nCamera \"perspective\"",
        "LookAt 0 0 -3  @ 0 0  0 1 0\nCamera \"perspective\"",
        "LookAt 0 0 -3  0 0 0  0 @ 0\nCamera \"perspective\"",
        "Scale 1 @ 1\nCamera \"perspective\"",
        "Camera \"perspective\" \"float fov\" @",
        "Camera \"perspective\" \"float lensradius\" @",
        "Camera \"perspective\" \"float lensradius\" .1 \"float focaldistance\" @",
        "Camera \"orthographic\" \"float screenwindow\" [ -1 @ -1 1 ]",
        "Camera \"perspective\" \"float frameaspectratio\" @",
    ] {
        let good = if camera.starts_with("LookAt 0 0 @") { "-3" } else { "1" };
        add("cameras and films", good, Touched, format!("{camera}\n{FILM}{world}"));
    }
    for film in [
        "PixelFilter \"gaussian\" \"float sigma\" @",
        "PixelFilter \"mitchell\" \"float B\" @",
        "PixelFilter \"box\" \"float xradius\" @",
        "Film \"rgb\" \"integer xresolution\" 24 \"integer yresolution\" 12 \"float iso\" @",
        "Film \"rgb\" \"integer xresolution\" 24 \"integer yresolution\" 12 \"float maxcomponentvalue\" @",
    ] {
        add("cameras and films", "1", Touched, format!("{CAMERA}{FILM}{film}\n{world}"));
    }
    all
}

/// The scene around a mesh or image file named `file` in the left half.
pub(super) fn with_mesh(file: &str, material: &str) -> String {
    scene(&format!("{material}\nShape \"plymesh\" \"string filename\" \"{file}\""))
}

/// The scene around an image on the left, by a filter, as what the material says.
pub(super) fn with_texels(filter: &str, subject: &str) -> String {
    scene(&format!("{}\nShape \"trianglemesh\" {QUAD}", subject.replace("FILTER", filter)))
}

/// The scene under a sky of that image.
pub(super) fn with_sky() -> String {
    scene("LightSource \"infinite\" \"string filename\" \"bad.pfm\"")
}
