//! What a scene takes in memory, by its description and the headers of its meshes.
//!
//! Invariant: counts are those of the description; bytes a primitive are measured, and say by which command.
//! Never opens a file.

use super::{all_shapes, is_visible};
use crate::scene::ply::MeshFacts;
use crate::scene::{Cage, Film, MeshSource, SceneDescription, Shape, ShapeKind, Strand, TriangleMesh};
use crate::settings::{Backend, RenderSettings};

/// Triangles from which on a mesh is cut into pages: those of smaller ones would be mostly empty.
pub const LEAST_PAGED: u64 = 1024;

/// What geometry takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GeometryBytes {
    /// Vertices, attributes and acceleration structures, all of them resident.
    pub whole: u64,
    /// The same by the largest figures that were measured, for who must not promise too little.
    pub whole_most: u64,
    /// Beside that, while acceleration structures are built.
    pub building: u64,
    /// Likewise where large meshes come and go.
    pub building_staying: u64,
    /// What stays where large meshes come and go: the others, outlines of pages and what finds them.
    pub staying: u64,
    /// All pages.
    pub pages: u64,
    /// Triangles and other primitives.
    pub primitives: u64,
    /// Those that shine.
    pub shining: u64,
    /// The number of triangles of every mesh is known, not guessed.
    pub exact: bool,
}

/// What an acceleration structure takes. From `weir compare SCENE --rounds 0 --json FILE` on `weir generate city`,
/// `forest` and `terrain` of 300,000 and 2,000,000 triangles: native 52.1 to 58.2 bytes a primitive, of which 187 an instance
/// in the forest; Embree 4.4 62.9 to 76.9, of which 405 an instance.
struct Tree {
    primitive: u64,
    instance: u64,
    /// A structure of its own, for an object.
    object: u64,
    /// What intersects itself.
    custom: u64,
}

impl Tree {
    fn of(backend: Backend) -> Self {
        match backend {
            Backend::Native => Self { primitive: 52, instance: 187, object: 256, custom: 92 },
            Backend::Embree => Self { primitive: 66, instance: 405, object: 512, custom: 120 },
        }
    }

    /// The most: small trees are emptier, and Embree rounds what it takes up to blocks.
    fn most(backend: Backend) -> Self {
        match backend {
            Backend::Native => Self { primitive: 60, instance: 260, object: 1024, custom: 320 },
            Backend::Embree => Self { primitive: 80, instance: 640, object: 8192, custom: 512 },
        }
    }
}

/// Embree's own, whatever it builds.
const EMBREE_BASE: u64 = 1 << 20;
/// Of a primitive beside its tree while that is built: 25 to 30 bytes, by `memory.peak_rss` less `peak_accounted` of `weir
/// SCENE --spp 1 --size 64x36 --stats FILE` on the same scenes, less the 25 MB that any render takes.
const BUILDING: u64 = 32;
/// Of a triangle in a page, its vertices' attributes and padding apart: `weir SCENE --geometry-memory 40M` on the same.
const PAGE_TRIANGLE: f64 = 68.0;
/// Vertices on the border of two pages are in both.
const SHARED_VERTICES: f64 = 1.2;
/// Of a page: its head, and what the next leaf had no room in; 4.8 MB of pages of 4 KiB are 5.3 MB for it.
const PAGE_UNUSED: u64 = 400;
/// Of a page that is away: its outline, and what finds it.
const PAGE_STAYS: u64 = 120 + 8 + 32 + 64;
/// Of a triangle in a page that is made: its share of a piece.
const MADE_STAYS: u64 = 2;
/// Of a run of a curve, and of the frame that each begins with but the first of a strand.
const RUN: u64 = 44;
const FRAME: u64 = 64;
/// Of a surface that is neither mesh nor patches.
const QUADRIC: u64 = 320;

