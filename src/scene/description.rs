//! The flat tables of a scene. An id is an index into one table and is a type of its own.

use crate::color::Rgb;
use crate::error::Location;
use crate::math::Transform;
use crate::scene::mesh::{MeshSource, PatchMesh};
use std::path::PathBuf;
use std::sync::Arc;

macro_rules! id {
    ($($(#[$doc:meta])* $name:ident),* $(,)?) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub struct $name(pub u32);
        impl $name {
            /// As an index into its table.
            #[inline(always)]
            #[must_use]
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }
    )*};
}

id! {
    /// Index into [`SceneDescription::meshes`].
    MeshId,
    /// Index into [`SceneDescription::patch_meshes`].
    PatchMeshId,
    /// Index into [`SceneDescription::materials`].
    MaterialId,
    /// Index into [`SceneDescription::textures`].
    TextureId,
    /// Index into [`SceneDescription::images`].
    ImageId,
    /// Index into [`SceneDescription::area_lights`].
    AreaLightId,
    /// Index into [`SceneDescription::media`].
    MediumId,
    /// Index into [`SceneDescription::objects`].
    ObjectId,
}

/// Everything a renderer needs to know, and nothing it has yet loaded.
#[derive(Clone, Debug, Default)]
pub struct SceneDescription {
    /// The file it came from.
    pub path: PathBuf,
    /// Camera.
    pub camera: Camera,
    /// Film size, crop and exposure.
    pub film: Film,
    /// Pixel filter.
    pub filter: Filter,
    /// Samples per pixel asked for by the file.
    pub spp: u32,
    /// Seed asked for by the file.
    pub seed: u64,
    /// Path integrator's bounds.
    pub integrator: Integrator,
    /// Triangle meshes, by where they come from.
    pub meshes: Vec<MeshSource>,
    /// Bilinear patch meshes.
    pub patch_meshes: Vec<Arc<PatchMesh>>,
    /// Shapes of the world.
    pub shapes: Vec<Shape>,
    /// Named objects for instancing: their shapes are in the object's own space.
    pub objects: Vec<Vec<Shape>>,
    /// Instances of objects in the world. Never nested: readers flatten.
    pub instances: Vec<Instance>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Textures, float and spectrum in one table; a float is grey.
    pub textures: Vec<Texture>,
    /// Image files that textures and lights refer to.
    pub images: Vec<ImageSource>,
    /// Emission of shapes.
    pub area_lights: Vec<AreaLight>,
    /// Lights without a shape.
    pub lights: Vec<Light>,
    /// Participating media.
    pub media: Vec<Medium>,
    /// The medium the camera stands in.
    pub camera_medium: Option<MediumId>,
    /// What is known to the format and not to us, and what stands in for it.
    pub warnings: Vec<Warning>,
}

/// One line for the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Where.
    pub at: Location,
    /// What it is and what stands in for it.
    pub message: String,
}

/// A shape with all that its attributes said.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Geometry.
    pub kind: ShapeKind,
    /// Object to world (to instance space inside an object).
    pub object_to_world: Transform,
    /// pbrt's `ReverseOrientation`: flips the geometric normal.
    pub reverse_orientation: bool,
    /// Material.
    pub material: MaterialId,
    /// Emission.
    pub area_light: Option<AreaLightId>,
    /// Opacity: below 1 the surface is absent with that probability.
    pub alpha: Option<TextureId>,
    /// Media on both sides; `None` when the surface does not separate media.
    pub medium: Option<MediumInterface>,
    /// Where it was declared.
    pub at: Location,
}

/// Geometry of a shape, pbrt's parameters.
#[derive(Clone, Debug, PartialEq)]
pub enum ShapeKind {
    /// Triangles.
    Mesh(MeshId),
    /// Bilinear patches.
    Patches(PatchMeshId),
    /// Sphere, possibly partial.
    Sphere {
        /// Radius.
        radius: f32,
        /// Lower clip.
        z_min: f32,
        /// Upper clip.
        z_max: f32,
        /// Sweep in degrees.
        phi_max_degrees: f32,
    },
    /// Disk or annulus.
    Disk {
        /// Height along z.
        height: f32,
        /// Outer radius.
        radius: f32,
        /// Inner radius.
        inner_radius: f32,
        /// Sweep in degrees.
        phi_max_degrees: f32,
    },
    /// Open cylinder around z.
    Cylinder {
        /// Radius.
        radius: f32,
        /// Lower end.
        z_min: f32,
        /// Upper end.
        z_max: f32,
        /// Sweep in degrees.
        phi_max_degrees: f32,
    },
}

/// An object placed in the world.
#[derive(Clone, Debug)]
pub struct Instance {
    /// Which object.
    pub object: ObjectId,
    /// Instance space to world.
    pub instance_to_world: Transform,
    /// Where it was declared.
    pub at: Location,
}

