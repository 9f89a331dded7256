//! The end of a scene: names become ids. Materials, textures, media and objects may stand anywhere
//! in the world, so nothing is resolved before. Never reads text.

use super::lexer::shown;
use super::materials::MaterialTable;
use super::reader::Reader;
use super::shapes::ShapeRefs;
use super::state::MaterialRef;
use super::suggest::nearest;
use crate::error::{Error, Location, Result};
use crate::scene::{
    Instance, Material, MaterialId, MediumId, MediumInterface, MeshSource, ObjectId, SceneDescription, Shape,
    ShapeKind, Texture,
};
use std::collections::HashMap;
use std::rc::Rc;

impl Reader {
    pub(super) fn finish(mut self) -> Result<SceneDescription> {
        self.build_textures()?;
        let materials = self.build_materials()?;
        let refs = std::mem::take(&mut self.shape_refs);
        let mut shapes = std::mem::take(&mut self.scene.shapes);
        for (shape, refs) in shapes.iter_mut().zip(refs) {
            self.resolve(shape, &refs, &materials)?;
        }
        self.scene.shapes = shapes;
        let object_refs = std::mem::take(&mut self.object_refs);
        let mut objects = std::mem::take(&mut self.scene.objects);
        for (shapes, refs) in objects.iter_mut().zip(object_refs) {
            for (shape, refs) in shapes.iter_mut().zip(refs) {
                self.resolve(shape, &refs, &materials)?;
            }
        }
        self.scene.objects = objects;
        for place in std::mem::take(&mut self.uses) {
            let object = self.object(&place.name, &place.at)?;
            // An empty object is legal and shows nothing.
            if !self.scene.objects[object.index()].is_empty() {
                let instance_to_world = *place.instance_to_world;
                self.scene.instances.push(Instance { object, instance_to_world, at: place.at });
            }
        }
        if let Some(camera) = self.camera.take() {
            self.scene.camera_medium = self.medium_named(&camera.medium, &camera.item.params.at)?;
        }
        self.scene.warnings = self.warnings.finish();
        Ok(self.scene)
    }

    fn resolve(&mut self, shape: &mut Shape, refs: &ShapeRefs, table: &MaterialTable) -> Result<()> {
        shape.material = material_of(&refs.material, table, &shape.at)?;
        if let Some(p) = &refs.alpha
            && let Some(id) = self.float_texture_opt(p, "alpha")?
            // Fully opaque costs nothing.
            && !matches!(self.scene.textures[id.index()], Texture::Constant(v) if v.x >= 1.0)
        {
            shape.alpha = Some(id);
        }
        if let (Some(p), ShapeKind::Mesh(id)) = (&refs.displacement, &shape.kind)
            && let Some(found) = self.float_texture_opt(p, "displacement")?
            && let MeshSource::Displaced { texture, .. } = &mut self.scene.meshes[id.index()]
        {
            *texture = found;
        }
        if shape.area_light.is_some() && self.scene.materials[shape.material.index()] == Material::Interface {
            let what = "a shape of interface material does not emit (in pbrt-v4 neither); it is dark";
            self.warnings.add(&shape.at, what);
            shape.area_light = None;
        }
        if refs.inside != refs.outside {
            shape.medium = Some(MediumInterface {
                inside: self.medium_named(&refs.inside, &shape.at)?,
                outside: self.medium_named(&refs.outside, &shape.at)?,
            });
        }
        Ok(())
    }

    fn medium_named(&self, name: &Rc<str>, at: &Location) -> Result<Option<MediumId>> {
        if name.is_empty() {
            return Ok(None);
        }
        let found = self.media.get(name).copied();
        found.ok_or_else(|| undefined("medium", name, &self.media, "MakeNamedMedium", at))
    }

    fn object(&self, name: &Rc<str>, at: &Location) -> Result<ObjectId> {
        let found = self.objects.get(name).copied();
        found.ok_or_else(|| undefined("object", name, &self.objects, "ObjectBegin", at))
    }
}

fn material_of(wanted: &MaterialRef, table: &MaterialTable, at: &Location) -> Result<MaterialId> {
    match wanted {
        MaterialRef::Unnamed(i) => Ok(table.unnamed[*i as usize]),
        MaterialRef::Named(name) => {
            let found = table.named.get(name).copied();
            found.ok_or_else(|| undefined("material", name, &table.named, "MakeNamedMaterial", at))
        }
    }
}

fn undefined<T>(
    what: &str,
    name: &str,
    known: &HashMap<Rc<str>, T>,
    directive: &str,
    at: &Location,
) -> Error {
    let mut names: Vec<&str> = known.keys().map(|k| &**k).collect();
    // A fixed order, so that the message does not change from run to run.
    names.sort_unstable();
    let hint = match nearest(name, &names) {
        Some(near) => format!("did you mean \"{near}\"?"),
        None => format!("define it with {directive}"),
    };
    Error::at(at, format!("no {what} \"{}\"; {hint}", shown(name.as_bytes())))
}
