//! Known answers, cracks and rates of what is made.
//!
//! Invariant: shapes are told apart by the bits of their positions, as a ray tells them apart.

use super::displace::{Displaced, Displacement};
use super::parts::{InPieces, Part};
use super::patches::Patches;
use super::refine::{MAX_TRIANGLES, Refined};
use super::rule::middle;
use super::seams::{self, Seam};
use super::view::{Seen, View};
use super::{Place, curves};
use crate::color::Rgb;
use crate::error::Error;
use crate::math::{DVec3, Transform};
use crate::scene::{
    Camera, CameraKind, CurveKind, Encoding, Mapping, Strand, Texture, TextureId, TriangleMesh,
};
use crate::texture::{ImageData, Pixels, TextureStore, Textures};
use glam::{DMat4, Vec3};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::Arc;

const AT_HOME: Place<'static> = Place { to_world: &Transform::IDENTITY, places: &[Transform::IDENTITY] };

fn textures(node: Texture) -> Arc<Textures> {
    let one = ImageData { width: 1, height: 1, channels: 1, pixels: Pixels::U8(vec![0]) };
    let store = TextureStore::from_data(one, Encoding::Linear, false).expect("memory");
    Arc::new(Textures::new(vec![node], store, None).expect("one node"))
}

/// u at texture coordinates (u, v).
fn slope() -> Texture {
    let mapping = Mapping::Uv { scale: [1.0; 2], delta: [0.0; 2] };
    let [low, high] = [Rgb::ZERO, Rgb::ONE];
    Texture::Bilerp { mapping, corners: [low, low, high, high] }
}

/// From `distance` towards the origin along +z, 90 degrees wide.
fn view(distance: f64, pixels: u32, edge: f32) -> View {
    let back = DMat4::from_translation(DVec3::new(0.0, 0.0, -distance));
    let camera = Camera {
        kind: CameraKind::Perspective { fov_degrees: 90.0 },
        camera_to_world: Transform::from_matrix(back).expect("a translation"),
        ..Camera::default()
    };
    View::new(&camera, (pixels, pixels), edge)
}

/// `base`, to be moved by the only texture of `textures`.
fn displacement(
    textures: &Arc<Textures>,
    edge_length: Option<f32>,
    view: &View,
    base: TriangleMesh,
) -> Result<Displaced, Error> {
    let what = Displacement { texture: TextureId(0), edge_length, textures, place: AT_HOME, view };
    what.of(base, MAX_TRIANGLES)
}

fn displaced(base: TriangleMesh, node: Texture, edge_length: Option<f32>, view: &View) -> TriangleMesh {
    let moved = displacement(&textures(node), edge_length, view, base);
    let moved = moved.and_then(|moved| moved.whole(MAX_TRIANGLES, &|| false));
    moved.unwrap_or_else(|e| panic!("{e}")).mesh
}

fn square() -> TriangleMesh {
    TriangleMesh {
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
        uvs: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        indices: vec![[0, 1, 2], [0, 2, 3]],
        ..TriangleMesh::default()
    }
}

fn corners(mesh: &TriangleMesh, t: [u32; 3]) -> [DVec3; 3] {
    t.map(|v| Vec3::from(mesh.positions[v as usize]).as_dvec3())
}

fn area(mesh: &TriangleMesh) -> f64 {
    let one = |&t: &[u32; 3]| {
        let [a, b, c] = corners(mesh, t);
        0.5 * (b - a).cross(c - a).length()
    };
    mesh.indices.iter().map(one).sum()
}

#[test]
fn a_plane_moved_by_a_slope_is_the_sloping_plane() {
    let mesh = displaced(square(), slope(), Some(0.1), &view(1e9, 100, 2.0));
    assert!(mesh.indices.len() > 400, "{}", mesh.indices.len());
    for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
        // Half-way points of half-way points are exact here.
        assert_eq!(p[2], p[0]);
        let known = Vec3::new(-1.0, 0.0, 1.0).normalize();
        assert!(Vec3::from(*n).distance(known) < 1e-6, "{n:?}");
    }
    assert!((area(&mesh) - 2f64.sqrt()).abs() < 1e-12, "{}", area(&mesh));
    // Before it was moved no edge was longer.
    for &t in &mesh.indices {
        let [a, b, c] = corners(&mesh, t).map(DVec3::truncate);
        assert!([a.distance(b), b.distance(c), c.distance(a)].iter().all(|&l| l <= f64::from(0.1f32)));
    }
}

