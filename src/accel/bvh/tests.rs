//! The hierarchy against every triangle in turn, its forms against each other, and rays that break things.

use super::outline::Outline;
use super::query::{Best, Query};
use super::tree::Block;
use super::triangle::intersect;
use super::{BvhScene, Form};
use crate::accel::{Accel, Custom, Geometry, Hit, InstanceOf, NONE, Ray};
use glam::{Mat4, Quat, Vec3};

/// Spheres of radius `radius` in a row along x, and a mask that lets every third primitive's hits pass.
struct Spheres {
    radius: f32,
}

impl Custom for Spheres {
    fn bounds(&self, _: u32, primitive: u32) -> (Vec3, Vec3) {
        let centre = Vec3::X * primitive as f32;
        (centre - self.radius, centre + self.radius)
    }

    fn intersect(&self, _: u32, primitive: u32, ray: &Ray) -> Option<(f32, f32, f32)> {
        let centre = Vec3::X * primitive as f32;
        let (o, d) = ((ray.origin - centre).as_dvec3(), ray.direction.as_dvec3());
        let (a, b) = (d.length_squared(), o.dot(d));
        let discriminant = b * b - a * (o.length_squared() - f64::from(self.radius).powi(2));
        let root = (discriminant >= 0.0).then(|| discriminant.sqrt())?;
        let inside = |t: f64| t > f64::from(ray.t_min) && t < f64::from(ray.t_max);
        [(-b - root) / a, (-b + root) / a].into_iter().find(|&t| inside(t)).map(|t| (t as f32, 0.0, 0.0))
    }

    fn is_opaque(&self, _: u32, primitive: u32, _: (f32, f32, f32), _: &Ray) -> bool {
        !primitive.is_multiple_of(3)
    }
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [-1, 1).
    fn signed(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }

    fn point(&mut self) -> Vec3 {
        Vec3::new(self.signed(), self.signed(), self.signed())
    }
}

struct Soup {
    positions: Vec<[f32; 3]>,
    indices: Vec<[u32; 3]>,
}

/// Triangles of sizes from 1 down to 1e-4, some without area, some twice.
fn soup(count: usize, seed: u64) -> Soup {
    let mut random = Random(seed);
    let mut soup = Soup { positions: Vec::new(), indices: Vec::new() };
    for i in 0..count {
        let size = 10f32.powf(random.signed() * 2.0 - 2.0);
        let at = random.point();
        let corners = match i % 16 {
            14 => [at, at, at + random.point() * size],
            15 => [at; 3],
            _ => [at, at + random.point() * size, at + random.point() * size],
        };
        let first = soup.positions.len() as u32;
        soup.positions.extend(corners.map(|c| c.to_array()));
        soup.indices.push([first, first + 1, first + 2]);
        if i % 16 == 13 {
            soup.indices.push([first + 1, first + 2, first]);
        }
    }
    soup.positions.reserve(1);
    soup
}

impl Soup {
    fn geometry(&self) -> Geometry<'_> {
        Geometry::Triangles { positions: &self.positions, indices: &self.indices, alpha: None }
    }

    /// The nearest hit, by asking every triangle.
    fn brute(&self, ray: &Ray) -> Hit {
        let Some(query) = Query::new(ray, 2.0) else { return Hit::MISS };
        let mut best = Best::before(ray.t_max);
        for (i, corners) in self.indices.iter().enumerate() {
            let mut block = Block::empty();
            block.set(0, corners.map(|c| self.positions[c as usize]), 0, i as u32);
            if let Some(met) = intersect(&query, &block, 0)
                && best.is_beaten_by(met.t, NONE, 0, i as u32)
            {
                best.take(Hit {
                    t: met.t,
                    u: met.u,
                    v: met.v,
                    geometry: 0,
                    primitive: i as u32,
                    instance: NONE,
                    place: NONE,
                });
            }
        }
        best.into_hit()
    }
}

