//! `Texture` directives. They are built when the scene has been read, images first and the rest in
//! order, so a texture may refer to any image and to what stands before it (pbrt's rule; it keeps
//! the references free of cycles). A spectrum texture may differ by use: see `Use`.
//! Never loads an image.

use super::lexer::shown;
use super::params::{Params, Type};
use super::reader::{Item, Reader, index};
use super::spectra::{USES, Use, color, color_of};
use super::suggest::nearest;
use crate::color::Rgb;
use crate::error::{Error, Location, Result};
use crate::math::Transform;
use crate::scene::{
    Channels, Encoding, ImageId, ImageSource, Mapping, Texture, TextureFilter, TextureId, Wrap,
};
use glam::Vec3;
use std::collections::HashMap;
use std::path::PathBuf;
use std::rc::Rc;

/// A texture as its directive gave it.
pub(super) struct PendingTexture {
    pub(super) name: Rc<str>,
    pub(super) float: bool,
    pub(super) item: Item,
    pub(super) texture_to_world: Rc<Transform>,
}

/// What an evaluation of a texture visits.
#[derive(Clone, Copy)]
struct Weight {
    depth: u32,
    nodes: u64,
}

/// Most textures one inside the other.
const MAX_DEPTH: u32 = 256;

/// Textures declared, waiting and built.
#[derive(Default)]
pub(super) struct Textures {
    pub(super) pending: Vec<PendingTexture>,
    /// `None` until built.
    floats: HashMap<Rc<str>, Option<TextureId>>,
    /// By [`Use`].
    spectra: HashMap<Rc<str>, Option<[TextureId; 3]>>,
    constants: HashMap<[u32; 3], TextureId>,
    /// What an evaluation of each texture of the scene visits.
    weights: Vec<Weight>,
    images: HashMap<(PathBuf, u32, bool), ImageId>,
}

impl Textures {
    /// Takes a name; `false` when it is taken.
    pub(super) fn declare(&mut self, name: &Rc<str>, float: bool) -> bool {
        if float {
            self.floats.insert(name.clone(), None).is_none()
        } else {
            self.spectra.insert(name.clone(), None).is_none()
        }
    }
}

const KINDS: [&str; 12] = [
    "constant",
    "scale",
    "mix",
    "directionmix",
    "bilerp",
    "imagemap",
    "checkerboard",
    "dots",
    "fbm",
    "wrinkled",
    "windy",
    "ptex",
];

impl Reader {
    /// Builds every declared texture.
    pub(super) fn build_textures(&mut self) -> Result<()> {
        let pending = std::mem::take(&mut self.textures.pending);
        let is_image = |t: &&PendingTexture| &*t.item.name == "imagemap";
        let images = pending.iter().filter(is_image);
        for t in images.chain(pending.iter().filter(|t| !is_image(t))) {
            if t.float {
                let texture = self.texture_of(t, None)?;
                let id = self.push_texture(texture, &t.item.params.at)?;
                self.textures.floats.insert(t.name.clone(), Some(id));
            } else {
                let mut ids = [TextureId(0); 3];
                let mut built: Vec<Texture> = Vec::with_capacity(3);
                for (i, how) in USES.into_iter().enumerate() {
                    let texture = self.texture_of(t, Some(how))?;
                    ids[i] = match built.iter().position(|b| *b == texture) {
                        Some(same) => ids[same],
                        None => self.push_texture(texture.clone(), &t.item.params.at)?,
                    };
                    built.push(texture);
                }
                self.textures.spectra.insert(t.name.clone(), Some(ids));
            }
            t.item.params.finish()?;
        }
        Ok(())
    }

    fn push_texture(&mut self, texture: Texture, at: &Location) -> Result<TextureId> {
        if let Texture::Constant(value) = texture {
            return self.constant(value);
        }
        let mut weight = Weight { depth: 1, nodes: 1 };
        for part in texture.parts().into_iter().flatten() {
            let part = self.textures.weights[part.index()];
            weight.depth = weight.depth.max(part.depth + 1);
            weight.nodes = weight.nodes.saturating_add(part.nodes);
        }
        if weight.depth > MAX_DEPTH || weight.nodes > Texture::MAX_NODES {
            let what = format!(
                "a texture of {} others, {} deep; {} and {MAX_DEPTH} at most",
                weight.nodes,
                weight.depth,
                Texture::MAX_NODES
            );
            return Err(Error::at(at, what));
        }
        let id = TextureId(index(self.scene.textures.len())?);
        self.scene.textures.push(texture);
        self.textures.weights.push(weight);
        Ok(id)
    }

