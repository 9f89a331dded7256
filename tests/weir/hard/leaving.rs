//! Rays that leave surfaces: none may meet again the primitive that it left (shadow acne), and none that starts inside
//! a closed surface may get out without meeting it (a light leak). On a series of world offsets and scales.
//!
//! Invariant: points, their error bounds and the moved origins are the renderer's own (`Surfaces::surface_point`,
//! `offset_origin`); where the truth is needed it is decided in f64 on the shapes as rounded.

use super::{Effort, Row, Table, Tracer};
use crate::closed::{Placement, Random, Rounded, is_inside};
use crate::support::{Frame, head, icosphere, scene};
use glam::{DMat3, DVec3, Vec3, Vec3A};
use weir::accel::{Accel, Hit, NONE, Ray};
use weir::geometry::made::{Making, View};
use weir::geometry::{
    Kinds, Needs, SceneGeometry, SurfacePoint, SurfaceShape, Surfaces, load, offset_origin,
};

pub(super) const CUBE: &str = "Shape \"trianglemesh\" \"point3 P\" [ -1 -1 -1  1 -1 -1  -1 1 -1  1 1 -1  -1 -1 1  1 -1 1 \
     -1 1 1  1 1 1 ]\n\"integer indices\" [ 0 2 1  1 2 3   4 5 6  5 7 6   0 1 4  1 5 4   2 6 3  3 6 7   0 4 2  2 4 6 \
     1 3 5  3 7 5 ]\n";

/// Closed and convex, of about unit size.
pub(super) fn shapes() -> Vec<(&'static str, String)> {
    vec![
        ("cube", CUBE.to_owned()),
        ("cube, turned", format!("Rotate 33 .3 1 .2\n{CUBE}")),
        ("long thin box, turned", format!("Rotate 50 1 .2 .4\nScale 1 1e-3 1e-3\n{CUBE}")),
        ("sphere of 320 triangles", format!("Shape \"trianglemesh\" {}\n", icosphere(2))),
        ("sphere", "Shape \"sphere\"\n".to_owned()),
        ("ellipsoid", "Rotate 40 1 1 0\nScale 1 .2 .6\nShape \"sphere\"\n".to_owned()),
    ]
}

/// Where the world is put: distance from the zero point, and scale.
///
/// A size below 2¹⁰ units in the last place of the offset leaves no shape to speak of: such places are left out.
pub(super) fn places() -> Vec<(f64, f64)> {
    let mut places = Vec::new();
    for offset in [0.0, 1e3, 1e5, 1e7] {
        for scale in [1e-8, 1e-4, 1.0, 1e4, 1e8] {
            if scale >= 1024.0 * offset * f64::from(f32::EPSILON) {
                places.push((offset, scale));
            }
        }
    }
    places
}

pub(super) fn centre(offset: f64) -> DVec3 {
    DVec3::new(0.8, -0.5, 0.33) * offset
}

fn place_text((offset, scale): (f64, f64)) -> String {
    let c = centre(offset);
    format!("Translate {} {} {}\nScale {scale} {scale} {scale}\n", c.x, c.y, c.z)
}

pub(super) fn place_name((offset, scale): (f64, f64)) -> String {
    format!("at {offset:e}, scale {scale:e}")
}

/// A loaded scene of `text`.
pub(super) fn geometry(text: &str) -> SceneGeometry {
    let frame = Frame { size: (1, 1), spp: 1, max_depth: 1 };
    let scene = scene(&(head("Camera \"orthographic\"", frame) + text));
    let view = View::new(&scene.camera, (1, 1), 1.0);
    load(&scene, None, &Making::new(&view, None, None), &|| false).expect("a good scene")
}

/// A loaded scene, traced.
pub(super) struct Traced<'a> {
    pub(super) accel: Box<dyn Accel + 'a>,
    surfaces: Surfaces<'a>,
}

