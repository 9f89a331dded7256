//! Reads every mesh of a scene in parallel, brings it into world space, and lists surfaces in the
//! order the acceleration structure will know them by.

use super::made::{self, Making};
use super::pages::{Made, PageMaker, PageSource, PageStore, Source, Tessellated};
use super::place::{place_mesh, place_normals};
use super::{Mesh, Patches, PlacedInstance, Quadric, Surface, SurfaceShape};
use crate::accel::{Geometry, Hit, InstanceOf};
use crate::error::Result;
use crate::math::Transform;
use crate::prepare::{has_to_stay, is_visible};
use crate::scene::{MeshSource, SceneDescription, Shape, ShapeKind, TextureId};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::path::PathBuf;

/// Evaluates an opacity texture; given by the room that owns the textures.
pub trait Opacity: Sync + Send {
    /// Opacity in [0, 1] at texture coordinates and position.
    fn opacity(&self, texture: TextureId, uv: Vec2, p: Vec3) -> f32;
}

/// Everything at rest: surfaces of the world first, then those of each object in turn.
pub struct SceneGeometry {
    /// All surfaces.
    pub surfaces: Vec<Surface>,
    /// How many of them are the world's own.
    pub world_count: usize,
    /// Objects as ranges of surfaces.
    pub objects: Vec<std::ops::Range<usize>>,
    /// Placed objects.
    pub instances: Vec<PlacedInstance>,
    /// For alpha masks; `None` when no surface has one.
    pub opacity: Option<Box<dyn Opacity>>,
    /// Where paged meshes come from; `None` when all geometry stays.
    pub pages: Option<PageStore>,
    /// Most bytes that were lent to make pages.
    pub making_bytes: u64,
    /// One line each: what a person should know of what was made.
    pub notes: Vec<String>,
}

/// Which geometry stays and which comes and goes.
#[derive(Clone, Debug)]
pub struct Paging {
    /// Bytes of all geometry.
    pub budget: u64,
    /// Most bytes that meshes are cut in; `None`: what follows from the budget.
    pub cut_in: Option<u64>,
    /// All of it is expected to fit where it has so many triangles and other primitives at most; `None`: it is not.
    pub whole: Option<u64>,
    /// Threads that look at pages at the same time, at most.
    pub threads: usize,
    /// Bytes of a page.
    pub page_bytes: usize,
    /// Where page files are kept; `None`: the user's cache directory.
    pub cache_dir: Option<PathBuf>,
}

/// Loads the shapes of `scene`; `making` is for those that are made. `stop` is asked while meshes are cut into pages,
/// or divided, which may take long.
///
/// # Errors
/// [`Interrupted`](crate::error::Error::Interrupted) when `stop` says so. The first mesh, in the scene's order, that cannot be read.
pub fn load(
    scene: &SceneDescription,
    paging: Option<&Paging>,
    making: &Making<'_>,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<SceneGeometry> {
    let Some(paging) = paging else { return load_with(scene, None, making, stop) };
    let mut too_large = None;
    if let Some(expected) = paging.whole {
        match load_with(scene, None, making, stop) {
            Ok(geometry) => {
                let primitives = geometry.primitive_count();
                if primitives <= expected || geometry.bytes() + TREE_BYTES * primitives <= paging.budget {
                    return Ok(geometry);
                }
            }
            // What is too large as a whole may do in pages.
            Err(e) if making.was_too_large() => too_large = Some(e),
            Err(e) => return Err(e),
        }
    }
    let maker = PageMaker::new(paging.cache_dir.as_deref(), paging.page_bytes, paging.budget);
    let mut maker = maker.map_err(|e| too_large.unwrap_or(e))?;
    maker = maker.for_threads(paging.threads);
    if let Some(bytes) = paging.cut_in {
        maker = maker.within(bytes);
    }
    load_with(scene, Some((maker, paging.page_bytes)), making, stop)
}

/// Of a primitive's share of the tree, where what was expected of meshes was a guess: 51 to 60 for triangles (`weir
/// compare`), and as much again for the tree of those that shine.
const TREE_BYTES: u64 = 128;

