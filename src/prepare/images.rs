//! Which images are seen, and which are needed whole, by following references from what is visible.
//!
//! Never loads one, never decides a sampling.

use crate::scene::{
    ImageId, Material, MaterialId, MeshSource, SceneDescription, ShapeKind, Texture, TextureId,
};

/// What the plan found out about an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImageNeeds {
    /// A texture looks at coarser levels, as every filter does.
    pub mip_levels: bool,
    /// Something reads all of it at once, so that it cannot be had tile by tile.
    pub whole: bool,
    /// Some texture or light looks at it at all; else it is not even opened.
    pub used: bool,
}

/// For each image: whether anything visible reads it, and whether it is a texture's, which reads all
/// levels.
#[must_use]
pub fn image_needs(scene: &SceneDescription) -> Vec<ImageNeeds> {
    let mut walk = Walk {
        scene,
        needs: vec![ImageNeeds::default(); scene.images.len()],
        textures: vec![false; scene.textures.len()],
        materials: vec![false; scene.materials.len()],
    };
    for shape in super::all_shapes(scene) {
        walk.material(shape.material);
        if let Some(alpha) = shape.alpha {
            walk.texture(alpha);
        }
        if let ShapeKind::Mesh(id) = shape.kind
            && let MeshSource::Displaced { texture, .. } = scene.meshes[id.index()]
        {
            walk.texture(texture);
        }
        if let Some(light) = shape.area_light
            && let Some(image) = scene.area_lights[light.index()].image
        {
            // Its mean is needed before the first ray, and both ways of sampling must see one value.
            walk.image(image, false);
            walk.needs[image.index()].whole = true;
        }
    }
    // Environment images are not here: their lights read them whole, once.
    walk.needs
}

struct Walk<'a> {
    scene: &'a SceneDescription,
    needs: Vec<ImageNeeds>,
    textures: Vec<bool>,
    materials: Vec<bool>,
}

impl Walk<'_> {
    fn image(&mut self, id: ImageId, mip_levels: bool) {
        let n = &mut self.needs[id.index()];
        n.used = true;
        n.mip_levels |= mip_levels;
    }

    fn texture(&mut self, id: TextureId) {
        if std::mem::replace(&mut self.textures[id.index()], true) {
            return;
        }
        let texture = &self.scene.textures[id.index()];
        if let Texture::Image { image, .. } = texture {
            self.image(*image, true);
        }
        for part in texture.parts().into_iter().flatten() {
            self.texture(part);
        }
    }

    fn material(&mut self, id: MaterialId) {
        if std::mem::replace(&mut self.materials[id.index()], true) {
            return;
        }
        let material = &self.scene.materials[id.index()];
        for texture in material.textures() {
            self.texture(texture);
        }
        if let Material::Mix { a, b, .. } = material {
            self.material(*a);
            self.material(*b);
        }
    }
}
