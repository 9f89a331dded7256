//! `terrain`: mountains around a lake, a knoll with stones in front. Invariant: the camera stands on
//! the knoll above whatever the seed made of it. Never holds the mesh.

use super::ground::{Ground, Land, Row, Warp, byte};
use super::mesh_out::{Vertex, write_grid};
use super::noise::{add_row, blend, fbm, gradient, hash, lerp, normalized, smoothstep, unit, value};
use super::sky::Sky;
use super::{Job, Plan, Recipe, directory};
use crate::error::{Error, Result};
use std::io::{self, Write};
use std::sync::Arc;

/// Texels a side that most readers still take.
const MAX_TEXELS: f64 = 16_384.0;
/// Triangles of one mesh whose indices fit u32 with room.
const MAX_MESH_TRIANGLES: u64 = 4_000_000_000;

struct Mountains {
    seed: u32,
}

impl Mountains {
    /// Where the lake's shore is 1 and its middle 0.
    fn shore(&self, x: f64, y: f64) -> f32 {
        let (dx, dy) = ((x - 60.0) / 620.0, (y - 1120.0) / 900.0);
        let q = (dx * dx + dy * dy).sqrt() as f32;
        q + 0.20 * fbm(self.seed ^ 0x11, x / 520.0, y / 520.0, 4)
    }

    /// Ridges that sharpen on slopes and calm down in valleys (Musgrave's ridged multifractal, with
    /// slopes damping what comes after them).
    fn ridges(&self, x: f64, y: f64, finest: f32) -> f32 {
        let wx = x + 260.0 * f64::from(gradient(self.seed ^ 0x21, x / 1500.0, y / 1500.0)[0]);
        let wy = y + 260.0 * f64::from(gradient(self.seed ^ 0x22, x / 1500.0, y / 1500.0)[0]);
        let (mut px, mut py) = (wx / 2600.0, wy / 2600.0);
        let (mut sum, mut height, mut weight, mut length) = (0.0f32, 1.0f32, 1.0f32, 2600.0f32);
        let mut slope = [0.0f32; 2];
        for octave in 0..14 {
            let fade = (length / finest - 1.0).clamp(0.0, 1.0);
            if fade == 0.0 {
                break;
            }
            let [n, dx, dy] = gradient(self.seed.wrapping_add(0x31 + octave), px, py);
            let ridge = 1.0 - n.abs();
            let sharp = ridge * ridge;
            slope = [slope[0] + dx * 0.35, slope[1] + dy * 0.35];
            let calm = 1.0 / (1.0 + 0.28 * (slope[0] * slope[0] + slope[1] * slope[1]));
            sum += fade * height * weight * sharp * calm;
            weight = (sharp * 1.7).clamp(0.0, 1.0);
            height *= 0.49;
            length *= 0.5;
            (px, py) = (1.6 * px - 1.2 * py, 1.2 * px + 1.6 * py);
            slope = [0.8 * slope[0] - 0.6 * slope[1], 0.6 * slope[0] + 0.8 * slope[1]];
        }
        sum
    }

    /// A stone in most cells of `size` metres: its height here, 0 beside it.
    fn stone(&self, salt: u32, x: f64, y: f64, size: f64) -> f32 {
        let (cx, cy) = ((x / size).floor(), (y / size).floor());
        let h = hash(self.seed ^ salt, cx as i32, cy as i32);
        let crowd = value(self.seed ^ 0x41, cx * size / 14.0, cy * size / 14.0);
        if unit(h) > 1.35 * crowd * crowd {
            return 0.0;
        }
        let (a, b, c) =
            (unit(h.wrapping_mul(0x9e37)), unit(h.wrapping_mul(0x85eb_ca6b)), unit(h.rotate_left(9)));
        let radius = 0.12 + 0.22 * c * c;
        let jitter = |t: f32| radius + (1.0 - 2.0 * radius) * t;
        let (dx, dy) = ((x / size - cx) as f32 - jitter(a), (y / size - cy) as f32 - jitter(b));
        let bump = 1.0 + 0.35 * gradient(self.seed ^ 0x42, 5.0 * x / size, 5.0 * y / size)[0];
        let d = (dx * dx + dy * dy * (1.0 + b)) / (radius * radius) * bump * bump;
        if d < 1.0 { (1.0 - d * d).sqrt() * radius * size as f32 * (0.5 + 0.4 * a) } else { 0.0 }
    }

