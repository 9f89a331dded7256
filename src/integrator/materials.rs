//! Materials made ready: what is constant is evaluated once per render, so that a hit on a plain
//! material copies a finished scattering function. Textures are read only where one is.

use crate::color::Rgb;
use crate::geometry::Needs;
use crate::integrator::bsdf::{
    Bsdf, CoatedTables, Conductor, Dielectric, Diffuse, DiffuseTransmission, Ggx, ThinDielectric,
    roughness_to_alpha,
};
use crate::integrator::kernel::Kernel;
use crate::integrator::sampler::mix;
use crate::prepare::Calls;
use crate::scene::{Material, Roughness, SceneDescription, TextureId};
use crate::texture::{TextureCoordinates, Textures};

/// Tables of coated materials, by material; they outlive the [`Materials`] that borrow them.
pub struct MaterialTables(Vec<Option<CoatedTables>>);

impl MaterialTables {
    /// Builds what the scene's coated materials need.
    #[must_use]
    pub fn new(scene: &SceneDescription, textures: &Textures) -> Self {
        use rayon::prelude::*;
        let table = |m: &Material| {
            let Material::CoatedDiffuse { roughness, thickness, eta, max_depth, .. } = m else { return None };
            Some(match constant_alpha(roughness, textures) {
                Some((x, y)) => CoatedTables::constant(*eta, x, y, *thickness, *max_depth),
                None => CoatedTables::textured(*eta, *thickness, *max_depth),
            })
        };
        Self(scene.materials.par_iter().map(table).collect())
    }
}

enum Compiled<'a> {
    /// The commonest material, its reflectance constant.
    Diffuse(Diffuse),
    /// All parameters are constant. Boxed, so that telling a plain material costs one comparison.
    Ready(Box<Bsdf<'a>>),
    /// The commonest textured material.
    TexturedDiffuse(TextureId),
    /// Whatever else has textures.
    Textured(&'a Material, Option<&'a CoatedTables>),
    Mix {
        a: u32,
        b: u32,
        amount: TextureId,
    },
    Interface,
}

/// What a material does with light at a point.
pub enum Scattering<'a> {
    /// Lambertian reflection, worth a way of its own through shading.
    Diffuse(Diffuse),
    /// Any other scattering function.
    Other(Bsdf<'a>),
    /// Nothing: an interface.
    Passes,
}

impl<'a> From<Option<Bsdf<'a>>> for Scattering<'a> {
    #[inline(always)]
    fn from(bsdf: Option<Bsdf<'a>>) -> Self {
        match bsdf {
            Some(Bsdf::Diffuse(d)) => Self::Diffuse(d),
            Some(other) => Self::Other(other),
            None => Self::Passes,
        }
    }
}

/// The materials of a scene by id.
pub struct Materials<'a> {
    compiled: Vec<Compiled<'a>>,
    needs: Vec<Needs>,
    may_pass: Vec<bool>,
    textures: &'a Textures,
}

