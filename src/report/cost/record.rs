//! What a study of cost found. Errors are root mean square relative errors: the root of relMSE with the record's
//! ε, without the pixels of largest error (`weir diff`'s trimmed relMSE).

use crate::film::Image;
use serde::{Deserialize, Serialize};

/// A study of what accuracy costs in time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CostStudy {
    /// Version of Weir.
    pub weir: String,
    /// The scene's file.
    pub scene: String,
    /// Pixels that were rendered, across and down.
    pub size: [u32; 2],
    /// Pixels of the film that seconds at a target are told for.
    pub full_size: [u32; 2],
    /// Threads.
    pub threads: usize,
    /// Seconds that the study was given, and that it took.
    pub budget_s: f64,
    /// See `budget_s`.
    pub spent_s: f64,
    /// Seconds to load and build the scene once; not part of any other time here.
    pub load_s: f64,
    /// ε of relMSE.
    pub epsilon: f64,
    /// The error that seconds are told for.
    pub target: f64,
    /// What errors are held against.
    pub reference: Reference,
    /// Noise falls with this power of the number of samples (squared: 1 for independent samples), as measured.
    pub slope: f64,
    /// Everything that was measured.
    pub points: Vec<Point>,
    /// What follows, a sentence each.
    pub advice: Vec<String>,
    /// Predictions, held against renders.
    pub checks: Vec<Check>,
    /// What was not measured, and why.
    pub left_out: Vec<LeftOut>,
}

/// What errors are held against.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Reference {
    /// The file that was given; absent where it was rendered.
    pub file: Option<String>,
    /// Samples per pixel of all its renders.
    pub spp: u64,
    /// Scattering events of its paths.
    pub max_depth: u32,
    /// Seconds that it took.
    pub seconds: f64,
    /// Its own error, estimated from its parts; absent where it was given.
    pub error: Option<f64>,
}

/// A mean and the standard deviation of one value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation; 0 of a single value.
    pub deviation: f64,
}

/// One setting of one knob, measured by some renders of different seeds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Point {
    /// Which knob was turned; `samples` for the scene's own settings at several sample counts.
    pub knob: String,
    /// To what.
    pub value: String,
    /// The options of `weir render` that do so.
    pub options: String,
    /// Samples per pixel of each render.
    pub spp: u32,
    /// Renders.
    pub renders: u32,
    /// Processor seconds of rendering over threads, each.
    pub seconds: Spread,
    /// relMSE of each against the reference, less what the reference's own noise adds. Settings with equally many samples
    /// have renders of the same seeds, in this order.
    pub relmse: Vec<f64>,
    /// Root of the mean of `relmse`.
    pub error: f64,
    /// Part of it that more samples take away.
    pub noise: f64,
    /// Part that they do not; 0 where it cannot be told from none.
    pub bias: f64,
    /// Three standard deviations above the estimate of the bias: it is hardly more.
    pub bias_bound: f64,
    /// How much more light it has in all than the scene's own settings in renders of the same seeds, as a share; absent
    /// for those.
    pub light: Option<Spread>,
    /// What the target takes with it; absent where no number of samples reaches it.
    pub at_target: Option<AtTarget>,
    /// Seconds at the target over those of the scene's own settings.
    pub over_own: Option<f64>,
    /// Standard deviation of the logarithm of `over_own`, as told from the renders; two of them are taken for chance.
    pub over_own_deviation: f64,
    /// Nothing that was measured has less error in less time.
    pub best: bool,
}

/// What it takes to have the error that was asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AtTarget {
    /// Samples per pixel.
    pub spp: f64,
    /// Seconds for the whole film.
    pub seconds: f64,
}

/// A prediction and what a render said.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Check {
    /// The options.
    pub options: String,
    /// Samples per pixel.
    pub spp: u32,
    /// The error that was predicted, and that of the render.
    pub predicted: f64,
    /// See `predicted`.
    pub measured: f64,
    /// Seconds that were predicted, and that it took; of what was rendered.
    pub predicted_s: f64,
    /// See `predicted_s`.
    pub measured_s: f64,
}

/// A knob that was left alone.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LeftOut {
    /// Which.
    pub knob: String,
    /// Why.
    pub because: String,
}

/// A render that took as long as the others beside it, for the page.
pub struct Picture {
    /// Its point's place in the record.
    pub point: usize,
    /// Samples per pixel, and seconds.
    pub spp: u32,
    /// See `spp`.
    pub seconds: f64,
    /// The render.
    pub image: Image,
}
