//! What a comparison says, as it goes to JSON; the names of the keys are a contract. All sizes in bytes, all times in
//! seconds. What Embree does not tell is null.

use super::arbiter::Name;
use super::hits::{Disagreement, Kind, Tally};
use super::rates::Rate;
use crate::accel::{Hit, Ray};
use serde::Serialize;
use std::collections::BTreeMap;

/// See above.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// Version.
    pub weir: String,
    /// The scene's file.
    pub scene: String,
    /// Triangles and other primitives, those of instances once.
    pub primitives: u64,
    /// Placed objects.
    pub instances: u64,
    /// Threads of what is measured on all threads.
    pub threads: usize,
    /// Seed of the paths and of the aimed rays.
    pub seed: u64,
    /// Rays, by where they come from.
    pub rays: RayCounts,
    /// All rays, fast Embree.
    #[serde(flatten)]
    pub hits: Hits,
    /// The same rays, by kind.
    pub by_kind: BTreeMap<&'static str, Hits>,
    /// The same rays against robust Embree, if it was asked for.
    pub robust: Option<Hits>,
    /// The worst disagreements, those without an explanation first.
    pub worst: Vec<Worst>,
    /// `None` in a Weir without Embree: then the native answers are held against the arbiter alone.
    pub embree: Option<Backend>,
    /// Ours.
    pub native: Backend,
    /// Of rates and build times.
    pub native_over_embree: Option<Ratios>,
    /// All rates.
    pub rates: Vec<Rate>,
}

/// How many rays of each kind.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct RayCounts {
    /// From the camera.
    pub camera: u64,
    /// From surfaces.
    pub bounce: u64,
    /// To lights.
    pub shadow: u64,
    /// At what is hard to hit.
    pub aimed: u64,
    /// Through the middles of the picture's pixels.
    pub pixel: u64,
}

/// What became of rays. `same` + `ties` + `explained` + `unexplained` is all of them.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Hits {
    /// One primitive at distances within the bounds, or none.
    pub same: u64,
    /// Two primitives at one distance within the bounds.
    pub ties: u64,
    /// Of `same`, those whose distances differ in some bit.
    pub within_bound: u64,
    /// Disagreements inside the bounds, or faults of Embree that the arbiter shows.
    pub explained: u64,
    /// All others, and every fault of the native hierarchy.
    pub unexplained: u64,
    /// Both by reason.
    pub reasons: BTreeMap<&'static str, u64>,
    /// Rays whose occlusion was held against the closest hit of the same backend, for both.
    pub occlusion_checked: u64,
    /// Rays that agree and were shown to the arbiter all the same.
    pub audited: u64,
    /// Native rays, among those the arbiter was shown, that went through what is closed.
    pub native_misses_through_closed_mesh: u64,
    /// The same for Embree.
    pub embree_misses_through_closed_mesh: u64,
}

/// One disagreement.
#[derive(Clone, Debug, Serialize)]
pub struct Worst {
    /// As `--ray` takes it.
    pub ray: String,
    /// Where it comes from.
    pub kind: Kind,
    /// Why.
    pub reason: &'static str,
    /// Whether that is an explanation.
    pub explained: bool,
    /// Native and Embree; null is a miss.
    pub answers: Answers,
}

/// What both say.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Answers {
    /// Ours.
    pub native: Option<Answer>,
    /// Embree's.
    pub embree: Option<Answer>,
}

/// A hit.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Answer {
    /// Distance in units of the direction's length.
    pub t: f32,
    /// Instance, if any.
    pub instance: Option<u32>,
    /// Geometry.
    pub geometry: u32,
    /// Primitive.
    pub primitive: u32,
}

/// One backend.
#[derive(Clone, Debug, Serialize)]
pub struct Backend {
    /// Of the library, or of Weir.
    pub version: String,
    /// On all threads.
    pub build_s: f64,
    /// On one.
    pub build_1_thread_s: f64,
    /// Of the acceleration structure. The native one holds its own vertices; Embree reads the scene's.
    pub bytes: u64,
    /// Over primitives.
    pub bytes_per_triangle: f64,
    /// Camera and bounce rays in the order of paths, one thread; null where nothing was measured.
    pub closest_mrays_per_s: Option<f64>,
    /// Shadow rays, one thread.
    pub occluded_mrays_per_s: Option<f64>,
    /// Rays that went through surfaces that are closed where they pass.
    pub misses_through_closed_mesh: u64,
    /// Nodes that a camera or bounce ray visits for its closest hit.
    pub nodes_per_ray: Option<f64>,
    /// Leaves.
    pub leaves_per_ray: Option<f64>,
}

