//! A study of cost as one page: what to do, error over time, crops at equal time, every number.

use super::record::{CostStudy, Picture, Point};
use super::text::per_cent;
use crate::film::Image;
use crate::report::chart::{Axis, Lines, Mark, Series, lines};
use crate::report::escape::escape;
use crate::report::html::document;
use crate::report::html::parts::{drawing, figure, number, numbers};
use crate::report::html::picture::data_uri;
use crate::report::seconds;
use std::fmt::Write;
use std::path::Path;

/// Pixels of a crop, across and down.
const CROP: u32 = 72;
/// Crops beside the reference, at most.
const CROPS: usize = 7;
/// Colours of knobs, in the order in which they come.
const COLOURS: [&str; 6] = ["c2", "c3", "c4", "c5", "c6", "c0"];

/// The page of `study`, with the reference and renders that took equally long.
#[must_use]
pub fn cost_page(study: &CostStudy, reference: &Image, pictures: &[Picture]) -> String {
    let name = Path::new(&study.scene).file_name().unwrap_or_default().to_string_lossy();
    let mut body = format!(
        "<header><h1>What accuracy costs: {}</h1><p class=\"soft\">{}, by Weir {}</p></header>\n",
        escape(&name),
        escape(&study.scene),
        escape(&study.weir)
    );
    for sentence in &study.advice {
        let _ = writeln!(body, "<p class=\"advice\">{}</p>", escape(sentence));
    }
    body += &cards(study);
    let _ = writeln!(body, "<section><h2>What was measured</h2>{}</section>", chart(study));
    body += &crops(study, reference, pictures);
    let _ = writeln!(body, "<section><h2>Every setting</h2>{}{}</section>", table(study), notes(study));
    document(&format!("{name}: cost"), &body)
}

fn cards(study: &CostStudy) -> String {
    let mut out = "<dl class=\"numbers\">\n".to_owned();
    let mut card = |title: &str, shown: &str| {
        let _ = writeln!(out, "<div><dt>{title}</dt><dd>{shown}</dd></div>");
    };
    card("error that is wanted", &number("/target", &study.target, &per_cent(study.target)));
    let own = study.reference.error;
    card(
        "the reference’s own",
        &number("/reference/error", &own, &own.map_or("unknown".to_owned(), per_cent)),
    );
    card("its samples", &number("/reference/spp", &study.reference.spp, &study.reference.spp.to_string()));
    card("noise falls with", &format!("samples<sup>−{:.2}</sup>", study.slope / 2.0));
    card("the study took", &number("/spent_s", &study.spent_s, &seconds(study.spent_s)));
    card("loading, once", &number("/load_s", &study.load_s, &seconds(study.load_s)));
    card("threads", &number("/threads", &study.threads, &study.threads.to_string()));
    out + "</dl>\n"
}

/// Names of all knobs, in the order in which they come.
fn knobs(study: &CostStudy) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for point in &study.points {
        if !names.contains(&point.knob.as_str()) {
            names.push(&point.knob);
        }
    }
    names
}

fn chart(study: &CostStudy) -> String {
    let at = |p: &Point| (p.seconds.mean, p.error);
    let drawn = || study.points.iter().filter(|p| p.error > 0.0 && p.seconds.mean > 0.0);
    let range = |of: &dyn Fn(&Point) -> f64| {
        let (low, high) = drawn().map(of).fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
        (low * 0.8, high * 1.25)
    };
    let ((x0, mut x1), (mut y0, y1)) = (range(&|p| p.seconds.mean), range(&|p| p.error));
    // As far as the error that is wanted, where that is not far.
    let scale = |size: [u32; 2]| f64::from(size[0]) * f64::from(size[1]);
    let own = study.points.iter().rfind(|p| p.knob == "samples").and_then(|p| p.at_target);
    let reached = own.map(|at| at.seconds * scale(study.size) / scale(study.full_size).max(1.0));
    let predicted = reached.filter(|seconds| *seconds < x1 * 30.0);
    if let Some(seconds) = predicted {
        (x1, y0) = (x1.max(seconds * 1.25), y0.min(study.target * 0.8));
    }
    let mut series = Vec::new();
    let mut colours = COLOURS.into_iter().cycle();
    for knob in knobs(study) {
        let own = knob == "samples";
        let points: Vec<(f64, f64)> = drawn().filter(|p| p.knob == knob).map(at).collect();
        let colour = if own { "c1" } else { colours.next().unwrap_or("c0") };
        series.push(Series { name: knob.to_owned(), colour, points, dots: !own });
    }
    if let Some(first) = drawn().find(|p| p.knob == "samples") {
        let (x, y) = at(first);
        let guide = vec![(x, y), (x1, y * (x1 / x).powf(-0.5))];
        series.push(Series { name: "slope −½".to_owned(), colour: "c0", points: guide, dots: false });
    }
    let last = study.points.iter().rfind(|p| p.knob == "samples").map(at);
    if let (Some(from), Some(seconds)) = (last, predicted.filter(|s| last.is_some_and(|l| *s > l.0))) {
        let points = vec![from, (seconds, study.target)];
        series.push(Series { name: "predicted".to_owned(), colour: "c6", points, dots: false });
    }
    let mut front: Vec<(f64, f64)> = drawn().filter(|p| p.best).map(at).collect();
    front.sort_by(|a, b| a.0.total_cmp(&b.0));
    series.push(Series { name: "the best".to_owned(), colour: "c3", points: front, dots: false });
    let mut said: Vec<(f64, String)> = drawn()
        .map(|p| {
            let text = format!(
                "{} {}: {} in {}, {} samples",
                p.knob,
                p.value,
                per_cent(p.error),
                seconds(p.seconds.mean),
                p.spp
            );
            (p.seconds.mean, text)
        })
        .collect();
    said.sort_by(|a, b| a.0.total_cmp(&b.0));
    let chart = Lines {
        what: "error over seconds of rendering, both logarithmic".to_owned(),
        titles: ("seconds of rendering", "error"),
        x: Axis::logarithmic(x0, x1, seconds),
        y: Axis::logarithmic(y0, y1, per_cent),
        series,
        upright: Vec::new(),
        level: vec![Mark {
            at: study.target,
            text: format!("wanted {}", per_cent(study.target)),
            colour: "c4",
        }],
        said,
        height: 300.0,
    };
    let said = "Root mean square relative error against the reference, by seconds of one render; the line is the scene as it \
                is set with more and more samples, dots are other settings at one sample count.";
    figure("chart-cost", "Error over time", said, &drawing(&lines(&chart)))
}

