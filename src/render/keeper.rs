//! Keeps a render half done on the disk while it goes on.
//!
//! Invariant: what is kept is a state that the render without an interruption goes through.
//! Never stops a render because a disk does not take it: that is said at once, a line for each reason, and at the end.

use super::Progress;
use super::job::Job;
use super::meanwhile::meanwhile;
use crate::accel::Accel;
use crate::error::{Error, Result};
use crate::film::FilmBuffer;
use crate::film::checkpoint::{self, Checkpoint};
use crate::permits::lock;
use crate::settings::Checkpointing;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// As often as is kept at most.
const OFTEN: Duration = Duration::from_millis(1);

/// Where a render is kept, and what it is.
pub(super) struct Keeper<'a> {
    pub(super) settings: &'a Checkpointing,
    pub(super) identity: Vec<(String, String)>,
    kept: Mutex<Kept>,
}

/// What has come of it.
#[derive(Default)]
struct Kept {
    /// Samples in the file.
    samples: Option<u64>,
    seconds: f64,
    /// What went wrong last.
    failed: Option<String>,
    /// What went wrong at some time, each told once.
    told: Vec<String>,
}

/// Reads the checkpoint `path` of the render that is `identity` into `film`, if there is one.
///
/// # Errors
/// Those of [`checkpoint::load`], and one with more samples a pixel than `spp`.
pub(super) fn take_up(
    path: &Path,
    film: &FilmBuffer,
    identity: &[(String, String)],
    spp: u32,
) -> Result<Option<Checkpoint>> {
    let there = checkpoint::load(path, film, identity)?;
    let most = film.samples(u32::MAX).1;
    if most > spp {
        return Err(Error::Usage(format!(
            "{}: a checkpoint with {most} samples per pixel already, more than the {spp} asked for; ask for more, or \
             remove it to start anew",
            path.display()
        )));
    }
    Ok(there)
}

impl<'a> Keeper<'a> {
    /// Of the render `identity`; `there` are the samples that the file has already.
    pub(super) fn new(
        settings: &'a Checkpointing,
        identity: Vec<(String, String)>,
        there: Option<u64>,
    ) -> Self {
        Self { settings, identity, kept: Mutex::new(Kept { samples: there, ..Kept::default() }) }
    }

    /// Calls `render`, which works at `job`, and keeps that as often as was asked for, and when it has ended.
    pub(super) fn during<A: Accel + ?Sized, R>(&self, job: &Job<'_, A>, render: impl FnOnce() -> R) -> R {
        // For ever, if a person says so.
        let every =
            Duration::try_from_secs_f64(self.settings.every_seconds).unwrap_or(Duration::MAX).max(OFTEN);
        // Without that thread it is kept when it ends.
        let result = meanwhile(
            "checkpoints",
            || every,
            || {
                if let Some(line) = self.keep(job) {
                    (job.control.progress)(Progress::Warning(&format!(
                        "warning: {line}; the render goes on"
                    )));
                }
            },
            render,
        );
        // What goes wrong now is said in the end.
        self.keep(job);
        result
    }

    /// Writes what is done of `job`, if anything is new; what goes wrong with it and never did before.
    fn keep<A: Accel + ?Sized>(&self, job: &Job<'_, A>) -> Option<String> {
        let rounds = job.rounds.as_ref()?;
        let start = Instant::now();
        let samples = job.samples.load(Ordering::Relaxed);
        let mut kept = lock(&self.kept);
        if kept.samples == Some(samples) || samples == 0 {
            return None;
        }
        let path = &self.settings.path;
        let saved = rounds.hold(|targets| checkpoint::save(path, &job.buffer, &self.identity, targets));
        kept.seconds += start.elapsed().as_secs_f64();
        kept.failed = saved.err().map(|e| format!("the checkpoint was not written: {e}"));
        kept.samples = Some(samples).filter(|_| kept.failed.is_none());
        let new = kept.failed.clone().filter(|line| !kept.told.contains(line))?;
        kept.told.push(new.clone());
        Some(new)
    }

    /// Seconds that writing took, and what went wrong with the last.
    pub(super) fn end(self) -> (f64, Option<String>) {
        let kept = self.kept.into_inner().unwrap_or_else(PoisonError::into_inner);
        (kept.seconds, kept.failed)
    }
}
