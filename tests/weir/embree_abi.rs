//! Asks the Embree that was linked whether it has the ABI that `embree4-sys` declares.
//!
//! Invariant: a library with a larger hit record, or one of another major version, fails here before it
//! can corrupt a render.
//! Never: tests Weir's own traversal; the unit tests of `accel` do.

use std::ffi::CStr;
use std::ptr::{null_mut, without_provenance_mut};
use std::slice;

use embree4_sys::*;

/// Answers are compared with exact values: the triangle's coordinates are small powers of two.
const TRIANGLE: [[f32; 3]; 3] = [[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 1.0, 2.0]];

/// Bytes around a record that a query must leave alone.
const CANARY: u8 = 0xA5;

/// Owns a device and every scene made from it.
struct Embree {
    device: RTCDevice,
    scenes: Vec<RTCScene>,
}

impl Embree {
    fn new() -> Self {
        let config: &CStr = c"threads=1,set_affinity=0";
        // SAFETY: the configuration ends in a zero byte.
        let device = unsafe { rtcNewDevice(config.as_ptr()) };
        assert!(!device.is_null(), "Embree gives no device");
        Self { device, scenes: Vec::new() }
    }

    fn property(&self, property: RTCDeviceProperty) -> isize {
        // SAFETY: the device lives until `self` is dropped.
        unsafe { rtcGetDeviceProperty(self.device, property) }
    }

    fn scene(&mut self) -> RTCScene {
        // SAFETY: the device lives until `self` is dropped.
        let scene = unsafe { rtcNewScene(self.device) };
        self.scenes.push(scene);
        scene
    }

    /// Takes over `geometry`'s one reference, commits it and then the scene.
    fn attach(&self, scene: RTCScene, geometry: RTCGeometry) {
        // SAFETY: the geometry is alive and its buffers are set.
        unsafe { rtcCommitGeometry(geometry) };
        // SAFETY: both are alive and of this device.
        unsafe { rtcAttachGeometry(scene, geometry) };
        // SAFETY: the scene now holds a reference of its own.
        unsafe { rtcReleaseGeometry(geometry) };
        // SAFETY: no other thread knows the scene.
        unsafe { rtcCommitScene(scene) };
        self.no_error();
    }

    fn geometry(&self, kind: RTCGeometryType) -> RTCGeometry {
        // SAFETY: the device lives until `self` is dropped.
        let geometry = unsafe { rtcNewGeometry(self.device, kind) };
        assert!(!geometry.is_null(), "Embree gives no geometry");
        geometry
    }

    fn triangle(&mut self) -> RTCScene {
        let scene = self.scene();
        let geometry = self.geometry(RTC_GEOMETRY_TYPE_TRIANGLE);
        // SAFETY: the geometry is alive; the stride is that of three floats.
        let vertices =
            unsafe { rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, 3) };
        assert!(!vertices.is_null());
        // SAFETY: Embree allocated three items of three floats there, aligned to 16 bytes.
        unsafe { slice::from_raw_parts_mut(vertices.cast::<[f32; 3]>(), 3) }.copy_from_slice(&TRIANGLE);
        // SAFETY: the geometry is alive; the stride is that of three indices.
        let indices =
            unsafe { rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, 1) };
        assert!(!indices.is_null());
        // SAFETY: Embree allocated one item of three indices there, aligned to 16 bytes.
        unsafe { slice::from_raw_parts_mut(indices.cast::<u32>(), 3) }.copy_from_slice(&[0, 1, 2]);
        self.attach(scene, geometry);
        scene
    }

    /// A scene with one instance of `inner`, moved by `offset`.
    fn instance(&mut self, inner: RTCScene, offset: [f32; 3]) -> RTCScene {
        let scene = self.scene();
        let geometry = self.geometry(RTC_GEOMETRY_TYPE_INSTANCE);
        // SAFETY: both are alive and of this device.
        unsafe { rtcSetGeometryInstancedScene(geometry, inner) };
        let [x, y, z] = offset;
        let transform: [f32; 12] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, x, y, z];
        // SAFETY: the format's twelve floats are there; Embree copies them.
        unsafe {
            rtcSetGeometryTransform(geometry, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, transform.as_ptr().cast());
        }
        self.attach(scene, geometry);
        scene
    }

    fn closest(&self, scene: RTCScene, origin: [f32; 3]) -> RTCRayHit {
        let mut rayhit = RTCRayHit::new(RTCRay::new(origin, [0.0, 0.0, 1.0], 0.0, f32::INFINITY));
        // SAFETY: the scene is committed and the record is ours alone.
        unsafe { rtcIntersect1(scene, &raw mut rayhit, null_mut()) };
        self.no_error();
        rayhit
    }

    fn no_error(&self) {
        // SAFETY: the device lives until `self` is dropped.
        let code = unsafe { rtcGetDeviceError(self.device) };
        assert_eq!(code, RTC_ERROR_NONE, "Embree reports an error");
    }
}

