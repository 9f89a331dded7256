//! Lights as pbrt-v4 measures them. `rgb` passes through; a spectrum or black body is brought to
//! luminance 1 and then scaled. `power` and `illuminance` replace brightness but keep what `rgb` and
//! `scale` said as a factor, as pbrt does. Never measures a shape or an image: what depends on
//! them stays a request in the description.

use super::params::{Params, Type};
use super::reader::{Item, Reader, index};
use super::spectra::{Use, color, color_opt};
use crate::color::Rgb;
use crate::error::{Error, Result};
use crate::scene::{AreaLight, AreaLightId, Encoding, Light};
use glam::Vec3;
use std::f32::consts::PI;

const KINDS: [&str; 6] = ["distant", "point", "spot", "infinite", "goniometric", "projection"];
const POINT: &[Type] = &[Type::Point3];

impl Reader {
    pub(super) fn light(&mut self, item: &Item) -> Result<()> {
        let p = &item.params;
        let light = match &*item.name {
            "distant" => self.distant(p)?,
            "point" => {
                let intensity = self.intensity(p, 4.0 * PI)?;
                Light::Point { intensity, position: self.from(p)? }
            }
            "spot" => {
                let cone = p.float("coneangle", 30.0)?;
                let delta = p.float("conedeltaangle", 5.0)?;
                self.spot(p, cone, delta)?
            }
            "infinite" => self.infinite(p)?,
            "goniometric" => {
                let what =
                    "light \"goniometric\" is not supported; a point light without its image stands in";
                self.warnings.add(&p.at, what);
                p.accept(&["filename"]);
                let intensity = self.intensity(p, 4.0 * PI)?;
                Light::Point { intensity, position: self.state.ctm.point(Vec3::ZERO).to_array() }
            }
            "projection" => {
                let what = "light \"projection\" is not supported; a spot light of its angle stands in";
                self.warnings.add(&p.at, what);
                p.accept(&["filename"]);
                let half = 0.5 * p.float("fov", 90.0)?;
                self.spot(p, half, 0.0)?
            }
            _ => return Err(item.unknown("light", "lights", &KINDS)),
        };
        p.finish()?;
        self.scene.lights.push(light);
        Ok(())
    }

    /// Intensity: `I` times `scale`; with `power`, that over `extent`, the solid angle in which it leaves.
    fn intensity(&self, p: &Params, extent: f32) -> Result<Rgb> {
        let i = color(p, "I", 1.0, Use::Illuminant, &self.files)? * p.float("scale", 1.0)?;
        let power = p.float("power", -1.0)?;
        Ok(if power > 0.0 { i * (power / extent) } else { i })
    }

    fn from(&self, p: &Params) -> Result<[f32; 3]> {
        Ok(self.state.ctm.point(Vec3::from(p.triple("from", POINT, [0.0; 3])?)).to_array())
    }

    /// The world direction `sign · (to − from)`.
    fn axis(&self, p: &Params, sign: f32) -> Result<[f32; 3]> {
        let from = Vec3::from(p.triple("from", POINT, [0.0; 3])?);
        let to = Vec3::from(p.triple("to", POINT, [0.0, 0.0, 1.0])?);
        // Twice, because vectors of either length must not overflow under the transform.
        let local = ((to - from) * sign).try_normalize();
        match local.and_then(|d| self.state.ctm.vector(d).try_normalize()) {
            Some(d) => Ok(d.to_array()),
            None => Err(p.error("to", "the light has no direction; \"from\" and \"to\" must differ")),
        }
    }

    fn distant(&mut self, p: &Params) -> Result<Light> {
        let mut irradiance = color(p, "L", 1.0, Use::Illuminant, &self.files)? * p.float("scale", 1.0)?;
        let illuminance = p.float("illuminance", -1.0)?;
        if illuminance > 0.0 {
            irradiance *= illuminance;
        }
        Ok(Light::Distant { irradiance, towards: self.axis(p, -1.0)? })
    }

    fn spot(&mut self, p: &Params, cone: f32, delta: f32) -> Result<Light> {
        if !(cone > 0.0 && cone <= 180.0) {
            return Err(p.error(
                "coneangle",
                format!("the cone's angle is {cone}; it must be above 0 and at most 180"),
            ));
        }
        if delta < 0.0 {
            return Err(
                p.error("conedeltaangle", format!("\"conedeltaangle\" is {delta}; it must not be negative"))
            );
        }
        let cos_total_width = cone.to_radians().cos();
        let cos_falloff_start = (cone - delta).max(0.0).to_radians().cos();
        // The smooth step between the two cosines has half their difference as its integral.
        let extent = 2.0 * PI * ((1.0 - cos_falloff_start) + 0.5 * (cos_falloff_start - cos_total_width));
        Ok(Light::Spot {
            intensity: self.intensity(p, extent)?,
            position: self.from(p)?,
            axis: self.axis(p, 1.0)?,
            cos_falloff_start,
            cos_total_width,
        })
    }

    fn infinite(&mut self, p: &Params) -> Result<Light> {
        let scale = p.float("scale", 1.0)?;
        let radiance = color_opt(p, "L", Use::Illuminant, &self.files)?;
        let illuminance = p.float("illuminance", -1.0)?;
        if p.tuples::<3>("portal", POINT)?.is_some() {
            let what = "portals are not supported; the whole sky is sampled instead (noise, not brightness, differs)";
            self.warnings.add(p.place("portal"), what);
        }
        let Some((name, at)) = p.string("filename")? else {
            let mut radiance = radiance.unwrap_or(Rgb::ONE) * scale;
            if illuminance > 0.0 {
                radiance *= illuminance / PI;
            }
            return Ok(Light::Constant { radiance });
        };
        if radiance.is_some() {
            let what = "both \"L\" and \"filename\" are given; an infinite light takes one of them";
            return Err(Error::at(&p.at, what));
        }
        let path = self.files.require(name, at)?;
        let at = at.clone();
        Ok(Light::Image {
            image: self.image(path, Encoding::Srgb, &at)?,
            scale: Rgb::splat(scale),
            light_to_world: *self.state.ctm,
            illuminance: (illuminance > 0.0).then_some(illuminance),
        })
    }

    /// The emission of shapes that follow; an empty name ends it.
    pub(super) fn area_light(&mut self, item: &Item) -> Result<Option<AreaLightId>> {
        let p = &item.params;
        match &*item.name {
            "" => return Ok(None),
            "diffuse" => {}
            _ => return Err(item.unknown("area light", "area lights", &["diffuse"])),
        }
        let radiance = color_opt(p, "L", Use::Illuminant, &self.files)?;
        let scale = p.float("scale", 1.0)?;
        let power = p.float("power", -1.0)?;
        let image = match p.string("filename")? {
            None => None,
            Some(_) if radiance.is_some() => {
                let what = "both \"L\" and \"filename\" are given; an area light takes one of them";
                return Err(Error::at(&p.at, what));
            }
            Some((name, at)) => {
                let path = self.files.require(name, at)?;
                Some(self.image(path, Encoding::Srgb, at)?)
            }
        };
        let light = AreaLight {
            radiance: radiance.unwrap_or(Rgb::ONE) * scale,
            image,
            two_sided: p.bool("twosided", false)?,
            power: (power > 0.0).then_some(power),
        };
        p.finish()?;
        let id = AreaLightId(index(self.scene.area_lights.len())?);
        self.scene.area_lights.push(light);
        Ok(Some(id))
    }
}
