//! Known answers of the arbiter.

use super::super::aimed::Random;
use super::super::judge::{Fault, Reason};
use super::super::testing::Triangles;
use super::*;

const VOICES: [Voice; 2] = [Voice::Native, Voice::Embree];

/// A square of two triangles at z = 2, from −1 to 1, cut along x = y.
fn square() -> Triangles {
    let at = |x: f32, y: f32| [x, y, 2.0];
    Triangles::new(
        vec![at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)],
        vec![[0, 1, 2], [0, 2, 3]],
    )
}

fn towards(x: f32, y: f32, z: f32) -> Ray {
    Ray::new(Vec3::ZERO, Vec3::new(x, y, z))
}

fn hit(t: f32, primitive: u32) -> Hit {
    Hit { t, u: 0.0, v: 0.0, geometry: 0, primitive, instance: NONE, place: NONE }
}

fn doubts(found: &[Candidate]) -> Vec<(u32, Option<Doubt>)> {
    found.iter().filter_map(|c| Some((c.name.primitive, c.may[0]?.doubt))).collect()
}

#[test]
fn plain_edge_and_range() {
    let square = square();
    let shapes = square.shapes();
    let arbiter = Arbiter::new(&shapes, VOICES);
    let list = |ray: &Ray| doubts(&arbiter.candidates(ray, f64::INFINITY));
    assert_eq!(list(&towards(0.5, 0.0, 2.0)), [(0, None)]);
    assert_eq!(list(&towards(-0.5, 0.0, 2.0)), [(1, None)]);
    assert_eq!(list(&towards(0.0, 0.0, 1.0)), [(0, Some(Doubt::Edge)), (1, Some(Doubt::Edge))]);
    assert_eq!(list(&towards(1.0, 0.25, 2.0)), [(0, Some(Doubt::Edge))]);
    assert_eq!(list(&towards(1.1, 0.0, 2.0)), []);
    assert_eq!(list(&towards(0.5, 0.0, -2.0)), []);
    let upto = |t_max: f32| Ray { t_max, ..towards(0.5, 0.0, 2.0) };
    assert_eq!(list(&upto(1.0)), [(0, Some(Doubt::Range))]);
    assert_eq!(list(&upto(0.999)), []);
    assert_eq!(list(&upto(1.001)), [(0, None)]);
    let found = arbiter.candidates(&towards(0.5, 0.0, 2.0), f64::INFINITY);
    assert_eq!(found[0].t, 1.0);
    // In its own plane.
    let along = Ray::new(Vec3::new(-5.0, 0.25, 2.0), Vec3::X);
    assert_eq!(list(&along), [(0, Some(Doubt::Grazing)), (1, Some(Doubt::Grazing))]);
}

#[test]
fn what_has_no_area_is_said_to_have_none() {
    let line = Triangles::new(vec![[0.0, -1.0, 2.0], [0.0, 0.0, 2.0], [0.0, 1.0, 2.0]], vec![[0, 1, 2]]);
    let shapes = line.shapes();
    let arbiter = Arbiter::new(&shapes, VOICES);
    let found = arbiter.candidates(&towards(0.0, 0.25, 2.0), f64::INFINITY);
    assert_eq!(doubts(&found), [(0, Some(Doubt::Degenerate))]);
}

