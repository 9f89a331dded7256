use super::*;
use crate::integrator::camera::{Camera, CameraRay};
use crate::math::Vec2;
use crate::scene::{self, CameraKind};
use glam::{DMat2, DVec3, Vec3A};

/// Singular values of the matrix with columns `a` and `b` in the plane, larger first.
fn singular(a: DVec3, b: DVec3) -> [f64; 2] {
    let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
    let mean = 0.5 * (aa + bb);
    let half = (0.25 * (aa - bb) * (aa - bb) + ab * ab).sqrt();
    let det = DMat2::from_cols_array(&[aa, ab, ab, bb]).determinant().max(0.0);
    let large = mean + half;
    [large.sqrt(), (det / large).sqrt()]
}

/// Where the ray meets the plane through `p` with normal `n`, and how far it went.
fn meet(ray: &crate::accel::Ray, p: DVec3, n: DVec3) -> (DVec3, f64) {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let t = (p - o).dot(n) / d.dot(n);
    (o + d * t, t)
}

#[test]
fn a_camera_cone_cuts_the_ellipse_of_its_pixel_from_a_tilted_plane() {
    for (kind, area_error, axis_error) in [
        // Pixels of a flat film are not square off the axis: 13 degrees off, cos = 0.97.
        (CameraKind::Perspective { fov_degrees: 35.0 }, 0.02, 0.05),
        (CameraKind::Orthographic, 1e-3, 1e-3),
        // Equal areas, but of any shape.
        (CameraKind::Spherical { equal_area: true }, 0.02, 1.0),
    ] {
        let camera = scene::Camera { kind: kind.clone(), ..scene::Camera::default() };
        let camera = Camera::new(&camera, (300, 200));
        for raster in [Vec2::new(131.3, 83.4), Vec2::new(60.0, 150.0), Vec2::new(190.0, 40.0)] {
            let ray_at =
                |dx: f32, dy: f32| camera.ray(raster + Vec2::new(dx, dy), Vec2::splat(0.5), true).ray;
            let CameraRay { ray, cone } = camera.ray(raster, Vec2::splat(0.5), true);
            let d = ray.direction.as_dvec3();
            for tilt in [0.0, 0.5, 1.0, 1.3] {
                let side = d.cross(DVec3::new(0.3, 1.0, 0.2)).normalize();
                let n = -d * f64::cos(tilt) + side * f64::sin(tilt);
                let p = ray.origin.as_dvec3() + d * 7.0;
                // Half a pixel to each side.
                let step = |dx: f32, dy: f32| meet(&ray_at(dx, dy), p, n).0 - meet(&ray_at(-dx, -dy), p, n).0;
                let want = singular(step(0.5, 0.0), step(0.0, 0.5));
                let [long, short] = ellipse(cone.width_at(7.0), ray.direction.into(), n.as_vec3a())
                    .axes()
                    .map(|v| v.as_dvec3());
                assert!(
                    long.dot(short).abs() < 1e-6 && long.dot(n).abs() < 1e-6 && short.dot(n).abs() < 1e-6
                );
                let area = long.length() * short.length() / (want[0] * want[1]);
                assert!((area - 1.0).abs() < area_error, "{kind:?} {raster} {tilt}: area {area}");
                let ratio = [long.length() / want[0], short.length() / want[1]];
                let worst = ratio.map(|r| (r - 1.0).abs()).into_iter().fold(0.0, f64::max);
                assert!(worst < axis_error, "{kind:?} {raster} {tilt}: {ratio:?}");
            }
        }
    }
}

fn flat(through: Option<f32>) -> Event {
    Event { curvature: 0.0, cos_in: 1.0, cos_out: 1.0, through, rough: 0.0 }
}

#[test]
fn a_flat_mirror_is_a_window_into_its_picture() {
    let cone = Cone { width: 0.1, spread: 0.02 };
    let behind = cone.after(3.0, &Event { cos_in: 0.4, cos_out: 0.4, ..flat(None) });
    assert!((behind.width_at(4.0) - cone.width_at(7.0)).abs() < 1e-6);
}

