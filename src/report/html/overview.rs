//! The head of the page: the image and the numbers that come first; and its foot: how to do it again.

use super::parts::{absent, exact, number};
use super::picture::data_uri;
use crate::film::Image;
use crate::report::escape::{escape, shell_quoted};
use crate::report::{bytes, count, seconds};
use crate::stats::RenderStats;
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;

/// Title, image, main numbers.
pub(super) fn section(stats: &RenderStats, image: Option<&Image>) -> String {
    let name = Path::new(&stats.scene).file_name().unwrap_or_default().to_string_lossy();
    let mut out = format!(
        "<header><h1>{}</h1><p class=\"soft\">{}, rendered by Weir {}</p></header>\n",
        escape(&name),
        escape(&stats.scene),
        escape(&stats.weir)
    );
    if stats.interrupted {
        out += "<p class=\"warning\">It was stopped before its last sample.</p>\n";
    }
    if stats.image.non_finite_samples > 0 {
        let n = stats.image.non_finite_samples;
        let shown = number("/image/non_finite_samples", &n, &n.to_string());
        let _ = writeln!(out, "<p class=\"warning\">{shown} samples were infinite or not a number.</p>");
    }
    out += &picture(stats, image);
    out += "<dl class=\"numbers\">\n";
    let mut card = |title: &str, shown: &str| {
        let _ = writeln!(out, "<div><dt>{title}</dt><dd>{shown}</dd></div>");
    };
    let (time, memory, rays) = (&stats.time, &stats.memory, &stats.rays);
    card("in all", &number("/time/total_s", &time.total_s, &seconds(time.total_s)));
    card("rendering", &number("/time/render_s", &time.render_s, &seconds(time.render_s)));
    card(
        "first pixel after",
        &number("/time/first_pixel_s", &time.first_pixel_s, &seconds(time.first_pixel_s)),
    );
    card("samples", &number("/image/samples", &stats.image.samples, &count(stats.image.samples as f64)));
    // Follows from two numbers that stand in the record; it does not itself.
    card("samples a second", &count(stats.samples_per_second()));
    card("rays a second", &number("/rays/per_second", &rays.per_second, &count(rays.per_second)));
    card("closest-hit rays", &number("/rays/closest", &rays.closest, &count(rays.closest as f64)));
    card("occlusion rays", &number("/rays/occluded", &rays.occluded, &count(rays.occluded as f64)));
    let peak = memory.peak_rss.map_or("unknown".to_owned(), bytes);
    card("peak memory", &number("/memory/peak_rss", &memory.peak_rss, &peak));
    card("threads", &number("/threads", &stats.threads, &stats.threads.to_string()));
    card("threads busy", &number("/busy", &stats.busy, &format!("{:.1} %", stats.busy * 100.0)));
    out + "</dl>\n"
}

fn picture(stats: &RenderStats, image: Option<&Image>) -> String {
    let Some(image) = image else {
        return absent("image", "The image is not in the statistics; `weir render --report` puts it here.");
    };
    let (uri, (width, height)) = data_uri(image);
    let smaller = if width < image.width { format!("; shown at {width} × {height}") } else { String::new() };
    format!(
        "<figure class=\"picture\" id=\"image\"><img src=\"{uri}\" width=\"{width}\" height=\"{height}\" \
         alt=\"the rendered image\"><figcaption>{} × {} pixels, {} samples per pixel{}{smaller}</figcaption></figure>\n",
        number("/image/width", &stats.image.width, &stats.image.width.to_string()),
        number("/image/height", &stats.image.height, &stats.image.height.to_string()),
        number("/image/spp", &stats.image.spp, &stats.image.spp.to_string()),
        error(stats),
    )
}

/// How samples are spread, and the error that they tell of, where that was asked for.
fn error(stats: &RenderStats) -> String {
    let image = &stats.image;
    let (Some(least), Some(most), Some(noise)) = (image.spp_min, image.spp_max, stats.settings.noise) else {
        return String::new();
    };
    let mut out = format!(
        ", {} at least and {} at most; a relative error of {} was asked for",
        number("/image/spp_min", &least, &least.to_string()),
        number("/image/spp_max", &most, &most.to_string()),
        number("/settings/noise", &noise, &format!("{:.2} %", noise * 100.0)),
    );
    if let Some(relmse) = image.estimated_relmse {
        let shown = number("/image/estimated_relmse", &relmse, &format!("{relmse:.3e}"));
        let _ = write!(out, ", and estimated are {:.2} % (relMSE {shown})", relmse.sqrt() * 100.0);
    }
    out
}

/// The command line and the settings.
pub(super) fn reproduce(stats: &RenderStats) -> String {
    let mut out = "<section><h2>To do it again</h2>\n".to_owned();
    if stats.command.is_empty() {
        out += &absent(
            "command",
            "The record has no command line; the settings below are those that were in force.",
        );
    } else {
        let line: Vec<String> = stats.command.iter().map(|argument| shell_quoted(argument)).collect();
        let _ = writeln!(out, "<pre id=\"command\">{}</pre>", escape(&line.join(" ")));
    }
    let _ = writeln!(
        out,
        "<p class=\"soft\">The image depends on the scene, the settings and the seed alone. These were in force, \
         what the scene says and defaults included:</p>\n<div class=\"table\"><table id=\"settings\"><tbody>"
    );
    let settings = serde_json::to_value(&stats.settings).expect("plain data");
    for (name, value) in settings.as_object().into_iter().flatten() {
        let shown = match value {
            Value::Null => "not given".to_owned(),
            Value::Bool(on) => if *on { "yes" } else { "no" }.to_owned(),
            Value::String(text) => text.clone(),
            other => exact(other),
        };
        let shown = number(&format!("/settings/{name}"), value, &shown);
        let _ = writeln!(out, "<tr><td>{}</td><td>{shown}</td></tr>", escape(&name.replace('_', " ")));
    }
    out + "</tbody></table></div></section>\n"
}