#[test]
fn values_that_are_no_numbers_move_nothing() {
    let textures = textures(Texture::Constant(Rgb::splat(f32::NAN)));
    let made = displacement(&textures, Some(0.3), &view(3.0, 10, 2.0), square()).expect("sound");
    let made = made.whole(MAX_TRIANGLES, &|| false).expect("few");
    assert_eq!(made.not_numbers, made.mesh.positions.len() as u64);
    assert!(made.mesh.positions.iter().all(|p| p[2] == 0.0));
    // Neither do positions that are none keep it busy for ever.
    let mut base = square();
    base.positions[1] = [f32::INFINITY, f32::NAN, 0.0];
    base.positions[2] = [3e38, -3e38, 0.0];
    let mesh = displaced(base, slope(), Some(1e37), &view(3.0, 10, 2.0));
    assert!(mesh.indices.len() < 100_000);
}

/// By degrees of latitude and longitude; texture coordinates begin anew at a meridian and at both poles.
fn globe(columns: u32, rows: u32) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for j in 0..=rows {
        for i in 0..=columns {
            let (theta, phi) =
                (PI * f64::from(j) / f64::from(rows), 2.0 * PI * f64::from(i % columns) / f64::from(columns));
            let ring = if j == 0 || j == rows { 0.0 } else { theta.sin() };
            let p = [ring * phi.cos(), ring * phi.sin(), theta.cos()].map(|c| c as f32);
            mesh.positions.push(p);
            mesh.normals.push(p);
            mesh.uvs.push([i as f32 / columns as f32, j as f32 / rows as f32]);
        }
    }
    for j in 0..rows {
        for i in 0..columns {
            let a = j * (columns + 1) + i;
            let (b, c, d) = (a + 1, a + columns + 1, a + columns + 2);
            if j > 0 {
                mesh.indices.push([a, c, b]);
            }
            if j + 1 < rows {
                mesh.indices.push([b, c, d]);
            }
        }
    }
    mesh
}

/// `mesh` without shared vertices or normals, each triangle with texture coordinates of its own.
fn soup(mesh: &TriangleMesh) -> TriangleMesh {
    let mut soup = TriangleMesh::default();
    for (i, t) in mesh.indices.iter().enumerate() {
        for v in t.map(|v| v as usize) {
            soup.positions.push(mesh.positions[v]);
            soup.uvs.push([i as f32 * 0.37 % 1.0, mesh.uvs[v][1]]);
        }
        soup.indices.push([0, 1, 2].map(|k| (3 * i + k) as u32));
    }
    soup
}

/// Edges, by the bits of their ends, that do not have two triangles which run along them in opposite directions.
fn open_edges(mesh: &TriangleMesh) -> usize {
    let place = |v: u32| mesh.positions[v as usize].map(|c| (c + 0.0).to_bits());
    let mut edges: BTreeMap<_, Vec<bool>> = BTreeMap::new();
    for t in &mesh.indices {
        for k in 0..3 {
            let (a, b) = (place(t[k]), place(t[(k + 1) % 3]));
            assert_ne!(a, b, "an edge without length");
            edges.entry((a.min(b), a.max(b))).or_default().push(a < b);
        }
    }
    edges.values().filter(|ways| ways.len() != 2 || ways[0] == ways[1]).count()
}

/// V − E + F of a closed mesh, by places.
fn characteristic(mesh: &TriangleMesh) -> i64 {
    let used = mesh.indices.iter().flatten().map(|&v| mesh.positions[v as usize]);
    let mut places: Vec<_> = used.map(|p| p.map(|c| (c + 0.0).to_bits())).collect();
    places.sort_unstable();
    places.dedup();
    places.len() as i64 - mesh.indices.len() as i64 / 2
}