#[test]
fn curved_mirrors_and_lenses_have_their_focal_lengths() {
    let beam = Cone { width: 0.01, spread: 0.0 };
    // Concave, radius 2: a parallel beam meets at half the radius; convex: as from there.
    let concave = beam.after(5.0, &Event { curvature: -0.5, ..flat(None) });
    assert!(concave.width_at(1.0).abs() < 1e-7);
    // Behind the focus it is as wide as before, on the other side.
    assert!((concave.width_at(2.0) + 0.01).abs() < 1e-7);
    let convex = beam.after(5.0, &Event { curvature: 0.5, ..flat(None) });
    assert!((convex.width_at(1.0) - 0.02).abs() < 1e-7);
    // A ball of glass, radius 2: its back focus is at R (2 − η)/(2 (η − 1)) behind it.
    let (r, eta) = (2.0f32, 1.5f32);
    let inside = beam.after(5.0, &Event { curvature: 1.0 / r, ..flat(Some(eta)) });
    let out = inside.after(2.0 * r, &Event { curvature: -1.0 / r, ..flat(Some(1.0 / eta)) });
    let focus = r * (2.0 - eta) / (2.0 * (eta - 1.0));
    assert!(out.width_at(focus).abs() < 1e-6, "{} at {focus}", out.width_at(focus));
    assert!(out.width > 0.0 && out.spread < 0.0);
}

/// Four neighbours of a ray through a flat interface, in f64, against the cone.
#[test]
fn refraction_spreads_a_cone_as_snells_law_spreads_its_rays() {
    let n = DVec3::Z;
    for eta in [1.5f64, 1.0 / 1.33] {
        for angle in [0.0f64, 0.3, 0.6] {
            let d = DVec3::new(angle.sin(), 0.0, -angle.cos());
            let refract = |d: DVec3| {
                let cos = -d.dot(n);
                let k = 1.0 - (1.0 - cos * cos) / (eta * eta);
                d / eta + n * (cos / eta - k.sqrt())
            };
            let spread = 1e-3;
            let sides = [DVec3::new(angle.cos(), 0.0, angle.sin()), DVec3::Y];
            let out = refract(d);
            // Solid angle behind the interface over that in front: product of both directions.
            let [x, y] = sides.map(|s| {
                (refract((d + s * spread * 0.5).normalize()) - refract((d - s * spread * 0.5).normalize()))
                    .length()
            });
            let cone = Cone { width: 0.0, spread: spread as f32 };
            let event =
                Event { cos_in: angle.cos() as f32, cos_out: -out.z as f32, ..flat(Some(eta as f32)) };
            let got = f64::from(cone.after(1.0, &event).spread);
            let want = (x * y).sqrt();
            assert!((got / want - 1.0).abs() < 1e-3, "{eta} {angle}: {got}, not {want}");
        }
    }
}

#[test]
fn a_sample_stands_for_its_share_of_the_solid_angle() {
    // 64 samples of a uniform hemisphere: each has 2π/64, a cone of half-angle 0.18.
    let angle = sample_angle(1.0 / (2.0 * std::f32::consts::PI), 1.0 / 8.0);
    let solid = 2.0 * std::f32::consts::PI * (1.0 - (0.5 * angle).cos());
    assert!((solid * 64.0 / (2.0 * std::f32::consts::PI) - 1.0).abs() < 0.01);
    assert!(sample_angle(0.0, 1.0) <= std::f32::consts::PI);
    let cone = Cone { width: -0.2, spread: -0.1 };
    let after = cone.after(1.0, &Event { rough: angle, ..flat(None) });
    assert!(after.width > 0.0 && after.spread == angle);
    let fine = cone.after(1.0, &Event { rough: 0.01, ..flat(None) });
    assert_eq!(fine.spread, -0.1);
}

#[test]
fn grazing_rays_see_bounded_ellipses() {
    for cos in [0.0f32, 1e-8, 0.01, 1.0, -1.0] {
        let d = Vec3A::new((1.0 - cos * cos).sqrt(), 0.0, -cos);
        let [long, short] = ellipse(0.5, d, Vec3A::Z).axes();
        assert!(long.is_finite() && long.length() <= 0.5 * MAX_STRETCH * 1.001);
        assert!((short.length() - 0.5).abs() < 1e-6);
    }
}
