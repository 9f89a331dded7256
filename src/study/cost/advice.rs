//! What follows from what was measured: seconds at the error that is wanted, what to turn, and in words.
//!
//! Invariant: measures nothing. A prediction uses the power with which noise falls, and says no more than was told from
//! chance.

use super::knobs::{Variant, changes_the_limit};
use super::plan::Plan;
use super::{SAMPLES, spread};
use crate::report::cost::{AtTarget, CostStudy, Point, Spread, per_cent};
use crate::report::seconds;
use crate::settings::RenderSettings;

/// All knobs that help, together.
pub(super) const JOINT: &str = "together";

/// Times that differ by less are alike: renders of the same setting do.
const ALIKE: f64 = 0.08;

/// The line through the logarithms of what was measured of settings at several sample counts: their noise at any.
struct Ladder {
    /// Logarithm of the variance at one sample, and minus its slope.
    at_one: f64,
    slope: f64,
}

impl Ladder {
    fn new(points: &[Point], knob: &str) -> Self {
        let ladder: Vec<(f64, f64)> = points
            .iter()
            .filter(|p| p.knob == knob && p.noise > 0.0)
            .map(|p| (f64::from(p.spp).ln(), 2.0 * p.noise.ln()))
            .collect();
        let n = ladder.len().max(1) as f64;
        let (x, y) = ladder.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
        let (over, under) =
            ladder.iter().fold((0.0, 0.0), |(o, u), p| (o + (p.0 - x) * (p.1 - y), u + (p.0 - x).powi(2)));
        // Noise that does not fall, or falls faster than any sampler lets it, is chance in few samples.
        let slope = if under > 0.0 { (-over / under).clamp(0.5, 3.0) } else { 1.0 };
        Self { at_one: y + slope * x, slope }
    }

    /// Square of the noise at `spp` samples.
    fn noise(&self, spp: f64) -> f64 {
        (self.at_one - self.slope * spp.ln()).exp()
    }
}

/// With which power of the sample count the variance of the scene's own settings falls; 1 where there are not two counts.
pub(super) fn slope(points: &[Point]) -> f64 {
    Ladder::new(points, SAMPLES).slope
}

/// The power for one setting, where that was measured, else that of the scene's own; samples that know nothing of each
/// other have 1 at most.
fn slope_of(study: &CostStudy, point: &Point) -> f64 {
    if point.knob == JOINT {
        return Ladder::new(&study.points, JOINT).slope;
    }
    if point.options.contains("--sampler independent") { study.slope.min(1.0) } else { study.slope }
}

/// Square of the noise of `point`'s setting at `spp` samples: that of the scene's own settings, which many renders
/// tell, times the ratio of both at one count, in renders of the same seeds.
fn noise_at(study: &CostStudy, point: &Point, own: &Point, spp: f64) -> f64 {
    let ladder = Ladder::new(&study.points, SAMPLES);
    // Where nothing is random there is no line either.
    if own.noise == 0.0 {
        return point.noise.powi(2) * (f64::from(point.spp) / spp).powf(slope_of(study, point));
    }
    if point.knob == SAMPLES {
        return ladder.noise(spp);
    }
    if point.knob == JOINT && point.noise > 0.0 {
        return Ladder::new(&study.points, JOINT).noise(spp);
    }
    let here = f64::from(point.spp);
    let measured = (point.noise / own.noise).powi(2) * ladder.noise(here);
    measured * (here / spp).powf(slope_of(study, point))
}

/// What it takes until the square of the noise is `room`.
fn samples_for(study: &CostStudy, point: &Point, own: &Point, room: f64) -> f64 {
    let here = f64::from(point.spp);
    let spp = here * (noise_at(study, point, own, here) / room).powf(1.0 / slope_of(study, point));
    // Fewer samples than one are not to be had.
    spp.max(1.0)
}

/// Seconds of a sample of `point`'s setting, over what was rendered. Of the scene's own, where most were taken.
fn seconds_of_sample(study: &CostStudy, point: &Point, plan: &Plan) -> f64 {
    let of = |p: &Point| p.seconds.mean / f64::from(p.spp);
    match own(study, plan) {
        Some(own) if point.knob == SAMPLES => of(own),
        _ => of(point),
    }
}

/// Fills in what follows point by point.
pub(super) fn predict(study: &mut CostStudy, plan: &Plan) {
    study.slope = slope(&study.points);
    let Some(own) = own(study, plan).cloned() else { return };
    let target = study.target.powi(2);
    let mut found = Vec::new();
    for point in &study.points {
        // The bias of the scene's own settings is one, whatever the count.
        let bias = if point.knob == SAMPLES { own.bias } else { point.bias };
        let room = target - bias.powi(2);
        let at = (room > 0.0).then(|| {
            let spp = samples_for(study, point, &own, room);
            AtTarget { spp, seconds: spp * seconds_of_sample(study, point, plan) * plan.scale }
        });
        let better = |q: &Point| {
            let (a, b) = ((q.seconds.mean, q.error), (point.seconds.mean, point.error));
            a.0 <= b.0 && a.1 <= b.1 && a != b
        };
        found.push((at, deviation(point, &own, slope_of(study, point)), !study.points.iter().any(better)));
    }
    let of_own =
        study.points.iter().position(|p| p.knob == SAMPLES && p.spp == plan.spp).and_then(|i| found[i].0);
    for (point, (at, deviation, best)) in study.points.iter_mut().zip(found) {
        point.at_target = at;
        point.over_own = at.zip(of_own).map(|(at, own)| at.seconds / own.seconds);
        point.over_own_deviation = deviation;
        point.best = best;
    }
}