impl<'a> Traced<'a> {
    pub(super) fn new(geometry: &'a SceneGeometry, tracer: Tracer) -> Self {
        let (world, objects, instances) = geometry.for_backend();
        let accel =
            tracer.builder().build(&world, &objects, &instances, geometry, None).expect("a small scene");
        Self { accel, surfaces: Surfaces::new(geometry, |_| Needs::default()) }
    }

    pub(super) fn point(&self, hit: &Hit, ray: &Ray) -> SurfacePoint {
        self.surfaces.surface_point(hit, self.surfaces.surface_of(hit, Kinds::ALL), || *ray, Kinds::ALL)
    }
}

/// A unit vector at random.
pub(super) fn direction(random: &mut Random) -> DVec3 {
    loop {
        let v = random.point();
        if (1e-3..1.0).contains(&v.length()) {
            return v.normalize();
        }
    }
}

/// A direction off a surface of normal `n`: to either side; half of them at angles from 90° down to 1e-8 of a radian.
fn leaving(random: &mut Random, n: DVec3) -> DVec3 {
    let d = direction(random);
    if random.unit() < 0.5 {
        return d;
    }
    let along = (d - n * d.dot(n)).normalize_or_zero();
    let sine = 10f64.powf(-8.0 * random.unit()) * if random.unit() < 0.5 { 1.0 } else { -1.0 };
    along * (1.0 - sine * sine).sqrt() + n * sine
}

/// Whether `o` is inside the closed shape of `geometry` for certain, in its instance if it has one.
fn inside(geometry: &SceneGeometry, o: DVec3) -> bool {
    let placement = geometry.instances.first().map(|i| {
        let m = i.to_world.m;
        Placement::new(DMat3::from_mat4(m), m.w_axis.truncate())
    });
    let (o, slack) = placement.map_or((o, 0.0), |p| (p.to_object(o), p.slack(o)));
    match &geometry.surfaces[0].shape {
        SurfaceShape::Mesh(mesh) => {
            let rounded = Rounded { positions: mesh.positions.clone(), indices: mesh.indices.clone() };
            is_inside(&rounded, o, slack)
        }
        // Met in f64, in its own space: what rounds there is 2⁻⁵⁰ of the coordinates.
        SurfaceShape::Quadric(q) => {
            let inverse = &q.to_world.inv;
            let size = inverse.w_axis.truncate().length() + 1.0;
            let stretch = inverse.x_axis.length() + inverse.y_axis.length() + inverse.z_axis.length();
            inverse.transform_point3(o).length() < 1.0 - size * 0.5f64.powi(50) - stretch * slack
        }
        _ => unreachable!("shapes are meshes and spheres"),
    }
}

/// The point that a hit names, in f64, and its distance from the nearest other face, for boxes.
fn past_a_wall(geometry: &SceneGeometry, hit: &Hit) -> Option<f64> {
    let SurfaceShape::Mesh(mesh) = &geometry.surfaces[0].shape else { return None };
    let corners = |i: usize| mesh.indices[i].map(|v| Vec3::from(mesh.positions[v as usize]).as_dvec3());
    let [a, b, c] = corners(hit.primitive as usize);
    let (u, v) = (f64::from(hit.u), f64::from(hit.v));
    let (p, n) = (a + (b - a) * u + (c - a) * v, (b - a).cross(c - a).normalize_or_zero());
    let others = (0..mesh.indices.len()).filter_map(|i| {
        let [a, b, c] = corners(i);
        let m = (b - a).cross(c - a).normalize_or_zero();
        // The other half of its own face is no wall.
        (m.dot(n) < 0.999).then(|| (p - a).dot(m).abs())
    });
    Some(others.fold(f64::INFINITY, f64::min))
}

/// Of rays that leave one shape in one place: acne, leaks, and points from which the moved origin is past a wall.
struct Found {
    acne: Row,
    leaks: Row,
    past: Row,
}

impl Found {
    fn new(what: &str, tracer: Tracer) -> Self {
        let row = |kind: &str, bound| Row::new(format!("{kind}: {what}"), tracer, bound, false);
        Self {
            acne: row("rays that meet again what they left", 0.0),
            leaks: row("rays from inside that get out", 0.0),
            past: row(
                "origins moved past a wall, and that wall's distance over the error",
                2.0 * 3f64.sqrt(),
            ),
        }
    }

