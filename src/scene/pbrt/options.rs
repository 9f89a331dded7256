//! What stands before the world: camera, filter, sampler, integrator, accelerator, options. Built at
//! `WorldBegin`, because film and camera need each other. Never resolves a medium.

use super::lexer::{Kind, Lexer, Token, shown};
use super::params::Params;
use super::reader::{Item, PendingCamera, Reader};
use super::suggest::known_names;
use crate::error::{Error, Result};
use crate::scene::{Camera, CameraKind, Filter};

/// Samples a pixel; more would not fit the samplers' 32-bit indices.
const MAX_SPP: i32 = 1 << 24;
const MAX_DEPTH: i32 = 1 << 24;

const OPTIONS: [&str; 11] = [
    "disablepixeljitter",
    "disabletexturefiltering",
    "disablewavelengthjitter",
    "displacementedgescale",
    "forcediffuse",
    "msereferenceimage",
    "msereferenceout",
    "pixelstats",
    "rendercoordsys",
    "seed",
    "wavefront",
];

impl Reader {
    pub(super) fn build_options(&mut self) -> Result<()> {
        if let Some(camera) = self.camera.take() {
            self.scene.camera = self.camera(&camera)?;
            self.camera = Some(camera);
        }
        if let Some(item) = self.film.take() {
            self.film(&item)?;
        }
        self.scene.film.imaging_ratio *= self.scene.camera.exposure_seconds;
        if let Some(item) = self.filter.take() {
            self.scene.filter = filter(&item)?;
        }
        if let Some(item) = self.sampler.take() {
            self.sampler(&item)?;
        }
        if let Some(item) = self.integrator.take() {
            self.integrator(&item)?;
        }
        Ok(())
    }

    fn camera(&mut self, pending: &PendingCamera) -> Result<Camera> {
        let p = &pending.item.params;
        let kind = match &*pending.item.name {
            "perspective" => {
                let fov_degrees = p.float("fov", 90.0)?;
                if !(fov_degrees > 0.0 && fov_degrees < 180.0) {
                    let what = format!("\"fov\" is {fov_degrees}; it must be above 0 and below 180");
                    return Err(p.error("fov", what));
                }
                CameraKind::Perspective { fov_degrees }
            }
            "orthographic" => CameraKind::Orthographic,
            "spherical" => {
                let mappings = [("equalarea", true), ("equirectangular", false)];
                CameraKind::Spherical { equal_area: p.choice("mapping", &mappings)? }
            }
            "realistic" => {
                p.accept(&["lensfile", "aperturediameter", "focusdistance", "aperture"]);
                let what = "camera \"realistic\" is not supported; a pinhole of 30 degrees stands in";
                self.warnings.add(&p.at, what);
                CameraKind::Perspective { fov_degrees: 30.0 }
            }
            _ => {
                let names = ["perspective", "orthographic", "spherical", "realistic"];
                return Err(pending.item.unknown("camera", "cameras", &names));
            }
        };
        let open = p.float("shutteropen", 0.0)?;
        let close = p.float("shutterclose", 1.0)?;
        if close <= open {
            let what = format!("the shutter closes at {close} and opens at {open}; it must close later");
            return Err(p.error("shutterclose", what));
        }
        let frame_aspect_ratio = match p.float_opt("frameaspectratio")? {
            Some(a) if a <= 0.0 => {
                let what = format!("\"frameaspectratio\" is {a}; it must be positive");
                return Err(p.error("frameaspectratio", what));
            }
            other => other,
        };
        let screen_window = p.numbers::<4>("screenwindow")?;
        if let Some([x0, x1, y0, y1]) = screen_window
            && (x0 == x1 || y0 == y1)
        {
            return Err(p.error("screenwindow", "\"screenwindow\" is empty; give x0 x1 y0 y1 that differ"));
        }
        let camera = Camera {
            kind,
            camera_to_world: pending.world_to_camera.inverse(),
            lens_radius: p.float("lensradius", 0.0)?.max(0.0),
            focal_distance: p.positive("focaldistance", 1e6)?,
            screen_window,
            frame_aspect_ratio,
            exposure_seconds: close - open,
        };
        p.finish()?;
        Ok(camera)
    }

