//! Lines or dots over an axis, named where they end, with marks across and numbers for the pointer.

use super::{At, Axis, CHARACTER, svg};
use crate::report::escape::escape;
use std::fmt::Write;

/// One line.
pub(in crate::report) struct Series {
    /// Written at its end.
    pub(in crate::report) name: String,
    /// Its colour, of the page's.
    pub(in crate::report) colour: &'static str,
    /// x and y.
    pub(in crate::report) points: Vec<(f64, f64)>,
    /// Points that no line joins.
    pub(in crate::report) dots: bool,
}

/// A line across the chart, and what it says.
pub(in crate::report) struct Mark {
    /// Where.
    pub(in crate::report) at: f64,
    /// What it is.
    pub(in crate::report) text: String,
    /// Its colour, of the page's.
    pub(in crate::report) colour: &'static str,
}

/// A chart of lines.
pub(in crate::report) struct Lines {
    /// Its name.
    pub(in crate::report) what: String,
    /// What is counted across, and what upwards; the axes' units follow.
    pub(in crate::report) titles: (&'static str, &'static str),
    /// Across.
    pub(in crate::report) x: Axis,
    /// Upwards.
    pub(in crate::report) y: Axis,
    /// What is drawn.
    pub(in crate::report) series: Vec<Series>,
    /// Marks at an x.
    pub(in crate::report) upright: Vec<Mark>,
    /// Marks at a y.
    pub(in crate::report) level: Vec<Mark>,
    /// Said when the pointer is nearest to an x. Rising.
    pub(in crate::report) said: Vec<(f64, String)>,
    /// Height of the field.
    pub(in crate::report) height: f64,
}

const WIDTH: f64 = 560.0;
const LEFT: f64 = 46.0;
/// Space between texts that stand one above the other.
const LINE: f64 = 14.0;
/// Strips that say something, at most: more are thinner than a pixel.
const STRIPS: usize = 512;

/// Draws `chart`.
pub(in crate::report) fn lines(chart: &Lines) -> String {
    let named = chart.series.iter().map(|s| s.name.chars().count()).max().unwrap_or(0) as f64;
    let right = WIDTH - (named * CHARACTER + 10.0).max(16.0);
    // Names of marks stand above the field, each in a line of its own: near ones would cover each other.
    let top = LINE * chart.upright.len() as f64 + 22.0;
    let bottom = top + chart.height;
    let x = |v: f64| chart.x.place(v).map(|part| LEFT + (right - LEFT) * part);
    let y = |v: f64| chart.y.place(v).map(|part| bottom - (bottom - top) * part);

    let mut out = String::new();
    for (value, label) in &chart.y.ticks {
        let Some(at) = y(*value) else { continue };
        let _ = write!(out, "<path class=\"grid\" d=\"M{} {}H{}\"/>", At(LEFT), At(at), At(right));
        let _ = write!(
            out,
            "<text class=\"tick end\" x=\"{}\" y=\"{}\">{label}</text>",
            At(LEFT - 6.0),
            At(at + 4.0)
        );
    }
    for (value, label) in &chart.x.ticks {
        let Some(at) = x(*value).map(At) else { continue };
        let _ = write!(out, "<path class=\"grid\" d=\"M{at} {}v5\"/>", At(bottom));
        let _ = write!(
            out,
            "<text class=\"tick mid\" x=\"{at}\" y=\"{}\">{}</text>",
            At(bottom + 17.0),
            escape(label)
        );
    }
    // Names of marks come over all lines, which would strike them through.
    let mut over = String::new();
    for (i, mark) in chart.upright.iter().enumerate() {
        let Some(at) = x(mark.at) else { continue };
        let line = LINE * i as f64 + 11.0;
        let length = mark.text.chars().count() as f64 * CHARACTER;
        // To the right of its line where there is room.
        let (side, text) = if at + length < WIDTH { ("", at + 4.0) } else { (" end", at - 4.0) };
        let (up, down) = (At(line - 9.0), At(bottom));
        let _ = write!(out, "<path class=\"mark s{}\" d=\"M{} {up}V{down}\"/>", mark.colour, At(at));
        let (text, line, said) = (At(text), At(line), escape(&mark.text));
        let _ = write!(over, "<text class=\"value halo{side}\" x=\"{text}\" y=\"{line}\">{said}</text>");
    }
    let _ = write!(
        out,
        "<text class=\"unit halo\" x=\"4\" y=\"{}\">{}</text><text class=\"unit mid\" x=\"{}\" y=\"{}\">{}</text>",
        At(top - 9.0),
        with_unit(chart.titles.1, chart.y.unit),
        At((LEFT + right) / 2.0),
        At(bottom + 33.0),
        with_unit(chart.titles.0, chart.x.unit)
    );
    for mark in &chart.level {
        let Some(at) = y(mark.at) else { continue };
        let (left, right) = (At(LEFT), At(right));
        let _ = write!(out, "<path class=\"mark s{}\" d=\"M{left} {}H{right}\"/>", mark.colour, At(at));
        let (at, text) = (At(at - 4.0), escape(&mark.text));
        let _ = write!(over, "<text class=\"value halo end\" x=\"{right}\" y=\"{at}\">{text}</text>");
    }
    let mut names = Vec::new();
    for series in &chart.series {
        let points: Vec<(f64, f64)> =
            series.points.iter().filter_map(|&(a, b)| Some((x(a)?, y(b)?))).collect();
        let mut path = String::new();
        for (i, &(a, b)) in points.iter().enumerate() {
            let step = if i == 0 || series.dots { 'M' } else { 'L' };
            let dot = if series.dots || points.len() == 1 { "h0" } else { "" };
            let _ = write!(path, "{step}{} {}{dot}", At(a), At(b));
        }
        let Some(&last) = points.last() else { continue };
        let dots = if series.dots || points.len() == 1 { " dots" } else { "" };
        let _ = write!(out, "<path class=\"line{dots} s{}\" d=\"{path}\"/>", series.colour);
        names.push((last, series));
    }
    // Apart from each other, from the top down, and then not below the field.
    names.sort_by(|a, b| a.0.1.total_cmp(&b.0.1));
    let mut places: Vec<f64> = Vec::new();
    for ((_, at), _) in &names {
        places.push(places.last().map_or(*at, |above| at.max(above + LINE)));
    }
    let mut limit = bottom;
    for at in places.iter_mut().rev() {
        *at = at.min(limit);
        limit = *at - LINE;
    }
    for (((from, _), series), at) in names.iter().zip(places) {
        let (from, at) = (At(from + 6.0), At(at + 4.0));
        let _ = write!(
            out,
            "<text class=\"{}\" x=\"{from}\" y=\"{at}\">{}</text>",
            series.colour,
            escape(&series.name)
        );
    }
    out += &over;
    strips(chart, &x, (top, bottom), &mut out);
    svg((WIDTH, bottom + 40.0), &chart.what, &out)
}

