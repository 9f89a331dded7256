//! Known answers of the schedule room: ways through grids, and rays that are answered once whatever the limits.

use super::{
    Fresh, Grid, Ledger, Limits, Meter, Order, PIECE_BYTES, Piece, Queues, Sink, Space, Spill, Traveller,
};
use crate::accel::{Accel, Hit, PageBox, Ray};
use crate::stats::sample_hash;
use glam::Vec3;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};

fn random(seed: u64) -> impl FnMut() -> f32 {
    let mut next = seed << 32;
    move || {
        next += 1;
        (sample_hash(next) >> 8) as f32 / (1 << 24) as f32
    }
}

fn boxes(count: u32, seed: u64) -> Vec<PageBox> {
    let mut random = random(seed);
    let mut point = || Vec3::new(random(), random(), random() * 0.1) * 10.0;
    (0..count)
        .map(|i| {
            let lo = point();
            PageBox { lo, hi: lo + point() * 0.05, pages: i..i + 1 }
        })
        .collect()
}

/// Voxels with pages that `ray` comes past, in order, with the distances at which it leaves them.
fn way(grid: &Grid, ray: &Ray) -> Vec<(u32, f32)> {
    let mut way = Vec::new();
    let mut at = grid.enter(ray);
    while let Some(voxel) = at {
        let next = grid.next(ray, voxel);
        way.push((voxel, next.map_or(f32::INFINITY, |(t, _)| t)));
        at = next.map(|(_, v)| v);
        assert!(way.len() <= 400, "{ray:?} does not end");
    }
    way
}

#[test]
fn a_way_ends_and_comes_past_what_the_ray_meets() {
    let boxes = boxes(300, 1);
    let grid = Grid::new(&boxes, 200);
    assert!((200..2000).contains(&grid.len()), "{} voxels", grid.len());
    let pairs = grid.pairs(&boxes, 1 << 20).expect("few");
    let per_voxel: u32 = (0..grid.len() as u32).map(|i| grid.pages(i)).sum();
    assert_eq!(pairs.len() as u32, per_voxel, "two ways to count");
    assert!(grid.pairs(&boxes, 10).is_none());
    let mut random = random(2);
    let mut met = 0;
    for i in 0..20_000 {
        let mut point = || Vec3::new(random(), random(), random()) * 12.0 - 1.0;
        let (a, b) = (point(), point());
        let mut ray = Ray::new(a, b - a);
        if i % 5 == 0 {
            ray.direction[i % 3] = 0.0;
        }
        if i % 7 == 0 {
            ray.t_max = 1.0;
        }
        let way = way(&grid, &ray);
        assert!(way.len() <= grid.dims().iter().sum::<u32>() as usize, "{} voxels", way.len());
        for b in &boxes {
            let inverse = ray.direction.recip();
            let (s, t) = ((b.lo - ray.origin) * inverse, (b.hi - ray.origin) * inverse);
            let (near, far) = (s.min(t).max_element().max(0.0), s.max(t).min_element().min(ray.t_max));
            if near < far - 1e-3 {
                met += 1;
                let page = b.pages.start;
                let has_it = way.iter().any(|&(voxel, _)| pairs.contains(&(page, voxel)));
                assert!(has_it, "{ray:?} meets page {page} and comes past no voxel that has it");
            }
        }
    }
    assert!(met > 500, "only {met}");
}