/// Native over Embree; for rates more is better, for times and bytes less. One thread, but for `build`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Ratios {
    /// Geometric mean of camera and bounce rays.
    pub closest: Option<f64>,
    /// Shadow rays.
    pub occluded: Option<f64>,
    /// All threads.
    pub build: f64,
    /// One thread.
    pub build_1_thread: f64,
    /// Bytes.
    pub bytes: f64,
}

impl Hits {
    pub(super) fn of(tally: &Tally) -> Self {
        Self {
            same: tally.same,
            ties: tally.ties,
            within_bound: tally.within_bound,
            explained: tally.explained,
            unexplained: tally.unexplained,
            reasons: tally.reasons.iter().map(|(reason, &count)| (reason.name(), count)).collect(),
            occlusion_checked: tally.occlusion_checked,
            audited: tally.audited,
            native_misses_through_closed_mesh: tally.slipped[0],
            embree_misses_through_closed_mesh: tally.slipped[1],
        }
    }
}

impl Answer {
    pub(super) fn of(hit: &Hit) -> Option<Self> {
        let name = Name::of(hit)?;
        let instance = (name.instance() != crate::accel::NONE).then_some(name.instance());
        Some(Self { t: hit.t, instance, geometry: name.geometry, primitive: name.primitive })
    }
}

impl std::fmt::Display for Answer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { t, instance, geometry, primitive } = self;
        match instance {
            Some(i) => write!(f, "t {t:?}, instance {i}, geometry {geometry}, primitive {primitive}"),
            None => write!(f, "t {t:?}, geometry {geometry}, primitive {primitive}"),
        }
    }
}

impl Worst {
    pub(super) fn of(d: &Disagreement) -> Self {
        Self {
            ray: ray_text(&d.ray),
            kind: d.kind,
            reason: d.reason.name(),
            explained: d.reason.is_explained(),
            answers: Answers { native: Answer::of(&d.hits[0]), embree: Answer::of(&d.hits[1]) },
        }
    }
}

/// The shortest decimals that are these floats and no others: origin, direction, range.
#[must_use]
pub fn ray_text(ray: &Ray) -> String {
    let (o, d) = (ray.origin, ray.direction);
    let numbers = [o.x, o.y, o.z, d.x, d.y, d.z, ray.t_min, ray.t_max].map(|v| format!("{v:?}"));
    numbers.join(",")
}

/// What [`ray_text`] writes; the range may be left out.
///
/// # Errors
/// A line that says what would be right.
pub fn parse_ray(text: &str) -> Result<Ray, String> {
    let numbers: Option<Vec<f32>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let ray = match numbers.as_deref() {
        Some(&[a, b, c, d, e, f]) => Ray::new(glam::Vec3::new(a, b, c), glam::Vec3::new(d, e, f)),
        Some(&[a, b, c, d, e, f, t_min, t_max]) => {
            Ray { t_min, t_max, ..Ray::new(glam::Vec3::new(a, b, c), glam::Vec3::new(d, e, f)) }
        }
        _ => return Err("a ray is ox,oy,oz,dx,dy,dz or ox,oy,oz,dx,dy,dz,tmin,tmax".to_owned()),
    };
    let ordered = ray.t_min >= 0.0 && ray.t_min < ray.t_max;
    if !(ray.origin.is_finite() && ray.direction.is_finite() && ray.direction != glam::Vec3::ZERO && ordered)
    {
        return Err(
            "origin and direction must be finite, the direction not zero, and 0 <= tmin < tmax".to_owned()
        );
    }
    Ok(ray)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_survives_its_text() {
        for ray in ["0.1,-2.5e-30,3e20,1.0,0.33333334,-1e-7,0.0,inf", "1.0,2.0,3.0,0.0,0.0,1.0,0.0,0.9999999"]
        {
            let back = ray_text(&parse_ray(ray).expect("a ray"));
            let again = parse_ray(&back).expect("a ray");
            assert_eq!(back, ray_text(&again));
            let first = parse_ray(ray).expect("a ray");
            assert_eq!((first.origin, first.direction), (again.origin, again.direction));
        }
        for wrong in ["", "1,2,3", "0,0,0,0,0,0", "0,0,0,0,0,nan", "0,0,0,0,0,1,2,1", "a,0,0,0,0,1"] {
            assert!(parse_ray(wrong).is_err(), "{wrong}");
        }
    }
}
