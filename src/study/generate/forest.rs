//! `forest`: a path between spruces, birches and oaks, all of them instances of a few plants, on
//! ground of its own. Invariant: plants that do not fit the triangles asked for are left out, never
//! cut. Never paints.

use super::city_text::write_places;
use super::forest_land::{Floor, crowd, write_bark, write_leaves};
use super::ground::{Ground, Warp};
use super::image_out::{TextureFormat, texture_bytes};
use super::mesh_out::{Mesh, count, write_mesh};
use super::noise::{Random, smoothstep, turn};
use super::plant::{Species, Tree, stone, tuft};
use super::sky::Sky;
use super::{Job, Plan, Recipe, directory};
use crate::error::{Error, Result};
use std::io::{self, Write};
use std::sync::Arc;

const MAX_TEXELS: f64 = 16_384.0;
/// Texels a side of a plant's leaves.
const MAX_LEAF_TEXELS: f64 = 8192.0;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Growth {
    Tree(Species),
    Tuft,
    Stone,
}

/// One object and where it stands.
struct Plant {
    name: String,
    growth: Growth,
    seed: u32,
    tree: Option<Tree>,
    /// Blades of a tuft, or divisions of a stone.
    count: u32,
    places: Vec<[f32; 6]>,
}

impl Plant {
    /// Its meshes: name, whether with normals, description.
    fn parts(&self) -> Vec<(&'static str, bool, super::city_text::Build)> {
        let (seed, n) = (self.seed, self.count);
        match (self.growth, self.tree) {
            (Growth::Tree(_), Some(tree)) => vec![
                ("wood", true, Arc::new(move |m: &mut Mesh| tree.wood(m))),
                ("leaves", false, Arc::new(move |m: &mut Mesh| tree.foliage(m))),
            ],
            (Growth::Stone, _) => vec![("stone", false, Arc::new(move |m: &mut Mesh| stone(seed, n, m)))],
            _ => vec![("blades", false, Arc::new(move |m: &mut Mesh| tuft(seed, n, (0.55, 0.36), m)))],
        }
    }

    /// Its two extremes of leaf colour.
    fn leaf_colours(&self) -> ([f32; 3], [f32; 3]) {
        match self.growth {
            Growth::Tree(Species::Spruce) => ([78.0, 104.0, 62.0], [116.0, 138.0, 76.0]),
            Growth::Tree(Species::Oak) => ([132.0, 142.0, 60.0], [200.0, 160.0, 72.0]),
            Growth::Tree(Species::Birch) => ([190.0, 160.0, 64.0], [212.0, 186.0, 92.0]),
            Growth::Tree(Species::Bush) => ([108.0, 132.0, 62.0], [178.0, 124.0, 64.0]),
            _ => ([88.0, 108.0, 46.0], [156.0, 146.0, 80.0]),
        }
    }
}