/// Rays at corners, edges, faces and nothing, some along axes, some that end early.
fn rays(soup: &Soup, count: usize, seed: u64) -> Vec<Ray> {
    let mut random = Random(seed);
    (0..count)
        .map(|i| {
            let corners = soup.indices[random.next() as usize % soup.indices.len()]
                .map(|c| Vec3::from(soup.positions[c as usize]));
            let target = match i % 4 {
                0 => corners[0],
                1 => corners[1].lerp(corners[2], random.signed() * 0.5 + 0.5),
                2 => (corners[0] + corners[1] + corners[2]) / 3.0,
                _ => random.point(),
            };
            let mut origin = random.point() * if i % 3 == 0 { 0.5 } else { 3.0 };
            if i % 5 == 0 {
                // Along an axis: the other components are exactly zero.
                let axis = i / 5 % 3;
                let along = origin[axis];
                origin = target;
                origin[axis] = along;
            }
            let mut ray = Ray::new(origin, target - origin);
            if i % 7 == 0 {
                ray.t_max = 1.0;
            }
            if i % 11 == 0 {
                ray.direction = -ray.direction.normalize_or_zero();
            }
            ray
        })
        .collect()
}

fn bits(hit: &Hit) -> [u32; 6] {
    let Hit { t, u, v, geometry, primitive, instance, place: _ } = *hit;
    [t.to_bits(), u.to_bits(), v.to_bits(), geometry, primitive, instance]
}

#[test]
fn both_forms_find_what_asking_every_triangle_finds_to_the_bit() {
    let nothing = Spheres { radius: 0.0 };
    for (count, seed) in [(1, 1), (3, 2), (17, 3), (300, 4), (3000, 5)] {
        let soup = soup(count, seed);
        let build =
            |form| BvhScene::new(&[soup.geometry()], &[], &[], &nothing, None, form).expect("few triangles");
        let (plain, wide) = (build(Form::Plain), build(Form::Wide));
        let mut hits = 0;
        for ray in rays(&soup, 4000, seed) {
            let truth = soup.brute(&ray);
            hits += usize::from(truth.geometry != NONE);
            for scene in [&plain, &wide] {
                assert_eq!(bits(&scene.closest(&ray)), bits(&truth), "{ray:?}: {truth:?}");
                assert_eq!(scene.occluded(&ray), truth.geometry != NONE, "{ray:?}");
            }
        }
        assert!(count == 1 || hits > 800, "only {hits} hits over {count} triangles test too little");
    }
}

#[test]
fn instances_and_primitives_of_their_own_are_found_in_both_forms() {
    let spheres = Spheres { radius: 0.4 };
    let soup = soup(200, 6);
    let object = vec![soup.geometry(), Geometry::Custom { count: 12, user: 0, alpha: true }];
    let mut random = Random(7);
    let instances: Vec<InstanceOf> = (0..50)
        .map(|_| {
            let scale = Vec3::new(1.0, 0.5 + random.signed() * 0.4, -0.3);
            let turn = Quat::from_axis_angle(random.point().normalize_or(Vec3::X), random.signed() * 3.0);
            let m = Mat4::from_scale_rotation_translation(scale, turn, random.point() * 4.0);
            let mut transform = [0.0; 12];
            for (out, axis) in transform.chunks_exact_mut(3).zip(m.to_cols_array_2d()) {
                out.copy_from_slice(&axis[..3]);
            }
            InstanceOf { object: 0, transform }
        })
        .collect();
    let world = [Geometry::Custom { count: 5, user: 1, alpha: false }, soup.geometry()];
    let build = |form| {
        BvhScene::new(&world, std::slice::from_ref(&object), &instances, &spheres, None, form).expect("few")
    };
    let (plain, wide) = (build(Form::Plain), build(Form::Wide));
    let mut seen = [0; 4];
    for ray in rays(&soup, 20_000, 8) {
        let (a, b) = (plain.closest(&ray), wide.closest(&ray));
        assert_eq!(bits(&a), bits(&b), "{ray:?}: {a:?} {b:?}");
        assert_eq!(plain.occluded(&ray), a.geometry != NONE, "{ray:?}");
        assert_eq!(wide.occluded(&ray), a.geometry != NONE, "{ray:?}");
        if a.geometry != NONE {
            seen[usize::from(a.instance != NONE) * 2 + a.geometry as usize] += 1;
            let masked = a.instance != NONE && a.geometry == 1;
            assert!(!masked || !a.primitive.is_multiple_of(3), "a masked primitive was hit: {a:?}");
        }
    }
    assert!(seen.iter().all(|&n| n > 100), "kinds of hits: {seen:?}");
}