    fn sampler(&mut self, item: &Item) -> Result<()> {
        let p = &item.params;
        p.accept(&["randomization", "jitter"]);
        self.scene.spp = match &*item.name {
            "stratified" => {
                let x = p.int_in("xsamples", 4, 1..=4096)?;
                x * p.int_in("ysamples", 4, 1..=4096)?
            }
            "independent" => p.int_in("pixelsamples", 4, 1..=MAX_SPP)?,
            "halton" | "paddedsobol" | "sobol" | "zsobol" | "pmj02bn" => {
                p.int_in("pixelsamples", 16, 1..=MAX_SPP)?
            }
            _ => {
                let names =
                    ["zsobol", "sobol", "paddedsobol", "halton", "independent", "stratified", "pmj02bn"];
                return Err(item.unknown("sampler", "samplers", &names));
            }
        };
        let seed = p.int("seed", -1)?;
        if let Ok(seed) = u64::try_from(seed) {
            self.scene.seed = seed;
        }
        p.finish()
    }

    fn integrator(&mut self, item: &Item) -> Result<()> {
        let p = &item.params;
        match &*item.name {
            "path" | "volpath" => {
                if p.bool("regularize", false)? {
                    let what = "regularized materials are not supported; they keep their roughness";
                    self.warnings.add(p.place("regularize"), what);
                }
                self.scene.integrator.rr_threshold = p.float("rrthreshold", 1.0)?;
            }
            other @ ("simplepath" | "simplevolpath" | "randomwalk" | "ao" | "lightpath" | "bdpt" | "mlt"
            | "sppm" | "function") => {
                p.accept(&[
                    "samplelights",
                    "samplebsdf",
                    "cossample",
                    "maxdistance",
                    "visualizestrategies",
                    "visualizeweights",
                    "regularize",
                    "bootstrapsamples",
                    "chains",
                    "mutationsperpixel",
                    "largestepprobability",
                    "sigma",
                    "photonsperiteration",
                    "radius",
                    "seed",
                    "iterations",
                    "function",
                    "skipbad",
                    "imagefilename",
                ]);
                let what = format!("integrator \"{other}\" is not supported; path stands in");
                self.warnings.add(&p.at, what);
            }
            _ => {
                let names = [
                    "path",
                    "volpath",
                    "simplepath",
                    "simplevolpath",
                    "randomwalk",
                    "ao",
                    "lightpath",
                    "bdpt",
                    "mlt",
                    "sppm",
                    "function",
                ];
                return Err(item.unknown("integrator", "integrators", &names));
            }
        }
        p.choice("lightsampler", &[("bvh", ()), ("uniform", ()), ("power", ()), ("exhaustive", ())])?;
        self.scene.integrator.max_depth = p.int_in("maxdepth", 5, 0..=MAX_DEPTH)?;
        p.finish()
    }

    /// Accelerators differ in time, never in the picture: checked, then forgotten.
    pub(super) fn accelerator(item: &Item) -> Result<()> {
        match &*item.name {
            "bvh" => item.params.accept(&["maxnodeprims", "splitmethod"]),
            "kdtree" => {
                item.params.accept(&["intersectcost", "traversalcost", "emptybonus", "maxprims", "maxdepth"])
            }
            _ => return Err(item.unknown("accelerator", "accelerators", &["bvh", "kdtree"])),
        }
        item.params.finish()
    }

