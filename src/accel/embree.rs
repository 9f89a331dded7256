//! Embree through FFI: the only room that speaks C. One device, one scene for the world, one
//! scene an object. Instances are one level deep (`RTC_MAX_INSTANCE_LEVEL_COUNT` is 1, and a
//! nested instance would miss in silence), which the types here make unspeakable: an object is
//! made of [`Geometry`], never of instances.
//!
//! Invariant: vertex and index memory given to [`EmbreeScene::new`] outlives the scene; the
//! lifetime `'a` holds that. Queries write only into the 96-byte record on their own stack.

use super::{Accel, Custom, Geometry, Hit, InstanceOf, NONE, Ray};
use crate::error::{Error, Result};
use embree4_sys as rtc;
use glam::Vec3;
use std::ffi::{c_int, c_uint, c_void};
use std::marker::PhantomData;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

/// Mirrors what a geometry's callbacks need; boxed so that its address is stable.
struct User<'a> {
    custom: &'a dyn Custom,
    name: u32,
    alpha: bool,
}

/// An Embree device, and the bytes its memory monitor counts. One serves all scenes of a render:
/// with two, TBB's idle workers of the one were seen to spin while the other traced.
pub struct EmbreeDevice {
    handle: rtc::RTCDevice,
    /// Boxed, the callback holds its address.
    bytes: Box<AtomicI64>,
}

// SAFETY: device calls made here are thread-safe (Embree API reference, "rtcNewDevice").
unsafe impl Send for EmbreeDevice {}
// SAFETY: as above; the counter is atomic.
unsafe impl Sync for EmbreeDevice {}

/// A committed world.
pub struct EmbreeScene<'a> {
    device: Arc<EmbreeDevice>,
    world: rtc::RTCScene,
    objects: Vec<rtc::RTCScene>,
    /// Geometries of the world scene; ids from here on are instances.
    geometry_count: u32,
    /// Callback data, referred to by raw pointers inside Embree.
    #[expect(clippy::vec_box, reason = "Embree holds the address of each, which a growing Vec would move")]
    users: Vec<Box<User<'a>>>,
    /// The vertex memory that Embree shares.
    _shared: PhantomData<&'a [[f32; 3]]>,
}

// SAFETY: Embree scenes are immutable after commit, and its query functions may be called from
// any number of threads on a committed scene (Embree API reference, "rtcIntersect1").
unsafe impl Send for EmbreeScene<'_> {}
// SAFETY: as above; the monitor's counter is atomic and `Custom` is `Sync`.
unsafe impl Sync for EmbreeScene<'_> {}

/// How to build.
#[derive(Clone, Copy, Debug, Default)]
pub struct BuildOptions {
    /// Embree's robust traversal: about a fifth slower, fewer misses at edges.
    pub robust: bool,
    /// Worker threads of the build.
    pub threads: usize,
}

impl EmbreeDevice {
    /// Opens Embree without worker threads of its own: ours build and trace.
    ///
    /// # Errors
    /// [`Error::Resource`] when Embree is older than 4.3 or newer than 4.
    pub fn new() -> Result<Arc<Self>> {
        // SAFETY: the string is NUL-terminated and static.
        let handle = unsafe { rtc::rtcNewDevice(c"threads=1,set_affinity=0".as_ptr()) };
        if handle.is_null() {
            return Err(Error::Resource("Embree could not create a device".into()));
        }
        let device = Self { handle, bytes: Box::new(AtomicI64::new(0)) };
        let v = device.version_number();
        if !(40300..50000).contains(&v) {
            return Err(Error::Resource(format!(
                "Embree {} is loaded; Weir needs 4.3 or later, below 5 (run `make embree`)",
                device.version()
            )));
        }
        // SAFETY: the counter is boxed and freed only after the device is released in `drop`.
        unsafe {
            rtc::rtcSetDeviceMemoryMonitorFunction(
                handle,
                Some(memory_monitor),
                std::ptr::from_ref::<AtomicI64>(&device.bytes).cast_mut().cast(),
            );
        }
        Ok(Arc::new(device))
    }

