//! The choice of who traverses: builds whatever the settings name behind [`Accel`].
//!
//! Never falls back in silence: a backend that is not in this program is an error.

use super::bvh::{BvhScene, Form};
#[cfg(feature = "embree")]
use super::embree::{BuildOptions, EmbreeDevice, EmbreeScene};
use super::{Accel, Custom, Geometry, InstanceOf, Pages};
#[cfg(not(feature = "embree"))]
use crate::error::Error;
use crate::error::Result;
use crate::settings::Backend;
#[cfg(feature = "embree")]
use std::sync::Arc;

/// Builds acceleration structures; one for all of a render.
pub enum Builder {
    /// Embree.
    #[cfg(feature = "embree")]
    Embree {
        /// The library.
        device: Arc<EmbreeDevice>,
        /// How to build.
        options: BuildOptions,
    },
    /// Ours.
    Native,
}

impl Builder {
    /// For `backend`. `robust` and `threads` are for Embree: the native hierarchy is always watertight, and is
    /// built on the threads of the pool it is called on.
    ///
    /// # Errors
    /// [`Error::Usage`](crate::error::Error::Usage) for Embree in a Weir without it; [`Error::Resource`](crate::error::Error::Resource) where the library is unfit.
    pub fn new(backend: Backend, robust: bool, threads: usize) -> Result<Self> {
        match backend {
            Backend::Native => Ok(Self::Native),
            #[cfg(feature = "embree")]
            Backend::Embree => {
                Ok(Self::Embree { device: EmbreeDevice::new()?, options: BuildOptions { robust, threads } })
            }
            #[cfg(not(feature = "embree"))]
            Backend::Embree => {
                let _ = (robust, threads);
                Err(Error::Usage(
                    "this Weir was built without Embree; use --backend native, or build it with the feature \
                     `embree`"
                        .into(),
                ))
            }
        }
    }

    /// Builds `world` and `objects`, with `instances` of the latter.
    ///
    /// # Errors
    /// [`Error::Resource`](crate::error::Error::Resource) when memory, or the numbering of primitives, runs out.
    pub fn build<'a>(
        &self,
        world: &[Geometry<'a>],
        objects: &[Vec<Geometry<'a>>],
        instances: &[InstanceOf],
        custom: &'a dyn Custom,
        pages: Option<&'a dyn Pages>,
    ) -> Result<Box<dyn Accel + 'a>> {
        Ok(match self {
            #[cfg(feature = "embree")]
            Self::Embree { device, options } => {
                Box::new(EmbreeScene::new(device, world, objects, instances, custom, *options)?)
            }
            Self::Native => Box::new(BvhScene::new(world, objects, instances, custom, pages, Form::best())?),
        })
    }

    /// Name and version.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            #[cfg(feature = "embree")]
            Self::Embree { device, .. } => format!("embree {}", device.version()),
            Self::Native => "native".into(),
        }
    }
}