    /// Woods on gentle slopes, 0 to 1.
    fn woods(&self, x: f64, y: f64, h: f32, q: f32) -> f32 {
        let line = 150.0 + 190.0 * fbm(self.seed ^ 0x51, x / 300.0, y / 300.0, 3);
        smoothstep(line + 40.0, line - 30.0, h)
            * smoothstep(1.04, 1.12, q)
            * smoothstep(420.0, 640.0, y as f32)
    }
}

impl Land for Mountains {
    fn height(&self, x: f64, y: f64, finest: f32) -> [f32; 2] {
        let q = self.shore(x, y);
        let bed = if q < 1.0 { -34.0 * (1.0 - q * q) } else { 30.0 * (q - 1.0) };
        let rise = smoothstep(1.05, 3.4, q) + 0.35 * smoothstep(3.0, 7.0, q);
        // Low behind the camera and beside it, where the sun comes from.
        let rise = rise * (0.14 + 0.86 * smoothstep(100.0, 2000.0, y as f32));
        let mut h = bed + 650.0 * rise * self.ridges(x, y, finest);
        let (dx, dy) = ((x - 20.0) / 190.0, (y + 70.0) / 230.0);
        let near = (1.0 - dx * dx - dy * dy).max(0.0) as f32;
        // The knoll replaces whatever is there.
        h = lerp(h, 9.0 + 34.0 * near, smoothstep(0.0, 0.55, near));
        let rolling = 2.4 * fbm(self.seed ^ 0x61, x / 34.0, y / 34.0, 4);
        h += rolling * smoothstep(1.0, 1.1, q);
        let mut stone = 0.0;
        let away = (x * x + y * y) as f32;
        if away < 400.0 * 400.0 && q > 1.0 && finest < 1.5 {
            let mut tall = 0.0f32;
            for (salt, size) in [(0x71, 6.3), (0x72, 2.1), (0x73, 0.9), (0x74, 0.42)] {
                tall = tall.max(self.stone(salt, x, y, size));
            }
            stone = smoothstep(0.0, 0.05, tall);
            h += tall + 0.16 * fbm(self.seed ^ 0x62, x / 0.9, y / 0.9, 6);
        }
        let woods = self.woods(x, y, h, q);
        if woods > 0.0 && finest < 12.0 {
            let crown = value(self.seed ^ 0x52, x / 7.0, y / 7.0);
            h += woods * 15.0 * crown * (0.6 + 0.4 * value(self.seed ^ 0x53, x / 2.9, y / 2.9));
        }
        [h, stone]
    }