#[test]
fn a_closed_mesh_stays_closed_at_seams_and_between_rates() {
    // From so near that rates differ all over it, and with a texture that jumps by 1 where it begins anew.
    let near = view(1.3, 200, 2.0);
    let globe = globe(12, 6);
    assert_eq!(open_edges(&globe), 0);
    let mesh = displaced(globe.clone(), slope(), None, &near);
    assert!(mesh.indices.len() > 10_000, "{}", mesh.indices.len());
    let lengths = mesh.indices.iter().map(|&t| {
        let [a, b, _] = corners(&mesh, t);
        a.distance(b)
    });
    let (short, long) = lengths.fold((f64::MAX, 0.0), |(lo, hi), l| (l.min(lo), l.max(hi)));
    assert!(long > 16.0 * short, "rates are about one: {short} to {long}");
    assert_eq!(open_edges(&mesh), 0);
    assert_eq!(characteristic(&mesh), 2);

    // Without shared vertices, and with the normals of its faces.
    let mesh = displaced(soup(&globe), slope(), None, &near);
    assert_eq!(open_edges(&mesh), 0);
    assert_eq!(characteristic(&mesh), 2);
}

/// The test above must be able to fail.
#[test]
fn without_seams_it_opens() {
    let textures = textures(slope());
    let view = view(1.3, 200, 2.0);
    let mut what = displacement(&textures, None, &view, globe(12, 6)).expect("sound");
    assert!(!std::mem::take(&mut what.base.seams).is_empty());
    let made = what.whole(MAX_TRIANGLES, &|| false).expect("few");
    assert!(open_edges(&made.mesh) > 100);
}

#[test]
fn sheets_that_lie_on_one_another_stay_apart() {
    // Four triangles at the edge in the middle: none is the other side's.
    let mut two = square();
    let (upper, n) = (two.clone(), two.positions.len() as u32);
    two.positions.extend(&upper.positions);
    two.uvs.extend(&upper.uvs);
    two.indices.extend(upper.indices.iter().map(|t| [t[0] + n, t[2] + n, t[1] + n]));
    let inner = |seam: &Seam| seam.a == [0, 2];
    assert!(!seams::find(&two.positions, &two.indices, |_, _| true).iter().any(inner));
    let mesh = displaced(two, Texture::Constant(Rgb::ONE), Some(0.2), &view(1e9, 10, 2.0));
    let inside = |p: &&[f32; 3]| (0.01..0.99).contains(&p[0]) && (0.01..0.99).contains(&p[1]);
    assert!(mesh.positions.iter().filter(inside).all(|p| p[2].abs() == 1.0));
}

/// Positions, normals, corners.
type Bits = [Vec<[u32; 3]>; 3];

fn bits(mesh: &TriangleMesh) -> Bits {
    let of = |column: &[[f32; 3]]| column.iter().map(|p| p.map(f32::to_bits)).collect();
    [of(&mesh.positions), of(&mesh.normals), mesh.indices.clone()]
}

#[test]
fn it_depends_on_no_thread_and_on_no_order() {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| displaced(globe(12, 6), slope(), None, &view(1.3, 150, 2.0)))
    };
    assert!(bits(&with(1)) == bits(&with(3)));
    // Turned triangles in another order are the same places.
    let mut other = globe(12, 6);
    other.indices.reverse();
    other.indices.iter_mut().for_each(|t| t.rotate_left(1));
    let other = displaced(other, slope(), None, &view(1.3, 150, 2.0));
    let places = |mesh: &TriangleMesh| {
        let [mut all, ..] = bits(mesh);
        all.sort_unstable();
        all
    };
    assert!(places(&other) == places(&with(2)));
}

#[test]
fn what_would_be_too_many_is_refused_before_it_is_made() {
    let textures = textures(slope());
    let view = view(3.0, 10, 2.0);
    let Err(Error::Resource(line)) = displacement(&textures, Some(1e-5), &view, square()) else {
        panic!("2·10¹⁰ triangles were made")
    };
    assert!(line.contains("(23094011934 at least)"), "{line}");
    let TriangleMesh { positions, indices: triangles, .. } = square();
    let refined = Refined { positions, triangles, ..Refined::default() };
    let divided = refined.clone().divide(1000, |a, b| Some(middle(a, b)), &|| false);
    let Err(Error::Resource(line)) = divided else { panic!("a thousand are not enough") };
    assert!(line.contains("more than 1000 triangles, as many as there is memory for"), "{line}");
    assert!(matches!(refined.divide(1000, |_, _| None, &|| true), Err(Error::Interrupted)));
}

