//! A study of cost as text.

use super::record::{CostStudy, Point};
use crate::report::seconds;
use std::fmt::Write;

/// An error or a share, two digits: `0.84 %`, `12 %`.
#[must_use]
pub fn per_cent(share: f64) -> String {
    let value = share * 100.0;
    match value {
        0.0 => "0 %".to_owned(),
        v if v < 0.095 => format!("{v:.3} %"),
        v if v < 0.995 => format!("{v:.2} %"),
        v if v < 9.95 => format!("{v:.1} %"),
        v => format!("{v:.0} %"),
    }
}

/// The study for a person to read.
#[must_use]
pub fn write_cost(study: &CostStudy) -> String {
    let mut out = String::new();
    for line in &study.advice {
        let _ = writeln!(out, "{line}");
    }
    let [w, h] = study.size;
    let reference = &study.reference;
    let _ = writeln!(
        out,
        "\nerrors are root mean square relative errors (relMSE, epsilon {}), of {w}x{h} pixels, held against {}",
        study.epsilon,
        match (&reference.file, reference.error) {
            (Some(file), _) => format!("{file}, whose own error is not known"),
            (None, error) => format!(
                "{} samples per pixel to depth {} ({}), whose own error is {}",
                reference.spp,
                reference.max_depth,
                seconds(reference.seconds),
                error.map_or("unknown".to_owned(), per_cent)
            ),
        }
    );
    let _ = writeln!(
        out,
        "times are processor seconds over threads; that to {} is for {}x{} pixels on {} threads, without {} of loading; noise falls with samples^-{:.2}\n",
        per_cent(study.target),
        study.full_size[0],
        study.full_size[1],
        study.threads,
        seconds(study.load_s),
        study.slope / 2.0
    );
    // What is put together has a long name, which stands above.
    let shown = |p: &Point| if p.knob == "together" { "as above".to_owned() } else { p.value.clone() };
    let _ = writeln!(
        out,
        "{:<12} {:<14} {:>5} {:>7} {:>9} {:>8} {:>8} {:>8} {:>8}  {:>10} {:>6}",
        "knob", "value", "spp", "renders", "time", "error", "noise", "bias", "light", "at target", "times"
    );
    for point in &study.points {
        let (Point { knob, spp, renders, .. }, value) = (point, shown(point));
        let bias =
            if point.bias > 0.0 { per_cent(point.bias) } else { format!("<{}", per_cent(point.bias_bound)) };
        let _ = writeln!(
            out,
            "{knob:<12} {value:<14} {spp:>5} {renders:>7} {:>9} {:>8} {:>8} {bias:>8} {:>8}  {:>10} {:>6}{}",
            seconds(point.seconds.mean),
            per_cent(point.error),
            per_cent(point.noise),
            point.light.map_or(String::new(), |light| format!("{:+.2} %", light.mean * 100.0)),
            point.at_target.map_or("never".to_owned(), |at| seconds(at.seconds)),
            point.over_own.map_or(String::new(), |times| format!("{times:.2}")),
            if point.best { " *" } else { "" }
        );
    }
    let _ = writeln!(out, "* nothing that was measured has less error in less time");
    for check in &study.checks {
        let _ = writeln!(
            out,
            "checked: {} at {} samples: predicted {} in {}, measured {} in {}",
            if check.options.is_empty() { "the scene's own settings" } else { &check.options },
            check.spp,
            per_cent(check.predicted),
            seconds(check.predicted_s),
            per_cent(check.measured),
            seconds(check.measured_s)
        );
    }
    for left in &study.left_out {
        let _ = writeln!(out, "not measured: {}: {}", left.knob, left.because);
    }
    out
}
