//! Participating media. Homogeneous absorption is kept; what scatters, glows or varies in space is
//! known and not simulated, and the reader says so. Never resolves a name: `finish.rs` does.

use super::lexer::shown;
use super::reader::{Item, Reader, index};
use super::spectra::{Use, color, color_opt};
use super::suggest::known_names;
use crate::color::Rgb;
use crate::error::{Error, Result};
use crate::scene::{Medium, MediumId};
use std::rc::Rc;

const KINDS: [&str; 5] = ["homogeneous", "uniformgrid", "rgbgrid", "cloud", "nanovdb"];

impl Reader {
    pub(super) fn medium(&mut self, item: &Item) -> Result<()> {
        let p = &item.params;
        let name: Rc<str> = Rc::from(&*item.name);
        if self.media.contains_key(&name) {
            let what =
                format!("medium \"{}\" is already defined; choose another name", shown(name.as_bytes()));
            return Err(Error::at(&p.at, what));
        }
        let Some((kind, at)) = p.string("type")? else {
            let name = shown(name.as_bytes());
            let what =
                format!("medium \"{name}\" has no type; add \"string type\" \"homogeneous\" or another");
            return Err(Error::at(&p.at, what));
        };
        let id = match kind {
            "homogeneous" => self.homogeneous(item)?,
            "uniformgrid" | "rgbgrid" | "cloud" | "nanovdb" => {
                self.warnings.add(&p.at, format!("medium \"{kind}\" is not supported; vacuum stands in"));
                p.accept_all();
                None
            }
            other => {
                let hint = known_names(other, "media", &KINDS);
                return Err(Error::at(at, format!("unknown medium \"{}\"{hint}", shown(other.as_bytes()))));
            }
        };
        self.media.insert(name, id);
        Ok(())
    }

    fn homogeneous(&mut self, item: &Item) -> Result<Option<MediumId>> {
        let p = &item.params;
        let sigma_a = color(p, "sigma_a", 1.0, Use::Unbounded, &self.files)?;
        let sigma_s = color(p, "sigma_s", 1.0, Use::Unbounded, &self.files)?;
        let scale = p.float("scale", 1.0)?;
        let g = p.float("g", 0.0)?;
        let glow = color_opt(p, "Le", Use::Illuminant, &self.files)?;
        let glow = glow.unwrap_or(Rgb::ZERO) * p.float("Lescale", 1.0)?;
        let preset = p.string("preset")?.is_some_and(|(name, _)| !name.is_empty());
        p.finish()?;
        if preset {
            self.warnings.add(p.place("preset"), "media presets are not supported; vacuum stands in");
            return Ok(None);
        }
        if glow != Rgb::ZERO {
            self.warnings.add(p.place("Le"), "media do not glow here; only their absorption is kept");
        }
        if sigma_s * scale != Rgb::ZERO {
            let what = "scattering in media is not simulated; the medium absorbs by sigma_a alone";
            self.warnings.add(&p.at, what);
        }
        let id = MediumId(index(self.scene.media.len())?);
        self.scene.media.push(Medium { sigma_a: sigma_a * scale, sigma_s: sigma_s * scale, g });
        Ok(Some(id))
    }
}
