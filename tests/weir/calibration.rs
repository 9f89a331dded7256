//! What `--noise` promises against what it keeps: each picture against a reference of many samples and another seed.
//!
//! The error of a pixel is the root of its relMSE, the mean over channels of the squared difference over the reference's
//! square and 0.01. The reference's own error is in every difference: it is told beside, and taken off where a mean of
//! squares is told.

use crate::determinism::everything;
use crate::support::{outcome, shared, shared_scenes};
use std::path::Path;
use weir::film::Image;
use weir::scene::{self, SceneDescription};
use weir::settings::{RenderSettings, Schedule};

/// What one picture kept of its promise.
#[derive(Clone, Copy, Default)]
struct Kept {
    pixels: f64,
    /// Pixels within what was asked for, and within 1.5 times.
    within: f64,
    near: f64,
    /// Tiles of 8×8 pixels, and those whose root mean square error is within the same.
    tiles: f64,
    tiles_within: f64,
    tiles_near: f64,
    /// Sums over pixels: squared error, and the estimate of it.
    square: f64,
    estimate: f64,
    /// Squared error of the reference, likewise.
    reference: f64,
    samples: f64,
    /// Ratio of the means to the reference's, summed over pictures.
    mean: f64,
    pictures: f64,
}

impl Kept {
    fn add(&mut self, other: &Self) {
        let Self {
            pixels,
            within,
            near,
            tiles,
            tiles_within,
            tiles_near,
            square,
            estimate,
            reference,
            samples,
            mean,
            pictures,
        } = *other;
        for (sum, value) in [
            (&mut self.pixels, pixels),
            (&mut self.within, within),
            (&mut self.near, near),
            (&mut self.tiles, tiles),
            (&mut self.tiles_within, tiles_within),
            (&mut self.tiles_near, tiles_near),
            (&mut self.square, square),
            (&mut self.estimate, estimate),
            (&mut self.reference, reference),
            (&mut self.samples, samples),
            (&mut self.mean, mean),
            (&mut self.pictures, pictures),
        ] {
            *sum += value;
        }
    }

    /// Achieved over asked for, the root of the mean square.
    fn ratio(&self, noise: f64) -> f64 {
        ((self.square - self.reference).max(0.0) / self.pixels).sqrt() / noise
    }

    fn row(&self, name: &str, noise: f64) -> String {
        let share = |part: f64, of: f64| format!("{:.1} %", part / of * 100.0);
        format!(
            "| {name} | {} % | {:.2} | {:.2} | {} | {} | {} | {} | {:.4} | {:.0} |",
            noise * 100.0,
            self.ratio(noise),
            (self.estimate / self.pixels).sqrt() / noise,
            share(self.near, self.pixels),
            share(self.within, self.pixels),
            share(self.tiles_near, self.tiles),
            share(self.tiles - self.tiles_within, self.tiles),
            self.mean / self.pictures,
            self.samples / self.pixels
        )
    }
}

const HEAD: &str = "| scene | asked for | achieved / asked | estimated / asked | pixels within 1.5 × | pixels within 1 × | regions within 1.5 × | regions stopped too early | mean / reference's | samples per pixel |\n\
     |---|---|---|---|---|---|---|---|---|---|";

struct Reference {
    image: Image,
    relmse: f64,
}

fn reference(scene: &SceneDescription, settings: &RenderSettings, spp: u32) -> Reference {
    // So low a noise that none stops but what has none.
    let settings =
        RenderSettings { noise: Some(1e-4), spp: Some(spp), seed: Some(1_000_003), ..settings.clone() };
    let outcome = outcome(scene, &settings).unwrap_or_else(|e| panic!("{e}"));
    Reference { relmse: outcome.stats.image.estimated_relmse.expect("passes enough"), image: outcome.image }
}

fn measure(
    scene: &SceneDescription,
    settings: &RenderSettings,
    reference: &Reference,
    noise: f64,
    seed: u64,
) -> Kept {
    let settings = RenderSettings { noise: Some(noise), seed: Some(seed), ..settings.clone() };
    let outcome = outcome(scene, &settings).unwrap_or_else(|e| panic!("{e}"));
    let (image, right) = (&outcome.image, &reference.image);
    let error = |i: usize| -> f64 {
        let of = |c: usize| {
            let (x, r) = (f64::from(image.pixels[i][c]), f64::from(right.pixels[i][c]));
            (x - r).powi(2) / (3.0 * (r * r + 0.01))
        };
        of(0) + of(1) + of(2)
    };
    let pixels = image.pixels.len() as f64;
    let total = |image: &Image| image.pixels.iter().flatten().map(|&c| f64::from(c)).sum::<f64>();
    let mut kept = Kept {
        pixels,
        reference: reference.relmse * pixels,
        estimate: outcome.stats.image.estimated_relmse.expect("passes enough") * pixels,
        samples: outcome.stats.image.samples as f64,
        mean: total(image) / total(right),
        pictures: 1.0,
        ..Kept::default()
    };
    for y in (0..image.height).step_by(8) {
        for x in (0..image.width).step_by(8) {
            let (mut square, mut count) = (0.0, 0.0);
            for v in y..(y + 8).min(image.height) {
                for u in x..(x + 8).min(image.width) {
                    let error = error(image.index(u, v));
                    kept.within += f64::from(error.sqrt() <= noise);
                    kept.near += f64::from(error.sqrt() <= 1.5 * noise);
                    square += error;
                    count += 1.0;
                }
            }
            kept.square += square;
            kept.tiles += 1.0;
            // Of what is the picture's own, as far as that is known.
            let rms = (square / count - reference.relmse).max(0.0).sqrt();
            kept.tiles_within += f64::from(rms <= noise);
            kept.tiles_near += f64::from(rms <= 1.5 * noise);
        }
    }
    kept
}

