//! How the seconds of a study are spent: on how many pixels, samples and renders.
//!
//! Invariant: what is planned takes no longer than what is left, if samples take as long as the first ones did, but for
//! the least that can be measured at all.

use super::knobs::Variant;
use crate::report::cost::Point;

/// What a study renders.
pub(super) struct Plan {
    /// Pixels.
    pub(super) size: (u32, u32),
    /// Samples of each part of the reference.
    pub(super) reference_spp: u32,
    /// Sample counts of the scene's own settings, and how often each is rendered.
    pub(super) ladder: Vec<(u32, u32)>,
    /// Samples and renders of each other setting.
    pub(super) spp: u32,
    pub(super) renders: u32,
    /// Whether there is time to load the scene again.
    pub(super) reloads: bool,
    /// Pixels of the film over those that are rendered.
    pub(super) scale: f64,
}

/// Shares of the time: for the reference, for the ladder, for knobs. The rest is for what follows.
const REFERENCE: f64 = 0.4;
const LADDER: f64 = 0.15;
const KNOBS: f64 = 0.3;

/// Samples per pixel of a reference that is worth the name.
const LEAST_REFERENCE: f64 = 256.0;
/// Samples per pixel of each other setting, at best: as many as are traced together.
const SPP: u32 = 16;
const RENDERS: u32 = 4;
/// Fewest pixels, so that a mean over them means something.
const LEAST_PIXELS: f64 = 4096.0;
/// Most pixels: more make no mean better known.
const MOST_PIXELS: f64 = 250_000.0;

impl Plan {
    /// Renders that a reference is made of, so that its own error can be told.
    pub(super) const REFERENCE_PARTS: u32 = 4;

    /// The most pixels of a film of `full` that are ever rendered.
    pub(super) fn largest(full: (u32, u32)) -> (u32, u32) {
        scaled(full, MOST_PIXELS / (f64::from(full.0) * f64::from(full.1)))
    }

    /// For a film of `full` pixels, a sample of which takes `seconds`, and one of the reference `of_reference`, within `left`
    /// seconds; loading takes `load`.
    pub(super) fn new(
        full: (u32, u32),
        (seconds, of_reference): (f64, f64),
        left: f64,
        load: f64,
        all: &[Variant],
        given: bool,
    ) -> Self {
        let again = all.iter().filter(|v| v.reloads).count() as f64 * load;
        let reloads = again < 0.15 * left;
        let left = if reloads { left - again } else { left };
        let turned = all.iter().filter(|v| reloads || !v.reloads).count().max(1) as f64;
        let reference = if given { 0.0 } else { REFERENCE };
        let seconds = seconds.max(1e-6);
        // A reference that was given has its size.
        let of_reference = of_reference.max(seconds);
        let least = (LEAST_REFERENCE * of_reference / (REFERENCE * left))
            .max(turned * f64::from(SPP * RENDERS) * seconds / (KNOBS * left));
        let pixels = f64::from(full.0) * f64::from(full.1);
        let wanted = if given {
            pixels
        } else {
            (pixels / least.max(1.0)).clamp(LEAST_PIXELS, MOST_PIXELS).min(pixels)
        };
        let size = if given { full } else { scaled(full, wanted / pixels) };
        let scale = pixels / (f64::from(size.0) * f64::from(size.1));
        let each = seconds / scale;
        let reference_spp =
            (reference * left / (of_reference / scale) / f64::from(Self::REFERENCE_PARTS)) as u32;
        let knobs = KNOBS * left / each / turned;
        let spp = [SPP, 8, 4, 2].into_iter().find(|&n| f64::from(n * RENDERS) <= knobs).unwrap_or(1);
        // Each rung takes twice as long as the one before: all of them twice the last.
        let most = (LADDER * left / each / 2.0 / f64::from(RENDERS)) as u32;
        let mut ladder: Vec<(u32, u32)> =
            (0..12).map(|i| 1 << i).filter(|&n| n <= most.max(spp)).map(|n| (n, RENDERS)).collect();
        // The largest count may have room for two renders.
        if let Some(&(last, _)) = ladder.last().filter(|(last, _)| *last <= most && *last > spp) {
            ladder.push((last * 2, 2));
        }
        let reference_spp = reference_spp.clamp(spp.max(4), 1 << 20);
        Self { size, reference_spp, ladder, spp, renders: RENDERS, reloads, scale }
    }

    /// Samples that `point`'s setting has in `seconds`.
    pub(super) fn spp_in(&self, seconds: f64, point: &Point) -> u32 {
        let each = point.seconds.mean / f64::from(point.spp.max(1));
        if each > 0.0 { (seconds / each).round().clamp(1.0, 65536.0) as u32 } else { point.spp }
    }
}

/// `size` with `share` of its pixels, in its shape.
fn scaled(size: (u32, u32), share: f64) -> (u32, u32) {
    let side = share.min(1.0).sqrt();
    let of = |n: u32| ((f64::from(n) * side).round() as u32).clamp(1, n);
    (of(size.0), of(size.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::RenderSettings;

    fn variants(count: usize, reloads: bool) -> Vec<Variant> {
        let one = Variant {
            knob: "knob",
            value: String::new(),
            options: String::new(),
            settings: RenderSettings::default(),
            reloads,
        };
        vec![one; count]
    }

    #[test]
    fn what_is_planned_fits_in_the_time() {
        for full in [(1280, 720), (64, 64), (400, 300)] {
            for seconds in [0.001, 0.02, 0.5] {
                for left in [10.0, 60.0, 600.0] {
                    let all = [variants(9, false), variants(6, true)].concat();
                    let plan = Plan::new(full, (seconds, seconds), left, 0.1, &all, false);
                    let each = seconds / plan.scale;
                    let samples = f64::from(plan.reference_spp * Plan::REFERENCE_PARTS)
                        + plan.ladder.iter().map(|&(n, r)| f64::from(n * r)).sum::<f64>()
                        // And once more for the pictures of equal time.
                        + 15.0 * f64::from(plan.spp * (plan.renders + 1));
                    let least = plan.spp <= 2;
                    assert!(
                        least || samples * each < left,
                        "{full:?} {seconds} {left}: {} s at {:?}",
                        samples * each,
                        plan.size
                    );
                    assert!(plan.ladder.iter().any(|&(n, _)| n == plan.spp), "{:?}", plan.ladder);
                    assert!(plan.ladder.len() >= 2 || plan.spp == 1);
                }
            }
        }
    }

    #[test]
    fn a_scene_that_loads_slowly_is_loaded_once() {
        assert!(!Plan::new((640, 360), (0.02, 0.02), 60.0, 20.0, &variants(3, true), false).reloads);
        assert!(Plan::new((640, 360), (0.02, 0.02), 60.0, 0.2, &variants(3, true), false).reloads);
        let given = Plan::new((1280, 720), (0.1, 0.1), 60.0, 0.2, &variants(3, true), true);
        assert_eq!((given.size, given.scale), ((1280, 720), 1.0));
    }
}