    fn version_number(&self) -> isize {
        // SAFETY: the device is live.
        unsafe { rtc::rtcGetDeviceProperty(self.handle, rtc::RTC_DEVICE_PROPERTY_VERSION) }
    }

    /// Embree's version as it prints it.
    #[must_use]
    pub fn version(&self) -> String {
        let v = self.version_number();
        format!("{}.{}.{}", v / 10000, v / 100 % 100, v % 100)
    }

    /// Bytes that all scenes of this device hold.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed).max(0).unsigned_abs()
    }

    fn check(&self, doing: &str) -> Result<()> {
        // SAFETY: the device is live.
        let e = unsafe { rtc::rtcGetDeviceError(self.handle) };
        match e {
            rtc::RTC_ERROR_NONE => Ok(()),
            rtc::RTC_ERROR_OUT_OF_MEMORY => Err(Error::Resource(format!("out of memory while {doing}"))),
            e => Err(Error::Resource(format!("Embree reports error {e} while {doing}"))),
        }
    }
}

impl Drop for EmbreeDevice {
    fn drop(&mut self) {
        // SAFETY: ours, released once; scenes hold an `Arc` of it and are gone.
        unsafe { rtc::rtcReleaseDevice(self.handle) };
    }
}

/// Threads worth starting to build over `geometry`.
fn builders(geometry: &[Geometry<'_>], threads: usize) -> usize {
    let primitives: usize = geometry
        .iter()
        .map(|g| match g {
            Geometry::Triangles { indices, .. } => indices.len(),
            Geometry::Custom { count, .. } => *count as usize,
            Geometry::Pages { .. } => 0,
        })
        .sum();
    // Some 5 ms of building each.
    threads.min(1 + primitives / 20_000)
}

/// Builds a scene with `threads` of ours.
fn commit(scene: rtc::RTCScene, threads: usize) {
    /// A scene's handle on its way to another thread.
    struct Handle(rtc::RTCScene);
    // SAFETY: Embree allows any number of threads to join one commit.
    unsafe impl Send for Handle {}
    std::thread::scope(|scope| {
        for _ in 1..threads {
            let handle = Handle(scene);
            let build = move || {
                let handle = handle;
                // SAFETY: the scene is live until the scope ends.
                unsafe { rtc::rtcJoinCommitScene(handle.0) };
            };
            // A thread that the system refuses is one fewer.
            if std::thread::Builder::new().spawn_scoped(scope, build).is_err() {
                break;
            }
        }
        // SAFETY: the scene is live.
        unsafe { rtc::rtcJoinCommitScene(scene) };
    });
}

impl<'a> EmbreeScene<'a> {
    /// Builds acceleration structures over `world` and `objects`, with `instances` of the latter.
    ///
    /// # Errors
    /// [`Error::Resource`] when Embree runs out of memory.
    pub fn new(
        device: &Arc<EmbreeDevice>,
        world: &[Geometry<'a>],
        objects: &[Vec<Geometry<'a>>],
        instances: &[InstanceOf],
        custom: &'a dyn Custom,
        options: BuildOptions,
    ) -> Result<Self> {
        let mut scene = Self {
            device: Arc::clone(device),
            world: std::ptr::null_mut(),
            objects: Vec::with_capacity(objects.len()),
            geometry_count: c_uint::try_from(world.len()).expect("ids are u32"),
            users: Vec::new(),
            _shared: PhantomData,
        };
        for object in objects {
            let s = scene.new_scene(options);
            scene.objects.push(s);
            for g in object {
                scene.attach(s, g, custom)?;
            }
            commit(s, builders(object, options.threads));
        }
        scene.world = scene.new_scene(options);
        for g in world {
            scene.attach(scene.world, g, custom)?;
        }
        for i in instances {
            scene.attach_instance(i);
        }
        commit(scene.world, builders(world, options.threads));
        device.check("building the acceleration structure")?;
        Ok(scene)
    }

    fn new_scene(&self, options: BuildOptions) -> rtc::RTCScene {
        // SAFETY: the device is live.
        let s = unsafe { rtc::rtcNewScene(self.device.handle) };
        if options.robust {
            // SAFETY: `s` was made above.
            unsafe { rtc::rtcSetSceneFlags(s, rtc::RTC_SCENE_FLAG_ROBUST) };
        }
        s
    }

    fn attach(&mut self, scene: rtc::RTCScene, g: &Geometry<'a>, custom: &'a dyn Custom) -> Result<()> {
        let kind = match g {
            Geometry::Triangles { .. } => rtc::RTC_GEOMETRY_TYPE_TRIANGLE,
            Geometry::Custom { .. } => rtc::RTC_GEOMETRY_TYPE_USER,
            Geometry::Pages { .. } => {
                return Err(Error::Usage(
                    "Embree keeps all geometry in memory; --geometry-memory needs --backend native".into(),
                ));
            }
        };
        // SAFETY: the device is live.
        let geometry = unsafe { rtc::rtcNewGeometry(self.device.handle, kind) };
        match *g {
            Geometry::Triangles { positions, indices, alpha } => {
                Self::share(geometry, positions, indices);
                if let Some(name) = alpha {
                    self.set_user(geometry, User { custom, name, alpha: true });
                    // SAFETY: the callback has the signature Embree asks for and the user data
                    // set above.
                    unsafe { rtc::rtcSetGeometryIntersectFilterFunction(geometry, Some(filter)) };
                    // SAFETY: as above.
                    unsafe { rtc::rtcSetGeometryOccludedFilterFunction(geometry, Some(filter)) };
                }
            }
            Geometry::Custom { count, user, alpha } => {
                // SAFETY: the geometry is of the user type.
                unsafe { rtc::rtcSetGeometryUserPrimitiveCount(geometry, count) };
                self.set_user(geometry, User { custom, name: user, alpha });
                // SAFETY: signature and user data as Embree asks.
                unsafe {
                    rtc::rtcSetGeometryBoundsFunction(geometry, Some(custom_bounds), std::ptr::null_mut());
                }
                // SAFETY: as above.
                unsafe { rtc::rtcSetGeometryIntersectFunction(geometry, Some(custom_intersect)) };
                // SAFETY: as above.
                unsafe { rtc::rtcSetGeometryOccludedFunction(geometry, Some(custom_occluded)) };
            }
            Geometry::Pages { .. } => unreachable!("refused above"),
        }
        // SAFETY: all buffers are set.
        unsafe { rtc::rtcCommitGeometry(geometry) };
        // SAFETY: both live; ids are given in the order of attachment.
        unsafe { rtc::rtcAttachGeometry(scene, geometry) };
        // SAFETY: the scene holds its own reference now.
        unsafe { rtc::rtcReleaseGeometry(geometry) };
        self.device.check("adding geometry")
    }

    fn share(geometry: rtc::RTCGeometry, positions: &'a [[f32; 3]], indices: &'a [[u32; 3]]) {
        // SAFETY: the slice outlives the scene ('a), and `Geometry::Triangles` asks of the caller
        // that 16 bytes are readable at the last vertex.
        unsafe {
            rtc::rtcSetSharedGeometryBuffer(
                geometry,
                rtc::RTC_BUFFER_TYPE_VERTEX,
                0,
                rtc::RTC_FORMAT_FLOAT3,
                positions.as_ptr().cast(),
                0,
                12,
                positions.len(),
            );
        }
        // SAFETY: the slice outlives the scene ('a); indices were validated by the reader.
        unsafe {
            rtc::rtcSetSharedGeometryBuffer(
                geometry,
                rtc::RTC_BUFFER_TYPE_INDEX,
                0,
                rtc::RTC_FORMAT_UINT3,
                indices.as_ptr().cast(),
                0,
                12,
                indices.len(),
            );
        }
    }

    fn set_user(&mut self, geometry: rtc::RTCGeometry, user: User<'a>) {
        let user = Box::new(user);
        // SAFETY: the box lives in `users` until the device is released.
        unsafe {
            rtc::rtcSetGeometryUserData(geometry, std::ptr::from_ref(&*user).cast_mut().cast());
        }
        self.users.push(user);
    }

    fn attach_instance(&self, instance: &InstanceOf) {
        // SAFETY: the device is live.
        let g = unsafe { rtc::rtcNewGeometry(self.device.handle, rtc::RTC_GEOMETRY_TYPE_INSTANCE) };
        // SAFETY: the object's scene is committed and kept in `objects`.
        unsafe { rtc::rtcSetGeometryInstancedScene(g, self.objects[instance.object as usize]) };
        // SAFETY: twelve floats, column-major, as the format says.
        unsafe {
            rtc::rtcSetGeometryTransform(
                g,
                0,
                rtc::RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR,
                instance.transform.as_ptr().cast(),
            );
        }
        // SAFETY: complete.
        unsafe { rtc::rtcCommitGeometry(g) };
        // SAFETY: both live.
        unsafe { rtc::rtcAttachGeometry(self.world, g) };
        // SAFETY: the scene holds its own reference.
        unsafe { rtc::rtcReleaseGeometry(g) };
    }
}

impl Drop for EmbreeScene<'_> {
    fn drop(&mut self) {
        if !self.world.is_null() {
            // SAFETY: ours, released once.
            unsafe { rtc::rtcReleaseScene(self.world) };
        }
        for &s in &self.objects {
            // SAFETY: ours, released once.
            unsafe { rtc::rtcReleaseScene(s) };
        }
    }
}

#[inline(always)]
fn to_rtc(ray: &Ray) -> rtc::RTCRay {
    rtc::RTCRay {
        org_x: ray.origin.x,
        org_y: ray.origin.y,
        org_z: ray.origin.z,
        tnear: ray.t_min,
        dir_x: ray.direction.x,
        dir_y: ray.direction.y,
        dir_z: ray.direction.z,
        time: 0.0,
        tfar: ray.t_max,
        mask: !0,
        id: 0,
        flags: 0,
    }
}

impl Accel for EmbreeScene<'_> {
    #[inline(always)]
    fn closest(&self, ray: &Ray) -> Hit {
        let mut record = rtc::RTCRayHit {
            ray: to_rtc(ray),
            hit: rtc::RTCHit {
                Ng_x: 0.0,
                Ng_y: 0.0,
                Ng_z: 0.0,
                u: 0.0,
                v: 0.0,
                primID: NONE,
                geomID: NONE,
                instID: [NONE],
                instPrimID: [NONE],
            },
        };
        // SAFETY: a committed scene and a 16-byte aligned record of 96 bytes on this stack.
        unsafe { rtc::rtcIntersect1(self.world, &mut record, std::ptr::null_mut()) };
        let instance = record.hit.instID[0];
        Hit {
            t: record.ray.tfar,
            u: record.hit.u,
            v: record.hit.v,
            geometry: record.hit.geomID,
            primitive: record.hit.primID,
            instance: if instance == NONE { NONE } else { instance - self.geometry_count },
            place: NONE,
        }
    }

    #[inline(always)]
    fn occluded(&self, ray: &Ray) -> bool {
        let mut r = to_rtc(ray);
        // SAFETY: a committed scene and a 16-byte aligned record of 48 bytes on this stack.
        unsafe { rtc::rtcOccluded1(self.world, &mut r, std::ptr::null_mut()) };
        r.tfar < 0.0
    }

    fn bytes(&self) -> u64 {
        self.device.bytes()
    }

    fn bounds(&self) -> (Vec3, Vec3) {
        let mut b = rtc::RTCBounds::default();
        // SAFETY: a committed scene and a bounds record on this stack.
        unsafe { rtc::rtcGetSceneBounds(self.world, &mut b) };
        (Vec3::new(b.lower_x, b.lower_y, b.lower_z), Vec3::new(b.upper_x, b.upper_y, b.upper_z))
    }
}

/// Embree tells how many bytes it takes and gives back.
unsafe extern "C" fn memory_monitor(counter: *mut c_void, bytes: isize, _post: bool) -> bool {
    // SAFETY: the pointer is the boxed counter set in `EmbreeScene::new`.
    let counter = unsafe { &*counter.cast::<AtomicI64>() };
    counter.fetch_add(bytes as i64, Ordering::Relaxed);
    true
}

fn ray_of(r: &rtc::RTCRay) -> Ray {
    Ray {
        origin: Vec3::new(r.org_x, r.org_y, r.org_z),
        direction: Vec3::new(r.dir_x, r.dir_y, r.dir_z),
        t_min: r.tnear,
        t_max: r.tfar,
    }
}

unsafe extern "C" fn custom_bounds(args: *const rtc::RTCBoundsFunctionArguments) {
    // SAFETY: Embree passes valid arguments.
    let args = unsafe { &*args };
    // SAFETY: the pointer was set by `set_user` and its box lives as long as the scene.
    let user = unsafe { &*args.geometryUserPtr.cast_const().cast::<User<'_>>() };
    let (lo, hi) = user.custom.bounds(user.name, args.primID);
    // SAFETY: Embree passes a valid output record.
    let out = unsafe { &mut *args.bounds_o };
    *out = rtc::RTCBounds {
        lower_x: lo.x,
        lower_y: lo.y,
        lower_z: lo.z,
        align0: 0.0,
        upper_x: hi.x,
        upper_y: hi.y,
        upper_z: hi.z,
        align1: 0.0,
    };
}

unsafe extern "C" fn custom_intersect(args: *const rtc::RTCIntersectFunctionNArguments) {
    // SAFETY: Embree passes valid arguments.
    let args = unsafe { &*args };
    debug_assert_eq!(args.N, 1, "only single-ray queries are made");
    // SAFETY: set by `set_user`.
    let user = unsafe { &*args.geometryUserPtr.cast_const().cast::<User<'_>>() };
    // SAFETY: with N = 1 the record is one RTCRayHit.
    let record = unsafe { &mut *args.rayhit.cast::<rtc::RTCRayHit>() };
    let ray = ray_of(&record.ray);
    let Some((t, u, v)) = user.custom.intersect(user.name, args.primID, &ray) else { return };
    if user.alpha && !user.custom.is_opaque(user.name, args.primID, (t, u, v), &ray) {
        return;
    }
    // SAFETY: Embree passes the query's context.
    let context = unsafe { &*args.context };
    record.ray.tfar = t;
    record.hit.u = u;
    record.hit.v = v;
    record.hit.geomID = args.geomID;
    record.hit.primID = args.primID;
    record.hit.instID = context.instID;
    record.hit.instPrimID = context.instPrimID;
}

unsafe extern "C" fn custom_occluded(args: *const rtc::RTCOccludedFunctionNArguments) {
    // SAFETY: Embree passes valid arguments.
    let args = unsafe { &*args };
    debug_assert_eq!(args.N, 1, "only single-ray queries are made");
    // SAFETY: set by `set_user`.
    let user = unsafe { &*args.geometryUserPtr.cast_const().cast::<User<'_>>() };
    // SAFETY: with N = 1 the record is one RTCRay.
    let r = unsafe { &mut *args.ray.cast::<rtc::RTCRay>() };
    let ray = ray_of(r);
    if let Some(hit) = user.custom.intersect(user.name, args.primID, &ray)
        && (!user.alpha || user.custom.is_opaque(user.name, args.primID, hit, &ray))
    {
        r.tfar = f32::NEG_INFINITY;
    }
}

unsafe extern "C" fn filter(args: *const rtc::RTCFilterFunctionNArguments) {
    // SAFETY: Embree passes valid arguments.
    let args = unsafe { &*args };
    debug_assert_eq!(args.N, 1, "only single-ray queries are made");
    // SAFETY: set by `set_user`.
    let user = unsafe { &*args.geometryUserPtr.cast_const().cast::<User<'_>>() };
    // SAFETY: with N = 1 the record is one RTCRay.
    let ray = ray_of(unsafe { &*args.ray.cast::<rtc::RTCRay>() });
    // SAFETY: with N = 1 the record is one RTCHit.
    let hit = unsafe { &*args.hit.cast::<rtc::RTCHit>() };
    // While a filter runs, the ray ends at the hit it is asked about.
    if !user.custom.is_opaque(user.name, hit.primID, (ray.t_max, hit.u, hit.v), &ray) {
        // SAFETY: with N = 1 there is one valid flag.
        let valid: &mut c_int = unsafe { &mut *args.valid };
        *valid = 0;
    }
}