    /// The texture that is `value` everywhere.
    pub(super) fn constant(&mut self, value: Rgb) -> Result<TextureId> {
        let key = value.to_array().map(f32::to_bits);
        if let Some(&id) = self.textures.constants.get(&key) {
            return Ok(id);
        }
        let id = TextureId(index(self.scene.textures.len())?);
        self.scene.textures.push(Texture::Constant(value));
        self.textures.weights.push(Weight { depth: 1, nodes: 1 });
        self.textures.constants.insert(key, id);
        Ok(id)
    }

    /// A float parameter that may be a texture.
    pub(super) fn float_texture_opt(&mut self, p: &Params, name: &'static str) -> Result<Option<TextureId>> {
        let Some(found) = p.find(name, &[Type::Float, Type::Texture]) else { return Ok(None) };
        if found.kind == Type::Float {
            let [v] = found.numbers::<1>()?;
            return self.constant(Rgb::splat(v)).map(Some);
        }
        let wanted = texture_name(found.strings_ref(), &found.at)?;
        match self.textures.floats.get(wanted) {
            Some(Some(id)) => Ok(Some(*id)),
            Some(None) => Err(later(wanted, &found.at)),
            None => Err(self.no_texture(wanted, "float", &found.at)),
        }
    }

    /// A float parameter that may be a texture, with a default.
    pub(super) fn float_texture(
        &mut self,
        p: &Params,
        name: &'static str,
        default: f32,
    ) -> Result<TextureId> {
        match self.float_texture_opt(p, name)? {
            Some(id) => Ok(id),
            None => self.constant(Rgb::splat(default)),
        }
    }

    /// A colour parameter that may be a texture.
    pub(super) fn spectrum_texture_opt(
        &mut self,
        p: &Params,
        name: &'static str,
        how: Use,
    ) -> Result<Option<TextureId>> {
        const KINDS: &[Type] = &[Type::Rgb, Type::Texture, Type::Spectrum, Type::Blackbody];
        let Some(found) = p.find(name, KINDS) else { return Ok(None) };
        if found.kind != Type::Texture {
            let value = color_of(found, p.space, how, &self.files)?;
            return self.constant(value).map(Some);
        }
        let wanted = texture_name(found.strings_ref(), &found.at)?;
        match self.textures.spectra.get(wanted) {
            Some(Some(ids)) => Ok(Some(ids[how as usize])),
            Some(None) => Err(later(wanted, &found.at)),
            None => Err(self.no_texture(wanted, "spectrum", &found.at)),
        }
    }

    /// A colour parameter that may be a texture, with a grey default.
    pub(super) fn spectrum_texture(
        &mut self,
        p: &Params,
        name: &'static str,
        default: f32,
        how: Use,
    ) -> Result<TextureId> {
        match self.spectrum_texture_opt(p, name, how)? {
            Some(id) => Ok(id),
            None => self.constant(Rgb::splat(default)),
        }
    }

    fn no_texture(&self, wanted: &str, kind: &str, at: &Location) -> Error {
        let (own, other, other_kind): (Vec<&str>, bool, &str) = if kind == "float" {
            let own = self.textures.floats.keys().map(|k| &**k).collect();
            (own, self.textures.spectra.contains_key(wanted), "spectrum")
        } else {
            let own = self.textures.spectra.keys().map(|k| &**k).collect();
            (own, self.textures.floats.contains_key(wanted), "float")
        };
        let mut own = own;
        // A fixed order, so that the message does not change from run to run.
        own.sort_unstable();
        let hint = match nearest(wanted, &own) {
            _ if other => format!("there is a {other_kind} texture of that name"),
            Some(near) => format!("did you mean \"{near}\"?"),
            None => "define it with Texture".to_owned(),
        };
        Error::at(at, format!("no {kind} texture \"{}\"; {hint}", shown(wanted.as_bytes())))
    }

