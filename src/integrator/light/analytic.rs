//! Irradiance in closed form, for tests: what a render of these scenes must converge to. All at
//! unit radiance, nothing occluded. Never used while rendering.

use glam::{DVec3, Vec3};
use std::f64::consts::PI;

/// From a polygon wholly above the horizon of `n` (Lambert 1760): ½ |Σ Θᵢ n·Γᵢ|.
pub(crate) fn polygon_irradiance(p: Vec3, n: Vec3, vertices: &[Vec3]) -> f64 {
    let r: Vec<DVec3> = vertices.iter().map(|v| (v.as_dvec3() - p.as_dvec3()).normalize()).collect();
    assert!(r.iter().all(|r| r.dot(n.as_dvec3()) >= -1e-9), "a polygon below the horizon");
    let edge = |a: DVec3, b: DVec3| {
        let c = a.cross(b);
        c / c.length() * c.length().atan2(a.dot(b))
    };
    let sum: DVec3 = (0..r.len()).map(|i| edge(r[i], r[(i + 1) % r.len()])).sum();
    0.5 * sum.dot(n.as_dvec3()).abs()
}

/// From a sphere wholly above the horizon: π (r/d)² cosθ.
pub(crate) fn sphere_irradiance(p: Vec3, n: Vec3, center: Vec3, radius: f32) -> f64 {
    let d = center.as_dvec3() - p.as_dvec3();
    let ratio = f64::from(radius) / d.length();
    PI * ratio * ratio * d.normalize().dot(n.as_dvec3())
}

/// From a disk facing the point along its axis, at `distance`: π r² / (r² + d²).
pub(crate) fn disk_irradiance(radius: f64, distance: f64) -> f64 {
    PI * radius * radius / (radius * radius + distance * distance)
}

/// On the inner floor centre of an open cylinder standing on it, from the cylinder's wall: all that
/// the disk of its upper end does not send.
pub(crate) fn cylinder_wall_irradiance(radius: f64, height: f64) -> f64 {
    PI - disk_irradiance(radius, height)
}

/// From a distant light of `irradiance` on a facing surface: the cosine law.
pub(crate) fn distant_irradiance(irradiance: f64, cos: f64) -> f64 {
    irradiance * cos.max(0.0)
}

#[test]
fn the_closed_forms_agree_where_they_meet() {
    let cap = |n: usize| -> Vec<Vec3> {
        let at = |i: usize| (i as f32 / n as f32 * std::f32::consts::TAU).sin_cos();
        (0..n).map(|i| Vec3::new(0.7 * at(i).1, 0.7 * at(i).0, 1.3)).collect()
    };
    // A polygon of very many sides is a disk, short by 2π²/3n² of its area.
    let polygon = polygon_irradiance(Vec3::ZERO, Vec3::Z, &cap(2000));
    assert!((polygon / disk_irradiance(0.7, 1.3) - 1.0).abs() < 1e-5);
    // A disk and the sphere that shows the same outline send the same.
    let sin = 0.7 / (0.7f64.powi(2) + 1.3f64.powi(2)).sqrt();
    let sphere = sphere_irradiance(Vec3::ZERO, Vec3::Z, Vec3::Z * 2.0, 2.0 * sin as f32);
    assert!((sphere / disk_irradiance(0.7, 1.3) - 1.0).abs() < 1e-6);
    assert!((cylinder_wall_irradiance(1.0, 1.0) - 0.5 * PI).abs() < 1e-12);
    assert_eq!(distant_irradiance(2.0, -0.5), 0.0);
}