/// What the geometry of `scene` takes with `backend`, in pages of `page_bytes`. `headers` are of its meshes.
#[must_use]
pub fn geometry_bytes(
    scene: &SceneDescription,
    headers: &[MeshFacts],
    backend: Backend,
    page_bytes: u64,
) -> GeometryBytes {
    let (tree, most) = (Tree::of(backend), Tree::most(backend));
    let base = if backend == Backend::Embree { EMBREE_BASE } else { 4096 };
    let mut all = GeometryBytes { exact: true, whole_most: base, ..GeometryBytes::default() };
    let visible = |shape: &&Shape| is_visible(scene, shape);
    for shape in all_shapes(scene).filter(visible) {
        let mut pages = 0;
        let (columns, primitives, custom) = match &shape.kind {
            ShapeKind::Mesh(id) => {
                let source = &scene.meshes[id.index()];
                let facts = mesh_facts(source, headers.get(id.index()));
                all.exact &= facts.exact;
                if is_pageable(shape, source, &facts) {
                    pages = page_count(&facts, page_bytes);
                    all.staying += control_bytes(source, &facts);
                }
                // The last vertex has room behind it.
                (12 + facts.vertices * facts.vertex_bytes + 12 * facts.triangles, facts.triangles, false)
            }
            ShapeKind::Patches(id) => {
                let p = &scene.patch_meshes[id.index()];
                let vertices = 12 * (p.positions.len() + p.normals.len()) + 8 * p.uvs.len();
                ((vertices + 16 * p.indices.len()) as u64, p.indices.len() as u64, true)
            }
            _ => (QUADRIC, 1, true),
        };
        // What shines is in a tree of its own, too.
        let trees = 1 + u64::from(shape.area_light.is_some());
        let of = |t: &Tree| columns + trees * primitives * if custom { t.custom } else { t.primitive };
        all.whole += of(&tree);
        all.whole_most += of(&most);
        all.building += trees * primitives * BUILDING;
        all.primitives += primitives;
        all.shining += if shape.area_light.is_some() { primitives } else { 0 };
        if pages > 0 {
            all.pages += pages * page_bytes;
            all.staying += pages * PAGE_STAYS;
        } else {
            all.staying += of(&most);
            all.building_staying += trees * primitives * BUILDING;
        }
    }
    let (objects, instances) = (scene.objects.len() as u64, scene.instances.len() as u64);
    all.whole += objects * tree.object + instances * tree.instance;
    let placed = (objects + 1) * most.object + instances * most.instance;
    all.whole_most += placed;
    all.staying += placed;
    all
}

/// Whether all of `shape` is at hand, whatever the memory: lights are sampled on it, or a mask is read.
#[must_use]
pub fn has_to_stay(shape: &Shape) -> bool {
    shape.area_light.is_some() || shape.alpha.is_some()
}

/// Most faces at a vertex of a subdivision surface that is made part by part: each part there takes all of them, at every
/// level.
pub const MOST_FACES_AT_A_VERTEX: usize = 256;

/// Bytes of a triangle that is made and stays, at least: its corners, half a vertex of 32 bytes, and 52 of its tree.
pub const STAYING_TRIANGLE: u64 = 80;

/// Whether so many triangles are worth pages, when `staying` bytes of what they are made of stay.
#[must_use]
pub fn are_worth_pages(triangles: u64, staying: u64) -> bool {
    triangles >= LEAST_PAGED && 2 * staying <= triangles * STAYING_TRIANGLE
}

fn is_pageable(shape: &Shape, source: &MeshSource, facts: &MeshFacts) -> bool {
    let part_by_part = match source {
        // What the scene's file says is there anyway.
        MeshSource::Inline(_) => false,
        MeshSource::Subdivision { cage, .. } => cage.most_at_a_vertex() <= MOST_FACES_AT_A_VERTEX,
        MeshSource::Ply(_) | MeshSource::Displaced { .. } | MeshSource::Curves(_) => true,
    };
    part_by_part && !has_to_stay(shape) && are_worth_pages(facts.triangles, control_bytes(source, facts))
}

/// Of what a shape is made of, page by page, beside the scene's description; a displaced mesh's base is not known here.
fn control_bytes(source: &MeshSource, facts: &MeshFacts) -> u64 {
    match source {
        MeshSource::Inline(_) | MeshSource::Ply(_) => 0,
        MeshSource::Subdivision { cage: Cage::Loop(control), .. } => {
            25 * control.positions.len() as u64 + 36 * control.indices.len() as u64
        }
        // It is kept refined once.
        MeshSource::Subdivision { cage: cage @ Cage::CatmullClark(control), .. } => {
            25 * cage.vertices(1) + 48 * control.corners.len() as u64
        }
        MeshSource::Displaced { .. } => facts.triangles * MADE_STAYS,
        // A segment has a run at least.
        MeshSource::Curves(strands) => {
            let runs = |segments: u64| RUN * segments + FRAME * segments.saturating_sub(1);
            facts.triangles * MADE_STAYS + strands.iter().map(|s| runs(s.points.len() as u64)).sum::<u64>()
        }
    }
}

fn page_count(facts: &MeshFacts, page_bytes: u64) -> u64 {
    let attributes = facts.vertex_bytes.saturating_sub(12) * facts.vertices;
    let bytes = facts.triangles as f64 * PAGE_TRIANGLE + attributes as f64 * SHARED_VERTICES;
    (bytes / page_bytes.saturating_sub(PAGE_UNUSED).max(1) as f64).ceil() as u64
}

fn mesh_facts(source: &MeshSource, header: Option<&MeshFacts>) -> MeshFacts {
    match source {
        MeshSource::Ply(_) | MeshSource::Displaced { .. } | MeshSource::Curves(_) => {
            header.copied().unwrap_or_default()
        }
        MeshSource::Inline(mesh) => MeshFacts {
            vertices: mesh.positions.len() as u64,
            vertex_bytes: columns(mesh) / mesh.positions.len().max(1) as u64,
            triangles: mesh.indices.len() as u64,
            exact: true,
        },
        // Limit normals come with the points.
        MeshSource::Subdivision { cage, levels } => MeshFacts {
            vertices: cage.vertices(*levels),
            vertex_bytes: 24,
            triangles: cage.triangles(*levels),
            exact: true,
        },
    }
}

