//! Materials by pbrt-v4's names, parameters and defaults. What pbrt has and we have not becomes a
//! near relative, with a warning. Never evaluates a scattering function.

use super::lexer::shown;
use super::params::{Params, Type};
use super::reader::{Item, Reader, index};
use super::spectra::{Use, color_opt, spectrum_of};
use super::suggest::nearest;
use crate::color::conductor::conductor_rgb;
use crate::color::spectrum::Spectrum;
use crate::color::{Rgb, luminance};
use crate::error::{Error, Location, Result};
use crate::scene::{Material, MaterialId, Roughness, Texture, TextureId};
use std::collections::HashMap;
use std::rc::Rc;

const KINDS: [&str; 13] = [
    "diffuse",
    "coateddiffuse",
    "conductor",
    "dielectric",
    "thindielectric",
    "diffusetransmission",
    "coatedconductor",
    "subsurface",
    "mix",
    "interface",
    "hair",
    "measured",
    "none",
];

/// Names that pbrt-v3 had.
const FORMER: [(&str, &str); 9] = [
    ("matte", "diffuse"),
    ("plastic", "coateddiffuse"),
    ("substrate", "coateddiffuse"),
    ("uber", "coateddiffuse"),
    ("glass", "dielectric"),
    ("metal", "conductor"),
    ("mirror", "conductor"),
    ("translucent", "diffusetransmission"),
    ("kdsubsurface", "subsurface"),
];

/// Where the materials of the scene ended up.
pub(super) struct MaterialTable {
    /// By `Material` directive; 0 is the default.
    pub(super) unnamed: Vec<MaterialId>,
    pub(super) named: HashMap<Rc<str>, MaterialId>,
}

/// Most mixes one inside the other.
const MAX_MIX_DEPTH: u32 = 256;

impl Reader {
    /// Builds all materials: named ones in order, then the others, as pbrt does, so that a named mix
    /// refers to what stands before it.
    pub(super) fn build_materials(&mut self) -> Result<MaterialTable> {
        let default = Material::Diffuse { reflectance: self.constant(Rgb::splat(0.5))? };
        self.scene.materials.push(default);
        self.mix_depths.push(0);
        let mut table = MaterialTable { unnamed: vec![MaterialId(0)], named: HashMap::new() };
        for (name, params) in std::mem::take(&mut self.named_materials) {
            let Some((kind, _)) = params.string("type")? else {
                let name = shown(name.as_bytes());
                let what =
                    format!("material \"{name}\" has no type; add \"string type\" \"diffuse\" or another");
                return Err(Error::at(&params.at, what));
            };
            let at = params.at.clone();
            let item = Item { name: kind.into(), params };
            let material = self.material(&item, &table.named)?;
            let id = self.push_material(material, &at)?;
            table.named.insert(name, id);
        }
        for item in std::mem::take(&mut self.materials) {
            let material = self.material(&item, &table.named)?;
            let id = self.push_material(material, &item.params.at)?;
            table.unnamed.push(id);
        }
        Ok(table)
    }

    fn push_material(&mut self, material: Material, at: &Location) -> Result<MaterialId> {
        let depth = match &material {
            Material::Mix { a, b, .. } => 1 + self.mix_depths[a.index()].max(self.mix_depths[b.index()]),
            _ => 0,
        };
        if depth > MAX_MIX_DEPTH {
            let what = format!("mixes {depth} deep; {MAX_MIX_DEPTH} at most");
            return Err(Error::at(at, what));
        }
        self.mix_depths.push(depth);
        let id = MaterialId(index(self.scene.materials.len())?);
        self.scene.materials.push(material);
        Ok(id)
    }

