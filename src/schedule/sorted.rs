//! Large groups of rays in the order of their directions and origins, each traced to its end.
//!
//! Invariant: every thread takes whole groups, and no ray is in two.

use super::{Rays, Requests, Schedule, Sink, TEST};
use crate::accel::{Accel, Ray};
use glam::Vec3;

/// Rays that are sorted together.
const GROUP: usize = 1 << 16;

/// Sorted rays (Eisenacher et al. 2013, section 4.1): by octant of the direction, then by origin along a Z-order curve.
pub struct Sorted {
    lo: Vec3,
    scale: Vec3,
}

impl Sorted {
    /// For a world within these bounds.
    #[must_use]
    pub fn new((lo, hi): (Vec3, Vec3)) -> Self {
        let size = (hi - lo).max(Vec3::splat(f32::MIN_POSITIVE));
        Self { lo, scale: Vec3::splat(1024.0) / size }
    }

    /// Three bits of direction, thirty of place.
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

impl Schedule for Sorted {
    fn work<A: Accel + ?Sized>(
        &self,
        accel: &A,
        rays: &impl Rays,
        requests: &Requests<'_>,
        sink: &mut impl Sink,
        stop: &(dyn Fn() -> bool + Sync),
    ) {
        let mut group: Vec<(u64, u32)> = Vec::with_capacity(GROUP);
        loop {
            group.clear();
            while group.len() < GROUP
                && let Some(range) = requests.take()
            {
                group.extend(range.map(|name| (self.key(&rays.ray(name)), name)));
            }
            if group.is_empty() || stop() {
                return;
            }
            group.sort_unstable();
            for &(_, name) in &group {
                let ray = rays.ray(name);
                if name & TEST == 0 {
                    sink.hit(name, accel.closest(&ray));
                } else {
                    sink.seen(name & !TEST, accel.occluded(&ray));
                }
            }
            sink.settle();
        }
    }
}
