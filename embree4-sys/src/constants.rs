//! Embree's limits, enumerations and flags.
//!
//! Invariant: C enumerations are `c_uint` aliases with constants, never Rust enums, because a newer
//! library may return a value that is not listed here and a Rust enum would then be undefined behaviour.
//! Never: lists what a processor build of Embree does not know (GPU flags).

use core::ffi::c_uint;

/// Instance levels that the library is built with; 2 or more would change every hit's layout.
pub const RTC_MAX_INSTANCE_LEVEL_COUNT: usize = 1;
/// Time steps that a geometry may have at most.
pub const RTC_MAX_TIME_STEP_COUNT: usize = 129;
/// "No geometry", "no instance".
pub const RTC_INVALID_GEOMETRY_ID: c_uint = u32::MAX;

macro_rules! enumeration {
    ($(#[$doc:meta])* $type:ident { $($(#[$about:meta])* $name:ident = $value:expr;)* }) => {
        $(#[$doc])*
        pub type $type = c_uint;
        $(
            #[doc = concat!("See [`", stringify!($type), "`].")]
            $(#[$about])*
            pub const $name: $type = $value;
        )*
    };
}

enumeration! {
    /// What can be asked of a device.
    RTCDeviceProperty {
        /// major * 10000 + minor * 100 + patch.
        RTC_DEVICE_PROPERTY_VERSION = 0;
        RTC_DEVICE_PROPERTY_VERSION_MAJOR = 1;
        RTC_DEVICE_PROPERTY_VERSION_MINOR = 2;
        RTC_DEVICE_PROPERTY_VERSION_PATCH = 3;
        RTC_DEVICE_PROPERTY_NATIVE_RAY4_SUPPORTED = 32;
        RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED = 33;
        RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED = 34;
        RTC_DEVICE_PROPERTY_BACKFACE_CULLING_CURVES_ENABLED = 63;
        RTC_DEVICE_PROPERTY_RAY_MASK_SUPPORTED = 64;
        RTC_DEVICE_PROPERTY_BACKFACE_CULLING_ENABLED = 65;
        RTC_DEVICE_PROPERTY_FILTER_FUNCTION_SUPPORTED = 66;
        RTC_DEVICE_PROPERTY_IGNORE_INVALID_RAYS_ENABLED = 67;
        RTC_DEVICE_PROPERTY_COMPACT_POLYS_ENABLED = 68;
        RTC_DEVICE_PROPERTY_TRIANGLE_GEOMETRY_SUPPORTED = 96;
        RTC_DEVICE_PROPERTY_QUAD_GEOMETRY_SUPPORTED = 97;
        RTC_DEVICE_PROPERTY_SUBDIVISION_GEOMETRY_SUPPORTED = 98;
        RTC_DEVICE_PROPERTY_CURVE_GEOMETRY_SUPPORTED = 99;
        RTC_DEVICE_PROPERTY_USER_GEOMETRY_SUPPORTED = 100;
        RTC_DEVICE_PROPERTY_POINT_GEOMETRY_SUPPORTED = 101;
        /// 0 its own, 1 oneTBB, 2 PPL.
        RTC_DEVICE_PROPERTY_TASKING_SYSTEM = 128;
        RTC_DEVICE_PROPERTY_JOIN_COMMIT_SUPPORTED = 129;
        RTC_DEVICE_PROPERTY_PARALLEL_COMMIT_SUPPORTED = 130;
    }
}

enumeration! {
    /// What went wrong last on this thread.
    RTCError {
        RTC_ERROR_NONE = 0;
        RTC_ERROR_UNKNOWN = 1;
        RTC_ERROR_INVALID_ARGUMENT = 2;
        RTC_ERROR_INVALID_OPERATION = 3;
        RTC_ERROR_OUT_OF_MEMORY = 4;
        /// The processor lacks SSE2.
        RTC_ERROR_UNSUPPORTED_CPU = 5;
        /// A memory or progress monitor said stop.
        RTC_ERROR_CANCELLED = 6;
    }
}

enumeration! {
    /// What a geometry is made of.
    RTCGeometryType {
        RTC_GEOMETRY_TYPE_TRIANGLE = 0;
        RTC_GEOMETRY_TYPE_QUAD = 1;
        RTC_GEOMETRY_TYPE_GRID = 2;
        RTC_GEOMETRY_TYPE_SUBDIVISION = 8;
        RTC_GEOMETRY_TYPE_CONE_LINEAR_CURVE = 15;
        RTC_GEOMETRY_TYPE_ROUND_LINEAR_CURVE = 16;
        RTC_GEOMETRY_TYPE_FLAT_LINEAR_CURVE = 17;
        RTC_GEOMETRY_TYPE_ROUND_BEZIER_CURVE = 24;
        RTC_GEOMETRY_TYPE_FLAT_BEZIER_CURVE = 25;
        RTC_GEOMETRY_TYPE_NORMAL_ORIENTED_BEZIER_CURVE = 26;
        RTC_GEOMETRY_TYPE_ROUND_BSPLINE_CURVE = 32;
        RTC_GEOMETRY_TYPE_FLAT_BSPLINE_CURVE = 33;
        RTC_GEOMETRY_TYPE_NORMAL_ORIENTED_BSPLINE_CURVE = 34;
        RTC_GEOMETRY_TYPE_SPHERE_POINT = 50;
        RTC_GEOMETRY_TYPE_DISC_POINT = 51;
        RTC_GEOMETRY_TYPE_ORIENTED_DISC_POINT = 52;
        RTC_GEOMETRY_TYPE_USER = 120;
        RTC_GEOMETRY_TYPE_INSTANCE = 121;
        RTC_GEOMETRY_TYPE_INSTANCE_ARRAY = 122;
    }
}

enumeration! {
    /// What a geometry's buffer holds.
    RTCBufferType {
        RTC_BUFFER_TYPE_INDEX = 0;
        RTC_BUFFER_TYPE_VERTEX = 1;
        RTC_BUFFER_TYPE_VERTEX_ATTRIBUTE = 2;
        RTC_BUFFER_TYPE_NORMAL = 3;
        RTC_BUFFER_TYPE_TANGENT = 4;
        RTC_BUFFER_TYPE_NORMAL_DERIVATIVE = 5;
        RTC_BUFFER_TYPE_GRID = 8;
        RTC_BUFFER_TYPE_FACE = 16;
        RTC_BUFFER_TYPE_LEVEL = 17;
        RTC_BUFFER_TYPE_TRANSFORM = 23;
        RTC_BUFFER_TYPE_FLAGS = 32;
    }
}

enumeration! {
    /// The format of a buffer's items or of a transform.
    RTCFormat {
        RTC_FORMAT_UNDEFINED = 0;
        RTC_FORMAT_UCHAR = 0x1001;
        RTC_FORMAT_USHORT = 0x3001;
        RTC_FORMAT_UINT = 0x5001;
        RTC_FORMAT_UINT2 = 0x5002;
        /// Three vertex numbers: a triangle.
        RTC_FORMAT_UINT3 = 0x5003;
        /// Four vertex numbers: a quad.
        RTC_FORMAT_UINT4 = 0x5004;
        RTC_FORMAT_FLOAT = 0x9001;
        RTC_FORMAT_FLOAT2 = 0x9002;
        RTC_FORMAT_FLOAT3 = 0x9003;
        /// Position and radius, for curves and points.
        RTC_FORMAT_FLOAT4 = 0x9004;
        RTC_FORMAT_FLOAT3X4_ROW_MAJOR = 0x9134;
        RTC_FORMAT_FLOAT4X4_ROW_MAJOR = 0x9144;
        /// Twelve floats, a column after the other.
        RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR = 0x9234;
        /// Sixteen floats, a column after the other.
        RTC_FORMAT_FLOAT4X4_COLUMN_MAJOR = 0x9244;
        RTC_FORMAT_GRID = 0xA001;
        RTC_FORMAT_QUATERNION_DECOMPOSITION = 0xB001;
    }
}

enumeration! {
    /// How much time a build may take for faster queries.
    RTCBuildQuality {
        RTC_BUILD_QUALITY_LOW = 0;
        RTC_BUILD_QUALITY_MEDIUM = 1;
        /// Splits triangles as well: about twice the memory.
        RTC_BUILD_QUALITY_HIGH = 2;
        /// Geometry only: keeps the tree's shape.
        RTC_BUILD_QUALITY_REFIT = 3;
    }
}

enumeration! {
    /// How a scene is built; flags combine by `|`.
    RTCSceneFlags {
        RTC_SCENE_FLAG_NONE = 0;
        RTC_SCENE_FLAG_DYNAMIC = 1 << 0;
        RTC_SCENE_FLAG_COMPACT = 1 << 1;
        RTC_SCENE_FLAG_ROBUST = 1 << 2;
        RTC_SCENE_FLAG_FILTER_FUNCTION_IN_ARGUMENTS = 1 << 3;
    }
}

enumeration! {
    /// How a query goes; flags combine by `|`.
    RTCRayQueryFlags {
        RTC_RAY_QUERY_FLAG_NONE = 0;
        /// Calls the filter of the arguments for every geometry, not only for those that enabled it.
        RTC_RAY_QUERY_FLAG_INVOKE_ARGUMENT_FILTER = 1 << 1;
        RTC_RAY_QUERY_FLAG_INCOHERENT = 0;
        RTC_RAY_QUERY_FLAG_COHERENT = 1 << 16;
    }
}

enumeration! {
    /// What a traversal must be able to meet. On a processor this hint is not used: pass "all".
    RTCFeatureFlags {
        RTC_FEATURE_FLAG_NONE = 0;
        RTC_FEATURE_FLAG_ALL = 0xffff_ffff;
    }
}
