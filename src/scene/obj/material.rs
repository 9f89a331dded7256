//! MTL into materials. As with OBJ, text is cleaned before tobj parses it (a `Kd` of two numbers
//! makes it panic), and texture options go aside: tobj would take them for the file's name. The
//! rules are at the head of the module above. Never opens an image.

use super::clean::{lines, split_keyword};
use super::{Surface, find_file, warn};
use crate::color::Rgb;
use crate::error::{Error, Location, Result};
use crate::scene::{
    AreaLight, AreaLightId, Channels, Encoding, ImageId, ImageSource, Mapping, Material, MaterialId,
    Roughness, SceneDescription, Texture, TextureFilter, TextureId, Warning, Wrap,
};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Colours below this count as black: exporters write 0.001 for none.
const BLACK: f32 = 0.02;
/// Kinds of image that [`crate::texture`] reads.
const IMAGE_KINDS: &[&str] = &["png", "jpg", "jpeg", "tga", "bmp", "dib", "tif", "tiff", "hdr", "exr", "pfm"];

/// All materials of a scene's libraries, as parsed.
#[derive(Default)]
pub(super) struct Library {
    materials: Vec<(tobj::Material, PathBuf)>,
    names: HashMap<String, usize>,
    lower: HashMap<String, usize>,
}

impl Library {
    pub(super) fn len(&self) -> usize {
        self.materials.len()
    }

    /// By name, else by name in any case.
    pub(super) fn find(&self, name: &str) -> Option<usize> {
        self.names.get(name).or_else(|| self.lower.get(&name.to_lowercase())).copied()
    }

    /// Adds the materials of the file `path`, whose bytes are `text`. Of two with one name, the
    /// first is used.
    pub(super) fn add(&mut self, path: &Path, text: &[u8], warnings: &mut Vec<Warning>) -> Result<()> {
        if text.iter().take(1 << 16).any(|&b| b == 0) {
            return Err(Error::file(path, "binary data or UTF-16; an MTL file in UTF-8 is needed"));
        }
        let clean = clean(path, text, warnings);
        let (materials, _) = tobj::load_mtl_buf(&mut clean.as_bytes())
            .map_err(|e| Error::file(path, format!("damaged material library: {e}")))?;
        for m in materials {
            let i = self.materials.len();
            self.names.entry(m.name.clone()).or_insert(i);
            self.lower.entry(m.name.to_lowercase()).or_insert(i);
            self.materials.push((m, path.to_path_buf()));
        }
        Ok(())
    }

    /// Puts material `number` into the scene's tables; a number beyond the last gives grey.
    pub(super) fn realise(
        &self,
        number: usize,
        obj: &Path,
        scene: &mut SceneDescription,
        warnings: &mut Vec<Warning>,
    ) -> Surface {
        let Some((m, file)) = self.materials.get(number) else {
            let reflectance = constant(scene, Rgb::splat(0.5));
            return Surface {
                material: push(scene, Material::Diffuse { reflectance }),
                area_light: None,
                alpha: None,
            };
        };
        Builder { m, file, obj, scene, warnings }.build()
    }
}

/// Keywords whose values are colours.
const COLORS: &[&str] = &["Ka", "Kd", "Ks", "Ke"];
/// Keywords with one number.
const NUMBERS: &[&str] = &["Ns", "Ni", "d", "Tr", "Pr", "Pm", "illum"];
/// Texture maps that are used.
const MAPS: &[&str] = &["map_Kd", "map_d", "map_Ke"];
/// Texture maps that are not.
const OTHER_MAPS: &[&str] = &[
    "map_Ks", "map_Ns", "map_bump", "bump", "norm", "disp", "decal", "refl", "map_Pr", "map_Pm", "map_Ps",
    "map_refl", "map_Tr",
];

