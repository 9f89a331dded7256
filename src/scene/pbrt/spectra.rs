//! Colour parameters to linear Rec. 709: `rgb` in any of pbrt's colour spaces, `blackbody`, and
//! `spectrum` by name, by samples or from a file. What a spectrum becomes depends on its use, as in
//! pbrt-v4: a light's luminance is 1, a reflectance is seen under D65, an index keeps its value.
//! Never reads a texture.

use super::lexer::shown;
use super::params::{ColorSpace, Param, Params, Type, Values};
use super::suggest::nearest;
use super::warnings::Files;
use crate::color::Rgb;
use crate::color::spectrum::{Spectrum, blackbody_rgb, rec709_to_xyz, xyz_to_rec709};
use crate::error::{Error, Result};
use glam::{DMat3, DVec3, Vec3};
use std::io::Read;

/// The types a colour may have.
pub(super) const COLOR: &[Type] = &[Type::Rgb, Type::Spectrum, Type::Blackbody];

/// Bytes of a spectrum file; measured spectra have a few thousand lines at most.
const MAX_SPECTRUM_BYTES: u64 = 1 << 20;

/// What a colour is used for (pbrt's `SpectrumType`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Use {
    /// Reflectance: at most 1.
    Albedo,
    /// Index of refraction, absorption.
    Unbounded,
    /// Emission: white is D65, of luminance 1.
    Illuminant,
}

pub(super) const USES: [Use; 3] = [Use::Albedo, Use::Unbounded, Use::Illuminant];

/// The colour of that name, if it is given.
pub(super) fn color_opt(params: &Params, name: &'static str, how: Use, files: &Files) -> Result<Option<Rgb>> {
    params.find(name, COLOR).map(|p| color_of(p, params.space, how, files)).transpose()
}

/// The colour of that name, else `default` in each channel.
pub(super) fn color(
    params: &Params,
    name: &'static str,
    default: f32,
    how: Use,
    files: &Files,
) -> Result<Rgb> {
    Ok(color_opt(params, name, how, files)?.unwrap_or(Rgb::splat(default)))
}

/// The colour a parameter of one of the types [`COLOR`] gives.
pub(super) fn color_of(p: &Param, space: ColorSpace, how: Use, files: &Files) -> Result<Rgb> {
    match p.kind {
        Type::Rgb => {
            let rgb = Vec3::from(p.numbers::<3>()?);
            if rgb.min_element() < 0.0 {
                let what = format!("\"rgb {}\" has a negative component; none may be below 0", p.name);
                return Err(Error::at(&p.at, what));
            }
            if how == Use::Albedo && rgb.max_element() > 1.0 {
                let what = format!("\"rgb {}\" reflects more than arrives; none may be above 1", p.name);
                return Err(Error::at(&p.at, what));
            }
            Ok(to_rec709(rgb, p.space.unwrap_or(space), how))
        }
        Type::Blackbody => {
            let [kelvin] = p.numbers::<1>()?;
            let spectrum = if kelvin > 0.0 { Spectrum::blackbody(f64::from(kelvin)) } else { None };
            let Some(spectrum) = spectrum else {
                let what = format!("a black body of {kelvin} K does not glow; give a temperature above 0");
                return Err(Error::at(&p.at, what));
            };
            let peak = spectrum.samples().iter().fold(0f32, |m, s| m.max(s.1));
            Ok(match how {
                Use::Illuminant => blackbody_rgb(kelvin),
                Use::Albedo => spectrum.scaled(1.0 / peak).to_rgb_albedo(),
                Use::Unbounded => spectrum.scaled(1.0 / peak).to_rgb_unbounded(),
            })
        }
        _ => {
            let spectrum = spectrum_of(p, files)?;
            Ok(match how {
                Use::Illuminant => spectrum.to_rgb_illuminant(),
                Use::Albedo => spectrum.to_rgb_albedo(),
                Use::Unbounded => spectrum.to_rgb_unbounded(),
            })
        }
    }
}

/// The spectrum a `spectrum` parameter gives.
pub(super) fn spectrum_of(p: &Param, files: &Files) -> Result<Spectrum> {
    let fail = |why: String| Error::at(&p.at, why);
    match &p.values {
        Values::Floats(v) => {
            if v.len() % 2 != 0 || v.is_empty() {
                let (n, name) = (v.len(), &p.name);
                return Err(fail(format!(
                    "\"spectrum {name}\" has {n} numbers; give pairs of wavelength and value"
                )));
            }
            Spectrum::from_samples(v.chunks_exact(2).map(|c| (c[0], c[1])).collect()).map_err(fail)
        }
        Values::Strings(v) if v.len() == 1 => match Spectrum::named(&v[0]) {
            Some(s) => Ok(s),
            None => spectrum_file(p, &v[0], files),
        },
        _ => Err(fail(format!("\"spectrum {}\" needs one name, one file, or pairs of numbers", p.name))),
    }
}

