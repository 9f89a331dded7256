//! Pictures that must be flat or black, on the series of world offsets and scales: shadow acne and light leaks, counted
//! in samples.
//!
//! Invariant: one sample a pixel and a box filter, so that a pixel is a sample; no roulette. What a sample must be is
//! known before anything is rendered.

use super::leaving::{CUBE, centre, place_name, places, shapes};
use super::{Effort, Row, Table, Tracer};
use crate::support::{Frame, head, outcome, scene};
use glam::DVec3;
use weir::film::Image;
use weir::settings::{Estimator, RenderSettings};

/// A camera at `eye`, in units of the scale around the centre.
fn camera((offset, scale): (f64, f64), eye: DVec3, at: DVec3, kind: &str) -> String {
    let c = centre(offset);
    let (e, a) = (c + eye * scale, c + at * scale);
    format!("LookAt {} {} {}  {} {} {}  0 1 0\nCamera {kind}", e.x, e.y, e.z, a.x, a.y, a.z)
}

/// `text` in units of the scale around the centre.
fn placed((offset, scale): (f64, f64), text: &str) -> String {
    let c = centre(offset);
    format!(
        "AttributeBegin\nTranslate {} {} {}\nScale {scale} {scale} {scale}\n{text}AttributeEnd\n",
        c.x, c.y, c.z
    )
}

/// As [`placed`], as an object and its instance.
fn instanced(place: (f64, f64), text: &str) -> String {
    let object = format!("ObjectBegin \"o\"\nAttributeBegin\n{text}AttributeEnd\nObjectEnd\n");
    object + &placed(place, "ObjectInstance \"o\"\n")
}

fn render(text: &str, tracer: Tracer, estimator: Estimator, seed: u64) -> Image {
    let settings = RenderSettings { estimator, roulette: Some(false), seed: Some(seed), ..tracer.settings() };
    let outcome = outcome(&scene(text), &settings).unwrap_or_else(|e| panic!("{e}\n{text}"));
    assert_eq!(outcome.stats.image.non_finite_samples, 0, "{text}");
    outcome.image
}

/// Counts in `row` the pixels of which `wrong` says so.
fn judge(row: &mut Row, image: &Image, what: &str, wrong: impl Fn(f32) -> bool) {
    for (i, p) in image.pixels.iter().enumerate() {
        row.count(wrong(p[0]), || format!("{what}: pixel {i} is {}", p[0]));
    }
}

/// Offsets of the series; each row of the table is one, with all its scales.
const OFFSETS: [f64; 4] = [0.0, 1e3, 1e5, 1e7];

/// **What must hold.** A convex body that reflects one half, under a sky of 1, is one half or (beside it) 1 in every
/// sample: no path meets the body twice.
///
/// **Why.** See `leaving::acne_and_leaks`; and a convex body has nothing else to meet. (Rounding at 1e7 folds its
/// flat faces by 1e-3 at most, which cosine-weighted paths see with a probability of its square.) A sample is
/// one half times the sky's 1, in fewer than 16 roundings.
pub(super) fn acne(effort: Effort) -> Table {
    let mut table = Table::default();
    let side = effort.of(16, 128) as u32;
    for (name, text) in shapes().into_iter().filter(|(name, _)| !name.contains("thin")) {
        for tracer in Tracer::ALL {
            for offset in OFFSETS {
                let mut row = Row::new(format!("samples with acne, at {offset:e}"), tracer, 0.0, false);
                for place in places().into_iter().filter(|p| p.0 == offset) {
                    for (seed, placed) in [placed(place, &text), instanced(place, &text)].iter().enumerate() {
                        let frame = Frame { size: (side, side), spp: 1, max_depth: 4 };
                        let eye = DVec3::new(0.9, 1.9, -2.4);
                        let camera = camera(place, eye, DVec3::ZERO, "\"perspective\" \"float fov\" 50");
                        let text = head(&camera, frame)
                            + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n\
                               Material \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\n"
                            + placed;
                        let image = render(&text, tracer, Estimator::Scattering, seed as u64);
                        judge(&mut row, &image, &format!("{name} {}", place_name(place)), |v| {
                            v < 0.5 - 16.0 * f32::EPSILON
                        });
                        assert!(image.pixels.iter().any(|p| p[0] < 0.6), "nothing is seen:\n{text}");
                    }
                }
                table.extend([row]);
            }
        }
    }
    table
}

