//! Kernels: whichever runs, the picture is the same to the bit, and a scene never gets one that lacks what it calls for.
//!
//! Invariant: the tests run with debug assertions, which are met where a kernel is given what it has not.

mod prices;

use crate::determinism::everything;
use crate::pages::{least, make, settings};
use crate::support::{Frame, bits, head, icosphere, render, scene_beside, shared_scenes};
use std::path::Path;
use weir::film::Image;
use weir::film::write::write_image;
use weir::prepare::{Calls, KernelName};
use weir::render::{Outcome, plan};
use weir::scene::{self, SceneDescription};
use weir::settings::{Backend, RenderSettings, Schedule};
use weir::study::generate::Kind;

/// A box with a ball under a lamp, and what an effect makes of it.
pub(crate) struct Effect {
    /// As in [`weir::prepare::EFFECTS`], or what the scene is without any.
    pub(crate) name: &'static str,
    camera: &'static str,
    /// Before the floor, whose material it may give.
    floor: &'static str,
    /// The floor's own parameters.
    of_floor: &'static str,
    ball: &'static str,
    /// At the end.
    more: &'static str,
    /// What it needs a kernel to have.
    pub(crate) calls: Calls,
    /// The kernel that does.
    pub(crate) kernel: KernelName,
}

const PINHOLE: &str = "Camera \"perspective\" \"float fov\" 38";
const WHITE: &str = "Material \"diffuse\" \"rgb reflectance\" [ .7 .7 .7 ]";

const PLAIN: Effect = Effect {
    name: "plain",
    camera: PINHOLE,
    floor: WHITE,
    of_floor: "",
    ball: WHITE,
    more: "",
    calls: Calls::NONE,
    kernel: KernelName::Diffuse,
};

/// The plain scene first.
pub(crate) const SCENES: [Effect; 13] = [
    PLAIN,
    Effect {
        name: "textures",
        floor: "Texture \"t\" \"spectrum\" \"checkerboard\" \"float uscale\" 8 \"float vscale\" 8\n\
                Material \"diffuse\" \"texture reflectance\" \"t\"",
        calls: Calls::TEXTURES,
        kernel: KernelName::Textured,
        ..PLAIN
    },
    Effect {
        name: "ray_differentials",
        floor: "Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"texture.png\" \"string filter\" \"trilinear\"\n\
                Material \"diffuse\" \"texture reflectance\" \"t\"",
        calls: Calls::FOOTPRINTS,
        kernel: KernelName::Textured,
        ..PLAIN
    },
    Effect {
        name: "alpha_masks",
        floor: "Texture \"a\" \"float\" \"checkerboard\" \"float uscale\" 8 \"float vscale\" 8 \"float tex1\" 1 \"float tex2\" .5\n\
                Material \"diffuse\" \"rgb reflectance\" [ .7 .7 .7 ]",
        of_floor: "\"texture alpha\" \"a\"",
        ..PLAIN
    },
    Effect {
        name: "rough_lobes",
        ball: "Material \"conductor\" \"float roughness\" .2",
        calls: Calls::LOBES,
        kernel: KernelName::Solid,
        ..PLAIN
    },
    Effect {
        name: "transmission",
        ball: "Material \"dielectric\"",
        calls: Calls::TRANSMISSION,
        kernel: KernelName::Solid,
        ..PLAIN
    },
    Effect {
        name: "layered_coats",
        ball: "Material \"coateddiffuse\" \"float roughness\" 0",
        calls: Calls::LOBES,
        kernel: KernelName::Solid,
        ..PLAIN
    },
    Effect {
        name: "media",
        ball: "MakeNamedMedium \"fog\" \"string type\" \"homogeneous\" \"rgb sigma_a\" [ 1 2 3 ] \"rgb sigma_s\" [ 0 0 0 ]\n\
               Material \"interface\"\nMediumInterface \"fog\" \"\"",
        calls: Calls::MEDIA,
        kernel: KernelName::General,
        ..PLAIN
    },
    Effect {
        name: "depth_of_field",
        camera: "Camera \"perspective\" \"float fov\" 38 \"float lensradius\" .05 \"float focaldistance\" 4",
        calls: Calls::LENS,
        kernel: KernelName::Solid,
        ..PLAIN
    },
    Effect {
        name: "instances",
        more: "ObjectBegin \"o\"\nShape \"trianglemesh\" \"point3 P\" [ 0 0 0  .3 0 0  0 0 .3 ]\nObjectEnd\n\
               AttributeBegin\nTranslate -.5 -.5 .3\nObjectInstance \"o\"\nAttributeEnd",
        calls: Calls::INSTANCES,
        kernel: KernelName::Solid,
        ..PLAIN
    },
    Effect {
        name: "image_lights",
        more: "LightSource \"infinite\" \"string filename\" \"sky.pfm\"",
        ..PLAIN
    },
    Effect {
        name: "many_lights",
        more: "LightSource \"point\" \"rgb I\" [ .2 .2 .2 ] \"point3 from\" [ .5 -.5 1.5 ]\n\
               LightSource \"point\" \"rgb I\" [ .1 .2 .2 ] \"point3 from\" [ -.5 -.5 1.5 ]",
        ..PLAIN
    },
    Effect {
        name: "other shapes",
        more: "AttributeBegin\nTranslate -.5 -.5 .3\nShape \"sphere\" \"float radius\" .2\nAttributeEnd",
        calls: Calls::SHAPES,
        kernel: KernelName::Solid,
        ..PLAIN
    },
];