    fn material(&mut self, item: &Item, named: &HashMap<Rc<str>, MaterialId>) -> Result<Material> {
        let p = &item.params;
        let material = match &*item.name {
            // pbrt stops here too: it takes any parameter of a material that is none.
            "interface" | "" | "none" => return Ok(Material::Interface),
            "diffuse" => {
                self.dropped_unless_zero(p, "sigma", "Oren-Nayar roughness")?;
                Material::Diffuse { reflectance: self.spectrum_texture(p, "reflectance", 0.5, Use::Albedo)? }
            }
            "coateddiffuse" => self.coated_diffuse(p)?,
            "conductor" => {
                self.conductor(p, ["eta", "k", "reflectance"], ["roughness", "uroughness", "vroughness"])?
            }
            "dielectric" => {
                let roughness = self.roughness(p, ["roughness", "uroughness", "vroughness"])?;
                Material::Dielectric { eta: self.eta(p, "eta", 1.5)?, roughness }
            }
            "thindielectric" => Material::ThinDielectric { eta: self.eta(p, "eta", 1.5)? },
            "diffusetransmission" => {
                self.dropped_unless_zero(p, "sigma", "Oren-Nayar roughness")?;
                p.accept(&["remaproughness"]);
                Material::DiffuseTransmission {
                    reflectance: self.spectrum_texture(p, "reflectance", 0.25, Use::Albedo)?,
                    transmittance: self.spectrum_texture(p, "transmittance", 0.25, Use::Albedo)?,
                    scale: p.float("scale", 1.0)?,
                }
            }
            "mix" => self.mix(p, named)?,
            "coatedconductor" => {
                self.stands_in(p, "coatedconductor", "its conductor without the coat");
                p.accept(&[
                    "interface.roughness",
                    "interface.uroughness",
                    "interface.vroughness",
                    "interface.eta",
                    "thickness",
                    "maxdepth",
                    "nsamples",
                    "g",
                    "albedo",
                ]);
                self.conductor(
                    p,
                    ["conductor.eta", "conductor.k", "reflectance"],
                    ["conductor.roughness", "conductor.uroughness", "conductor.vroughness"],
                )?
            }
            "subsurface" => self.subsurface(p)?,
            "hair" => {
                self.stands_in(p, "hair", "a diffuse of its color, or brown");
                p.accept(&["sigma_a", "eumelanin", "pheomelanin", "eta", "beta_m", "beta_n", "alpha"]);
                let brown = Rgb::new(0.25, 0.15, 0.09);
                let reflectance = match self.spectrum_texture_opt(p, "color", Use::Albedo)? {
                    Some(id) => id,
                    None => self.constant(brown)?,
                };
                Material::Diffuse { reflectance }
            }
            "measured" => {
                self.stands_in(p, "measured", "a diffuse of reflectance 0.5");
                p.accept(&["filename"]);
                Material::Diffuse { reflectance: self.constant(Rgb::splat(0.5))? }
            }
            other => {
                if let Some((_, now)) = FORMER.iter().find(|(was, _)| *was == other) {
                    let what = format!("material \"{other}\" is pbrt-v3's; pbrt-v4 has \"{now}\"");
                    return Err(Error::at(&p.at, what));
                }
                return Err(item.unknown("material", "materials", &KINDS));
            }
        };
        if self.float_texture_opt(p, "displacement")?.is_some() {
            self.warnings
                .add(p.place("displacement"), "bump maps are not supported; the surface stays smooth");
        }
        if p.string("normalmap")?.is_some() {
            self.warnings
                .add(p.place("normalmap"), "normal maps are not supported; the surface stays smooth");
        }
        p.finish()?;
        Ok(material)
    }

    fn stands_in(&mut self, p: &Params, what: &str, stand_in: &str) {
        self.warnings.add(&p.at, format!("material \"{what}\" is not supported; {stand_in} stands in"));
    }

    /// A float parameter without effect here: a warning unless it is 0.
    fn dropped_unless_zero(&mut self, p: &Params, name: &'static str, what: &str) -> Result<()> {
        if let Some(id) = self.float_texture_opt(p, name)?
            && self.scene.textures[id.index()] != Texture::Constant(Rgb::ZERO)
        {
            self.warnings.add(p.place(name), format!("{what} is not supported; 0 stands in"));
        }
        Ok(())
    }

