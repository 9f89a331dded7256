//! Time per call, for people: `cargo test --release --lib bsdf -- --ignored --nocapture speed`.

use super::*;
use std::f32::consts::TAU;
use std::hint::black_box;
use std::time::Instant;

#[test]
#[ignore = "prints times, judges nothing"]
fn nanoseconds_per_sample_and_eval() {
    let rough = Ggx::new(0.2, 0.2);
    let smooth = Ggx::new(0.0, 0.0);
    let (rough_table, smooth_table) =
        (CoatedTable::new(1.5, 0.2, 0.2, 0.01, 10), CoatedTable::new(1.5, 0.0, 0.0, 0.01, 10));
    let grid = CoatedTables::textured(1.5, 0.01, 10);
    let grey = Rgb::splat(0.5);
    let cases = [
        ("diffuse", Bsdf::Diffuse(Diffuse::new(grey))),
        ("diffuse transmission", Bsdf::DiffuseTransmission(DiffuseTransmission::new(grey, grey))),
        ("conductor smooth", Bsdf::Conductor(Conductor::from_reflectance(grey, smooth))),
        ("conductor rough", Bsdf::Conductor(gold((0.2, 0.2)))),
        ("dielectric smooth", Bsdf::Dielectric(Dielectric::new(1.5, smooth))),
        ("dielectric rough", Bsdf::Dielectric(Dielectric::new(1.5, rough))),
        ("thin dielectric", Bsdf::ThinDielectric(ThinDielectric::new(1.5))),
        ("coated smooth", Bsdf::CoatedDiffuse(CoatedDiffuse::with_table(&smooth_table, grey, smooth))),
        ("coated rough", Bsdf::CoatedDiffuse(CoatedDiffuse::with_table(&rough_table, grey, rough))),
        ("coated textured", Bsdf::CoatedDiffuse(grid.bsdf(grey, 0.2, 0.2))),
    ];
    let mut rng = Rng(5);
    let inputs: Vec<_> = (0..4096)
        .map(|_| {
            let wo = direction(0.05 + 0.95 * rng.f32(), TAU * rng.f32());
            (wo, direction(0.05 + 0.95 * rng.f32(), TAU * rng.f32()), rng.f32(), rng.vec2())
        })
        .collect();
    let rounds = 500;
    // The fastest round: others share the machine.
    let time = |call: &mut dyn FnMut()| {
        let round = |_| {
            let start = Instant::now();
            call();
            start.elapsed().as_secs_f64() * 1e9 / 4096.0
        };
        (0..rounds).map(round).fold(f64::INFINITY, f64::min)
    };
    for (name, bsdf) in &cases {
        let bsdf = black_box(bsdf);
        let sample = time(&mut || {
            let sum: f32 = inputs
                .iter()
                .filter_map(|(wo, _, uc, u)| bsdf.sample(*wo, *uc, *u))
                .map(|s| s.pdf + s.weight.x + s.wi.x)
                .sum();
            black_box(sum);
        });
        let eval = time(&mut || {
            let sum: f32 =
                inputs.iter().map(|(wo, wi, ..)| bsdf.eval(*wo, *wi)).map(|(f, pdf)| f.x + pdf).sum();
            black_box(sum);
        });
        println!("{name:22} sample {sample:6.1} ns   eval {eval:6.1} ns");
    }
    let build = time_once(|| CoatedTable::new(1.5, 0.2, 0.2, 0.01, 10));
    let smooth = time_once(|| CoatedTable::new(1.5, 0.0, 0.0, 0.01, 10));
    let grid = time_once(|| CoatedTables::textured(1.5, 0.01, 10));
    println!("tables: rough {build:.2} ms, smooth {smooth:.3} ms, textured {grid:.1} ms");
    println!("sizes: Bsdf {} bytes, sample {} bytes", size_of::<Bsdf>(), size_of::<BsdfSample>());
}

fn time_once<T>(make: impl FnOnce() -> T) -> f64 {
    let start = Instant::now();
    black_box(make());
    start.elapsed().as_secs_f64() * 1e3
}