/// MTL text that tobj parses without error: one word, then exactly the numbers it needs.
fn clean(path: &Path, text: &[u8], warnings: &mut Vec<Warning>) -> String {
    let mut out = String::new();
    let mut any = false;
    for (number, line) in lines(text) {
        let (keyword, rest) = split_keyword(&line);
        let (keyword, rest) = (String::from_utf8_lossy(keyword), String::from_utf8_lossy(rest));
        let rest = rest.trim();
        let canonical =
            |list: &[&'static str]| list.iter().find(|k| k.eq_ignore_ascii_case(&keyword)).copied();
        let mut warning = |message: String| {
            if warnings.len() < 1000 {
                let at = Location { line: number, ..Location::whole(path) };
                warnings.push(Warning { at, message });
            }
        };
        let words: Vec<&str> = rest.split_whitespace().take_while(|w| !w.starts_with('#')).collect();
        // `d -halo 0.9`: the halo is of no use to a path tracer.
        let values: Vec<f32> = words
            .iter()
            .filter(|w| **w != "-halo")
            .map_while(|w| w.parse::<f32>().ok().filter(|v| v.is_finite()))
            .collect();
        if keyword == "newmtl" {
            any = true;
            // Without a name it can still be meant by a `usemtl` without one.
            let name = if rest.is_empty() { "unnamed" } else { rest };
            out.push_str(&format!("newmtl {name}\n"));
        } else if !any {
            // tobj would lose it, and so would its author's program.
        } else if let Some(k) = canonical(COLORS) {
            match values[..] {
                [r, g, b, ..] => out.push_str(&format!("{k} {r} {g} {b}\n")),
                [v, ..] => out.push_str(&format!("{k} {v} {v} {v}\n")),
                [] => warning(format!("{k} needs three numbers; spectral curves and XYZ are ignored")),
            }
        } else if let Some(k) = canonical(NUMBERS) {
            match values.first() {
                Some(v) if k == "illum" => out.push_str(&format!("illum {}\n", v.clamp(0.0, 255.0) as u8)),
                Some(v) => out.push_str(&format!("{k} {v}\n")),
                None => warning(format!("{k} needs a number; ignored")),
            }
        } else if let Some(k) = canonical(MAPS) {
            let (name, uv) = texture_name(rest);
            if name.is_empty() {
                warning(format!("{k} names no file; ignored"));
            } else {
                out.push_str(&format!("{k} {name}\n{k}:uv {} {} {} {}\n", uv[0], uv[1], uv[2], uv[3]));
            }
        } else if let Some(k) = canonical(OTHER_MAPS) {
            out.push_str(&format!("{k}:ignored x\n"));
        }
    }
    out
}

/// The file's name and (scale, offset) of u and v in what follows a `map_` keyword. Options stand
/// before the name as a rule, and after it in files that exist.
fn texture_name(rest: &str) -> (String, [f32; 4]) {
    let mut uv = [1.0, 1.0, 0.0, 0.0];
    let mut name: Vec<&str> = Vec::new();
    let mut words = rest.split_whitespace().peekable();
    while let Some(word) = words.next() {
        let numbers = match word.to_ascii_lowercase().as_str() {
            "-s" => Some((0, 3)),
            "-o" => Some((2, 3)),
            "-t" => Some((4, 3)),
            "-mm" => Some((4, 2)),
            "-bm" | "-boost" | "-texres" => Some((4, 1)),
            "-blendu" | "-blendv" | "-cc" | "-clamp" | "-imfchan" | "-type" | "-colorspace" => None,
            _ => {
                name.push(word);
                continue;
            }
        };
        let Some((slot, most)) = numbers else {
            words.next();
            continue;
        };
        for k in 0..most {
            let Some(value) = words.peek().and_then(|w| w.parse::<f32>().ok()) else { break };
            words.next();
            if slot < 4 && k < 2 && value.is_finite() {
                uv[slot + k] = value;
            }
        }
    }
    (name.join(" "), uv)
}

fn push(scene: &mut SceneDescription, material: Material) -> MaterialId {
    scene.materials.push(material);
    MaterialId(scene.materials.len() as u32 - 1)
}

fn texture(scene: &mut SceneDescription, texture: Texture) -> TextureId {
    if let Some(i) = scene.textures.iter().position(|t| *t == texture) {
        return TextureId(i as u32);
    }
    scene.textures.push(texture);
    TextureId(scene.textures.len() as u32 - 1)
}

fn constant(scene: &mut SceneDescription, value: Rgb) -> TextureId {
    texture(scene, Texture::Constant(value))
}

struct Builder<'a> {
    m: &'a tobj::Material,
    file: &'a Path,
    obj: &'a Path,
    scene: &'a mut SceneDescription,
    warnings: &'a mut Vec<Warning>,
}