/// Standard deviation of the logarithm of the ratio of seconds at one error: of the ratio of errors, render by render,
/// and of the times.
fn deviation(point: &Point, own: &Point, slope: f64) -> f64 {
    if point.knob == SAMPLES {
        return 0.0;
    }
    let pairs = point.relmse.iter().zip(&own.relmse).filter(|(a, b)| **a > 0.0 && **b > 0.0);
    let logarithms: Vec<f64> = pairs.map(|(a, b)| (a / b).ln()).collect();
    let of_errors = spread(&logarithms).deviation / slope;
    let relative = |s: &Spread| if s.mean > 0.0 { s.deviation / s.mean } else { 0.0 };
    let variance = of_errors.powi(2) + relative(&point.seconds).powi(2) + relative(&own.seconds).powi(2);
    (variance / f64::from(point.renders.max(1))).sqrt()
}

/// Whether the setting takes more (or, below zero, less) time than the scene's own by more than chance.
fn differs(point: &Point) -> f64 {
    let Some(times) = point.over_own else { return 0.0 };
    let logarithm = times.ln();
    if logarithm.abs() > ALIKE.max(2.0 * point.over_own_deviation) { logarithm } else { 0.0 }
}

/// By how much more (or, below zero, less) light the setting has than the scene's own; 0 where that may be chance.
fn more_light(point: &Point) -> f64 {
    let Some(light) = point.light else { return 0.0 };
    let chance = 4.0 * light.deviation / f64::from(point.renders.max(1)).sqrt();
    if light.mean.abs() > chance.max(1e-5) { light.mean } else { 0.0 }
}

/// The scene's own settings at the plan's sample count, which others are compared with.
fn own<'s>(study: &'s CostStudy, plan: &Plan) -> Option<&'s Point> {
    study.points.iter().find(|p| p.knob == SAMPLES && p.spp == plan.spp)
}