impl<'a> Materials<'a> {
    /// The textures that materials read.
    #[inline(always)]
    #[must_use]
    pub fn textures(&self) -> &'a Textures {
        self.textures
    }

    /// Evaluates what is constant.
    #[must_use]
    pub fn new(scene: &'a SceneDescription, textures: &'a Textures, tables: &'a MaterialTables) -> Self {
        let compile = |(i, m): (usize, &'a Material)| compile(m, textures, tables.0[i].as_ref());
        let compiled = scene.materials.iter().enumerate().map(compile).collect();
        let needs = needs(scene, textures);
        let may_pass = may_pass(scene);
        Self { compiled, needs, may_pass, textures }
    }

    /// Attributes of a surface that `material` reads. Where rays may pass it, no footprint: shadow
    /// rays have none, and must decide as paths do.
    #[must_use]
    pub fn needs(&self, material: u32) -> Needs {
        let needs = self.needs[material as usize];
        if self.may_pass(material) { needs.without(Needs::FOOTPRINT) } else { needs }
    }

    /// Whether rays may pass `material` without scattering.
    #[must_use]
    pub fn may_pass(&self, material: u32) -> bool {
        self.may_pass[material as usize]
    }

    /// What `material` asks of a kernel. Of a mix both parts may come, whatever they are.
    #[must_use]
    pub fn calls(&self, material: u32) -> Calls {
        let all = Calls::TEXTURES.and(Calls::LOBES).and(Calls::TRANSMISSION);
        let calls = match &self.compiled[material as usize] {
            Compiled::Diffuse(_) => Calls::NONE,
            Compiled::Ready(bsdf) => Calls::LOBES.and_if(may_transmit(bsdf), Calls::TRANSMISSION),
            Compiled::TexturedDiffuse(_) => Calls::TEXTURES,
            Compiled::Textured(..) | Compiled::Mix { .. } => all,
            Compiled::Interface => Calls::MEDIA,
        };
        calls
            .and_if(self.may_pass(material), Calls::MEDIA)
            .and_if(self.needs(material).has(Needs::FOOTPRINT), Calls::FOOTPRINTS)
    }

    /// The scattering function at a point. `key` decides between mixed materials and is the same for
    /// whoever asks about one path vertex. Both are asked for only where the material needs them.
    #[inline(always)]
    #[must_use]
    pub fn scattering<K: Kernel>(
        &self,
        material: u32,
        at: impl FnOnce() -> TextureCoordinates,
        key: impl FnOnce() -> u32,
    ) -> Scattering<'a> {
        let compiled = &self.compiled[material as usize];
        match compiled {
            Compiled::Diffuse(d) => return Scattering::Diffuse(*d),
            Compiled::Ready(b) if K::LOBES => return Scattering::Other(**b),
            Compiled::Interface if K::MEDIA => return Scattering::Passes,
            _ if !K::TEXTURES => unreachable!("the kernel has what materials call for"),
            _ => {}
        }
        // Asked for in one place: `at` is compiled into it.
        let at = at();
        if let Compiled::TexturedDiffuse(t) = compiled {
            return Scattering::Diffuse(Diffuse::new(albedo(self.textures.eval_here(*t, &at))));
        }
        // A copy: what is lent to a call must lie in memory, and the commoner `at` need not.
        let copy = TextureCoordinates { ..at };
        self.uncommon(compiled, &copy, key()).into()
    }

    #[inline(never)]
    fn uncommon(&self, compiled: &Compiled<'a>, at: &TextureCoordinates, key: u32) -> Option<Bsdf<'a>> {
        match compiled {
            Compiled::Diffuse(d) => Some(Bsdf::Diffuse(*d)),
            Compiled::Ready(b) => Some(**b),
            Compiled::TexturedDiffuse(t) => {
                Some(Bsdf::Diffuse(Diffuse::new(albedo(self.textures.eval(*t, at)))))
            }
            Compiled::Textured(m, tables) => {
                Some(evaluate(m, *tables, &|t| self.textures.eval(t, at)).expect("mixes are compiled apart"))
            }
            Compiled::Mix { a, b, amount } => {
                let amount = self.textures.eval(*amount, at).x;
                let h = at.p.to_array().iter().fold(key, |h, c| mix(h ^ c.to_bits()));
                let draw = (h >> 8) as f32 * (1.0 / (1 << 24) as f32);
                let chosen = if amount > 0.0 && draw < amount { *b } else { *a };
                self.uncommon(&self.compiled[chosen as usize], at, mix(h))
            }
            Compiled::Interface => None,
        }
    }
}

fn may_transmit(bsdf: &Bsdf<'_>) -> bool {
    matches!(bsdf, Bsdf::Dielectric(_) | Bsdf::ThinDielectric(_) | Bsdf::DiffuseTransmission(_))
}

/// A reflectance a surface can have.
#[inline(always)]
fn albedo(c: Rgb) -> Rgb {
    c.clamp(Rgb::ZERO, Rgb::ONE)
}

fn alpha(roughness: &Roughness, value: impl Fn(TextureId) -> Rgb) -> (f32, f32) {
    let one = |t: TextureId| {
        let r = value(t).x.max(0.0);
        if roughness.remap { roughness_to_alpha(r) } else { r }
    };
    (one(roughness.u), one(roughness.v))
}

fn constant_alpha(roughness: &Roughness, textures: &Textures) -> Option<(f32, f32)> {
    let (u, v) = (textures.constant(roughness.u)?, textures.constant(roughness.v)?);
    Some(alpha(roughness, |t| if t == roughness.u { u } else { v }))
}

fn is_anisotropic(m: &Material) -> bool {
    match m {
        Material::CoatedDiffuse { roughness, .. }
        | Material::ConductorReflectance { roughness, .. }
        | Material::Conductor { roughness, .. }
        | Material::Dielectric { roughness, .. } => roughness.u != roughness.v,
        _ => false,
    }
}

