//! A small kit of charts: axes with round ticks, lines, bars, heat maps, each a string of SVG.
//!
//! Invariant: no number that is infinite or not a number reaches the SVG, whatever the data hold; all text
//! is escaped here. Never knows what is drawn.

mod axis;
mod bars;
mod heat;
mod lines;

pub(super) use axis::{Axis, Kind};
pub(super) use bars::{Bar, Part, bars};
pub(super) use heat::{Heat, heat};
pub(super) use lines::{Lines, Mark, Series, lines};

use std::fmt;

/// Width of a character of the charts' text, in their units: generous, since fonts differ.
const CHARACTER: f64 = 8.0;

/// A coordinate, to a tenth; what is not finite is drawn at 0, what is far off not far.
#[derive(Clone, Copy)]
struct At(f64);

impl fmt::Display for At {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tenths = if self.0.is_finite() { (self.0.clamp(-1e5, 1e5) * 10.0).round() } else { 0.0 };
        // Adding zero turns −0 into 0.
        write!(f, "{}", tenths / 10.0 + 0.0)
    }
}

/// What is put around a chart's parts. `label` is what it shows, for those who do not see it.
fn svg((width, height): (f64, f64), label: &str, inside: &str) -> String {
    format!(
        "<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\">{inside}</svg>",
        At(width),
        At(height),
        super::escape::escape(label)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_short_and_finite() {
        for (value, text) in [
            (1.0, "1"),
            (1.25, "1.3"),
            (-0.01, "0"),
            (f64::NAN, "0"),
            (f64::INFINITY, "0"),
            (1e300, "100000"),
        ] {
            assert_eq!(At(value).to_string(), text);
        }
    }
}