/// Media on the two sides of a surface; `None` is vacuum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MediumInterface {
    /// Against the geometric normal.
    pub inside: Option<MediumId>,
    /// Along the geometric normal.
    pub outside: Option<MediumId>,
}

/// A homogeneous medium, per world unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Medium {
    /// Absorption.
    pub sigma_a: Rgb,
    /// Scattering (known; not simulated yet, the reader warns).
    pub sigma_s: Rgb,
    /// Henyey-Greenstein asymmetry.
    pub g: f32,
}

/// Microfacet roughness. With `remap`, α = √roughness as pbrt-v4 has it; else the value is α.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roughness {
    /// Along u.
    pub u: TextureId,
    /// Along v.
    pub v: TextureId,
    /// Whether to remap.
    pub remap: bool,
}

impl Roughness {
    /// Below this α in both directions the surface is treated as a perfect mirror (pbrt-v4).
    pub const SMOOTH_BELOW: f32 = 1e-3;
}

/// pbrt-v4's materials with its parameters; ids refer to textures.
#[derive(Clone, Debug, PartialEq)]
pub enum Material {
    /// Lambertian reflection.
    Diffuse {
        /// Albedo.
        reflectance: TextureId,
    },
    /// Rough dielectric over a Lambertian base.
    CoatedDiffuse {
        /// Base albedo.
        reflectance: TextureId,
        /// Interface roughness.
        roughness: Roughness,
        /// Layer thickness (σt = 1 inside, pbrt's layered model).
        thickness: f32,
        /// Relative index of refraction.
        eta: f32,
        /// Interactions inside the layers before a path is dropped.
        max_depth: u32,
    },
    /// Metal by complex index of refraction.
    Conductor {
        /// Real part per channel.
        eta: TextureId,
        /// Imaginary part per channel.
        k: TextureId,
        /// Roughness.
        roughness: Roughness,
    },
    /// Metal by reflectance at normal incidence (pbrt: eta 1, k from r).
    ConductorReflectance {
        /// Reflectance at normal incidence.
        reflectance: TextureId,
        /// Roughness.
        roughness: Roughness,
    },
    /// Glass.
    Dielectric {
        /// Index of refraction inside over outside.
        eta: f32,
        /// Roughness.
        roughness: Roughness,
    },
    /// A pane with both interfaces.
    ThinDielectric {
        /// Index of refraction.
        eta: f32,
    },
    /// Lambertian reflection and transmission.
    DiffuseTransmission {
        /// Reflected albedo.
        reflectance: TextureId,
        /// Transmitted albedo.
        transmittance: TextureId,
        /// Factor on both.
        scale: f32,
    },
    /// One of two materials at each point: `b` with probability `amount`.
    Mix {
        /// Chosen with probability 1 − amount.
        a: MaterialId,
        /// Chosen with probability amount.
        b: MaterialId,
        /// Probability of `b`.
        amount: TextureId,
    },
    /// No scattering: only a boundary between media.
    Interface,
}

impl Material {
    /// The textures that it reads itself; a mix's sides read their own.
    #[must_use]
    pub fn textures(&self) -> Vec<TextureId> {
        match self {
            Self::Diffuse { reflectance } => vec![*reflectance],
            Self::CoatedDiffuse { reflectance, roughness, .. }
            | Self::ConductorReflectance { reflectance, roughness } => {
                vec![*reflectance, roughness.u, roughness.v]
            }
            Self::Conductor { eta, k, roughness } => vec![*eta, *k, roughness.u, roughness.v],
            Self::Dielectric { roughness, .. } => vec![roughness.u, roughness.v],
            Self::DiffuseTransmission { reflectance, transmittance, .. } => {
                vec![*reflectance, *transmittance]
            }
            Self::Mix { amount, .. } => vec![*amount],
            Self::ThinDielectric { .. } | Self::Interface => vec![],
        }
    }
}

/// How (u, v) of a texture follows from a hit.
#[derive(Clone, Debug, PartialEq)]
pub enum Mapping {
    /// st = scale · uv + delta.
    Uv {
        /// Scale.
        scale: [f32; 2],
        /// Offset.
        delta: [f32; 2],
    },
    /// Spherical: θ/π, φ/2π in texture space.
    Spherical {
        /// World to texture space.
        world_to_texture: Transform,
    },
    /// Cylindrical: φ/2π, z in texture space.
    Cylindrical {
        /// World to texture space.
        world_to_texture: Transform,
    },
    /// Planar: (p·v1 + du, p·v2 + dv) in texture space.
    Planar {
        /// World to texture space.
        world_to_texture: Transform,
        /// First axis.
        v1: [f32; 3],
        /// Second axis.
        v2: [f32; 3],
        /// Offset.
        delta: [f32; 2],
    },
}

