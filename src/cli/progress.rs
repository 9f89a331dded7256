//! The progress bar: on stderr, only when that is a terminal. Workers call [`Bar::update`], so it
//! costs them an atomic store most times and never waits for the terminal.

use crate::cli::note;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use std::fmt::Write;
use std::io::IsTerminal;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Once};
use std::time::Duration;
use weir::render::Progress;
use weir::report::{count, seconds};

const BAR_WIDTH: usize = 24;
/// Often enough for the time left to count down.
const REDRAW: Duration = Duration::from_millis(250);

/// What a person sees while waiting.
pub(super) struct Bar {
    bar: ProgressBar,
    time_limit_seconds: Option<f64>,
    /// What is counted.
    unit: &'static str,
    /// So far, where the bar counts regions.
    samples: Arc<AtomicU64>,
    sampling: Once,
}

impl Bar {
    /// A bar on stderr, or none.
    pub(super) fn new(shown: bool, time_limit_seconds: Option<f64>) -> Self {
        let shown = shown && std::io::stderr().is_terminal();
        let target = if shown { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(None, target);
        bar.set_style(template("{spinner} {msg} {elapsed}"));
        if shown {
            bar.enable_steady_tick(REDRAW);
        }
        Self { bar, time_limit_seconds, unit: "samples", samples: Arc::default(), sampling: Once::new() }
    }

    /// A bar that counts something else than samples.
    pub(super) fn counting(unit: &'static str, shown: bool) -> Self {
        Self { unit, ..Self::new(shown, None) }
    }

    /// The bar itself, to say something beside it.
    pub(super) fn handle(&self) -> ProgressBar {
        self.bar.clone()
    }

    /// A phase that begins, or samples done. From any thread.
    pub(super) fn update(&self, progress: Progress<'_>) {
        match progress {
            Progress::Warning(line) => self.bar.suspend(|| note(line)),
            Progress::Phase(name) => self.bar.set_message(name),
            Progress::Converting { done, total } => {
                let percent = done as f64 / total.max(1) as f64 * 100.0;
                self.bar.set_message(format!("making tiled copies of textures: {percent:.0} %"));
            }
            Progress::Samples { done, total } => self.update_count(done, total),
            Progress::Regions { done, total, samples } => self.update_regions(done, total, samples),
        }
    }

    /// So much done of so much. From any thread.
    pub(super) fn update_count(&self, done: u64, total: u64) {
        let (limit, unit) = (self.time_limit_seconds, self.unit);
        self.begin(total, move |at| line(at, unit, limit));
        // Threads may report in another order than they counted.
        if done > self.bar.position() {
            self.bar.set_position(done);
        }
    }

    /// So many regions done of so many, and samples so far. From any thread.
    fn update_regions(&self, done: u64, total: u64, samples: u64) {
        let (limit, counted) = (self.time_limit_seconds, Arc::clone(&self.samples));
        self.begin(total, move |at| region_line(at, counted.load(Ordering::Relaxed), limit));
        self.samples.fetch_max(samples, Ordering::Relaxed);
        // Not always more than before: what lies beside a noisy region may have to go on.
        self.bar.set_position(done);
    }

    /// From now on shows what `line` says.
    fn begin(&self, total: u64, line: impl Fn(At) -> String + Clone + Send + Sync + 'static) {
        self.sampling.call_once(|| {
            let style = template("{line}");
            let style = style.with_key("line", move |state: &ProgressState, out: &mut dyn Write| {
                let at = At {
                    done: state.pos(),
                    total: state.len().unwrap_or(0),
                    elapsed: state.elapsed().as_secs_f64(),
                };
                // A bar that cannot be formatted is not worth an error.
                let _ = out.write_str(&line(at));
            });
            self.bar.set_length(total);
            self.bar.reset_elapsed();
            self.bar.set_style(style);
        });
    }

    /// Leaves the terminal as it was.
    pub(super) fn clear(&self) {
        self.bar.finish_and_clear();
    }
}

fn template(text: &str) -> ProgressStyle {
    ProgressStyle::with_template(text).expect("our own templates are well formed")
}

/// So much done of how much, and seconds since the first.
#[derive(Clone, Copy)]
struct At {
    done: u64,
    total: u64,
    elapsed: f64,
}

/// Bar, percentage, rate and time left: of the samples or of the time limit, whichever ends first.
fn line(at: At, unit: &str, time_limit_seconds: Option<f64>) -> String {
    let by_samples = share(at);
    let by_time = time_limit_seconds.map_or(0.0, |limit| at.elapsed / limit);
    let fraction = by_samples.max(by_time).min(1.0);
    let left =
        if fraction > 0.0 { time_left(at.elapsed / fraction - at.elapsed) + " left" } else { String::new() };
    format!("{}  {} {unit}/s  {left}", drawn(fraction), count(rate(at.done, at)))
}

/// Regions that are done, rate, and what there is so far. How long it takes nobody knows: the regions that are left are
/// those that take longest. A limit of time is known.
fn region_line(at: At, samples: u64, time_limit_seconds: Option<f64>) -> String {
    let left = time_limit_seconds.map(|limit| format!(", at most {} left", time_left(limit - at.elapsed)));
    format!(
        "{} of regions done  {} samples/s, {} so far{}",
        drawn(share(at).min(1.0)),
        count(rate(samples, at)),
        count(samples as f64),
        left.unwrap_or_default()
    )
}

fn share(at: At) -> f64 {
    if at.total > 0 { at.done as f64 / at.total as f64 } else { 0.0 }
}

fn rate(done: u64, at: At) -> f64 {
    if at.elapsed > 0.0 { done as f64 / at.elapsed } else { 0.0 }
}

/// Whole seconds: an estimate has no more.
fn time_left(left: f64) -> String {
    match left.max(0.0).ceil() {
        short if short < 60.0 => format!("{short} s"),
        long => seconds(long),
    }
}

/// A bar and its percentage.
fn drawn(fraction: f64) -> String {
    let filled = (fraction * BAR_WIDTH as f64) as usize;
    let (full, empty) = ("=".repeat(filled), " ".repeat(BAR_WIDTH - filled));
    format!("[{full}{empty}] {:3.0} %", (fraction * 100.0).floor())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_says_rate_share_and_time_left() {
        let text = line(At { done: 2_500_000, total: 10_000_000, elapsed: 5.0 }, "samples", None);
        assert_eq!(text, "[======                  ]  25 %  500 k samples/s  15 s left");
        // The time limit ends it sooner.
        let text = line(At { done: 2_500_000, total: 10_000_000, elapsed: 5.0 }, "samples", Some(10.0));
        assert_eq!(text, "[============            ]  50 %  500 k samples/s  5 s left");
        // Past its end, and before its beginning.
        assert!(line(At { done: 9, total: 3, elapsed: 1.0 }, "samples", Some(0.1)).contains("100 %"));
        assert!(line(At { done: 0, total: 0, elapsed: 0.0 }, "samples", None).contains("  0 %  0 samples/s"));
    }

    #[test]
    fn regions_are_counted_where_samples_have_no_end() {
        let at = At { done: 150, total: 600, elapsed: 5.0 };
        let text = region_line(at, 2_500_000, None);
        assert_eq!(text, "[======                  ]  25 % of regions done  500 k samples/s, 2.50 M so far");
        let text = region_line(at, 2_500_000, Some(95.0));
        assert!(text.ends_with("2.50 M so far, at most 1 min 30 s left"), "{text}");
        assert!(region_line(At { done: 0, total: 0, elapsed: 0.0 }, 0, None).contains("  0 % of regions"));

        let bar = Bar::new(false, None);
        for (done, samples, shown) in [(10, 500, 500), (30, 400, 500), (20, 900, 900)] {
            bar.update(Progress::Regions { done, total: 40, samples });
            assert_eq!((bar.bar.position(), bar.bar.length()), (done, Some(40)));
            assert_eq!(bar.samples.load(Ordering::Relaxed), shown, "never fewer than before");
        }
    }
}
