//! Ctrl-C (and SIGTERM, SIGHUP): the first stops the render, which then writes what is done; the
//! second ends the program at once. Invariant: neither leaves a half-written file. Never writes.

use crate::cli::note;
use indicatif::ProgressBar;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use weir::film::replace::remove_partial_files;

/// Set by the first signal.
pub(super) static CANCEL: AtomicBool = AtomicBool::new(false);
/// Nothing to write yet: the first signal ends the program.
const LOADING: u8 = 0;
const RENDERING: u8 = 1;
const WRITING: u8 = 2;
static PHASE: AtomicU8 = AtomicU8::new(LOADING);

/// Exit code of a program that Ctrl-C ended: 128 + SIGINT.
const INTERRUPTED: i32 = 130;

/// Listens from now on. `bar` is moved aside for the one line that is said.
pub(super) fn listen(bar: ProgressBar) {
    // Under nohup, the person asked to survive a hang-up. The handler covers all three signals or
    // none, so there they keep their default.
    if hangup_is_ignored() {
        return;
    }
    let handler = move || {
        let again = CANCEL.swap(true, Ordering::Relaxed);
        if again || PHASE.load(Ordering::Relaxed) == LOADING {
            remove_partial_files();
            std::process::exit(INTERRUPTED);
        }
        let doing = if PHASE.load(Ordering::Relaxed) == WRITING { "writing" } else { "stopping to write" };
        bar.suspend(|| note(&format!("interrupted: {doing} what is done; once more to quit at once")));
    };
    // Without a handler Ctrl-C ends the program, which is no reason not to render.
    if let Err(e) = ctrlc::set_handler(handler) {
        note(&format!("warning: Ctrl-C will not write what is done: {e}"));
    }
}

/// From now on there may be something to write.
pub(super) fn rendering() {
    PHASE.store(RENDERING, Ordering::Relaxed);
}

/// Rendering is over.
pub(super) fn writing() {
    PHASE.store(WRITING, Ordering::Relaxed);
}

/// Signal 1 in the mask of ignored signals.
fn hangup_is_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 != 0)
}