    fn colour(&self, row: &Row<'_>, out: &mut [u8]) {
        let n = row.xs.len();
        let at = (row.y, row.step);
        let (mut broad, mut fine, mut strata) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        add_row(self.seed ^ 0x81, 1.0 / 90.0, row.xs, at, 0.6, &mut broad);
        add_row(self.seed ^ 0x82, 1.0 / 17.0, row.xs, at, 0.4, &mut broad);
        add_row(self.seed ^ 0x83, 1.0 / 2.7, row.xs, at, 0.45, &mut fine);
        add_row(self.seed ^ 0x84, 1.0 / 0.6, row.xs, at, 0.35, &mut fine);
        add_row(self.seed ^ 0x85, 1.0 / 0.07, row.xs, at, 0.45, &mut fine);
        add_row(self.seed ^ 0x86, 1.0 / 240.0, row.xs, at, 1.0, &mut strata);
        for (i, texel) in out.chunks_exact_mut(3).enumerate() {
            let (h, up, b, f) = (row.height[i], row.up[i], broad[i], fine[i]);
            let layer = ((h * 0.021 + 4.0 * strata[i] + 1.3 * b).fract().abs() * 2.0 - 1.0).abs();
            let rock = blend([118.0, 109.0, 101.0], [142.0, 130.0, 116.0], smoothstep(0.2, 0.8, layer));
            let grass =
                blend([76.0, 84.0, 36.0], [158.0, 136.0, 76.0], (0.42 + 0.7 * b + 0.75 * f).clamp(0.0, 1.0));
            // Meadow by slope and height, woods as a darker green, snow above, sand at the water.
            let meadow = smoothstep(0.66, 0.84, up + 0.10 * b) * smoothstep(520.0, 260.0, h + 140.0 * b);
            let mut c = blend(rock, grass, meadow * (1.0 - row.stone[i]));
            let (x, y) = (f64::from(row.xs[i]), f64::from(row.y));
            if h < 400.0 && y > 400.0 && h > 0.0 {
                let woods = self.woods_at(x, y, h, b);
                c = blend(c, [52.0, 66.0, 38.0], woods);
            }
            let snow_line = 560.0 + 150.0 * b - 60.0 * f;
            let snow = smoothstep(snow_line, snow_line + 120.0, h)
                * smoothstep(0.50, 0.72, up + 0.08 * b + 0.05 * f);
            c = blend(c, [236.0, 240.0, 247.0], snow);
            c = blend([120.0, 112.0, 96.0], c, smoothstep(0.6, 2.2, h + 0.8 * f));
            let grain = 1.0 + (0.34 - 0.28 * snow) * f;
            (0..3).for_each(|k| texel[k] = byte((c[k] * grain).clamp(0.0, 255.0)));
        }
    }
}

impl Mountains {
    /// As [`Self::woods`], by a texel's own broad noise instead.
    fn woods_at(&self, _x: f64, y: f64, h: f32, broad: f32) -> f32 {
        let line = 150.0 + 120.0 * broad;
        smoothstep(line + 40.0, line - 30.0, h)
            * smoothstep(4.0, 12.0, h)
            * smoothstep(420.0, 640.0, y as f32)
    }
}

/// The lake: a grid with the land's spacing, waves in its normals.
fn write_lake(seed: u32, cells: u32, path: &std::path::Path) -> Result<()> {
    write_grid(path, cells, cells, |rows| {
        let mut vertices = Vec::with_capacity(rows.len() * (cells as usize + 1));
        for j in rows {
            for i in 0..=cells {
                let t = |k: u32| f64::from(k) / f64::from(cells);
                let (x, y) = (2400.0 * (t(i) - 0.5) + 60.0, 2500.0 * t(j) * (0.35 + 0.65 * t(j)));
                let [_, ax, ay] = gradient(seed ^ 0x91, x / 9.0, y / 6.0);
                let [_, bx, by] = gradient(seed ^ 0x92, x / 2.1, y / 1.5);
                let calm = smoothstep(-0.3, 0.4, fbm(seed ^ 0x93, x / 260.0, y / 160.0, 3));
                let size = 0.002 + 0.010 * calm;
                let n = normalized([-(ax + bx) * size, -(ay + by) * size, 1.0]);
                vertices.push(Vertex { p: [x as f32, y as f32, 0.0], n, uv: [t(i) as f32, t(j) as f32] });
            }
        }
        vertices
    })
}

