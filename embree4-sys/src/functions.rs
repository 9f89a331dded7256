//! Embree's functions, one line each. What each demands and does is in its manual, under the same name.
//!
//! Invariant: every symbol here is exported by Embree 4.3.0 and by 4.4, so that a build linked against
//! either starts with the other.
//! Never: unwinds through a callback; a callback that panics must abort or catch.

use core::ffi::{c_char, c_int, c_uint, c_void};

use crate::constants::*;
use crate::ray::*;
use crate::types::*;

#[link(name = "embree4")]
unsafe extern "C" {
    // Devices.

    /// A device for a configuration such as `threads=1,set_affinity=0`; null on failure, and then
    /// `rtcGetDeviceError(null)` says why.
    pub fn rtcNewDevice(config: *const c_char) -> RTCDevice;
    /// One reference more.
    pub fn rtcRetainDevice(device: RTCDevice);
    /// One reference less.
    pub fn rtcReleaseDevice(device: RTCDevice);
    /// A property's value.
    pub fn rtcGetDeviceProperty(device: RTCDevice, property: RTCDeviceProperty) -> isize;
    /// This thread's first error since the last call; null asks for `rtcNewDevice`'s own.
    pub fn rtcGetDeviceError(device: RTCDevice) -> RTCError;
    /// Sets who hears of errors.
    pub fn rtcSetDeviceErrorFunction(device: RTCDevice, function: RTCErrorFunction, user: *mut c_void);
    /// Sets who hears of memory taken and given back; must not change while scenes exist.
    pub fn rtcSetDeviceMemoryMonitorFunction(
        device: RTCDevice,
        function: RTCMemoryMonitorFunction,
        user: *mut c_void,
    );

    // Scenes.

    /// An empty scene.
    pub fn rtcNewScene(device: RTCDevice) -> RTCScene;
    /// The scene's device, with one reference more.
    pub fn rtcGetSceneDevice(scene: RTCScene) -> RTCDevice;
    /// One reference more.
    pub fn rtcRetainScene(scene: RTCScene);
    /// One reference less.
    pub fn rtcReleaseScene(scene: RTCScene);
    /// Sets how the scene is built.
    pub fn rtcSetSceneFlags(scene: RTCScene, flags: RTCSceneFlags);
    /// How the scene is built.
    pub fn rtcGetSceneFlags(scene: RTCScene) -> RTCSceneFlags;
    /// Sets how well the scene is built.
    pub fn rtcSetSceneBuildQuality(scene: RTCScene, quality: RTCBuildQuality);
    /// Sets who hears of a build's progress.
    pub fn rtcSetSceneProgressMonitorFunction(
        scene: RTCScene,
        function: RTCProgressMonitorFunction,
        user: *mut c_void,
    );
    /// Builds the scene; one thread calls.
    pub fn rtcCommitScene(scene: RTCScene);
    /// Builds the scene; every thread that calls helps and waits.
    pub fn rtcJoinCommitScene(scene: RTCScene);
    /// The committed scene's box.
    pub fn rtcGetSceneBounds(scene: RTCScene, bounds_o: *mut RTCBounds);
    /// The committed scene's boxes at times 0 and 1.
    pub fn rtcGetSceneLinearBounds(scene: RTCScene, bounds_o: *mut RTCLinearBounds);
    /// Attaches a geometry, with one reference more, under the id that it returns.
    pub fn rtcAttachGeometry(scene: RTCScene, geometry: RTCGeometry) -> c_uint;
    /// Attaches a geometry, with one reference more, under an id that is free.
    pub fn rtcAttachGeometryByID(scene: RTCScene, geometry: RTCGeometry, geomID: c_uint);
    /// Detaches a geometry, with one reference less.
    pub fn rtcDetachGeometry(scene: RTCScene, geomID: c_uint);
    /// The geometry of an id; no reference more; safe beside queries, not beside changes.
    pub fn rtcGetGeometry(scene: RTCScene, geomID: c_uint) -> RTCGeometry;
    /// The user data of the geometry of an id; safe beside queries, not beside changes.
    pub fn rtcGetGeometryUserDataFromScene(scene: RTCScene, geomID: c_uint) -> *mut c_void;
    /// An instance's transform at a time, by its id in the scene.
    pub fn rtcGetGeometryTransformFromScene(
        scene: RTCScene,
        geomID: c_uint,
        time: f32,
        format: RTCFormat,
        transform: *mut c_void,
    );

    // Geometries.

    /// A geometry without buffers.
    pub fn rtcNewGeometry(device: RTCDevice, kind: RTCGeometryType) -> RTCGeometry;
    /// One reference more.
    pub fn rtcRetainGeometry(geometry: RTCGeometry);
    /// One reference less.
    pub fn rtcReleaseGeometry(geometry: RTCGeometry);
    /// Takes the changes made; scenes see them at their own commit.
    pub fn rtcCommitGeometry(geometry: RTCGeometry);
    /// Lets scenes see the geometry.
    pub fn rtcEnableGeometry(geometry: RTCGeometry);
    /// Hides the geometry from scenes.
    pub fn rtcDisableGeometry(geometry: RTCGeometry);
    /// Sets how many time steps there are.
    pub fn rtcSetGeometryTimeStepCount(geometry: RTCGeometry, count: c_uint);
    /// Sets which part of the shutter the time steps cover.
    pub fn rtcSetGeometryTimeRange(geometry: RTCGeometry, start: f32, end: f32);
    /// Sets how many vertex attributes there are.
    pub fn rtcSetGeometryVertexAttributeCount(geometry: RTCGeometry, count: c_uint);
    /// Sets which rays see the geometry.
    pub fn rtcSetGeometryMask(geometry: RTCGeometry, mask: c_uint);
    /// Sets how well the geometry's own tree is built.
    pub fn rtcSetGeometryBuildQuality(geometry: RTCGeometry, quality: RTCBuildQuality);
    /// Sets a buffer object.
    pub fn rtcSetGeometryBuffer(
        geometry: RTCGeometry,
        kind: RTCBufferType,
        slot: c_uint,
        format: RTCFormat,
        buffer: RTCBuffer,
        byte_offset: usize,
        byte_stride: usize,
        item_count: usize,
    );
    /// Borrows the caller's memory for as long as the geometry lives. Sixteen bytes must be readable from
    /// the start of the last vertex.
    pub fn rtcSetSharedGeometryBuffer(
        geometry: RTCGeometry,
        kind: RTCBufferType,
        slot: c_uint,
        format: RTCFormat,
        data: *const c_void,
        byte_offset: usize,
        byte_stride: usize,
        item_count: usize,
    );
    /// Allocates a buffer of Embree's for the caller to fill; null when out of memory.
    pub fn rtcSetNewGeometryBuffer(
        geometry: RTCGeometry,
        kind: RTCBufferType,
        slot: c_uint,
        format: RTCFormat,
        byte_stride: usize,
        item_count: usize,
    ) -> *mut c_void;
    /// A buffer's data.
    pub fn rtcGetGeometryBufferData(geometry: RTCGeometry, kind: RTCBufferType, slot: c_uint) -> *mut c_void;
    /// Says that a buffer's data changed.
    pub fn rtcUpdateGeometryBuffer(geometry: RTCGeometry, kind: RTCBufferType, slot: c_uint);
    /// Sets the closest-hit filter.
    pub fn rtcSetGeometryIntersectFilterFunction(geometry: RTCGeometry, filter: RTCFilterFunctionN);
    /// Sets the occlusion filter.
    pub fn rtcSetGeometryOccludedFilterFunction(geometry: RTCGeometry, filter: RTCFilterFunctionN);
    /// Lets the filter of a query's arguments see this geometry.
    pub fn rtcSetGeometryEnableFilterFunctionFromArguments(geometry: RTCGeometry, enable: bool);
    /// Sets the pointer that callbacks receive.
    pub fn rtcSetGeometryUserData(geometry: RTCGeometry, user: *mut c_void);
    /// The pointer that callbacks receive.
    pub fn rtcGetGeometryUserData(geometry: RTCGeometry) -> *mut c_void;
    /// Sets how many primitives a user geometry has.
    pub fn rtcSetGeometryUserPrimitiveCount(geometry: RTCGeometry, count: c_uint);
    /// Sets who bounds user primitives.
    pub fn rtcSetGeometryBoundsFunction(
        geometry: RTCGeometry,
        function: RTCBoundsFunction,
        user: *mut c_void,
    );
    /// Sets who intersects user primitives.
    pub fn rtcSetGeometryIntersectFunction(geometry: RTCGeometry, function: RTCIntersectFunctionN);
    /// Sets who tests user primitives for occlusion.
    pub fn rtcSetGeometryOccludedFunction(geometry: RTCGeometry, function: RTCOccludedFunctionN);
    /// Runs the query's filter from a user geometry's closest-hit callback.
    pub fn rtcInvokeIntersectFilterFromGeometry(
        arguments: *const RTCIntersectFunctionNArguments,
        filter_arguments: *const RTCFilterFunctionNArguments,
    );
    /// Runs the query's filter from a user geometry's occlusion callback.
    pub fn rtcInvokeOccludedFilterFromGeometry(
        arguments: *const RTCOccludedFunctionNArguments,
        filter_arguments: *const RTCFilterFunctionNArguments,
    );
    /// Sets the scene that an instance shows. One that holds instances itself is never traversed further:
    /// its rays miss, without an error.
    pub fn rtcSetGeometryInstancedScene(geometry: RTCGeometry, scene: RTCScene);
    /// Sets the scenes that an instance array shows.
    pub fn rtcSetGeometryInstancedScenes(geometry: RTCGeometry, scenes: *mut RTCScene, count: usize);
    /// Sets an instance's object-to-world transform at a time step.
    pub fn rtcSetGeometryTransform(
        geometry: RTCGeometry,
        time_step: c_uint,
        format: RTCFormat,
        transform: *const c_void,
    );
    /// Sets an instance's transform at a time step as a decomposition.
    pub fn rtcSetGeometryTransformQuaternion(
        geometry: RTCGeometry,
        time_step: c_uint,
        decomposition: *const RTCQuaternionDecomposition,
    );
    /// An instance's transform at a time.
    pub fn rtcGetGeometryTransform(
        geometry: RTCGeometry,
        time: f32,
        format: RTCFormat,
        transform: *mut c_void,
    );

    // Buffers.

    /// A buffer of Embree's.
    pub fn rtcNewBuffer(device: RTCDevice, bytes: usize) -> RTCBuffer;
    /// A buffer over the caller's memory.
    pub fn rtcNewSharedBuffer(device: RTCDevice, data: *mut c_void, bytes: usize) -> RTCBuffer;
    /// A buffer's data.
    pub fn rtcGetBufferData(buffer: RTCBuffer) -> *mut c_void;
    /// One reference more.
    pub fn rtcRetainBuffer(buffer: RTCBuffer);
    /// One reference less.
    pub fn rtcReleaseBuffer(buffer: RTCBuffer);

    // Queries. `valid` has a lane of -1 for each ray to trace and is aligned as the packet is.

    /// The closest hit of one ray; `arguments` may be null.
    pub fn rtcIntersect1(scene: RTCScene, rayhit: *mut RTCRayHit, arguments: *mut RTCIntersectArguments);
    /// The closest hits of 4 rays.
    pub fn rtcIntersect4(
        valid: *const c_int,
        scene: RTCScene,
        rayhit: *mut RTCRayHit4,
        arguments: *mut RTCIntersectArguments,
    );
    /// The closest hits of 8 rays.
    pub fn rtcIntersect8(
        valid: *const c_int,
        scene: RTCScene,
        rayhit: *mut RTCRayHit8,
        arguments: *mut RTCIntersectArguments,
    );
    /// The closest hits of 16 rays.
    pub fn rtcIntersect16(
        valid: *const c_int,
        scene: RTCScene,
        rayhit: *mut RTCRayHit16,
        arguments: *mut RTCIntersectArguments,
    );
    /// Whether one ray meets anything: `tfar` becomes minus infinity; `arguments` may be null.
    pub fn rtcOccluded1(scene: RTCScene, ray: *mut RTCRay, arguments: *mut RTCOccludedArguments);
    /// Whether each of 4 rays meets anything.
    pub fn rtcOccluded4(
        valid: *const c_int,
        scene: RTCScene,
        ray: *mut RTCRay4,
        arguments: *mut RTCOccludedArguments,
    );
    /// Whether each of 8 rays meets anything.
    pub fn rtcOccluded8(
        valid: *const c_int,
        scene: RTCScene,
        ray: *mut RTCRay8,
        arguments: *mut RTCOccludedArguments,
    );
    /// Whether each of 16 rays meets anything.
    pub fn rtcOccluded16(
        valid: *const c_int,
        scene: RTCScene,
        ray: *mut RTCRay16,
        arguments: *mut RTCOccludedArguments,
    );
}