fn load_with(
    scene: &SceneDescription,
    maker: Option<(PageMaker, usize)>,
    making: &Making<'_>,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<SceneGeometry> {
    let visible = |s: &&Shape| is_visible(scene, s);
    let places = made::all_places(scene);
    let (of_world, of_objects) = places.split_last().expect("the world comes last");
    let of = |places| move |shape| (shape, places);
    let mut shapes: Vec<(&Shape, &[Transform])> =
        scene.shapes.iter().filter(visible).map(of(&of_world[..])).collect();
    let world_count = shapes.len();
    let mut objects = Vec::with_capacity(scene.objects.len());
    for (object, places) in scene.objects.iter().zip(of_objects) {
        let start = shapes.len();
        shapes.extend(object.iter().filter(visible).map(of(&places[..])));
        objects.push(start..shapes.len());
    }
    // Collected as results first, so that the error reported is the first in the scene's order.
    let loaded: Vec<Result<Loaded>> = shapes
        .par_iter()
        .map(|(shape, places)| surface(scene, shape, places, maker.as_ref().map(|m| &m.0), making, stop))
        .collect();
    let loaded = loaded.into_iter().collect::<Result<Vec<_>>>()?;
    let (mut files, mut notes) = (Vec::new(), Vec::new());
    let mut first = 0;
    let surfaces = loaded
        .into_iter()
        .map(|(mut surface, file, note)| {
            notes.extend(note);
            if let SurfaceShape::Paged(mesh) = &mut surface.shape {
                mesh.first = first;
                first += mesh.outlines.len() as u32;
            }
            files.extend(file);
            surface
        })
        .collect();
    let making_bytes = maker.as_ref().map_or(0, |(maker, _)| maker.most_lent());
    let pages = match maker {
        Some((_, page_bytes)) if !files.is_empty() => Some(PageStore::new(files, page_bytes)?),
        _ => None,
    };
    let instances = scene
        .instances
        .iter()
        .filter(|i| !objects[i.object.index()].is_empty())
        .map(|i| PlacedInstance {
            to_world: i.instance_to_world,
            object: i.object.0,
            surface_base: u32::try_from(objects[i.object.index()].start)
                .expect("surfaces are counted in u32"),
        })
        .collect();
    Ok(SceneGeometry { surfaces, world_count, objects, instances, opacity: None, pages, making_bytes, notes })
}

/// A surface, where its pages are if it is paged, and what a person should know of it.
type Loaded = (Surface, Option<PageSource>, Option<String>);

fn surface(
    scene: &SceneDescription,
    shape: &Shape,
    places: &[Transform],
    maker: Option<&PageMaker>,
    making: &Making<'_>,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<Loaded> {
    let to_world = &shape.object_to_world;
    let flip = shape.reverse_orientation ^ to_world.swaps_handedness();
    let (kind, file, note) = match &shape.kind {
        ShapeKind::Mesh(id) => {
            let maker = maker.filter(|_| !has_to_stay(shape));
            mesh(&scene.meshes[id.index()], shape, places, maker, making, stop)?
        }
        ShapeKind::Patches(id) => {
            let p = &scene.patch_meshes[id.index()];
            let patches = Patches {
                positions: p.positions.iter().map(|&v| to_world.point(v.into()).to_array()).collect(),
                normals: place_normals(p.normals.clone(), to_world, shape.reverse_orientation),
                uvs: p.uvs.clone(),
                indices: p.indices.clone(),
            };
            (SurfaceShape::Patches(patches), None, None)
        }
        kind => {
            let quadric = Quadric::new(kind, *to_world);
            let quadric = quadric.expect("shapes that are neither mesh nor patches are quadrics");
            (SurfaceShape::Quadric(quadric), None, None)
        }
    };
    let surface = Surface {
        shape: kind,
        material: shape.material,
        flip_normal: flip,
        area_light: shape.area_light,
        alpha: shape.alpha,
        medium: shape.medium,
    };
    Ok((surface, file, note))
}

/// A mesh as it is or in pages, which `maker` makes, where they are then, and what a person should know of it.
fn mesh(
    source: &MeshSource,
    shape: &Shape,
    places: &[Transform],
    maker: Option<&PageMaker>,
    making: &Making<'_>,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(SurfaceShape, Option<PageSource>, Option<String>)> {
    let (to_world, reverse) = (&shape.object_to_world, shape.reverse_orientation);
    let not_numbers =
        |values: &str| format!("{}: {values} of its displacement are no numbers; 0 stands in", shape.at);
    match (maker, source) {
        (Some(maker), MeshSource::Ply(path)) => {
            let source = Source { path, to_world, reverse };
            // Named before it is read: what is read may be newer, never older.
            let named = maker.name(&source)?;
            let made = match maker.find(&named) {
                Some((mesh, file)) => Made::Pages(mesh, file),
                None => maker.make(&source, &named, stop)?,
            };
            return Ok(match made {
                Made::Pages(mesh, file) => (SurfaceShape::Paged(mesh), Some(PageSource::File(file)), None),
                Made::Stays(mesh) => (SurfaceShape::Mesh(mesh), None, None),
            });
        }
        (Some(maker), _) => {
            let pieces = made::in_pieces(source, shape, places, making, maker.piece_triangles(), stop)?;
            let what = Tessellated { name: shape.at.to_string(), to_world, reverse, stop };
            if let Some(pieces) = pieces
                && let Some((mesh, pages)) = maker.tessellate(pieces, what)?
            {
                let note = pages.not_numbers().then(|| not_numbers("values"));
                let pages = PageSource::Made(Box::new(pages));
                return Ok((SurfaceShape::Paged(mesh), Some(pages), note));
            }
        }
        (None, _) => {}
    }
    let made = made::make(source, shape, places, making, stop)?;
    let count = made.not_numbers;
    let note = (count > 0).then(|| not_numbers(&format!("{count} values")));
    Ok((SurfaceShape::Mesh(place_mesh(made.mesh, to_world, reverse)), None, note))
}