    /// One texture; `how` is `None` for a float texture.
    fn texture_of(&mut self, t: &PendingTexture, how: Option<Use>) -> Result<Texture> {
        let p = &t.item.params;
        Ok(match &*t.item.name {
            "constant" => Texture::Constant(self.plain(p, "value", 1.0, how)?),
            "scale" => Texture::Scale {
                texture: self.child(p, "tex", 1.0, how)?,
                scale: self.float_texture(p, "scale", 1.0)?,
            },
            "mix" => Texture::Mix {
                a: self.child(p, "tex1", 0.0, how)?,
                b: self.child(p, "tex2", 1.0, how)?,
                amount: self.float_texture(p, "amount", 0.5)?,
            },
            "directionmix" => {
                let dir = p.triple("dir", &[Type::Vector3], [0.0, 1.0, 0.0])?;
                let Some(dir) = t.texture_to_world.vector(Vec3::from(dir)).try_normalize() else {
                    return Err(p.error("dir", "\"dir\" has no length; give a direction"));
                };
                Texture::DirectionMix {
                    a: self.child(p, "tex1", 0.0, how)?,
                    b: self.child(p, "tex2", 1.0, how)?,
                    dir: dir.to_array(),
                }
            }
            "bilerp" => Texture::Bilerp {
                mapping: mapping(p, &t.texture_to_world)?,
                corners: [
                    self.plain(p, "v00", 0.0, how)?,
                    self.plain(p, "v01", 1.0, how)?,
                    self.plain(p, "v10", 0.0, how)?,
                    self.plain(p, "v11", 1.0, how)?,
                ],
            },
            "imagemap" => self.image_texture(t, how)?,
            "checkerboard" => {
                let dimension = p.int_in("dimension", 2, 2..=3)?;
                let a = self.child(p, "tex1", 1.0, how)?;
                let b = self.child(p, "tex2", 0.0, how)?;
                let world_to_texture = t.texture_to_world.inverse();
                if dimension == 3 {
                    Texture::Checkerboard3d { world_to_texture, a, b }
                } else {
                    Texture::Checkerboard { mapping: mapping(p, &t.texture_to_world)?, a, b }
                }
            }
            "dots" => {
                mapping(p, &t.texture_to_world)?;
                self.warnings
                    .add(&p.at, "texture \"dots\" is not supported; the mean of its two parts stands in");
                Texture::Mix {
                    a: self.child(p, "inside", 1.0, how)?,
                    b: self.child(p, "outside", 0.0, how)?,
                    amount: self.constant(Rgb::splat(0.5))?,
                }
            }
            other @ ("fbm" | "wrinkled" | "windy" | "marble" | "ptex")
                if how.is_some() || other != "marble" =>
            {
                p.accept(&["octaves", "roughness", "scale", "variation", "filename", "encoding"]);
                let what = format!("texture \"{other}\" is not supported; a constant 0.5 stands in");
                self.warnings.add(&p.at, what);
                Texture::Constant(Rgb::splat(0.5))
            }
            _ => {
                let mut names = KINDS.to_vec();
                names.extend(how.map(|_| "marble"));
                return Err(t.item.unknown("texture", "textures", &names));
            }
        })
    }

    fn child(&mut self, p: &Params, name: &'static str, default: f32, how: Option<Use>) -> Result<TextureId> {
        match how {
            None => self.float_texture(p, name, default),
            Some(how) => self.spectrum_texture(p, name, default, how),
        }
    }

    fn plain(&self, p: &Params, name: &'static str, default: f32, how: Option<Use>) -> Result<Rgb> {
        match how {
            None => Ok(Rgb::splat(p.float(name, default)?)),
            Some(how) => color(p, name, default, how, &self.files),
        }
    }

