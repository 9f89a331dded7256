//! Piecewise linear spectra and their reduction to linear Rec. 709 RGB. Runs while a scene is read;
//! the renderer itself never sees a wavelength.
//!
//! Invariant: a `Spectrum` has at least one sample, wavelengths in nm strictly increase, and all
//! numbers are finite. Integrals run over 360 to 830 nm in steps of 1 nm, in f64.

use super::data::cie::{CIE_X, CIE_Y, CIE_Z, DAYLIGHT_S0, DAYLIGHT_S1, DAYLIGHT_S2};
use super::{Rgb, named};
use glam::{DMat3, DVec3, Vec3};
use std::sync::LazyLock;

/// First wavelength of the colour matching functions in nm.
const FIRST_NM: i32 = 360;
/// Last wavelength of the colour matching functions in nm.
const LAST_NM: i32 = 830;
/// Step of the stored colour matching functions in nm.
const CIE_STEP_NM: f64 = 5.0;
/// Second radiation constant hc/k [nm K] (CODATA 2018).
const C2_NM_K: f64 = 1.438_776_877e7;

/// A function of wavelength: linear between samples, zero outside them (as pbrt-v4 reads it),
/// except that a single sample stands for a constant.
#[derive(Clone, Debug, PartialEq)]
pub struct Spectrum {
    samples: Vec<(f32, f32)>,
}

impl Spectrum {
    /// The same `value` at every wavelength.
    #[must_use]
    pub fn constant(value: f32) -> Self {
        Self { samples: vec![(560.0, value)] }
    }

    /// From (wavelength in nm, value) pairs.
    ///
    /// # Errors
    /// One line saying which pair is wrong, where there is none, where wavelengths do not strictly
    /// increase, or where a number is not finite.
    pub fn from_samples(samples: Vec<(f32, f32)>) -> Result<Self, String> {
        if samples.is_empty() {
            return Err("a spectrum without samples; expected pairs of wavelength in nm and value".into());
        }
        for (i, &(nm, value)) in samples.iter().enumerate() {
            if !nm.is_finite() || !value.is_finite() {
                return Err(format!("spectrum pair {} is not finite; expected two finite numbers", i + 1));
            }
            if i > 0 && nm <= samples[i - 1].0 {
                let before = samples[i - 1].0;
                return Err(format!(
                    "spectrum wavelength {nm} nm of pair {} follows {before} nm; expected strictly increasing wavelengths",
                    i + 1
                ));
            }
        }
        Ok(Self { samples })
    }

