//! The renders of a study, one after the other: of the reference, of sample counts, of knobs, of the advice.
//!
//! Invariant: nothing new is begun past the time that there is, but for what the study cannot do without.
//! Never judges: `predict` and `advice` do.

use super::knobs::Variant;
use super::plan::Plan;
use super::sums::{Sums, Truth};
use super::{SAMPLES, advice, own, predict, spread};
use crate::color::luminance;
use crate::error::{Error, Result};
use crate::film::Image;
use crate::render::{Control, Frames, Progress, with_frames};
use crate::report::cost::{Check, CostStudy, LeftOut, Picture, Point, Reference};
use crate::scene::SceneDescription;
use crate::settings::{RenderSettings, Sampler};
use glam::Vec3;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// The study on its way.
pub(super) struct Bench<'a, 'c> {
    pub(super) scene: &'a SceneDescription,
    pub(super) control: &'a Control<'c>,
    pub(super) start: Instant,
    pub(super) study: CostStudy,
    pub(super) pictures: Vec<Picture>,
    /// The scene's.
    pub(super) seed: u64,
    /// Mean luminance of the renders of the scene's own settings that others are compared with.
    pub(super) light: Vec<f64>,
    /// Past so many seconds nothing new is begun.
    pub(super) latest_s: f64,
}

/// Texture footprints shrink with the number of samples down to this one's: all renders have those of long ones, or what
/// a few samples blur would pass for a bias.
const FOOTPRINT_SPP: u32 = 64;

/// Sample and seed of renders that only warm up, and seeds of others than the measured, which have 1, 2 and so on.
const WARM: (u32, u64) = (1, 0);
const REFERENCE: u64 = 1 << 32;
const CHECK: u64 = 1 << 33;

/// Seconds from which on processor time is told well enough: some ticks of a system's clock.
const TOLD_S: f64 = 0.05;

impl Bench<'_, '_> {
    fn phase(&self, name: &'static str) -> Result<()> {
        (self.control.progress)(Progress::Phase(name));
        if self.control.cancel.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
    }

