//! Rays that are no rays, and rays of which something is known exactly.
//!
//! Invariant: what is compared is compared bit for bit.

use super::leaving::direction;
use super::meeting::{Soup, soup};
use super::{Effort, Row, Table, Tracer};
use crate::closed::{Random, point_of};
use glam::{DVec3, Vec3};
use weir::accel::{Accel, Hit, NONE, Ray};

const ODD: [f32; 16] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    1e30,
    -1e30,
    1e19,
    -1e19,
    0.0,
    -0.0,
    1e-30,
    f32::MIN_POSITIVE,
    1e-40,
    -1e-45,
    1.0,
];

/// Triangles good and bad: what is not finite must not keep rays from the others.
fn mixed(random: &mut Random) -> Soup {
    let mut soup = soup(0, 64, 1.0, DVec3::ZERO, random);
    for (i, p) in soup.positions.iter_mut().enumerate() {
        if i % 9 == 4 {
            p[i % 3] = ODD[i / 9 % 9];
        }
    }
    soup
}

/// **What must hold.** A ray with numbers of every kind, over triangles with numbers of every kind, has an answer: a miss,
/// or a hit of a primitive that is there at a distance that is a number within the ray's interval. An empty interval,
/// or one whose ends are no numbers, is a miss, and nothing occludes in it.
///
/// **Why.** No bound is needed: comparisons with what is not a number are false, and answers are made of comparisons.
/// (Embree says of itself that such rays are undefined; it is counted.)
pub(super) fn bad_rays(effort: Effort) -> Table {
    let mut table = Table::default();
    let rays = effort.of(20_000, 1_000_000);
    for tracer in Tracer::ALL {
        let mut answers = Row::new("rays of odd numbers: answers that are none", tracer, 0.0, false);
        let mut empty = Row::new("rays of empty intervals: hits", tracer, 0.0, false);
        let mut random = Random(11);
        let soup = mixed(&mut random);
        let accel = soup.build(tracer);
        for _ in 0..rays {
            let mut numbers = [(); 6].map(|()| (2.0 * random.unit() - 1.0) as f32);
            let mut interval = [0.0, f32::INFINITY];
            for _ in 0..1 + random.below(3) {
                numbers[random.below(6)] = ODD[random.below(ODD.len())];
            }
            if random.unit() < 0.3 {
                interval[random.below(2)] = ODD[random.below(ODD.len())];
            }
            let [a, b, c, d, e, f] = numbers;
            let ray = Ray {
                origin: Vec3::new(a, b, c),
                direction: Vec3::new(d, e, f),
                t_min: interval[0],
                t_max: interval[1],
            };
            let (hit, occluded) = (accel.closest(&ray), accel.occluded(&ray));
            let named = hit.geometry == 0 && (hit.primitive as usize) < soup.indices.len();
            let good = hit.geometry == NONE || named && hit.t >= ray.t_min && hit.t <= ray.t_max;
            answers.count(!good, || format!("{ray:?}: {hit:?}"));
            // Not `<`: what is not a number is empty too.
            if !matches!(ray.t_min.partial_cmp(&ray.t_max), Some(std::cmp::Ordering::Less)) {
                empty.count(hit.geometry != NONE || occluded, || format!("{ray:?}: {hit:?}, {occluded}"));
            }
        }
        // Aimed at what is there.
        for _ in 0..rays {
            let ray = aimed(&soup, &mut random);
            if !(ray.origin.is_finite() && ray.direction.is_finite()) {
                continue;
            }
            let at = random.unit() as f32 * 3.0;
            for (t_min, t_max) in [
                (at, at),
                (at.next_up(), at),
                (0.0, 0.0),
                (0.0, -0.0),
                (f32::INFINITY, f32::INFINITY),
                (0.0, -1.0),
            ] {
                let ray = Ray { t_min, t_max, ..ray };
                let (hit, occluded) = (accel.closest(&ray), accel.occluded(&ray));
                empty.count(hit.geometry != NONE || occluded, || format!("{ray:?}: {hit:?}, {occluded}"));
            }
        }
        table.extend([answers, empty]);
    }
    table
}

fn aimed(soup: &Soup, random: &mut Random) -> Ray {
    let corners = soup.indices[random.below(soup.indices.len())];
    let corners = corners.map(|v| Vec3::from(soup.positions[v as usize]).as_dvec3());
    let aim = random.below(3);
    let to = point_of(corners, random, aim);
    let origin = to + direction(random) * (0.1 + 3.0 * random.unit());
    Ray::new(origin.as_vec3(), (to - origin).as_vec3())
}

/// All of a hit but its place; a distance is multiplied by `scale`.
fn bits(hit: &Hit, scale: f32) -> [u32; 6] {
    let t = if hit.geometry == NONE { hit.t } else { hit.t * scale };
    // Plus zero: the two zeros are one weight.
    let [u, v] = [hit.u + 0.0, hit.v + 0.0].map(f32::to_bits);
    [t.to_bits(), u, v, hit.geometry, hit.primitive, hit.instance]
}

