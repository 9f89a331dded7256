//! Instances against the same geometry flattened: sheared, mirrored, stretched, nested.
//!
//! Invariant: corners are multiples of 1/64 and transforms have few bits, so that flattening rounds nothing: both are
//! exactly the same shapes.

use super::meeting::{Soup, rows};
use super::{Effort, Row, Table, Tracer};
use crate::closed::{Nothing, Random, point_of};
use glam::{DMat3, DVec3, Vec3};
use weir::accel::{Accel, InstanceOf, NONE, Ray};
use weir::scene::pbrt::parse_str;
use weir::study::compare::{Held, Shapes, hold};

/// Name, and what is done one after the other, the innermost last.
fn transforms() -> Vec<(&'static str, Vec<DMat3>)> {
    let scale = |x, y, z| DMat3::from_diagonal(DVec3::new(x, y, z));
    let shear = DMat3::from_cols(DVec3::X, DVec3::new(3.0, 1.0, 0.0), DVec3::new(-1.0, 2.0, 1.0));
    let turn = DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X);
    vec![
        ("mirrored", vec![scale(-1.0, 1.0, 1.0)]),
        ("mirrored twice, scaled by 64", vec![scale(-64.0, 64.0, -64.0)]),
        ("turned", vec![turn]),
        ("stretched by 1/64 and 64", vec![scale(1.0 / 64.0, 1.0, 64.0)]),
        ("sheared", vec![shear]),
        ("sheared, mirrored, turned, nested three deep", vec![shear, turn, scale(-1.0, 1.0, 0.5), shear]),
    ]
}

/// Triangles whose corners are multiples of 1/64.
fn grid(count: usize, random: &mut Random) -> Vec<[DVec3; 3]> {
    let mut at = || (random.point() * 64.0).round() / 64.0;
    (0..count).map(|_| [at(), at(), at()]).collect()
}

/// **What must hold.** Every answer through an instance is one that the exact meeting allows, as in `meeting::soups`; and so
/// is every answer of the flattened soup, to the same rays. Where the transform only mirrors and scales by powers
/// of two, both are the same to the bit.
///
/// **Why.** `study/compare/bounds.rs` adds to a meeting's bound what the ray's way into the object rounds: for the native
/// inverse, γ₄ of the sizes and one unit of each element. Signs and powers of two round nothing on that way, and
/// `rays::odd_rays` holds for the rest.
pub(super) fn flattened(effort: Effort) -> Table {
    let mut table = Table::default();
    let (rounds, rays) = (effort.of(2, 30), effort.of(150, 2000));
    for (name, parts) in transforms() {
        let m = parts.iter().fold(DMat3::IDENTITY, |all, part| all * *part);
        let exact = name.starts_with("mirrored");
        let mut held = [(); 4].map(|()| Held::default());
        let mut changed =
            Tracer::ALL.map(|t| Row::new(format!("answers that flattening changes: {name}"), t, 0.0, false));
        for round in 0..rounds {
            let mut random = Random(round as u64 * 31 + 5);
            let triangles = grid(64, &mut random);
            let at = if exact { DVec3::ZERO } else { (random.point() * 1024.0).round() };
            let own = Soup::new(&triangles);
            let flat: Vec<[DVec3; 3]> = triangles.iter().map(|t| t.map(|p| m * p + at)).collect();
            let flat = Soup::new(&flat);
            let transform = InstanceOf { object: 0, transform: columns(m, at) };
            let rays: Vec<Ray> = (0..rays).map(|i| aimed(&flat, i, &mut random)).collect();
            let objects = [vec![own.geometry()]];
            let build = |tracer: Tracer| {
                tracer.builder().build(&[], &objects, &[transform], &Nothing, None).expect("few triangles")
            };
            let placed = Tracer::ALL.map(build);
            let in_world = Tracer::ALL.map(|tracer| flat.build(tracer));
            for robust in 0..2 {
                let ground = |instanced: bool| Shapes {
                    world: if instanced { Vec::new() } else { vec![flat.geometry()] },
                    objects: if instanced { objects.to_vec() } else { Vec::new() },
                    instances: if instanced { vec![transform] } else { Vec::new() },
                    custom: &Nothing,
                };
                let of = |all: &[Box<dyn Accel + '_>; 3]| {
                    let pair: [&dyn Accel; 2] = [&*all[0], &*all[1 + robust]];
                    hold(&ground(std::ptr::eq(all, &placed)), pair, robust == 1, &rays)
                };
                held[robust].join(of(&placed));
                held[2 + robust].join(of(&in_world));
            }
            if exact {
                for (row, (a, b)) in changed.iter_mut().zip(placed.iter().zip(&in_world)) {
                    for ray in &rays {
                        let (mut hit, other) = (a.closest(ray), b.closest(ray));
                        hit.instance = NONE;
                        let key = |h: &weir::accel::Hit| (h.t.to_bits(), h.geometry, h.primitive);
                        row.count(key(&hit) != key(&other), || format!("{ray:?}: {hit:?}, flat {other:?}"));
                    }
                }
            }
        }
        let [placed, placed_robust, flat, flat_robust] = &held;
        for (what, embree, robust) in [
            (format!("instance, {name}"), placed, placed_robust),
            ("flattened, all of them".to_owned(), flat, flat_robust),
        ] {
            table.extend(rows(&what, Tracer::Native, embree, 0));
            table.extend(rows(&what, Tracer::Embree, embree, 1));
            table.extend(rows(&what, Tracer::Robust, robust, 1));
        }
        table.extend(changed.into_iter().filter(|_| exact));
    }
    table
}