/// Decides the scene.
pub(super) fn plan(recipe: &Recipe) -> Result<Plan> {
    let seed = recipe.hash_seed();
    let whole = (recipe.texture_bytes as f64 / 4.0).sqrt();
    let side =
        ((whole / MAX_TEXELS).ceil() as u32).max(recipe.triangles.div_ceil(MAX_MESH_TRIANGLES) as u32).max(1);
    let patches = u64::from(side) * u64::from(side);
    if recipe.triangles < 8 * patches {
        let message = format!(
            "{} bytes of textures take {patches} patches of ground, which need {} triangles at least; {} are asked for",
            recipe.texture_bytes,
            8 * patches,
            recipe.triangles
        );
        return Err(Error::Usage(message));
    }
    let lake = ((recipe.triangles as f64 * 0.01).sqrt() as u32).clamp(1, 1000);
    let land_triangles = recipe.triangles - 2 * u64::from(lake) * u64::from(lake);
    let cells = (land_triangles as f64 / (2.0 * patches as f64)).sqrt();
    let nu = (cells.round() as u32).max(1);
    let nv = ((land_triangles as f64 / (2.0 * patches as f64 * f64::from(nu))).round() as u32).max(1);
    let ground = Ground {
        x: Warp { reach: 6500.0, dense: 0.03, ends: [-1.0, 1.0] },
        y: Warp { reach: 9000.0, dense: 0.02, ends: [-0.32, 1.0] },
        side,
        cells: [nu, nv],
        texels: ((whole / f64::from(side)).round() as u32).max(1),
    };
    let land = Arc::new(Mountains { seed });
    let mut jobs = Vec::new();
    let format = recipe.format;
    for (a, b) in (0..side).flat_map(|b| (0..side).map(move |a| (a, b))) {
        let mesh_land = Arc::clone(&land);
        jobs.push(Job::new(
            format!("{}/land-{a}-{b}.ply", directory::MESHES),
            ground.triangles() / patches * 40,
            move |path| ground.write_patch(&*mesh_land, (a, b), path),
        ));
        let texture_land = Arc::clone(&land);
        jobs.push(Job::new(
            format!("{}/land-{a}-{b}{}", directory::TEXTURES, format.extension()),
            u64::from(ground.texels) * u64::from(ground.texels) * 4,
            move |path| ground.write_texture(&*texture_land, (a, b), path, format),
        ));
    }
    let lake_work = 80 * u64::from(lake) * u64::from(lake);
    jobs.push(Job::new(format!("{}/lake.ply", directory::MESHES), lake_work, move |path| {
        write_lake(seed, lake, path)
    }));
    let sky = Sky::new(0.60, 0.34, [4.4, 3.25, 2.15], 0.5);
    jobs.push(sky.job(recipe));
    let triangles = ground.triangles() + 2 * u64::from(lake) * u64::from(lake);
    let eye = eye(&land);
    Ok(Plan {
        jobs,
        triangles,
        instanced_triangles: triangles,
        texture_bytes: u64::from(ground.texels) * u64::from(ground.texels) * 4 * patches,
        text: Box::new(move |out| write_text(out, side, format, &sky, eye)),
    })
}

/// Above the ground at the origin and what is close in front of it.
fn eye(land: &Mountains) -> f32 {
    let mut eye = f32::MIN;
    for step in 0..40 {
        let y = f64::from(step) * 1.5;
        for x in [-2.0, -1.0, 0.0, 1.0, 2.0] {
            let h = land.height(x * (1.0 + y * 0.1), y, 0.3)[0];
            eye = eye.max(h + 2.6 + 0.16 * y as f32);
        }
    }
    eye
}

fn write_text(
    out: &mut dyn Write,
    side: u32,
    format: super::TextureFormat,
    sky: &Sky,
    eye: f32,
) -> io::Result<()> {
    writeln!(out, "LookAt 0 0 {eye}  0 100 {}  0 0 1", eye + 4.0)?;
    writeln!(out, "Camera \"perspective\" \"float fov\" 42\nWorldBegin")?;
    sky.write_text(out)?;
    let (meshes, textures, suffix) = (directory::MESHES, directory::TEXTURES, format.extension());
    for (a, b) in (0..side).flat_map(|b| (0..side).map(move |a| (a, b))) {
        writeln!(
            out,
            "Texture \"land-{a}-{b}\" \"spectrum\" \"imagemap\" \"string filename\" \"{textures}/land-{a}-{b}{suffix}\" \
             \"string wrap\" \"clamp\" \"string filter\" \"trilinear\""
        )?;
        writeln!(out, "Material \"diffuse\" \"texture reflectance\" \"land-{a}-{b}\"")?;
        writeln!(out, "Shape \"plymesh\" \"string filename\" \"{meshes}/land-{a}-{b}.ply\"")?;
    }
    writeln!(out, "Material \"dielectric\" \"float eta\" 1.33 \"float roughness\" 0")?;
    writeln!(out, "Shape \"plymesh\" \"string filename\" \"{meshes}/lake.ply\"")
}
