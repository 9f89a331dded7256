//! Whether an image differs from what it should be by more than chance. A scene is rendered several
//! times with seeds of their own; the spread of those runs is the noise, and nothing need be assumed
//! about the sampler but that seeds are independent.
//!
//! Every test states its false-alarm rate for the whole image: a pixel is held to the rate that Šidák
//! 1967 gives for that many pixels. Seeds are fixed, so that a test which passes once passes always.

use crate::support::{grey, image, mean};
use weir::film::Image;
use weir::scene::SceneDescription;
use weir::settings::RenderSettings;

/// Chance that a right image is called wrong, once for its pixels and once for its mean.
pub(crate) const FALSE_ALARM: f64 = 1e-3;

/// What rounding may add to a pixel, relative: paths of tens of vertices with a few roundings each.
const ROUNDING: f64 = 2e-5;

/// Several independent renders of one scene.
pub(crate) struct Runs {
    /// Pixels (mean of the channels), by run.
    pixels: Vec<Vec<f64>>,
}

impl Runs {
    pub(crate) fn of(scene: &SceneDescription, settings: &RenderSettings, count: u64) -> Self {
        let one = |seed| grey(&image(scene, &RenderSettings { seed: Some(1000 + seed), ..settings.clone() }));
        Self { pixels: (0..count).map(one).collect() }
    }

    fn column(&self, pixel: usize) -> Summary {
        Summary::of(self.pixels.iter().map(|run| run[pixel]))
    }

    fn columns(&self) -> Vec<Summary> {
        (0..self.pixels[0].len()).map(|i| self.column(i)).collect()
    }

    /// Of the image's mean, run by run: errors that pixels share show here.
    pub(crate) fn whole(&self) -> Summary {
        Summary::of(self.pixels.iter().map(|run| mean(run)))
    }

    /// Holds every pixel, and the mean of all, against known values. `resolution` is the standard error
    /// of the image's mean, relative, that the test must reach: noise alone must not make it pass.
    #[track_caller]
    pub(crate) fn assert_is(&self, expected: &[f64], resolution: f64, what: &str) {
        assert_eq!(expected.len(), self.pixels[0].len(), "{what}");
        let known: Vec<Summary> = expected.iter().map(|&e| Summary::known(e)).collect();
        judge(&self.columns(), &known, what);
        self.assert_mean(mean(expected), resolution, what);
    }

    /// Mean over pixels of the variance of their mean.
    pub(crate) fn noise(&self) -> f64 {
        let columns = self.columns();
        columns.iter().map(|c| c.variance).sum::<f64>() / columns.len() as f64
    }

    /// The mean over runs of one pixel.
    pub(crate) fn mean_of(&self, pixel: usize) -> f64 {
        self.column(pixel).mean
    }

    /// As [`Self::assert_is`] where the known values are themselves only good to `slack`.
    #[track_caller]
    pub(crate) fn assert_near(&self, expected: &[f64], resolution: f64, slack: f64, what: &str) {
        let near = |(got, e): (Summary, &f64)| {
            let apart = got.mean - e;
            Summary { mean: e + apart.signum() * (apart.abs() - slack).max(0.0), ..got }
        };
        let columns: Vec<Summary> = self.columns().into_iter().zip(expected).map(near).collect();
        let known: Vec<Summary> = expected.iter().map(|&e| Summary::known(e)).collect();
        judge(&columns, &known, what);
        let error = self.whole().error() / mean(expected).abs();
        assert!(
            error <= resolution || resolution.is_infinite(),
            "{what}: too noisy to say: standard error {error:.2e}"
        );
    }

    /// Holds the image's mean alone against a known value.
    #[track_caller]
    pub(crate) fn assert_mean(&self, expected: f64, resolution: f64, what: &str) {
        let whole = self.whole();
        judge(&[whole], &[Summary::known(expected)], &format!("{what}, mean of the image"));
        let error = whole.error() / expected.abs();
        assert!(error <= resolution, "{what}: too noisy to say: standard error {error:.2e} of the mean");
    }

    /// The same of another way to estimate one picture.
    #[track_caller]
    pub(crate) fn assert_agrees(&self, other: &Self, resolution: f64, what: &str) {
        judge(&self.columns(), &other.columns(), what);
        let (a, b) = (self.whole(), other.whole());
        judge(&[a], &[b], &format!("{what}, mean of the image"));
        let error = a.error().hypot(b.error()) / b.mean.abs();
        assert!(error <= resolution, "{what}: too noisy to say: standard error {error:.2e} of the mean");
    }
}

/// Mean of independent values and the variance of that mean.
#[derive(Clone, Copy)]
pub(crate) struct Summary {
    pub(crate) mean: f64,
    variance: f64,
    /// Degrees of freedom of `variance`; none for a known value.
    freedom: f64,
}

impl Summary {
    fn known(mean: f64) -> Self {
        Self { mean, variance: 0.0, freedom: f64::INFINITY }
    }

