//! The directives: reads them in order, keeps the graphics state, and hands each item to its
//! builder. Materials, textures, media and objects may be named before they are defined, as in
//! pbrt, so references are resolved when the last file ends (`finish.rs`).
//! Never recurses for nesting inside a file; `Include` and `Import` recurse up to [`MAX_INCLUDE_DEPTH`].

use super::lexer::{Kind, Lexer, Token, shown};
use super::params::Params;
use super::shapes::ShapeRefs;
use super::source::Source;
use super::state::{Block, MaterialRef, Saved, State, Target};
use super::suggest::known_names;
use super::textures::Textures;
use super::warnings::{Files, Warnings};
use crate::error::{Error, Location, Result};
use crate::math::Transform;
use crate::scene::{MediumId, ObjectId, SceneDescription};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Files that include one another.
pub(super) const MAX_INCLUDE_DEPTH: usize = 64;
/// `Include` and `Import` directives that one scene may carry out in all.
pub(super) const MAX_INCLUDES: usize = 100_000;

const DIRECTIVES: [&str; 40] = [
    "Accelerator",
    "ActiveTransform",
    "AreaLightSource",
    "Attribute",
    "AttributeBegin",
    "AttributeEnd",
    "Camera",
    "ColorSpace",
    "ConcatTransform",
    "CoordSysTransform",
    "CoordinateSystem",
    "Film",
    "Identity",
    "Import",
    "Include",
    "Integrator",
    "LightSource",
    "LookAt",
    "MakeNamedMaterial",
    "MakeNamedMedium",
    "Material",
    "MediumInterface",
    "NamedMaterial",
    "ObjectBegin",
    "ObjectEnd",
    "ObjectInstance",
    "Option",
    "PixelFilter",
    "ReverseOrientation",
    "Rotate",
    "Sampler",
    "Scale",
    "Shape",
    "Texture",
    "Transform",
    "TransformBegin",
    "TransformEnd",
    "TransformTimes",
    "Translate",
    "WorldBegin",
];

const OPTIONS_ONLY: [&str; 8] =
    ["Camera", "Film", "Sampler", "Integrator", "PixelFilter", "Accelerator", "TransformTimes", "WorldBegin"];

const WORLD_ONLY: [&str; 17] = [
    "AttributeBegin",
    "AttributeEnd",
    "TransformBegin",
    "TransformEnd",
    "ReverseOrientation",
    "LightSource",
    "AreaLightSource",
    "Shape",
    "ObjectBegin",
    "ObjectEnd",
    "ObjectInstance",
    "Texture",
    "Material",
    "MakeNamedMaterial",
    "NamedMaterial",
    "Import",
    "Attribute",
];

/// A directive's `"name"` and parameters.
pub(super) struct Item {
    pub(super) name: Box<str>,
    pub(super) params: Params,
}

impl Item {
    /// An error at the directive: the name is unknown; the known ones.
    pub(super) fn unknown(&self, what: &str, plural: &str, names: &[&str]) -> Error {
        let hint = known_names(&self.name, plural, names);
        Error::at(&self.params.at, format!("unknown {what} \"{}\"{hint}", shown(self.name.as_bytes())))
    }
}

/// An object placed, before objects are resolved.
pub(super) struct ObjectUse {
    pub(super) name: Rc<str>,
    pub(super) instance_to_world: Rc<Transform>,
    pub(super) at: Location,
}

/// The camera's state at its directive.
pub(super) struct PendingCamera {
    pub(super) item: Item,
    pub(super) world_to_camera: Rc<Transform>,
    pub(super) medium: Rc<str>,
}

