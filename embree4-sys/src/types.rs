//! Handles, callback types, and the structs that callbacks and queries receive.
//!
//! Invariant: each struct is as long as Embree 4.3 and later make it, which is asserted below.
//! Never: owns a handle; reference counts are the caller's.

use core::ffi::{c_char, c_int, c_uint, c_void};
use core::marker::{PhantomData, PhantomPinned};

use crate::constants::*;

macro_rules! handles {
    ($($(#[$doc:meta])* $opaque:ident => $handle:ident;)*) => {$(
        #[doc = concat!("What a [`", stringify!($handle), "`] points at; only Embree knows its fields.")]
        #[repr(C)]
        #[derive(Debug)]
        pub struct $opaque {
            _bytes: [u8; 0],
            _neither_send_nor_sync: PhantomData<(*mut u8, PhantomPinned)>,
        }
        $(#[$doc])*
        pub type $handle = *mut $opaque;
    )*};
}

handles! {
    /// A device: configuration, error state and memory monitor. Reference-counted.
    RTCDeviceTy => RTCDevice;
    /// A scene: geometries and the acceleration structure over them. Reference-counted.
    RTCSceneTy => RTCScene;
    /// A geometry, attached to any number of scenes. Reference-counted.
    RTCGeometryTy => RTCGeometry;
    /// A buffer that several geometries may share. Reference-counted.
    RTCBufferTy => RTCBuffer;
}

macro_rules! opaque {
    ($($(#[$doc:meta])* $name:ident;)*) => {$(
        $(#[$doc])*
        #[repr(C)]
        #[derive(Debug)]
        pub struct $name {
            _bytes: [u8; 0],
            _neither_send_nor_sync: PhantomData<(*mut u8, PhantomPinned)>,
        }
    )*};
}

opaque! {
    /// `N` rays as twelve columns of `N` 4-byte values, in [`crate::RTCRay`]'s order.
    RTCRayN;
    /// `N` hits as nine columns of `N` 4-byte values, in [`crate::RTCHit`]'s order.
    RTCHitN;
    /// `N` rays, then `N` hits: 21 columns of `N` 4-byte values.
    RTCRayHitN;
}

/// An axis-aligned box in world units.
#[repr(C, align(16))]
#[derive(Clone, Copy, Debug, Default)]
#[allow(missing_docs, reason = "corners and padding, as named")]
pub struct RTCBounds {
    pub lower_x: f32,
    pub lower_y: f32,
    pub lower_z: f32,
    pub align0: f32,
    pub upper_x: f32,
    pub upper_y: f32,
    pub upper_z: f32,
    pub align1: f32,
}

/// Boxes at times 0 and 1; the box at a time in between is their mixture.
#[repr(C, align(16))]
#[derive(Clone, Copy, Debug, Default)]
pub struct RTCLinearBounds {
    /// At time 0.
    pub bounds0: RTCBounds,
    /// At time 1.
    pub bounds1: RTCBounds,
}

/// A transform taken apart so that rotation interpolates as a quaternion.
#[repr(C, align(16))]
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs, reason = "the sixteen numbers of the manual, as named")]
pub struct RTCQuaternionDecomposition {
    pub scale_x: f32,
    pub scale_y: f32,
    pub scale_z: f32,
    pub skew_xy: f32,
    pub skew_xz: f32,
    pub skew_yz: f32,
    pub shift_x: f32,
    pub shift_y: f32,
    pub shift_z: f32,
    pub quaternion_r: f32,
    pub quaternion_i: f32,
    pub quaternion_j: f32,
    pub quaternion_k: f32,
    pub translation_x: f32,
    pub translation_y: f32,
    pub translation_z: f32,
}

/// The instances a query is inside of; callers may put it first in a larger struct of theirs.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RTCRayQueryContext {
    /// The stack of instance ids.
    pub instID: [c_uint; RTC_MAX_INSTANCE_LEVEL_COUNT],
    /// The stack of members of instance arrays. New in 4.3.
    pub instPrimID: [c_uint; RTC_MAX_INSTANCE_LEVEL_COUNT],
}

impl RTCRayQueryContext {
    /// Outside every instance: what a query must start with.
    pub const OUTSIDE: Self = Self {
        instID: [RTC_INVALID_GEOMETRY_ID; RTC_MAX_INSTANCE_LEVEL_COUNT],
        instPrimID: [RTC_INVALID_GEOMETRY_ID; RTC_MAX_INSTANCE_LEVEL_COUNT],
    };
}

/// What a filter receives: `N` rays and their candidate hits. It refuses lane `i` by `valid[i] = 0`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RTCFilterFunctionNArguments {
    /// `N` lanes, -1 for a lane to judge.
    pub valid: *mut c_int,
    /// What `rtcSetGeometryUserData` set.
    pub geometryUserPtr: *mut c_void,
    /// The query's context.
    pub context: *mut RTCRayQueryContext,
    /// The rays; `tfar` is the candidate's distance.
    pub ray: *mut RTCRayN,
    /// The candidates.
    pub hit: *mut RTCHitN,
    /// How many lanes.
    pub N: c_uint,
}

