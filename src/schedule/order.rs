//! The order of rays that are traced one after the other.

use crate::accel::Ray;
use glam::Vec3;

/// By octant of the direction, then by origin along a Z-order curve (Eisenacher et al. 2013, section 4.1).
#[derive(Clone, Copy, Debug)]
pub struct Order {
    lo: Vec3,
    scale: Vec3,
}

impl Order {
    /// For a world within these bounds.
    #[must_use]
    pub fn new((lo, hi): (Vec3, Vec3)) -> Self {
        let size = (hi - lo).max(Vec3::splat(f32::MIN_POSITIVE));
        Self { lo, scale: Vec3::splat(1024.0) / size }
    }

    /// Three bits of direction above thirty of place.
    pub(super) fn key(&self, ray: &Ray) -> u64 {
        let p = ((ray.origin - self.lo) * self.scale).clamp(Vec3::ZERO, Vec3::splat(1023.0)).as_uvec3();
        let octant = u64::from(ray.direction.is_negative_bitmask());
        octant << 30 | spread(p.x) | spread(p.y) << 1 | spread(p.z) << 2
    }
}

/// Ten bits, two zeros after each.
fn spread(v: u32) -> u64 {
    let v = u64::from(v);
    let v = (v | v << 16) & 0x0300_00ff;
    let v = (v | v << 8) & 0x0300_f00f;
    let v = (v | v << 4) & 0x030c_30c3;
    (v | v << 2) & 0x0924_9249
}
