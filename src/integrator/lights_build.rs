//! Turns the scene's lights and emitting surfaces into what [`Lights`] samples. Runs once.

use crate::color::{Rgb, luminance};
use crate::error::{Error, Result};
use crate::geometry::{SceneGeometry, Surface, SurfaceShape};
use crate::integrator::light::cylinder::Cylinder;
use crate::integrator::light::delta::DeltaLight;
use crate::integrator::light::disk::Disk;
use crate::integrator::light::env::{EnvFilter, EnvMapping, EnvironmentMap};
use crate::integrator::light::parallelogram::merge_triangles;
use crate::integrator::light::patch::Patch;
use crate::integrator::light::sphere::Sphere;
use crate::integrator::light::tree::{LightBounds, LightTree};
use crate::integrator::lights::{Bounded, Emitter, Infinite, Lights, NO_LIGHT, Opacity, Place};
use crate::math::Transform;
use crate::scene::{AreaLight, Channels, ImageId, Light, SceneDescription, ShapeKind, TextureFilter, Wrap};
use crate::texture::{Footprint, Sampler, Textures, read_image};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::f32::consts::PI;
use std::sync::Arc;

/// Reads the images of image-based lights, in the order of the scene's lights.
///
/// # Errors
/// An image that cannot be read or does not fit a mapping.
pub fn load_environments(scene: &SceneDescription) -> Result<Vec<EnvironmentMap>> {
    let read = |light: &Light| -> Option<Result<EnvironmentMap>> {
        let Light::Image { image, light_to_world, .. } = light else { return None };
        let source = &scene.images[image.index()];
        Some(read_image(&source.path).and_then(|data| {
            let (w, h) = (data.width as usize, data.height as usize);
            // pbrt-v4's maps are square and equal-area; anything else is latitude and longitude.
            let mapping = if w == h { EnvMapping::EqualAreaOctahedral } else { EnvMapping::LatLong };
            let texels = data.linear_rgb(source.encoding);
            EnvironmentMap::new(texels, w, h, mapping, EnvFilter::Nearest, light_to_world)
                .map_err(|message| Error::at(&source.at, message))
        }))
    };
    scene.lights.par_iter().filter_map(read).collect::<Vec<_>>().into_iter().collect()
}

impl Lights {
    /// Collects the lights of a scene; `environments` as [`load_environments`] gave them.
    #[must_use]
    pub fn new(
        scene: &SceneDescription,
        geometry: &SceneGeometry,
        textures: &Arc<Textures>,
        environments: Vec<EnvironmentMap>,
    ) -> Self {
        let mut build = Build::for_geometry(geometry);
        build.free_standing(scene, environments);
        for (i, surface) in geometry.surfaces.iter().enumerate().take(geometry.world_count) {
            if let Some(id) = surface.area_light {
                build.emitter(i, surface, &scene.area_lights[id.index()], textures);
            }
        }
        let tree = LightTree::new(&build.bounds);
        let choices = build.infinite.len() + usize::from(tree.is_some());
        Lights {
            emitters: build.emitters,
            single: build.bounded.len() == 1 && build.infinite.is_empty(),
            choose_infinite: build.infinite.len() as f32 / choices.max(1) as f32,
            bounded: build.bounded,
            tree,
            infinite: build.infinite,
            constant: build.constant,
            textures: Arc::clone(textures),
            textured_corners: build.textured_corners,
        }
    }
}

struct Build<'a> {
    geometry: &'a SceneGeometry,
    emitters: Vec<Emitter>,
    bounded: Vec<Bounded>,
    bounds: Vec<LightBounds>,
    infinite: Vec<Infinite>,
    constant: Rgb,
    textured_corners: Vec<(u32, [Vec2; 4])>,
}

/// A light of a surface before it is entered.
struct Candidate {
    place: Place,
    /// Corners, for bounds; empty for round shapes.
    corners: Vec<Vec3>,
    area: f32,
    /// Normal on the emitting side.
    n: Vec3,
    flip: bool,
}

impl<'a> Build<'a> {
    fn for_geometry(geometry: &'a SceneGeometry) -> Self {
        Self {
            geometry,
            emitters: Vec::new(),
            bounded: Vec::new(),
            bounds: Vec::new(),
            infinite: Vec::new(),
            constant: Rgb::ZERO,
            textured_corners: Vec::new(),
        }
    }