    /// From the text of an `.spd` file: wavelength in nm and value in turn, separated by blanks or
    /// commas; `#` starts a comment.
    ///
    /// # Errors
    /// As [`Spectrum::from_samples`], and for a word that is no number (with its line).
    pub fn from_spd_text(text: &str) -> Result<Self, String> {
        let mut numbers = Vec::new();
        for (number, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default();
            for word in line.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty()) {
                let value: f32 = word.parse().map_err(|_| {
                    let shown: String = word.chars().take(24).collect();
                    format!("line {}: \"{shown}\" in a spectrum; expected a number", number + 1)
                })?;
                numbers.push(value);
            }
        }
        if numbers.len() % 2 != 0 {
            let n = numbers.len();
            return Err(format!("a spectrum with {n} numbers; expected pairs of wavelength in nm and value"));
        }
        Self::from_samples(numbers.chunks_exact(2).map(|p| (p[0], p[1])).collect())
    }

    /// One of pbrt-v4's named spectra; illuminants are scaled to a luminance Y of 1, as there.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        named::find(name)
    }

    /// The names that [`Spectrum::named`] knows.
    #[must_use]
    pub fn names() -> &'static [&'static str] {
        named::NAMES
    }

    /// The CIE daylight of a nominal colour temperature in kelvin, Y = 1; below 4000 K, where daylight
    /// is undefined, a black body (CIE 15, §3.1; as pbrt-v4's sensors have it). `None` unless
    /// the temperature is positive and finite.
    #[must_use]
    pub fn daylight(kelvin: f64) -> Option<Self> {
        // The daylight formulas use the radiation constant of 1968; D65 is therefore 6504 K.
        let cct = kelvin * (1.4388 / 1.4380);
        if cct < 4000.0 {
            return Self::blackbody(cct);
        }
        if !cct.is_finite() {
            return None;
        }
        let (a, b, c, d) = if cct <= 7000.0 {
            (-4.607e9, 2.9678e6, 0.09911e3, 0.244_063)
        } else {
            (-2.0064e9, 1.9018e6, 0.24748e3, 0.23704)
        };
        let x = ((a / cct + b) / cct + c) / cct + d;
        let y = -3.0 * x * x + 2.870 * x - 0.275;
        let m = 0.0241 + 0.2562 * x - 0.7341 * y;
        let m1 = (-1.3515 - 1.7703 * x + 5.9114 * y) / m;
        let m2 = (0.0300 - 31.4424 * x + 30.0717 * y) / m;
        let samples = (0..DAYLIGHT_S0.len()).map(|i| {
            let s =
                f64::from(DAYLIGHT_S0[i]) + m1 * f64::from(DAYLIGHT_S1[i]) + m2 * f64::from(DAYLIGHT_S2[i]);
            (300.0 + 10.0 * i as f32, s.max(0.0) as f32)
        });
        Some(Self { samples: samples.collect() }.with_unit_luminance())
    }

    /// A black body, Y = 1, every 5 nm. `None` unless the temperature is positive and finite.
    #[must_use]
    pub fn blackbody(kelvin: f64) -> Option<Self> {
        (kelvin > 0.0 && kelvin.is_finite()).then(|| {
            let y = xyz_integral(|nm| planck_relative(nm, kelvin)).y / y_integral();
            let samples = (FIRST_NM..=LAST_NM).step_by(5);
            let samples = samples.map(|nm| (nm as f32, (planck_relative(f64::from(nm), kelvin) / y) as f32));
            Self { samples: samples.collect() }
        })
    }

    /// The samples, (wavelength in nm, value), wavelengths increasing.
    #[must_use]
    pub fn samples(&self) -> &[(f32, f32)] {
        &self.samples
    }

    /// The value at `nm`; zero outside the samples.
    #[must_use]
    pub fn eval(&self, nm: f64) -> f64 {
        let inside = self.samples.len() == 1
            || (nm >= f64::from(self.samples[0].0)
                && nm <= f64::from(self.samples[self.samples.len() - 1].0));
        if inside { self.eval_clamped(nm) } else { 0.0 }
    }

    /// The value at `nm`; the nearest sample's outside them (for refractive indices, which do not
    /// vanish where a table ends).
    #[must_use]
    pub fn eval_clamped(&self, nm: f64) -> f64 {
        let after = self.samples.partition_point(|s| f64::from(s.0) <= nm);
        if after == 0 || after == self.samples.len() {
            return f64::from(self.samples[after.saturating_sub(1)].1);
        }
        let (a, b) = (self.samples[after - 1], self.samples[after]);
        let t = (nm - f64::from(a.0)) / (f64::from(b.0) - f64::from(a.0));
        f64::from(a.1) + t * (f64::from(b.1) - f64::from(a.1))
    }

    /// Every value times `factor`.
    #[must_use]
    pub fn scaled(mut self, factor: f32) -> Self {
        self.samples.iter_mut().for_each(|s| s.1 *= factor);
        self
    }

    /// Tristimulus values, scaled so that a constant 1 has Y = 1 (pbrt-v4's `SpectrumToXYZ`).
    #[must_use]
    pub fn to_xyz(&self) -> Vec3 {
        (xyz_integral(|nm| self.eval(nm)) / y_integral()).as_vec3()
    }

    /// An emitter's colour at luminance 1; black where the spectrum has none. Components outside
    /// the Rec. 709 gamut become 0, and the rest is scaled back to luminance 1.
    #[must_use]
    pub fn to_rgb_illuminant(&self) -> Rgb {
        unit_luminance_rgb(xyz_integral(|nm| self.eval(nm)))
    }

    /// Average for each channel over equal energy and over the wavelengths that the samples cover,
    /// weighted by the positive part of the Rec. 709 matching functions: a constant v gives
    /// (v, v, v), and no result leaves the spectrum's range. For refractive indices.
    #[must_use]
    pub fn to_rgb_unbounded(&self) -> Rgb {
        let (mut sum, mut weight) = (DVec3::ZERO, DVec3::ZERO);
        let covered = self.samples[0].0..=self.samples[self.samples.len() - 1].0;
        for nm in FIRST_NM..=LAST_NM {
            if self.samples.len() == 1 || covered.contains(&(nm as f32)) {
                let w = (SPACE.from_xyz * cie(f64::from(nm))).max(DVec3::ZERO);
                sum += w * self.eval_clamped(f64::from(nm));
                weight += w;
            }
        }
        let mean = self.eval_clamped(560.0);
        let channel = |i: usize| if weight[i] > 0.0 { sum[i] / weight[i] } else { mean };
        DVec3::new(channel(0), channel(1), channel(2)).as_vec3()
    }

    /// A reflectance's colour under D65: a constant v gives (v, v, v). Clamped below at 0 and
    /// above at 1 (or at the largest sample, where that exceeds 1), so that a saturated colour
    /// outside the gamut cannot make energy.
    #[must_use]
    pub fn to_rgb_albedo(&self) -> Rgb {
        let top = self.samples.iter().fold(1f32, |m, s| m.max(s.1));
        reflectance_rgb(|nm| self.eval(nm)).as_vec3().clamp(Vec3::ZERO, Vec3::splat(top))
    }

    /// Scaled to Y = 1 where Y is positive.
    pub(super) fn with_unit_luminance(self) -> Self {
        let y = xyz_integral(|nm| self.eval(nm)).y / y_integral();
        if y > 0.0 { self.scaled((1.0 / y) as f32) } else { self }
    }
}