impl Effect {
    /// The scene's text; its images stand where [`images`] puts them.
    pub(crate) fn text(&self, frame: Frame) -> String {
        let Self { floor, of_floor, ball, more, .. } = self;
        let view = format!("LookAt 0 -3.9 1  0 0 1  0 0 1\n{}", self.camera);
        format!(
            "{}AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ 14 12 9 ]\n\
             Shape \"trianglemesh\" \"point3 P\" [ -.35 .35 1.99  .35 .35 1.99  .35 -.35 1.99  -.35 -.35 1.99 ] \
             \"integer indices\" [ 0 1 2 0 2 3 ]\nAttributeEnd\n\
             AttributeBegin\n{floor}\n\
             Shape \"trianglemesh\" \"point3 P\" [ -1 -1 0  1 -1 0  1 1 0  -1 1 0 ] \"integer indices\" [ 0 1 2 0 2 3 ] \
             \"point2 uv\" [ 0 0 1 0 1 1 0 1 ] {of_floor}\nAttributeEnd\n\
             {WHITE}\n\
             Shape \"trianglemesh\" \"point3 P\" [ -1 -1 0  1 -1 0  1 1 0  -1 1 0  -1 -1 2  1 -1 2  1 1 2  -1 1 2 ] \
             \"integer indices\" [ 4 5 6 4 6 7 3 2 6 3 6 7 0 3 7 0 7 4 1 2 6 1 6 5 ]\n\
             AttributeBegin\n{ball}\nTranslate .3 0 .4\nScale .4 .4 .4\nShape \"trianglemesh\" {}\nAttributeEnd\n{more}\n",
            head(&view, frame),
            icosphere(3)
        )
    }
}

/// The images that [`SCENES`] name.
pub(crate) fn images(folder: &Path) {
    let mut image = Image::new(8, 8);
    for (i, p) in image.pixels.iter_mut().enumerate() {
        *p = [0.2, 0.3, 0.2 + 0.1 * (i % 5) as f32];
    }
    for name in ["sky.pfm", "texture.png"] {
        write_image(&folder.join(name), &image, &[]).expect("writable");
    }
}

fn forcing(names: &[&str], settings: &RenderSettings) -> RenderSettings {
    let force_effects = names.iter().map(|n| (*n).to_owned()).collect();
    RenderSettings { force_effects, ..settings.clone() }
}

/// Renders with the scene's own kernel and with all effects forced, and holds one against the other.
fn same_from_both(scene: &SceneDescription, settings: &RenderSettings, what: &str) -> Outcome {
    let own = render(scene, settings);
    let general = render(scene, &forcing(&["all"], settings));
    assert_eq!(general.stats.plan.kernel, "general", "{what}");
    assert!(
        bits(&own.image) == bits(&general.image),
        "{what}: {} draws another picture",
        own.stats.plan.kernel
    );
    own
}

const BACKENDS: [Backend; 2] = [Backend::Embree, Backend::Native];
const FRAME: Frame = Frame { size: (16, 12), spp: 4, max_depth: 4 };