fn with_unit(title: &str, unit: &str) -> String {
    if unit.is_empty() { escape(title) } else { format!("{} ({unit})", escape(title)) }
}

/// An upright strip around every x, for the pointer.
fn strips(chart: &Lines, x: &impl Fn(f64) -> Option<f64>, (top, bottom): (f64, f64), out: &mut String) {
    let every = chart.said.len().div_ceil(STRIPS).max(1);
    let at: Vec<(f64, &str)> =
        chart.said.iter().step_by(every).filter_map(|(v, text)| Some((x(*v)?, text.as_str()))).collect();
    let between = |i: usize| (at[i].0 + at[i + 1].0) / 2.0;
    for (i, (place, text)) in at.iter().enumerate() {
        let from = if i == 0 { place - 2.0 } else { between(i - 1) };
        let to = if i + 1 == at.len() { place + 2.0 } else { between(i) };
        let _ = write!(
            out,
            "<rect class=\"strip\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"><title>{}</title></rect>",
            At(from),
            At(top),
            At((to - from).max(0.1)),
            At(bottom - top),
            escape(text)
        );
    }
}

#[cfg(test)]
mod tests {
    use super::super::Kind;
    use super::*;

    fn chart(points: Vec<(f64, f64)>) -> Lines {
        Lines {
            what: "a <chart>".to_owned(),
            titles: ("time", "memory"),
            x: Axis::up_to(10.0, Kind::Seconds, 5.0),
            y: Axis::from_zero(100.0, Kind::Bytes, 4.0),
            said: points.iter().map(|p| (p.0, format!("{p:?} & more"))).collect(),
            series: vec![
                Series { name: "first".to_owned(), colour: "c1", points: points.clone(), dots: false },
                Series { name: "second".to_owned(), colour: "c2", points, dots: true },
            ],
            upright: vec![Mark { at: 5.0, text: "half".to_owned(), colour: "c3" }],
            level: vec![Mark { at: f64::NAN, text: "nowhere".to_owned(), colour: "c3" }],
            height: 100.0,
        }
    }

    #[test]
    fn names_at_the_ends_do_not_cover_each_other() {
        let text = lines(&chart(vec![(0.0, 0.0), (10.0, 1.0)]));
        let y = |name: &str| -> f64 {
            let before = text.split(&format!("\">{name}<")).next().expect("some");
            before.rsplit("y=\"").next().expect("some").parse().expect("a number")
        };
        assert!((y("second") - y("first")).abs() >= LINE - 0.2, "{text}");
        assert!(text.contains("time (s)") && text.contains("memory (B)"), "{text}");
        assert!(text.contains("a &lt;chart&gt;") && text.contains("&amp; more"), "{text}");
    }

    #[test]
    fn what_is_no_number_is_left_out() {
        let text = lines(&chart(vec![(0.0, 1.0), (f64::NAN, 2.0), (1.0, f64::INFINITY), (2.0, 3.0)]));
        let line =
            text.split("class=\"line sc1\" d=\"").nth(1).expect("a line").split('"').next().expect("closed");
        assert_eq!(line.matches(['M', 'L']).count(), 2, "{line}");
        assert!(!text.contains("nowhere"), "{text}");
        let coordinates: String =
            text.split("<title>").map(|t| t.split("</title>").last().unwrap_or("")).collect();
        assert!(!coordinates.contains("NaN") && !coordinates.contains("inf"), "{coordinates}");
        assert!(lines(&chart(Vec::new())).starts_with("<svg"));
    }

    #[test]
    fn many_points_have_not_too_many_strips() {
        let text = lines(&chart((0..5000).map(|i| (f64::from(i) / 500.0, 1.0)).collect()));
        assert!(text.matches("class=\"strip\"").count() <= STRIPS);
    }
}
