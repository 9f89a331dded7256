//! What follows from what was measured, for a person: what to turn, and in words.
//!
//! Invariant: measures nothing, and says no more than was told from chance.

use super::knobs::{Variant, changes_the_limit};
use super::plan::Plan;
use super::{SAMPLES, own};
use crate::report::cost::{AtTarget, CostStudy, Point, per_cent};
use crate::report::seconds;
use crate::settings::RenderSettings;

/// All knobs that help, together.
pub(super) const JOINT: &str = "together";

/// Standard deviations that are taken for chance: one in twenty of Student's distribution for four renders.
const CHANCE: f64 = 3.2;

/// A share of the light that is worth a word.
const LIGHT: f64 = 0.005;

/// Times that differ by less are alike: renders of the same setting do.
const ALIKE: f64 = 0.08;

/// Whether the setting takes more (or, below zero, less) time than the scene's own by more than chance.
fn differs(point: &Point) -> f64 {
    let Some(times) = point.over_own else { return 0.0 };
    let logarithm = times.ln();
    if logarithm.abs() > ALIKE.max(CHANCE * point.over_own_deviation) { logarithm } else { 0.0 }
}

/// By how much more (or, below zero, less) light the setting has than the scene's own; 0 where that may be chance, and
/// for what does not change what a long render comes to.
fn more_light(point: &Point) -> f64 {
    let Some(light) = point.light.filter(|_| changes_the_limit(&point.knob)) else { return 0.0 };
    let chance = 4.0 * light.deviation / f64::from(point.renders.max(1)).sqrt();
    if light.mean.abs() > chance.max(1e-5) { light.mean } else { 0.0 }
}

/// The settings that take the least time, one of each knob, if they save any.
pub(super) fn joint(
    study: &CostStudy,
    all: &[Variant],
    own: &RenderSettings,
    scene_depth: u32,
) -> Option<Variant> {
    // Nothing to gain where one sample does.
    if study.points.iter().all(|p| p.knob != SAMPLES || p.error == 0.0) {
        return None;
    }
    let mut chosen: Vec<(&Point, &Variant)> = Vec::new();
    for point in &study.points {
        let Some(variant) = all.iter().find(|v| v.knob == point.knob && v.value == point.value) else {
            continue;
        };
        let Some(times) = point.over_own.filter(|_| differs(point) < 0.0) else { continue };
        // More cannot take less time; what says so is chance.
        if point.knob == "depth" && variant.settings.max_depth > own.max_depth.or(Some(scene_depth)) {
            continue;
        }
        // Biases of several add up, and may be a little more than was told.
        let light = more_light(point).abs();
        if changes_the_limit(&point.knob) && point.bias.max(light) > study.target / 4.0 {
            continue;
        }
        match chosen.iter_mut().find(|(other, _)| other.knob == point.knob) {
            Some(other) if other.0.over_own.is_some_and(|least| times < least) => *other = (point, variant),
            Some(_) => {}
            None => chosen.push((point, variant)),
        }
    }
    if chosen.is_empty() {
        return None;
    }
    let mut settings = own.clone();
    for (_, Variant { knob, settings: s, .. }) in &chosen {
        match *knob {
            "depth" => settings.max_depth = s.max_depth,
            "roulette" => settings.roulette = s.roulette,
            "sampler" => settings.sampler = s.sampler,
            "direct light" => settings.estimator = s.estimator,
            "filter" => settings.texture_filter = s.texture_filter,
            "traversal" => (settings.backend, settings.robust) = (s.backend, s.robust),
            other => unreachable!("{other} is no knob"),
        }
    }
    let list = |of: &dyn Fn(&Variant) -> String, by: &str| {
        chosen.iter().map(|(_, v)| of(v)).filter(|s| !s.is_empty()).collect::<Vec<_>>().join(by)
    };
    Some(Variant {
        knob: JOINT,
        value: list(&|v| format!("{} {}", v.knob, v.value), ", "),
        options: list(&|v| v.options.clone(), " "),
        settings,
        reloads: chosen.iter().any(|(_, v)| v.reloads),
    })
}

