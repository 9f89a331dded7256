//! Rays a second of each backend, on the same rays in the same rounds.
//!
//! Invariant: a ratio is the median of ratios within rounds; backends take turns within a round, so that a busy machine
//! slows both.

use super::hits::Kind;
use crate::accel::{Accel, Ray};
use rayon::prelude::*;
use serde::Serialize;
use std::hint::black_box;
use std::time::Instant;

/// Which question.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Query {
    /// The nearest hit.
    Closest,
    /// Whether there is one.
    Occluded,
}

/// Rates of one kind of rays, in millions of rays a second.
#[derive(Clone, Debug, Serialize)]
pub struct Rate {
    /// Where the rays come from.
    pub kind: Kind,
    /// Whether they were put in random order.
    pub shuffled: bool,
    /// The question.
    pub query: Query,
    /// Threads.
    pub threads: usize,
    /// Rays a round.
    pub rays: usize,
    /// Our hierarchy.
    pub native: f64,
    /// Embree.
    pub embree: Option<f64>,
    /// Embree in robust mode.
    pub embree_robust: Option<f64>,
    /// Native over Embree: the median over rounds.
    pub native_over_embree: Option<f64>,
    /// Native over robust Embree.
    pub native_over_embree_robust: Option<f64>,
}

/// Rays that a thread takes at a time, in the order of the paths: a wave.
const TASK: usize = 1024;

/// One set of rays and the question.
pub(super) struct Set<'a> {
    pub(super) kind: Kind,
    pub(super) shuffled: bool,
    pub(super) query: Query,
    pub(super) rays: &'a [Ray],
}

fn answer(accel: &dyn Accel, query: Query, rays: &[Ray]) -> u64 {
    match query {
        Query::Closest => rays.iter().map(|r| u64::from(accel.closest(r).primitive)).sum(),
        Query::Occluded => rays.iter().map(|r| u64::from(accel.occluded(r))).sum(),
    }
}

fn seconds(accel: &dyn Accel, set: &Set<'_>, pool: Option<&rayon::ThreadPool>) -> f64 {
    let start = Instant::now();
    let sum = match pool {
        None => answer(accel, set.query, set.rays),
        Some(pool) => {
            pool.install(|| set.rays.par_chunks(TASK).map(|r| answer(accel, set.query, r)).sum::<u64>())
        }
    };
    black_box(sum);
    start.elapsed().as_secs_f64()
}

/// Of an odd number of values the middle one, else the mean of two.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n == 0 { f64::NAN } else { 0.5 * (values[(n - 1) / 2] + values[n / 2]) }
}

/// Measures `set` in `rounds` rounds on one thread, or on those of `pool`. `accels` are native, Embree, robust Embree.
pub(super) fn measure(
    accels: [Option<&dyn Accel>; 3],
    set: &Set<'_>,
    rounds: u32,
    pool: Option<&rayon::ThreadPool>,
) -> Rate {
    let mut taken: [Vec<f64>; 3] = Default::default();
    // Once before, for caches.
    for round in 0..=rounds {
        for (accel, taken) in accels.iter().zip(&mut taken) {
            let Some(accel) = accel else { continue };
            let s = seconds(*accel, set, pool);
            if round > 0 {
                taken.push(s);
            }
        }
    }
    let [native, embree, robust] = taken;
    let rate = |seconds: &[f64]| {
        (!seconds.is_empty()).then(|| set.rays.len() as f64 * 1e-6 / median(seconds.to_vec()))
    };
    let ratio = |other: &[f64]| {
        (!other.is_empty()).then(|| median(other.iter().zip(&native).map(|(o, n)| o / n).collect()))
    };
    Rate {
        kind: set.kind,
        shuffled: set.shuffled,
        query: set.query,
        threads: pool.map_or(1, rayon::ThreadPool::current_num_threads),
        rays: set.rays.len(),
        native: rate(&native).unwrap_or(0.0),
        embree: rate(&embree),
        embree_robust: rate(&robust),
        native_over_embree: ratio(&embree),
        native_over_embree_robust: ratio(&robust),
    }
}

#[cfg(test)]
mod tests {
    use super::median;

    #[test]
    fn medians() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), 2.5);
    }
}