    /// `Option "name" value`; the name may carry a type, the value brackets, as the format's own examples do.
    pub(super) fn option(&mut self, lx: &mut Lexer<'_>, token: &Token<'_>) -> Result<()> {
        let at = lx.location(token.start);
        let text = lx.require_string("the option's name")?;
        let last = text.split_whitespace().next_back().unwrap_or("");
        let name: String =
            last.chars().filter(|c| !matches!(c, '-' | '_')).map(|c| c.to_ascii_lowercase()).collect();
        let bracket = lx.eat(b'[');
        let value = lx.require("the option's value")?;
        if bracket && !lx.eat(b']') {
            return Err(lx.error(lx.position(), "the option has more than one value; close with ]"));
        }
        let bad = |wanted: &str| {
            lx.error(value.start, format!("found {} where {wanted} should be", shown(value.bytes)))
        };
        let flag = match value.bytes {
            b"true" => Some(true),
            b"false" => Some(false),
            _ => None,
        };
        let unsupported = match name.as_str() {
            "seed" => {
                let seed = std::str::from_utf8(value.bytes).ok().and_then(|v| v.parse::<i64>().ok());
                self.scene.seed = seed.ok_or_else(|| bad("an integer"))?.cast_unsigned();
                None
            }
            "disablepixeljitter" => Some("pixel samples stay jittered"),
            "disabletexturefiltering" => Some("textures stay filtered"),
            "forcediffuse" => Some("materials stay as they are"),
            "pixelstats" => Some("no statistics a pixel are written"),
            // Neither has a meaning without wavelengths or a second renderer.
            "disablewavelengthjitter" | "wavefront" => {
                flag.ok_or_else(|| bad("true or false"))?;
                None
            }
            "rendercoordsys" => None,
            "displacementedgescale" => {
                let scale = std::str::from_utf8(value.bytes).ok().and_then(|v| v.parse::<f32>().ok());
                let scale = scale.filter(|scale| *scale > 0.0 && scale.is_finite());
                self.edge_scale = scale.ok_or_else(|| bad("a number above zero"))?;
                None
            }
            "msereferenceimage" | "msereferenceout" => {
                if value.kind != Kind::Quoted {
                    return Err(bad("a quoted string"));
                }
                self.warnings.add(&at, format!("option \"{name}\" is not supported; no error is measured"));
                None
            }
            _ => {
                let hint = known_names(&name, "options", &OPTIONS);
                return Err(Error::at(&at, format!("unknown option \"{}\"{hint}", shown(text.as_bytes()))));
            }
        };
        if let Some(instead) = unsupported
            && flag.ok_or_else(|| bad("true or false"))?
        {
            self.warnings.add(&at, format!("option \"{name}\" is not supported; {instead}"));
        }
        Ok(())
    }
}

fn filter(item: &Item) -> Result<Filter> {
    let p = &item.params;
    let radius = |p: &Params, r: f32| -> Result<[f32; 2]> {
        let radius = [p.positive("xradius", r)?, p.positive("yradius", r)?];
        // A sample touches (2r)² pixels.
        match radius.iter().zip(["xradius", "yradius"]).find(|(r, _)| **r > 64.0) {
            Some((r, name)) => Err(p.error(name, format!("\"{name}\" is {r}; at most 64 pixels"))),
            None => Ok(radius),
        }
    };
    let filter = match &*item.name {
        "box" => Filter::Box { radius: radius(p, 0.5)? },
        "triangle" => Filter::Triangle { radius: radius(p, 2.0)? },
        "gaussian" => Filter::Gaussian { radius: radius(p, 1.5)?, sigma: p.positive("sigma", 0.5)? },
        "mitchell" => Filter::Mitchell {
            radius: radius(p, 2.0)?,
            b: p.float("B", 1.0 / 3.0)?,
            c: p.float("C", 1.0 / 3.0)?,
        },
        "sinc" => Filter::Sinc { radius: radius(p, 4.0)?, tau: p.positive("tau", 3.0)? },
        _ => {
            return Err(item.unknown(
                "filter",
                "filters",
                &["box", "triangle", "gaussian", "mitchell", "sinc"],
            ));
        }
    };
    p.finish()?;
    Ok(filter)
}
