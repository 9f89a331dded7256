//! Many surfaces in one place: identical triangles, coplanar decals, touching glass, lamps on surfaces, and a camera inside
//! what it looks at.
//!
//! Invariant: what a sample must be is known before anything is rendered.

use super::leaving::CUBE;
use super::meeting::Soup;
use super::{Effort, Row, Table, Tracer};
use crate::support::{Frame, head, outcome, scene};
use glam::DVec3;
use std::time::Instant;
use weir::accel::{NONE, Ray};
use weir::film::Image;
use weir::settings::{Estimator, RenderSettings};

/// Half a unit in the last place of one.
pub(super) const U: f64 = (f32::EPSILON / 2.0) as f64;

/// Renders without roulette; no sample may be lost.
pub(super) fn render(text: &str, tracer: Tracer, estimator: Estimator) -> Image {
    let settings = RenderSettings { estimator, roulette: Some(false), ..tracer.settings() };
    let outcome = outcome(&scene(text), &settings).unwrap_or_else(|e| panic!("{e}\n{text}"));
    assert_eq!(outcome.stats.image.non_finite_samples, 0, "{text}");
    outcome.image
}

/// Measures how far all channels are from `expected`, relative to it.
pub(super) fn flat(row: &mut Row, image: &Image, expected: f64, what: &str) {
    for (i, p) in image.pixels.iter().enumerate() {
        let far = p.iter().map(|&c| (f64::from(c) - expected).abs()).fold(0.0, f64::max);
        row.measure(far / expected, || format!("{what}: pixel {i} is {p:?}, not {expected}"));
    }
}

/// **What must hold.** 1e5 triangles in one place are built and asked within seconds (20 for all rays here; a tree that does
/// not end at what it cannot part would need hours), and the native answer is always the first of them.
///
/// **Why.** Equal triangles give equal distances, and of hits at one distance the smallest name counts.
fn identical(effort: Effort) -> Table {
    let mut table = Table::default();
    let t = [DVec3::ZERO, DVec3::new(1.0, 0.2, 0.1), DVec3::new(0.3, 1.0, -0.2)];
    let soup = Soup::new(&vec![t; 100_000]);
    for tracer in Tracer::ALL {
        let mut names =
            Row::new("1e5 identical triangles: answers that are not the first", tracer, 0.0, false);
        let mut seconds = Row::new("1e5 identical triangles: seconds", tracer, 20.0, true);
        let start = Instant::now();
        let accel = soup.build(tracer);
        for i in 0..effort.of(40, 1000) {
            let (s, c) = (i as f64 * 0.1).sin_cos();
            let to = t[0] * 0.3 + t[1] * (0.3 + 0.1 * s) + t[2] * (0.3 - 0.1 * s);
            let from = DVec3::new(s, c, 2.0).as_vec3();
            let ray = Ray::new(from, (to - from.as_dvec3()).as_vec3());
            let hit = accel.closest(&ray);
            names.count(hit.primitive != 0 || hit.geometry == NONE || !accel.occluded(&ray), || {
                format!("{ray:?}: {hit:?}")
            });
        }
        seconds.measure(start.elapsed().as_secs_f64(), String::new);
        table.extend([names, seconds]);
    }
    table
}

const SQUARE: &str = "Shape \"trianglemesh\" \"point3 P\" [ -1 -1 0  -1 1 0  1 1 0  1 -1 0 ] \"integer indices\" [ 0 1 2 0 2 3 ]\n";
const SKY: &str = "LightSource \"infinite\" \"rgb L\" [ 1 1 1 ]\n";

fn slanted(side: u32, spp: u32, depth: u32) -> String {
    let frame = Frame { size: (side, side), spp, max_depth: depth };
    head("LookAt .3 -1.1 -1.9  .1 .05 0  0 1 0\nCamera \"perspective\" \"float fov\" 30", frame)
}

/// **What must hold.** A decal, which is its ground again in another colour, is hidden by it in every sample: the picture is
/// that of the ground alone, bit for bit. A lamp given before the floor in which it lies is 1 in every sample.
///
/// **Why.** As above, the first of equals counts; a lamp in its own plane lights nothing.
fn decals(effort: Effort) -> Table {
    let mut table = Table::default();
    let side = effort.of(24, 256) as u32;
    for tracer in Tracer::ALL {
        for turn in ["", "Rotate 17 .3 1 .2\n"] {
            let where_ = if turn.is_empty() { "along axes" } else { "turned" };
            let mut row =
                Row::new(format!("samples in which a decal fights its ground, {where_}"), tracer, 0.0, false);
            let ground = slanted(side, 1, 2)
                + SKY
                + turn
                + "Material \"diffuse\" \"rgb reflectance\" [ .5 .5 .5 ]\n"
                + SQUARE;
            let decal = ground.clone() + "Material \"diffuse\" \"rgb reflectance\" [ .1 .5 .9 ]\n" + SQUARE;
            let images = [&ground, &decal].map(|text| render(text, tracer, Estimator::Scattering));
            for (i, (a, b)) in images[0].pixels.iter().zip(&images[1].pixels).enumerate() {
                row.count(a.map(f32::to_bits) != b.map(f32::to_bits), || format!("pixel {i}: {a:?}, {b:?}"));
            }
            table.extend([row]);
            let mut row =
                Row::new(format!("error of a lamp in its floor, {where_}"), tracer, 16.0 * U, false);
            let text = slanted(side, 1, 2)
                + turn
                + "AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [ 1 1 1 ] \"bool twosided\" true\n"
                + SQUARE
                + "AttributeEnd\n"
                + SQUARE;
            let image = render(&text, tracer, Estimator::Both);
            // Beside the lamp there is nothing.
            let lit: Vec<[f32; 3]> = image.pixels.iter().copied().filter(|p| p[0] > 0.0).collect();
            assert!(lit.len() > image.pixels.len() / 2, "the lamp is not seen");
            flat(&mut row, &Image { width: lit.len() as u32, height: 1, pixels: lit, ..image }, 1.0, "lamp");
            table.extend([row]);
        }
    }
    table
}