/// A floor, from −1 to 1 in x and y, facing −z, where the camera is.
const FLOORS: [(&str, &str); 4] = [
    (
        "quad",
        "Shape \"trianglemesh\" \"point3 P\" [ -1 -1 0  -1 1 0  1 1 0  1 -1 0 ] \"integer indices\" [ 0 1 2 0 2 3 ]\n",
    ),
    (
        "far quad",
        "Shape \"trianglemesh\" \"point3 P\" [ -1000 -1000 0  -1000 1000 0  1000 1000 0  1000 -1000 0 ] \
         \"integer indices\" [ 0 1 2 0 2 3 ]\n",
    ),
    ("disk", "Shape \"disk\" \"float radius\" 3\n"),
    ("patch", "Shape \"bilinearmesh\" \"point3 P\" [ -1 -1 0  -1 1 0  1 -1 0  1 1 0 ]\n"),
];

/// Lights above such a floor, at unit scale; `@` is where the place goes.
fn lights() -> Vec<(&'static str, String)> {
    let distant = |degrees: f64| {
        let (s, c) = degrees.to_radians().sin_cos();
        format!("LightSource \"distant\" \"point3 from\" [ {} 0 {} ] \"point3 to\" [ 0 0 0 ]\n", c, -s)
    };
    vec![
        ("distant light, overhead", distant(90.0)),
        ("distant light, at 5°", distant(5.0)),
        ("distant light, at 0.1°", distant(0.1)),
        ("point light", "LightSource \"point\" \"point3 from\" [ .3 .2 -.01 ]\n".to_owned()),
        (
            "lamp of two triangles",
            "AreaLightSource \"diffuse\"\nShape \"trianglemesh\" \"point3 P\" [ -1 -1 -.5  1 -1 -.5  1 1 -.5  -1 1 -.5 ] \
             \"integer indices\" [ 0 1 2 0 2 3 ]\n"
                .to_owned(),
        ),
        (
            "lamp of a sphere",
            "AreaLightSource \"diffuse\"\nTranslate 0 0 -.8\nShape \"sphere\" \"float radius\" .25\n".to_owned(),
        ),
    ]
}

/// **What must hold.** A light above a bare floor lights every sample of it: none is black.
///
/// **Why.** The floor lies along axes, so that rounding does not tilt it; the shadow ray starts above it
/// (`leaving::acne_and_leaks`) and goes up, to a light that ends it before its own surface by that point's
/// bound. The lamps lie wholly above the floor.
pub(super) fn shadows(effort: Effort) -> Table {
    let mut table = Table::default();
    let side = effort.of(8, 96) as u32;
    for (light, light_text) in lights() {
        for tracer in Tracer::ALL {
            for offset in OFFSETS {
                let mut row = Row::new(format!("samples in false shadow, at {offset:e}"), tracer, 0.0, false);
                for place in places().into_iter().filter(|p| p.0 == offset) {
                    for (name, floor) in FLOORS {
                        let frame = Frame { size: (side, side), spp: 1, max_depth: 1 };
                        // Between the floor and whatever shines.
                        let eye = DVec3::new(0.0, 0.0, -0.4);
                        let window = 0.9 * place.1;
                        let kind = format!(
                            "\"orthographic\" \"float screenwindow\" [ {} {window} {} {window} ]",
                            -window, -window
                        );
                        let material = "Material \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\n";
                        let text = head(&camera(place, eye, DVec3::ZERO, &kind), frame)
                            + material
                            + &placed(place, &light_text)
                            + &placed(place, floor);
                        let image = render(&text, tracer, Estimator::Lights, 0);
                        judge(&mut row, &image, &format!("{light}, {name} {}", place_name(place)), |v| {
                            v <= 0.0
                        });
                    }
                }
                table.extend([row]);
            }
        }
    }
    table
}