#[test]
fn pixels_of_edges_are_those_of_the_camera() {
    // At distance 10 a pixel of 100 is 0.2 wide; edges may have two.
    let view = view(10.0, 100, 2.0);
    let seen = |places: &[Transform]| {
        let seen = Seen::new(&view, places, DVec3::ZERO, 1.0);
        seen.edge(&seen.spot(DVec3::new(-0.5, 0.0, 0.0)), &seen.spot(DVec3::new(0.5, 0.0, 0.0)))
    };
    let near = |found: f64, known: f64| assert!((found / known - 1.0).abs() < 1e-12, "{found}, not {known}");
    let moved = |by: DVec3| Transform::from_matrix(DMat4::from_translation(by)).expect("a translation");
    near(seen(&[Transform::IDENTITY]), 2.5);
    near(seen(&[moved(DVec3::Z * 10.0)]), 1.25);
    // Behind the eye, and beside the film: an eighth.
    near(seen(&[moved(DVec3::Z * -20.0)]), 2.5 / 8.0);
    let aside = seen(&[moved(DVec3::X * 15.0)]);
    near(aside, 5.0 / (0.02 * (14.5f64 * 14.5 + 100.0).sqrt()) / 8.0 / 5.0 / 2.0);
    // The largest of all; what is not looked at one by one has a bound.
    let many: Vec<Transform> = (0..40).rev().map(|i| moved(DVec3::Z * f64::from(i))).collect();
    near(seen(&many), 2.5);
    let scaled = Transform::from_matrix(DMat4::from_scale(DVec3::splat(3.0))).expect("a scale");
    near(seen(&[Transform::IDENTITY, scaled]), 7.5);
    assert_eq!(seen(&[]), 0.0);
}

fn drawn(strand: &Strand, view: &View) -> TriangleMesh {
    let strands = std::slice::from_ref(strand);
    let mesh = curves::draw(strands, &AT_HOME, view).expect("few");
    let counted = curves::count(strands, &AT_HOME, view);
    assert_eq!(counted, (mesh.positions.len() as u64, mesh.indices.len() as u64));
    mesh
}

fn straight(kind: CurveKind, widths: [f32; 2]) -> Strand {
    let points = vec![
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]],
        [[3.0, 0.0, 0.0], [4.0, 0.0, 0.0], [5.0, 0.0, 0.0], [6.0, 0.0, 0.0]],
    ];
    let normals = if kind == CurveKind::Ribbon { vec![[0.0, 0.0, -1.0]; 3] } else { Vec::new() };
    Strand { kind, points, widths, normals }
}

#[test]
fn a_straight_curve_has_the_area_of_its_outline() {
    for pixels in [10, 100, 1000] {
        let view = view(10.0, pixels, 2.0);
        // Sides of a tube are as long together as the circle, so that the outline is as wide in the mean.
        for kind in [CurveKind::Flat, CurveKind::Cylinder] {
            let found = area(&drawn(&straight(kind, [0.5; 2]), &view));
            assert!((found - PI * 0.5 * 6.0).abs() < 1e-5, "{found}");
        }
        let found = area(&drawn(&straight(CurveKind::Ribbon, [0.5; 2]), &view));
        assert!((found - 3.0).abs() < 1e-6, "{found}");
        let found = area(&drawn(&straight(CurveKind::Ribbon, [0.5, 0.0]), &view));
        assert!((found - 1.5).abs() < 1e-6, "{found}");
        let tip = drawn(&straight(CurveKind::Flat, [0.5, 0.0]), &view);
        assert!((area(&tip) / (PI * 0.25 * 6.0) - 1.0).abs() < 2e-3, "{}", area(&tip));
        for &t in &tip.indices {
            let [a, b, c] = corners(&tip, t);
            assert!((b - a).cross(c - a).length() > 0.0, "a triangle without area");
        }
    }
    let through_the_eye = area(&drawn(&straight(CurveKind::Flat, [0.5; 2]), &view(0.0, 100, 2.0)));
    assert!((through_the_eye - PI * 0.5 * 6.0).abs() < 1e-5, "{through_the_eye}");
    assert!(drawn(&straight(CurveKind::Flat, [0.0; 2]), &view(10.0, 100, 2.0)).indices.is_empty());
}