    fn free_standing(&mut self, scene: &SceneDescription, environments: Vec<EnvironmentMap>) {
        let mut environments = environments.into_iter();
        for light in &scene.lights {
            match *light {
                Light::Constant { radiance } => self.constant += radiance,
                Light::Distant { irradiance, towards } => {
                    self.infinite.push(Infinite::Distant { irradiance, towards: towards.into() });
                }
                Light::Point { intensity, position } => {
                    let position = Vec3::from(position);
                    let light = DeltaLight::Point { intensity, position };
                    let power = luminance(light.power(0.0));
                    self.delta(light, LightBounds::round(position, position, power));
                }
                Light::Spot { intensity, position, axis, cos_falloff_start, cos_total_width } => {
                    let (position, axis) = (Vec3::from(position), Vec3::from(axis));
                    let light =
                        DeltaLight::Spot { intensity, position, axis, cos_falloff_start, cos_total_width };
                    let power = luminance(light.power(0.0));
                    let bounds = LightBounds::spot(position, axis, power, cos_falloff_start, cos_total_width);
                    self.delta(light, bounds);
                }
                Light::Image { scale, illuminance, light_to_world, .. } => {
                    let map = environments.next().expect("one environment was read for each image light");
                    let mut scale = scale;
                    if let Some(target) = illuminance {
                        let up = light_to_world.vector(Vec3::Z).normalize_or_zero();
                        let got = luminance(map.irradiance(up));
                        if got > 0.0 {
                            scale *= target / got;
                        }
                    }
                    self.infinite.push(Infinite::Image { map: Box::new(map), scale });
                }
            }
        }
    }

    fn delta(&mut self, light: DeltaLight, bounds: LightBounds) {
        self.bounded.push(Bounded {
            place: Place::Delta(light),
            radiance: Rgb::ZERO,
            flip: false,
            emitter: 0,
            opacity: Opacity::Solid,
        });
        self.bounds.push(bounds);
    }

    fn emitter(&mut self, index: usize, surface: &Surface, light: &AreaLight, textures: &Textures) {
        let emitter = self.emitters.len() as u32;
        let sides = if light.two_sided { 2.0 } else { 1.0 };
        let image_mean = light.image.map_or(1.0, |id| mean_luminance(textures, id));
        let mut light_by_primitive = Vec::new();
        let opacity = match surface.alpha.map(|t| (t, textures.constant(t))) {
            None => Opacity::Solid,
            Some((_, Some(a))) if a.x >= 1.0 => Opacity::Solid,
            Some((_, Some(a))) if a.x <= 0.0 => Opacity::Hidden,
            Some((t, _)) => Opacity::Texture(t),
        };
        let textured = light.image.is_some() || matches!(opacity, Opacity::Texture(_));
        for (candidate, primitives) in self.candidates(surface, textured) {
            let Some(candidate) = candidate else {
                light_by_primitive.extend(std::iter::repeat_n(NO_LIGHT, primitives));
                continue;
            };
            let mut radiance = light.radiance;
            // pbrt-v4: the power asked for is that of each shape (each triangle of a mesh), and
            // `radiance` then carries colour and scale.
            if let Some(power) = light.power {
                let area = candidate.area / primitives as f32;
                radiance *= power / (PI * area * sides * image_mean);
            }
            let id = self.bounded.len() as u32;
            light_by_primitive.extend(std::iter::repeat_n(id, primitives));
            let power = luminance(radiance) * candidate.area * PI * sides * image_mean;
            self.bounds.push(if candidate.corners.is_empty() {
                let (lo, hi) = crate::accel::Custom::bounds(self.geometry, index as u32, 0);
                LightBounds::round(lo, hi, power)
            } else {
                LightBounds::flat(&candidate.corners, candidate.n, power, light.two_sided)
            });
            if textured && let Some(corners) = corner_uvs(surface, light_by_primitive.len() - 1) {
                self.textured_corners.push((id, corners));
            }
            let (place, flip) = (candidate.place, candidate.flip);
            self.bounded.push(Bounded { place, radiance, flip, emitter, opacity });
        }
        self.emitters.push(Emitter {
            surface: index as u32,
            two_sided: light.two_sided,
            image: light.image,
            light_by_primitive,
        });
    }