/// Asked part by part, cut anywhere, the answer is that of the whole ray, to the bit.
#[test]
fn parts_of_a_ray_give_what_the_whole_gives() {
    let spheres = Spheres { radius: 0.4 };
    let soup = soup(200, 6);
    let mut random = Random(17);
    let instances: Vec<InstanceOf> = (0..200)
        .map(|_| {
            let Vec3 { x, y, z } = random.point() * 4.0;
            InstanceOf { object: 0, transform: [0.3, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.3, x, y, z] }
        })
        .collect();
    let world = [Geometry::Custom { count: 5, user: 1, alpha: false }, soup.geometry()];
    let object = vec![soup.geometry()];
    for form in [Form::Plain, Form::Wide] {
        let scene = BvhScene::new(&world, std::slice::from_ref(&object), &instances, &spheres, None, form)
            .expect("few");
        let mut late = 0;
        for ray in rays(&soup, 20_000, 18) {
            let mut cuts: Vec<f32> = (0..4).map(|_| random.signed().abs() * 8.0).collect();
            // Not in order, as rounding may leave them.
            cuts.push(f32::INFINITY);
            let (mut from, mut hit, mut occluded) = (f32::NEG_INFINITY, Hit::MISS, false);
            for &to in &cuts {
                hit = scene.closest_part(&ray, from, to, &hit);
                occluded |= scene.occluded_part(&ray, from, to);
                if hit.t < to {
                    break;
                }
                late += u32::from(hit.geometry != NONE);
                from = to;
            }
            let truth = scene.closest(&ray);
            assert_eq!(bits(&hit), bits(&truth), "{ray:?} at {cuts:?}: {hit:?} {truth:?}");
            assert_eq!(occluded, truth.geometry != NONE, "{ray:?} at {cuts:?}");
        }
        assert!(late > 100, "{late} rays met something before its part began");
    }
}

#[test]
fn the_tree_does_not_depend_on_the_number_of_threads() {
    let soup = soup(60_000, 9);
    let nothing = Spheres { radius: 0.0 };
    let build = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a few threads");
        pool.install(|| BvhScene::new(&[soup.geometry()], &[], &[], &nothing, None, Form::best()))
            .expect("few triangles")
    };
    let (one, three) = (build(1), build(3));
    assert_eq!(one.world_image(), three.world_image());
}