/// What a user geometry's closest-hit callback receives.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RTCIntersectFunctionNArguments {
    /// `N` lanes, -1 for a lane to intersect.
    pub valid: *mut c_int,
    /// What `rtcSetGeometryUserData` set.
    pub geometryUserPtr: *mut c_void,
    /// The primitive to intersect.
    pub primID: c_uint,
    /// The query's context.
    pub context: *mut RTCRayQueryContext,
    /// Rays, and the hits to write.
    pub rayhit: *mut RTCRayHitN,
    /// How many lanes.
    pub N: c_uint,
    /// The geometry's id in its scene.
    pub geomID: c_uint,
}

/// What a user geometry's occlusion callback receives. It occludes lane `i` by `tfar[i] = -inf`.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RTCOccludedFunctionNArguments {
    /// `N` lanes, -1 for a lane to test.
    pub valid: *mut c_int,
    /// What `rtcSetGeometryUserData` set.
    pub geometryUserPtr: *mut c_void,
    /// The primitive to test.
    pub primID: c_uint,
    /// The query's context.
    pub context: *mut RTCRayQueryContext,
    /// The rays.
    pub ray: *mut RTCRayN,
    /// How many lanes.
    pub N: c_uint,
    /// The geometry's id in its scene.
    pub geomID: c_uint,
}

/// What a user geometry's bounding callback receives.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RTCBoundsFunctionArguments {
    /// What `rtcSetGeometryUserData` set.
    pub geometryUserPtr: *mut c_void,
    /// The primitive to bound.
    pub primID: c_uint,
    /// The time step to bound it at.
    pub timeStep: c_uint,
    /// Where the box goes.
    pub bounds_o: *mut RTCBounds,
}

/// Judges candidate hits.
pub type RTCFilterFunctionN = Option<unsafe extern "C" fn(args: *const RTCFilterFunctionNArguments)>;
/// Intersects a user primitive.
pub type RTCIntersectFunctionN = Option<unsafe extern "C" fn(args: *const RTCIntersectFunctionNArguments)>;
/// Tests a user primitive for occlusion.
pub type RTCOccludedFunctionN = Option<unsafe extern "C" fn(args: *const RTCOccludedFunctionNArguments)>;
/// Bounds a user primitive.
pub type RTCBoundsFunction = Option<unsafe extern "C" fn(args: *const RTCBoundsFunctionArguments)>;
/// Hears of errors as they happen; `message` may be null.
pub type RTCErrorFunction =
    Option<unsafe extern "C" fn(user: *mut c_void, code: RTCError, message: *const c_char)>;
/// Hears of bytes taken (positive) or given back (negative), before (`post` false) or after the fact; an
/// answer of `false` to a taking that has not happened yet cancels the build.
pub type RTCMemoryMonitorFunction =
    Option<unsafe extern "C" fn(user: *mut c_void, bytes: isize, post: bool) -> bool>;
/// Hears of a build's progress, 0 to 1; `false` cancels it.
pub type RTCProgressMonitorFunction = Option<unsafe extern "C" fn(user: *mut c_void, fraction: f64) -> bool>;

macro_rules! arguments {
    ($name:ident, $callback:ident: $callback_type:ty, $what:literal) => {
        #[doc = concat!("Optional arguments of a ", $what, " query; a null pointer means [`Self::DEFAULT`].")]
        #[repr(C)]
        #[derive(Clone, Copy, Debug)]
        pub struct $name {
            /// How the query goes.
            pub flags: RTCRayQueryFlags,
            /// What the traversal must be able to meet.
            pub feature_mask: RTCFeatureFlags,
            /// The query's context, or null for one of Embree's.
            pub context: *mut RTCRayQueryContext,
            /// A filter for geometries that enabled it, or for all (see the flags).
            pub filter: RTCFilterFunctionN,
            /// A callback for user geometries that have none of their own.
            pub $callback: $callback_type,
        }

        impl $name {
            /// What Embree assumes when it gets a null pointer.
            pub const DEFAULT: Self = Self {
                flags: RTC_RAY_QUERY_FLAG_INCOHERENT,
                feature_mask: RTC_FEATURE_FLAG_ALL,
                context: core::ptr::null_mut(),
                filter: None,
                $callback: None,
            };
        }
    };
}

arguments!(RTCIntersectArguments, intersect: RTCIntersectFunctionN, "closest-hit");
arguments!(RTCOccludedArguments, occluded: RTCOccludedFunctionN, "occlusion");

#[cfg(target_pointer_width = "64")]
const _: () = {
    assert!(size_of::<RTCRayQueryContext>() == 8, "4.3+ writes instPrimID as well");
    assert!(size_of::<RTCIntersectArguments>() == 32, "no field for curves' least width");
    assert!(size_of::<RTCOccludedArguments>() == 32, "no field for curves' least width");
    assert!(size_of::<RTCBounds>() == 32 && align_of::<RTCBounds>() == 16, "two 16-byte lanes");
    assert!(size_of::<RTCLinearBounds>() == 64, "two boxes");
    assert!(size_of::<RTCQuaternionDecomposition>() == 64, "sixteen floats");
    assert!(size_of::<RTCFilterFunctionNArguments>() == 48, "five pointers, a count, padding");
    assert!(size_of::<RTCIntersectFunctionNArguments>() == 48, "as the C compiler pads it");
    assert!(size_of::<RTCOccludedFunctionNArguments>() == 48, "as the C compiler pads it");
    assert!(size_of::<RTCBoundsFunctionArguments>() == 24, "as the C compiler pads it");
};