fn spectrum_file(p: &Param, name: &str, files: &Files) -> Result<Spectrum> {
    let Some(path) = files.find(name, &p.at) else {
        let hint = match nearest(name, Spectrum::names()) {
            Some(near) => format!("did you mean \"{near}\"?"),
            None => "give a named spectrum such as \"metal-Cu-eta\", or the path of a file".to_owned(),
        };
        return Err(Error::at(
            &p.at,
            format!("no spectrum and no file \"{}\"; {hint}", shown(name.as_bytes())),
        ));
    };
    let mut text = String::new();
    let read = std::fs::File::open(&path)
        .and_then(|f| f.take(MAX_SPECTRUM_BYTES + 1).read_to_string(&mut text))
        .map_err(|e| format!("cannot read ({e})"));
    let checked = read.and_then(|n| {
        if n as u64 > MAX_SPECTRUM_BYTES {
            return Err(format!("is larger than {MAX_SPECTRUM_BYTES} bytes"));
        }
        Spectrum::from_spd_text(&text)
    });
    checked.map_err(|why| Error::at(&p.at, format!("spectrum file \"{}\": {why}", path.display())))
}

/// Linear RGB of a space to linear Rec. 709. A reflectance stays white where it was white (Bradford);
/// an illuminant keeps its colour. What Rec. 709 cannot show is clipped at zero.
fn to_rec709(rgb: Rgb, space: ColorSpace, how: Use) -> Rgb {
    let d65 = rec709_to_xyz(Vec3::ONE).as_dvec3();
    // Primaries: SMPTE RP 431-2, ITU-R BT.2020, SMPTE ST 2065-1 (its white by Academy TB-2018-001).
    let (primaries, white) = match space {
        ColorSpace::Srgb => return rgb,
        ColorSpace::DciP3 => ([(0.68, 0.32), (0.265, 0.69), (0.15, 0.06)], d65),
        ColorSpace::Rec2020 => ([(0.708, 0.292), (0.17, 0.797), (0.131, 0.046)], d65),
        ColorSpace::Aces2065 => ([(0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.077)], xyz_of(0.32168, 0.33767)),
    };
    let columns = primaries.map(|(x, y): (f64, f64)| DVec3::new(x, y, 1.0 - x - y));
    let m = DMat3::from_cols(columns[0], columns[1], columns[2]);
    let mut xyz = m * DMat3::from_diagonal(m.inverse() * white) * rgb.as_dvec3();
    if how != Use::Illuminant {
        let cones = bradford();
        let scale = (cones * d65) / (cones * white);
        xyz = cones.inverse() * DMat3::from_diagonal(scale) * cones * xyz;
    }
    xyz_to_rec709(xyz.as_vec3()).max(Vec3::ZERO)
}

fn xyz_of(x: f64, y: f64) -> DVec3 {
    DVec3::new(x / y, 1.0, (1.0 - x - y) / y)
}

/// Cone responses from XYZ (Lam 1985).
fn bradford() -> DMat3 {
    DMat3::from_cols_array(&[0.8951, -0.7502, 0.0389, 0.2664, 1.7135, -0.0685, -0.1614, 0.0367, 1.0296])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_stays_white_and_primaries_widen() {
        for space in [ColorSpace::DciP3, ColorSpace::Rec2020, ColorSpace::Aces2065] {
            let white = to_rec709(Vec3::ONE, space, Use::Albedo);
            assert!((white - Vec3::ONE).abs().max_element() < 1e-4, "{space:?} {white}");
            let red = to_rec709(Vec3::X, space, Use::Albedo);
            assert!(red.x > 1.05 && red.y == 0.0, "{space:?} {red}");
        }
        // D60 as a light is warmer than D65.
        let warm = to_rec709(Vec3::ONE, ColorSpace::Aces2065, Use::Illuminant);
        assert!(warm.x > 1.02 && warm.z < 0.95, "{warm}");
        // ITU-R BT.2087: green of BT.2020 in BT.709 is (-0.588, 1.133, -0.101).
        let green = to_rec709(Vec3::Y, ColorSpace::Rec2020, Use::Illuminant);
        assert!((green.y - 1.1329).abs() < 1e-3, "{green}");
    }
}
