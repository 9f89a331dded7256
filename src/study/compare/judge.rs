//! Who is right, and why: holds answers against what the arbiter lists.
//!
//! An answer of a voice is *within its arithmetic* when its primitive is one that the voice may say is hit, at a distance
//! it may say, and nothing that the voice must have met lies wholly before. The native voice must also meet closed
//! surfaces: where the ray passes edges within rounding, and each of them has a triangle on both sides, one of these
//! triangles is hit whatever the rounding, because all see the same rounded corners.
//! Never calls a native answer beyond its bound explained.

use super::arbiter::{Arbiter, Candidate, Name};
use super::verdict::Doubt;
use crate::accel::{Hit, Ray};

/// What is wrong with one answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// It went past what must be hit.
    Missed,
    /// It slipped through a surface that is closed there.
    MissedAtEdge,
    /// It names what cannot be hit.
    FalseHit,
    /// The distance is beyond the bound.
    WrongDistance,
}

/// What a disagreement comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Reason {
    /// Both within their arithmetic: see [`Doubt`].
    Edge,
    Range,
    Grazing,
    Degenerate,
    Alpha,
    Silhouette,
    /// Both hits are certain, their order is within rounding.
    Order,
    /// Embree alone is wrong.
    EmbreeMissedAtEdge,
    EmbreeMissed,
    EmbreeFalseHit,
    EmbreeWrongDistance,
    /// Its occlusion contradicts its closest hit.
    EmbreeOcclusion,
    /// The native hierarchy is wrong, whoever else is.
    NativeMissedAtEdge,
    NativeMissed,
    NativeFalseHit,
    NativeWrongDistance,
    NativeOcclusion,
    /// Nothing accounts for it.
    Unknown,
}

impl Reason {
    /// For text and JSON.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Edge => "edge",
            Self::Range => "range",
            Self::Grazing => "grazing",
            Self::Degenerate => "degenerate_triangle",
            Self::Alpha => "alpha",
            Self::Silhouette => "silhouette",
            Self::Order => "order",
            Self::EmbreeMissedAtEdge => "embree_missed_at_edge",
            Self::EmbreeMissed => "embree_missed",
            Self::EmbreeFalseHit => "embree_false_hit",
            Self::EmbreeWrongDistance => "embree_wrong_distance",
            Self::EmbreeOcclusion => "embree_occlusion",
            Self::NativeMissedAtEdge => "native_missed_at_edge",
            Self::NativeMissed => "native_missed",
            Self::NativeFalseHit => "native_false_hit",
            Self::NativeWrongDistance => "native_wrong_distance",
            Self::NativeOcclusion => "native_occlusion",
            Self::Unknown => "unknown",
        }
    }

    /// Whether rounding, or a fault of Embree that the arbiter has shown, accounts for it.
    pub(super) fn is_explained(self) -> bool {
        self < Self::NativeMissedAtEdge
    }

    fn of_native(fault: Fault) -> Self {
        match fault {
            Fault::Missed => Self::NativeMissed,
            Fault::MissedAtEdge => Self::NativeMissedAtEdge,
            Fault::FalseHit => Self::NativeFalseHit,
            Fault::WrongDistance => Self::NativeWrongDistance,
        }
    }

    fn of_embree(fault: Fault) -> Self {
        match fault {
            Fault::Missed => Self::EmbreeMissed,
            Fault::MissedAtEdge => Self::EmbreeMissedAtEdge,
            Fault::FalseHit => Self::EmbreeFalseHit,
            Fault::WrongDistance => Self::EmbreeWrongDistance,
        }
    }

    fn of_doubt(doubt: Doubt) -> Self {
        match doubt {
            Doubt::Edge => Self::Edge,
            Doubt::Range => Self::Range,
            Doubt::Grazing => Self::Grazing,
            Doubt::Degenerate => Self::Degenerate,
            Doubt::Alpha => Self::Alpha,
            Doubt::Silhouette => Self::Silhouette,
        }
    }
}

/// What the arbiter says of two answers to one ray.
#[derive(Clone, Debug)]
pub(super) struct Judgement {
    /// Native, then Embree.
    pub(super) faults: [Option<Fault>; 2],
    /// Of a difference between the two; `None` where there is none and no fault.
    pub(super) reason: Option<Reason>,
}

/// Where the first voice must have met something: the nearest certain hit's greatest distance, and that of the nearest
/// closed surface that it passes at an edge.
fn musts(candidates: &[Candidate], voice: usize) -> (f64, f64) {
    let verdicts = || candidates.iter().filter_map(|c| c.may[voice]);
    let certain = verdicts().filter(|v| v.doubt.is_none()).map(|v| v.hi).fold(f64::INFINITY, f64::min);
    (certain, closed(candidates, voice))
}

/// Greatest distance of the nearest group of triangles, joined by corners, that no rounding of corners can slip between.
fn closed(candidates: &[Candidate], voice: usize) -> f64 {
    let mut left: Vec<&Candidate> =
        candidates.iter().filter(|c| c.triangle.is_some() && c.may[0].is_some()).collect();
    let mut nearest = f64::INFINITY;
    while let Some(first) = left.pop() {
        let mut group = vec![first];
        let mut next = 0;
        while next < group.len() {
            let of = group[next];
            left.retain(|c| {
                let joined = touches(of, c);
                if joined {
                    group.push(c);
                }
                !joined
            });
            next += 1;
        }
        if is_closed(&group) {
            let bounds = group.iter().flat_map(|c| [c.may[0], c.may[voice]]).flatten();
            nearest = nearest.min(bounds.map(|v| v.hi).fold(f64::NEG_INFINITY, f64::max));
        }
    }
    nearest
}