impl Drop for Embree {
    fn drop(&mut self) {
        for &scene in &self.scenes {
            // SAFETY: each scene was made by `scene` and is released once.
            unsafe { rtcReleaseScene(scene) };
        }
        // SAFETY: made by `new` and released once.
        unsafe { rtcReleaseDevice(self.device) };
    }
}

#[test]
fn the_version_is_one_whose_abi_is_declared() {
    let embree = Embree::new();
    let version = embree.property(RTC_DEVICE_PROPERTY_VERSION);
    assert!((VERSION_FIRST..VERSION_PAST).contains(&version), "Embree {version}");
    let parts = [
        (RTC_DEVICE_PROPERTY_VERSION_MAJOR, version / 10_000),
        (RTC_DEVICE_PROPERTY_VERSION_MINOR, version / 100 % 100),
        (RTC_DEVICE_PROPERTY_VERSION_PATCH, version % 100),
    ];
    for (property, expected) in parts {
        assert_eq!(embree.property(property), expected, "property {property}");
    }
}

#[test]
fn what_a_render_relies_on_is_compiled_in() {
    let embree = Embree::new();
    for (property, name) in [
        (RTC_DEVICE_PROPERTY_RAY_MASK_SUPPORTED, "ray masks"),
        (RTC_DEVICE_PROPERTY_FILTER_FUNCTION_SUPPORTED, "filter functions"),
        (RTC_DEVICE_PROPERTY_TRIANGLE_GEOMETRY_SUPPORTED, "triangles"),
        (RTC_DEVICE_PROPERTY_USER_GEOMETRY_SUPPORTED, "user geometry"),
        (RTC_DEVICE_PROPERTY_CURVE_GEOMETRY_SUPPORTED, "curves"),
        (RTC_DEVICE_PROPERTY_JOIN_COMMIT_SUPPORTED, "joining a commit"),
    ] {
        assert_eq!(embree.property(property), 1, "{name}");
    }
    assert_eq!(embree.property(RTC_DEVICE_PROPERTY_BACKFACE_CULLING_ENABLED), 0, "culling loses hits");
}

#[test]
fn a_triangle_is_hit_where_it_is_and_nowhere_else() {
    let mut embree = Embree::new();
    let scene = embree.triangle();

    let inside = embree.closest(scene, [0.25, 0.5, 0.0]);
    assert_eq!((inside.hit.geomID, inside.hit.primID), (0, 0));
    assert_eq!(inside.ray.tfar, 2.0);
    // u weighs the second vertex, v the third.
    assert_eq!((inside.hit.u, inside.hit.v), (0.25, 0.5));
    assert_eq!((inside.hit.Ng_x, inside.hit.Ng_y, inside.hit.Ng_z.abs()), (0.0, 0.0, 1.0));
    assert_eq!(inside.hit.instID, [RTC_INVALID_GEOMETRY_ID]);
    assert_eq!(inside.hit.instPrimID, [RTC_INVALID_GEOMETRY_ID]);

    let outside = embree.closest(scene, [0.75, 0.75, 0.0]);
    assert_eq!(outside.hit.geomID, RTC_INVALID_GEOMETRY_ID);
    assert_eq!(outside.ray.tfar, f32::INFINITY);
}