    fn rows(self) -> impl Iterator<Item = Row> {
        // Nothing was past a wall: nothing to show.
        [self.acne, self.leaks, self.past].into_iter().filter(|row| row.tried > 0)
    }
}

/// `count` rays to the shape of `geometry` (alone in its world, around `centre`) and on from there.
fn leave(
    geometry: &SceneGeometry,
    (centre, size): (DVec3, f64),
    tracer: Tracer,
    count: usize,
    found: &mut Found,
) {
    let traced = Traced::new(geometry, tracer);
    let mut random = Random(size.to_bits() ^ centre.x.to_bits());
    for i in 0..count {
        let target = centre + random.point() * 0.6 * size;
        let away = if i % 3 == 0 { random.unit() } else { 2.0 + 30.0 * random.unit() * random.unit() };
        let origin = centre + direction(&mut random) * away * size;
        let ray = Ray::new(origin.as_vec3(), (target - origin).normalize().as_vec3());
        let hit = traced.accel.closest(&ray);
        if hit.geometry == NONE {
            continue;
        }
        let point = traced.point(&hit, &ray);
        let d = leaving(&mut random, Vec3::from(point.ng).as_dvec3()).as_vec3();
        let side = point.ng.dot(Vec3A::from(d));
        let start = Vec3::from(offset_origin(point.p, point.error, point.ng, d.into()));
        let next = Ray::new(start, d);
        let again = traced.accel.closest(&next);
        let same =
            [again.geometry, again.primitive, again.instance] == [hit.geometry, hit.primitive, hit.instance];
        let triangle = matches!(geometry.surfaces[0].shape, SurfaceShape::Mesh(_));
        let example = || format!("{next:?} left {hit:?} at {point:?} and met {again:?}");
        // A round surface is met again from within, at the far end of the chord.
        if triangle || side > 0.0 {
            found.acne.count(same, example);
        }
        if side < 0.0 {
            if inside(geometry, start.as_dvec3()) {
                found.leaks.count(again.geometry == NONE, example);
            } else if geometry.instances.is_empty()
                && let Some(distance) = past_a_wall(geometry, &hit)
                && outside(geometry, start.as_dvec3())
            {
                found.past.measure(distance / f64::from(point.error), example);
            }
        }
    }
}

/// Whether `o` is outside a convex mesh, by more than f64 rounds.
fn outside(geometry: &SceneGeometry, o: DVec3) -> bool {
    let SurfaceShape::Mesh(mesh) = &geometry.surfaces[0].shape else { return false };
    mesh.indices.iter().any(|t| {
        let [a, b, c] = t.map(|v| Vec3::from(mesh.positions[v as usize]).as_dvec3());
        let n = (b - a).cross(c - a);
        (o - a).dot(n) > 1e-12 * (o - a).length() * n.length()
    })
}

/// **What must hold.** A ray that leaves a triangle from the moved origin never meets it again, on either side; one that
/// leaves a sphere outwards never meets it again. A ray from a moved origin that is inside a closed mesh by the
/// rule of `closed.rs`, or inside a sphere, meets it.
///
/// **Why.** The origin lies at least error·|n|₁ less the point's own rounding above the plane: INTERPOLATION pays for
/// that rounding, and PLANE = γ₁₀ of the longest edge component E is left. The native test answers exactly for
/// a triangle whose corners are moved by at most 7u·E along two axes (`accel/bvh/query.rs`), which raises no point of
/// it by more than 7u·E·|n|₁ < γ₁₀·E·|n|₁. So the ray starts above the moved triangle, and goes up. A sphere is met in
/// f64. The second claim is that of `watertight.rs`, for origins as the renderer makes them.
///
/// **Past a wall.** Where a face's point is nearer to another face than its own error, the moved origin may lie outside:
/// no leak of the traversal, but light that gets in. From the exact point, the origin is at most √3·error off by
/// rounding and √3·error by the move, and the way between crosses the other face: so that face's distance from the
/// point is at most 2√3 = 3.46 errors.
///
/// Embree's distances to a triangle are γ₈·|e₁|·|e₂|·|c|/|n| off, which nothing bounds for slivers, and its fast mode
/// is not watertight: it is counted.
pub(super) fn acne_and_leaks(effort: Effort) -> Table {
    let mut table = Table::default();
    let count = effort.of(400, 60_000);
    for (_, text) in shapes() {
        for tracer in Tracer::ALL {
            for offset in [0.0, 1e3, 1e5, 1e7] {
                let mut found = Found::new(&format!("at {offset:e}"), tracer);
                for place in places().into_iter().filter(|p| p.0 == offset) {
                    let geometry = geometry(&(place_text(place) + &text));
                    leave(&geometry, (centre(offset), place.1), tracer, count, &mut found);
                }
                table.extend(found.rows());
            }
        }
    }
    table
}