    /// The lights of a surface, each with the number of primitives it covers; `None` for what has
    /// no area.
    fn candidates(&self, surface: &Surface, textured: bool) -> Vec<(Option<Candidate>, usize)> {
        match &surface.shape {
            SurfaceShape::Paged(_) => unreachable!("meshes that shine are not paged"),
            SurfaceShape::Mesh(mesh) => {
                let corners = |i: usize| mesh.indices[i].map(|k| Vec3::from(mesh.positions[k as usize]));
                let emits_along = |i: usize| {
                    let [a, b, c] = corners(i);
                    let mut n = (b - a).cross(c - a).normalize_or_zero();
                    let shading: Vec3 = if mesh.normals.is_empty() {
                        Vec3::ZERO
                    } else {
                        mesh.indices[i].iter().map(|&k| Vec3::from(mesh.normals[k as usize])).sum()
                    };
                    if shading == Vec3::ZERO {
                        if surface.flip_normal {
                            n = -n;
                        }
                    } else if shading.dot(n) < 0.0 {
                        n = -n;
                    }
                    n
                };
                let mut list = Vec::new();
                let mut i = 0;
                while i < mesh.indices.len() {
                    let t = corners(i);
                    let n = emits_along(i);
                    if !textured && i + 1 < mesh.indices.len() && emits_along(i + 1).dot(n) > 0.0 {
                        let other = corners(i + 1);
                        if let Some(q) = merge_triangles(t, other) {
                            let flip = q.n().dot(n) < 0.0;
                            let area = q.area();
                            let all = t.into_iter().chain(other).collect();
                            let place = Place::Parallelogram(q);
                            list.push((Some(Candidate { place, corners: all, area, n, flip }), 2));
                            i += 2;
                            continue;
                        }
                    }
                    let cross = (t[1] - t[0]).cross(t[2] - t[0]);
                    let candidate = Candidate {
                        place: Place::Triangle(t),
                        corners: t.to_vec(),
                        area: cross.length() * 0.5,
                        n,
                        flip: cross.dot(n) < 0.0,
                    };
                    list.push((Some(candidate), 1));
                    i += 1;
                }
                list
            }
            SurfaceShape::Patches(patches) => (0..patches.indices.len())
                .map(|i| {
                    let c = patches.indices[i].map(|k| Vec3::from(patches.positions[k as usize]));
                    let Some(patch) = Patch::new(c[0], c[1], c[2], c[3]) else { return (None, 1) };
                    let (_, du, dv) = patches.at(i as u32, 0.5, 0.5);
                    let n = du.cross(dv).normalize_or_zero().as_vec3();
                    let n = if surface.flip_normal { -n } else { n };
                    let area = patch.area();
                    let place = Place::Patch(patch);
                    let flip = surface.flip_normal;
                    (Some(Candidate { place, corners: c.to_vec(), area, n, flip }), 1)
                })
                .collect(),
            SurfaceShape::Quadric(q) => {
                vec![(quadric(&q.shape, &q.to_world, surface.flip_normal), 1)]
            }
        }
    }
}

fn quadric(shape: &ShapeKind, to_world: &Transform, flip: bool) -> Option<Candidate> {
    let (place, area, flat) = match *shape {
        ShapeKind::Sphere { radius, z_min, z_max, phi_max_degrees } => {
            let s = Sphere::new(to_world, radius, z_min, z_max, phi_max_degrees)?;
            let area = s.area();
            (Place::Sphere(s), area, None)
        }
        ShapeKind::Disk { height, radius, inner_radius, phi_max_degrees } => {
            let s = Disk::new(to_world, height, radius, inner_radius, phi_max_degrees)?;
            let area = s.area();
            let corner = |x: f32, y: f32| to_world.point(Vec3::new(x * radius, y * radius, height));
            let corners = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0)];
            (Place::Disk(s), area, Some(corners))
        }
        ShapeKind::Cylinder { radius, z_min, z_max, phi_max_degrees } => {
            let s = Cylinder::new(to_world, radius, z_min, z_max, phi_max_degrees)?;
            let area = s.area();
            (Place::Cylinder(s), area, None)
        }
        ShapeKind::Mesh(_) | ShapeKind::Patches(_) => return None,
    };
    let n = to_world.normal(Vec3::Z).normalize_or_zero();
    let n = if flip { -n } else { n };
    Some(Candidate { place, corners: flat.unwrap_or_default(), area, n, flip })
}

/// Texture coordinates that a mesh gives the corners of a primitive; a triangle has its third twice.
fn corner_uvs(surface: &Surface, primitive: usize) -> Option<[Vec2; 4]> {
    match &surface.shape {
        SurfaceShape::Mesh(m) if !m.uvs.is_empty() => {
            let [a, b, c] = m.indices[primitive].map(|i| Vec2::from(m.uvs[i as usize]));
            Some([a, b, c, c])
        }
        SurfaceShape::Patches(p) if !p.uvs.is_empty() => {
            Some(p.indices[primitive].map(|i| Vec2::from(p.uvs[i as usize])))
        }
        _ => None,
    }
}

/// Mean luminance of an image's texels.
fn mean_luminance(textures: &Textures, image: ImageId) -> f32 {
    let Some((w, h)) = textures.store().size(image) else { return 0.0 };
    let sampler = Sampler { filter: TextureFilter::Point, wrap: Wrap::Clamp, channels: Channels::Rgb };
    let mut sum = 0.0f64;
    for y in 0..h {
        for x in 0..w {
            let uv = Vec2::new((x as f32 + 0.5) / w as f32, (y as f32 + 0.5) / h as f32);
            let texel = textures.store().lookup(image, uv, Footprint::default(), sampler);
            sum += f64::from(luminance(texel));
        }
    }
    (sum / (f64::from(w) * f64::from(h))) as f32
}