fn compile<'a>(m: &'a Material, textures: &'a Textures, tables: Option<&'a CoatedTables>) -> Compiled<'a> {
    if let Material::Mix { a, b, amount } = m {
        return Compiled::Mix { a: a.0, b: b.0, amount: *amount };
    }
    if m.textures().iter().all(|t| textures.constant(*t).is_some()) {
        let value = |t: TextureId| textures.constant(t).expect("all textures of this material are constant");
        return match evaluate(m, tables, &value).into() {
            Scattering::Diffuse(d) => Compiled::Diffuse(d),
            Scattering::Other(b) => Compiled::Ready(Box::new(b)),
            Scattering::Passes => Compiled::Interface,
        };
    }
    match m {
        Material::Diffuse { reflectance } => Compiled::TexturedDiffuse(*reflectance),
        _ => Compiled::Textured(m, tables),
    }
}

/// The scattering function for given texture values; `None` for an interface or a mix.
fn evaluate<'a>(
    m: &Material,
    tables: Option<&'a CoatedTables>,
    value: &dyn Fn(TextureId) -> Rgb,
) -> Option<Bsdf<'a>> {
    let ggx = |r: &Roughness| {
        let (x, y) = alpha(r, value);
        Ggx::new(x, y)
    };
    Some(match m {
        Material::Diffuse { reflectance } => Bsdf::Diffuse(Diffuse::new(albedo(value(*reflectance)))),
        Material::CoatedDiffuse { reflectance, roughness, .. } => {
            let (x, y) = alpha(roughness, value);
            let tables = tables.expect("coated materials have tables");
            Bsdf::CoatedDiffuse(tables.bsdf(albedo(value(*reflectance)), x, y))
        }
        Material::Conductor { eta, k, roughness } => {
            Bsdf::Conductor(Conductor::new(value(*eta), value(*k), ggx(roughness)))
        }
        Material::ConductorReflectance { reflectance, roughness } => {
            Bsdf::Conductor(Conductor::from_reflectance(albedo(value(*reflectance)), ggx(roughness)))
        }
        Material::Dielectric { eta, roughness } => Bsdf::Dielectric(Dielectric::new(*eta, ggx(roughness))),
        Material::ThinDielectric { eta } => Bsdf::ThinDielectric(ThinDielectric::new(*eta)),
        Material::DiffuseTransmission { reflectance, transmittance, scale } => {
            let one = |t: TextureId| albedo(value(t) * *scale);
            Bsdf::DiffuseTransmission(DiffuseTransmission::new(one(*reflectance), one(*transmittance)))
        }
        Material::Mix { .. } | Material::Interface => return None,
    })
}

/// What each material reads, mixed ones included: what a mix needs follows from both of its sides,
/// passed along until nothing changes, since mixes of mixes may share sides.
fn needs(scene: &SceneDescription, textures: &Textures) -> Vec<Needs> {
    let own = |m: &Material| {
        let mut needs = Needs::default();
        for t in m.textures() {
            if textures.constant(t).is_none() {
                needs = needs.and(Needs::UV);
            }
            if textures.wants_footprint(t) {
                needs = needs.and(Needs::FOOTPRINT);
            }
        }
        if is_anisotropic(m) {
            needs = needs.and(Needs::TANGENT);
        }
        needs
    };
    let mut all: Vec<Needs> = scene.materials.iter().map(own).collect();
    loop {
        let mut changed = false;
        for (i, m) in scene.materials.iter().enumerate() {
            if let Material::Mix { a, b, .. } = m {
                let needs = all[i].and(all[a.index()]).and(all[b.index()]);
                changed |= needs != all[i];
                all[i] = needs;
            }
        }
        if !changed {
            return all;
        }
    }
}

/// Which materials are interfaces or have one among their parts.
fn may_pass(scene: &SceneDescription) -> Vec<bool> {
    let mut all: Vec<bool> = scene.materials.iter().map(|m| *m == Material::Interface).collect();
    loop {
        let before = all.clone();
        for (i, m) in scene.materials.iter().enumerate() {
            if let Material::Mix { a, b, .. } = m {
                all[i] |= all[a.index()] || all[b.index()];
            }
        }
        if all == before {
            return all;
        }
    }
}