fn touches(a: &Candidate, b: &Candidate) -> bool {
    let (Some(s), Some(t)) = (a.triangle, b.triangle) else { return false };
    a.name.instance() == b.name.instance() && s.corners.iter().any(|p| t.corners.contains(p))
}

/// Whether every edge that the ray passes within rounding has a triangle of the group on both sides.
fn is_closed(group: &[&Candidate]) -> bool {
    let settled = |c: &&Candidate| c.may[0].is_some_and(|v| matches!(v.doubt, None | Some(Doubt::Edge)));
    group.iter().all(settled)
        && group.iter().all(|c| {
            let Some(seen) = c.triangle else { return false };
            (0..3).filter(|&i| seen.near_edge[i]).all(|i| {
                let (a, b) = (seen.corners[(i + 1) % 3], seen.corners[(i + 2) % 3]);
                group.iter().any(|other| {
                    let Some(o) = other.triangle else { return false };
                    other.name != c.name
                        && (0..3).any(|k| {
                            let (p, q) = (o.corners[(k + 1) % 3], o.corners[(k + 2) % 3]);
                            // Run through the other way, an edge has its triangle on the other side.
                            let same = o.facing.signum() == seen.facing.signum();
                            (p, q) == (b, a) && same || (p, q) == (a, b) && !same
                        })
                })
            })
        })
}

/// What is wrong with `hit`, the answer of voice number `voice`.
fn fault(candidates: &[Candidate], voice: usize, hit: &Hit) -> Option<Fault> {
    let (certain, closed) = musts(candidates, voice);
    let mut t = f64::INFINITY;
    if let Some(name) = Name::of(hit) {
        let verdict = candidates.iter().find(|c| c.name == name).and_then(|c| c.may[voice]);
        let Some(verdict) = verdict else { return Some(Fault::FalseHit) };
        if !verdict.allows(hit.t) {
            return Some(Fault::WrongDistance);
        }
        t = f64::from(hit.t);
    }
    if certain < t {
        Some(Fault::Missed)
    } else if closed < t {
        Some(Fault::MissedAtEdge)
    } else {
        None
    }
}

impl Arbiter<'_> {
    /// All that may be hit up to the farther of two answers.
    pub(super) fn gather(&self, ray: &Ray, hits: [&Hit; 2]) -> Vec<Candidate> {
        let limit = |h: &Hit| Name::of(h).map_or(f64::from(ray.t_max), |_| f64::from(h.t));
        let mut found = self.candidates(ray, limit(hits[0]).max(limit(hits[1])));
        // What is answered is asked for even where no box says so.
        for name in hits.into_iter().filter_map(Name::of) {
            if !found.iter().any(|c| c.name == name) {
                found.extend(self.look(name, ray));
            }
        }
        found
    }

    /// Judges the answers of both voices to `ray`.
    pub(super) fn judge(&self, ray: &Ray, hits: [&Hit; 2]) -> Judgement {
        let found = self.gather(ray, hits);
        let faults = [fault(&found, 0, hits[0]), fault(&found, 1, hits[1])];
        let reason = match faults {
            [Some(native), _] => Some(Reason::of_native(native)),
            [None, Some(embree)] => Some(Reason::of_embree(embree)),
            [None, None] => Self::difference(&found, hits),
        };
        Judgement { faults, reason }
    }

    /// Why two answers differ that are both within their arithmetic.
    fn difference(found: &[Candidate], hits: [&Hit; 2]) -> Option<Reason> {
        let names = hits.map(Name::of);
        if names[0] == names[1] {
            return None;
        }
        // The voice that did not stop at the nearer hit had a doubt about it, or the other about its own.
        let nearer = match names {
            [Some(_), None] => 0,
            [None, Some(_)] => 1,
            _ if hits[0].t <= hits[1].t => 0,
            _ => 1,
        };
        let doubt = |of: usize, voice: usize| {
            let candidate = found.iter().find(|c| Some(c.name) == names[of])?;
            match candidate.may[voice] {
                Some(verdict) => verdict.doubt,
                // It could not say this at all, so the one that did was in doubt.
                None => candidate.may[1 - voice].and_then(|v| v.doubt),
            }
        };
        let doubt = doubt(nearer, 1 - nearer)
            .or_else(|| doubt(nearer, nearer))
            .or_else(|| doubt(1 - nearer, nearer))
            .or_else(|| doubt(1 - nearer, 1 - nearer));
        Some(match doubt {
            Some(doubt) => Reason::of_doubt(doubt),
            None if names.iter().all(Option::is_some) => Reason::Order,
            None => Reason::Unknown,
        })
    }

    /// Whether the voice may say of `ray` that anything is in its way, and that nothing is.
    pub(super) fn occlusion(&self, ray: &Ray, voice: usize) -> (bool, bool) {
        let found = self.candidates(ray, f64::from(ray.t_max));
        let (certain, _) = musts(&found, voice);
        (found.iter().any(|c| c.may[voice].is_some()), certain == f64::INFINITY)
    }
}
