//! `city`: blocks of buildings along an avenue, towers in the middle. Invariant: how many buildings
//! there are and how they are divided follows from the counts asked for alone. Never writes text or
//! paints.

use super::building::{Building, Cell, Part};
use super::city_text::{self, Prop};
use super::image_out::texture_bytes;
use super::mesh_out::{count, write_mesh};
use super::noise::{Random, hash, value};
use super::sky::Sky;
use super::street::Tile;
use super::{Job, Plan, Recipe, directory, facade};
use crate::error::Result;
use std::sync::Arc;

/// Half widths of the avenue and of the other streets, between kerbs, and of a pavement.
const AVENUE: f32 = 11.0;
const STREET: f32 = 6.5;
const PAVEMENT: f32 = 3.6;
/// Texels a side at most.
const MAX_TEXELS: f64 = 32_768.0;

/// Everything about a city but the bytes.
pub(super) struct City {
    pub(super) buildings: Vec<Building>,
    pub(super) tiles: Vec<Tile>,
    pub(super) props: Vec<Prop>,
    /// Where the camera is, and the height that downtown's towers are seen from.
    pub(super) eye: [f32; 3],
}

/// Decides the scene.
pub(super) fn plan(recipe: &Recipe) -> Result<Plan> {
    let city = Arc::new(layout(recipe));
    let format = recipe.format;
    let mut jobs = Vec::new();
    // Nearest first: they are divided first and painted finest.
    let (cells, tile_cell) = divide(&city, recipe.triangles);
    let mut triangles = 0;
    for (i, &cell) in cells.iter().enumerate() {
        for (part, name) in [(Part::Walls, "walls"), (Part::Glass, "glass")] {
            let own = building_triangles(&city.buildings[i], part, cell);
            if own == 0 {
                continue;
            }
            triangles += own;
            let city = Arc::clone(&city);
            jobs.push(Job::new(format!("{}/{name}-{i}.ply", directory::MESHES), own * 40, move |path| {
                write_mesh(path, false, |mesh| city.buildings[i].build(part, cell, mesh))
            }));
        }
    }
    for i in 0..city.tiles.len() {
        let own = count(|mesh| city.tiles[i].build(tile_cell, mesh));
        triangles += own;
        let city = Arc::clone(&city);
        jobs.push(Job::new(format!("{}/street-{i}.ply", directory::MESHES), own * 40, move |path| {
            write_mesh(path, false, |mesh| city.tiles[i].build(tile_cell, mesh))
        }));
    }
    let mut instanced = triangles;
    for prop in &city.props {
        for part in &prop.parts {
            let own = count(|mesh| (part.build)(mesh));
            triangles += own;
            instanced += own * prop.places.len() as u64;
            let build = Arc::clone(&part.build);
            let normals = part.normals;
            jobs.push(Job::new(format!("{}/{}.ply", directory::MESHES, part.name), own * 40, move |path| {
                write_mesh(path, normals, |mesh| build(mesh))
            }));
        }
    }
    // What is left goes into the plain around the city.
    let left = (recipe.triangles.saturating_sub(triangles) / 2).clamp(4, 400_000_000);
    let nu = ((left as f64).sqrt() as u32).max(1);
    let nv = (left / u64::from(nu)) as u32;
    triangles += 2 * u64::from(nu) * u64::from(nv);
    instanced += 2 * u64::from(nu) * u64::from(nv);
    jobs.push(Job::new(
        format!("{}/plain.ply", directory::MESHES),
        80 * u64::from(nu) * u64::from(nv),
        move |path| write_mesh(path, true, |mesh| city_text::plain(nu, nv, mesh)),
    ));
    let [facades, streets] = texels(&city, recipe.texture_bytes);
    let mut bytes = 0;
    for (i, &size) in facades.iter().enumerate() {
        bytes += texture_bytes(size);
        let city = Arc::clone(&city);
        let name = format!("{}/facade-{i}{}", directory::TEXTURES, format.extension());
        jobs.push(Job::new(name, texture_bytes(size), move |path| {
            facade::write(&city.buildings[i], size, path, format)
        }));
    }
    for (i, &size) in streets.iter().enumerate() {
        bytes += texture_bytes(size);
        let city = Arc::clone(&city);
        let name = format!("{}/street-{i}{}", directory::TEXTURES, format.extension());
        jobs.push(Job::new(name, texture_bytes(size), move |path| {
            city.tiles[i].write_texture(size, path, format)
        }));
    }
    let sky = Sky::new(0.915, 0.40, [5.6, 4.3, 3.0], 0.6);
    jobs.push(sky.job(recipe));
    let glazed: Vec<bool> = cells.iter().map(Option::is_some).collect();
    Ok(Plan {
        jobs,
        triangles,
        instanced_triangles: instanced,
        texture_bytes: bytes,
        text: Box::new(move |out| city_text::write(&city, &glazed, format, &sky, out)),
    })
}

