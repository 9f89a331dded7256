//! What `AttributeBegin` saves and `AttributeEnd` restores. Small, because a file may nest deeply:
//! large parts are shared. Never builds anything.

use super::params::{Attributes, ColorSpace};
use crate::error::Location;
use crate::math::Transform;
use crate::scene::AreaLightId;
use std::rc::Rc;

/// Levels of `AttributeBegin` and `ObjectBegin` inside one another. A level costs some 150 bytes and,
/// where it changes the transform, 256 more: 27 MB in all.
pub(super) const MAX_NESTING: usize = 1 << 16;

/// Which material shapes get.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum MaterialRef {
    /// The n-th `Material` directive; 0 is pbrt's default, diffuse .5.
    Unnamed(u32),
    /// `NamedMaterial`, resolved at the end of the scene.
    Named(Rc<str>),
}

/// The graphics state.
#[derive(Clone, Debug)]
pub(super) struct State {
    /// Current transform at the start of the shutter interval.
    pub(super) ctm: Rc<Transform>,
    /// Whether transform directives reach the start of the interval (`ActiveTransform`).
    pub(super) start_active: bool,
    pub(super) reverse_orientation: bool,
    pub(super) space: ColorSpace,
    pub(super) material: MaterialRef,
    pub(super) area_light: Option<AreaLightId>,
    /// Empty is vacuum.
    pub(super) inside: Rc<str>,
    /// Empty is vacuum.
    pub(super) outside: Rc<str>,
    /// Parameters from `Attribute`, by [`Target`].
    pub(super) attributes: [Attributes; 5],
}

impl Default for State {
    fn default() -> Self {
        Self {
            ctm: Rc::new(Transform::IDENTITY),
            start_active: true,
            reverse_orientation: false,
            space: ColorSpace::Srgb,
            material: MaterialRef::Unnamed(0),
            area_light: None,
            inside: Rc::from(""),
            outside: Rc::from(""),
            attributes: Default::default(),
        }
    }
}

/// What `Attribute` parameters apply to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Target {
    Shape,
    Light,
    Material,
    Medium,
    Texture,
}

pub(super) const TARGETS: [(&str, Target); 5] = [
    ("shape", Target::Shape),
    ("light", Target::Light),
    ("material", Target::Material),
    ("medium", Target::Medium),
    ("texture", Target::Texture),
];

/// Why a state was saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Block {
    Attribute,
    Object,
}

/// A saved state, and the place of the directive that saved it.
#[derive(Debug)]
pub(super) struct Saved {
    pub(super) state: State,
    pub(super) block: Block,
    pub(super) at: Location,
}
