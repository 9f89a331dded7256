//! The progress bar: on stderr, only when that is a terminal. Workers call [`Bar::update`], so it
//! costs them an atomic store most times and never waits for the terminal.

use crate::cli::note;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use std::fmt::Write;
use std::io::IsTerminal;
use std::sync::Once;
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
        Self { bar, time_limit_seconds, unit: "samples", sampling: Once::new() }
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
        }
    }

    /// So much done of so much. From any thread.
    pub(super) fn update_count(&self, done: u64, total: u64) {
        self.sampling.call_once(|| {
            let (limit, unit) = (self.time_limit_seconds, self.unit);
            let style = template("{line}");
            let style = style.with_key("line", move |state: &ProgressState, out: &mut dyn Write| {
                let at = At {
                    done: state.pos(),
                    total: state.len().unwrap_or(0),
                    elapsed: state.elapsed().as_secs_f64(),
                };
                // A bar that cannot be formatted is not worth an error.
                let _ = out.write_str(&line(at, unit, limit));
            });
            self.bar.set_length(total);
            self.bar.reset_elapsed();
            self.bar.set_style(style);
        });
        // Threads may report in another order than they counted.
        if done > self.bar.position() {
            self.bar.set_position(done);
        }
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
    let by_samples = if at.total > 0 { at.done as f64 / at.total as f64 } else { 0.0 };
    let by_time = time_limit_seconds.map_or(0.0, |limit| at.elapsed / limit);
    let fraction = by_samples.max(by_time).min(1.0);
    let filled = (fraction * BAR_WIDTH as f64) as usize;
    let rate = if at.elapsed > 0.0 { at.done as f64 / at.elapsed } else { 0.0 };
    let left = if fraction > 0.0 {
        // Whole seconds: an estimate has no more.
        match (at.elapsed / fraction - at.elapsed).max(0.0).ceil() {
            short if short < 60.0 => format!("{short} s left"),
            long => format!("{} left", seconds(long)),
        }
    } else {
        String::new()
    };
    format!(
        "[{}{}] {:3.0} %  {} {unit}/s  {left}",
        "=".repeat(filled),
        " ".repeat(BAR_WIDTH - filled),
        (fraction * 100.0).floor(),
        count(rate)
    )
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
}