/// Name, scene and settings; those of `../shared` where they are.
fn scenes(size: (u32, u32)) -> Vec<(String, SceneDescription, RenderSettings)> {
    let settings = RenderSettings {
        size: Some(size),
        threads: Some(std::thread::available_parallelism().map_or(1, std::num::NonZero::get)),
        ..RenderSettings::default()
    };
    let mut list = Vec::new();
    let mut add = |name: String, path: &Path| {
        list.push((name, scene::load(path).unwrap_or_else(|e| panic!("{e}")), settings.clone()));
    };
    for name in ["cornell", "materials", "textures", "instances"] {
        add(name.to_owned(), &Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.pbrt")));
    }
    shared_scenes().iter().for_each(|(name, path)| add(format!("pbrt {name}"), path));
    for (name, file) in [("cornell", "cornell_box.obj"), ("spot", "spot/spot_triangulated.obj")] {
        if let Some(folder) = shared(&format!("obj-{name}")) {
            add(format!("obj {name}"), &folder.join(file));
        }
    }
    list
}

/// From the environment, or what a full run takes.
fn asked<T: std::str::FromStr + Clone>(name: &str, full: &[T]) -> Vec<T> {
    let text = std::env::var(name).unwrap_or_default();
    let list: Vec<T> = text.split(',').filter_map(|word| word.parse().ok()).collect();
    if list.is_empty() { full.to_vec() } else { list }
}

/// The whole of it: `make calibrate` prints the table of `docs/noise.md`.
#[test]
#[ignore = "minutes to hours: make calibrate"]
fn calibrate() {
    let noises = asked("WEIR_CALIBRATE_NOISE", &[0.2, 0.1, 0.05]);
    let seeds = asked::<u64>("WEIR_CALIBRATE_SEEDS", &[20])[0];
    let spp = asked::<u32>("WEIR_CALIBRATE_REFERENCE", &[8192])[0];
    let only = std::env::var("WEIR_CALIBRATE_SCENE").unwrap_or_default();
    println!("{HEAD}");
    let mut all = vec![Kept::default(); noises.len()];
    for (name, scene, settings) in scenes((96, 54)) {
        if !name.contains(&only) {
            continue;
        }
        let reference = reference(&scene, &settings, spp);
        eprintln!("{name}: relative error of the reference {:.2} %", reference.relmse.sqrt() * 100.0);
        for (&noise, all) in noises.iter().zip(&mut all) {
            let mut kept = Kept::default();
            (0..seeds).for_each(|seed| kept.add(&measure(&scene, &settings, &reference, noise, seed)));
            println!("{}", kept.row(&name, noise));
            all.add(&kept);
        }
    }
    noises.iter().zip(&all).for_each(|(&noise, all)| println!("{}", all.row("all", noise)));
}

/// Of a small picture, what the table says of larger ones.
#[test]
fn an_error_that_is_asked_for_is_kept() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.pbrt");
    let scene = scene::load(&path).unwrap_or_else(|e| panic!("{e}"));
    let settings = RenderSettings { size: Some((40, 40)), ..RenderSettings::default() };
    let reference = reference(&scene, &settings, 4096);
    let mut samples = Vec::new();
    for noise in [0.1, 0.05] {
        let mut kept = Kept::default();
        (0..3).for_each(|seed| kept.add(&measure(&scene, &settings, &reference, noise, seed)));
        println!("{HEAD}\n{}", kept.row("cornell", noise));
        assert!(kept.near >= 0.95 * kept.pixels, "{} of {} pixels", kept.near, kept.pixels);
        let (ratio, estimated) = (kept.ratio(noise), (kept.estimate / kept.pixels).sqrt() / noise);
        assert!((0.2..1.0).contains(&ratio), "{ratio}");
        // The estimate is of what is there: rather too large, and not by half.
        assert!((0.9..1.5).contains(&(estimated / ratio)), "estimated {estimated}, achieved {ratio}");
        assert!((kept.mean / kept.pictures - 1.0).abs() < 0.01, "{}", kept.mean / kept.pictures);
        samples.push(kept.samples);
    }
    assert!(samples[1] > 2.0 * samples[0], "half the error takes about four times the samples: {samples:?}");
}

#[test]
fn all_schedules_and_numbers_of_threads_stop_at_the_same_samples() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = everything(folder.path());
    let with = |schedule, threads, crop| {
        let settings = RenderSettings {
            schedule,
            crop,
            threads: Some(threads),
            noise: Some(0.1),
            spp: Some(300),
            ..RenderSettings::default()
        };
        outcome(&scene, &settings).unwrap_or_else(|e| panic!("{e}"))
    };
    let one = with(Schedule::Depth, 1, None);
    let image = &one.stats.image;
    assert!(image.spp_min < image.spp_max && image.estimated_relmse.is_some_and(|e| e > 0.0), "{image:?}");
    assert_eq!(
        one.stats.plan.bytes.film, one.stats.memory.accounted.film,
        "what is kept of errors is planned"
    );
    for (schedule, threads) in [(Schedule::Depth, 3), (Schedule::Sorted, 1), (Schedule::Sorted, 3)] {
        let other = with(schedule, threads, None);
        assert!(other.image.pixels == one.image.pixels, "{schedule:?}, {threads} threads: another picture");
        assert_eq!(other.stats.image.samples, image.samples);
        assert_eq!(other.stats.image.estimated_relmse, image.estimated_relmse);
    }
}