#[test]
fn faults_are_told_from_rounding() {
    let square = square();
    let shapes = square.shapes();
    let arbiter = Arbiter::new(&shapes, VOICES);
    let reason = |ray: &Ray, native: &Hit, embree: &Hit| arbiter.judge(ray, [native, embree]).reason;
    let (plain, edge) = (towards(0.5, 0.0, 2.0), towards(0.0, 0.0, 2.0));
    let miss = &Hit::MISS;
    assert_eq!(reason(&plain, &hit(1.0, 0), &hit(1.0, 0)), None);
    assert_eq!(reason(&plain, miss, &hit(1.0, 0)), Some(Reason::NativeMissed));
    assert_eq!(reason(&plain, &hit(1.0, 0), miss), Some(Reason::EmbreeMissed));
    assert_eq!(reason(&plain, miss, miss), Some(Reason::NativeMissed));
    assert_eq!(reason(&plain, &hit(1.00001, 0), &hit(1.0, 0)), Some(Reason::NativeWrongDistance));
    assert_eq!(reason(&plain, &hit(1.0, 0), &hit(1.00001, 0)), Some(Reason::EmbreeWrongDistance));
    assert_eq!(reason(&plain, &hit(1.0, 1), &hit(1.0, 0)), Some(Reason::NativeFalseHit));
    // Through the diagonal, which has a triangle on both sides, nothing may pass.
    assert_eq!(reason(&edge, &hit(1.0, 0), &hit(1.0, 1)), Some(Reason::Edge));
    assert_eq!(reason(&edge, miss, &hit(1.0, 1)), Some(Reason::NativeMissedAtEdge));
    assert_eq!(reason(&edge, &hit(1.0, 0), miss), Some(Reason::EmbreeMissedAtEdge));
    let both = arbiter.judge(&edge, [miss, miss]);
    assert_eq!(both.faults, [Some(Fault::MissedAtEdge); 2]);
    // Past the outer edge it may.
    let outer = towards(1.0, 0.25, 2.0);
    assert_eq!(reason(&outer, miss, &hit(1.0, 0)), Some(Reason::Edge));
    assert_eq!(reason(&outer, &hit(1.0, 0), miss), Some(Reason::Edge));
    // And past a corner of it.
    assert_eq!(reason(&towards(1.0, 1.0, 2.0), miss, &hit(1.0, 0)), Some(Reason::Edge));
}

#[test]
fn a_closed_surface_is_closed_at_corners_and_open_at_its_outline() {
    let sphere = Triangles::sphere(8, 1.0, Vec3::new(0.0, 0.0, 0.0));
    let shapes = sphere.shapes();
    let arbiter = Arbiter::new(&shapes, VOICES);
    let mut inner = 0;
    for p in &sphere.positions {
        let target = Vec3::from(*p);
        let origin = target * 3.0;
        let ray = Ray::new(origin, target - origin);
        let judged = arbiter.judge(&ray, [&Hit::MISS; 2]);
        assert!(matches!(judged.faults[0], Some(Fault::Missed | Fault::MissedAtEdge)), "{p:?}: {judged:?}");
        inner += 1;
        // Square to the axis through the corner: the pole is the sphere's outline there.
        if p[2].abs() == 1.0 {
            let ray = Ray::new(target + Vec3::X * 3.0, Vec3::NEG_X);
            let found = arbiter.candidates(&ray, f64::INFINITY);
            assert!(!found.is_empty());
            assert_eq!(arbiter.judge(&ray, [&Hit::MISS; 2]).faults, [None; 2], "{p:?}");
        }
    }
    assert_eq!(inner, 2 + 7 * 16);
}

#[test]
fn boxes_hide_nothing() {
    let mut random = Random(3);
    let soup = Triangles::soup(9000, 10.0, &mut random);
    let shapes = soup.shapes();
    let arbiter = Arbiter::new(&shapes, VOICES);
    let (mut seen, mut doubtful) = (0, 0);
    for i in 0..200 {
        let mut any = || Vec3::from_array([0; 3].map(|_| (random.unit() as f32 - 0.5) * 30.0));
        let (origin, mut target) = (any(), any());
        if i % 2 == 0 {
            // At a corner.
            target = Vec3::from(soup.positions[random.next() as usize % soup.positions.len()]);
        }
        let ray = Ray::new(origin, target - origin);
        let local = LocalRay::new(Voice::Embree, &ray, None);
        let bounds = |i: usize| {
            let corner = |k: usize| Vec3::from(soup.positions[3 * i + k]);
            (0..3).map(corner).fold(EMPTY, |b, p| (b.0.min(p), b.1.max(p)))
        };
        let mut all: Vec<Name> = (0..9000)
            .map(|primitive| Name { placed: 0, geometry: 0, primitive })
            .filter(|&name| arbiter.look(name, &ray).is_some())
            // Past the tip of a sliver, rounding at its edges reaches beyond its box; no hierarchy asks there.
            .filter(|name| near(&local, 0.0, f64::INFINITY, bounds(name.primitive as usize)))
            .collect();
        let found = arbiter.candidates(&ray, f64::INFINITY);
        doubtful += found.iter().filter_map(|c| c.may[0]).filter(|v| v.doubt.is_some()).count();
        let mut names: Vec<Name> = found.iter().map(|c| c.name).collect();
        names.retain(|n| near(&local, 0.0, f64::INFINITY, bounds(n.primitive as usize)));
        names.sort();
        all.sort();
        seen += all.len();
        assert_eq!(names, all);
    }
    assert!(seen > 100 && doubtful > 90, "{seen} {doubtful}");
}
