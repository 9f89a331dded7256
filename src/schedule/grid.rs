//! The scheduling grid: voxels over everything that has pages, and the way of a ray through them.
//!
//! Invariant: a ray's way ends, after at most as many voxels as lie along the grid's three edges together. Where a ray
//! is cut decides nothing but time, so nothing here need be exact.

use crate::accel::{PageBox, Ray};
use glam::{IVec3, UVec3, Vec3};

/// Cells along an edge, and of a grid, at most.
const MOST: u32 = 128;
const MOST_CELLS: u64 = 1 << 18;
/// In place of a voxel's name: the cell has no pages.
const EMPTY: u32 = u32::MAX;

/// A grid of cells of one size. Those with pages are voxels, counted from zero.
#[derive(Default)]
pub struct Grid {
    lo: Vec3,
    hi: Vec3,
    cell: Vec3,
    dims: UVec3,
    /// By cell: its voxel, or [`EMPTY`].
    voxels: Vec<u32>,
    /// By voxel: its cell, and how many pages lie in it, wholly or in part.
    cells: Vec<u32>,
    pages: Vec<u32>,
}

impl Grid {
    /// Over `boxes`, with some `wanted` voxels or a few more; fewer where that would take more cells than are sensible.
    #[must_use]
    pub fn new(boxes: &[PageBox], wanted: u32) -> Self {
        let (lo, hi) = boxes
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), b| (lo.min(b.lo), hi.max(b.hi)));
        if boxes.is_empty() {
            return Self::default();
        }
        let size =
            (hi - lo).max(Vec3::splat((hi - lo).max_element() * 1e-6)).max(Vec3::splat(f32::MIN_POSITIVE));
        let mut edge = size.max_element();
        loop {
            let grid = Self::with_edge(boxes, lo, hi, size, edge);
            let finer = edge * 0.8;
            let cells = (size / finer).ceil().max(Vec3::ONE);
            let too_fine = cells.max_element() > MOST as f32
                || f64::from(cells.x) * f64::from(cells.y) * f64::from(cells.z) > MOST_CELLS as f64;
            if grid.len() as u32 >= wanted || too_fine {
                return grid;
            }
            edge = finer;
        }
    }

    fn with_edge(boxes: &[PageBox], lo: Vec3, hi: Vec3, size: Vec3, edge: f32) -> Self {
        let dims = (size / edge).ceil().as_uvec3().clamp(UVec3::ONE, UVec3::splat(MOST));
        let mut grid = Self { lo, hi, cell: size / dims.as_vec3(), dims, ..Self::default() };
        // Differences along the axes, summed up afterwards: a box costs the same however many voxels it covers.
        let wide = dims + 1;
        let at = |v: UVec3| ((v.z * wide.y + v.y) * wide.x + v.x) as usize;
        let mut sums = vec![0i64; (wide.x * wide.y * wide.z) as usize];
        for b in boxes {
            let (from, to) = (grid.cell_at(b.lo).as_uvec3(), grid.cell_at(b.hi).as_uvec3() + 1);
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
        for cell in 0..dims.x * dims.y * dims.z {
            let pages = u32::try_from(sums[at(grid.place_of(cell))]).unwrap_or(u32::MAX);
            grid.voxels.push(if pages > 0 { grid.cells.len() as u32 } else { EMPTY });
            if pages > 0 {
                grid.cells.push(cell);
                grid.pages.push(pages);
            }
        }
        grid
    }

    /// Cells along each axis.
    #[must_use]
    pub fn dims(&self) -> [u32; 3] {
        self.dims.to_array()
    }

    /// Least and greatest corner.
    #[must_use]
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        [self.lo.to_array(), self.hi.to_array()]
    }

    /// Voxels.
    #[must_use]
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Whether there is no voxel.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Bytes of its tables.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of_val(&self.voxels[..]) + size_of_val(&self.cells[..]) + size_of_val(&self.pages[..])
    }

    /// Pages in voxel `i`.
    #[must_use]
    pub fn pages(&self, i: u32) -> u32 {
        self.pages[i as usize]
    }

    /// Pairs of page and voxel in which it lies; `None` when there are more than `most`.
    #[must_use]
    pub fn pairs(&self, boxes: &[PageBox], most: usize) -> Option<Vec<(u32, u32)>> {
        let range = |b: &PageBox| (self.cell_at(b.lo), self.cell_at(b.hi));
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
                        let voxel = self.voxels[self.index(IVec3::new(x, y, z))];
                        // Its box lies there, so it has pages.
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
        self.place_of(self.cells[i as usize])
    }

    fn place_of(&self, cell: u32) -> UVec3 {
        UVec3::new(cell % self.dims.x, cell / self.dims.x % self.dims.y, cell / (self.dims.x * self.dims.y))
    }

    fn index(&self, at: IVec3) -> usize {
        let at = at.as_uvec3();
        ((at.z * self.dims.y + at.y) * self.dims.x + at.x) as usize
    }

    /// The cell nearest to `p`.
    fn cell_at(&self, p: Vec3) -> IVec3 {
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
        let at = self.cell_at(ray.origin + ray.direction * near);
        match self.voxels[self.index(at)] {
            EMPTY => self.walk(ray, at).map(|(_, next)| next),
            here => Some(here),
        }
    }

    /// Where `ray` leaves voxel `i` for the next one with pages, and that; `None` where none comes.
    #[must_use]
    pub fn next(&self, ray: &Ray, i: u32) -> Option<(f32, u32)> {
        self.walk(ray, self.place(i).as_ivec3())
    }

    /// [`Self::next`] from a cell.
    fn walk(&self, ray: &Ray, mut at: IVec3) -> Option<(f32, u32)> {
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
            let here = self.voxels[self.index(at)];
            if here != EMPTY {
                return Some((least, here));
            }
        }
    }
}
