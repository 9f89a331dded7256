//! The film: size, crop, exposure, white balance. pbrt's "cie1931" sensor is the one simulated.
//! Never opens the image it names.

use super::lexer::shown;
use super::params::{ColorSpace, Params};
use super::reader::{Item, Reader};
use super::suggest::known_names;
use crate::color::spectrum::white_balance_matrix;
use crate::error::{Error, Result};
use std::path::PathBuf;

/// Pixels a side.
const MAX_SIDE: i32 = 1 << 16;

const SENSORS: [&str; 18] = [
    "cie1931",
    "canon_eos_100d",
    "canon_eos_1dx_mkii",
    "canon_eos_200d",
    "canon_eos_200d_mkii",
    "canon_eos_5d",
    "canon_eos_5d_mkii",
    "canon_eos_5d_mkiii",
    "canon_eos_5d_mkiv",
    "canon_eos_5ds",
    "canon_eos_m",
    "hasselblad_l1d_20c",
    "nikon_d810",
    "nikon_d850",
    "sony_ilce_6400",
    "sony_ilce_7m3",
    "sony_ilce_7rm3",
    "sony_ilce_9",
];

impl Reader {
    /// Fills the film but for the exposure time, which is the camera's.
    pub(super) fn film(&mut self, item: &Item) -> Result<()> {
        let p = &item.params;
        match &*item.name {
            "rgb" => {}
            "gbuffer" => {
                p.accept(&["coordinatesystem"]);
                self.warnings.add(&p.at, "film \"gbuffer\" is not supported; a plain rgb image stands in");
            }
            "spectral" => {
                p.accept(&["nbuckets", "lambdamin", "lambdamax"]);
                self.warnings.add(&p.at, "film \"spectral\" is not supported; a plain rgb image stands in");
            }
            _ => return Err(item.unknown("film", "films", &["rgb", "gbuffer", "spectral"])),
        }
        p.accept(&["diagonal", "savefp16"]);
        if p.space != ColorSpace::Srgb {
            self.warnings
                .add(&p.at, "images are written in linear Rec. 709; the film's ColorSpace has no effect");
        }
        let size =
            (p.int_in("xresolution", 1280, 1..=MAX_SIDE)?, p.int_in("yresolution", 720, 1..=MAX_SIDE)?);
        self.scene.film.size = size;
        self.scene.film.crop = crop(p, size)?;
        self.scene.film.filename = p.string("filename")?.map(|(name, _)| PathBuf::from(name));
        self.scene.film.max_component_value = p.positive("maxcomponentvalue", f32::INFINITY)?;
        self.scene.film.imaging_ratio = p.positive("iso", 100.0)? / 100.0;
        self.sensor(p)?;
        p.finish()
    }

    fn sensor(&mut self, p: &Params) -> Result<()> {
        if let Some((name, at)) = p.string("sensor")?
            && name != "cie1931"
        {
            if !SENSORS.contains(&name) {
                let hint = known_names(name, "sensors", &SENSORS);
                return Err(Error::at(at, format!("unknown sensor \"{}\"{hint}", shown(name.as_bytes()))));
            }
            self.warnings.add(at, format!("sensor \"{name}\" is not supported; cie1931 stands in"));
        }
        let kelvin = p.float("whitebalance", 0.0)?;
        if kelvin != 0.0 {
            if !(1000.0..=50_000.0).contains(&kelvin) {
                let what = format!("\"whitebalance\" is {kelvin} K; it must be from 1000 to 50000");
                return Err(p.error("whitebalance", what));
            }
            self.scene.film.white_balance = white_balance_matrix(kelvin);
        }
        Ok(())
    }
}

/// The crop window in pixels: `cropwindow` (fractions) goes before `pixelbounds`, both x0 x1 y0 y1.
fn crop(p: &Params, size: (u32, u32)) -> Result<[u32; 4]> {
    let mut crop = [0, 0, size.0, size.1];
    let mut name = "pixelbounds";
    if let Some((bounds, at)) = p.ints("pixelbounds") {
        let &[x0, x1, y0, y1] = bounds else {
            return Err(Error::at(
                at,
                format!("\"pixelbounds\" has {} values; it takes x0 x1 y0 y1", bounds.len()),
            ));
        };
        let inside = |v: i32, n: u32| u32::try_from(v.max(0)).unwrap_or(0).min(n);
        crop = [inside(x0, size.0), inside(y0, size.1), inside(x1, size.0), inside(y1, size.1)];
    }
    if let Some([x0, x1, y0, y1]) = p.numbers::<4>("cropwindow")? {
        name = "cropwindow";
        let pixel = |v: f32, n: u32| (v.clamp(0.0, 1.0) * n as f32).ceil() as u32;
        crop = [
            pixel(x0.min(x1), size.0),
            pixel(y0.min(y1), size.1),
            pixel(x0.max(x1), size.0),
            pixel(y0.max(y1), size.1),
        ];
    }
    if crop[0] >= crop[2] || crop[1] >= crop[3] {
        return Err(p.error(name, "the crop window holds no pixel; give x0 x1 y0 y1 inside the film"));
    }
    Ok(crop)
}
