//! Each ray through both backends, and what became of it.
//!
//! Every ray ends in exactly one of:
//! - *same*: both miss, or both name one primitive at distances that each voice may say by the bounds of `bounds.rs`;
//!   `within_bound` counts those of them whose distances differ in some bit;
//! - *tie*: two primitives, each at a distance that its voice may say, and the two ranges of distances overlap. (The
//!   native rule at one distance is the least instance, geometry, primitive; Embree has none);
//! - *explained* or *unexplained*: everything else, by what the arbiter says.
//!
//! Rays that agree are shown to the arbiter too, some of them: both may be wrong together.

use super::arbiter::{Arbiter, Name};
use super::judge::{Fault, Judgement, Reason};
use crate::accel::{Accel, Hit, Ray};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// Where a ray comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// From the camera.
    Camera,
    /// From a surface, in search of the next.
    Bounce,
    /// From a surface to a light.
    Shadow,
    /// At vertices, edges, faces of boxes and slivers.
    Aimed,
    /// Through the middle of a pixel, for the picture.
    Pixel,
}

/// A ray on which the backends differ, or of which one is wrong.
#[derive(Clone, Debug)]
pub(super) struct Disagreement {
    pub(super) kind: Kind,
    /// Among the rays of its kind.
    pub(super) index: usize,
    pub(super) ray: Ray,
    /// Native, then Embree.
    pub(super) hits: [Hit; 2],
    pub(super) reason: Reason,
}

impl Disagreement {
    /// Larger is worse: how far the distances are apart, relative to the larger.
    fn severity(&self) -> (bool, f32) {
        let [a, b] = self.hits.map(|h| if Name::of(&h).is_some() { h.t } else { f32::INFINITY });
        let apart = if a == b { 0.0 } else { (a - b).abs() / a.abs().max(b.abs()) };
        // Infinity over infinity: a miss against a hit.
        (!self.reason.is_explained(), if apart.is_nan() { f32::INFINITY } else { apart })
    }
}

/// What became of rays.
#[derive(Clone, Debug, Default)]
pub(super) struct Tally {
    pub(super) rays: u64,
    pub(super) same: u64,
    pub(super) within_bound: u64,
    pub(super) ties: u64,
    pub(super) explained: u64,
    pub(super) unexplained: u64,
    /// Rays whose occlusion was asked for and held against the closest hit.
    pub(super) occlusion_checked: u64,
    /// Rays that agree and were shown to the arbiter.
    pub(super) audited: u64,
    /// Through surfaces that are closed where the ray passes: native, then Embree.
    pub(super) slipped: [u64; 2],
    pub(super) reasons: BTreeMap<Reason, u64>,
    pub(super) disagreements: Vec<Disagreement>,
}

impl Tally {
    pub(super) fn merge(mut self, other: Self) -> Self {
        let Self {
            rays,
            same,
            within_bound,
            ties,
            explained,
            unexplained,
            occlusion_checked,
            audited,
            slipped,
            reasons,
            disagreements,
        } = other;
        self.rays += rays;
        self.same += same;
        self.within_bound += within_bound;
        self.ties += ties;
        self.explained += explained;
        self.unexplained += unexplained;
        self.occlusion_checked += occlusion_checked;
        self.audited += audited;
        self.slipped = [self.slipped[0] + slipped[0], self.slipped[1] + slipped[1]];
        for (reason, count) in reasons {
            *self.reasons.entry(reason).or_default() += count;
        }
        self.disagreements.extend(disagreements);
        self
    }

    /// The worst first, those without an explanation before all others.
    pub(super) fn worst(&self, count: usize) -> Vec<&Disagreement> {
        let mut all: Vec<&Disagreement> = self.disagreements.iter().collect();
        all.sort_by(|a, b| {
            let (a, b) = (a.severity(), b.severity());
            b.0.cmp(&a.0).then(b.1.total_cmp(&a.1))
        });
        all.truncate(count);
        all
    }
}

/// The two that are compared. Without Embree the native one stands for both.
pub(super) struct Pair<'a> {
    pub(super) native: &'a dyn Accel,
    pub(super) other: &'a dyn Accel,
    pub(super) arbiter: &'a Arbiter<'a>,
}

/// What a look at two answers says, without the arbiter's search.
enum Glance {
    Same { bitwise: bool },
    Tie,
    Differ,
}