/// **What must hold.** Glass bodies that neither absorb nor emit are not seen under a sky of 1: with a gap between them of more
/// than twice what origins are moved (1e-5 here, of 7e-6), within 1024 roundings of a path's 64 vertices. From
/// inside glass the sky is η² = 2.25 in every sample.
///
/// **Why.** Every path carries its weight of 1 to the sky, times η² when it leaves glass and 1/η² when it enters. Where two
/// faces lie in one place, the origin that is moved off the first is past the second, and a path leaves what it never
/// entered: no moved origin can tell. So what touches exactly is counted, and its error is η² − 1 for each such face.
fn glass(effort: Effort) -> Table {
    let mut table = Table::default();
    let side = effort.of(16, 128) as u32;
    let glass = "Material \"dielectric\" \"float eta\" 1.5\n";
    for tracer in Tracer::ALL {
        for (name, gap, bound) in [("a gap of 1e-5", 1e-5, Some(1024.0 * U)), ("no gap", 0.0, None)] {
            let mut row = Row::new(format!("error of two glass cubes with {name}"), tracer, 0.0, false);
            row.bound = row.bound.and(bound);
            let frame = Frame { size: (side, side), spp: 1, max_depth: 64 };
            let text = head("LookAt .7 1.3 -5  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" 40", frame)
                + SKY
                + glass
                + &format!(
                    "AttributeBegin\nTranslate {} 0 0\nScale .5 .5 .5\n{CUBE}AttributeEnd\n",
                    0.5 + gap
                )
                + &format!("AttributeBegin\nTranslate -.5 0 0\nScale .5 .5 .5\n{CUBE}AttributeEnd\n");
            flat(&mut row, &render(&text, tracer, Estimator::Scattering), 1.0, name);
            table.extend([row]);
        }
        let mut row = Row::new("error of the sky from inside glass", tracer, 1024.0 * U, false);
        let frame = Frame { size: (side, side), spp: 4, max_depth: 64 };
        let inside = head("LookAt .1 .2 .1  1 .3 .2  0 1 0\nCamera \"perspective\" \"float fov\" 100", frame)
            + SKY
            + glass;
        flat(
            &mut row,
            &render(&(inside + "Shape \"sphere\"\n"), tracer, Estimator::Scattering),
            2.25,
            "inside",
        );
        table.extend([row]);
    }
    table
}

pub(super) fn all(effort: Effort) -> Table {
    let mut table = identical(effort);
    table.extend(decals(effort).0);
    table.extend(glass(effort).0);
    table
}

#[test]
fn many_surfaces_in_one_place() {
    all(Effort::Quick).assert_holds();
}

/// The tests above must be able to fail: of a decal a unit in the last place above its ground some is seen, and glass
/// that is left without having been entered is.
#[test]
fn a_decal_in_front_and_glass_without_a_face_are_found() {
    let above = SQUARE.replace(" 0  -1 1 0  1 1 0  1 -1 0 ]", " -1e-3  -1 1 -1e-3  1 1 -1e-3  1 -1 -1e-3 ]");
    assert!(above != SQUARE);
    let ground = slanted(16, 1, 2) + SKY + SQUARE;
    let decal = ground.clone() + "Material \"diffuse\" \"rgb reflectance\" [ .1 .5 .9 ]\n" + &above;
    let [a, b] = [&ground, &decal].map(|text| render(text, Tracer::Native, Estimator::Scattering));
    assert!(a.pixels.iter().zip(&b.pixels).filter(|(a, b)| a != b).count() > 100);
    let mut row = Row::new("x", Tracer::Native, 1024.0 * U, true);
    let frame = Frame { size: (8, 8), spp: 1, max_depth: 64 };
    let open = head("LookAt 0 0 -5  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" 10", frame)
        + SKY
        + "Material \"dielectric\" \"float eta\" 1.5\nTranslate 0 0 1\nReverseOrientation\n"
        + SQUARE;
    flat(&mut row, &render(&open, Tracer::Native, Estimator::Scattering), 1.0, "open");
    assert!(row.worst > 0.5);
}