#[test]
fn what_is_not_finite_is_left_out_and_the_rest_is_found() {
    let mut soup = soup(100, 10);
    let good = soup.indices.len();
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -3e38] {
        for axis in 0..3 {
            let first = soup.positions.len() as u32;
            soup.positions.extend([[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
            soup.positions.last_mut().expect("just added")[axis] = bad;
            soup.indices.push([first, first + 1, first + 2]);
        }
    }
    let nothing = Spheres { radius: 0.0 };
    let scene = BvhScene::new(&[soup.geometry()], &[], &[], &nothing, None, Form::best()).expect("few");
    let finite = Soup { positions: soup.positions.clone(), indices: soup.indices[..good].to_vec() };
    for ray in rays(&finite, 1000, 11) {
        let truth = finite.brute(&ray);
        assert_eq!(bits(&scene.closest(&ray)), bits(&truth), "{ray:?}");
    }
}

#[test]
fn rays_that_are_no_rays_meet_nothing_and_end() {
    let soup = soup(500, 12);
    let nothing = Spheres { radius: 0.0 };
    let scene = BvhScene::new(&[soup.geometry()], &[], &[], &nothing, None, Form::best()).expect("few");
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 3e38] {
        for axis in 0..3 {
            let mut origin = Vec3::ZERO;
            origin[axis] = bad;
            let ray = Ray::new(origin, Vec3::ONE);
            assert_eq!(scene.closest(&ray).geometry, NONE, "{ray:?}");
            assert!(!scene.occluded(&ray), "{ray:?}");
            let mut direction = Vec3::ONE;
            direction[axis] = bad;
            let ray = Ray::new(Vec3::ZERO, direction);
            assert_eq!(scene.closest(&ray).geometry, NONE, "{ray:?}");
            assert!(!scene.occluded(&ray), "{ray:?}");
        }
    }
    let still = Ray::new(Vec3::ZERO, Vec3::ZERO);
    assert_eq!(scene.closest(&still).geometry, NONE);
    // An empty interval, and an end before the start.
    for (t_min, t_max) in [(1.0, 1.0), (2.0, 1.0), (0.0, 0.0), (f32::NAN, 1.0), (0.0, f32::NAN)] {
        for ray in rays(&soup, 200, 13) {
            let ray = Ray { t_min, t_max, ..ray };
            assert_eq!(scene.closest(&ray).geometry, NONE, "{ray:?}");
            assert!(!scene.occluded(&ray), "{ray:?}");
        }
    }
}

#[test]
fn a_hundred_thousand_triangles_in_one_place_take_bounded_time() {
    let mut soup = Soup { positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], indices: Vec::new() };
    soup.indices.resize(100_000, [0, 1, 2]);
    let nothing = Spheres { radius: 0.0 };
    for form in [Form::Plain, Form::Wide] {
        let scene = BvhScene::new(&[soup.geometry()], &[], &[], &nothing, None, form).expect("fits");
        let hit = scene.closest(&Ray::new(Vec3::new(0.25, 0.25, 1.0), Vec3::NEG_Z));
        assert_eq!((hit.t, hit.primitive), (1.0, 0), "of equal hits the first counts");
    }
}

#[test]
fn nothing_is_never_hit() {
    let nothing = Spheres { radius: 0.0 };
    for form in [Form::Plain, Form::Wide] {
        let scene = BvhScene::new(&[], &[], &[], &nothing, None, form).expect("fits");
        assert_eq!(scene.closest(&Ray::new(Vec3::ZERO, Vec3::Z)).geometry, NONE);
        assert!(!scene.occluded(&Ray::new(Vec3::ZERO, Vec3::Z)));
        let (lo, hi) = scene.bounds();
        assert!(lo.x > hi.x);
    }
}

#[test]
fn an_instance_has_the_pages_of_its_object() {
    // Of two meshes that lie in one another, so that their pages take turns in the tree.
    let row = |from: f32| -> Vec<Outline> {
        let places = (0..40u8).map(|i| f32::from(i) * 2.0 + from);
        places.map(|x| Outline::whole([[x, 0.0, 0.0], [x + 0.5, 1.0, 1.0]])).collect()
    };
    let (even, odd) = (row(0.0), row(1.0));
    let object = vec![
        Geometry::Pages { first: 7, outlines: &even },
        Geometry::Pages { first: 7 + even.len() as u32, outlines: &odd },
    ];
    let spheres = Spheres { radius: 1.0 };
    let place =
        InstanceOf { object: 0, transform: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 3.0, 0.0, 0.0] };
    let world = [Geometry::Pages { first: 0, outlines: &even[..7] }];
    let scene = BvhScene::new(&world, &[object], &[place], &spheres, None, Form::best()).expect("few");
    let mut names: Vec<u32> = scene.pages().into_iter().flat_map(|b| b.pages).collect();
    names.sort_unstable();
    assert_eq!(names, (0..87).collect::<Vec<u32>>());
}