/// The point of all knobs together, if that pays: then it is what is advised, else the scene's own settings.
pub(super) fn joint_that_helps(study: &CostStudy) -> Option<usize> {
    let joint = study.points.iter().rposition(|p| p.knob == JOINT)?;
    (differs(&study.points[joint]) < 0.0).then_some(joint)
}

/// What a person can act on.
pub(super) fn sentences(study: &CostStudy, advised: usize, plan: &Plan) -> Vec<String> {
    let Some(point) = study.points.get(advised) else { return Vec::new() };
    let Some(own) = own(study, plan) else { return Vec::new() };
    let target = per_cent(study.target);
    let samples = |at: &AtTarget| format!("{} samples per pixel", at.spp);
    if own.error == 0.0 {
        return vec!["Every render is the same: one sample per pixel does.".to_owned()];
    }
    let mut out = vec![match own.at_target {
        Some(at) => format!(
            "For {target} error this scene needs {} as it is set ({}).",
            seconds(at.seconds),
            samples(&at)
        ),
        None => format!(
            "As it is set this scene never has {target} error: {} stay however many samples it takes.",
            per_cent(own.bias)
        ),
    }];
    if study.reference.error.is_some_and(|error| error > study.target) {
        out.push(format!(
            "The reference itself has {} error: what follows is told by the way noise falls; a larger --budget tells more.",
            study.reference.error.map_or(String::new(), per_cent)
        ));
    }
    if let Some(check) =
        study.checks.iter().find(|c| !(0.7..1.4).contains(&(c.measured / c.predicted.max(1e-9))))
    {
        out.push(format!(
            "A check disagrees: {} at {} samples was predicted, {} was measured; take all of this as rough.",
            per_cent(check.predicted),
            check.spp,
            per_cent(check.measured)
        ));
    }
    if point.knob == JOINT
        && let Some(at) = point.at_target
    {
        out.push(format!(
            "With {} it needs {} ({}): add {}.",
            point.value,
            seconds(at.seconds),
            samples(&at),
            if point.options.is_empty() { "nothing" } else { &point.options }
        ));
    }
    let turned = || study.points.iter().filter(|p| p.knob != SAMPLES && p.knob != JOINT);
    let name = |p: &Point| {
        let light = match more_light(p) {
            same if same.abs() <= LIGHT => String::new(),
            more if more > 0.0 => format!(" ({} more light)", per_cent(more)),
            less => format!(" ({} less light)", per_cent(-less)),
        };
        format!("{} {}{light}", p.knob, p.value)
    };
    let list = |of: Vec<String>| match of.as_slice() {
        [] => String::new(),
        [one] => one.clone(),
        [some @ .., last] => format!("{} and {last}", some.join(", ")),
    };
    let other = |p: &&Point| more_light(p).abs() > LIGHT;
    let free: Vec<String> =
        turned().filter(|p| p.over_own.is_some() && differs(p) == 0.0 && !other(p)).map(name).collect();
    if !free.is_empty() {
        out.push(format!("No difference that was told from chance: {}.", list(free)));
    }
    let mut costly: Vec<&Point> = turned().filter(|p| differs(p) > 0.0).collect();
    costly.sort_by(|a, b| b.over_own.unwrap_or(0.0).total_cmp(&a.over_own.unwrap_or(0.0)));
    if !costly.is_empty() {
        let times = |p: &Point| format!("{} {:.1} times the seconds", name(p), p.over_own.unwrap_or(0.0));
        out.push(format!("It costs: {}.", list(costly.into_iter().map(times).collect())));
    }
    let changed: Vec<String> = turned().filter(other).map(name).collect();
    if !changed.is_empty() {
        out.push(format!("Another picture: {}.", list(changed)));
    }
    let never: Vec<String> = turned()
        .filter(|p| p.at_target.is_none())
        .map(|p| format!("{} ({} stay)", name(p), per_cent(p.bias)))
        .collect();
    if !never.is_empty() {
        out.push(format!("Never {target}: {}.", list(never)));
    }
    out
}