/// Decides the scene.
pub(super) fn plan(recipe: &Recipe) -> Result<Plan> {
    let seed = recipe.hash_seed();
    let floor = Arc::new(Floor { seed });
    let mut plants = plants(recipe);
    place(&floor, &mut plants);
    plants.retain(|p| !p.places.is_empty());
    let format = recipe.format;
    let (mut jobs, mut triangles, mut instanced) = (Vec::new(), 0, 0);
    for plant in &plants {
        for (part, normals, build) in plant.parts() {
            let own = count(|mesh| build(mesh));
            triangles += own;
            instanced += own * plant.places.len() as u64;
            let name = format!("{}/{}-{part}.ply", directory::MESHES, plant.name);
            jobs.push(Job::new(name, own * 60, move |path| write_mesh(path, normals, |mesh| build(mesh))));
        }
    }
    let mut bytes = 0;
    let side = (recipe.texture_bytes as f64 * 0.4 / (12.0 * plants.len().max(1) as f64)).sqrt();
    let side = side.round().clamp(2.0, MAX_LEAF_TEXELS) as u32;
    for plant in &plants {
        let (own, colours) = (plant.seed, plant.leaf_colours());
        let texture =
            |what: &str| format!("{}/{}-{what}{}", directory::TEXTURES, plant.name, format.extension());
        if let Growth::Tree(species) = plant.growth {
            let size = (side, 2 * side);
            bytes += texture_bytes(size);
            jobs.push(Job::new(texture("bark"), texture_bytes(size), move |path| {
                write_bark(own, species, size, path, format)
            }));
        }
        bytes += texture_bytes((side, side));
        let stony = plant.growth == Growth::Stone;
        jobs.push(Job::new(texture("leaves"), texture_bytes((side, side)), move |path| {
            if stony {
                return write_bark(own, Species::Oak, (side, side), path, format);
            }
            write_leaves(own, colours, side, path, format)
        }));
    }
    let (ground, patches) = ground(recipe, triangles, bytes)?;
    for (a, b) in patches_of(ground.side) {
        let (land, work) = (Arc::clone(&floor), ground.triangles() / patches * 40);
        jobs.push(Job::new(format!("{}/land-{a}-{b}.ply", directory::MESHES), work, move |path| {
            ground.write_patch(&*land, (a, b), path)
        }));
        let land = Arc::clone(&floor);
        let work = texture_bytes((ground.texels, ground.texels));
        bytes += work;
        let name = format!("{}/land-{a}-{b}{}", directory::TEXTURES, format.extension());
        jobs.push(Job::new(name, work, move |path| ground.write_texture(&*land, (a, b), path, format)));
    }
    // Brighter than open country: little of it comes through the trees.
    let sky = Sky { scale: 1.4, ..Sky::new(0.12, 0.52, [8.0, 5.9, 3.8], 0.45) };
    jobs.push(sky.job(recipe));
    triangles += ground.triangles();
    let eye = floor.level(0.0, 0.0) + 1.55;
    Ok(Plan {
        jobs,
        triangles,
        instanced_triangles: instanced + ground.triangles(),
        texture_bytes: bytes,
        text: Box::new(move |out| write_text(out, &plants, ground.side, format, &sky, eye)),
    })
}

fn patches_of(side: u32) -> impl Iterator<Item = (u32, u32)> {
    (0..side).flat_map(move |b| (0..side).map(move |a| (a, b)))
}

/// What the plants leave of both counts goes into the ground.
fn ground(recipe: &Recipe, triangles: u64, bytes: u64) -> Result<(Ground, u64)> {
    let whole = (recipe.texture_bytes.saturating_sub(bytes) as f64 / 4.0).sqrt();
    let side = ((whole / MAX_TEXELS).ceil() as u32).max(1);
    let patches = u64::from(side) * u64::from(side);
    let left = recipe.triangles.saturating_sub(triangles);
    if left < 8 * patches {
        let message = format!(
            "{} bytes of textures take {patches} patches of ground, which need {} triangles at least; {} are asked for",
            recipe.texture_bytes,
            32 * patches,
            recipe.triangles
        );
        return Err(Error::Usage(message));
    }
    let nu = ((left as f64 / (2.0 * patches as f64)).sqrt().round() as u32).max(1);
    let nv = ((left as f64 / (2.0 * patches as f64 * f64::from(nu))).round() as u32).max(1);
    let ground = Ground {
        x: Warp { reach: 320.0, dense: 0.05, ends: [-1.0, 1.0] },
        y: Warp { reach: 460.0, dense: 0.04, ends: [-0.5, 1.0] },
        side,
        cells: [nu, nv],
        texels: ((whole / f64::from(side)).round() as u32).max(1),
    };
    Ok((ground, patches))
}