#[test]
fn normals_look_out_and_triangles_with_them() {
    for kind in [CurveKind::Flat, CurveKind::Ribbon] {
        let mesh = drawn(&straight(kind, [0.5, 0.1]), &view(3.0, 300, 2.0));
        for &t in &mesh.indices {
            let [a, b, c] = corners(&mesh, t);
            let out = t.map(|v| Vec3::from(mesh.normals[v as usize]).as_dvec3()).iter().sum::<DVec3>();
            assert!((b - a).cross(c - a).dot(out) > 0.0, "{kind:?}");
        }
        assert!(mesh.uvs.iter().flatten().all(|c| (0.0..=1.0).contains(c)));
    }
}

/// A cubic at `u`, by its definition.
fn cubic(p: &[[f32; 3]; 4], u: f64) -> DVec3 {
    let p = p.map(|p| Vec3::from(p).as_dvec3());
    (1.0 - u).powi(3) * p[0]
        + 3.0 * (1.0 - u).powi(2) * u * p[1]
        + 3.0 * (1.0 - u) * u * u * p[2]
        + u.powi(3) * p[3]
}

fn from_line(p: DVec3, [a, b]: [DVec3; 2]) -> f64 {
    let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
    p.distance(a + (b - a) * t)
}

#[test]
fn a_bent_curve_is_within_a_quarter_of_a_pixel() {
    let bent = Strand {
        kind: CurveKind::Ribbon,
        points: vec![
            [[-1.0, 0.0, 0.0], [-1.0, 2.0, 0.5], [1.0, -2.0, 0.0], [1.0, 0.3, -0.5]],
            [[1.0, 0.3, -0.5], [1.0, 1.0, 0.0], [0.2, 1.0, 0.0], [0.2, 0.5, 0.0]],
        ],
        widths: [0.02; 2],
        normals: vec![[0.0, 0.0, -1.0]; 3],
    };
    for pixels in [20, 200, 2000] {
        // Nothing is nearer than 2.5, so that a pixel is this wide at least.
        let quarter = 0.25 * 2.0 * 2.5 / f64::from(pixels) * (1.0 + 0.3);
        let mesh = drawn(&bent, &view(3.0, pixels, 2.0));
        let middles: Vec<DVec3> = mesh
            .positions
            .chunks_exact(2)
            .map(|pair| 0.5 * (Vec3::from(pair[0]).as_dvec3() + Vec3::from(pair[1]).as_dvec3()))
            .collect();
        for i in 0..2000 {
            let p = cubic(&bent.points[i / 1000], f64::from(i as u32 % 1000) / 1000.0);
            let far = middles.windows(2).map(|w| from_line(p, [w[0], w[1]])).fold(f64::MAX, f64::min);
            assert!(far < quarter, "{pixels}: {far} of {quarter}");
        }
        assert!(pixels < 2000 || middles.len() < 200, "{}", middles.len());
    }
}

#[test]
fn segments_of_a_smooth_curve_meet_to_the_bit() {
    let text = "WorldBegin\nShape \"curve\" \"string basis\" \"bspline\" \"float width\" .3 \"point3 P\" \
                [ 0 0 0  .7 1 0  2 .3 1  3 1.1 1  3 2 1  2 2.3 .2  1 3 0 ]";
    let scene = crate::scene::pbrt::parse_str(text, std::path::Path::new("s.pbrt")).expect("sound");
    let crate::scene::MeshSource::Curves(strands) = &scene.meshes[0] else { panic!("a curve") };
    assert_eq!(strands[0].points.len(), 4);
    let mesh = drawn(&strands[0], &view(6.0, 300, 2.0));
    // A tube that is open at both ends: as many edges of one triangle as it has sides at these.
    let sides = mesh.uvs.iter().filter(|uv| uv[0] == 0.0).count() / 4 - 1;
    assert_eq!(open_edges(&mesh), 2 * sides);
}

/// Of a triangle: positions, normals and texture coordinates of its corners, in bits.
type Triangle = [[u32; 8]; 3];

