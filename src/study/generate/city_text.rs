//! What stands in the city's streets, the plain around it, and the text of its scene. Never decides
//! where buildings are.

use super::city::City;
use super::directory;
use super::image_out::TextureFormat;
use super::mesh_out::{Mesh, Vertex};
use super::noise::{Random, fbm, normalized, smoothstep};
use super::plant::{Species, Tree};
use super::sky::Sky;
use super::street::{CarPart, KERB, Tile, car, lamp};
use std::io::{self, Write};
use std::sync::Arc;

/// Describes one mesh.
pub(super) type Build = Arc<dyn Fn(&mut Mesh) + Send + Sync>;

/// One mesh of a prop with the directives of its material.
pub(super) struct PropPart {
    pub(super) name: String,
    pub(super) material: String,
    pub(super) normals: bool,
    pub(super) build: Build,
}

/// Something that stands in many places.
pub(super) struct Prop {
    pub(super) name: String,
    pub(super) parts: Vec<PropPart>,
    /// x, y, z, cosine and sine of the turn about z, scale.
    pub(super) places: Vec<[f32; 6]>,
}

fn part(
    name: &str,
    material: &str,
    normals: bool,
    build: impl Fn(&mut Mesh) + Send + Sync + 'static,
) -> PropPart {
    PropPart { name: name.to_owned(), material: material.to_owned(), normals, build: Arc::new(build) }
}

fn diffuse(rgb: [f32; 3]) -> String {
    format!("Material \"diffuse\" \"rgb reflectance\" [ {} {} {} ]", rgb[0], rgb[1], rgb[2])
}

/// Cars, lamps and trees along the kerbs.
pub(super) fn props(seed: u32, tiles: &[Tile], triangles: u64) -> Vec<Prop> {
    let mut r = Random::new(seed, 31);
    const PAINTS: [[f32; 3]; 7] = [
        [0.55, 0.55, 0.56],
        [0.03, 0.03, 0.035],
        [0.62, 0.61, 0.58],
        [0.30, 0.03, 0.025],
        [0.04, 0.09, 0.22],
        [0.16, 0.17, 0.18],
        [0.55, 0.36, 0.05],
    ];
    let mut cars: Vec<Prop> = PAINTS
        .iter()
        .enumerate()
        .map(|(k, c)| {
            let paint = format!(
                "Material \"coateddiffuse\" \"rgb reflectance\" [ {} {} {} ] \"float roughness\" 0.002",
                c[0], c[1], c[2]
            );
            let glass = "Material \"coateddiffuse\" \"rgb reflectance\" [ 0.01 0.012 0.014 ] \"float roughness\" 0 \"float eta\" 1.7";
            Prop {
                name: format!("car-{k}"),
                parts: vec![
                    part(&format!("car-body-{k}"), &paint, false, |m| car(CarPart::Body, m)),
                    part(&format!("car-glass-{k}"), glass, false, |m| car(CarPart::Glass, m)),
                    part(&format!("car-wheels-{k}"), &diffuse([0.03; 3]), false, |m| car(CarPart::Wheels, m)),
                ],
                places: Vec::new(),
            }
        })
        .collect();
    let mut lamps = Prop {
        name: "lamp".to_owned(),
        parts: vec![part("lamp", &diffuse([0.09, 0.10, 0.10]), false, lamp)],
        places: Vec::new(),
    };
    let leaves = (triangles / 400).clamp(400, 60_000) as u32;
    let mut trees: Vec<Prop> = (0..3)
        .map(|k| {
            let tree = Tree { seed: seed ^ (0x600 + k), species: Species::Oak, height: 8.5, levels: 3, leaves };
            let green = [[0.10, 0.15, 0.035], [0.16, 0.17, 0.04], [0.24, 0.17, 0.04]][k as usize];
            let foliage = format!(
                "Material \"diffusetransmission\" \"rgb reflectance\" [ {0} {1} {2} ] \"rgb transmittance\" [ {0} {1} {2} ]",
                green[0], green[1], green[2]
            );
            Prop {
                name: format!("tree-{k}"),
                parts: vec![
                    part(&format!("tree-wood-{k}"), &diffuse([0.12, 0.09, 0.07]), true, move |m| tree.wood(m)),
                    part(&format!("tree-leaves-{k}"), &foliage, false, move |m| tree.foliage(m)),
                ],
                places: Vec::new(),
            }
        })
        .collect();
    for tile in tiles {
        let [x0, y0, x1, y1] = tile.block;
        // Each kerb: where it begins, its direction, its length.
        let kerbs = [
            ([x0, y0], [1.0, 0.0], x1 - x0),
            ([x1, y0], [0.0, 1.0], y1 - y0),
            ([x1, y1], [-1.0, 0.0], x1 - x0),
            ([x0, y1], [0.0, -1.0], y1 - y0),
        ];
        for (start, along, length) in kerbs {
            let out = [along[1], -along[0]];
            let at =
                |s: f32, o: f32| [start[0] + along[0] * s + out[0] * o, start[1] + along[1] * s + out[1] * o];
            let mut s = 7.5;
            while s < length - 8.0 {
                if r.unit() < 0.72 {
                    let [x, y] = at(s, 1.15 + r.range(-0.08, 0.08));
                    // Cars drive along +y of their own; they stand along the kerb.
                    let k = (r.unit() * 7.0) as usize;
                    cars[k].places.push([x, y, 0.0, along[1], -along[0], 1.0]);
                }
                s += r.range(5.4, 6.6);
            }
            let mut s = 4.0;
            let mut k = 0;
            while s < length - 3.0 {
                let [x, y] = at(s, -0.8);
                if k % 3 == 0 {
                    // The arm points over the street: its −y is `out`.
                    lamps.places.push([x, y, KERB, -out[1], out[0], 1.0]);
                } else if r.unit() < 0.75 {
                    let [c, s] = super::noise::turn(f64::from(r.unit()));
                    let species = (r.unit() * 3.0) as usize;
                    trees[species].places.push([x, y, KERB, c, s, r.range(0.75, 1.15)]);
                }
                k += 1;
                s += 8.0;
            }
        }
        if tile.park {
            for _ in 0..26 {
                let (x, y) = (r.range(x0 + 5.0, x1 - 5.0), r.range(y0 + 5.0, y1 - 5.0));
                let species = (r.unit() * 3.0) as usize;
                let [c, s] = super::noise::turn(f64::from(r.unit()));
                trees[species].places.push([x, y, KERB, c, s, r.range(0.9, 1.5)]);
            }
        }
        // Two moving cars on the street west of the block.
        for _ in 0..2 {
            let (lane, y) = (r.range(1.9, 2.6), r.range(y0, y1));
            let north = r.bits() & 1 == 0;
            let x = tile.area[0] + if north { lane } else { -lane };
            let k = (r.unit() * 7.0) as usize;
            cars[k].places.push([x, y, 0.0, if north { 1.0 } else { -1.0 }, 0.0, 1.0]);
        }
    }
    cars.push(lamps);
    cars.append(&mut trees);
    cars.retain(|p| !p.places.is_empty());
    cars
}

