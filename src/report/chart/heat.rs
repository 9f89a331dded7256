//! A map of cells whose depth of colour is a number: nothing is no colour, the most is the full one.

use super::{At, svg};
use crate::report::escape::escape;
use std::fmt::Write;

/// Cells of a grid.
pub(in crate::report) struct Heat {
    /// Its name.
    pub(in crate::report) what: String,
    /// Names of the axes: across, upwards.
    pub(in crate::report) axes: [&'static str; 2],
    /// Cells across and upwards.
    pub(in crate::report) size: [usize; 2],
    /// By row from below: the number, and what it is.
    pub(in crate::report) cells: Vec<(f64, String)>,
}

const LEFT: f64 = 20.0;
const BOTTOM: f64 = 20.0;
/// Of the longer side.
const SIDE: f64 = 190.0;

/// How deep the colour of `value` is where the most is `most`: by the square root, since few cells have much.
fn depth(value: f64, most: f64) -> f64 {
    let part = value / most;
    if part.is_finite() && part > 0.0 { 0.12 + 0.88 * part.min(1.0).sqrt() } else { 0.0 }
}

/// Draws `map`.
pub(in crate::report) fn heat(map: &Heat) -> String {
    let [across, up] = map.size.map(|n| n.max(1));
    let cell = SIDE / across.max(up) as f64;
    let (width, height) = (cell * across as f64, cell * up as f64);
    let most = map.cells.iter().map(|c| c.0).filter(|v| v.is_finite()).fold(0.0, f64::max);
    let mut out = format!(
        "<rect class=\"field\" x=\"{}\" y=\"1\" width=\"{}\" height=\"{}\"/>",
        At(LEFT),
        At(width),
        At(height)
    );
    for (i, (value, title)) in map.cells.iter().take(across * up).enumerate() {
        let shown = depth(*value, most);
        if shown <= 0.0 {
            continue;
        }
        let _ = write!(
            out,
            "<rect class=\"heat\" fill-opacity=\"{shown:.2}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"><title>{}</title></rect>",
            At(LEFT + (i % across) as f64 * cell),
            At(1.0 + height - (i / across + 1) as f64 * cell),
            At(cell),
            At(cell),
            escape(title)
        );
    }
    let [x, y] = map.axes;
    let _ = write!(
        out,
        "<text class=\"unit mid\" x=\"{}\" y=\"{}\">{}</text><text class=\"unit\" x=\"4\" y=\"{}\">{}</text>",
        At(LEFT + width / 2.0),
        At(height + 16.0),
        escape(x),
        At(1.0 + height / 2.0 + 4.0),
        escape(y)
    );
    svg((LEFT + SIDE + 4.0, height + BOTTOM + 4.0), &map.what, &out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_no_colour_and_the_most_is_full() {
        assert_eq!((depth(0.0, 5.0), depth(5.0, 5.0)), (0.0, 1.0));
        assert_eq!((depth(f64::NAN, 5.0), depth(1.0, 0.0)), (0.0, 0.0));
        assert!(depth(1.0, 4.0) < depth(2.0, 4.0));
        let cells = [0.0, 1.0, 4.0, f64::NAN, f64::INFINITY, 0.0];
        let map = Heat {
            what: "visits".to_owned(),
            axes: ["x", "y"],
            size: [3, 2],
            cells: cells.iter().map(|v| (*v, "a<b".to_owned())).collect(),
        };
        let text = heat(&map);
        assert_eq!(text.matches("class=\"heat\"").count(), 2, "{text}");
        assert!(text.contains("fill-opacity=\"1.00\"") && text.contains("a&lt;b"), "{text}");
        // Rows from below.
        let first = text.split("class=\"heat\"").nth(1).expect("one");
        assert!(first.contains("y=\"64.3\""), "{first}");
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
    }

    #[test]
    fn an_empty_grid_divides_by_nothing() {
        let map = Heat { what: String::new(), axes: ["x", "y"], size: [0, 0], cells: Vec::new() };
        assert!(!heat(&map).contains("NaN"));
    }
}