impl SceneGeometry {
    /// Bytes of vertices and attributes, and of what pages are made of.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let control = self.pages.as_ref().map_or(0, PageStore::control_bytes);
        let surfaces = self
            .surfaces
            .iter()
            .map(|s| match &s.shape {
                SurfaceShape::Mesh(m) => m.bytes(),
                SurfaceShape::Paged(m) => size_of_val(&m.outlines[..]),
                SurfaceShape::Patches(p) => {
                    12 * (p.positions.len() + p.normals.len()) + 8 * p.uvs.len() + 16 * p.indices.len()
                }
                SurfaceShape::Quadric(_) => size_of::<Surface>(),
            } as u64)
            .sum::<u64>();
        control + surfaces
    }

    /// Calls `look` with the triangle that was hit on a paged mesh, as a mesh of its own and a hit on that.
    pub(super) fn with_paged<R>(&self, hit: &Hit, look: impl FnOnce(&Mesh, &Hit) -> R) -> R {
        let pages = self.pages.as_ref().expect("paged meshes have a store of pages");
        pages.with_triangle(hit.place, |mesh| look(mesh, &Hit { primitive: 0, ..*hit }))
    }

    /// Triangles and other primitives, instances not multiplied.
    #[must_use]
    pub fn primitive_count(&self) -> u64 {
        self.surfaces
            .iter()
            .map(|s| match &s.shape {
                SurfaceShape::Mesh(m) => m.indices.len() as u64,
                SurfaceShape::Paged(m) => m.triangles,
                SurfaceShape::Patches(p) => p.indices.len() as u64,
                SurfaceShape::Quadric(_) => 1,
            })
            .sum()
    }

    fn described(&self, range: std::ops::Range<usize>) -> Vec<Geometry<'_>> {
        range
            .map(|i| {
                let user = u32::try_from(i).expect("surfaces are counted in u32");
                let s = &self.surfaces[i];
                match &s.shape {
                    SurfaceShape::Mesh(m) => Geometry::Triangles {
                        positions: &m.positions,
                        indices: &m.indices,
                        alpha: s.alpha.map(|_| user),
                    },
                    SurfaceShape::Paged(m) => Geometry::Pages { first: m.first, outlines: &m.outlines },
                    SurfaceShape::Patches(p) => Geometry::Custom {
                        count: u32::try_from(p.indices.len()).expect("primitives are counted in u32"),
                        user,
                        alpha: s.alpha.is_some(),
                    },
                    SurfaceShape::Quadric(_) => Geometry::Custom { count: 1, user, alpha: s.alpha.is_some() },
                }
            })
            .collect()
    }

    /// The emitting surfaces of the world, for a traversal of their own. Hits in it name no
    /// surface: it answers only whether there is any.
    #[must_use]
    pub fn describe_emitters(&self) -> Vec<Geometry<'_>> {
        (0..self.world_count)
            .filter(|&i| self.surfaces[i].area_light.is_some())
            .flat_map(|i| self.described(i..i + 1))
            .collect()
    }

    /// What a backend builds from: the world, the objects, the instances.
    #[must_use]
    pub fn for_backend(&self) -> (Vec<Geometry<'_>>, Vec<Vec<Geometry<'_>>>, Vec<InstanceOf>) {
        let world = self.described(0..self.world_count);
        let objects = self.objects.iter().map(|r| self.described(r.clone())).collect();
        let instances = self
            .instances
            .iter()
            .map(|i| {
                let m = i.to_world.m.as_mat4();
                let mut transform = [0.0; 12];
                for (column, axis) in
                    transform.chunks_exact_mut(3).zip([m.x_axis, m.y_axis, m.z_axis, m.w_axis])
                {
                    column.copy_from_slice(&[axis.x, axis.y, axis.z]);
                }
                InstanceOf { object: i.object, transform }
            })
            .collect();
        (world, objects, instances)
    }
}
