//! Answers to given rays over given geometry, each held against the arbiter: for tests that bring both.
//!
//! Invariant: every ray is judged, not some; a fault is what `judge` calls one, by the bounds of the voice's own arithmetic.
//! Never: looks for rays itself.

use super::arbiter::{Arbiter, Candidate, Name, Shapes};
use super::bounds::Voice;
use super::outcome::ray_text;
use crate::accel::{Accel, Hit, Ray};
use rayon::prelude::*;

/// What became of rays; by voice, native first.
#[derive(Clone, Debug, Default)]
pub struct Held {
    /// Rays.
    pub rays: u64,
    /// Of them, hits.
    pub hits: [u64; 2],
    /// Answers beyond the voice's bounds.
    pub faults: [u64; 2],
    /// Occlusion that contradicts the closest hit where no rounding accounts for it.
    pub contradictions: [u64; 2],
    /// Largest error of a distance as a share of its bound.
    pub worst: [f64; 2],
    /// The first fault or contradiction of each.
    pub examples: [Option<String>; 2],
}

impl Held {
    /// Adds what another said.
    pub fn join(&mut self, other: Self) {
        self.rays += other.rays;
        for i in 0..2 {
            self.hits[i] += other.hits[i];
            self.faults[i] += other.faults[i];
            self.contradictions[i] += other.contradictions[i];
            self.worst[i] = self.worst[i].max(other.worst[i]);
        }
        for (mine, others) in self.examples.iter_mut().zip(other.examples) {
            *mine = mine.take().or(others);
        }
    }

    fn take(&mut self, arbiter: &Arbiter<'_>, accels: [&dyn Accel; 2], ray: &Ray) {
        self.rays += 1;
        let hits = accels.map(|accel| accel.closest(ray));
        let judgement = arbiter.judge(ray, [&hits[0], &hits[1]]);
        let found = arbiter.gather(ray, [&hits[0], &hits[1]]);
        for i in 0..2 {
            let hit = Name::of(&hits[i]);
            self.hits[i] += u64::from(hit.is_some());
            self.faults[i] += u64::from(judgement.faults[i].is_some());
            let contradicts = accels[i].occluded(ray) != hit.is_some() && {
                let (may, may_not) = arbiter.occlusion(ray, i);
                // Two tests of Embree may round differently at an edge; the native ones may not.
                i == 0 || !(may && may_not)
            };
            self.contradictions[i] += u64::from(contradicts);
            if judgement.faults[i].is_none() {
                self.worst[i] = self.worst[i].max(share(&found, i, &hits[i]).unwrap_or(0.0));
            }
            if (contradicts || judgement.faults[i].is_some()) && self.examples[i].is_none() {
                let fault = judgement.faults[i];
                self.examples[i] = Some(format!("{fault:?}: {}: {:?}", ray_text(ray), hits[i]));
            }
        }
    }
}

/// The error of a distance over what it may be; none where the answer is right or held to a box.
fn share(found: &[Candidate], voice: usize, hit: &Hit) -> Option<f64> {
    let name = Name::of(hit)?;
    let candidate = found.iter().find(|c| c.name == name)?;
    let verdict = candidate.may[voice]?;
    let error = f64::from(hit.t) - candidate.t;
    let most = if error > 0.0 { verdict.hi - candidate.t } else { verdict.lo - candidate.t };
    (error != 0.0 && error / most >= 0.0).then_some(error / most)
}

/// Judges the answers of `native` and of `other`, which is Embree in its `robust` mode or not, to `rays` over `shapes`,
/// from which both were built.
#[must_use]
pub fn hold(shapes: &Shapes<'_>, [native, other]: [&dyn Accel; 2], robust: bool, rays: &[Ray]) -> Held {
    let voice = if robust { Voice::EmbreeRobust } else { Voice::Embree };
    let arbiter = Arbiter::new(shapes, [Voice::Native, voice]);
    let part = |rays: &[Ray]| {
        let mut held = Held::default();
        rays.iter().for_each(|ray| held.take(&arbiter, [native, other], ray));
        held
    };
    let parts: Vec<Held> = rays.par_chunks(256).map(part).collect();
    let mut all = Held::default();
    parts.into_iter().for_each(|part| all.join(part));
    all
}