/// Everything read so far.
pub(super) struct Reader {
    pub(super) scene: SceneDescription,
    pub(super) warnings: Warnings,
    pub(super) files: Files,
    pub(super) state: State,
    pub(super) stack: Vec<Saved>,
    /// Saved states below this belong to the file that imports this one.
    pub(super) stack_base: usize,
    world: bool,
    pub(super) systems: HashMap<Rc<str>, Rc<Transform>>,
    pub(super) camera: Option<PendingCamera>,
    pub(super) film: Option<Item>,
    pub(super) filter: Option<Item>,
    pub(super) sampler: Option<Item>,
    pub(super) integrator: Option<Item>,
    pub(super) textures: Textures,
    /// `Material` directives, after pbrt's default.
    pub(super) materials: Vec<Item>,
    pub(super) named_materials: Vec<(Rc<str>, Params)>,
    /// How deep each material of the scene mixes.
    pub(super) mix_depths: Vec<u32>,
    material_names: HashSet<Rc<str>>,
    /// `None` where vacuum stands in.
    pub(super) media: HashMap<Rc<str>, Option<MediumId>>,
    pub(super) objects: HashMap<Rc<str>, ObjectId>,
    pub(super) open_object: Option<ObjectId>,
    pub(super) uses: Vec<ObjectUse>,
    /// Parallel to the shapes of the world, then to those of each object.
    pub(super) shape_refs: Vec<ShapeRefs>,
    pub(super) object_refs: Vec<Vec<ShapeRefs>>,
    /// Files being read, outermost first; the scene itself is not among them.
    pub(super) open_files: Vec<PathBuf>,
    pub(super) includes: usize,
    pub(super) said_motion: bool,
    /// Factor on `displacement.edgelength`.
    pub(super) edge_scale: f32,
}

impl Reader {
    pub(super) fn new(path: &Path) -> Self {
        Self {
            scene: SceneDescription { path: path.to_path_buf(), spp: 16, ..SceneDescription::default() },
            warnings: Warnings::default(),
            files: Files::new(path),
            state: State::default(),
            stack: Vec::new(),
            stack_base: 0,
            world: false,
            systems: HashMap::new(),
            camera: None,
            film: None,
            filter: None,
            sampler: None,
            integrator: None,
            textures: Textures::default(),
            materials: Vec::new(),
            named_materials: Vec::new(),
            mix_depths: Vec::new(),
            material_names: HashSet::new(),
            media: HashMap::new(),
            objects: HashMap::new(),
            open_object: None,
            uses: Vec::new(),
            shape_refs: Vec::new(),
            object_refs: Vec::new(),
            open_files: Vec::new(),
            includes: 0,
            said_motion: false,
            edge_scale: 1.0,
        }
    }

    /// Reads a whole scene.
    pub(super) fn read(mut self, source: &Source) -> Result<SceneDescription> {
        self.open_files.extend(std::fs::canonicalize(&source.path));
        let lx = self.read_file(source)?;
        if !self.world {
            let end = lx.location(source.data.len());
            return Err(Error::at(&end, "the file ends before the world; add WorldBegin and what it holds"));
        }
        self.check_closed(0)?;
        self.finish()
    }