/// The setting of a knob that shows most: the worst at equal time; of the scene's own and of all together the last.
fn shown<'p>(study: &CostStudy, pictures: &'p [Picture]) -> Vec<&'p Picture> {
    let mut chosen: Vec<&Picture> = Vec::new();
    for knob in knobs(study) {
        let of =
            pictures.iter().filter(|p| study.points.get(p.point).is_some_and(|point| point.knob == knob));
        let error = |p: &Picture| {
            let point = &study.points[p.point];
            point.bias.hypot(point.noise * (f64::from(point.spp) / f64::from(p.spp.max(1))).sqrt())
        };
        chosen.extend(of.max_by(|a, b| error(a).total_cmp(&error(b))));
    }
    let first = chosen.iter().position(|p| study.points[p.point].knob == "together");
    if let Some(at) = first {
        let together = chosen.remove(at);
        chosen.insert(1.min(chosen.len()), together);
    }
    chosen.truncate(CROPS);
    chosen
}

fn crops(study: &CostStudy, reference: &Image, pictures: &[Picture]) -> String {
    let shown = shown(study, pictures);
    let same = |p: &&&Picture| (p.image.width, p.image.height) == (reference.width, reference.height);
    let Some(first) = shown.iter().find(same) else { return String::new() };
    let window = window(&first.image, reference);
    let mut out = "<section><h2>At equal time</h2><p class=\"said\">The window in which the scene’s own settings are farthest \
                   off, and below each its difference from the reference: black where there is none, white where it is as large as \
                   the reference.</p>\n<div class=\"crops\">\n"
        .to_owned();
    let mut one = |images: &[Image], what: &str, caption: &str| {
        out += "<figure>";
        for image in images {
            let (uri, (w, h)) = data_uri(image);
            let _ = write!(out, "<img src=\"{uri}\" width=\"{w}\" height=\"{h}\" alt=\"{}\">", escape(what));
        }
        let _ =
            writeln!(out, "<figcaption><b>{}</b><br>{}</figcaption></figure>", escape(what), escape(caption));
    };
    let spp = study.reference.spp;
    let caption = if spp > 0 { format!("{spp} samples") } else { "as given".to_owned() };
    one(&[cut(reference, window)], "reference", &caption);
    for picture in shown.iter().filter(same) {
        let point = &study.points[picture.point];
        let what = if point.knob == "samples" {
            "as it is set".to_owned()
        } else {
            format!("{}: {}", point.knob, point.value)
        };
        let caption = format!("{} samples, {}", picture.spp, seconds(picture.seconds));
        one(&[cut(&picture.image, window), difference(&picture.image, reference, window)], &what, &caption);
    }
    out + "</div></section>\n"
}

/// How far `a` is off at a pixel, beside what is right; at most 1.
fn off(a: [f32; 3], right: [f32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|c| {
        let value = (a[c] - right[c]).abs() / (right[c].abs() + 0.1);
        if value.is_finite() { value.min(1.0) } else { 1.0 }
    })
}