    fn of(values: impl Iterator<Item = f64> + Clone) -> Self {
        let n = values.clone().count() as f64;
        let mean = values.clone().sum::<f64>() / n;
        let variance = values.map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0) / n;
        Self { mean, variance, freedom: n - 1.0 }
    }

    pub(crate) fn error(&self) -> f64 {
        self.variance.sqrt()
    }

    /// How many standard errors apart, as the normal deviate of equal significance (Welch's t with
    /// his degrees of freedom).
    fn deviate(&self, other: &Self) -> f64 {
        let variance = self.variance + other.variance;
        let apart = (self.mean - other.mean).abs();
        let slack = ROUNDING * (self.mean.abs() + other.mean.abs()) * 0.5;
        let apart = (apart - slack).max(0.0);
        if apart == 0.0 {
            return 0.0;
        }
        if variance == 0.0 {
            return f64::INFINITY;
        }
        let freedom = variance.powi(2)
            / (self.variance.powi(2) / self.freedom + other.variance.powi(2) / other.freedom);
        normal_of_t(apart / variance.sqrt(), freedom)
    }
}

/// The normal deviate whose two-sided tail is that of `t` (Wallace 1959, bound A).
fn normal_of_t(t: f64, freedom: f64) -> f64 {
    (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0) * (freedom * (t * t / freedom).ln_1p()).sqrt()
}

/// Two-sided tail of the normal distribution (Numerical Recipes' erfc, relative error 1.2e-7).
fn tail(z: f64) -> f64 {
    let x = z.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.5 * x);
    const C: [f64; 10] = [
        -1.265_512_23,
        1.000_023_68,
        0.374_091_96,
        0.096_784_18,
        -0.186_288_06,
        0.278_868_07,
        -1.135_203_98,
        1.488_515_87,
        -0.822_152_23,
        0.170_872_77,
    ];
    t * (-x * x + C.iter().rev().fold(0.0, |sum, c| sum * t + c)).exp()
}

#[track_caller]
fn judge(a: &[Summary], b: &[Summary], what: &str) {
    let each = -((-FALSE_ALARM).ln_1p() / a.len() as f64).exp_m1();
    let mut wrong: Vec<(usize, f64)> =
        a.iter().zip(b).map(|(a, b)| a.deviate(b)).enumerate().filter(|&(_, z)| tail(z) < each).collect();
    wrong.sort_by(|x, y| y.1.total_cmp(&x.1));
    let worst: Vec<String> = wrong
        .iter()
        .take(5)
        .map(|&(i, z)| {
            format!(
                "{i}: {:.6} ± {:.6} against {:.6} ± {:.6} (z {z:.1})",
                a[i].mean,
                a[i].error(),
                b[i].mean,
                b[i].error()
            )
        })
        .collect();
    assert!(wrong.is_empty(), "{what}: {} of {} differ: {}", wrong.len(), a.len(), worst.join("; "));
}

/// How many pixels of two images of the same samples differ by more than `relative`.
pub(crate) fn differing(a: &Image, b: &Image, relative: f32) -> usize {
    assert_eq!((a.width, a.height), (b.width, b.height));
    let far = |(x, y): (&[f32; 3], &[f32; 3])| {
        x.iter().zip(y).any(|(x, y)| (x - y).abs() > relative * x.abs().max(y.abs()).max(1e-3))
    };
    a.pixels.iter().zip(&b.pixels).filter(|&p| far(p)).count()
}

#[test]
fn tails_are_those_of_the_tables() {
    for (z, p) in [(0.0, 1.0), (1.959_964, 0.05), (3.290_527, 1e-3), (4.891_638, 1e-6)] {
        assert!((tail(z) / p - 1.0).abs() < 1e-4, "{z}: {} is not {p}", tail(z));
    }
    // Student's t: two-sided 1e-3 and 1e-4 of 15 degrees of freedom.
    for (t, p) in [(4.0728, 1e-3), (5.2391, 1e-4)] {
        assert!((tail(normal_of_t(t, 15.0)) / p - 1.0).abs() < 0.02, "{t}");
    }
}

#[test]
fn a_wrong_mean_is_found_and_a_right_one_passes() {
    let mut state = 7u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let runs = Runs { pixels: (0..16).map(|_| (0..100).map(|_| 0.5 + uniform()).collect()).collect() };
    runs.assert_is(&[1.0; 100], 0.01, "uniform");
    let found = |f: &(dyn Fn() + std::panic::RefUnwindSafe)| std::panic::catch_unwind(f).is_err();
    assert!(found(&|| runs.assert_is(&[1.03; 100], 0.01, "all three per cent off")));
    let mut one = [1.0; 100];
    one[37] = 1.6;
    assert!(found(&|| runs.assert_is(&one, 0.01, "one pixel off")));
    assert!(found(&|| runs.assert_is(&[1.0; 100], 0.001, "not this well known")));
}
