//! Nanoseconds for each sample, printed: `cargo test --release light::bench -- --ignored --nocapture`.

use super::delta::DeltaLight;
use super::disk::Disk;
use super::env::{EnvFilter, EnvMapping, EnvironmentMap};
use super::parallelogram::Parallelogram;
use super::select::AliasTable;
use super::sphere::Sphere;
use super::testing::Rng;
use super::tree::{LightBounds, LightTree};
use super::{octahedral, patch, triangle};
use crate::color::Rgb;
use crate::math::Transform;
use glam::{Vec2, Vec3};
use std::hint::black_box;
use std::time::Instant;

fn time<T>(name: &str, mut f: impl FnMut(Vec2) -> T) {
    let mut rng = Rng::new(1);
    let us: Vec<Vec2> = (0..1 << 14).map(|_| rng.vec2()).collect();
    let mut best = f64::INFINITY;
    for _ in 0..20 {
        let start = Instant::now();
        for &u in &us {
            black_box(f(black_box(u)));
        }
        best = best.min(start.elapsed().as_secs_f64() * 1e9 / us.len() as f64);
    }
    println!("{name:40} {best:7.1} ns");
}

#[test]
#[ignore = "a measurement, not a test"]
fn nanoseconds_per_sample() {
    let (a, b, c) = (Vec3::ZERO, Vec3::X, Vec3::Y);
    let (near, far) = (Vec3::new(0.2, 0.3, 1.0), Vec3::new(0.2, 0.3, 30.0));
    time("triangle, area", |u| triangle::sample(black_box(far), a, b, c, u));
    time("triangle, spherical", |u| triangle::sample(black_box(near), a, b, c, u));
    time("triangle, spherical pdf", |u| triangle::pdf(black_box(near), a, b, c, u.x, u.y));
    let quad = Parallelogram::new(a, b, c).expect("area");
    let skew = Parallelogram::new(a, b, c + b).expect("area");
    time("rectangle, area", |u| quad.sample(black_box(far), u));
    time("rectangle, spherical", |u| quad.sample(black_box(near), u));
    time("rectangle, spherical pdf", |u| quad.pdf(black_box(near), u.x, u.y));
    time("parallelogram, two spherical triangles", |u| skew.sample(black_box(near), u));
    let whole = Sphere::new(&Transform::IDENTITY, 1.0, -1.0, 1.0, 360.0).expect("sphere");
    let part = Sphere::new(&Transform::IDENTITY, 1.0, -0.5, 1.0, 360.0).expect("sphere");
    time("sphere, cone", |u| whole.sample(black_box(far), u));
    time("sphere, clipped", |u| part.sample(black_box(far), u));
    let disk = Disk::new(&Transform::IDENTITY, 0.0, 1.0, 0.0, 360.0).expect("disk");
    time("disk", |u| disk.sample(black_box(near), u));
    let patch = patch::Patch::new(a, b, c, b + c + Vec3::Z).expect("patch");
    time("patch", |u| patch.sample(black_box(near), u));
    let point = DeltaLight::Point { intensity: Rgb::ONE, position: near };
    time("point", |u| point.sample(black_box(u.extend(0.0))));
    time("square to sphere", octahedral::square_to_sphere);
    let mut rng = Rng::new(2);
    for (mapping, name) in
        [(EnvMapping::EqualAreaOctahedral, "octahedral"), (EnvMapping::LatLong, "lat-long")]
    {
        let n = 2048;
        let texels = (0..n * n).map(|_| [rng.f32().powi(8); 3]).collect();
        let id = Transform::IDENTITY;
        let start = Instant::now();
        let map = EnvironmentMap::new(texels, n, n, mapping, EnvFilter::Bilinear, &id).expect("fits");
        println!("{name} 2048² built in {:.3} s", start.elapsed().as_secs_f64());
        time(&format!("{name}, sample"), |u| map.sample(u));
        time(&format!("{name}, radiance"), |u| map.radiance(octahedral::square_to_sphere(u)));
        time(&format!("{name}, pdf"), |u| map.pdf(octahedral::square_to_sphere(u)));
    }
    let table = AliasTable::new(&vec![1.0; 10_000]).expect("weights");
    time("alias table of 10⁴", |u| table.sample(u.x));
    for n in [10, 1000, 100_000, 1_000_000] {
        let lights: Vec<LightBounds> = (0..n)
            .map(|_| {
                let v = rng.direction() * 10.0;
                let corners = [v, v + rng.direction() * 0.1, v + rng.direction() * 0.1];
                LightBounds::flat(&corners, rng.direction(), rng.f32(), false)
            })
            .collect();
        let start = Instant::now();
        let tree = LightTree::new(&lights).expect("power");
        println!("tree of {n} built in {:.3} s, {} bytes", start.elapsed().as_secs_f64(), tree.bytes());
        let at = |u: Vec2| (u * 8.0 - 4.0).extend(u.x);
        time(&format!("tree of {n}, sample"), |u| tree.sample(at(u), Vec3::Z, u.y));
        time(&format!("tree of {n}, pmf"), |u| tree.pmf(at(u), Vec3::Z, (u.x * n as f32) as usize % n));
    }
}