#[test]
fn occlusion_says_so_in_tfar() {
    let mut embree = Embree::new();
    let scene = embree.triangle();
    for (origin, expected) in [([0.25, 0.5, 0.0], f32::NEG_INFINITY), ([0.75, 0.75, 0.0], 8.0)] {
        let mut ray = RTCRay::new(origin, [0.0, 0.0, 1.0], 0.0, 8.0);
        // SAFETY: the scene is committed and the ray is ours alone.
        unsafe { rtcOccluded1(scene, &raw mut ray, null_mut()) };
        assert_eq!(ray.tfar, expected);
    }
}

/// A record between two fields of canaries; both lie directly against it.
#[repr(C, align(64))]
struct Guarded<T> {
    before: [u8; 64],
    record: T,
    after: [u8; 64],
}

impl<T> Guarded<T> {
    fn new(record: T) -> Self {
        Self { before: [CANARY; 64], record, after: [CANARY; 64] }
    }

    fn assert_intact(&self) {
        assert_eq!(self.before, [CANARY; 64], "Embree wrote before the record");
        assert_eq!(self.after, [CANARY; 64], "Embree wrote past the record: its hit is larger than ours");
    }
}

#[test]
fn one_ray_writes_nothing_past_its_record() {
    let mut embree = Embree::new();
    let triangle = embree.triangle();
    let scene = embree.instance(triangle, [0.0, 0.0, 1.0]);
    let ray = RTCRay::new([0.25, 0.5, 0.0], [0.0, 0.0, 1.0], 0.0, f32::INFINITY);
    let mut guarded = Guarded::new(RTCRayHit::new(ray));
    // SAFETY: the scene is committed and the record is ours alone.
    unsafe { rtcIntersect1(scene, &raw mut guarded.record, null_mut()) };
    guarded.assert_intact();
    assert_eq!(guarded.record.ray.tfar, 3.0);
    assert_eq!(guarded.record.hit.instID, [0]);
    // An instance that is no array counts as an array of one.
    assert_eq!(guarded.record.hit.instPrimID, [0]);
}

#[test]
fn eight_rays_write_nothing_past_their_record() {
    const LANES: usize = 8;
    let mut embree = Embree::new();
    let triangle = embree.triangle();
    let scene = embree.instance(triangle, [0.0, 0.0, 1.0]);
    let columns = RTCRay8 {
        // Lanes alternate between a hit and a miss.
        org_x: [0.25, 0.75, 0.25, 0.75, 0.25, 0.75, 0.25, 0.75],
        org_y: [0.5, 0.75, 0.5, 0.75, 0.5, 0.75, 0.5, 0.75],
        org_z: [0.0; LANES],
        tnear: [0.0; LANES],
        dir_x: [0.0; LANES],
        dir_y: [0.0; LANES],
        dir_z: [1.0; LANES],
        time: [0.0; LANES],
        tfar: [f32::INFINITY; LANES],
        mask: [u32::MAX; LANES],
        id: [0; LANES],
        flags: [0; LANES],
    };
    let none = RTCHit8 {
        Ng_x: [0.0; LANES],
        Ng_y: [0.0; LANES],
        Ng_z: [0.0; LANES],
        u: [0.0; LANES],
        v: [0.0; LANES],
        primID: [RTC_INVALID_GEOMETRY_ID; LANES],
        geomID: [RTC_INVALID_GEOMETRY_ID; LANES],
        instID: [[RTC_INVALID_GEOMETRY_ID; LANES]],
        instPrimID: [[RTC_INVALID_GEOMETRY_ID; LANES]],
    };
    #[repr(C, align(32))]
    struct Valid([i32; LANES]);
    let valid = Valid([-1; LANES]);
    let mut guarded = Guarded::new(RTCRayHit8 { ray: columns, hit: none });
    // SAFETY: the scene is committed, `valid` is aligned as the packet is, and the record is ours alone.
    unsafe { rtcIntersect8(valid.0.as_ptr(), scene, &raw mut guarded.record, null_mut()) };
    guarded.assert_intact();
    for lane in 0..LANES {
        let (instance, distance) =
            if lane % 2 == 0 { (0, 3.0) } else { (RTC_INVALID_GEOMETRY_ID, f32::INFINITY) };
        assert_eq!(guarded.record.hit.instID[0][lane], instance, "lane {lane}");
        assert_eq!(guarded.record.ray.tfar[lane], distance, "lane {lane}");
    }
}