/// A reflectance under D65 to linear Rec. 709, unclamped.
pub(super) fn reflectance_rgb(f: impl Fn(f64) -> f64) -> DVec3 {
    let d65 = &*D65;
    SPACE.from_xyz * xyz_integral(|nm| d65.eval(nm) * f(nm)) / y_integral()
}

/// The three colour matching functions of the CIE 1931 2 degree observer at `nm`; 0 outside
/// 360 to 830 nm.
#[must_use]
pub fn cie_xyz(nm: f32) -> Vec3 {
    cie(f64::from(nm)).as_vec3()
}

fn cie(nm: f64) -> DVec3 {
    let at = (nm - f64::from(FIRST_NM)) / CIE_STEP_NM;
    if !(0.0..=(CIE_X.len() - 1) as f64).contains(&at) {
        return DVec3::ZERO;
    }
    let i = (at as usize).min(CIE_X.len() - 2);
    let t = at - i as f64;
    let row = |i: usize| DVec3::new(f64::from(CIE_X[i]), f64::from(CIE_Y[i]), f64::from(CIE_Z[i]));
    row(i) * (1.0 - t) + row(i + 1) * t
}

/// Sum over 1 nm steps of `f` times the matching functions.
fn xyz_integral(f: impl Fn(f64) -> f64) -> DVec3 {
    (FIRST_NM..=LAST_NM).map(|nm| cie(f64::from(nm)) * f(f64::from(nm))).sum()
}

/// ∫ȳ dλ, about 106.857 nm.
fn y_integral() -> f64 {
    static Y: LazyLock<f64> = LazyLock::new(|| xyz_integral(|_| 1.0).y);
    *Y
}

/// Planck's law up to a factor that depends on the temperature alone, chosen so that nothing
/// under- or overflows at any temperature.
pub(super) fn planck_relative(nm: f64, kelvin: f64) -> f64 {
    let x = C2_NM_K / (nm * kelvin);
    let x_last = C2_NM_K / (f64::from(LAST_NM) * kelvin);
    (560.0 / nm).powi(5) * (x_last - x).exp() / -(-x).exp_m1()
}

/// D65 at Y = 1.
static D65: LazyLock<Spectrum> =
    LazyLock::new(|| Spectrum::named("stdillum-D65").expect("D65 is among the named spectra"));

/// The Rec. 709 colour space.
struct Space {
    to_xyz: DMat3,
    from_xyz: DMat3,
    white: DVec3,
}

/// Rec. 709 primaries with the white of the tabulated D65 (not of its rounded chromaticity), so
/// that D65 is (1, 1, 1) to rounding.
static SPACE: LazyLock<Space> = LazyLock::new(|| {
    let white = xyz_integral(|nm| D65.eval(nm));
    let white = white / white.y;
    let column = |x: f64, y: f64| DVec3::new(x / y, 1.0, (1.0 - x - y) / y);
    let primaries = DMat3::from_cols(column(0.64, 0.33), column(0.30, 0.60), column(0.15, 0.06));
    let to_xyz = primaries * DMat3::from_diagonal(primaries.inverse() * white);
    Space { to_xyz, from_xyz: to_xyz.inverse(), white }
});

