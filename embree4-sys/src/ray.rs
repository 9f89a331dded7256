//! Rays, hits, and the packets of both: the memory that a query reads and writes.
//!
//! Invariant: sizes and alignments are those of Embree 4.3 and later; a hit ends in `instPrimID`, which
//! 4.2 lacks, and a smaller record than the library's means that a query writes past its end.
//! Never: initialises lanes for a packet; a packet's `valid` mask says which lanes are read.

use core::ffi::c_uint;

use crate::constants::{RTC_INVALID_GEOMETRY_ID, RTC_MAX_INSTANCE_LEVEL_COUNT};

/// A ray: origin and direction in world units; a hit lies at `org + t * dir` with `tnear <= t <= tfar`.
///
/// A closest-hit query sets `tfar` to the hit's `t`; an occlusion query sets it to minus infinity when
/// something lies in between.
#[repr(C, align(16))]
#[derive(Clone, Copy, Debug)]
pub struct RTCRay {
    /// Origin, x.
    pub org_x: f32,
    /// Origin, y.
    pub org_y: f32,
    /// Origin, z.
    pub org_z: f32,
    /// Start of the segment, in multiples of the direction.
    pub tnear: f32,
    /// Direction, x; need not be of unit length.
    pub dir_x: f32,
    /// Direction, y.
    pub dir_y: f32,
    /// Direction, z.
    pub dir_z: f32,
    /// Time within the shutter, 0 to 1.
    pub time: f32,
    /// End of the segment; set to the hit's distance.
    pub tfar: f32,
    /// Geometry is seen where its mask and this one share a bit.
    pub mask: c_uint,
    /// The caller's number, passed to callbacks.
    pub id: c_uint,
    /// Must be 0.
    pub flags: c_uint,
}

/// A closest hit. `geomID` stays [`RTC_INVALID_GEOMETRY_ID`] when the ray meets nothing.
#[repr(C, align(16))]
#[derive(Clone, Copy, Debug)]
pub struct RTCHit {
    /// Geometric normal, x; in the instance's own space, not of unit length.
    pub Ng_x: f32,
    /// Geometric normal, y.
    pub Ng_y: f32,
    /// Geometric normal, z.
    pub Ng_z: f32,
    /// Barycentric weight of a triangle's second vertex.
    pub u: f32,
    /// Barycentric weight of a triangle's third vertex.
    pub v: f32,
    /// The primitive within its geometry.
    pub primID: c_uint,
    /// The geometry within its scene.
    pub geomID: c_uint,
    /// The instance's geometry id in the scene that was asked, or invalid.
    pub instID: [c_uint; RTC_MAX_INSTANCE_LEVEL_COUNT],
    /// The member of an instance array, or invalid. New in 4.3.
    pub instPrimID: [c_uint; RTC_MAX_INSTANCE_LEVEL_COUNT],
}

/// What `rtcIntersect1` reads and writes.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RTCRayHit {
    /// The ray asked.
    pub ray: RTCRay,
    /// The answer.
    pub hit: RTCHit,
}

impl RTCRay {
    /// A ray at time 0 that every mask sees.
    #[must_use]
    pub const fn new(origin: [f32; 3], direction: [f32; 3], tnear: f32, tfar: f32) -> Self {
        Self {
            org_x: origin[0],
            org_y: origin[1],
            org_z: origin[2],
            tnear,
            dir_x: direction[0],
            dir_y: direction[1],
            dir_z: direction[2],
            time: 0.0,
            tfar,
            mask: u32::MAX,
            id: 0,
            flags: 0,
        }
    }
}

impl RTCHit {
    /// The answer "nothing", which a query must find in place.
    pub const NONE: Self = Self {
        Ng_x: 0.0,
        Ng_y: 0.0,
        Ng_z: 0.0,
        u: 0.0,
        v: 0.0,
        primID: RTC_INVALID_GEOMETRY_ID,
        geomID: RTC_INVALID_GEOMETRY_ID,
        instID: [RTC_INVALID_GEOMETRY_ID; RTC_MAX_INSTANCE_LEVEL_COUNT],
        instPrimID: [RTC_INVALID_GEOMETRY_ID; RTC_MAX_INSTANCE_LEVEL_COUNT],
    };
}