#[test]
fn each_scene_gets_the_kernel_that_has_its_effects() {
    let folder = tempfile::tempdir().expect("a folder");
    images(folder.path());
    for effect in &SCENES {
        let scene = scene_beside(&effect.text(FRAME), folder.path());
        for backend in BACKENDS {
            for schedule in [Schedule::Depth, Schedule::Sorted] {
                let what = format!("{}, {backend:?}, {schedule:?}", effect.name);
                let settings = RenderSettings { backend, schedule, ..RenderSettings::default() };
                let own = same_from_both(&scene, &settings, &what);
                assert_eq!(own.stats.plan.kernel, effect.kernel.name(), "{what}");
                assert!(effect.kernel.has().has(effect.calls), "{what}");
                let planned = plan(&scene, &settings).unwrap_or_else(|e| panic!("{what}: {e}"));
                let told = &own.stats.plan;
                assert_eq!((&planned.kernel, &planned.calls), (&told.kernel, &told.calls), "{what}");
                assert!(bits(&own.image).iter().any(|p| *p != [0; 3]), "{what}: a black picture");
            }
        }
    }
}

#[test]
fn every_kernel_between_gives_the_same_picture_too() {
    let folder = tempfile::tempdir().expect("a folder");
    images(folder.path());
    for effect in &SCENES {
        let scene = scene_beside(&effect.text(FRAME), folder.path());
        let own = render(&scene, &RenderSettings::default());
        let mut ran = vec![own.stats.plan.kernel.clone()];
        for names in [&["rough_lobes"][..], &["textures"], &["ray_differentials", "many_lights"], &["media"]]
        {
            let forced = render(&scene, &forcing(names, &RenderSettings::default()));
            let kernel = forced.stats.plan.kernel.clone();
            assert!(bits(&own.image) == bits(&forced.image), "{}: {kernel}, for {names:?}", effect.name);
            ran.push(kernel);
        }
        // From the scene's own on, all have run.
        ran.dedup();
        let wanted = KernelName::ALL.into_iter().skip_while(|k| *k != effect.kernel).map(KernelName::name);
        assert_eq!(ran, wanted.collect::<Vec<_>>(), "{}", effect.name);
    }
}

#[test]
fn the_scenes_of_the_house_and_of_others_look_the_same_from_every_kernel() {
    let house = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut scenes = vec![house.join("demo/demo.pbrt")];
    for name in ["cornell", "furnace", "instances", "materials", "textures"] {
        scenes.push(house.join(name).with_extension("pbrt"));
    }
    scenes.extend(shared_scenes().into_iter().map(|(_, path)| path));
    for path in scenes {
        let scene = scene::load(&path).unwrap_or_else(|e| panic!("{e}"));
        for (backend, schedule) in [(Backend::Embree, Schedule::Depth), (Backend::Native, Schedule::Sorted)] {
            let settings = RenderSettings {
                backend,
                schedule,
                size: Some((24, 16)),
                spp: Some(2),
                ..RenderSettings::default()
            };
            let what = format!("{}, {backend:?}, {schedule:?}", path.display());
            let own = same_from_both(&scene, &settings, &what);
            let planned = plan(&scene, &settings).unwrap_or_else(|e| panic!("{what}: {e}"));
            let told = &own.stats.plan;
            assert_eq!((&planned.kernel, &planned.calls), (&told.kernel, &told.calls), "{what}");
        }
    }
}

#[test]
fn rays_that_wait_bring_the_same_from_every_kernel() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = everything(folder.path());
    for backend in BACKENDS {
        let settings = RenderSettings { backend, spp: Some(4), ..RenderSettings::default() };
        assert_eq!(same_from_both(&scene, &settings, "everything").stats.plan.kernel, "general");
    }
    let at = folder.path().join("city");
    let city = make(Kind::City, 30_000, &at);
    let base = settings(&at);
    let budget = least(&city, &base);
    let voxel = RenderSettings {
        schedule: Schedule::Voxel,
        geometry_memory: Some(budget),
        voxels: Some(30),
        ray_memory: Some(64 << 20),
        ..base
    };
    let own = same_from_both(&city, &voxel, "a city in pages");
    assert_eq!(own.stats.scheduler.name, "voxel");
    let general = render(&city, &forcing(&["media"], &voxel));
    assert!(bits(&own.image) == bits(&general.image));
    assert_ne!(own.stats.plan.kernel, "general");
}
