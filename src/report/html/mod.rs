//! What a render cost, as one HTML page that stands alone.
//!
//! Invariant: the page asks for nothing: no network, no other file, no script, and its own policy forbids
//! all three. Every number in a chart stands in the page as text too, as the statistics have it.
//! Never measures: what is not in the record is not in the page, and the page says why.

mod caches;
mod curves;
mod memory;
mod overview;
pub(super) mod parts;
pub(super) mod picture;
mod scheduler;
mod time;

use super::escape::escape;
use crate::film::Image;
use crate::stats::RenderStats;
use std::path::Path;

/// The page of `stats`, with the image where it is at hand.
#[must_use]
pub fn html_page(stats: &RenderStats, image: Option<&Image>) -> String {
    let name = Path::new(&stats.scene).file_name().unwrap_or_default().to_string_lossy();
    let caches = [
        caches::Which {
            id: "texture",
            title: "Textures",
            piece: "tile",
            option: "--texture-memory",
            cache: stats.texture_cache.as_ref(),
            curve: &stats.miss_ratio.texture,
            beside: 0,
            why: "No texture came and went in tiles: what the scene reads of images was in memory as a whole.",
        },
        caches::Which {
            id: "geometry",
            title: "Geometry",
            piece: "page",
            option: "--geometry-memory",
            cache: stats.geometry_cache.as_ref(),
            curve: &stats.miss_ratio.geometry,
            // What was asked for holds the geometry that stays as well.
            beside: match (stats.settings.geometry_memory, &stats.geometry_cache) {
                (Some(asked), Some(cache)) => asked.saturating_sub(cache.budget),
                _ => 0,
            },
            why: "No geometry came and went in pages: all of it stayed in memory.",
        },
    ];
    let mut body = overview::section(stats, image);
    body += &time::section(stats);
    body += &memory::section(stats);
    for which in &caches {
        body += &caches::section(which);
    }
    body += &scheduler::section(&stats.scheduler);
    body += &overview::reproduce(stats);
    document(&name, &body)
}

/// A page of this name around `body`, which is markup.
pub(super) fn document(name: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" \
         content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{} – Weir</title>\n\
         <link rel=\"icon\" href=\"data:,\">\n<style>\n{}</style>\n</head>\n<body>\n<main>\n{body}</main>\n</body>\n</html>\n",
        escape(name),
        include_str!("style.css")
    )
}

#[cfg(test)]
mod tests;