#[test]
fn grids_of_nothing_of_a_plane_and_of_rays_that_are_no_rays() {
    let nothing = Grid::new(&[], 100);
    let ray = Ray::new(Vec3::ZERO, Vec3::X);
    assert!(nothing.is_empty() && nothing.enter(&ray).is_none());
    let flat = PageBox { lo: Vec3::new(-1.0, -1.0, 2.0), hi: Vec3::new(1.0, 1.0, 2.0), pages: 0..3 };
    let point = PageBox { lo: Vec3::ONE, hi: Vec3::ONE, pages: 0..1 };
    for boxes in [vec![flat], vec![point]] {
        for wanted in [0, 1, 100, u32::MAX] {
            let grid = Grid::new(&boxes, wanted);
            assert!(!grid.is_empty());
            for direction in
                [Vec3::ZERO, Vec3::NAN, Vec3::splat(f32::INFINITY), Vec3::Z, -Vec3::X, Vec3::splat(1e-40)]
            {
                for origin in [Vec3::ZERO, Vec3::NAN, Vec3::splat(1e30), Vec3::ONE] {
                    let _ = way(&grid, &Ray::new(origin, direction));
                }
            }
        }
    }
}

/// Tells rays apart by their origin, and knows no geometry: what is entered beyond 0.5 is met.
struct Halves;

impl Accel for Halves {
    fn closest(&self, ray: &Ray) -> Hit {
        Hit { t: 0.5, geometry: 0, primitive: ray.origin.x as u32, ..Hit::MISS }
    }

    fn occluded(&self, ray: &Ray) -> bool {
        ray.origin.x as u32 % 2 == 1
    }

    fn closest_part(&self, ray: &Ray, from: f32, to: f32, so_far: &Hit) -> Hit {
        if from <= 0.5 && 0.5 < to { self.closest(ray) } else { *so_far }
    }

    fn occluded_part(&self, ray: &Ray, from: f32, to: f32) -> bool {
        from <= 0.5 && 0.5 < to && self.occluded(ray)
    }

    fn bytes(&self) -> u64 {
        0
    }

    fn bounds(&self) -> (Vec3, Vec3) {
        (Vec3::ZERO, Vec3::splat(10.0))
    }
}

/// A ray that has `left` more to come after it.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Numbered {
    number: u32,
    left: u32,
}

impl Traveller for Numbered {
    fn ray(&self) -> Ray {
        let y = self.number as f32 * 0.37 % 10.0;
        // The whole number is in x, and the fraction moves it through the grid.
        Ray::new(Vec3::new(self.number as f32, y, 0.5), Vec3::new(-3.0, 0.1, 0.2))
    }
}

struct Counting<'c> {
    meter: &'c Meter,
    pieces: &'c Mutex<Vec<Vec<Piece>>>,
    begun: &'c AtomicU32,
    answers: &'c [AtomicU32],
    tests: &'c [AtomicU32],
    held: Vec<Numbered>,
    panic_at: Option<u32>,
}

pub(super) const RAYS: u32 = 4000;
const CHILDREN: u32 = 2;
/// Pieces that each hundred rays keep.
const BEGUN: usize = 3;

impl Sink<Numbered, Numbered> for Counting<'_> {
    fn begin(&mut self, pieces: Vec<Piece>, fresh: &mut Fresh<Numbered, Numbered>) -> Option<Vec<Piece>> {
        assert_eq!(pieces.len(), BEGUN);
        let first = self.begun.fetch_add(100, Ordering::Relaxed);
        if first >= RAYS {
            return Some(pieces);
        }
        self.pieces.lock().expect("whole").push(pieces);
        fresh.paths.extend((first..first + 100).map(|number| Numbered { number, left: CHILDREN }));
        None
    }

    fn hit(&mut self, path: Numbered, hit: Hit, fresh: &mut Fresh<Numbered, Numbered>) {
        assert_ne!(Some(path.number), self.panic_at, "as asked");
        assert_eq!(hit.primitive, path.number);
        let before = self.answers[path.number as usize].fetch_add(1, Ordering::Relaxed);
        if path.number % 100 == 99 && before == CHILDREN {
            let pieces = self.pieces.lock().expect("whole").pop();
            self.meter.give(pieces.expect("as many as have begun"));
        }
        self.held.push(path);
        if self.held.len() == 50 {
            self.settle(true, fresh);
        }
    }

    fn seen(&mut self, test: Numbered, occluded: bool) {
        assert_eq!(occluded, test.number % 2 == 1);
        self.tests[test.number as usize].fetch_add(1, Ordering::Relaxed);
    }

    fn settle(&mut self, all: bool, fresh: &mut Fresh<Numbered, Numbered>) -> bool {
        if !all || self.held.is_empty() {
            return false;
        }
        for path in self.held.drain(..) {
            fresh.tests.push(path);
            if path.left > 0 {
                fresh.paths.push(Numbered { left: path.left - 1, ..path });
            }
        }
        true
    }
}

