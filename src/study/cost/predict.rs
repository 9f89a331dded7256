//! What follows from what was measured, in numbers: errors at other sample counts, seconds at the error that is wanted.
//!
//! Invariant: measures nothing; uses the power with which noise falls, as it was measured.

use super::advice::JOINT;
use super::knobs::SAMPLER;
use super::plan::Plan;
use super::{SAMPLES, own, spread};
use crate::report::cost::{AtTarget, CostStudy, Point, Spread};
use crate::settings::Sampler;

/// The line through the logarithms of what was measured at several sample counts, powers of two: noise at any. Beyond the
/// last of them variance falls with the number of samples at least, as it must in the end, however slowly the errors
/// that are left after the largest fall before.
#[derive(Clone, Copy, Debug)]
struct Line {
    /// Logarithm of the variance at one sample, and minus its slope.
    at_one: f64,
    slope: f64,
    /// The last count.
    last: f64,
}

/// Leading binary digits that a count is advised with: others cost more than they save.
const DIGITS: u32 = 4;

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

    /// Square of the noise at `spp` samples, a power of two.
    fn on_line(&self, spp: f64) -> f64 {
        let within = spp.min(self.last);
        let beyond = (spp / within).ln() * self.slope.max(1.0);
        (self.at_one - self.slope * within.ln() - beyond).exp()
    }

    /// Square of the noise at `spp` samples, whole ones. Points of a Sobol sequence fill each other's gaps in powers of two, and
    /// what is between is a mean of such sets of points, one for each binary digit, which are taken to know nothing of each other.
    fn noise(&self, spp: f64) -> f64 {
        // Far more than anybody takes.
        let count = spp.clamp(1.0, 2f64.powi(52)) as u64;
        let sets = (0..u64::BITS).filter(|digit| count >> digit & 1 == 1).map(|digit| (1u64 << digit) as f64);
        sets.map(|set| (set / count as f64).powi(2) * self.on_line(set)).sum()
    }

    /// Samples at which the square of the noise is no more than `room`: whole ones, the fewest of those with few binary digits.
    fn samples(&self, room: f64) -> f64 {
        let over = self.on_line(self.last) / room;
        let slope = if over > 1.0 { self.slope.max(1.0) } else { self.slope };
        // No more for rounding.
        let least = (self.last * over.powf(1.0 / slope) * (1.0 - 1e-9)).clamp(1.0, 2f64.powi(50)).ceil();
        let power = 2f64.powi((least as u64).ilog2() as i32);
        let step = (power / f64::from(1 << (DIGITS - 1))).max(1.0);
        let first = (least / step).ceil() * step;
        let candidates = (0..2 << DIGITS).map(|i| first + f64::from(i) * step);
        let enough = |spp: &f64| self.noise(*spp) <= room * (1.0 + 1e-9);
        candidates.take_while(|&spp| spp < 2.0 * power).find(enough).unwrap_or(2.0 * power)
    }

    /// Moved so that it goes through `noise` squared at `spp`.
    fn through(self, spp: f64, noise: f64) -> Self {
        Self { at_one: self.at_one + (noise / self.on_line(spp)).ln(), ..self }
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
    let here_now = square / own.noise.powi(2) * line.on_line(here);
    // Samples that know nothing of each other have a slope of one at most.
    let independent = point.knob == SAMPLER && point.value == Sampler::Independent.name();
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

/// The bias of `point`'s setting. That of the scene's own settings is one, whatever the count.
fn bias_of(point: &Point, own: &Point) -> f64 {
    if point.knob == SAMPLES { own.bias } else { point.bias }
}

/// Fills in what follows point by point.
pub(super) fn predict(study: &mut CostStudy, plan: &Plan) {
    study.slope = slope(&study.points);
    let Some(own) = own(study, plan).cloned() else { return };
    let target = study.target.powi(2);
    let mut found = Vec::new();
    for point in &study.points {
        let line = line_of(study, point, &own);
        let room = target - bias_of(point, &own).powi(2);
        let at = (room > 0.0).then(|| {
            let spp = line.map_or(1.0, |line| line.samples(room));
            AtTarget { spp, seconds: spp * seconds_of_sample(study, point, plan) * plan.scale }
        });
        let better = |q: &Point| {
            let (a, b) = ((q.seconds.mean, q.error), (point.seconds.mean, point.error));
            a.0 <= b.0 && a.1 <= b.1 && a != b
        };
        let slope = line.map_or(1.0, |line| line.slope);
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

/// Samples at which the advice can be held against a render in `left` seconds: those of the target, or as many as fit;
/// the error and the seconds that are predicted.
pub(super) fn checkable(study: &CostStudy, point: usize, plan: &Plan, left: f64) -> Option<(u32, f64, f64)> {
    let (point, own) = (study.points.get(point)?, own(study, plan)?);
    let each = seconds_of_sample(study, point, plan);
    let fits = ((left - study.load_s) * 0.8 / each.max(1e-9)).max(f64::from(2 * plan.spp));
    let wanted = point.at_target.map_or(fits, |at| at.spp);
    let spp = wanted.min(fits).clamp(1.0, 1e6) as u32;
    let error = (bias_of(point, own).powi(2) + noise_at(study, point, own, f64::from(spp))).sqrt();
    Some((spp, error, each * f64::from(spp)))
}

#[cfg(test)]
mod tests {
    use super::super::advice::sentences;
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
        // Of variance at n samples: that of each binary digit's set of them, weighted.
        let line = |n: f64| first * first * 8.0 * n.powf(-1.5);
        let variance = |n: u32| -> f64 {
            let sets = (0..32).filter(|d| n >> d & 1 == 1).map(|d| f64::from(1u32 << d));
            sets.map(|set| (set / f64::from(n)).powi(2) * line(set)).sum()
        };
        let few = |n: &u32| n >> (n.ilog2().saturating_sub(3)) << (n.ilog2().saturating_sub(3)) == *n;
        let expected = f64::from((1..1 << 16).filter(few).find(|&n| variance(n) <= 1e-4).expect("some do"));
        assert!(
            (at.spp / expected - 1.0).abs() < 1e-9
                && (at.seconds / (at.spp * 0.025 * 4.0) - 1.0).abs() < 1e-9
        );
        assert!(study.points[2].at_target.is_none(), "its bias is twice the target");
        let (spp, error, _) = checkable(&study, 1, &plan, 1e9).expect("a point");
        assert!((error / variance(spp).sqrt() - 1.0).abs() < 1e-9 && f64::from(spp) == at.spp);
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
        // 10 % at 16 samples, of a variance that falls as their number rises: 1600, in four binary digits.
        assert_eq!(spp[0..2], [1.0, 1.0]);
        assert!((spp[2] - 1664.0).abs() < 1e-6 && spp[3] == 1.0, "{spp:?}");
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
