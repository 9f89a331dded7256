//! Which effects a scene calls for, and who asks for each.
//!
//! Invariant: an effect is on if and only if something that a ray can meet, the camera or a light asks for it.
//! Never opens a file.

use super::textures::{KnownTexture, known_textures};
use super::{Calls, all_shapes, is_visible};
use crate::error::Location;
use crate::scene::{
    AreaLight, CameraKind, Light, Material, MaterialId, MeshSource, Roughness, SceneDescription, Shape,
    ShapeKind, Texture, TextureId,
};
use crate::stats::EffectStats;
use std::collections::BTreeMap;
use std::fmt::Display;

/// All effects that a scene may call for, in the order in which they are told.
pub const EFFECTS: [&str; 15] = [
    "textures",
    "ray_differentials",
    "alpha_masks",
    "bump_and_normal_maps",
    "transmission",
    "rough_lobes",
    "layered_coats",
    "media",
    "motion_blur",
    "depth_of_field",
    "instances",
    "displacement",
    "image_lights",
    "many_lights",
    "spectral_dispersion",
];

/// What Weir has not, and what readers say of who asks for it.
const MISSING: [(&str, &[&str]); 4] = [
    ("bump_and_normal_maps", &["bump maps are not", "normal maps are not", "bump is not", "norm is not"]),
    ("motion_blur", &["motion blur is not"]),
    ("displacement", &["disp is not"]),
    ("spectral_dispersion", &["dispersion is not"]),
];

/// The first who asks, and how many more do.
#[derive(Default)]
struct Asked {
    first: Option<String>,
    more: u64,
}

