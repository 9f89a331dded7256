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

/// Standard deviations that are taken for chance: one in twenty of Student's distribution for four renders.
const CHANCE: f64 = 3.2;

/// A share of the light that is worth a word.
const LIGHT: f64 = 0.005;

/// Times that differ by less are alike: renders of the same setting do.
const ALIKE: f64 = 0.08;

/// The line through the logarithms of what was measured at several sample counts: noise at any. Beyond the last of them
/// variance falls with the number of samples at least, as it must in the end, however slowly the errors that are
/// left after the largest fall before.
#[derive(Clone, Copy, Debug)]
struct Line {
    /// Logarithm of the variance at one sample, and minus its slope.
    at_one: f64,
    slope: f64,
    /// The last count.
    last: f64,
}

impl Line {
    /// Through the points of `knob`; `None` where none of them has noise.
    fn new(points: &[Point], knob: &str) -> Option<Self> {
        let ladder: Vec<(f64, f64)> = points
            .iter()
            .filter(|p| p.knob == knob && p.noise > 0.0)
            .map(|p| (f64::from(p.spp).ln(), 2.0 * p.noise.ln()))
            .collect();
        let last = ladder.iter().map(|p| p.0).reduce(f64::max)?.exp();
        let n = ladder.len() as f64;
        let (x, y) = ladder.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
        let (over, under) =
            ladder.iter().fold((0.0, 0.0), |(o, u), p| (o + (p.0 - x) * (p.1 - y), u + (p.0 - x).powi(2)));
        // Noise that does not fall, or falls faster than any sampler lets it, is chance in few samples.
        let slope = if under > 0.0 { (-over / under).clamp(0.5, 3.0) } else { 1.0 };
        Some(Self { at_one: y + slope * x, slope, last })
    }

    /// Square of the noise at `spp` samples.
    fn noise(&self, spp: f64) -> f64 {
        let within = spp.min(self.last);
        let beyond = (spp / within).ln() * self.slope.max(1.0);
        (self.at_one - self.slope * within.ln() - beyond).exp()
    }

    /// Samples until the square of the noise is `room`; one at least.
    fn samples(&self, room: f64) -> f64 {
        let over = self.noise(self.last) / room;
        let slope = if over > 1.0 { self.slope.max(1.0) } else { self.slope };
        (self.last * over.powf(1.0 / slope)).max(1.0)
    }

    /// Moved so that it goes through `noise` squared at `spp`.
    fn through(self, spp: f64, noise: f64) -> Self {
        Self { at_one: self.at_one + (noise / self.noise(spp)).ln(), ..self }
    }
}

/// With which power of the sample count the variance of the scene's own settings falls; 1 where that is not known.
pub(super) fn slope(points: &[Point]) -> f64 {
    Line::new(points, SAMPLES).map_or(1.0, |line| line.slope)
}

/// The line of `point`'s setting: that of the scene's own settings, which many renders tell, times the ratio of both at
/// one count in renders of the same seeds, or what was measured of it at several; `None` where it has no noise.
fn line_of(study: &CostStudy, point: &Point, own: &Point) -> Option<Line> {
    if point.knob == SAMPLES || point.knob == JOINT {
        return Line::new(&study.points, &point.knob);
    }
    if point.noise == 0.0 {
        return None;
    }
    let (here, square) = (f64::from(point.spp), point.noise.powi(2));
    let Some(line) = Line::new(&study.points, SAMPLES).filter(|_| own.noise > 0.0) else {
        // Nothing is random in the scene's own settings.
        return Some(Line { at_one: square.ln() + here.ln(), slope: 1.0, last: here });
    };
    let here_now = square / own.noise.powi(2) * line.noise(here);
    // Samples that know nothing of each other have a slope of one at most.
    let independent = point.options.contains("--sampler independent");
    let slope = if independent { line.slope.min(1.0) } else { line.slope };
    Some(Line { slope, ..line }.through(here, here_now))
}

/// Square of the noise of `point`'s setting at `spp` samples.
fn noise_at(study: &CostStudy, point: &Point, own: &Point, spp: f64) -> f64 {
    line_of(study, point, own).map_or(0.0, |line| line.noise(spp))
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
            let spp = line_of(study, point, &own).map_or(1.0, |line| line.samples(room));
            // Whole ones, and no more for rounding.
            let spp = (spp * (1.0 - 1e-9)).ceil();
            AtTarget { spp, seconds: spp * seconds_of_sample(study, point, plan) * plan.scale }
        });
        let better = |q: &Point| {
            let (a, b) = ((q.seconds.mean, q.error), (point.seconds.mean, point.error));
            a.0 <= b.0 && a.1 <= b.1 && a != b
        };
        let slope = line_of(study, point, &own).map_or(1.0, |line| line.slope);
        found.push((at, deviation(point, &own, slope), !study.points.iter().any(better)));
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
    if logarithm.abs() > ALIKE.max(CHANCE * point.over_own_deviation) { logarithm } else { 0.0 }
}

/// By how much more (or, below zero, less) light the setting has than the scene's own; 0 where that may be chance, and
/// for what does not change what a long render comes to.
fn more_light(point: &Point) -> f64 {
    let Some(light) = point.light.filter(|_| changes_the_limit(&point.knob)) else { return 0.0 };
    let chance = 4.0 * light.deviation / f64::from(point.renders.max(1)).sqrt();
    if light.mean.abs() > chance.max(1e-5) { light.mean } else { 0.0 }
}

/// The scene's own settings at the plan's sample count, which others are compared with.
fn own<'s>(study: &'s CostStudy, plan: &Plan) -> Option<&'s Point> {
    study.points.iter().find(|p| p.knob == SAMPLES && p.spp == plan.spp)
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
        let expected = (16.0 * ((first * first / 8.0) / 1e-4f64).powf(1.0 / 1.5)).ceil();
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