/// The settings that take the least time, one of each knob, if they save any.
pub(super) fn joint(study: &CostStudy, all: &[Variant], own: &RenderSettings) -> Option<Variant> {
    let mut chosen: Vec<(&Point, &Variant)> = Vec::new();
    for point in &study.points {
        let Some(variant) = all.iter().find(|v| v.knob == point.knob && v.value == point.value) else {
            continue;
        };
        let Some(times) = point.over_own.filter(|_| differs(point) < 0.0) else { continue };
        // Biases of several add up, and may be a little more than was told.
        let light = more_light(point).abs() / 2.0;
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

/// What to render with: all knobs together where that pays, else the scene's own settings; the point and its settings.
pub(super) fn advised(
    study: &CostStudy,
    joint: Option<&Variant>,
    own: &RenderSettings,
) -> (usize, RenderSettings) {
    let together = study.points.iter().rposition(|p| p.knob == JOINT);
    if let (Some(at), Some(joint)) = (together, joint)
        && differs(&study.points[at]) < 0.0
    {
        return (at, joint.settings.clone());
    }
    let last = study.points.iter().rposition(|p| p.knob == SAMPLES).unwrap_or(0);
    (last, own.clone())
}

/// Samples at which the advice can be held against a render in `left` seconds: those of the target, or as many as fit;
/// the error and the seconds that are predicted.
pub(super) fn checkable(study: &CostStudy, point: usize, plan: &Plan, left: f64) -> Option<(u32, f64, f64)> {
    let (point, own) = (study.points.get(point)?, own(study, plan)?);
    let each = seconds_of_sample(study, point, plan);
    let fits = ((left - study.load_s) * 0.8 / each.max(1e-9)).max(f64::from(2 * plan.spp));
    let wanted = point.at_target.map_or(fits, |at| at.spp.ceil());
    let spp = wanted.min(fits).clamp(1.0, 1e6) as u32;
    let bias = if point.knob == SAMPLES { own.bias } else { point.bias };
    let error = (bias.powi(2) + noise_at(study, point, own, f64::from(spp))).sqrt();
    Some((spp, error, each * f64::from(spp)))
}

/// What a person can act on.
pub(super) fn sentences(study: &CostStudy, advised: usize, plan: &Plan) -> Vec<String> {
    let Some(point) = study.points.get(advised) else { return Vec::new() };
    let Some(own) = own(study, plan) else { return Vec::new() };
    let target = per_cent(study.target);
    let samples = |at: &AtTarget| format!("{} samples per pixel", at.spp.ceil());
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
            0.0 => String::new(),
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
    let free: Vec<String> =
        turned().filter(|p| p.over_own.is_some() && differs(p) == 0.0).map(name).collect();
    if !free.is_empty() {
        out.push(format!("No difference that was told from chance: {}.", list(free)));
    }
    let mut costly: Vec<&Point> = turned().filter(|p| differs(p) > 0.0).collect();
    costly.sort_by(|a, b| b.over_own.unwrap_or(0.0).total_cmp(&a.over_own.unwrap_or(0.0)));
    if !costly.is_empty() {
        let times = |p: &Point| format!("{} {:.1} times the seconds", name(p), p.over_own.unwrap_or(0.0));
        out.push(format!("It costs: {}.", list(costly.into_iter().map(times).collect())));
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

#[cfg(test)]
mod tests {
    use super::*;

    fn point(knob: &str, value: &str, spp: u32, noise: f64, bias: f64, seconds: f64) -> Point {
        Point {
            knob: knob.to_owned(),
            value: value.to_owned(),
            spp,
            renders: 4,
            relmse: vec![noise * noise + bias * bias; 4],
            seconds: Spread { mean: seconds, deviation: 0.0 },
            error: noise.hypot(bias),
            noise,
            bias,
            bias_bound: bias,
            ..Point::default()
        }
    }

    fn study(points: Vec<Point>) -> (CostStudy, Plan) {
        let mut study = CostStudy { target: 0.01, points, ..CostStudy::default() };
        let plan = Plan {
            size: (100, 100),
            reference_spp: 64,
            ladder: vec![(4, 4), (16, 4)],
            spp: 16,
            renders: 4,
            reloads: true,
            scale: 4.0,
        };
        predict(&mut study, &plan);
        (study, plan)
    }

    #[test]
    fn seconds_at_the_target_follow_from_the_slope() {
        // Variance falls with n^1.5: from 16 to 64 samples by 8.
        let first = 0.2;
        let (study, plan) = study(vec![
            point(SAMPLES, "4", 4, first, 0.0, 0.1),
            point(SAMPLES, "16", 16, first / 8f64.sqrt(), 0.0, 0.4),
            point("depth", "2", 16, 0.05, 0.02, 0.2),
            point("sampler", "independent", 16, 0.05, 0.0, 0.4),
        ]);
        assert!((study.slope - 1.5).abs() < 1e-9, "{}", study.slope);
        let at = study.points[1].at_target.expect("no bias");
        let expected = 16.0 * ((first * first / 8.0) / 1e-4f64).powf(1.0 / 1.5);
        assert!(
            (at.spp / expected - 1.0).abs() < 1e-9
                && (at.seconds / (at.spp * 0.025 * 4.0) - 1.0).abs() < 1e-9
        );
        assert!(study.points[2].at_target.is_none(), "its bias is twice the target");
        let (spp, error, _) = checkable(&study, 1, &plan, 1e9).expect("a point");
        assert!((error / 0.01 - 1.0).abs() < 1e-2 && f64::from(spp) >= at.spp);
        let text = sentences(&study, 1, &plan).join("\n");
        assert!(text.contains("Never 1.0 %: depth 2 (2.0 % stay)."), "{text}");
        assert!(text.starts_with("For 1.0 % error this scene needs"), "{text}");
    }

    #[test]
    fn what_is_not_random_needs_one_sample() {
        let (study, _) = study(vec![
            point(SAMPLES, "4", 4, 0.0, 0.0, 0.1),
            point(SAMPLES, "16", 16, 0.0, 0.0, 0.4),
            point("direct light", "lights only", 16, 0.1, 0.0, 0.4),
            point("roulette", "off", 16, 0.0, 0.0, 0.8),
        ]);
        let spp: Vec<f64> = study.points.iter().filter_map(|p| p.at_target).map(|at| at.spp).collect();
        // 10 % at 16 samples, of a variance that falls as their number rises.
        assert_eq!(spp[0..2], [1.0, 1.0]);
        assert!((spp[2] - 1600.0).abs() < 1e-6 && spp[3] == 1.0, "{spp:?}");
        assert!(study.points.iter().all(|p| p.over_own.is_some_and(f64::is_finite)), "{study:?}");
    }

    #[test]
    fn the_front_has_what_nothing_beats() {
        let (study, _) = study(vec![
            point(SAMPLES, "4", 4, 0.2, 0.0, 0.1),
            point(SAMPLES, "16", 16, 0.1, 0.0, 0.4),
            point("roulette", "off", 16, 0.1, 0.0, 0.6),
            point("depth", "8", 16, 0.05, 0.001, 0.3),
        ]);
        let best: Vec<bool> = study.points.iter().map(|p| p.best).collect();
        assert_eq!(best, [true, false, false, true]);
    }
}