#[derive(Default)]
struct Found(BTreeMap<&'static str, Asked>);

impl Found {
    fn add(&mut self, effect: &'static str, who: impl FnOnce() -> String) {
        let asked = self.0.entry(effect).or_default();
        match asked.first {
            Some(_) => asked.more += 1,
            None => asked.first = Some(who()),
        }
    }
}

/// Each of [`EFFECTS`], on or off, and why.
#[must_use]
pub fn effects(scene: &SceneDescription) -> BTreeMap<String, EffectStats> {
    let mut found = Found::default();
    let materials = Materials::new(scene);
    for shape in all_shapes(scene).filter(|s| is_visible(scene, s)) {
        of_shape(scene, shape, &materials, &mut found);
    }
    of_camera(scene, &mut found);
    for instance in &scene.instances {
        found.add("instances", || format!("instance {}", at(&instance.at)));
    }
    of_lights(scene, &mut found);
    EFFECTS.iter().map(|&effect| (effect.to_owned(), told(scene, effect, found.0.get(effect)))).collect()
}

/// What paths of `scene` call for, as far as its description says it; `pages`, whether geometry will come and go.
#[must_use]
pub fn calls(scene: &SceneDescription, pages: bool) -> Calls {
    let materials = Materials::new(scene);
    let of_shape = |shape: &Shape| {
        let material = &scene.materials[shape.material.index()];
        let own = &materials.kinds[shape.material.index()];
        // Of a mix both parts may come.
        let mix = matches!(material, Material::Mix { .. });
        let textured = own.texture.is_some() || mix;
        let lobes = !matches!(material, Material::Diffuse { .. } | Material::Interface);
        let varies = |alpha: TextureId| materials.known[alpha.index()].constant.is_none();
        let light = shape.area_light.map(|light| &scene.area_lights[light.index()]);
        let textured_light =
            light.is_some_and(|light| light.image.is_some() || shape.alpha.is_some_and(varies));
        Calls::NONE
            .and_if(textured || textured_light, Calls::TEXTURES)
            .and_if(lobes, Calls::LOBES)
            .and_if(lobes && (own.transmits || textured), Calls::TRANSMISSION)
            .and_if(own.filtered.is_some() && !own.passes, Calls::FOOTPRINTS)
            .and_if(own.passes || shape.medium.is_some(), Calls::MEDIA)
            .and_if(!matches!(shape.kind, ShapeKind::Mesh(_)), Calls::SHAPES)
    };
    all_shapes(scene)
        .filter(|s| is_visible(scene, s))
        .fold(Calls::NONE, |calls, shape| calls.and(of_shape(shape)))
        .and_if(pages, Calls::SHAPES)
        .and_if(!scene.instances.is_empty(), Calls::INSTANCES)
        .and_if(scene.camera_medium.is_some(), Calls::MEDIA)
        .and_if(scene.camera.lens_radius > 0.0, Calls::LENS)
}

fn told(scene: &SceneDescription, effect: &str, asked: Option<&Asked>) -> EffectStats {
    if let Some(Asked { first: Some(first), more }) = asked {
        let more = if *more > 0 { format!(" (and {more} more)") } else { String::new() };
        return EffectStats { on: true, because: format!("{first}{more}") };
    }
    let because = match MISSING.iter().find(|(name, _)| *name == effect) {
        None => "nothing asks for it".to_owned(),
        Some((_, said)) => {
            let asks = scene.warnings.iter().find(|w| said.iter().any(|text| w.message.contains(text)));
            match asks {
                Some(w) => format!("Weir has none, though {} asks for it: {}", w.at, w.message),
                // It has that of pbrt.
                None if effect == "displacement" => "nothing asks for it".to_owned(),
                None => "nothing asks for it, and Weir has none".to_owned(),
            }
        }
    };
    EffectStats { on: false, because }
}

/// A place, if the file has lines.
fn at(place: &Location) -> impl Display {
    format!("at {place}")
}

fn of_camera(scene: &SceneDescription, found: &mut Found) {
    let camera = &scene.camera;
    if camera.lens_radius > 0.0 && !matches!(camera.kind, CameraKind::Spherical { .. }) {
        found.add("depth_of_field", || format!("the camera's lens, of radius {}", camera.lens_radius));
    }
    if scene.camera_medium.is_some() {
        found.add("media", || "the camera stands in a medium".to_owned());
    }
}

fn of_shape(scene: &SceneDescription, shape: &Shape, materials: &Materials, found: &mut Found) {
    let own = &materials.kinds[shape.material.index()];
    let who = |what: &str| format!("{what} of the shape {}", at(&shape.at));
    if let Some(texture) = own.texture {
        found.add("textures", || format!("{}: {}", who("the material"), named(scene, texture)));
    }
    // Where rays may pass, look-ups have no footprint.
    if let (Some(texture), false) = (own.filtered, own.passes) {
        found.add("ray_differentials", || format!("{}: {}", who("the material"), named(scene, texture)));
    }
    for (effect, asks) in
        [("transmission", own.transmits), ("rough_lobes", own.rough), ("layered_coats", own.coated)]
    {
        if asks {
            found.add(effect, || who("the material"));
        }
    }
    if let Some(alpha) = shape.alpha {
        found.add("alpha_masks", || who("the opacity"));
        if materials.known[alpha.index()].constant.is_none() {
            found.add("textures", || format!("{}: {}", who("the opacity"), named(scene, alpha)));
        }
    }
    if let ShapeKind::Mesh(id) = shape.kind
        && let MeshSource::Displaced { texture, .. } = scene.meshes[id.index()]
    {
        found.add("displacement", || format!("{}: {}", who("the displacement"), named(scene, texture)));
    }
    if shape.medium.is_some_and(|m| m.inside.is_some() || m.outside.is_some()) {
        found.add("media", || who("a side"));
    }
    if let Some(light) = shape.area_light
        && let Some(image) = scene.area_lights[light.index()].image
    {
        let path = &scene.images[image.index()].path;
        found.add("image_lights", || format!("{}: image {}", who("the light"), path.display()));
    }
}

fn of_lights(scene: &SceneDescription, found: &mut Found) {
    let mut lights = 0u64;
    let mut first = String::new();
    for light in &scene.lights {
        if let Light::Image { image, .. } = light {
            let source = &scene.images[image.index()];
            found.add("image_lights", || {
                format!("the light {}: image {}", at(&source.at), source.path.display())
            });
        }
        // A constant sky is found by paths, not chosen.
        lights += u64::from(!matches!(light, Light::Constant { .. }));
    }
    for shape in scene.shapes.iter().filter(|s| is_visible(scene, s)) {
        let Some(light) = shape.area_light else { continue };
        let AreaLight { radiance, .. } = &scene.area_lights[light.index()];
        if radiance.max_element() <= 0.0 {
            continue;
        }
        if first.is_empty() {
            first = format!(", the first of a shape {}", at(&shape.at));
        }
        lights = lights.saturating_add(pieces(scene, shape));
    }
    if lights > 1 {
        found.add("many_lights", || format!("{lights} lights{first}"));
    }
}

/// Parts that are chosen one by one; of a file at least two.
fn pieces(scene: &SceneDescription, shape: &Shape) -> u64 {
    match &shape.kind {
        ShapeKind::Mesh(id) => match &scene.meshes[id.index()] {
            MeshSource::Inline(mesh) => mesh.indices.len() as u64,
            _ => 2,
        },
        ShapeKind::Patches(id) => scene.patch_meshes[id.index()].indices.len() as u64,
        _ => 1,
    }
}

/// What a texture is, with the first file below it.
fn named(scene: &SceneDescription, id: TextureId) -> String {
    let node = &scene.textures[id.index()];
    if let Texture::Image { image, .. } = node {
        return format!("image {}", scene.images[image.index()].path.display());
    }
    let below = node.parts().into_iter().flatten().map(|part| named_image(scene, part, 0));
    match below.flatten().next() {
        Some(image) => image,
        None => "a texture without a file".to_owned(),
    }
}

/// Deep enough for any that a person wrote; expressions share parts, so that all of them may be too many.
const DEEPEST: u32 = 16;

fn named_image(scene: &SceneDescription, id: TextureId, depth: u32) -> Option<String> {
    let node = &scene.textures[id.index()];
    if let Texture::Image { image, .. } = node {
        return Some(format!("image {}", scene.images[image.index()].path.display()));
    }
    let first = node.parts().into_iter().flatten().next().filter(|_| depth < DEEPEST)?;
    named_image(scene, first, depth + 1)
}

/// What a material asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Kinds {
    /// The first that varies.
    texture: Option<TextureId>,
    /// The first that filters over a footprint.
    filtered: Option<TextureId>,
    transmits: bool,
    rough: bool,
    coated: bool,
    /// Rays may pass it.
    passes: bool,
}