    pub(super) fn read_file<'a>(&mut self, source: &'a Source) -> Result<Lexer<'a>> {
        let mut lx = Lexer::new(source);
        while let Some(token) = lx.next()? {
            if token.kind != Kind::Word {
                let what = format!("found {} where a directive should be", shown(token.bytes));
                return Err(lx.error(token.start, what));
            }
            self.directive(&mut lx, &token)?;
        }
        Ok(lx)
    }

    fn directive(&mut self, lx: &mut Lexer<'_>, token: &Token<'_>) -> Result<()> {
        let word = std::str::from_utf8(token.bytes).unwrap_or("");
        if self.world && OPTIONS_ONLY.contains(&word) {
            return Err(lx.error(token.start, format!("{word} inside the world; move it before WorldBegin")));
        }
        if !self.world && WORLD_ONLY.contains(&word) {
            return Err(lx.error(token.start, format!("{word} before the world; move it after WorldBegin")));
        }
        match word {
            "Shape" => {
                let item = self.item(lx, token, Some(Target::Shape))?;
                self.shape(item)?;
            }
            "AttributeBegin" | "TransformBegin" => self.save(lx, token, Block::Attribute)?,
            "AttributeEnd" | "TransformEnd" => self.restore(lx, token, Block::Attribute)?,
            "Attribute" => self.attribute(lx, token)?,
            "Translate" | "Scale" | "Rotate" | "LookAt" | "Transform" | "ConcatTransform" | "Identity" => {
                self.transform(lx, token, word)?;
            }
            "ActiveTransform" => self.active_transform(lx, token)?,
            "TransformTimes" => {
                lx.number("the start time")?;
                lx.number("the end time")?;
            }
            "CoordinateSystem" => {
                let name = lx.require_string("a name")?;
                self.systems.insert(Rc::from(&*name), self.state.ctm.clone());
            }
            "CoordSysTransform" => {
                let name = lx.require_string("a name")?;
                let Some(ctm) = self.systems.get(&*name) else {
                    let what = format!(
                        "no coordinate system \"{}\"; define it with CoordinateSystem",
                        shown(name.as_bytes())
                    );
                    return Err(lx.error(token.start, what));
                };
                self.state.ctm = ctm.clone();
            }
            "ColorSpace" => self.color_space(lx)?,
            "ReverseOrientation" => self.state.reverse_orientation = !self.state.reverse_orientation,
            "Material" => {
                let item = self.item(lx, token, Some(Target::Material))?;
                self.materials.push(item);
                // The first is pbrt's default.
                self.state.material = MaterialRef::Unnamed(index(self.materials.len())?);
            }
            "NamedMaterial" => {
                self.state.material = MaterialRef::Named(Rc::from(&*lx.require_string("a name")?))
            }
            "MakeNamedMaterial" => {
                let item = self.item(lx, token, Some(Target::Material))?;
                let name: Rc<str> = Rc::from(item.name);
                if !self.material_names.insert(name.clone()) {
                    let what = format!(
                        "material \"{}\" is already defined; choose another name",
                        shown(name.as_bytes())
                    );
                    return Err(lx.error(token.start, what));
                }
                self.named_materials.push((name, item.params));
            }
            "Texture" => self.texture(lx, token)?,
            "LightSource" => {
                let item = self.item(lx, token, Some(Target::Light))?;
                self.light(&item)?;
            }
            "AreaLightSource" => {
                let item = self.item(lx, token, Some(Target::Light))?;
                self.state.area_light = self.area_light(&item)?;
            }
            "MediumInterface" => {
                let inside = lx.require_string("the name of the inside medium")?;
                self.state.inside = Rc::from(&*inside);
                self.state.outside = if lx.peek() == Some(b'"') {
                    Rc::from(&*lx.require_string("the name of the outside medium")?)
                } else {
                    self.state.inside.clone()
                };
            }
            "MakeNamedMedium" => {
                let item = self.item(lx, token, Some(Target::Medium))?;
                self.medium(&item)?;
            }
            "ObjectBegin" => self.object_begin(lx, token)?,
            "ObjectEnd" => {
                if self.open_object.is_none() {
                    return Err(lx.error(token.start, "ObjectEnd without ObjectBegin; remove it"));
                }
                self.restore(lx, token, Block::Object)?;
                self.open_object = None;
            }
            "ObjectInstance" => {
                let name = Rc::from(&*lx.require_string("the name of an object")?);
                let at = lx.location(token.start);
                if self.open_object.is_some() {
                    return Err(Error::at(
                        &at,
                        "ObjectInstance inside an object; place instances after ObjectEnd",
                    ));
                }
                self.uses.push(ObjectUse { name, instance_to_world: self.state.ctm.clone(), at });
            }
            "Include" | "Import" => self.include(lx, token, word == "Import")?,
            "Camera" => {
                let item = self.item(lx, token, None)?;
                let ctm = self.state.ctm.clone();
                self.systems.insert(Rc::from("camera"), Rc::new(ctm.inverse()));
                let medium = self.state.outside.clone();
                self.camera = Some(PendingCamera { item, world_to_camera: ctm, medium });
            }
            "Film" => self.film = Some(self.item(lx, token, None)?),
            "PixelFilter" => self.filter = Some(self.item(lx, token, None)?),
            "Sampler" => self.sampler = Some(self.item(lx, token, None)?),
            "Integrator" => self.integrator = Some(self.item(lx, token, None)?),
            "Accelerator" => {
                let item = self.item(lx, token, None)?;
                Self::accelerator(&item)?;
            }
            "Option" => self.option(lx, token)?,
            "WorldBegin" => {
                self.world = true;
                self.state.ctm = Rc::new(Transform::IDENTITY);
                self.state.start_active = true;
                self.systems.insert(Rc::from("world"), self.state.ctm.clone());
                self.build_options()?;
            }
            _ => {
                let hint = match word {
                    "WorldEnd" => "; pbrt-v4 has none: remove it".to_owned(),
                    _ => known_names(&shown(token.bytes), "directives", &DIRECTIVES),
                };
                return Err(lx.error(token.start, format!("unknown directive {}{hint}", shown(token.bytes))));
            }
        }
        Ok(())
    }
}

/// A table's next index.
pub(super) fn index(length: usize) -> Result<u32> {
    u32::try_from(length)
        .map_err(|_| Error::Resource("the scene has more than 4 billion items of a kind".into()))
}