fn run(
    threads: usize,
    bytes: usize,
    wanted: u32,
    panic_at: Option<u32>,
    stop_after: usize,
) -> (u32, u32, usize) {
    run_in((bytes, None), threads, wanted, panic_at, stop_after)
}

/// In some memory and perhaps a file: paths and tests that were answered as often as they should be, and bytes taken.
pub(super) fn run_in(
    (bytes, spill): (usize, Option<&Spill>),
    threads: usize,
    wanted: u32,
    panic_at: Option<u32>,
    stop_after: usize,
) -> (u32, u32, usize) {
    let list = boxes(200, 3);
    let grid = if wanted == 0 { Grid::new(&[], 0) } else { Grid::new(&list, wanted) };
    let limits =
        Limits { begun: BEGUN, begin: bytes / 4 / PIECE_BYTES + BEGUN, taken: 256, shares: 4, voxels: 2 };
    let (order, meter) = (Order::new(Halves.bounds()), Meter::new(bytes));
    // What has begun has room for a third of all, or is counted with the rays.
    let apart = spill.map(|_| Meter::new(BEGUN * PIECE_BYTES * RAYS as usize / 300));
    let begun_in = apart.as_ref().unwrap_or(&meter);
    let room = Space { rays: &meter, begun: begun_in, spill };
    let queues = Queues::new(&grid, Ledger::new(&grid, None), order, limits, room);
    let zeros = || (0..RAYS).map(|_| AtomicU32::new(0)).collect::<Vec<_>>();
    let (answers, tests, begun) = (zeros(), zeros(), AtomicU32::new(0));
    let pieces = Mutex::default();
    let asked = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                let mut sink = Counting {
                    meter: begun_in,
                    pieces: &pieces,
                    begun: &begun,
                    answers: &answers,
                    tests: &tests,
                    held: Vec::new(),
                    panic_at,
                };
                let stop = || asked.fetch_add(1, Ordering::Relaxed) >= stop_after;
                queues.work(&Halves, &mut sink, &stop);
            });
        }
    });
    let once =
        |list: &[AtomicU32]| list.iter().filter(|n| n.load(Ordering::Relaxed) == CHILDREN + 1).count() as u32;
    (once(&answers), once(&tests), meter.bytes())
}

#[test]
fn every_ray_is_answered_once_whatever_the_limits() {
    for (threads, bytes, wanted) in
        [(1, 1 << 20, 50), (4, 1 << 20, 400), (3, 0, 50), (2, 20_000, 1), (3, 100_000, 0)]
    {
        let (answered, tested, peak) = run(threads, bytes, wanted, None, usize::MAX);
        let what = format!("{threads} threads, {bytes} bytes, {wanted} voxels");
        assert_eq!((answered, tested), (RAYS, RAYS), "{what}");
        assert!(peak <= bytes.max(BEGUN * PIECE_BYTES), "{what}: {peak} bytes");
    }
}

#[test]
fn who_says_stop_is_heard_and_a_panic_leaves_nobody_waiting() {
    let (answered, _, _) = run(4, 1 << 20, 100, None, 40);
    assert!(answered < RAYS, "it went on to the end");
    let panics = std::panic::catch_unwind(|| run(4, 1 << 20, 100, Some(17), usize::MAX));
    assert!(panics.is_err());
}