struct Materials {
    known: Vec<KnownTexture>,
    kinds: Vec<Kinds>,
}

impl Materials {
    fn new(scene: &SceneDescription) -> Self {
        let mut all = Self { known: known_textures(&scene.textures), kinds: Vec::new() };
        all.kinds = scene.materials.iter().map(|m| all.own(m)).collect();
        // Passed along until nothing changes, since mixes of mixes may share sides.
        loop {
            let before = all.kinds.clone();
            for (i, material) in scene.materials.iter().enumerate() {
                if let Material::Mix { a, b, .. } = material {
                    all.kinds[i] = all.kinds[i].with(all.at(*a)).with(all.at(*b));
                }
            }
            if all.kinds == before {
                return all;
            }
        }
    }

    fn at(&self, id: MaterialId) -> Kinds {
        self.kinds[id.index()]
    }

    fn own(&self, material: &Material) -> Kinds {
        let textures = material.textures();
        let first = |wanted: &dyn Fn(&KnownTexture) -> bool| {
            textures.iter().copied().find(|t| wanted(&self.known[t.index()]))
        };
        let roughness = match material {
            Material::CoatedDiffuse { roughness, .. }
            | Material::Conductor { roughness, .. }
            | Material::ConductorReflectance { roughness, .. }
            | Material::Dielectric { roughness, .. } => Some(roughness),
            _ => None,
        };
        Kinds {
            texture: first(&|known| known.constant.is_none()),
            filtered: first(&|known| known.wants_footprint),
            transmits: matches!(
                material,
                Material::Dielectric { .. }
                    | Material::ThinDielectric { .. }
                    | Material::DiffuseTransmission { .. }
            ),
            rough: roughness.is_some_and(|r| self.is_rough(r)),
            coated: matches!(material, Material::CoatedDiffuse { .. }),
            passes: matches!(material, Material::Interface),
        }
    }

    /// As the distribution of facets has it.
    fn is_rough(&self, roughness: &Roughness) -> bool {
        [roughness.u, roughness.v].iter().any(|t| match self.known[t.index()].constant {
            None => true,
            Some(value) => {
                let value = value.x.max(0.0);
                let alpha = if roughness.remap { value.sqrt() } else { value };
                alpha >= Roughness::SMOOTH_BELOW
            }
        })
    }
}

impl Kinds {
    fn with(self, other: Self) -> Self {
        Self {
            texture: self.texture.or(other.texture),
            filtered: self.filtered.or(other.filtered),
            transmits: self.transmits || other.transmits,
            rough: self.rough || other.rough,
            coated: self.coated || other.coated,
            passes: self.passes || other.passes,
        }
    }
}
