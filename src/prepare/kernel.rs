//! What a scene asks of the code that runs paths, and which of a few kernels has it all. The kernels themselves are in
//! `integrator/kernel.rs`.
//!
//! Invariant: [`choose`] gives the smallest kernel that has everything that is called for; the last has everything.
//! Never guesses: whoever renders asks with what the scene has become, whoever plans with what its description says.

/// Parts of a kernel, as bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Calls(pub u16);

impl Calls {
    /// Nothing but Lambertian reflection of constant colour by triangles.
    pub const NONE: Self = Self(0);
    /// Textures of materials and lights, mixes.
    pub const TEXTURES: Self = Self(1);
    /// Cones of paths.
    pub const FOOTPRINTS: Self = Self(2);
    /// Light passes surfaces that scatter: squared ratios of indices.
    pub const TRANSMISSION: Self = Self(4);
    /// Any other scattering function than a Lambertian one.
    pub const LOBES: Self = Self(8);
    /// Media, and interfaces between them.
    pub const MEDIA: Self = Self(16);
    /// A lens with a width.
    pub const LENS: Self = Self(32);
    /// Objects that are placed.
    pub const INSTANCES: Self = Self(64);
    /// Surfaces that are no triangles in memory: quadrics, patches, pages.
    pub const SHAPES: Self = Self(128);
    /// More than one light to choose from, or an image.
    pub const LIGHTS: Self = Self(256);
    /// Everything.
    pub const ALL: Self = Self(511);

    /// What the bits are called that choose a kernel: all have every light.
    pub const NAMES: [(Self, &'static str); 8] = [
        (Self::TEXTURES, "textures"),
        (Self::FOOTPRINTS, "footprints"),
        (Self::TRANSMISSION, "transmission"),
        (Self::LOBES, "other lobes"),
        (Self::MEDIA, "media"),
        (Self::LENS, "lens"),
        (Self::INSTANCES, "instances"),
        (Self::SHAPES, "other shapes"),
    ];

    /// Whether all of `other` is in it.
    #[inline(always)]
    #[must_use]
    pub const fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Both.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Those that are not in `other`.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// `other`, if `asked`.
    #[must_use]
    pub fn and_if(self, asked: bool, other: Self) -> Self {
        if asked { self.and(other) } else { self }
    }

    /// What [`EFFECTS`](super::EFFECTS) `effect` asks of a kernel: nothing where Weir lacks it, nor of masks, which
    /// traversal asks for.
    #[must_use]
    pub fn of(effect: &str) -> Self {
        match effect {
            "textures" => Self::TEXTURES,
            "ray_differentials" => Self::FOOTPRINTS,
            "transmission" => Self::TRANSMISSION.and(Self::LOBES),
            "rough_lobes" | "layered_coats" => Self::LOBES,
            "media" => Self::MEDIA,
            "depth_of_field" => Self::LENS,
            "instances" => Self::INSTANCES,
            "image_lights" | "many_lights" => Self::LIGHTS,
            _ => Self::NONE,
        }
    }
}

/// What `names`, of effects or `all`, force a kernel to have.
#[must_use]
pub fn forced(names: &[String]) -> Calls {
    let one = |name: &String| if name == "all" { Calls::ALL } else { Calls::of(name) };
    names.iter().map(one).fold(Calls::NONE, Calls::and)
}

/// A kernel: code for paths that has some parts and lacks the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum KernelName {
    /// Lambertian triangles.
    Diffuse,
    /// All that is constant, of any shape, under any light.
    Solid,
    /// Textures too.
    Textured,
    /// Everything.
    #[default]
    General,
}

impl KernelName {
    /// From the smallest on.
    pub const ALL: [Self; 4] = [Self::Diffuse, Self::Solid, Self::Textured, Self::General];

    /// What it is called.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Diffuse => "diffuse",
            Self::Solid => "solid",
            Self::Textured => "textured",
            Self::General => "general",
        }
    }

    /// Its parts. Lights are chosen at run time by all.
    #[must_use]
    pub const fn has(self) -> Calls {
        let constant = Calls::ALL.without(Calls::TEXTURES).without(Calls::FOOTPRINTS).without(Calls::MEDIA);
        match self {
            Self::Diffuse => Calls::LIGHTS,
            Self::Solid => constant,
            Self::Textured => Calls::ALL.without(Calls::MEDIA),
            Self::General => Calls::ALL,
        }
    }
}

/// The smallest kernel that has all that is called for.
#[must_use]
pub fn kernel_for(calls: Calls) -> KernelName {
    KernelName::ALL.into_iter().find(|kernel| kernel.has().has(calls)).unwrap_or_default()
}

/// A description of `calls` in words.
#[must_use]
pub fn calls_named(calls: Calls) -> String {
    let names: Vec<&str> = Calls::NAMES.iter().filter(|(bit, _)| calls.has(*bit)).map(|(_, n)| *n).collect();
    if names.is_empty() { "nothing but plain diffuse triangles".to_owned() } else { names.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kernel_has_all_that_is_called_for_and_none_before_it_has() {
        for bits in 0..=Calls::ALL.0 {
            let calls = Calls(bits);
            let chosen = kernel_for(calls);
            assert!(chosen.has().has(calls), "{calls:?}: {chosen:?}");
            let before = KernelName::ALL.into_iter().take_while(|k| *k != chosen);
            assert!(before.into_iter().all(|k| !k.has().has(calls)), "{calls:?}: {chosen:?}");
        }
        // And larger ones lack nothing that smaller ones have.
        for pair in KernelName::ALL.windows(2) {
            assert!(pair[1].has().has(pair[0].has()) && pair[1].has() != pair[0].has());
        }
        assert_eq!(KernelName::General.has(), Calls::ALL);
    }

    #[test]
    fn names_force_what_they_name() {
        let of = |names: &[&str]| forced(&names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>());
        assert_eq!(of(&[]), Calls::NONE);
        assert_eq!(of(&["all"]), Calls::ALL);
        assert_eq!(of(&["textures", "media"]), Calls::TEXTURES.and(Calls::MEDIA));
    }
}