/// Pixels of the film a triangle, of the square of an edge's most pixels. Edges are between half of it and all, and there
/// is what is hidden, seen aslant or out of view: 0.07 for a terrain, 0.12 for a sphere.
const TRIANGLE_PIXELS: f64 = 0.08;

/// What is expected of a displaced mesh whose base has this `header`, on a film of `pixels` and with edges of
/// `edge_pixels`: a guess, as if it filled the film once. Its vertices are not read before it is loaded.
#[must_use]
pub fn displaced_facts(source: &MeshSource, header: &MeshFacts, pixels: f64, edge_pixels: f64) -> MeshFacts {
    let MeshSource::Displaced { base, .. } = source else { return *header };
    let base = mesh_facts(base, Some(header));
    let triangles = base.triangles + (pixels / (TRIANGLE_PIXELS * edge_pixels * edge_pixels)) as u64;
    // Half as many vertices as triangles, with normals and texture coordinates.
    MeshFacts { vertices: base.vertices.max(triangles / 2), vertex_bytes: 32, triangles, exact: false }
}

/// Bytes of the vertices.
fn columns(mesh: &TriangleMesh) -> u64 {
    let TriangleMesh { positions, normals, uvs, tangents, indices: _ } = mesh;
    (12 * (positions.len() + normals.len() + tangents.len()) + 8 * uvs.len()) as u64
}

/// The film's sums, and the finished image: 16 and 12 bytes a pixel, and 40 for each tile of 8×8. A pass that is cut short
/// is kept apart where it may be continued (16 and 40), and squares of sums where they tell the error (12).
#[must_use]
pub fn film_bytes(film: &Film, settings: &RenderSettings) -> u64 {
    let [x0, y0, x1, y1] = film.crop;
    let (w, h) = (u64::from(x1.saturating_sub(x0)), u64::from(y1.saturating_sub(y0)));
    let (pixel, tile) = match (settings.noise, &settings.checkpoint) {
        (Some(_), _) => (16 + 12, 40),
        (None, Some(_)) => (16, 40),
        (None, None) => (0, 0),
    };
    w * h * (16 + 12 + pixel) + w.div_ceil(8) * h.div_ceil(8) * (40 + tile)
}

/// Of a shape and of what is made of it beside its vertices: its surface in three tables, and its name.
const SHAPE_TABLES: u64 = size_of::<Shape>() as u64 + 512;

/// Of a light: itself, and its place in the tree of lights.
const LIGHT: u64 = 320;

/// What sampling lights takes: `environments` are the bytes of their images, `shining` the primitives that shine.
#[must_use]
pub fn light_bytes(scene: &SceneDescription, environments: u64, shining: u64) -> u64 {
    environments + (shining + scene.lights.len() as u64) * LIGHT
}

/// What a mesh takes before it is loaded.
fn source_bytes(mesh: &MeshSource) -> u64 {
    let own = match mesh {
        MeshSource::Inline(mesh) | MeshSource::Subdivision { cage: Cage::Loop(mesh), .. } => {
            columns(mesh) + 12 * mesh.indices.len() as u64
        }
        MeshSource::Subdivision { cage: Cage::CatmullClark(mesh), .. } => {
            (12 * mesh.positions.len() + 4 * (mesh.corners.len() + mesh.ends.len())) as u64
        }
        MeshSource::Ply(path) => path.as_os_str().len() as u64,
        MeshSource::Displaced { base, .. } => source_bytes(base),
        MeshSource::Curves(strands) => strands.iter().map(Strand::bytes).sum(),
    };
    own + size_of::<MeshSource>() as u64
}

/// The tables of the description, and what other rooms keep in proportion to them.
#[must_use]
pub fn description_bytes(scene: &SceneDescription) -> u64 {
    let mut bytes = 64 << 10;
    for mesh in &scene.meshes {
        bytes += source_bytes(mesh);
    }
    for p in &scene.patch_meshes {
        bytes += (12 * (p.positions.len() + p.normals.len()) + 8 * p.uvs.len() + 16 * p.indices.len()) as u64;
    }
    bytes += SHAPE_TABLES * all_shapes(scene).count() as u64;
    let rest = [
        scene.instances.len() * 3 * size_of::<crate::scene::Instance>(),
        // Read, copied, and compiled.
        scene.textures.len() * 3 * size_of::<crate::scene::Texture>(),
        scene.materials.len() * 4 * size_of::<crate::scene::Material>(),
        // A table of 256 numbers each.
        scene.images.len() * (1024 + 512),
        scene.lights.len() * 2 * size_of::<crate::scene::Light>(),
        scene.media.len() * 2 * size_of::<crate::scene::Medium>(),
    ];
    bytes + rest.iter().sum::<usize>() as u64
}