/// As [`acne_and_leaks`], through instances that mirror, stretch and shear: no ray meets again what it left.
///
/// **Why.** A point's bound in the object's space is stretched by the transform; to it comes what the traversal rounds on
/// the way of the moved origin into that space, seen in the world.
pub(super) fn instances(effort: Effort) -> Table {
    let mut table = Table::default();
    let count = effort.of(1000, 80_000);
    let shears = [
        ("mirrored", "Scale -1 1 1", 1.0),
        ("scaled by 0.01, 1 and 100", "Scale 1e-2 1 1e2", 1.0),
        ("scaled by 1e6", "Scale 1e6 1e6 1e6", 1e6),
        ("scaled by 1e-6", "Scale 1e-6 1e-6 1e-6", 1e-6),
        ("sheared", "ConcatTransform [ 1 0 0 0  3 1 0 0  -1 2 1 0  0 0 0 1 ]", 1.0),
        ("sheared a hundredfold", "ConcatTransform [ 1 0 0 0  100 1 0 0  0 0 1 0  0 0 0 1 ]", 1.0),
    ];
    for (_, text) in shapes() {
        for (kind, transform, size) in shears {
            for tracer in Tracer::ALL {
                let mut found = Found::new(&format!("instances, {kind}"), tracer);
                for offset in [0.0, 1e3, 1e5].into_iter().filter(|o| o * 1e-4 < size) {
                    let c = centre(offset);
                    let text = format!(
                        "ObjectBegin \"o\"\nAttributeBegin\n{text}AttributeEnd\nObjectEnd\n\
                         Translate {} {} {}\n{transform}\nObjectInstance \"o\"\n",
                        c.x, c.y, c.z
                    );
                    leave(&geometry(&text), (c, size), tracer, count, &mut found);
                }
                table.extend(found.rows());
            }
        }
    }
    table
}

#[test]
fn rays_that_leave_do_not_meet_again_and_do_not_get_out() {
    acne_and_leaks(Effort::Quick).assert_holds();
}

#[test]
fn rays_that_leave_instances_do_not_meet_again() {
    instances(Effort::Quick).assert_holds();
}

/// The tests above must be able to fail: without the offset rays do meet again what they left.
#[test]
fn without_an_offset_there_is_acne() {
    let geometry = geometry(&(place_text((1e3, 1.0)) + &shapes()[1].1));
    let traced = Traced::new(&geometry, Tracer::Native);
    let mut random = Random(3);
    let mut acne = 0;
    for _ in 0..4000 {
        let c = centre(1e3);
        let origin = c + direction(&mut random) * 5.0;
        let ray = Ray::new(origin.as_vec3(), (c + random.point() * 0.5 - origin).normalize().as_vec3());
        let hit = traced.accel.closest(&ray);
        let point = traced.point(&hit, &ray);
        let d = leaving(&mut random, Vec3::from(point.ng).as_dvec3()).as_vec3();
        let again = traced.accel.closest(&Ray::new(point.p.into(), d));
        acne += u32::from(again.geometry != NONE && again.primitive == hit.primitive);
    }
    assert!(acne > 100, "{acne}");
}