/// Tristimulus values to linear Rec. 709, unclamped.
#[must_use]
pub fn xyz_to_rec709(xyz: Vec3) -> Rgb {
    (SPACE.from_xyz * xyz.as_dvec3()).as_vec3()
}

/// Linear Rec. 709 to tristimulus values.
#[must_use]
pub fn rec709_to_xyz(rgb: Rgb) -> Vec3 {
    (SPACE.to_xyz * rgb.as_dvec3()).as_vec3()
}

fn unit_luminance_rgb(xyz: DVec3) -> Rgb {
    if xyz.y.is_nan() || xyz.y <= 0.0 {
        return Rgb::ZERO;
    }
    let rgb = (SPACE.from_xyz * (xyz / xyz.y)).max(DVec3::ZERO);
    (rgb / (SPACE.to_xyz * rgb).y).as_vec3()
}

/// The colour of a black body of `kelvin`, luminance 1; black unless the temperature is positive
/// and finite. Out-of-gamut components as in [`Spectrum::to_rgb_illuminant`].
#[must_use]
pub fn blackbody_rgb(kelvin: f32) -> Rgb {
    if kelvin > 0.0 && kelvin.is_finite() {
        unit_luminance_rgb(xyz_integral(|nm| planck_relative(nm, f64::from(kelvin))))
    } else {
        Rgb::ZERO
    }
}