fn triangle(mesh: &TriangleMesh, t: [u32; 3]) -> Triangle {
    t.map(|v| {
        let v = v as usize;
        let [p, n] = [&mesh.positions, &mesh.normals].map(|column| column[v].map(f32::to_bits));
        let uv = mesh.uvs.get(v).copied().unwrap_or_default().map(f32::to_bits);
        [p[0], p[1], p[2], n[0], n[1], n[2], uv[0], uv[1]]
    })
}

/// Makes all pieces, some at a time, and holds them against the whole.
#[track_caller]
fn parts_are_the_whole(whole: &TriangleMesh, (parts, pieces): InPieces, at_once: usize) {
    let count: u64 = pieces.iter().map(|p| u64::from(p.triangles)).sum();
    assert_eq!(count, whole.indices.len() as u64);
    let names: Vec<u32> = (0..pieces.len() as u32).collect();
    let (even, odd): (Vec<_>, Vec<_>) =
        names.chunks(at_once).enumerate().partition(|(i, _)| i.is_multiple_of(2));
    let odd: Vec<u32> = odd.into_iter().flat_map(|(_, group)| group).copied().collect();
    let mut seen = vec![false; whole.indices.len()];
    let mut check = |part: Part| {
        assert_eq!(part.names.len(), part.mesh.indices.len());
        assert!(part.names.is_sorted());
        for (&name, &t) in part.names.iter().zip(&part.mesh.indices) {
            let known = triangle(whole, whole.indices[name as usize]);
            assert_eq!(triangle(&part.mesh, t), known, "triangle {name}");
            assert!(!std::mem::replace(&mut seen[name as usize], true), "{name} is made twice");
        }
    };
    even.into_iter().for_each(|(_, group)| check(parts.make(group)));
    // Pieces that are not neighbours, too.
    for k in 0..7 {
        check(parts.make(&odd.iter().skip(k).step_by(7).copied().collect::<Vec<u32>>()));
    }
    assert!(seen.iter().all(|&seen| seen));
}

#[test]
fn a_displaced_mesh_in_parts_is_the_whole() {
    let near = view(1.3, 90, 2.0);
    let globe = globe(12, 6);
    // Without shared vertices, and with seams of light.
    let soup = soup(&globe);
    // A sheet and its other side share all vertices, and so what is made between them.
    let mut leaf = square();
    leaf.normals = vec![[0.0, 0.0, 1.0]; 4];
    leaf.indices.extend([[0, 2, 1], [3, 2, 0], [1, 0, 2]]);
    // Numbers without all their digits have a middle beside them.
    let mut small = square();
    small.positions.iter_mut().for_each(|p| p[2] = if p[0] > 0.0 { 1.4e-45 } else { 4.2e-45 });
    // Many triangles at one vertex, of all sizes.
    let mut fan = TriangleMesh { positions: vec![[0.0; 3]], uvs: vec![[0.0; 2]], ..TriangleMesh::default() };
    for i in 0..600u16 {
        let angle = 2.0 * PI * f64::from(i) / 600.0;
        fan.positions.push([angle.cos() as f32, angle.sin() as f32, 0.0]);
        fan.uvs.push([f32::from(i) / 600.0, 1.0]);
        fan.indices.push([0, u32::from(i) + 1, (u32::from(i) + 1) % 600 + 1]);
    }
    for base in [square(), globe, soup, leaf, small, fan] {
        let whole = displaced(base.clone(), slope(), None, &near);
        assert!(whole.indices.len() > 1000, "{}", whole.indices.len());
        for (most, at_once) in [(1, 40), (30, 1), (30, 9), (100_000, 3)] {
            let moved = displacement(&textures(slope()), None, &near, base.clone()).expect("sound");
            let pieces = Patches::divide(moved, most, MAX_TRIANGLES, &|| false).expect("few");
            parts_are_the_whole(&whole, pieces, at_once);
        }
    }
}