/// The plants that fit, and how many leaves they have.
fn plants(recipe: &Recipe) -> Vec<Plant> {
    let seed = recipe.hash_seed();
    let variants =
        if recipe.triangles < 200_000 { 1 } else { (recipe.triangles / 6_000_000).clamp(2, 64) as u32 };
    let mut plants = Vec::new();
    let kinds = [
        ("spruce", Growth::Tree(Species::Spruce), 0.26, 19.0),
        ("birch", Growth::Tree(Species::Birch), 0.16, 14.0),
        ("oak", Growth::Tree(Species::Oak), 0.14, 15.0),
        ("bush", Growth::Tree(Species::Bush), 0.06, 1.4),
        ("tuft", Growth::Tuft, 0.04, 0.0),
        ("stone", Growth::Stone, 0.03, 0.0),
    ];
    for (name, growth, share, height) in kinds {
        let budget = (recipe.triangles as f64 * share / f64::from(variants)) as u64;
        for k in 0..variants {
            let own = seed ^ (0x9100 + k * 64 + plants.len() as u32);
            let mut r = Random::new(own, 41);
            let mut plant = Plant {
                name: format!("{name}-{k}"),
                growth,
                seed: own,
                tree: None,
                count: 0,
                places: Vec::new(),
            };
            match growth {
                Growth::Tree(species) => {
                    let height = height * r.range(0.8, 1.2);
                    let grown = |levels| Tree { seed: own, species, height, levels, leaves: 0 };
                    let fits = (0..=3u32).rev().map(grown).find(|t| t.wood_triangles() * 5 < budget * 2);
                    let Some(tree) = fits else { continue };
                    let leaves = ((budget - tree.wood_triangles()) / 2).min(1 << 29) as u32;
                    plant.tree = Some(Tree { leaves, ..tree });
                }
                Growth::Tuft => plant.count = (budget / 4).clamp(1, 4000) as u32,
                Growth::Stone => plant.count = ((budget as f64 / 4.0).sqrt() as u32).clamp(2, 700),
            }
            plants.push(plant);
        }
    }
    plants
}

/// Where plants stand: trees off the path, grass near the camera, stones anywhere.
fn place(floor: &Floor, plants: &mut [Plant]) {
    let seed = floor.seed;
    let mut put = |wanted: Growth, r: &mut Random, x: f32, y: f32, sink: f32, scale: f32| {
        let of_kind = plants.iter().filter(|p| p.growth == wanted).count();
        if of_kind == 0 {
            return;
        }
        let k = (r.unit() * of_kind as f32) as usize;
        let [c, s] = turn(f64::from(r.unit()));
        let z = floor.level(f64::from(x), f64::from(y)) - sink;
        if let Some(p) = plants.iter_mut().filter(|p| p.growth == wanted).nth(k) {
            p.places.push([x, y, z, c, s, scale]);
        }
    };
    let mut r = Random::new(seed, 51);
    let mut scatter =
        |cell: f32, x: [f32; 2], y: [f32; 2], at: &mut dyn FnMut(&mut Random, f32, f32, f32)| {
            let (nx, ny) = (((x[1] - x[0]) / cell) as u32, ((y[1] - y[0]) / cell) as u32);
            for (i, j) in (0..ny).flat_map(|j| (0..nx).map(move |i| (i, j))) {
                let px = x[0] + cell * (i as f32 + r.unit());
                let py = y[0] + cell * (j as f32 + r.unit());
                let off = floor.off_path(f64::from(px), f64::from(py));
                at(&mut r, px, py, off);
            }
        };
    scatter(4.4, [-130.0, 130.0], [-50.0, 300.0], &mut |r, x, y, off| {
        let clear = 3.3 + 2.6 * crowd(seed ^ 0x61, x, y, 15.0);
        if off < clear || x * x + y * y < 36.0 || r.unit() > 0.24 + 0.66 * crowd(seed ^ 0x62, x, y, 24.0) {
            return;
        }
        // Birches want light: at the path, and in groves.
        let light = 0.75 * smoothstep(12.0, 3.0, off) + smoothstep(0.55, 0.8, crowd(seed ^ 0x63, x, y, 34.0));
        let luck = r.unit();
        let species = if luck < 0.62 * light {
            Species::Birch
        } else if luck < 0.62 * light + 0.17 {
            Species::Oak
        } else {
            Species::Spruce
        };
        let scale = r.range(0.7, 1.25);
        put(Growth::Tree(species), r, x, y, 0.05, scale);
        if r.unit() < 0.25 {
            let small = r.range(0.12, 0.4);
            put(Growth::Tree(Species::Spruce), r, x + 1.9, y - 1.4, 0.03, small);
        }
    });
    scatter(3.1, [-45.0, 45.0], [-12.0, 110.0], &mut |r, x, y, off| {
        if off > 1.9 && x * x + y * y > 16.0 && r.unit() < 0.55 * crowd(seed ^ 0x64, x, y, 9.0) {
            let scale = r.range(0.5, 1.2);
            put(Growth::Tree(Species::Bush), r, x, y, 0.05, scale);
        }
    });
    for (cell, x, y) in [(0.62, 16.0, [-3.0, 26.0]), (1.3, 40.0, [26.0, 95.0])] {
        scatter(cell, [-x, x], y, &mut |r, x, y, off| {
            let grass = smoothstep(0.9, 1.8, off) * (0.25 + 1.1 * crowd(seed ^ 0x65, x, y, 5.0));
            if r.unit() < grass {
                let scale = r.range(0.5, 1.25);
                put(Growth::Tuft, r, x, y, 0.0, scale);
            }
        });
    }
    scatter(2.2, [-40.0, 40.0], [-6.0, 80.0], &mut |r, x, y, off| {
        if off > 1.3 && x * x + y * y > 9.0 && r.unit() < 0.34 * crowd(seed ^ 0x66, x, y, 7.0) {
            let u = r.unit();
            put(Growth::Stone, r, x, y, 0.05, 0.25 + 1.5 * u * u * u);
        }
    });
}