/// Rows of the matrix that maps linear Rec. 709 to itself and the colour of the daylight of
/// `kelvin` to neutral: von Kries scaling in Bradford cone responses, as pbrt-v4's sensors do.
/// The identity unless the temperature is positive and finite.
#[must_use]
pub fn white_balance_matrix(kelvin: f32) -> [[f32; 3]; 3] {
    // Bradford cone responses from XYZ (Lam 1985; Lindbloom), by rows.
    let lms_from_xyz =
        DMat3::from_cols_array(&[0.8951, 0.2664, -0.1614, -0.7502, 1.7135, 0.0367, 0.0389, -0.0685, 1.0296])
            .transpose();
    let rgb = Spectrum::daylight(f64::from(kelvin)).map_or(DMat3::IDENTITY, |daylight| {
        let source = xyz_integral(|nm| daylight.eval(nm));
        let scale = (lms_from_xyz * SPACE.white) / (lms_from_xyz * (source / source.y));
        let xyz = lms_from_xyz.inverse() * DMat3::from_diagonal(scale) * lms_from_xyz;
        SPACE.from_xyz * xyz * SPACE.to_xyz
    });
    rgb.transpose().as_mat3().to_cols_array_2d()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: Vec3, b: Vec3, tolerance: f32) {
        assert!((a - b).abs().max_element() <= tolerance, "{a} is not {b} within {tolerance}");
    }

    #[test]
    fn the_observer_integrates_to_106_857() {
        assert!((y_integral() - 106.857).abs() < 2e-3, "{}", y_integral());
        near(cie_xyz(555.0), Vec3::new(0.5120501, 1.0, 0.00575), 1e-6);
        assert_eq!(cie_xyz(359.9), Vec3::ZERO);
        assert_eq!(cie_xyz(830.1), Vec3::ZERO);
    }

    #[test]
    fn d65_is_white_and_the_matrix_is_rec709s() {
        let d65 = Spectrum::named("stdillum-D65").expect("named");
        near(d65.to_rgb_illuminant(), Vec3::ONE, 1e-6);
        assert!((d65.to_xyz().y - 1.0).abs() < 1e-6);
        // IEC 61966-2-1: white (0.3127, 0.3290) and the first row of XYZ to RGB.
        let w = SPACE.white / SPACE.white.dot(DVec3::ONE);
        assert!((w.x - 0.3127).abs() < 1e-4 && (w.y - 0.3290).abs() < 1e-4, "{w}");
        near(xyz_to_rec709(Vec3::X), Vec3::new(3.2406, -0.9689, 0.0557), 2e-3);
        near(rec709_to_xyz(xyz_to_rec709(Vec3::new(0.2, 0.5, 0.9))), Vec3::new(0.2, 0.5, 0.9), 1e-6);
    }

    #[test]
    fn illuminants_have_their_published_chromaticities() {
        // CIE 15, table T.3 (D60: Academy TB-2018-001).
        let published = [
            ("stdillum-A", 0.44758, 0.40745),
            ("stdillum-D50", 0.34567, 0.35850),
            ("stdillum-F1", 0.31310, 0.33727),
            ("stdillum-F2", 0.37208, 0.37529),
            ("stdillum-F4", 0.44018, 0.40329),
            ("stdillum-F7", 0.31292, 0.32933),
            ("stdillum-F11", 0.38052, 0.37713),
            ("stdillum-F12", 0.43695, 0.40441),
            ("illum-acesD60", 0.32168, 0.33767),
        ];
        for (name, x, y) in published {
            let xyz = Spectrum::named(name).expect(name).to_xyz();
            let sum = xyz.element_sum();
            assert!((xyz.y - 1.0).abs() < 1e-5, "{name}");
            assert!((xyz.x / sum - x).abs() < 3e-4 && (xyz.y / sum - y).abs() < 3e-4, "{name} {}", xyz / sum);
        }
    }

    #[test]
    fn black_bodies_have_luminance_one_and_their_colours() {
        // The Planckian locus passes within 0.005 in xy of D65 at 6504 K: Yxy of (0.3135, 0.3237).
        let c = rec709_to_xyz(blackbody_rgb(6504.0));
        let sum = c.element_sum();
        assert!((c.x / sum - 0.3135).abs() < 3e-4 && (c.y / sum - 0.3237).abs() < 3e-4, "{c}");
        for kelvin in [10.0, 500.0, 1000.0, 2856.0, 6504.0, 20_000.0, 1e6, 1e30] {
            let c = blackbody_rgb(kelvin);
            assert!((rec709_to_xyz(c).y - 1.0).abs() < 1e-5 && c.min_element() >= 0.0, "{kelvin} {c}");
        }
        assert!(blackbody_rgb(2856.0).x > 2.0 * blackbody_rgb(2856.0).z);
        for kelvin in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert_eq!(blackbody_rgb(kelvin), Rgb::ZERO);
        }
    }

    #[test]
    fn constants_stay_constant() {
        for v in [0.0, 0.3, 1.0] {
            near(Spectrum::constant(v).to_rgb_albedo(), Vec3::splat(v), 1e-6);
            near(Spectrum::constant(v).to_rgb_unbounded(), Vec3::splat(v), 1e-6);
        }
        near(Spectrum::constant(2.5).to_rgb_unbounded(), Vec3::splat(2.5), 1e-5);
        let band = Spectrum::from_samples(vec![(400.0, 1.5), (700.0, 1.5)]).expect("increasing");
        near(band.to_rgb_unbounded(), Vec3::splat(1.5), 1e-5);
        let red = Spectrum::from_samples(vec![(360.0, 0.0), (600.0, 0.0), (601.0, 0.9), (830.0, 0.9)]);
        let red = red.expect("increasing").to_rgb_albedo();
        assert!(red.x > 0.5 && red.y < 0.1 && red.z == 0.0, "{red}");
    }

    #[test]
    fn the_balanced_daylight_is_neutral() {
        for kelvin in [3000.0, 5000.0, 6500.0, 9000.0] {
            let m = white_balance_matrix(kelvin);
            let daylight = Spectrum::daylight(f64::from(kelvin)).expect("positive");
            let rgb = xyz_to_rec709(daylight.to_xyz());
            let out = Vec3::from_array(m.map(|row| Vec3::from_array(row).dot(rgb)));
            near(out, Vec3::ONE, 2e-5);
        }
        near(Vec3::from_array(white_balance_matrix(6500.0)[0]), Vec3::X, 2e-3);
        assert_eq!(white_balance_matrix(0.0)[1], [0.0, 1.0, 0.0]);
    }

    #[test]
    fn damaged_tables_are_refused_in_one_line() {
        let text = "# nm value\n400 0.5, 500\t0.75\n";
        let s = Spectrum::from_spd_text(text).expect("well formed");
        assert_eq!(s.samples(), [(400.0, 0.5), (500.0, 0.75)]);
        assert_eq!((s.eval(450.0), s.eval(399.0), s.eval_clamped(399.0)), (0.625, 0.0, 0.5));
        for bad in ["", "400", "400 1 400 2", "500 1 400 2", "400 x", "400 nan", "inf 1", "400 1e60"] {
            let e = Spectrum::from_spd_text(bad).expect_err(bad);
            assert!(e.contains("expected") && !e.contains('\n'), "{bad}: {e}");
        }
    }
}