impl RTCRayHit {
    /// A ray with no answer yet.
    #[must_use]
    pub const fn new(ray: RTCRay) -> Self {
        Self { ray, hit: RTCHit::NONE }
    }
}

macro_rules! packet {
    ($lanes:literal, $align:literal, $ray:ident, $hit:ident, $rayhit:ident) => {
        #[doc = concat!(stringify!($lanes), " rays as columns; the fields are [`RTCRay`]'s.")]
        #[repr(C, align($align))]
        #[derive(Clone, Copy, Debug)]
        #[allow(missing_docs, reason = "the fields of RTCRay, a lane each")]
        pub struct $ray {
            pub org_x: [f32; $lanes],
            pub org_y: [f32; $lanes],
            pub org_z: [f32; $lanes],
            pub tnear: [f32; $lanes],
            pub dir_x: [f32; $lanes],
            pub dir_y: [f32; $lanes],
            pub dir_z: [f32; $lanes],
            pub time: [f32; $lanes],
            pub tfar: [f32; $lanes],
            pub mask: [c_uint; $lanes],
            pub id: [c_uint; $lanes],
            pub flags: [c_uint; $lanes],
        }

        #[doc = concat!(stringify!($lanes), " hits as columns; the fields are [`RTCHit`]'s.")]
        #[repr(C, align($align))]
        #[derive(Clone, Copy, Debug)]
        #[allow(missing_docs, reason = "the fields of RTCHit, a lane each")]
        pub struct $hit {
            pub Ng_x: [f32; $lanes],
            pub Ng_y: [f32; $lanes],
            pub Ng_z: [f32; $lanes],
            pub u: [f32; $lanes],
            pub v: [f32; $lanes],
            pub primID: [c_uint; $lanes],
            pub geomID: [c_uint; $lanes],
            pub instID: [[c_uint; $lanes]; RTC_MAX_INSTANCE_LEVEL_COUNT],
            pub instPrimID: [[c_uint; $lanes]; RTC_MAX_INSTANCE_LEVEL_COUNT],
        }

        #[doc = concat!("What `rtcIntersect", stringify!($lanes), "` reads and writes.")]
        #[repr(C)]
        #[derive(Clone, Copy, Debug)]
        pub struct $rayhit {
            /// The rays asked.
            pub ray: $ray,
            /// The answers.
            pub hit: $hit,
        }
    };
}

packet!(4, 16, RTCRay4, RTCHit4, RTCRayHit4);
packet!(8, 32, RTCRay8, RTCHit8, RTCRayHit8);
packet!(16, 64, RTCRay16, RTCHit16, RTCRayHit16);

macro_rules! layout {
    ($($type:ty: $size:literal bytes, aligned $align:literal;)*) => {$(
        const _: () = assert!(
            size_of::<$type>() == $size && align_of::<$type>() == $align,
            concat!(stringify!($type), ": Embree 4.3+ reads and writes exactly this many bytes"),
        );
    )*};
}

layout! {
    RTCRay: 48 bytes, aligned 16;
    RTCHit: 48 bytes, aligned 16;
    RTCRayHit: 96 bytes, aligned 16;
    RTCRay4: 192 bytes, aligned 16;
    RTCHit4: 144 bytes, aligned 16;
    RTCRayHit4: 336 bytes, aligned 16;
    RTCRay8: 384 bytes, aligned 32;
    RTCHit8: 288 bytes, aligned 32;
    RTCRayHit8: 672 bytes, aligned 32;
    RTCRay16: 768 bytes, aligned 64;
    RTCHit16: 576 bytes, aligned 64;
    RTCRayHit16: 1344 bytes, aligned 64;
}
const _: () = assert!(core::mem::offset_of!(RTCHit, instPrimID) == 32, "4.3 put it behind instID");
