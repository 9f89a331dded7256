//! The bounds hold for what each backend answers, and are no wider than they need be.

use super::super::aimed::Random;
use super::super::arbiter::{Arbiter, Name};
use super::super::testing::{NoCustom, Triangles};
use super::*;
use crate::accel::Accel;
use crate::accel::bvh::{BvhScene, Form};
use glam::Vec3;

/// Errors of answered distances, over their bounds, for one triangle after the other.
fn ratios(voice: Voice, placed: bool) -> Vec<f64> {
    let mut random = Random(7);
    let mut found = Vec::new();
    #[cfg(feature = "embree")]
    let device = crate::accel::embree::EmbreeDevice::new().expect("Embree is there");
    for round in 0..3000 {
        let reach = [1.0, 1e-3, 1e4][round % 3];
        let soup = Triangles::soup(1, reach, &mut random);
        let mut shapes = soup.shapes();
        if placed {
            let mut transform = [0.0; 12].map(|_: f32| random.unit() as f32 - 0.5);
            for k in 0..3 {
                transform[4 * k] += 2.0;
                transform[9 + k] *= reach;
            }
            shapes.objects = vec![std::mem::take(&mut shapes.world)];
            shapes.instances = vec![InstanceOf { object: 0, transform }];
        }
        let (w, o, i) = (&shapes.world[..], &shapes.objects[..], &shapes.instances[..]);
        let accel: Box<dyn Accel + '_> = match voice {
            Voice::Native => Box::new(BvhScene::new(w, o, i, &NoCustom, None, Form::best()).expect("small")),
            #[cfg(feature = "embree")]
            _ => {
                let robust = voice == Voice::EmbreeRobust;
                let options = crate::accel::embree::BuildOptions { robust, threads: 1 };
                Box::new(
                    crate::accel::embree::EmbreeScene::new(&device, w, o, i, &NoCustom, options)
                        .expect("small"),
                )
            }
            #[cfg(not(feature = "embree"))]
            _ => return vec![0.5],
        };
        let corners = soup.positions[..3].iter().map(|&p| Vec3::from(p).as_dvec3()).collect::<Vec<_>>();
        for _ in 0..20 {
            let [a, b] = [random.unit(), random.unit()];
            let (a, b) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
            let mut target = corners[0] + (corners[1] - corners[0]) * a + (corners[2] - corners[0]) * b;
            if let Some(instance) = shapes.instances.first() {
                target = place(instance, target);
            }
            let away = f64::from(reach) * [1.0, 10.0, 1000.0][random.next() as usize % 3];
            let origin =
                target + DVec3::new(random.unit() - 0.5, random.unit() - 0.5, random.unit() - 0.5) * away;
            let (origin, target) = (origin.as_vec3(), target.as_vec3());
            let ray = Ray::new(origin, target - origin);
            let hit = accel.closest(&ray);
            let Some(name) = Name::of(&hit) else { continue };
            let arbiter = Arbiter::new(&shapes, [voice, voice]);
            let candidate = arbiter.look(name, &ray).expect("what is answered may be hit");
            let verdict = candidate.may[0].expect("as above");
            assert!(verdict.allows(hit.t), "{voice:?} {ray:?}: {} not in {verdict:?}", hit.t);
            if verdict.doubt.is_none() {
                let room = 0.5 * (verdict.hi - verdict.lo);
                found.push((f64::from(hit.t) - candidate.t).abs() / room);
            }
        }
    }
    found
}

/// No answer is beyond its bound; and the bound is of the right size: some answers use a good part of it (`used`), though
/// the worst case of every rounding at once is rare.
#[track_caller]
fn holds_and_is_used(voice: Voice, placed: bool, used: f64) {
    let ratios = ratios(voice, placed);
    if !cfg!(feature = "embree") && voice != Voice::Native {
        return;
    }
    assert!(ratios.len() > 5000, "{} certain hits", ratios.len());
    let most = ratios.into_iter().fold(0.0, f64::max);
    eprintln!("{voice:?}, placed {placed}: the largest error is {most:.3} of its bound");
    assert!(most > used && most <= 1.0, "{voice:?}, placed {placed}: {most}");
}

#[test]
fn native_distances_are_within_their_bounds() {
    holds_and_is_used(Voice::Native, false, 0.1);
    holds_and_is_used(Voice::Native, true, 0.1);
}

#[test]
fn distances_of_embree_are_within_their_bounds() {
    holds_and_is_used(Voice::Embree, false, 0.05);
    holds_and_is_used(Voice::Embree, true, 0.05);
    holds_and_is_used(Voice::EmbreeRobust, false, 0.05);
    holds_and_is_used(Voice::EmbreeRobust, true, 0.05);
}

#[test]
fn a_plain_hit_is_known_to_some_millionths() {
    let corners = [DVec3::new(-1.0, -1.0, 2.0), DVec3::new(1.0, -1.0, 2.0), DVec3::new(0.0, 1.0, 2.0)];
    let ray = Ray::new(Vec3::ZERO, Vec3::Z);
    for voice in [Voice::Native, Voice::Embree, Voice::EmbreeRobust] {
        let local = LocalRay::new(voice, &ray, None);
        let meeting = Meeting::new(&local, corners);
        let e = meeting.errors(voice, &local);
        assert_eq!(meeting.t, 2.0);
        assert!(meeting.w.iter().all(|w| *w * meeting.den > 0.0));
        assert!((meeting.w.iter().sum::<f64>() - meeting.den).abs() < 1e-12);
        assert!(e.t > 0.0 && e.t < 4e-6, "{voice:?}: {e:?}");
        assert!(e.w.iter().all(|e| *e < 1e-5), "{voice:?}: {e:?}");
    }
}

#[test]
fn what_is_not_turned_is_not_uncertain() {
    let transform = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 5.0, 0.0, 0.0];
    let ray = Ray::new(Vec3::new(1.0, 2.0, 3.0), Vec3::X);
    let local =
        LocalRay::new(Voice::Native, &ray, Some(&Placement::new(&InstanceOf { object: 0, transform })));
    assert_eq!((local.o, local.d), (DVec3::new(-4.0, 2.0, 3.0), DVec3::X));
    assert!(local.o_error.max_element() < 1e-5 && local.o_error.min_element() > 0.0, "{local:?}");
}