#[test]
fn curves_in_parts_are_the_whole() {
    let text = "WorldBegin\nShape \"curve\" \"string basis\" \"bspline\" \"float width0\" .3 \"float width1\" 0 \
                \"point3 P\" [ 0 0 0  .7 1 0  2 .3 1  3 1.1 1  3 2 1  2 2.3 .2  1 3 0 ]\n\
                Shape \"curve\" \"string type\" \"ribbon\" \"point3 P\" [ -1 0 0 -.3 1 0 .4 -1 0 1 0 0 ] \"float width\" \
                .5 \"normal N\" [ 0 0 1  0 .6 .8 ]";
    let scene = crate::scene::pbrt::parse_str(text, std::path::Path::new("s.pbrt")).expect("sound");
    let view = view(6.0, 700, 2.0);
    for mesh in &scene.meshes {
        let crate::scene::MeshSource::Curves(strands) = mesh else { panic!("curves") };
        let whole = curves::draw(strands, &AT_HOME, &view).expect("few");
        for (most, at_once) in [(1, 5), (20, 1), (100_000, 2)] {
            let pieces = curves::divide(strands, &AT_HOME, &view, most).expect("few");
            parts_are_the_whole(&whole, pieces, at_once);
        }
    }
}

#[test]
fn a_subdivision_surface_in_parts_is_the_whole() {
    use crate::geometry::subdivision::{divide, subdivide};
    use crate::scene::Cage;
    let mut globe = globe(8, 5);
    // Closed but for a hole, with a fan of its own at one vertex, which two faces touch in a point.
    let last = globe.positions.len() as u32;
    globe.positions.extend([[2.0, 0.0, 1.0], [2.0, 0.5, 1.0]]);
    globe.indices.remove(7);
    globe.indices.push([globe.indices[20][0], last, last + 1]);
    for control in [square(), globe] {
        for levels in [0, 1, 4] {
            let cage = Cage::Loop(Arc::new(control.clone()));
            let whole = subdivide(&cage, levels, &|| false).expect("small");
            for (most, at_once) in [(1, 13), (16, 3), (100_000, 5)] {
                parts_are_the_whole(&whole, divide(&cage, levels, most).expect("small"), at_once);
            }
        }
    }
}

#[test]
fn a_catmull_clark_surface_in_parts_is_the_whole() {
    use crate::geometry::subdivision::{divide, subdivide};
    use crate::scene::{Cage, PolygonMesh};
    // A globe of squares with triangles at its poles, a hole, and a pentagon of its own at one vertex.
    let (across, up) = (7u32, 4u32);
    let mut mesh = PolygonMesh::default();
    for y in 0..=up {
        for x in 0..across {
            let (s, c) = (2.0 * PI * f64::from(x) / f64::from(across)).sin_cos();
            let (high, wide) = (PI * (f64::from(y) + 0.4) / (f64::from(up) + 0.8)).sin_cos();
            mesh.positions.push([c * high, s * high, wide * (1.0 + 0.2 * s)].map(|v| v as f32));
        }
    }
    let mut add = |corners: &[u32]| {
        mesh.corners.extend_from_slice(corners);
        mesh.ends.push(mesh.corners.len() as u32);
    };
    for y in 0..up {
        for x in 0..across {
            let at = |x: u32, y: u32| y * across + x % across;
            match (x, y) {
                (3, 2) => {}
                (5, 1) => {
                    add(&[at(x, y), at(x + 1, y), at(x + 1, y + 1)]);
                    add(&[at(x, y), at(x + 1, y + 1), at(x, y + 1)]);
                }
                _ => add(&[at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]),
            }
        }
    }
    let lid: Vec<u32> = (0..across).rev().collect();
    add(&lid);
    let last = mesh.positions.len() as u32;
    mesh.positions.extend([[2.0, 0.0, 1.0], [2.0, 0.5, 1.0], [2.5, 0.5, 1.0], [2.5, 0.0, 1.0]]);
    mesh.corners.extend([9, last, last + 1, last + 2, last + 3]);
    mesh.ends.push(mesh.corners.len() as u32);
    let cage = Cage::CatmullClark(Arc::new(mesh));
    for levels in [1, 2, 4] {
        let whole = subdivide(&cage, levels, &|| false).expect("small");
        for (most, at_once) in [(1, 13), (16, 3), (100_000, 5)] {
            parts_are_the_whole(&whole, divide(&cage, levels, most).expect("small"), at_once);
        }
    }
}