fn columns(m: DMat3, at: DVec3) -> [f32; 12] {
    let mut transform = [0.0; 12];
    for (out, column) in transform.chunks_exact_mut(3).zip([m.x_axis, m.y_axis, m.z_axis, at]) {
        out.copy_from_slice(&column.as_vec3().to_array());
    }
    transform
}

/// At corners, edges and faces, some along axes.
fn aimed(soup: &Soup, i: usize, random: &mut Random) -> Ray {
    let corners = soup.indices[random.below(soup.indices.len())];
    let corners = corners.map(|v| Vec3::from(soup.positions[v as usize]).as_dvec3());
    let to = point_of(corners, random, i % 3);
    let mut d = random.point() * (corners[1] - corners[0]).length().max(1.0);
    if i.is_multiple_of(5) {
        d[i % 3] = 0.0;
    }
    let origin = (to - d).as_vec3();
    let d = (to - origin.as_dvec3()).as_vec3();
    Ray::new(origin, if d == Vec3::ZERO { Vec3::X } else { d })
}

#[test]
fn instances_answer_as_what_is_flattened() {
    flattened(Effort::Quick).assert_holds();
}

/// pbrt has no instances of instances: one line says so, rather than that they vanish.
#[test]
fn an_instance_inside_an_object_is_refused() {
    let text = "WorldBegin\nObjectBegin \"a\"\nShape \"sphere\"\nObjectEnd\n\
                ObjectBegin \"b\"\nObjectInstance \"a\"\nObjectEnd\nObjectInstance \"b\"\n";
    let error = parse_str(text, std::path::Path::new("a.pbrt")).expect_err("refused").to_string();
    assert!(error.contains("ObjectInstance inside an object") && !error.contains('\n'), "{error}");
}

/// The test above must be able to fail: an instance a ten-thousandth beside its place.
#[test]
fn a_moved_instance_is_found() {
    let mut random = Random(3);
    let own = Soup::new(&grid(64, &mut random));
    let objects = [vec![own.geometry()]];
    let at = |x: f64| InstanceOf { object: 0, transform: columns(DMat3::IDENTITY, DVec3::X * x) };
    let build = |tracer: Tracer| {
        tracer.builder().build(&[], &objects, &[at(0.0)], &Nothing, None).expect("few triangles")
    };
    let (native, embree) = (build(Tracer::Native), build(Tracer::Embree));
    let rays: Vec<Ray> = (0..500).map(|i| aimed(&own, i, &mut random)).collect();
    let ground =
        Shapes { world: Vec::new(), objects: objects.to_vec(), instances: vec![at(1e-4)], custom: &Nothing };
    let held = hold(&ground, [&*native, &*embree], false, &rays);
    assert!(held.faults[0] > 100 && held.faults[1] > 100, "{held:?}");
}