/// Texel outside the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Wrap {
    /// Tile.
    #[default]
    Repeat,
    /// Black outside.
    Black,
    /// Edge texel.
    Clamp,
    /// Wrap of an octahedral map.
    OctahedralSphere,
}

pub use crate::settings::TextureFilter;

/// Transfer curve of 8-bit (and 16-bit) images.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum Encoding {
    /// sRGB for 8-bit files, linear for float files (pbrt's default).
    #[default]
    Srgb,
    /// Values as they are.
    Linear,
    /// A power.
    Gamma(f32),
}

impl Eq for Encoding {}

/// An image file and how its numbers are to be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageSource {
    /// File.
    pub path: PathBuf,
    /// Transfer curve.
    pub encoding: Encoding,
    /// The scene itself names the curve: it wins over what the file says of its own numbers.
    pub named: bool,
    /// Where it was asked for.
    pub at: Location,
}

/// Which number of an image a texture reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Channels {
    /// Red, green, blue.
    #[default]
    Rgb,
    /// For float textures: the average of RGB (or the single channel).
    Average,
    /// For alpha masks: alpha if the image has it, else the average.
    Alpha,
}

/// pbrt-v4's textures.
#[derive(Clone, Debug, PartialEq)]
pub enum Texture {
    /// The same everywhere.
    Constant(Rgb),
    /// An image.
    Image {
        /// Which.
        image: ImageId,
        /// Where.
        mapping: Mapping,
        /// Filter.
        filter: TextureFilter,
        /// Wrap.
        wrap: Wrap,
        /// Factor after lookup.
        scale: f32,
        /// 1 − value, after the scale.
        invert: bool,
        /// Channels.
        channels: Channels,
    },
    /// Product.
    Scale {
        /// One factor.
        texture: TextureId,
        /// The other.
        scale: TextureId,
    },
    /// (1 − amount) a + amount b.
    Mix {
        /// At amount 0.
        a: TextureId,
        /// At amount 1.
        b: TextureId,
        /// Blend.
        amount: TextureId,
    },
    /// amount·a + (1 − amount)·b with amount = |n·dir|.
    DirectionMix {
        /// Facing `dir`.
        a: TextureId,
        /// Across `dir`.
        b: TextureId,
        /// Unit direction in world space.
        dir: [f32; 3],
    },
    /// Box-filtered checkerboard in two dimensions.
    Checkerboard {
        /// Where.
        mapping: Mapping,
        /// Even squares.
        a: TextureId,
        /// Odd squares.
        b: TextureId,
    },
    /// Checkerboard in three dimensions, in texture space.
    Checkerboard3d {
        /// World to texture space.
        world_to_texture: Transform,
        /// Even cubes.
        a: TextureId,
        /// Odd cubes.
        b: TextureId,
    },
    /// Bilinear blend of four corner values.
    Bilerp {
        /// Where.
        mapping: Mapping,
        /// Values at (0,0), (0,1), (1,0), (1,1).
        corners: [Rgb; 4],
    },
}

impl Texture {
    /// Most textures that one look-up may visit: expressions share parts, so a page of text can name
    /// more than any machine evaluates.
    pub const MAX_NODES: u64 = 100_000;

    /// The textures that this one is made of.
    #[must_use]
    pub fn parts(&self) -> [Option<TextureId>; 3] {
        match self {
            Self::Constant(_) | Self::Image { .. } | Self::Bilerp { .. } => [None; 3],
            Self::Scale { texture: a, scale: b }
            | Self::DirectionMix { a, b, .. }
            | Self::Checkerboard { a, b, .. }
            | Self::Checkerboard3d { a, b, .. } => [Some(*a), Some(*b), None],
            Self::Mix { a, b, amount } => [Some(*a), Some(*b), Some(*amount)],
        }
    }
}

/// Emission of a shape.
#[derive(Clone, Debug, PartialEq)]
pub struct AreaLight {
    /// Radiance [W/(m² sr)] per channel, scale included.
    pub radiance: Rgb,
    /// Image of the radiance over (u, v), a factor on `radiance`.
    pub image: Option<ImageId>,
    /// Both sides emit.
    pub two_sided: bool,
    /// Total power in watts asked for; the renderer divides it by the area it finds.
    pub power: Option<f32>,
}

