//! Values of options: sizes, times, windows. Each error says what would be right; clap puts the
//! option's name before it.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use std::ops::RangeInclusive;
use weir::geometry::pages::{LEAST_PAGE_BYTES, MOST_PAGE_BYTES};
use weir::prepare::EFFECTS;

/// One of `all`, by the name that `name` gives it.
pub(super) fn named<T: Copy + Send + Sync>(
    all: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    let find = move |text: String| *all.iter().find(|one| name(**one) == text).expect("one of them");
    PossibleValuesParser::new(all.iter().map(|one| name(*one))).map(find)
}

/// An effect by name, with underscores or hyphens, or `all`.
pub(super) fn effect(text: &str) -> Result<String, String> {
    let name = text.trim().replace(['-', ' '], "_");
    if name == "all" || EFFECTS.contains(&&*name) {
        Ok(name)
    } else {
        Err(format!("`{text}` is no effect; all is, or one of {}", EFFECTS.join(", ")))
    }
}

/// Bytes of a page of geometry.
pub(super) fn page_bytes(text: &str) -> Result<u64, String> {
    let bytes = bytes(text)?;
    let (least, most) = (LEAST_PAGE_BYTES as u64, MOST_PAGE_BYTES as u64);
    if (least..=most).contains(&bytes) {
        Ok(bytes)
    } else {
        Err(format!("`{text}` is not from {least} to {most} bytes; 16K or 64K is"))
    }
}

/// Bytes: `65536`, `512M`, `1.5G` (powers of 1024).
pub(super) fn bytes(text: &str) -> Result<u64, String> {
    let wrong = || format!("`{text}` is not a number of bytes; 65536, 512M or 1.5G is");
    let text = text.trim();
    let (number, scale) = match text.char_indices().next_back() {
        Some((i, 'k' | 'K')) => (&text[..i], 1u64 << 10),
        Some((i, 'm' | 'M')) => (&text[..i], 1 << 20),
        Some((i, 'g' | 'G')) => (&text[..i], 1 << 30),
        Some((i, 't' | 'T')) => (&text[..i], 1 << 40),
        _ => (text, 1),
    };
    let number: f64 = number.parse().map_err(|_| wrong())?;
    let bytes = number * scale as f64;
    if !(1.0..1e18).contains(&bytes) {
        return Err(wrong());
    }
    Ok(bytes as u64)
}

/// [`bytes`], or 0.
pub(super) fn bytes_or_none(text: &str) -> Result<u64, String> {
    if text.trim() == "0" { Ok(0) } else { bytes(text) }
}

/// Milliseconds of a simulated delay, up to a minute.
pub(super) fn milliseconds(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(ms) if (0.0..=60_000.0).contains(&ms) => Ok(ms),
        _ => Err(format!("`{text}` is not a number of milliseconds from 0 to 60000")),
    }
}

/// Most pixels of a film: 2²⁸, whose sums take 4 GiB.
const MAX_PIXELS: u64 = 1 << 28;

/// `1280x720`.
pub(super) fn size(text: &str) -> Result<(u32, u32), String> {
    let (width, height) = text
        .split_once(['x', 'X', '×'])
        .and_then(|(w, h)| Some((w.trim().parse::<u32>().ok()?, h.trim().parse::<u32>().ok()?)))
        .filter(|&(w, h)| w > 0 && h > 0)
        .ok_or("width and height in pixels are needed, as in 1280x720")?;
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(format!("at most {MAX_PIXELS} pixels are possible"));
    }
    Ok((width, height))
}

/// `x0,y0,x1,y1`.
pub(super) fn crop(text: &str) -> Result<[u32; 4], String> {
    let numbers: Option<Vec<u32>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x0, y0, x1, y1]) if x0 < x1 && y0 < y1 => Ok([x0, y0, x1, y1]),
        Some([_, _, _, _]) => Err("x1 must be above x0, and y1 above y0".to_owned()),
        _ => Err("four whole numbers of pixels are needed, as in 100,50,300,200".to_owned()),
    }
}

/// A relative error: `0.02`, `2%`.
pub(super) fn noise(text: &str) -> Result<f64, String> {
    let trimmed = text.trim();
    let (number, scale) = match trimmed.strip_suffix('%') {
        Some(number) => (number.trim_end(), 100.0),
        None => (trimmed, 1.0),
    };
    match number.parse::<f64>().map(|number| number / scale) {
        Ok(noise) if (1e-4..=1.0).contains(&noise) => Ok(noise),
        _ => Err(format!("`{text}` is not an error from 0.0001 to 1; 0.02 or 2% is")),
    }
}

/// Seconds from `60s`, `90`, `1.5m`, `2h`, `500ms`.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let split = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let (number, unit) = text.split_at(split);
    let factor = match unit.trim() {
        "" | "s" => 1.0,
        "ms" => 1e-3,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err("a time ends in s, m, h or ms, as in 60s".to_owned()),
    };
    match number.parse::<f64>() {
        Ok(n) if n > 0.0 && n.is_finite() => Ok(n * factor),
        _ => Err("a time above zero is needed, as in 60s or 1.5m".to_owned()),
    }
}

/// A count: `1000`, `20M`, `1.5G`, `2e9`. Units are decimal.
pub(super) fn amount(text: &str) -> Result<u64, String> {
    let wrong = || "a count is needed, as in 20M, 1.5G or 2e9".to_owned();
    let (number, factor) = match text.trim_end_matches(['B', 'b']).char_indices().next_back() {
        Some((i, 'k' | 'K')) => (&text[..i], 1e3),
        Some((i, 'm' | 'M')) => (&text[..i], 1e6),
        Some((i, 'g' | 'G')) => (&text[..i], 1e9),
        Some((i, 't' | 'T')) => (&text[..i], 1e12),
        _ => (text, 1.0),
    };
    match number.parse::<f64>() {
        // Above this, f64 no longer holds every whole number.
        Ok(n) if n * factor >= 1.0 && n * factor <= 9e15 => Ok((n * factor).round() as u64),
        _ => Err(wrong()),
    }
}

/// Samples per pixel.
pub(super) fn samples(text: &str) -> Result<u32, String> {
    whole(text, 1..=1 << 24)
}

/// Worker threads.
pub(super) fn threads(text: &str) -> Result<usize, String> {
    whole(text, 1..=4096).map(|n| n as usize)
}

/// Voxels of a grid.
pub(super) fn voxels(text: &str) -> Result<u32, String> {
    whole(text, 1..=1 << 14)
}

fn whole(text: &str, range: RangeInclusive<u32>) -> Result<u32, String> {
    text.parse()
        .ok()
        .filter(|n| range.contains(n))
        .ok_or_else(|| format!("a whole number from {} to {} is needed", range.start(), range.end()))
}

/// Pixels of an edge.
pub(super) fn edge_pixels(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(x) if (0.01..=1e6).contains(&x) => Ok(x),
        _ => Err("a number of pixels from 0.01 to 1000000 is needed, as in 1 or 4".to_owned()),
    }
}

/// A share above zero, and below one.
pub(super) fn share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x > 0.0 && x < 1.0 => Ok(x),
        _ => Err("a number between 0 and 1 is needed, as in 0.01".to_owned()),
    }
}

/// A limit that an error may have: zero or above.
pub(super) fn limit(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x >= 0.0 => Ok(x),
        _ => Err("a number of at least 0 is needed, as in 0.01".to_owned()),
    }
}
