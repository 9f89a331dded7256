//! Shapes for tests: a closed sphere of triangles, and a backend that lies now and then.

use super::aimed::Random;
use super::arbiter::Shapes;
use crate::accel::{Accel, Custom, Geometry, Hit, Ray};
use glam::Vec3;
use std::sync::atomic::{AtomicU64, Ordering};

/// A scene of triangles alone.
pub(super) struct NoCustom;

impl Custom for NoCustom {
    fn bounds(&self, _: u32, _: u32) -> (Vec3, Vec3) {
        unreachable!("triangles alone")
    }
    fn intersect(&self, _: u32, _: u32, _: &Ray) -> Option<(f32, f32, f32)> {
        unreachable!("triangles alone")
    }
    fn is_opaque(&self, _: u32, _: u32, _: (f32, f32, f32), _: &Ray) -> bool {
        unreachable!("nothing has a mask")
    }
}

/// Vertices, with room behind the last, and corners.
pub(super) struct Triangles {
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) indices: Vec<[u32; 3]>,
}

impl Triangles {
    pub(super) fn new(mut positions: Vec<[f32; 3]>, indices: Vec<[u32; 3]>) -> Self {
        // Embree reads 16 bytes at the last vertex.
        positions.reserve(1);
        Self { positions, indices }
    }

    /// A closed sphere of `rows` rows of `2 · rows` faces.
    pub(super) fn sphere(rows: u32, radius: f32, centre: Vec3) -> Self {
        let across = 2 * rows;
        let mut positions =
            vec![(centre + Vec3::Z * radius).to_array(), (centre - Vec3::Z * radius).to_array()];
        for r in 1..rows {
            for c in 0..across {
                let (st, ct) = (std::f32::consts::PI * r as f32 / rows as f32).sin_cos();
                let (sp, cp) = (std::f32::consts::TAU * c as f32 / across as f32).sin_cos();
                positions.push((centre + Vec3::new(st * cp, st * sp, ct) * radius).to_array());
            }
        }
        let at = |r: u32, c: u32| match r {
            0 => 0,
            _ if r == rows => 1,
            _ => 2 + (r - 1) * across + c % across,
        };
        let faces = (0..rows).flat_map(|r| (0..across).map(move |c| (r, c)));
        let quads = faces.flat_map(|(r, c)| {
            [[at(r, c), at(r + 1, c), at(r + 1, c + 1)], [at(r, c), at(r + 1, c + 1), at(r, c + 1)]]
        });
        let has_area = |t: &[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
        let indices: Vec<[u32; 3]> = quads.filter(has_area).collect();
        Self::new(positions, indices)
    }

    /// Triangles of every shape and size within `reach`, thin ones among them.
    pub(super) fn soup(count: u32, reach: f32, random: &mut Random) -> Self {
        let mut positions = Vec::new();
        for _ in 0..count {
            let mut any = |scale: f32| Vec3::from_array([0; 3].map(|_| (random.unit() as f32 - 0.5) * scale));
            let a = any(reach);
            let (b, c) = (a + any(reach * 0.1), a + any(reach * 0.1));
            let thin = random.unit().powi(6) as f32;
            let c = b + (c - b) * thin;
            positions.extend([a.to_array(), b.to_array(), c.to_array()]);
        }
        Self::new(positions, (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect())
    }

    pub(super) fn shapes(&self) -> Shapes<'_> {
        let geometry =
            Geometry::Triangles { positions: &self.positions, indices: &self.indices, alpha: None };
        Shapes { world: vec![geometry], objects: Vec::new(), instances: Vec::new(), custom: &NoCustom }
    }
}

/// What a liar does to a hundredth of the hits.
#[derive(Clone, Copy)]
pub(super) enum Lie {
    /// Drops it.
    Drop,
    /// Moves it by a ten-thousandth.
    Move,
    /// Names another primitive.
    Rename,
    /// Says the opposite when asked for occlusion.
    Occlusion,
}

/// Answers as another does, most of the time.
pub(super) struct Liar<'a> {
    pub(super) inner: &'a dyn Accel,
    pub(super) lie: Lie,
    pub(super) lies: AtomicU64,
}

impl<'a> Liar<'a> {
    pub(super) fn new(inner: &'a dyn Accel, lie: Lie) -> Self {
        Self { inner, lie, lies: AtomicU64::new(0) }
    }

    /// About one ray in a hundred, the same whoever asks when.
    fn lies_now(&self, ray: &Ray) -> bool {
        let bits = ray.origin.to_array().into_iter().chain(ray.direction.to_array());
        let hash = bits.fold(0u64, |h, c| {
            (h ^ u64::from(c.to_bits())).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29)
        });
        let now = hash % 100 == 7;
        self.lies.fetch_add(u64::from(now), Ordering::Relaxed);
        now
    }
}

impl Accel for Liar<'_> {
    fn closest(&self, ray: &Ray) -> Hit {
        let hit = self.inner.closest(ray);
        if hit.geometry == crate::accel::NONE || matches!(self.lie, Lie::Occlusion) || !self.lies_now(ray) {
            return hit;
        }
        match self.lie {
            Lie::Drop => Hit::MISS,
            Lie::Move => Hit { t: hit.t * 1.0001, ..hit },
            Lie::Rename | Lie::Occlusion => {
                // One that there is.
                let primitive = hit.primitive.checked_sub(64).unwrap_or(hit.primitive + 64);
                Hit { primitive, ..hit }
            }
        }
    }

    fn occluded(&self, ray: &Ray) -> bool {
        let truth = self.inner.occluded(ray);
        truth != (matches!(self.lie, Lie::Occlusion) && self.lies_now(ray))
    }

    fn bytes(&self) -> u64 {
        self.inner.bytes()
    }

    fn bounds(&self) -> (Vec3, Vec3) {
        self.inner.bounds()
    }
}