/// Streets, lots, buildings and what stands in the street.
fn layout(recipe: &Recipe) -> City {
    let seed = recipe.hash_seed();
    let wanted = (recipe.triangles / 200)
        .min(recipe.texture_bytes / 6000)
        .min((recipe.triangles / 1200).clamp(24, 1000))
        .max(recipe.triangles / 200_000)
        .max((recipe.texture_bytes as f64 / 1.2e9) as u64)
        .max(2);
    let blocks = wanted.div_ceil(7).max(1);
    let columns = ((blocks as f64 * 0.9).sqrt().ceil() as i32).max(1);
    let rows = (blocks as i32).div_euclid(columns) + i32::from(blocks as i32 % columns != 0);
    // Middles of the streets; the avenue is the one at 0.
    let mut r = Random::new(seed, 21);
    let west = columns / 2;
    let mut xs = vec![0.0f32; columns as usize + 1];
    for k in (0..west as usize).rev() {
        xs[k] = xs[k + 1] - r.range(62.0, 96.0);
    }
    for k in west as usize + 1..xs.len() {
        xs[k] = xs[k - 1] + r.range(62.0, 96.0);
    }
    let mut ys = vec![-24.0f32];
    (0..rows).for_each(|k| ys.push(ys[k as usize] + r.range(54.0, 82.0)));
    let centre = [40.0, 0.62 * ys[rows as usize]];
    let (mut tiles, mut buildings) = (Vec::new(), Vec::new());
    for (i, j) in (0..rows as usize).flat_map(|j| (0..columns as usize).map(move |i| (i, j))) {
        let half = |k: usize| if k as i32 == west { AVENUE } else { STREET };
        let area = [xs[i], ys[j], xs[i + 1], ys[j + 1]];
        let block = [area[0] + half(i), area[1] + STREET, area[2] - half(i + 1), area[3] - STREET];
        let h = hash(seed ^ 0x31, i as i32, j as i32);
        let park = blocks > 12 && h.is_multiple_of(19);
        tiles.push(Tile { seed: h, area, block, park });
        if !park {
            lots(seed, h, block, centre, ys[rows as usize], &mut buildings);
        }
    }
    let eye = [-30.0, -32.0, 54.0];
    let distance = |b: &Building| {
        let [x0, y0, x1, y1] = b.tiers[0].area;
        let (dx, dy) = (0.5 * (x0 + x1) - eye[0], 0.5 * (y0 + y1) - eye[1]);
        dx * dx + dy * dy
    };
    buildings.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.seed.cmp(&b.seed)));
    let props = if recipe.triangles >= 300_000 {
        city_text::props(seed, &tiles, recipe.triangles)
    } else {
        Vec::new()
    };
    City { buildings, tiles, props, eye }
}

/// Two rows of lots in a block, their backs together.
fn lots(seed: u32, h: u32, block: [f32; 4], centre: [f32; 2], depth: f32, buildings: &mut Vec<Building>) {
    let mut r = Random::new(seed ^ h, 22);
    let [x0, y0, x1, y1] =
        [block[0] + PAVEMENT, block[1] + PAVEMENT, block[2] - PAVEMENT, block[3] - PAVEMENT];
    let middle = y0 + (y1 - y0) * r.range(0.42, 0.58);
    for (low, high, south) in [(y0, middle, true), (middle, y1, false)] {
        let mut x = x0;
        while x < x1 - 7.0 {
            let mut width = r.range(11.0, 25.0);
            if x1 - x - width < 11.0 {
                width = x1 - x;
            }
            let (cx, cy) = (x + 0.5 * width - centre[0], 0.5 * (low + high) - centre[1]);
            let away = (cx * cx + cy * cy).sqrt() / (0.42 * depth + 60.0);
            let falloff = 1.0 / (1.0 + away * away * away * 5.0);
            let local = value(seed ^ 0x41, f64::from(x) / 90.0, f64::from(low) / 90.0);
            let luck = r.unit();
            let height = 12.0 + 13.0 * local + 7.0 * r.unit() + falloff * (26.0 + 190.0 * luck * luck * luck);
            let back = r.range(0.0, 3.5);
            let front = if r.unit() < 0.25 { r.range(0.5, 2.0) } else { 0.0 };
            let gap = if r.unit() < 0.18 { r.range(0.8, 2.5) } else { 0.04 };
            let (a, b) = if south { (low + front, high - back) } else { (low + back, high - front) };
            let area = [x, a, x + width - gap.min(width * 0.3), b];
            buildings.push(Building::new(r.bits(), area, height.min(width * 9.0)));
            x += width;
        }
    }
}

