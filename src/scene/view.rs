//! What a model alone cannot say: where to look from, and by what light. A model is seen from a little
//! above and beside, filling four fifths of the frame; one that is open to a side (a box without its
//! front) is seen through the opening; a closed room from inside. A soft sky and a sun light it,
//! unless it is a room with lamps of its own. Never moves the model.

use crate::color::Rgb;
use crate::math::{DMat4, DVec3, Transform};
use crate::scene::{Camera, CameraKind, Integrator, Light, MeshSource, SceneDescription, ShapeKind};

/// Part of the frame that the model fills.
const FILL: f64 = 0.8;
const FOV_DEGREES: f32 = 40.0;
/// Inside a room more has to be in view.
const ROOM_FOV_DEGREES: f32 = 75.0;

/// How a model lies in space.
struct Extent {
    lo: DVec3,
    hi: DVec3,
    /// Σ of the triangles' area vectors over the sum of areas: 0 for a closed surface.
    opening: DVec3,
    /// The volume by the divergence theorem over that of the bounds; negative when normals look in.
    volume: f64,
}

/// Adds camera, film defaults and lights to a scene of meshes.
pub(super) fn add_camera_and_lights(scene: &mut SceneDescription) {
    scene.spp = 32;
    scene.integrator = Integrator { max_depth: 8, ..Integrator::default() };
    let e = extent(scene);
    let centre = 0.5 * (e.lo + e.hi);
    let size = e.hi - e.lo;
    let room = e.volume < -0.3;
    let sideways = DVec3::new(e.opening.x, 0.0, e.opening.z);
    let open = sideways.length() > 0.05 && sideways.length() > e.opening.y.abs();
    let aspect = f64::from(scene.film.size.0) / f64::from(scene.film.size.1);

    let (dir, eye, fov_degrees) = if room && !open {
        // From the middle of one short wall to the other, a little off it so as not to be in it.
        let dir = if size.x > size.z { -DVec3::X } else { -DVec3::Z };
        (dir, centre - dir * (0.48 * (size * dir).length()), ROOM_FOV_DEGREES)
    } else {
        let from = if open { sideways.normalize() } else { DVec3::new(0.55, 0.4, 0.8).normalize() };
        let eye = centre + from * distance_to_fit(scene, centre, -from, aspect);
        (-from, eye, FOV_DEGREES)
    };
    scene.camera = Camera {
        kind: CameraKind::Perspective { fov_degrees },
        camera_to_world: look(eye, dir),
        ..Camera::default()
    };
    if !room || scene.area_lights.is_empty() {
        add_sky(scene, dir);
    }
}

fn add_sky(scene: &mut SceneDescription, dir: DVec3) {
    let (right, up, forward) = basis(dir);
    // Behind the left shoulder and above: shape reads where light crosses the view.
    let towards = (-0.45 * right + 0.75 * up - 0.6 * forward).normalize();
    scene.lights.push(Light::Constant { radiance: Rgb::new(0.5, 0.56, 0.65) });
    scene.lights.push(Light::Distant {
        irradiance: Rgb::new(1.75, 1.65, 1.5),
        towards: towards.as_vec3().to_array(),
    });
}

fn triangles(scene: &SceneDescription) -> impl Iterator<Item = [DVec3; 3]> + '_ {
    meshes(scene).flat_map(|m| {
        let at = |i: u32| glam::Vec3::from(m.positions[i as usize]).as_dvec3();
        m.indices.iter().map(move |t| t.map(at))
    })
}

fn meshes(scene: &SceneDescription) -> impl Iterator<Item = &crate::scene::TriangleMesh> {
    scene.shapes.iter().filter_map(|s| match s.kind {
        ShapeKind::Mesh(id) => match &scene.meshes[id.index()] {
            MeshSource::Inline(mesh) => Some(&**mesh),
            _ => None,
        },
        _ => None,
    })
}

fn extent(scene: &SceneDescription) -> Extent {
    let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (mut area, mut sum) = (0.0, DVec3::ZERO);
    for t in triangles(scene) {
        for p in t {
            (lo, hi) = (lo.min(p), hi.max(p));
        }
        let n = 0.5 * (t[1] - t[0]).cross(t[2] - t[0]);
        sum += n;
        area += n.length();
    }
    let centre = 0.5 * (lo + hi);
    let volume: f64 =
        triangles(scene).map(|[a, b, c]| (a - centre).dot((b - centre).cross(c - centre)) / 6.0).sum();
    let bounds = (hi - lo).element_product();
    Extent {
        lo,
        hi,
        opening: if area > 0.0 { sum / area } else { DVec3::ZERO },
        volume: if bounds > 0.0 { volume / bounds } else { 0.0 },
    }
}

/// Right, up and forward of a view along unit `dir`, right-handed world, y up.
fn basis(dir: DVec3) -> (DVec3, DVec3, DVec3) {
    let right = dir.cross(DVec3::Y).try_normalize().unwrap_or(DVec3::X);
    (right, right.cross(dir), dir)
}

fn look(eye: DVec3, dir: DVec3) -> Transform {
    let (right, up, forward) = basis(dir);
    let m = DMat4::from_cols(right.extend(0.0), up.extend(0.0), forward.extend(0.0), eye.extend(1.0));
    Transform::from_matrix(m).unwrap_or(Transform::IDENTITY)
}

/// From how far along −`dir` every vertex falls into the middle [`FILL`] of the frame.
fn distance_to_fit(scene: &SceneDescription, centre: DVec3, dir: DVec3, aspect: f64) -> f64 {
    let (right, up, forward) = basis(dir);
    let tan = FILL * (0.5 * f64::from(FOV_DEGREES).to_radians()).tan();
    let (tan_x, tan_y) = if aspect >= 1.0 { (tan * aspect, tan) } else { (tan, tan / aspect) };
    let mut distance: f64 = 0.0;
    for p in meshes(scene).flat_map(|m| &m.positions) {
        let q = glam::Vec3::from(*p).as_dvec3() - centre;
        let along = q.dot(forward);
        let aside = (q.dot(right).abs() / tan_x).max(q.dot(up).abs() / tan_y);
        distance = distance.max(aside - along);
    }
    // A model that is a point or a needle along the view still needs a place to look from.
    if distance > 0.0 { distance } else { 1.0 }
}
