//! What accuracy costs in time: the error and the seconds of every setting that trades one for the other, against a
//! reference, and what follows for the next render.
//!
//! A setting is rendered several times with few samples and different seeds, which gives its error a mean and a spread
//! and tells noise, which more samples take away, from bias, which they do not (`sums`). Sample counts that were not
//! rendered are predicted by the power with which noise falls, as measured on the scene's own settings.
//!
//! Invariant: never renders longer than about the time it is given, but for loading the scene and one short render.

mod advice;
mod bench;
mod knobs;
mod plan;
mod predict;
mod sums;

use crate::error::{Error, Result};
use crate::film::Image;
use crate::film::read::read_image;
use crate::render::stage::effective_film;
use crate::render::{Control, with_frames};
use crate::report::cost::{CostStudy, Picture, Point, Reference, Spread};
use crate::scene::SceneDescription;
use crate::settings::RenderSettings;
use crate::study::diff::REL_MSE_EPSILON;
use bench::Bench;
use knobs::{missing, variants};
use plan::Plan;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What to study, and for how long.
#[derive(Clone, Debug)]
pub struct Options {
    /// The settings that are the scene's own here.
    pub settings: RenderSettings,
    /// Seconds to spend, about; loading the scene is part of it.
    pub budget_s: f64,
    /// The error that is wanted: root mean square, relative.
    pub target: f64,
    /// An image to hold errors against, in place of one that is rendered.
    pub reference: Option<PathBuf>,
    /// Past so many times the seconds nothing new is begun.
    pub patience: f64,
}

/// [`Options::patience`] that a person has.
pub const PATIENCE: f64 = 1.1;

/// What was found, and images for a page.
pub struct Found {
    /// The record.
    pub study: CostStudy,
    /// The reference.
    pub reference: Image,
    /// Renders that took equally long.
    pub pictures: Vec<Picture>,
}

/// Studies `scene`.
///
/// # Errors
/// As rendering; a reference that cannot be read or has another size; [`Error::Interrupted`].
pub fn study(scene: &SceneDescription, options: &Options, control: &Control<'_>) -> Result<Found> {
    let start = Instant::now();
    let whole = RenderSettings { crop: Some([0, 0, 1, 1]), ..options.settings.clone() };
    let film = effective_film(scene, &whole)?;
    let given = options.reference.as_deref().map(|path| read_reference(path, film.size)).transpose()?;
    // A window would be another size at another scale; errors are those of the whole frame.
    let size = film.size;
    let own = RenderSettings {
        crop: Some([0, 0, size.0, size.1]),
        time_limit_seconds: None,
        ..options.settings.clone()
    };
    let study = CostStudy {
        weir: env!("CARGO_PKG_VERSION").into(),
        scene: scene.path.display().to_string(),
        full_size: size.into(),
        budget_s: options.budget_s,
        epsilon: REL_MSE_EPSILON,
        target: options.target,
        left_out: missing(),
        reference: Reference {
            file: options.reference.as_ref().map(|path| path.display().to_string()),
            ..Reference::default()
        },
        ..CostStudy::default()
    };
    let mut bench = Bench {
        scene,
        control,
        start,
        study,
        pictures: Vec::new(),
        seed: own.seed.unwrap_or(scene.seed),
        light: Vec::new(),
        latest_s: options.budget_s * options.patience,
    };
    let all = variants(scene, &own);
    let (truth, plan, like) = with_frames(scene, &own, control, |frames| {
        bench.study.load_s = start.elapsed().as_secs_f64();
        bench.begin(frames, &own, given, &all)
    })?;
    bench.turn_what_reloads(&all, &truth, &plan)?;
    bench.conclude(&all, &own, &truth, &plan)?;
    let mut study = bench.study;
    study.spent_s = start.elapsed().as_secs_f64();
    Ok(Found { study, reference: truth.image(&like), pictures: bench.pictures })
}

/// An image that errors of a film of `size` can be held against.
fn read_reference(path: &Path, size: (u32, u32)) -> Result<Image> {
    let image = read_image(path)?;
    let lost = image.non_finite_pixels();
    let Image { width, height, .. } = image;
    let wrong = if lost > 0 {
        format!("{lost} pixels are infinite or not a number; a reference has none")
    } else if image.pixels.len() > MOST_GIVEN {
        format!("{width}x{height} pixels, and {MOST_GIVEN} are the most; give a smaller one and --size")
    } else if (width, height) != size {
        format!(
            "{width}x{height} pixels, and the film has {}x{}; give --size {width}x{height} or a reference of the film's size",
            size.0, size.1
        )
    } else {
        return Ok(image);
    };
    Err(Error::file(path, wrong))
}

/// Most pixels of a reference that is given: each takes some hundred bytes.
const MOST_GIVEN: usize = 1 << 22;

/// The scene's own settings, as a knob.
const SAMPLES: &str = "samples";

/// The scene's own settings at the plan's sample count, which others are compared with; once they are measured.
fn own<'s>(study: &'s CostStudy, plan: &Plan) -> Option<&'s Point> {
    study.points.iter().find(|p| p.knob == SAMPLES && p.spp == plan.spp)
}

fn spread(values: &[f64]) -> Spread {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n.max(1.0);
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    Spread { mean, deviation: if n > 1.0 { (squares / (n - 1.0)).sqrt() } else { 0.0 } }
}