fn write_text(
    out: &mut dyn Write,
    plants: &[Plant],
    side: u32,
    format: TextureFormat,
    sky: &Sky,
    eye: f32,
) -> io::Result<()> {
    writeln!(out, "LookAt 0 0 {eye}  0.6 12 {}  0 0 1", eye + 0.9)?;
    writeln!(out, "Camera \"perspective\" \"float fov\" 50\nWorldBegin")?;
    sky.write_text(out)?;
    let (meshes, textures, suffix) = (directory::MESHES, directory::TEXTURES, format.extension());
    let texture = |out: &mut dyn Write, name: &str, wrap: &str| {
        writeln!(
            out,
            "Texture \"{name}\" \"spectrum\" \"imagemap\" \"string filename\" \"{textures}/{name}{suffix}\" \
             \"string wrap\" \"{wrap}\" \"string filter\" \"trilinear\""
        )
    };
    for (a, b) in patches_of(side) {
        let name = format!("land-{a}-{b}");
        texture(out, &name, "clamp")?;
        writeln!(out, "Material \"diffuse\" \"texture reflectance\" \"{name}\"")?;
        writeln!(out, "Shape \"plymesh\" \"string filename\" \"{meshes}/{name}.ply\"")?;
    }
    for plant in plants {
        let name = &plant.name;
        texture(out, &format!("{name}-leaves"), "clamp")?;
        if plant.tree.is_some() {
            texture(out, &format!("{name}-bark"), "repeat")?;
        }
        writeln!(out, "ObjectBegin \"{name}\"")?;
        for (part, ..) in plant.parts() {
            match part {
                "wood" => writeln!(out, "Material \"diffuse\" \"texture reflectance\" \"{name}-bark\"")?,
                "stone" => writeln!(out, "Material \"diffuse\" \"texture reflectance\" \"{name}-leaves\"")?,
                _ => writeln!(
                    out,
                    "Material \"diffusetransmission\" \"texture reflectance\" \"{name}-leaves\" \
                     \"texture transmittance\" \"{name}-leaves\""
                )?,
            }
            writeln!(out, "Shape \"plymesh\" \"string filename\" \"{meshes}/{name}-{part}.ply\"")?;
        }
        writeln!(out, "ObjectEnd")?;
    }
    plants.iter().try_for_each(|p| write_places(&p.name, &p.places, out))
}