/// **What must hold.** Closed rooms without a lamp under a sky are black within.
///
/// **Why.** `leaving::acne_and_leaks`: a ray from inside meets a wall, and a moved origin stays inside unless its point is
/// within X = 2√3·error of another wall (there). Of a mesh of area A whose edges are L long in all, such points
/// are 2·L·X/A at most: 2·X/s of a cube of half side s, 23·X/s of a sphere of 320 triangles, none of a round sphere.
/// With the error of `geometry/point.rs` and 6 vertices a sample, that is how many samples may leak in the mean;
/// the bound lies six standard deviations above.
pub(super) fn leaks(effort: Effort) -> Table {
    let mut table = Table::default();
    let side = effort.of(16, 192) as u32;
    let rooms =
        shapes().into_iter().filter(|(name, _)| !name.contains("thin") && !name.contains("ellipsoid"));
    for (name, text) in rooms {
        for tracer in Tracer::ALL {
            for offset in OFFSETS {
                let (edges, u) = (edges_of(name), f64::from(f32::EPSILON / 2.0));
                let mut expected = 0.0;
                let mut row = Row::new(format!("samples with leaks, at {offset:e}"), tracer, 0.0, false);
                for place in places().into_iter().filter(|p| p.0 == offset) {
                    for (seed, placed) in [placed(place, &text), instanced(place, &text)].iter().enumerate() {
                        let frame = Frame { size: (side, side), spp: 1, max_depth: 6 };
                        let (eye, at) = (DVec3::new(0.1, -0.2, 0.15), DVec3::new(0.3, 0.25, 0.5));
                        let text = head(&camera(place, eye, at, "\"perspective\" \"float fov\" 100"), frame)
                            + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n\
                               Material \"diffuse\" \"rgb reflectance\" [ .9 .9 .9 ]\n"
                            + placed;
                        let image = render(&text, tracer, Estimator::Both, seed as u64);
                        judge(&mut row, &image, &format!("{name} {}", place_name(place)), |v| v != 0.0);
                        let magnitude = centre(offset).abs().max_element() / place.1 + 1.0;
                        let error = (8.0 * magnitude + 10.0 * 2.0) * u;
                        expected += f64::from(side * side * 6) * edges * 2.0 * 3f64.sqrt() * error;
                    }
                }
                row.bound = row.bound.map(|_| (expected + 6.0 * expected.sqrt()).floor());
                table.extend([row]);
            }
        }
    }
    table
}

/// Twice the length of all edges over the area, at unit scale.
fn edges_of(name: &str) -> f64 {
    match name {
        "cube" | "cube, turned" => 2.0,
        "sphere of 320 triangles" => 23.0,
        "sphere" => 0.0,
        _ => unreachable!("a room that has not been measured"),
    }
}

#[test]
fn pictures_have_no_acne() {
    acne(Effort::Quick).assert_holds();
}

#[test]
fn lights_leave_no_false_shadows() {
    shadows(Effort::Quick).assert_holds();
}

#[test]
fn closed_rooms_are_black() {
    leaks(Effort::Quick).assert_holds();
}

/// The test above must be able to fail.
#[test]
fn a_room_with_a_hole_is_not_black() {
    let place = (1e3, 1.0);
    let open = CUBE.replace("[ 0 2 1  1 2 3 ", "[ 0 2 1 ");
    assert!(open != CUBE);
    let frame = Frame { size: (16, 16), spp: 1, max_depth: 6 };
    let camera = camera(place, DVec3::ZERO, DVec3::X, "\"perspective\" \"float fov\" 100");
    let text = head(&camera, frame)
        + "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\nMaterial \"diffuse\" \"rgb reflectance\" [ .9 .9 .9 ]\n"
        + &placed(place, &open);
    let image = render(&text, Tracer::Native, Estimator::Both, 0);
    assert!(image.pixels.iter().filter(|p| p[0] != 0.0).count() > 50);
}