    fn image_texture(&mut self, t: &PendingTexture, how: Option<Use>) -> Result<Texture> {
        let p = &t.item.params;
        p.accept(&["maxanisotropy"]);
        let filter = p.choice(
            "filter",
            &[
                ("bilinear", TextureFilter::Bilinear),
                ("point", TextureFilter::Point),
                ("trilinear", TextureFilter::Trilinear),
                ("EWA", TextureFilter::Ewa),
                ("ewa", TextureFilter::Ewa),
            ],
        )?;
        let wrap = p.choice(
            "wrap",
            &[
                ("repeat", Wrap::Repeat),
                ("black", Wrap::Black),
                ("clamp", Wrap::Clamp),
                ("octahedralsphere", Wrap::OctahedralSphere),
            ],
        )?;
        let asked = encoding(p)?;
        let Some((name, at)) = p.string("filename")? else {
            return Err(Error::at(&p.at, "imagemap needs \"string filename\"; name an image"));
        };
        let path = self.files.require(name, at)?;
        let suffix = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let is = |s: &str| suffix.as_deref() == Some(s);
        // Names of tiled files, which stand in for any other and may say their curve themselves.
        let tiled = is("tx") || is("tif") || is("tiff");
        // pbrt-v4 honours "encoding" in PNG alone; other 8-bit files are sRGB to it.
        let encoding = asked.filter(|_| is("png") || tiled);
        let named = tiled && encoding.is_some();
        // It reads an alpha channel from PNG and EXR alone, and float textures then take that.
        let channels = match how {
            Some(_) => Channels::Rgb,
            None if is("png") || is("exr") || tiled => Channels::Alpha,
            None => Channels::Average,
        };
        let at = at.clone();
        Ok(Texture::Image {
            image: self.image_as(path, encoding.unwrap_or(Encoding::Srgb), named, &at)?,
            mapping: mapping(p, &t.texture_to_world)?,
            filter,
            wrap,
            scale: p.float("scale", 1.0)?,
            invert: p.bool("invert", false)?,
            channels,
        })
    }

    /// The image file, once however often it is asked for.
    pub(super) fn image(&mut self, path: PathBuf, encoding: Encoding, at: &Location) -> Result<ImageId> {
        self.image_as(path, encoding, false, at)
    }

    fn image_as(&mut self, path: PathBuf, encoding: Encoding, named: bool, at: &Location) -> Result<ImageId> {
        let key = match encoding {
            Encoding::Srgb => 0,
            Encoding::Linear => 1,
            // A positive gamma's bits are far above 1.
            Encoding::Gamma(g) => g.to_bits(),
        };
        if let Some(&id) = self.textures.images.get(&(path.clone(), key, named)) {
            return Ok(id);
        }
        let id = ImageId(index(self.scene.images.len())?);
        self.textures.images.insert((path.clone(), key, named), id);
        self.scene.images.push(ImageSource { path, encoding, named, at: at.clone() });
        Ok(id)
    }
}

fn texture_name<'a>(names: &'a [Box<str>], at: &Location) -> Result<&'a str> {
    match names {
        [one] => Ok(one),
        _ => Err(Error::at(at, format!("{} texture names; give one", names.len()))),
    }
}

fn later(name: &str, at: &Location) -> Error {
    let name = shown(name.as_bytes());
    Error::at(at, format!("texture \"{name}\" is defined further down; move its Texture before this one"))
}

/// `encoding`: `sRGB`, `linear` or `gamma N`; `None` where the scene does not say.
fn encoding(p: &Params) -> Result<Option<Encoding>> {
    let Some((text, at)) = p.string("encoding")? else { return Ok(None) };
    match text {
        "sRGB" => Ok(Some(Encoding::Srgb)),
        "linear" => Ok(Some(Encoding::Linear)),
        _ => text
            .strip_prefix("gamma ")
            .and_then(|g| g.trim().parse::<f32>().ok())
            .filter(|g| g.is_finite() && *g > 0.0)
            .map(|g| Some(Encoding::Gamma(g)))
            .ok_or_else(|| {
                let text = shown(text.as_bytes());
                Error::at(at, format!("unknown encoding \"{text}\"; it is sRGB, linear or gamma N"))
            }),
    }
}

/// The two-dimensional mapping.
fn mapping(p: &Params, texture_to_world: &Transform) -> Result<Mapping> {
    let world_to_texture = texture_to_world.inverse();
    let kinds = [("uv", 0), ("spherical", 1), ("cylindrical", 2), ("planar", 3)];
    let kind = p.choice("mapping", &kinds)?;
    let delta = |p: &Params| -> Result<[f32; 2]> { Ok([p.float("udelta", 0.0)?, p.float("vdelta", 0.0)?]) };
    Ok(match kind {
        0 => Mapping::Uv { scale: [p.float("uscale", 1.0)?, p.float("vscale", 1.0)?], delta: delta(p)? },
        1 => Mapping::Spherical { world_to_texture },
        2 => Mapping::Cylindrical { world_to_texture },
        _ => Mapping::Planar {
            world_to_texture,
            v1: p.triple("v1", &[Type::Vector3], [1.0, 0.0, 0.0])?,
            v2: p.triple("v2", &[Type::Vector3], [0.0, 1.0, 0.0])?,
            delta: delta(p)?,
        },
    })
}