    fn roughness(&mut self, p: &Params, names: [&'static str; 3]) -> Result<Roughness> {
        let both = self.float_texture(p, names[0], 0.0)?;
        let u = self.float_texture_opt(p, names[1])?.unwrap_or(both);
        let v = self.float_texture_opt(p, names[2])?.unwrap_or(both);
        Ok(Roughness { u, v, remap: p.bool("remaproughness", true)? })
    }

    /// An index of refraction: a number, or a spectrum reduced to one number.
    fn eta(&mut self, p: &Params, name: &'static str, default: f32) -> Result<f32> {
        let eta = match p.float_opt(name)? {
            Some(eta) => eta,
            None => match color_opt(p, name, Use::Unbounded, &self.files)? {
                Some(rgb) => {
                    if (rgb.max_element() - rgb.min_element()) > 1e-3 {
                        self.warnings
                            .add(p.place(name), "dispersion is not simulated; the mean index stands in");
                    }
                    luminance(rgb)
                }
                None => default,
            },
        };
        // pbrt takes an index of 0 to mean 1.
        let eta = if eta == 0.0 { 1.0 } else { eta };
        if eta > 0.0 {
            Ok(eta)
        } else {
            Err(p.error(name, format!("\"{name}\" is {eta}; it must be positive")))
        }
    }

    fn coated_diffuse(&mut self, p: &Params) -> Result<Material> {
        p.accept(&["nsamples"]);
        let albedo = self.spectrum_texture(p, "albedo", 0.0, Use::Albedo)?;
        if self.scene.textures[albedo.index()] != Texture::Constant(Rgb::ZERO) {
            let what = "scattering inside a coat is not supported; a clear coat stands in";
            self.warnings.add(p.place("albedo"), what);
        }
        self.float_texture(p, "g", 0.0)?;
        let thickness = self.float_texture(p, "thickness", 0.01)?;
        let thickness = if let Texture::Constant(v) = self.scene.textures[thickness.index()] {
            v.x
        } else {
            self.warnings.add(p.place("thickness"), "a textured thickness is not supported; 0.01 stands in");
            0.01
        };
        Ok(Material::CoatedDiffuse {
            reflectance: self.spectrum_texture(p, "reflectance", 0.5, Use::Albedo)?,
            roughness: self.roughness(p, ["roughness", "uroughness", "vroughness"])?,
            thickness: thickness.max(f32::MIN_POSITIVE),
            eta: self.eta(p, "eta", 1.5)?,
            max_depth: p.int_in("maxdepth", 10, 0..=1_000_000)?,
        })
    }

    /// `names`: η, k and the reflectance that excludes them.
    fn conductor(
        &mut self,
        p: &Params,
        names: [&'static str; 3],
        rough: [&'static str; 3],
    ) -> Result<Material> {
        let roughness = self.roughness(p, rough)?;
        let fitted = self.fitted_metal(p, names[0], names[1])?;
        let eta = self.spectrum_texture_opt(p, names[0], Use::Unbounded)?;
        let k = self.spectrum_texture_opt(p, names[1], Use::Unbounded)?;
        if let Some(reflectance) = self.spectrum_texture_opt(p, names[2], Use::Albedo)? {
            if eta.is_some() || k.is_some() {
                let what =
                    "both \"reflectance\" and \"eta\" or \"k\" are given; a conductor takes one or the other";
                return Err(Error::at(&p.at, what));
            }
            return Ok(Material::ConductorReflectance { reflectance, roughness });
        }
        let (eta, k) = match fitted {
            Some((eta, k)) => (self.constant(eta)?, self.constant(k)?),
            None => {
                let copper = |name| Spectrum::named(name).map_or(Rgb::ONE, |s| s.to_rgb_unbounded());
                let or = |this: &mut Self, id: Option<TextureId>, name| match id {
                    Some(id) => Ok(id),
                    None => this.constant(copper(name)),
                };
                (or(self, eta, "metal-Cu-eta")?, or(self, k, "metal-Cu-k")?)
            }
        };
        Ok(Material::Conductor { eta, k, roughness })
    }

    /// η and k as one fit to the metal's spectral colour, where both are spectra (copper where absent).
    fn fitted_metal(&self, p: &Params, eta: &'static str, k: &'static str) -> Result<Option<(Rgb, Rgb)>> {
        const ANY: &[Type] = &[Type::Rgb, Type::Texture, Type::Spectrum, Type::Blackbody];
        let one = |name, copper| match p.find(name, ANY) {
            Some(found) if found.kind == Type::Spectrum => spectrum_of(found, &self.files).map(Some),
            Some(_) => Ok(None),
            None => Ok(Spectrum::named(copper)),
        };
        let pair = (one(eta, "metal-Cu-eta")?, one(k, "metal-Cu-k")?);
        Ok(if let (Some(eta), Some(k)) = pair { Some(conductor_rgb(&eta, &k)) } else { None })
    }

    fn mix(&mut self, p: &Params, named: &HashMap<Rc<str>, MaterialId>) -> Result<Material> {
        let Some(found) = p.find("materials", &[Type::String]) else {
            return Err(Error::at(
                &p.at,
                "mix needs \"string materials\" [ \"a\" \"b\" ]; name two materials",
            ));
        };
        let [a, b] = found.strings_ref() else {
            let n = found.strings_ref().len();
            return Err(Error::at(&found.at, format!("mix has {n} materials; it takes two")));
        };
        let find = |name: &str| {
            named.get(name).copied().ok_or_else(|| {
                let mut names: Vec<&str> = named.keys().map(|k| &**k).collect();
                names.sort_unstable();
                let hint = match nearest(name, &names) {
                    Some(near) => format!("did you mean \"{near}\"?"),
                    None => "define it with MakeNamedMaterial before the mix".to_owned(),
                };
                Error::at(&found.at, format!("no material \"{}\" to mix; {hint}", shown(name.as_bytes())))
            })
        };
        let (a, b) = (find(a)?, find(b)?);
        Ok(Material::Mix { a, b, amount: self.float_texture(p, "amount", 0.5)? })
    }

    fn subsurface(&mut self, p: &Params) -> Result<Material> {
        self.stands_in(p, "subsurface", "a coateddiffuse of its reflectance");
        p.accept(&["g", "name", "scale", "mfp"]);
        let a = color_opt(p, "sigma_a", Use::Unbounded, &self.files)?;
        let s = color_opt(p, "sigma_s", Use::Unbounded, &self.files)?;
        let reflectance = match self.spectrum_texture_opt(p, "reflectance", Use::Albedo)? {
            Some(id) => id,
            None => {
                // pbrt's default is whole milk.
                let a = a.unwrap_or(Rgb::new(0.0011, 0.0024, 0.014));
                let s = s.unwrap_or(Rgb::new(2.55, 3.21, 3.77));
                self.constant(diffuse_reflectance(a, s))?
            }
        };
        Ok(Material::CoatedDiffuse {
            reflectance,
            roughness: self.roughness(p, ["roughness", "uroughness", "vroughness"])?,
            thickness: 0.01,
            eta: self.eta(p, "eta", 1.33)?,
            max_depth: 10,
        })
    }
}

/// Albedo of a half-space that scatters isotropically (van de Hulst 1980, table 12's fit).
fn diffuse_reflectance(absorption: Rgb, scattering: Rgb) -> Rgb {
    let one = |a: f32, s: f32| {
        let single = if a + s > 0.0 { s / (a + s) } else { 0.0 };
        let r = (1.0 - single).max(0.0).sqrt();
        ((1.0 - r) * (1.0 - 0.139 * r) / (1.0 + 1.17 * r)).clamp(0.0, 1.0)
    };
    Rgb::new(
        one(absorption.x, scattering.x),
        one(absorption.y, scattering.y),
        one(absorption.z, scattering.z),
    )
}
