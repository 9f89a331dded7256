//! The kernels: code for paths, compiled for what a scene calls for. What a kernel lacks costs no branch and no bytes.
//!
//! Invariant: a kernel does for what it has exactly what the general one does, in the same order, so that the picture
//! does not depend on which of them runs; a path carries a value if and only if its kernel may change it.
//! Never chooses: [`World::kernel`](super::path::World::kernel) says which one has all that a scene calls for.

use super::cone::Cone;
use crate::accel::NONE;
use crate::geometry::Kinds;
use crate::prepare::{Calls, KernelName};
use bytemuck::{Pod, Zeroable};
use std::fmt::Debug;

/// A value that a path carries in some kernels.
pub trait Part<T>: Copy + Debug + Pod + Send + Sync {
    /// Holds `value`, if it holds any.
    fn new(value: T) -> Self;
    /// What it holds, or what stands for it where nothing changes it.
    fn or(self, constant: T) -> T;
}

/// A value that is carried.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Zeroable, Pod)]
pub struct Kept<T>(T);

/// One that is not: no bytes.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Zeroable, Pod)]
pub struct Absent([u32; 0]);

impl<T: Copy + Debug + Pod + Send + Sync> Part<T> for Kept<T> {
    #[inline(always)]
    fn new(value: T) -> Self {
        Self(value)
    }

    #[inline(always)]
    fn or(self, _: T) -> T {
        self.0
    }
}

impl<T> Part<T> for Absent {
    #[inline(always)]
    fn new(_: T) -> Self {
        Self([])
    }

    #[inline(always)]
    fn or(self, constant: T) -> T {
        constant
    }
}

/// Parts that code for paths has.
pub trait Kernel: Debug + Pod + Send + Sync {
    /// Which one it is.
    const NAME: KernelName;
    /// Width of the path, for texture footprints.
    type Cone: Part<Cone>;
    /// Product of squared index ratios.
    type Ratio: Part<f32>;
    /// Medium around a ray.
    type Medium: Part<u32>;
    /// Distance to the last scattering event.
    type Travelled: Part<f32>;

    /// See [`Calls::TEXTURES`].
    const TEXTURES: bool = Self::NAME.has().has(Calls::TEXTURES);
    /// See [`Calls::FOOTPRINTS`].
    const FOOTPRINTS: bool = Self::NAME.has().has(Calls::FOOTPRINTS);
    /// See [`Calls::LOBES`].
    const LOBES: bool = Self::NAME.has().has(Calls::LOBES);
    /// See [`Calls::MEDIA`].
    const MEDIA: bool = Self::NAME.has().has(Calls::MEDIA);
    /// See [`Calls::LENS`].
    const LENS: bool = Self::NAME.has().has(Calls::LENS);
    /// What surfaces there may be.
    const KINDS: Kinds = Kinds {
        instances: Self::NAME.has().has(Calls::INSTANCES),
        others: Self::NAME.has().has(Calls::SHAPES),
        attributes: Self::TEXTURES || Self::LOBES,
    };

    /// The medium of a path, or [`NONE`].
    #[inline(always)]
    fn medium(medium: Self::Medium) -> u32 {
        medium.or(NONE)
    }
}

/// A kernel for each name, with the parts of a path that it changes.
macro_rules! kernels {
    ($($name:ident: $cone:ty, $ratio:ty, $medium:ty, $travelled:ty;)*) => {$(
        #[doc = concat!("See [`KernelName::", stringify!($name), "`].")]
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Zeroable, Pod)]
        pub struct $name;

        impl Kernel for $name {
            const NAME: KernelName = KernelName::$name;
            type Cone = $cone;
            type Ratio = $ratio;
            type Medium = $medium;
            type Travelled = $travelled;
        }
    )*};
}

kernels! {
    Diffuse: Absent, Absent, Absent, Absent;
    Solid: Absent, Kept<f32>, Absent, Absent;
    Textured: Kept<Cone>, Kept<f32>, Absent, Absent;
    General: Kept<Cone>, Kept<f32>, Kept<u32>, Kept<f32>;
}

/// Calls what it is given with the kernel of a name.
macro_rules! with_kernel {
    ($name:expr, $kernel:ident => $body:expr) => {{
        use $crate::integrator::kernel as kernels;
        use $crate::prepare::KernelName;
        match $name {
            KernelName::Diffuse => {
                type $kernel = kernels::Diffuse;
                $body
            }
            KernelName::Solid => {
                type $kernel = kernels::Solid;
                $body
            }
            KernelName::Textured => {
                type $kernel = kernels::Textured;
                $body
            }
            KernelName::General => {
                type $kernel = kernels::General;
                $body
            }
        }
    }};
}
pub(crate) use with_kernel;

#[cfg(test)]
mod tests {
    use super::super::flight::Flight;
    use super::super::path::Path;
    use super::*;

    fn holds<K: Kernel>(path: usize) {
        let has = K::NAME.has();
        let kept = |bytes: usize, part: Calls| (bytes > 0) == has.has(part);
        assert!(kept(size_of::<K::Cone>(), Calls::FOOTPRINTS), "{:?}", K::NAME);
        assert!(kept(size_of::<K::Ratio>(), Calls::TRANSMISSION), "{:?}", K::NAME);
        assert!(kept(size_of::<K::Medium>(), Calls::MEDIA), "{:?}", K::NAME);
        assert!(kept(size_of::<K::Travelled>(), Calls::MEDIA), "{:?}", K::NAME);
        assert_eq!((size_of::<Path<K>>(), size_of::<Flight<K>>()), (path, path + 4), "{:?}", K::NAME);
    }

    #[test]
    fn a_path_carries_what_its_kernel_may_change_and_no_byte_more() {
        holds::<Diffuse>(52);
        holds::<Solid>(56);
        holds::<Textured>(64);
        holds::<General>(72);
    }
}