/// Rays of which a task takes this many.
const TASK: usize = 1024;
/// Of rays other than shadow rays, one in so many is asked for occlusion too.
const OCCLUSION_EVERY: usize = 4;

impl Pair<'_> {
    /// Compares `rays`, on the threads of the current pool. One in `audit_every` of those that agree goes to the arbiter.
    pub(super) fn compare(&self, kind: Kind, rays: &[Ray], audit_every: usize) -> Tally {
        let task = |(i, rays): (usize, &[Ray])| {
            let mut tally = Tally::default();
            for (k, ray) in rays.iter().enumerate() {
                self.one(kind, i * TASK + k, ray, audit_every, &mut tally);
            }
            tally
        };
        let parts: Vec<Tally> = rays.par_chunks(TASK).enumerate().map(task).collect();
        parts.into_iter().fold(Tally::default(), Tally::merge)
    }

    fn one(&self, kind: Kind, index: usize, ray: &Ray, audit_every: usize, tally: &mut Tally) {
        tally.rays += 1;
        let hits = [self.native.closest(ray), self.other.closest(ray)];
        let glance = self.glance(ray, [&hits[0], &hits[1]]);
        let audit = index.is_multiple_of(audit_every);
        let mut reason = None;
        if audit || matches!(glance, Glance::Differ) {
            let judgement = self.arbiter.judge(ray, [&hits[0], &hits[1]]);
            for (count, fault) in tally.slipped.iter_mut().zip(judgement.faults) {
                *count += u64::from(fault == Some(Fault::MissedAtEdge));
            }
            reason = match glance {
                Glance::Differ => Some(judgement.reason.unwrap_or(Reason::Unknown)),
                // A tie has a reason and is none the worse for it.
                Glance::Same { .. } | Glance::Tie => of_fault(&judgement),
            };
            tally.audited += u64::from(!matches!(glance, Glance::Differ));
        }
        if kind == Kind::Shadow || index.is_multiple_of(OCCLUSION_EVERY) {
            tally.occlusion_checked += 1;
            reason = reason.or_else(|| self.contradiction(ray, [&hits[0], &hits[1]]));
        }
        let Some(reason) = reason else {
            match glance {
                Glance::Same { bitwise } => {
                    tally.same += 1;
                    tally.within_bound += u64::from(!bitwise);
                }
                Glance::Tie => tally.ties += 1,
                Glance::Differ => unreachable!("a difference has a reason"),
            }
            return;
        };
        tally.explained += u64::from(reason.is_explained());
        tally.unexplained += u64::from(!reason.is_explained());
        *tally.reasons.entry(reason).or_default() += 1;
        tally.disagreements.push(Disagreement { kind, index, ray: *ray, hits, reason });
    }

    fn glance(&self, ray: &Ray, hits: [&Hit; 2]) -> Glance {
        let names = hits.map(Name::of);
        let [Some(a), Some(b)] = names else {
            return if names[0] == names[1] { Glance::Same { bitwise: true } } else { Glance::Differ };
        };
        let verdict = |name: Name, voice: usize| {
            self.arbiter.look(name, ray)?.may[voice].filter(|v| v.allows(hits[voice].t))
        };
        match (verdict(a, 0), verdict(b, 1)) {
            (Some(_), Some(_)) if a == b => {
                Glance::Same { bitwise: hits[0].t.to_bits() == hits[1].t.to_bits() }
            }
            (Some(v), Some(w)) if v.lo <= w.hi && w.lo <= v.hi => Glance::Tie,
            _ => Glance::Differ,
        }
    }

    /// Where a backend's occlusion contradicts its own closest hit.
    fn contradiction(&self, ray: &Ray, hits: [&Hit; 2]) -> Option<Reason> {
        if self.native.occluded(ray) != Name::of(hits[0]).is_some() {
            return Some(Reason::NativeOcclusion);
        }
        let occluded = self.other.occluded(ray);
        if occluded == Name::of(hits[1]).is_some() {
            return None;
        }
        let (may, may_not) = self.arbiter.occlusion(ray, 1);
        // Two tests of one backend may round differently at an edge.
        Some(if may && may_not { Reason::Edge } else { Reason::EmbreeOcclusion })
    }
}

/// The reason of an answer that is wrong though the other agrees.
fn of_fault(judgement: &Judgement) -> Option<Reason> {
    judgement.faults.iter().any(Option::is_some).then_some(judgement.reason)?
}

#[cfg(test)]
#[path = "hits_tests.rs"]
mod tests;
