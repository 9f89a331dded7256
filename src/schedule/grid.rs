//! The scheduling grid: voxels over everything that has pages, and the way of a ray through them.
//!
//! Invariant: a ray's way ends, after at most as many voxels as lie along the grid's three edges together. Where a ray
//! is cut decides nothing but time, so nothing here need be exact.

use crate::accel::{PageBox, Ray};
use glam::{IVec3, UVec3, Vec3};

/// Voxels along an edge at most.
const MOST: u32 = 128;

/// A grid of boxes of one size.
pub struct Grid {
    lo: Vec3,
    hi: Vec3,
    cell: Vec3,
    dims: UVec3,
    /// Pages that lie in each voxel, wholly or in part.
    pages: Vec<u32>,
    /// Voxels with pages.
    filled: u32,
}

impl Grid {
    /// Over `boxes`, with some `wanted` voxels that have pages in them, or a few more; no finer than boxes are large.
    #[must_use]
    pub fn new(boxes: &[PageBox], wanted: u32) -> Self {
        let (lo, hi) = boxes
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), b| (lo.min(b.lo), hi.max(b.hi)));
        if boxes.is_empty() {
            return Self { lo, hi, cell: Vec3::ONE, dims: UVec3::ZERO, pages: Vec::new(), filled: 0 };
        }
        let size =
            (hi - lo).max(Vec3::splat((hi - lo).max_element() * 1e-6)).max(Vec3::splat(f32::MIN_POSITIVE));
        let mut edge = size.max_element();
        loop {
            let grid = Self::with_edge(boxes, lo, hi, size, edge);
            let finer = edge * 0.8;
            if grid.filled >= wanted || size.max_element() / finer > MOST as f32 {
                return grid;
            }
            edge = finer;
        }
    }

    fn with_edge(boxes: &[PageBox], lo: Vec3, hi: Vec3, size: Vec3, edge: f32) -> Self {
        let dims = (size / edge).ceil().as_uvec3().clamp(UVec3::ONE, UVec3::splat(MOST));
        let mut grid = Self { lo, hi, cell: size / dims.as_vec3(), dims, pages: Vec::new(), filled: 0 };
        // Differences along the axes, summed up afterwards: a box costs the same however many voxels it covers.
        let wide = dims + 1;
        let at = |v: UVec3| ((v.z * wide.y + v.y) * wide.x + v.x) as usize;
        let mut sums = vec![0i64; (wide.x * wide.y * wide.z) as usize];
        for b in boxes {
            let (from, to) = (grid.voxel(b.lo).as_uvec3(), grid.voxel(b.hi).as_uvec3() + 1);
            for corner in 0..8u32 {
                let pick = |bit: u32, a: u32, b: u32| if corner >> bit & 1 == 0 { a } else { b };
                let place = UVec3::new(pick(0, from.x, to.x), pick(1, from.y, to.y), pick(2, from.z, to.z));
                let sign = if corner.count_ones() % 2 == 0 { 1 } else { -1 };
                sums[at(place)] += sign * b.pages.len() as i64;
            }
        }
        for step in [UVec3::X, UVec3::Y, UVec3::Z] {
            for z in step.z..wide.z {
                for y in step.y..wide.y {
                    for x in step.x..wide.x {
                        let here = UVec3::new(x, y, z);
                        sums[at(here)] += sums[at(here - step)];
                    }
                }
            }
        }
        grid.pages = (0..dims.x * dims.y * dims.z)
            .map(|i| u32::try_from(sums[at(grid.place(i))]).unwrap_or(u32::MAX))
            .collect();
        grid.filled = grid.pages.iter().filter(|&&n| n > 0).count() as u32;
        grid
    }

    /// Voxels along each axis.
    #[must_use]
    pub fn dims(&self) -> [u32; 3] {
        self.dims.to_array()
    }

    /// Least and greatest corner.
    #[must_use]
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        if self.dims == UVec3::ZERO { [[0.0; 3]; 2] } else { [self.lo.to_array(), self.hi.to_array()] }
    }

    /// Voxels, filled or not.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pages.len()
    }

    /// Whether there is no voxel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pages.is_empty()
    }

    /// Voxels with pages.
    #[must_use]
    pub fn filled(&self) -> u32 {
        self.filled
    }

    /// Pages in voxel `i`.
    #[must_use]
    pub fn pages(&self, i: u32) -> u32 {
        self.pages[i as usize]
    }

    /// Pairs of page and voxel in which it lies; `None` when there are more than `most`.
    #[must_use]
    pub fn pairs(&self, boxes: &[PageBox], most: usize) -> Option<Vec<(u32, u32)>> {
        let range = |b: &PageBox| (self.voxel(b.lo), self.voxel(b.hi));
        let count = |b: &PageBox| {
            let (from, to) = range(b);
            let size = (to - from + 1).as_u64vec3();
            (size.x * size.y * size.z).saturating_mul(b.pages.len() as u64)
        };
        let total: u64 = boxes.iter().map(count).fold(0, u64::saturating_add);
        if total > most as u64 {
            return None;
        }
        let mut pairs = Vec::with_capacity(total as usize);
        for b in boxes {
            let (from, to) = range(b);
            for z in from.z..=to.z {
                for y in from.y..=to.y {
                    for x in from.x..=to.x {
                        let voxel = self.index(IVec3::new(x, y, z));
                        pairs.extend(b.pages.clone().map(|page| (page, voxel)));
                    }
                }
            }
        }
        Some(pairs)
    }

    /// Where voxel `i` is along each axis.
    #[must_use]
    pub fn place(&self, i: u32) -> UVec3 {
        UVec3::new(i % self.dims.x, i / self.dims.x % self.dims.y, i / (self.dims.x * self.dims.y))
    }

    fn index(&self, at: IVec3) -> u32 {
        let at = at.as_uvec3();
        (at.z * self.dims.y + at.y) * self.dims.x + at.x
    }

    /// The voxel nearest to `p`.
    fn voxel(&self, p: Vec3) -> IVec3 {
        let last = self.dims.as_ivec3() - 1;
        // What is not a number becomes zero.
        ((p - self.lo) / self.cell).floor().clamp(Vec3::ZERO, last.as_vec3()).as_ivec3()
    }

    /// The first voxel with pages on the way of `ray`.
    #[must_use]
    pub fn enter(&self, ray: &Ray) -> Option<u32> {
        if self.is_empty() {
            return None;
        }
        let inverse = ray.direction.recip();
        let (a, b) = ((self.lo - ray.origin) * inverse, (self.hi - ray.origin) * inverse);
        let near = a.min(b).max_element().max(0.0);
        let far = a.max(b).min_element();
        // Not `near > far`, so that what is not a number goes on.
        if far < near || near >= ray.t_max {
            return None;
        }
        let at = self.voxel(ray.origin + ray.direction * near);
        let here = self.index(at);
        if self.pages[here as usize] > 0 { Some(here) } else { self.next(ray, here).map(|(_, next)| next) }
    }

    /// Where `ray` leaves voxel `i` for the next one with pages, and that; `None` where none comes.
    #[must_use]
    pub fn next(&self, ray: &Ray, i: u32) -> Option<(f32, u32)> {
        let mut at = self.place(i).as_ivec3();
        let forward = ray.direction.cmpge(Vec3::ZERO);
        let step = IVec3::select(forward, IVec3::ONE, IVec3::NEG_ONE);
        let ahead = IVec3::select(forward, IVec3::ONE, IVec3::ZERO);
        let inverse = ray.direction.recip();
        let dims = self.dims.as_ivec3();
        loop {
            let planes = self.lo + (at + ahead).as_vec3() * self.cell;
            let t = (planes - ray.origin) * inverse;
            // Along an axis that it does not move on a ray leaves no voxel. A plane that rounding has put behind the
            // origin is passed at once.
            let stays = ray.direction.cmpeq(Vec3::ZERO) | t.is_nan_mask();
            let t = Vec3::select(stays, Vec3::INFINITY, t.max(Vec3::ZERO));
            let least = t.min_element();
            if least == f32::INFINITY || least >= ray.t_max {
                return None;
            }
            let axis = if t.x == least {
                IVec3::X
            } else if t.y == least {
                IVec3::Y
            } else {
                IVec3::Z
            };
            at += step * axis;
            if at.cmplt(IVec3::ZERO).any() || at.cmpge(dims).any() {
                return None;
            }
            let here = self.index(at);
            if self.pages[here as usize] > 0 {
                return Some((least, here));
            }
        }
    }
}