/// Counts whether two answers are one, bit for bit.
fn same(row: &mut Row, [a, b]: [&dyn Accel; 2], [ray, other]: [&Ray; 2], scale: f32) {
    let hits = [bits(&a.closest(ray), 1.0), bits(&b.closest(other), scale)];
    let occluded = [a.occluded(ray), b.occluded(other)];
    row.count(hits[0] != hits[1] || occluded[0] != occluded[1], || {
        format!("{ray:?} {:?}, {other:?} {:?}, {occluded:?}", a.closest(ray), b.closest(other))
    });
}

/// **What must hold**, bit for bit:
/// - a direction 2ᵏ as long has the same hit at 2⁻ᵏ of the distance;
/// - a world and a ray 2ᵏ as large have the same hit at 2ᵏ of the distance, for k from −26 to 26 (1.5e-8 to 7e7);
/// - a mirrored world and ray have the same hit;
/// - −0 in a direction is 0.
///
/// **Why.** Multiplying by a power of two and turning a sign commute with rounding wherever nothing over- or
/// underflows: products of four such coordinates stay above 2⁻¹¹⁰ and below 2¹¹⁰. Zeros of both signs compare equal;
/// which face of a box they enter through differs, and by the last section of `accel/bvh/query.rs` the answer does not
/// depend on boxes.
///
/// Embree's reciprocals come from a table whose rounding need not scale: it is counted.
pub(super) fn odd_rays(effort: Effort) -> Table {
    let mut table = Table::default();
    let (rounds, rays) = (effort.of(6, 120), effort.of(300, 4000));
    for tracer in Tracer::ALL {
        let row = |what: &str| Row::new(format!("answers that change: {what}"), tracer, 0.0, false);
        let mut lengths = row("directions of other lengths");
        let mut worlds = row("worlds of other sizes");
        let mut mirrors = row("worlds mirrored");
        let mut zeros = row("zeros of the other sign");
        for round in 0..rounds {
            let mut random = Random(round as u64 + 77);
            let soup =
                soup(round % 6, 64, 1.0, DVec3::splat(if round % 2 == 0 { 0.0 } else { 3.0 }), &mut random);
            let accel = soup.build(tracer);
            let power = 2f32.powi(random.below(53) as i32 - 26);
            let axis = round % 3;
            let changed = |f: &dyn Fn([f32; 3]) -> [f32; 3]| {
                let mut other = soup.clone();
                other.positions.iter_mut().for_each(|p| *p = f(*p));
                other
            };
            let flip = |mut p: [f32; 3]| {
                p[axis] = -p[axis];
                p
            };
            let (large, mirrored) = (changed(&|p| p.map(|c| c * power)), changed(&flip));
            let (in_large, in_mirrored) = (large.build(tracer), mirrored.build(tracer));
            for i in 0..rays {
                let mut ray = aimed(&soup, &mut random);
                let long = Ray { direction: ray.direction * power, ..ray };
                same(&mut lengths, [&*accel, &*accel], [&ray, &long], power);
                let grown = Ray { origin: ray.origin * power, ..ray };
                same(&mut worlds, [&*accel, &*in_large], [&ray, &grown], 1.0 / power);
                let turned = |v: Vec3| Vec3::from(flip(v.to_array()));
                let seen = Ray { origin: turned(ray.origin), direction: turned(ray.direction), ..ray };
                same(&mut mirrors, [&*accel, &*in_mirrored], [&ray, &seen], 1.0);
                ray.direction[i % 3] = 0.0;
                if i % 2 == 0 {
                    ray.direction[(i + 1) % 3] = 0.0;
                }
                let mut minus = ray;
                minus.direction =
                    Vec3::from(ray.direction.to_array().map(|c| if c == 0.0 { -0.0 } else { c }));
                same(&mut zeros, [&*accel, &*accel], [&ray, &minus], 1.0);
            }
        }
        // In a world 2ᵏ as large the direction stays, so the distance is 2ᵏ as long.
        table.extend([lengths, worlds, mirrors, zeros]);
    }
    table
}

#[test]
fn odd_numbers_in_rays_have_answers() {
    bad_rays(Effort::Quick).assert_holds();
}

#[test]
fn exact_changes_change_nothing() {
    odd_rays(Effort::Quick).assert_holds();
}

/// The test above must be able to fail: a length that is no power of two does change bits.
#[test]
fn inexact_changes_are_found() {
    let mut random = Random(1);
    let soup = soup(0, 64, 1.0, DVec3::ZERO, &mut random);
    let accel = soup.build(Tracer::Native);
    let mut row = Row::new("x", Tracer::Native, 0.0, false);
    for _ in 0..100 {
        let ray = aimed(&soup, &mut random);
        same(&mut row, [&*accel, &*accel], [&ray, &Ray { direction: ray.direction * 3.0, ..ray }], 3.0);
    }
    assert!(row.worst > 10.0);
}
