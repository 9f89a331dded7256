//! Axes: from zero in round steps of 1, 2 or 5, or logarithmic, with one unit for all their numbers.
//!
//! Invariant: `low < high`, both finite, and every tick lies between them.

/// What an axis counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::report) enum Kind {
    /// Decimal units.
    Bytes,
    /// Thousands, millions.
    Count,
    /// Seconds, minutes, hours.
    Seconds,
    /// Parts of one, in per cent.
    Share,
}

impl Kind {
    /// The unit in which values up to `high` are short, and what one of it is.
    fn unit(self, high: f64) -> (f64, &'static str) {
        let thousands = |names: [&'static str; 6]| {
            let steps = (high.max(1.0).log10() / 3.0).floor().clamp(0.0, 5.0) as usize;
            (1000f64.powi(steps as i32), names[steps])
        };
        match self {
            Self::Bytes => thousands(["B", "kB", "MB", "GB", "TB", "PB"]),
            Self::Count => thousands(["", "thousand", "million", "billion", "trillion", "quadrillion"]),
            Self::Seconds if high < 1.0 => (1e-3, "ms"),
            Self::Seconds if high < 180.0 => (1.0, "s"),
            Self::Seconds if high < 3.0 * 3600.0 => (60.0, "min"),
            Self::Seconds => (3600.0, "h"),
            Self::Share => (0.01, "%"),
        }
    }
}

/// A range of values and where its ticks are.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::report) struct Axis {
    low: f64,
    high: f64,
    logarithmic: bool,
    /// Values, and what is written at them.
    pub(super) ticks: Vec<(f64, String)>,
    /// Of the ticks' numbers; empty where each says its own.
    pub(super) unit: &'static str,
}

/// The smallest of 1, 2, 5 times a power of ten that is at least `least`, which is positive.
fn round_step(least: f64) -> f64 {
    let power = 10f64.powf(least.log10().floor());
    // A hair of room: 5 may come out of the logarithm as 4.999….
    [1.0, 2.0, 5.0].into_iter().map(|m| m * power).find(|s| *s >= least * 0.999_999).unwrap_or(10.0 * power)
}

impl Axis {
    /// From zero to a round number that is at least `high`, in about `parts` parts.
    pub(in crate::report) fn from_zero(high: f64, kind: Kind, parts: f64) -> Self {
        let high = if high.is_finite() && high > 0.0 { high } else { 1.0 };
        let (one, unit) = kind.unit(high);
        let step = round_step(high / one / parts);
        let last = (high / one / step - 1e-9).ceil().max(1.0);
        let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
        let ticks = (0..=last as u32)
            .map(|i| (f64::from(i) * step * one, format!("{:.decimals$}", f64::from(i) * step)))
            .collect();
        Self { low: 0.0, high: last * step * one, logarithmic: false, ticks, unit }
    }

    /// From zero to exactly `high`: time, which ends when it ends.
    pub(in crate::report) fn up_to(high: f64, kind: Kind, parts: f64) -> Self {
        let mut axis = Self::from_zero(high, kind, parts);
        if high.is_finite() && high > 0.0 {
            axis.high = high;
            axis.ticks.retain(|(value, _)| *value <= high);
        }
        axis
    }

    /// Powers of two or ten between `low` and `high`, both positive.
    pub(in crate::report) fn logarithmic(low: f64, high: f64, label: impl Fn(f64) -> String) -> Self {
        let low = if low.is_finite() && low > 0.0 { low } else { 1.0 };
        let high = if high.is_finite() && high > low { high } else { low * 10.0 };
        let decades = (high / low).log10();
        let steps: &[f64] = if decades < 2.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
        let every = (decades / 7.0).ceil().max(1.0) as usize;
        let ticks = (first..=last)
            .step_by(every)
            .flat_map(|power| steps.iter().map(move |step| step * 10f64.powi(power)))
            .filter(|value| (low..=high).contains(value))
            .map(|value| (value, label(value)))
            .collect();
        Self { low, high, logarithmic: true, ticks, unit: "" }
    }

    /// Where `value` lies: 0 at the low end, 1 at the high one. `None` for what is not on the axis.
    pub(super) fn place(&self, value: f64) -> Option<f64> {
        let part = if self.logarithmic {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        // Rounding at the ends is no reason to lose a point.
        (part.is_finite() && (-1e-6..=1.0 + 1e-6).contains(&part)).then(|| part.clamp(0.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: &Axis) -> Vec<&str> {
        axis.ticks.iter().map(|(_, label)| label.as_str()).collect()
    }

    #[test]
    fn ticks_are_round_and_reach_the_top() {
        for (high, kind, expected, unit) in [
            (168e6, Kind::Bytes, &["0", "50", "100", "150", "200"][..], "MB"),
            (100.0, Kind::Bytes, &["0", "20", "40", "60", "80", "100"], "B"),
            (0.93, Kind::Seconds, &["0", "200", "400", "600", "800", "1000"], "ms"),
            (5.57, Kind::Seconds, &["0", "2", "4", "6"], "s"),
            (600.0, Kind::Seconds, &["0", "2", "4", "6", "8", "10"], "min"),
            (0.0125, Kind::Share, &["0.0", "0.5", "1.0", "1.5"], "%"),
            (1500.0, Kind::Count, &["0.0", "0.5", "1.0", "1.5"], "thousand"),
        ] {
            let axis = Axis::from_zero(high, kind, 5.0);
            assert_eq!((labels(&axis), axis.unit), (expected.to_vec(), unit), "{high}");
            assert!(axis.place(high).is_some() && axis.place(0.0) == Some(0.0));
        }
    }

    #[test]
    fn every_size_has_some_ticks_and_not_many() {
        for i in -60..60 {
            for kind in [Kind::Bytes, Kind::Count, Kind::Seconds, Kind::Share] {
                let high = 10f64.powf(f64::from(i) / 4.0);
                let axis = Axis::from_zero(high, kind, 5.0);
                assert!((2..=7).contains(&axis.ticks.len()), "{high}: {axis:?}");
                let mut unique = labels(&axis);
                unique.dedup();
                assert!(unique.len() == axis.ticks.len() || high < 1e-8, "{high}: {axis:?}");
            }
        }
    }

    #[test]
    fn what_is_no_number_makes_an_axis_all_the_same() {
        for high in [0.0, -3.0, f64::NAN, f64::INFINITY] {
            for axis in [
                Axis::from_zero(high, Kind::Bytes, 5.0),
                Axis::up_to(high, Kind::Seconds, 5.0),
                Axis::logarithmic(high, high, |v| v.to_string()),
            ] {
                assert!(axis.low < axis.high && axis.high.is_finite(), "{axis:?}");
                assert_eq!(axis.place(f64::NAN), None);
                assert_eq!(axis.place(f64::INFINITY), None);
            }
        }
        assert_eq!(Axis::logarithmic(1.0, 10.0, |v| v.to_string()).place(0.0), None);
    }

    #[test]
    fn a_logarithmic_axis_has_a_few_ticks() {
        let label = |v: f64| v.to_string();
        let wide = Axis::logarithmic(3e4, 2.5e8, label);
        assert_eq!(labels(&wide), ["100000", "1000000", "10000000", "100000000"]);
        assert_eq!(labels(&Axis::logarithmic(150.0, 1100.0, label)), ["200", "500", "1000"]);
        assert!((wide.place((3e4f64 * 2.5e8).sqrt()).expect("on it") - 0.5).abs() < 1e-12);
        assert!(Axis::logarithmic(1.0, 1e15, label).ticks.len() <= 8);
    }
}