impl Builder<'_> {
    fn number(&self, key: &str) -> Option<f32> {
        self.m.unknown_param.get(key)?.parse().ok()
    }

    fn build(mut self) -> Surface {
        let m = self.m;
        let mut ignored: Vec<&str> =
            m.unknown_param.keys().filter_map(|k| k.strip_suffix(":ignored")).collect();
        ignored.sort_unstable();
        for k in ignored {
            warn(self.warnings, self.file, format!("{k} is not supported; the surface goes without it"));
        }
        let material = self.material();
        let area_light = self.emission();
        let alpha = self.opacity(&material);
        Surface { material: push(self.scene, material), area_light, alpha }
    }

    fn color(&self, c: Option<[f32; 3]>) -> Rgb {
        c.map_or(Rgb::ZERO, Rgb::from).clamp(Rgb::ZERO, Rgb::ONE)
    }

    /// d, else 1 − Tr; a Tr of 1 alone is an exporter's word for opaque, nobody models nothing.
    fn dissolve(&self) -> f32 {
        let from_tr = self.number("Tr").filter(|&t| t < 1.0).map(|t| 1.0 - t);
        self.m.dissolve.or(from_tr).unwrap_or(1.0).clamp(0.0, 1.0)
    }

    fn material(&mut self) -> Material {
        let m = self.m;
        let (kd, ks) = (self.color(m.diffuse), self.color(m.specular));
        let illum = m.illumination_model.unwrap_or(2);
        let black = kd.max_element() < BLACK && m.diffuse_texture.is_none();
        let d = self.dissolve();
        let glass = match illum {
            6 | 7 | 9 => true,
            4 => d < 1.0 || (black && m.diffuse.is_some()),
            _ => d < 0.1,
        };
        if glass {
            let eta = m.optical_density.filter(|n| (1.01..10.0).contains(n)).unwrap_or(1.5);
            let roughness = self.roughness(0.0);
            return Material::Dielectric { eta, roughness };
        }
        let ns = m.shininess.unwrap_or(0.0).max(0.0);
        let alpha = match self.number("Pr") {
            // The metallic-roughness convention: α is the square.
            Some(r) => r.clamp(0.0, 1.0) * r.clamp(0.0, 1.0),
            // Blinn's exponent of equal width (Walter et al. 2007, §5.2 with Phong).
            None => (2.0 / (ns + 2.0)).sqrt(),
        };
        if self.number("Pm").is_some_and(|p| p >= 0.5) {
            let reflectance = self.diffuse();
            let roughness = self.roughness(alpha);
            return Material::ConductorReflectance { reflectance, roughness };
        }
        let shiny = ks.max_element() > BLACK && illum >= 2 && ns >= 10.0;
        let mirror = black && ks.max_element() > BLACK && (shiny || matches!(illum, 3 | 5));
        if mirror {
            let alpha = if m.shininess.is_none() && self.number("Pr").is_none() { 0.0 } else { alpha };
            let reflectance = constant(self.scene, ks);
            let roughness = self.roughness(alpha);
            return Material::ConductorReflectance { reflectance, roughness };
        }
        let reflectance = self.diffuse();
        if shiny || self.number("Pr").is_some_and(|r| r < 0.7) {
            let eta = m.optical_density.filter(|n| (1.2..2.5).contains(n)).unwrap_or(1.5);
            let roughness = self.roughness(alpha);
            return Material::CoatedDiffuse { reflectance, roughness, thickness: 0.01, eta, max_depth: 10 };
        }
        Material::Diffuse { reflectance }
    }

    fn roughness(&mut self, alpha: f32) -> Roughness {
        // Below this a lobe is a mirror to the eye and noise to a path tracer.
        let alpha = if alpha < 0.01 { 0.0 } else { alpha };
        let id = constant(self.scene, Rgb::splat(alpha));
        Roughness { u: id, v: id, remap: false }
    }

    fn diffuse(&mut self) -> TextureId {
        let m = self.m;
        let kd = m.diffuse.map_or(Rgb::splat(0.5), |c| self.color(Some(c)));
        let Some(name) = &m.diffuse_texture else { return constant(self.scene, kd) };
        let black = kd.max_element() < BLACK;
        match self.image(name, "map_Kd:uv", Encoding::Srgb, Channels::Rgb) {
            None if black => constant(self.scene, Rgb::splat(0.5)),
            None => constant(self.scene, kd),
            Some((image, _)) if black || kd == Rgb::ONE || m.diffuse.is_none() => image,
            Some((image, _)) => {
                let scale = constant(self.scene, kd);
                texture(self.scene, Texture::Scale { texture: image, scale })
            }
        }
    }

    fn emission(&mut self) -> Option<AreaLightId> {
        let m = self.m;
        let mut radiance = m.emissive.map_or(Rgb::ZERO, Rgb::from).max(Rgb::ZERO);
        let mut image = None;
        if let Some(name) = m.unknown_param.get("map_Ke") {
            image = self.image(name, "map_Ke:uv", Encoding::Srgb, Channels::Rgb).map(|(_, image)| image);
            if image.is_some() && radiance == Rgb::ZERO {
                radiance = Rgb::ONE;
            }
        }
        if radiance == Rgb::ZERO {
            return None;
        }
        self.scene.area_lights.push(AreaLight { radiance, image, two_sided: true, power: None });
        Some(AreaLightId(self.scene.area_lights.len() as u32 - 1))
    }

    fn opacity(&mut self, material: &Material) -> Option<TextureId> {
        let m = self.m;
        if let Some(name) = &m.dissolve_texture
            && let Some((id, _)) = self.image(name, "map_d:uv", Encoding::Linear, Channels::Alpha)
        {
            return Some(id);
        }
        let d = self.dissolve();
        // Glass says its transparency itself.
        (d < 1.0 && !matches!(material, Material::Dielectric { .. }))
            .then(|| constant(self.scene, Rgb::splat(d)))
    }

    /// An image texture, or a warning.
    fn image(
        &mut self,
        name: &str,
        uv_key: &str,
        encoding: Encoding,
        channels: Channels,
    ) -> Option<(TextureId, ImageId)> {
        let folders = [self.file, self.obj].map(|f| f.parent().unwrap_or(Path::new("")));
        let shown: String = name.escape_debug().take(200).collect();
        let Some(path) = find_file(name, &folders) else {
            warn(self.warnings, self.file, format!("texture `{shown}` is missing; its colour stands in"));
            return None;
        };
        let kind = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        if !IMAGE_KINDS.contains(&kind.as_str()) {
            let message =
                format!("texture `{shown}`: this kind of image is not supported; its colour stands in");
            warn(self.warnings, self.file, message);
            return None;
        }
        let at = Location::whole(self.file);
        let source = ImageSource { path, encoding, named: false, at };
        let same = |s: &ImageSource| s.path == source.path && s.encoding == source.encoding;
        let image = ImageId(match self.scene.images.iter().position(same) {
            Some(i) => i as u32,
            None => {
                self.scene.images.push(source);
                self.scene.images.len() as u32 - 1
            }
        });
        let uv: Vec<f32> = self
            .m
            .unknown_param
            .get(uv_key)
            .map(|s| s.split(' ').filter_map(|w| w.parse().ok()).collect())
            .unwrap_or_default();
        let (scale, delta) = match uv[..] {
            [su, sv, ou, ov] => ([su, sv], [ou, ov]),
            _ => ([1.0; 2], [0.0; 2]),
        };
        let id = texture(
            self.scene,
            Texture::Image {
                image,
                mapping: Mapping::Uv { scale, delta },
                filter: TextureFilter::Bilinear,
                wrap: Wrap::Repeat,
                scale: 1.0,
                invert: false,
                channels,
            },
        );
        Some((id, image))
    }
}
