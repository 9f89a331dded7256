//! What caches of other sizes would have missed, and what follows for the next render.

use super::caches::Which;
use super::parts::{absent, drawing, figure, number, numbers};
use crate::report::bytes;
use crate::report::chart::{Axis, Kind, Lines, Mark, Series, lines};
use crate::report::escape::escape;
use crate::stats::CacheStats;

/// The curve of a cache, with its budget and its knee.
pub(super) fn curve(which: &Which<'_>, cache: &CacheStats) -> String {
    let id = format!("chart-{}-curve", which.id);
    let points: Vec<(f64, f64)> =
        which.curve.iter().map(|&(size, ratio)| (size as f64, ratio)).filter(|p| p.0 > 0.0).collect();
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        let why =
            format!("There is no curve of other sizes: no {} came to the shared cache twice.", which.piece);
        return absent(&id, &why);
    };
    let knee = cache.knee.map(|k| k.bytes as f64);
    let marked = || knee.into_iter().chain([cache.budget as f64]).filter(|size| *size > 0.0);
    let low = marked().fold(first.0, f64::min);
    // A budget far beyond the last change is told in the sentence; here it would press the curve to the side.
    let high = marked().filter(|size| *size < last.0 * 100.0).fold(last.0, f64::max);
    let mut upright =
        vec![Mark { at: cache.budget as f64, text: format!("budget {}", bytes(cache.budget)), colour: "c0" }];
    upright.extend(cache.knee.map(|k| Mark {
        at: k.bytes as f64,
        text: format!("knee {}", bytes(k.bytes)),
        colour: "c4",
    }));
    upright.retain(|mark| mark.at > 0.0 && mark.at <= high);
    let chart = Lines {
        what: format!("misses of {}s by size of the cache", which.piece),
        titles: ("size of the cache", "misses"),
        x: Axis::logarithmic(low, high, |size| short(size as u64)),
        y: Axis::from_zero(points.iter().map(|p| p.1).fold(0.0, f64::max), Kind::Share, 5.0),
        said: which
            .curve
            .iter()
            .map(|&(size, ratio)| (size as f64, format!("{size} B: {ratio} misses a look-up")))
            .collect(),
        series: vec![Series { name: String::new(), colour: "c1", points, dots: false }],
        upright,
        level: Vec::new(),
        height: 190.0,
    };
    let pointer = format!("/miss_ratio/{}", which.id);
    let table = numbers("Numbers", &pointer, which.curve, &[("0", "size [B]"), ("1", "misses / look-ups")]);
    let said =
        "Predicted misses over look-ups, by size of a cache that evicts what was not used for longest.";
    let inside = format!("{}<p>{}</p>{table}", drawing(&lines(&chart)), advice(which, cache));
    figure(&id, "Other sizes", said, &inside)
}

/// A round size without needless digits.
fn short(size: u64) -> String {
    bytes(size).replace(".00 ", " ").replace(".0 ", " ")
}

/// One sentence, as markup.
fn advice(which: &Which<'_>, cache: &CacheStats) -> String {
    let key = |field: &str| format!("/{}_cache/{field}", which.id);
    let Some(knee) = cache.knee else {
        return escape(&format!("No {} was read, so that there is nothing to advise.", which.piece));
    };
    let size = number(&key("knee/bytes"), &knee.bytes, &bytes(knee.bytes));
    let budget = number(&key("budget"), &cache.budget, &bytes(cache.budget));
    let times = |field: &str, value: f64| number(&key(field), &value, &format!("{value:.2}"));
    let pressure = times("knee/pressure", knee.pressure);
    if cache.budget >= knee.bytes {
        return format!(
            "The budget of {budget} is enough, and more would gain little: from {size} on a cache reads {pressure} \
             times the footprint or less; half of that would read {} times.",
            times("knee/pressure_at_half", knee.pressure_at_half)
        );
    }
    format!(
        "More memory pays: {size} instead of {budget} would read {pressure} times the footprint instead of {} \
         (<code>{} {}</code>).",
        times("pressure", cache.total.pressure),
        which.option,
        knee.bytes.saturating_add(which.beside)
    )
}
