//! The comparison finds what is wrong, wherever it is, and finds nothing where nothing is.

use super::super::aimed::aimed;
use super::super::bounds::Voice;
use super::super::testing::{Liar, Lie, NoCustom, Triangles};
use super::*;
use crate::accel::bvh::{BvhScene, Form};
use glam::Vec3;
use std::sync::atomic::Ordering;

struct Compared {
    tally: Tally,
    lies: u64,
}

/// Native against native (the bounds of one), one of which may lie.
fn compared(lie: Option<(Lie, usize)>) -> Compared {
    let sphere = Triangles::sphere(40, 1.0, Vec3::new(0.5, -0.25, 3.0));
    let shapes = sphere.shapes();
    let scene = BvhScene::new(&shapes.world, &[], &[], &NoCustom, None, Form::best()).expect("small");
    let arbiter = Arbiter::new(&shapes, [Voice::Native; 2]);
    let rays = aimed(&shapes, 20_000, 5, scene.bounds(), Vec3::ZERO);
    assert_eq!(rays.len(), 20_000);
    let liar = Liar::new(&scene, lie.map_or(Lie::Drop, |l| l.0));
    let who = lie.map(|l| l.1);
    let pair = Pair {
        native: if who == Some(0) { &liar } else { &scene },
        other: if who == Some(1) { &liar } else { &scene },
        arbiter: &arbiter,
    };
    let tally = pair.compare(Kind::Aimed, &rays, 50);
    Compared { tally, lies: liar.lies.load(Ordering::Relaxed) }
}

#[test]
fn the_truth_is_the_same_as_itself() {
    let Tally { rays, same, within_bound, explained, unexplained, audited, slipped, .. } =
        compared(None).tally;
    assert_eq!((rays, same, within_bound, explained, unexplained), (20_000, 20_000, 0, 0, 0));
    assert_eq!((audited, slipped), (400, [0, 0]));
}

/// Every lie is found, and put down to the one who lied.
#[track_caller]
fn is_found(lie: Lie, who: usize, reasons: &[Reason]) {
    let Compared { tally, lies } = compared(Some((lie, who)));
    assert!(lies >= 4, "{lies} lies");
    let counted: u64 = reasons.iter().filter_map(|r| tally.reasons.get(r)).sum();
    // What was dropped or moved at the end of a ray's range, or at the outline, may pass for rounding; of aimed rays
    // half pass a corner or an edge.
    let rounding: u64 = [Reason::Edge, Reason::Range].iter().filter_map(|r| tally.reasons.get(r)).sum();
    assert!(counted + rounding >= lies && counted * 3 > lies, "{lies} lies: {:?}", tally.reasons);
    assert_eq!(tally.reasons.values().sum::<u64>(), counted + rounding, "{:?}", tally.reasons);
    let blamed = if who == 0 { tally.unexplained } else { tally.explained - rounding };
    assert_eq!(blamed, counted);
    assert_eq!(tally.same + tally.ties + tally.explained + tally.unexplained, tally.rays);
    let worst = tally.worst(1);
    assert!(worst[0].reason.is_explained() == (who == 1), "{worst:?}");
}

#[test]
fn dropped_hits_are_found() {
    is_found(Lie::Drop, 0, &[Reason::NativeMissed, Reason::NativeMissedAtEdge]);
    is_found(Lie::Drop, 1, &[Reason::EmbreeMissed, Reason::EmbreeMissedAtEdge]);
}

#[test]
fn moved_hits_are_found() {
    is_found(Lie::Move, 0, &[Reason::NativeWrongDistance]);
    is_found(Lie::Move, 1, &[Reason::EmbreeWrongDistance]);
}

#[test]
fn misnamed_hits_are_found() {
    is_found(Lie::Rename, 0, &[Reason::NativeFalseHit]);
    is_found(Lie::Rename, 1, &[Reason::EmbreeFalseHit]);
}

#[test]
fn contradicting_occlusion_is_found() {
    is_found(Lie::Occlusion, 0, &[Reason::NativeOcclusion]);
    is_found(Lie::Occlusion, 1, &[Reason::EmbreeOcclusion]);
}