/// The land around: flat below the city, hills towards the horizon.
pub(super) fn plain(nu: u32, nv: u32, mesh: &mut Mesh) {
    let height = |x: f64, y: f64| {
        let away = ((x * x + y * y).sqrt() as f32 - 1800.0).max(0.0);
        -0.25 + smoothstep(0.0, 5000.0, away) * (260.0 + 420.0 * fbm(77, x / 1900.0, y / 1900.0, 6))
    };
    mesh.grid(nu, nv, |i, j| {
        let at = |k: u32, n: u32| {
            let t = 2.0 * f64::from(k) / f64::from(n) - 1.0;
            9000.0 * (0.3 * t + 0.7 * t * t * t)
        };
        let (x, y) = (at(i, nu), at(j, nv));
        let h = height(x, y);
        let (dx, dy) = (height(x + 20.0, y) - h, height(x, y + 20.0) - h);
        Vertex { p: [x as f32, y as f32, h], n: normalized([-dx, -dy, 20.0]), uv: [0.5, 0.5] }
    });
}

/// The scene after the film.
pub(super) fn write(
    city: &City,
    glazed: &[bool],
    format: TextureFormat,
    sky: &Sky,
    out: &mut dyn Write,
) -> io::Result<()> {
    let [x, y, z] = city.eye;
    writeln!(out, "LookAt {x} {y} {z}  {} {} {}  0 0 1", x + 38.0, y + 100.0, z - 18.0)?;
    writeln!(out, "Camera \"perspective\" \"float fov\" 44\nWorldBegin")?;
    sky.write_text(out)?;
    let (meshes, textures, suffix) = (directory::MESHES, directory::TEXTURES, format.extension());
    writeln!(out, "{}", diffuse([0.16, 0.17, 0.10]))?;
    writeln!(out, "Shape \"plymesh\" \"string filename\" \"{meshes}/plain.ply\"")?;
    let texture = |out: &mut dyn Write, name: &str, i: usize| {
        writeln!(
            out,
            "Texture \"{name}-{i}\" \"spectrum\" \"imagemap\" \"string filename\" \"{textures}/{name}-{i}{suffix}\" \
             \"string wrap\" \"clamp\" \"string filter\" \"trilinear\""
        )
    };
    let shape = |out: &mut dyn Write, name: &str, i: usize| {
        writeln!(out, "Shape \"plymesh\" \"string filename\" \"{meshes}/{name}-{i}.ply\"")
    };
    for i in 0..city.tiles.len() {
        texture(out, "street", i)?;
        writeln!(out, "Material \"diffuse\" \"texture reflectance\" \"street-{i}\"")?;
        shape(out, "street", i)?;
    }
    for (i, &glazed) in glazed.iter().enumerate() {
        texture(out, "facade", i)?;
        writeln!(out, "Material \"diffuse\" \"texture reflectance\" \"facade-{i}\"")?;
        shape(out, "walls", i)?;
        if glazed {
            writeln!(
                out,
                "Material \"coateddiffuse\" \"texture reflectance\" \"facade-{i}\" \"float roughness\" 0 \"float eta\" 2.0"
            )?;
            shape(out, "glass", i)?;
        }
    }
    for prop in &city.props {
        writeln!(out, "ObjectBegin \"{}\"", prop.name)?;
        for part in &prop.parts {
            writeln!(out, "{}", part.material)?;
            writeln!(out, "Shape \"plymesh\" \"string filename\" \"{meshes}/{}.ply\"", part.name)?;
        }
        writeln!(out, "ObjectEnd")?;
    }
    for prop in &city.props {
        write_places(&prop.name, &prop.places, out)?;
    }
    Ok(())
}

/// Instances of an object.
pub(super) fn write_places(name: &str, places: &[[f32; 6]], out: &mut dyn Write) -> io::Result<()> {
    for &[x, y, z, c, s, k] in places {
        let (c, s) = (c * k, s * k);
        writeln!(
            out,
            "AttributeBegin Transform [ {c} {s} 0 0 {} {c} 0 0 0 0 {k} 0 {x} {y} {z} 1 ] ObjectInstance \"{name}\" AttributeEnd",
            -s
        )?;
    }
    Ok(())
}