/// Left upper corner and size of the window in which `image` is farthest from `reference`.
fn window(image: &Image, reference: &Image) -> [u32; 4] {
    let (w, h) = (CROP.min(image.width), CROP.min(image.height));
    let sum = |x0: u32, y0: u32| -> f64 {
        let rows = (y0..y0 + h).flat_map(|y| (x0..x0 + w).map(move |x| (x, y)));
        rows.map(|(x, y)| {
            let i = image.index(x, y);
            off(image.pixels[i], reference.pixels[i]).iter().map(|v| f64::from(*v)).sum::<f64>()
        })
        .sum()
    };
    let places = |most: u32| (0..=most).step_by(24).chain([most]);
    let all = places(image.height - h).flat_map(|y| places(image.width - w).map(move |x| (x, y)));
    let (x, y) = all.max_by(|a, b| sum(a.0, a.1).total_cmp(&sum(b.0, b.1))).unwrap_or((0, 0));
    [x, y, w, h]
}

fn cut(image: &Image, [x0, y0, w, h]: [u32; 4]) -> Image {
    let mut out = Image::new(w, h);
    for y in 0..h {
        for x in 0..w {
            let at = out.index(x, y);
            out.pixels[at] = image.pixels[image.index(x0 + x, y0 + y)];
        }
    }
    out
}

fn difference(image: &Image, reference: &Image, window: [u32; 4]) -> Image {
    let (mut out, right) = (cut(image, window), cut(reference, window));
    for (pixel, right) in out.pixels.iter_mut().zip(&right.pixels) {
        *pixel = off(*pixel, *right);
    }
    out
}

fn table(study: &CostStudy) -> String {
    let mut out = "<div class=\"table\"><table><thead><tr><th>knob</th><th>value</th><th>samples</th><th>renders</th>\
                   <th>time</th><th>error</th><th>noise</th><th>bias</th><th>light</th><th>at the wanted error</th><th>times own</th></tr></thead><tbody>\n"
        .to_owned();
    for (i, p) in study.points.iter().enumerate() {
        let of =
            |field: &str, value: f64, shown: &str| number(&format!("/points/{i}/{field}"), &value, shown);
        let bias = if p.bias > 0.0 {
            of("bias", p.bias, &per_cent(p.bias))
        } else {
            of("bias_bound", p.bias_bound, &format!("<{}", per_cent(p.bias_bound)))
        };
        let at = p
            .at_target
            .map_or("never".to_owned(), |at| of("at_target/seconds", at.seconds, &seconds(at.seconds)));
        let times = p.over_own.map_or(String::new(), |t| of("over_own", t, &format!("{t:.2}")));
        let light =
            p.light.map_or(String::new(), |l| of("light/mean", l.mean, &format!("{:+.2} %", l.mean * 100.0)));
        let best = if p.best { " ★" } else { "" };
        let _ = writeln!(
            out,
            "<tr><td>{}</td><td>{}{best}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{bias}</td><td>{light}</td><td>{at}</td><td>{times}</td></tr>",
            escape(&p.knob),
            escape(&p.value),
            p.spp,
            p.renders,
            of("seconds/mean", p.seconds.mean, &seconds(p.seconds.mean)),
            of("error", p.error, &per_cent(p.error)),
            of("noise", p.noise, &per_cent(p.noise)),
        );
    }
    let columns: [(&str, &str); 9] = [
        ("knob", "knob"),
        ("value", "value"),
        ("spp", "samples"),
        ("seconds/mean", "s"),
        ("seconds/deviation", "± s"),
        ("relmse", "relMSE of each"),
        ("bias_bound", "bias at most"),
        ("over_own_deviation", "± of the logarithm of times own"),
        ("options", "options"),
    ];
    out + "</tbody></table></div><p class=\"said\">★ nothing that was measured has less error in less time. Bias: what stays \
           however many samples are taken; &lt; where it cannot be told from none. Light: how much more there is in all than in \
           renders of the same seeds with the scene’s own settings.</p>"
        + &numbers("All numbers", "/points", &study.points, &columns)
}

fn notes(study: &CostStudy) -> String {
    let mut out = String::new();
    for (i, check) in study.checks.iter().enumerate() {
        let of =
            |field: &str, value: f64, shown: &str| number(&format!("/checks/{i}/{field}"), &value, shown);
        let options = if check.options.is_empty() { "the scene’s own settings" } else { &check.options };
        let _ = writeln!(
            out,
            "<p>Checked: {} at {} samples was to have {} in {}, and had {} in {}.</p>",
            escape(options),
            check.spp,
            of("predicted", check.predicted, &per_cent(check.predicted)),
            of("predicted_s", check.predicted_s, &seconds(check.predicted_s)),
            of("measured", check.measured, &per_cent(check.measured)),
            of("measured_s", check.measured_s, &seconds(check.measured_s)),
        );
    }
    for left in &study.left_out {
        let _ = writeln!(
            out,
            "<p class=\"said\">Not measured: {}: {}.</p>",
            escape(&left.knob),
            escape(&left.because)
        );
    }
    out
}
