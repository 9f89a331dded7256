//! Horizontal bars of parts, one under the other, on one axis from zero.

use super::{At, Axis, CHARACTER, Kind, svg};
use crate::report::escape::{escape, shorten};
use std::fmt::Write;

/// A piece of a bar.
pub(in crate::report) struct Part {
    /// How long it is.
    pub(in crate::report) value: f64,
    /// Its colour, of the page's.
    pub(in crate::report) colour: &'static str,
    /// What it is, with its number.
    pub(in crate::report) title: String,
}

/// A row.
pub(in crate::report) struct Bar {
    /// On the left.
    pub(in crate::report) label: String,
    /// The whole of what the label is short for.
    pub(in crate::report) name: String,
    /// Where the first part begins.
    pub(in crate::report) from: f64,
    /// Beside each other.
    pub(in crate::report) parts: Vec<Part>,
    /// To the right of them.
    pub(in crate::report) text: String,
}

const WIDTH: f64 = 560.0;
const ROW: f64 = 24.0;
const THICK: f64 = 15.0;
const BOTTOM: f64 = 34.0;
/// Characters of a label.
const LABEL: usize = 24;

/// Draws `rows`; `what` is the chart's name.
pub(in crate::report) fn bars(what: &str, kind: Kind, rows: &[Bar]) -> String {
    let finite = |v: f64| if v.is_finite() { v.max(0.0) } else { 0.0 };
    let end = |row: &Bar| finite(row.from) + row.parts.iter().map(|p| finite(p.value)).sum::<f64>();
    let axis = Axis::from_zero(rows.iter().map(end).fold(0.0, f64::max), kind, 5.0);
    let widest = |texts: &mut dyn Iterator<Item = &str>| {
        texts.map(|t| t.chars().count().min(LABEL)).max().unwrap_or(0) as f64 * CHARACTER
    };
    let left = widest(&mut rows.iter().map(|r| r.label.as_str())) + 12.0;
    let text = rows.iter().map(|r| r.text.chars().count()).max().unwrap_or(0) as f64 * CHARACTER;
    let right = WIDTH - text - 10.0;
    let bottom = rows.len() as f64 * ROW + 4.0;
    let x = |value: f64| left + (right - left) * axis.place(value).unwrap_or(0.0);

    let mut out = String::new();
    for (value, label) in &axis.ticks {
        let at = At(x(*value));
        let (low, high) = (At(bottom), At(bottom + 16.0));
        let _ = write!(out, "<path class=\"grid\" d=\"M{at} 0V{low}\"/>");
        let _ = write!(out, "<text class=\"tick mid\" x=\"{at}\" y=\"{high}\">{label}</text>");
    }
    let (middle, low) = (At((left + right) / 2.0), At(bottom + 31.0));
    let _ = write!(out, "<text class=\"unit mid\" x=\"{middle}\" y=\"{low}\">{}</text>", axis.unit);
    for (i, row) in rows.iter().enumerate() {
        let top = i as f64 * ROW + (ROW - THICK) / 2.0 + 2.0;
        let line = At(top + THICK - 3.0);
        let _ = write!(
            out,
            "<text class=\"end\" x=\"{}\" y=\"{line}\"><title>{}</title>{}</text>",
            At(left - 8.0),
            escape(&row.name),
            escape(&shorten(&row.label, LABEL))
        );
        let mut from = finite(row.from);
        for part in &row.parts {
            let to = from + finite(part.value);
            // Something is to be seen of whatever is not nothing.
            let least = if part.value > 0.0 { 1.0 } else { 0.0 };
            let _ = write!(
                out,
                "<rect class=\"{}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"><title>{}</title></rect>",
                part.colour,
                At(x(from)),
                At(top),
                At((x(to) - x(from)).max(least)),
                At(THICK),
                escape(&part.title)
            );
            from = to;
        }
        let _ = write!(
            out,
            "<text class=\"value\" x=\"{}\" y=\"{line}\">{}</text>",
            At(x(from) + 6.0),
            escape(&row.text)
        );
    }
    svg((WIDTH, bottom + BOTTOM), what, &out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(value: f64) -> Part {
        Part { value, colour: "c1", title: format!("<{value}>") }
    }

    #[test]
    fn parts_stand_beside_each_other() {
        let row = |from, parts: &[f64]| Bar {
            label: "a & b".to_owned(),
            name: String::new(),
            from,
            parts: parts.iter().map(|v| part(*v)).collect(),
            text: "1".to_owned(),
        };
        let text = bars("times", Kind::Count, &[row(0.0, &[2.0, 3.0]), row(5.0, &[5.0])]);
        let xs: Vec<(f64, f64)> = text
            .split("<rect ")
            .skip(1)
            .map(|r| {
                let number = |name: &str| {
                    let from = r.split(&format!("{name}=\"")).nth(1).expect("there");
                    from.split('"').next().expect("closed").parse::<f64>().expect("a number")
                };
                (number(" x"), number("width"))
            })
            .collect();
        assert_eq!(xs.len(), 3);
        // Coordinates are rounded to a tenth.
        assert!((xs[0].0 + xs[0].1 - xs[1].0).abs() < 0.2, "{xs:?}");
        assert!((xs[1].0 + xs[1].1 - xs[2].0).abs() < 0.2, "{xs:?}");
        assert!((xs[0].1 / xs[1].1 - 2.0 / 3.0).abs() < 0.01, "{xs:?}");
        assert!(text.contains("a &amp; b") && text.contains("&lt;2&gt;"), "{text}");
    }

    #[test]
    fn no_data_and_no_numbers_still_make_a_chart() {
        for rows in [
            vec![],
            vec![Bar {
                label: String::new(),
                name: String::new(),
                from: f64::NAN,
                parts: vec![part(f64::NAN), part(f64::INFINITY), part(-1.0)],
                text: String::new(),
            }],
        ] {
            let text = bars("nothing", Kind::Seconds, &rows);
            let coordinates = text.replace("<title>&lt;NaN&gt;", "").replace("<title>&lt;inf&gt;", "");
            assert!(!coordinates.contains("NaN") && !coordinates.contains("inf"), "{text}");
            assert!(!text.contains("width=\"-"), "{text}");
        }
    }
}