    /// Renders at `spp` samples with the seed of this number; the image and its seconds. Settings that are compared have
    /// the same seeds: much of their noise is the same then, and what chance adds.
    fn render(
        &mut self,
        frames: &mut Frames<'_, '_>,
        settings: &RenderSettings,
        (spp, number): (u32, u64),
        size: (u32, u32),
    ) -> Result<(Image, f64)> {
        let seed = self.seed.wrapping_add(number.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let settings = RenderSettings {
            spp: Some(spp),
            seed: Some(seed),
            footprint_spp: Some(FOOTPRINT_SPP),
            size: Some(size),
            crop: Some([0, 0, size.0, size.1]),
            ..settings.clone()
        };
        let outcome = frames.render(&settings)?;
        if outcome.interrupted {
            return Err(Error::Interrupted);
        }
        self.study.threads = outcome.stats.threads;
        let (wall, busy) = (outcome.stats.time.render_s, outcome.stats.busy);
        // What other programs take of the processors is no cost of this one. Of a few milliseconds the system does not
        // tell who had them.
        Ok((outcome.image, if wall < TOLD_S { wall } else { wall * busy }))
    }

    /// What needs one loading of the scene: how long a sample takes, the reference, the scene's own settings, and knobs
    /// that turn without another loading.
    pub(super) fn begin(
        &mut self,
        frames: &mut Frames<'_, '_>,
        own: &RenderSettings,
        given: Option<Image>,
        all: &[Variant],
    ) -> Result<(Truth, Plan, Image)> {
        self.phase("timing a sample")?;
        let full = (self.study.full_size[0], self.study.full_size[1]);
        let tried = if given.is_some() { full } else { Plan::largest(full) };
        // Twice: the first also reads textures and pages.
        self.render(frames, own, WARM, tried)?;
        let (_, seconds) = self.render(frames, own, WARM, tried)?;
        let depth = own.max_depth.unwrap_or(self.scene.integrator.max_depth);
        let max_depth = depth.saturating_mul(4).max(32);
        let right = RenderSettings { max_depth: Some(max_depth), sampler: Sampler::Sobol, ..own.clone() };
        let of_reference =
            if given.is_some() { seconds } else { self.render(frames, &right, WARM, tried)?.1 };
        let pixels = |size: (u32, u32)| f64::from(size.0) * f64::from(size.1);
        let whole = pixels(full) / pixels(tried);
        let left = (self.study.budget_s - self.start.elapsed().as_secs_f64()).max(1.0);
        let costs = (seconds * whole, of_reference * whole);
        let plan = Plan::new(full, costs, left, self.study.load_s, all, given.is_some());
        self.study.size = plan.size.into();

        let reference_start = Instant::now();
        let (truth, like) = match given {
            Some(image) => (Truth::given(&image), image),
            None => {
                self.phase("rendering the reference")?;
                let mut sums = Sums::new(plan.size.0, plan.size.1);
                let mut like = Image::new(0, 0);
                for part in 0..u64::from(Plan::REFERENCE_PARTS) {
                    like = self.render(frames, &right, (plan.reference_spp, REFERENCE + part), plan.size)?.0;
                    sums.add(&like);
                }
                let truth = sums.into_truth();
                self.study.reference = Reference {
                    file: None,
                    spp: u64::from(plan.reference_spp) * u64::from(Plan::REFERENCE_PARTS),
                    max_depth,
                    seconds: reference_start.elapsed().as_secs_f64(),
                    error: Some(truth.relmse.sqrt()),
                };
                (truth, like)
            }
        };

        self.phase("measuring samples")?;
        let knob = Variant {
            knob: SAMPLES,
            value: String::new(),
            options: String::new(),
            settings: own.clone(),
            reloads: false,
        };
        for &(spp, renders) in &plan.ladder {
            let variant = Variant { value: spp.to_string(), options: format!("--spp {spp}"), ..knob.clone() };
            self.measure(frames, &variant, (spp, renders), &truth, &plan)?;
        }
        self.study.slope = predict::slope(&self.study.points);
        self.phase("turning knobs")?;
        for variant in all.iter().filter(|v| !v.reloads) {
            self.measure(frames, variant, (plan.spp, plan.renders), &truth, &plan)?;
        }
        Ok((truth, plan, like))
    }

    /// Knobs that want the scene loaded again.
    pub(super) fn turn_what_reloads(&mut self, all: &[Variant], truth: &Truth, plan: &Plan) -> Result<()> {
        let reloading: Vec<&Variant> = all.iter().filter(|v| v.reloads).collect();
        if !plan.reloads && !reloading.is_empty() {
            let because = format!(
                "loading the scene again takes {:.1} s each; a larger --budget would do",
                self.study.load_s
            );
            let mut names: Vec<&str> = reloading.iter().map(|v| v.knob).collect();
            names.dedup();
            let left_out = |knob: &str| LeftOut { knob: knob.to_owned(), because: because.clone() };
            self.study.left_out.splice(0..0, names.into_iter().map(left_out));
            return Ok(());
        }
        for variant in reloading {
            self.phase("turning knobs")?;
            with_frames(self.scene, &variant.settings, self.control, |frames| {
                // What is read for the first time is not to be timed.
                self.render(frames, &variant.settings, WARM, plan.size)?;
                self.measure(frames, variant, (plan.spp, plan.renders), truth, plan)
            })?;
        }
        Ok(())
    }

    /// Renders `variant` some times, and writes down a point. Also a render that takes as long as the scene's own
    /// settings at the plan's sample count.
    fn measure(
        &mut self,
        frames: &mut Frames<'_, '_>,
        variant: &Variant,
        (spp, renders): (u32, u32),
        truth: &Truth,
        plan: &Plan,
    ) -> Result<()> {
        if variant.knob != SAMPLES && self.start.elapsed().as_secs_f64() > self.latest_s {
            let knob = format!("{} {}", variant.knob, variant.value);
            let because = "no time was left; a larger --budget would do".to_owned();
            self.study.left_out.insert(0, LeftOut { knob, because });
            return Ok(());
        }
        let mut sums = Sums::new(plan.size.0, plan.size.1);
        let (mut seconds, mut relmse, mut light) = (Vec::new(), Vec::new(), Vec::new());
        let mut first = None;
        for number in 1..=u64::from(renders) {
            let (image, time) = self.render(frames, &variant.settings, (spp, number), plan.size)?;
            sums.add(&image);
            relmse.push(truth.relmse_of(&image));
            light.push(mean_luminance(&image));
            seconds.push(time);
            first.get_or_insert((image, time));
        }
        let found = sums.bias(truth);
        if variant.knob == SAMPLES && spp == plan.spp {
            self.light.clone_from(&light);
        }
        let more: Vec<f64> = light
            .iter()
            .zip(&self.light)
            .filter(|(_, own)| **own > 0.0)
            .map(|(l, own)| l / own - 1.0)
            .collect();
        let square = spread(&relmse).mean.max(0.0);
        // Four standard deviations of an estimate that is not quite normal.
        let biased = found.square > 4.0 * found.deviation;
        let bias = if biased { found.square.min(square) } else { 0.0 };
        self.study.points.push(Point {
            knob: variant.knob.to_owned(),
            value: variant.value.clone(),
            options: variant.options.clone(),
            spp,
            renders,
            seconds: spread(&seconds),
            relmse,
            error: square.sqrt(),
            noise: (square - bias).sqrt(),
            bias: bias.sqrt(),
            light: (variant.knob != SAMPLES && spp == plan.spp && !more.is_empty()).then(|| spread(&more)),
            bias_bound: (found.square.max(0.0) + 3.0 * found.deviation).sqrt(),
            ..Point::default()
        });
        let point = self.study.points.len() - 1;
        let Some(own) = own(&self.study, plan).map(|own| own.seconds.mean) else { return Ok(()) };
        if spp != plan.spp {
            return Ok(());
        }
        let equal = plan.spp_in(own, &self.study.points[point]);
        let (image, seconds) = match first {
            Some(first) if equal == spp => first,
            _ => self.render(frames, &variant.settings, (equal, 1), plan.size)?,
        };
        self.pictures.push(Picture { point, spp: equal, seconds, image });
        Ok(())
    }

    /// What helps, all at once; what follows; and whether it is true.
    pub(super) fn conclude(
        &mut self,
        all: &[Variant],
        own: &RenderSettings,
        truth: &Truth,
        plan: &Plan,
    ) -> Result<()> {
        predict::predict(&mut self.study, plan);
        let joint = advice::joint(&self.study, all, own, self.scene.integrator.max_depth);
        let joint = joint.filter(|joint| plan.reloads || !joint.reloads);
        let mut advised = None;
        if let Some(joint) = &joint {
            self.phase("turning them together")?;
            advised = with_frames(self.scene, &joint.settings, self.control, |frames| {
                self.render(frames, &joint.settings, WARM, plan.size)?;
                // Two counts, for a slope of their own.
                let few = (plan.spp / 4).max(1);
                self.measure(frames, joint, (few, plan.renders), truth, plan)?;
                self.measure(frames, joint, (plan.spp, plan.renders), truth, plan)?;
                predict::predict(&mut self.study, plan);
                let helps = advice::joint_that_helps(&self.study);
                if let Some(found) = helps.and_then(|point| self.prediction(point, plan)) {
                    self.check(frames, &joint.settings, found, truth, plan)?;
                }
                Ok(helps)
            })?;
        }
        let point = match advised {
            Some(point) => point,
            None => {
                let last = self.study.points.iter().rposition(|p| p.knob == SAMPLES).unwrap_or(0);
                if let Some(found) = self.prediction(last, plan) {
                    with_frames(self.scene, own, self.control, |frames| {
                        self.render(frames, own, WARM, plan.size)?;
                        self.check(frames, own, found, truth, plan)
                    })?;
                }
                last
            }
        };
        self.study.advice = advice::sentences(&self.study, point, plan);
        Ok(())
    }

    /// What `point` predicts of a render that there is time for, and that has noise.
    fn prediction(&self, point: usize, plan: &Plan) -> Option<Check> {
        let left = self.study.budget_s - self.start.elapsed().as_secs_f64();
        let of = &self.study.points[point];
        if left <= 0.0 || of.noise == 0.0 {
            return None;
        }
        let (spp, predicted, predicted_s) = predict::checkable(&self.study, point, plan, left)?;
        // A count of samples is told apart.
        let options = if of.knob == SAMPLES { String::new() } else { of.options.clone() };
        Some(Check { options, spp, predicted, predicted_s, ..Check::default() })
    }

    /// Holds a prediction for `settings`, which are loaded, against a render.
    fn check(
        &mut self,
        frames: &mut Frames<'_, '_>,
        settings: &RenderSettings,
        prediction: Check,
        truth: &Truth,
        plan: &Plan,
    ) -> Result<()> {
        self.phase("checking the advice")?;
        let (image, measured_s) = self.render(frames, settings, (prediction.spp, CHECK), plan.size)?;
        let measured = truth.relmse_of(&image).max(0.0).sqrt();
        self.study.checks.push(Check { measured, measured_s, ..prediction });
        Ok(())
    }
}

/// Of the pixels that are numbers.
fn mean_luminance(image: &Image) -> f64 {
    let finite = image.pixels.iter().filter(|p| p.iter().all(|c| c.is_finite()));
    let sum: f64 = finite.map(|p| f64::from(luminance(Vec3::from(*p)))).sum();
    sum / image.pixels.len().max(1) as f64
}