/// Embree's one instance level makes an instance within an instance vanish, and says nothing: whoever reads
/// scenes must flatten. Should this test fail one day, Embree has begun to follow them.
#[test]
fn an_instance_within_an_instance_is_missed_in_silence() {
    let mut embree = Embree::new();
    let triangle = embree.triangle();
    let once = embree.instance(triangle, [0.0, 0.0, 1.0]);
    let twice = embree.instance(once, [0.0, 0.0, 1.0]);
    assert_eq!(embree.closest(once, [0.25, 0.5, 0.0]).ray.tfar, 3.0);
    assert_eq!(embree.closest(twice, [0.25, 0.5, 0.0]).hit.geomID, RTC_INVALID_GEOMETRY_ID);
}

/// Refuses every candidate, and counts them in the context that the caller extended.
#[repr(C)]
struct CountingContext {
    base: RTCRayQueryContext,
    candidates: u32,
}

unsafe extern "C" fn refuse(arguments: *const RTCFilterFunctionNArguments) {
    // SAFETY: Embree passes arguments that live for the call.
    let arguments = unsafe { *arguments };
    assert_eq!(arguments.N, 1, "one ray was asked");
    // SAFETY: the query's context is the first field of a `CountingContext`.
    let context = unsafe { &mut *arguments.context.cast::<CountingContext>() };
    context.candidates += 1;
    // SAFETY: `valid` has `N` lanes, and `N` is 1.
    unsafe { *arguments.valid = 0 };
    assert_eq!(arguments.geometryUserPtr, without_provenance_mut(0));
}

#[test]
fn a_filter_in_the_arguments_refuses_hits() {
    let mut embree = Embree::new();
    let scene = embree.scene();
    // SAFETY: the scene is alive and not committed yet.
    unsafe { rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_FILTER_FUNCTION_IN_ARGUMENTS) };
    let triangle = embree.triangle();
    // SAFETY: the scene holds geometry 0.
    let geometry = unsafe { rtcGetGeometry(triangle, 0) };
    // SAFETY: both are alive and of this device.
    unsafe { rtcAttachGeometry(scene, geometry) };
    // SAFETY: no other thread knows the scene.
    unsafe { rtcCommitScene(scene) };
    assert!(embree.closest(scene, [0.25, 0.5, 0.0]).hit.geomID == 0, "hit without a filter");

    let mut context = CountingContext { base: RTCRayQueryContext::OUTSIDE, candidates: 0 };
    let mut arguments = RTCIntersectArguments {
        flags: RTC_RAY_QUERY_FLAG_INVOKE_ARGUMENT_FILTER,
        context: (&raw mut context).cast(),
        filter: Some(refuse),
        ..RTCIntersectArguments::DEFAULT
    };
    let ray = RTCRay::new([0.25, 0.5, 0.0], [0.0, 0.0, 1.0], 0.0, f32::INFINITY);
    let mut guarded = Guarded::new(RTCRayHit::new(ray));
    // SAFETY: the scene is committed; record, arguments and context are ours alone and outlive the call.
    unsafe { rtcIntersect1(scene, &raw mut guarded.record, &raw mut arguments) };
    embree.no_error();
    guarded.assert_intact();
    assert_eq!(guarded.record.hit.geomID, RTC_INVALID_GEOMETRY_ID);
    assert_eq!(context.candidates, 1);
    assert_eq!(context.base.instID, [RTC_INVALID_GEOMETRY_ID]);
}