fn building_triangles(b: &Building, part: Part, cell: Cell) -> u64 {
    count(|mesh| b.build(part, cell, mesh))
}

/// Cells of each building's walls and of the streets, such that all of them have about `triangles`.
fn divide(city: &City, triangles: u64) -> (Vec<Cell>, f32) {
    let props: u64 = city.props.iter().flat_map(|p| &p.parts).map(|p| count(|mesh| (p.build)(mesh))).sum();
    let of = |cell: Cell| -> Vec<u64> {
        use rayon::prelude::*;
        let own =
            |b: &Building| [Part::Walls, Part::Glass].iter().map(|&p| building_triangles(b, p, cell)).sum();
        city.buildings.par_iter().map(own).collect()
    };
    let streets = |cell: f32| -> u64 { city.tiles.iter().map(|t| count(|mesh| t.build(cell, mesh))).sum() };
    let for_streets = triangles / 30;
    let tile_cell = finest(for_streets, streets);
    let budget = (triangles - triangles / 100).saturating_sub(props + streets(tile_cell));
    let (plain, full) = (of(None), of(Some(f32::INFINITY)));
    if full.iter().sum::<u64>() <= budget {
        let cell = finest(budget, |cell| of(Some(cell)).iter().sum());
        return (vec![Some(cell); plain.len()], tile_cell);
    }
    let mut left = budget.saturating_sub(plain.iter().sum());
    let cells = plain.iter().zip(&full).map(|(&p, &f)| {
        let more = f - p;
        if more > left {
            return None;
        }
        left -= more;
        Some(f32::INFINITY)
    });
    (cells.collect(), tile_cell)
}

/// The finest cell with no more than `most` triangles.
fn finest(most: u64, count_of: impl Fn(f32) -> u64) -> f32 {
    let (mut low, mut high) = (0.004f32, 64.0f32);
    for _ in 0..22 {
        let middle = (low * high).sqrt();
        if count_of(middle) > most { low = middle } else { high = middle }
    }
    high
}

/// Sizes of façades' and streets' textures: texels a metre fall off with distance from the camera.
fn texels(city: &City, bytes: u64) -> [Vec<(u32, u32)>; 2] {
    let near = |x: f32, y: f32| {
        let (dx, dy) = (x - city.eye[0], y - city.eye[1]);
        f64::from((90.0 / (dx * dx + dy * dy).sqrt().max(1.0)).clamp(0.14, 1.0))
    };
    let side =
        |metres: f32, density: f64| (f64::from(metres) * density).round().clamp(4.0, MAX_TEXELS) as u32;
    let sizes = |density: f64| {
        let facade = |b: &Building| {
            let [x0, y0, x1, y1] = b.tiers[0].area;
            let d = density * near(0.5 * (x0 + x1), 0.5 * (y0 + y1));
            let [w, h] = b.strip();
            (side(w, d), side(h, d))
        };
        let street = |t: &Tile| {
            let [x0, y0, x1, y1] = t.area;
            let d = 0.5 * density * near(0.5 * (x0 + x1), 0.5 * (y0 + y1));
            (side(x1 - x0, d), side(y1 - y0, d))
        };
        let facades: Vec<_> = city.buildings.iter().map(facade).collect();
        let streets: Vec<_> = city.tiles.iter().map(street).collect();
        [facades, streets]
    };
    let total = |density: f64| sizes(density).into_iter().flatten().map(texture_bytes).sum::<u64>();
    let (mut low, mut high) = (0.001f64, 50_000.0f64);
    for _ in 0..60 {
        let middle = (low * high).sqrt();
        if total(middle) > bytes { high = middle } else { low = middle }
    }
    sizes(low)
}