/// Lights without a shape.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "a scene has few lights without a shape")]
pub enum Light {
    /// Parallel light: irradiance on a facing surface is `irradiance`.
    Distant {
        /// Per channel.
        irradiance: Rgb,
        /// Unit vector towards the light, world space.
        towards: [f32; 3],
    },
    /// Isotropic point.
    Point {
        /// Radiant intensity per channel.
        intensity: Rgb,
        /// World space.
        position: [f32; 3],
    },
    /// Cone.
    Spot {
        /// Radiant intensity along the axis.
        intensity: Rgb,
        /// World space.
        position: [f32; 3],
        /// Unit axis, world space.
        axis: [f32; 3],
        /// Cosine of the angle where falloff begins.
        cos_falloff_start: f32,
        /// Cosine of the angle where light ends.
        cos_total_width: f32,
    },
    /// Constant radiance from everywhere.
    Constant {
        /// Per channel.
        radiance: Rgb,
    },
    /// Image-based light.
    Image {
        /// Radiance; equal-area octahedral when square (pbrt-v4), latitude-longitude when 2:1.
        image: ImageId,
        /// Factor per channel.
        scale: Rgb,
        /// Light space to world.
        light_to_world: Transform,
        /// Target illuminance, if the scene asks for one: the image is scaled to it.
        illuminance: Option<f32>,
    },
}

/// Camera kinds with pbrt's parameters.
#[derive(Clone, Debug, PartialEq)]
pub enum CameraKind {
    /// Pinhole or thin lens; `fov_degrees` spans the shorter image axis.
    Perspective {
        /// Field of view of the shorter axis.
        fov_degrees: f32,
    },
    /// Parallel projection.
    Orthographic,
    /// All directions; `equal_area` chooses the octahedral mapping over latitude-longitude.
    Spherical {
        /// pbrt-v4's default mapping is equal-area.
        equal_area: bool,
    },
}

/// A camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Projection.
    pub kind: CameraKind,
    /// Camera to world; the camera looks along +z with +y up (pbrt).
    pub camera_to_world: Transform,
    /// Lens radius; 0 is a pinhole.
    pub lens_radius: f32,
    /// Distance in perfect focus.
    pub focal_distance: f32,
    /// Screen window x0, x1, y0, y1; `None` follows from the aspect ratio.
    pub screen_window: Option<[f32; 4]>,
    /// Frame aspect ratio; `None` follows from the film.
    pub frame_aspect_ratio: Option<f32>,
    /// Shutter time in seconds (open to close), for exposure.
    pub exposure_seconds: f32,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            kind: CameraKind::Perspective { fov_degrees: 90.0 },
            camera_to_world: Transform::IDENTITY,
            lens_radius: 0.0,
            focal_distance: 1e6,
            screen_window: None,
            frame_aspect_ratio: None,
            exposure_seconds: 1.0,
        }
    }
}

/// Film.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    /// Full size in pixels.
    pub size: (u32, u32),
    /// Crop window in pixels: x0, y0, x1, y1 (exclusive).
    pub crop: [u32; 4],
    /// Output file the scene asks for.
    pub filename: Option<PathBuf>,
    /// Factor from radiance to stored value: pbrt's imaging ratio, exposure time × ISO / 100.
    pub imaging_ratio: f32,
    /// Linear transform of sensor RGB for a white balance, rows; identity when none.
    pub white_balance: [[f32; 3]; 3],
    /// Samples with a larger component are scaled down to it.
    pub max_component_value: f32,
}

impl Default for Film {
    fn default() -> Self {
        Self {
            size: (1280, 720),
            crop: [0, 0, 1280, 720],
            filename: None,
            imaging_ratio: 1.0,
            white_balance: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            max_component_value: f32::INFINITY,
        }
    }
}

/// Pixel filters, pbrt's parameters; radii in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filter {
    /// Constant.
    Box {
        /// Radii.
        radius: [f32; 2],
    },
    /// Tent.
    Triangle {
        /// Radii.
        radius: [f32; 2],
    },
    /// Gaussian less its value at the radius.
    Gaussian {
        /// Radii.
        radius: [f32; 2],
        /// Standard deviation.
        sigma: f32,
    },
    /// Mitchell and Netravali 1988.
    Mitchell {
        /// Radii.
        radius: [f32; 2],
        /// B.
        b: f32,
        /// C.
        c: f32,
    },
    /// Windowed sinc (Lanczos).
    Sinc {
        /// Radii.
        radius: [f32; 2],
        /// τ.
        tau: f32,
    },
}

impl Default for Filter {
    fn default() -> Self {
        Self::Gaussian { radius: [1.5, 1.5], sigma: 0.5 }
    }
}

/// Bounds of the path integrator.
#[derive(Clone, Debug, PartialEq)]
pub struct Integrator {
    /// Scattering events; 0 shows emission only.
    pub max_depth: u32,
    /// Paths below this throughput play Russian roulette (pbrt: 1 for the path integrator).
    pub rr_threshold: f32,
}

impl Default for Integrator {
    fn default() -> Self {
        Self { max_depth: 5, rr_threshold: 1.0 }
    }
}
