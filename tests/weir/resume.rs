//! What is stopped and taken up again, however often and wherever, is what one go gives, to the bit; and a checkpoint of
//! anything else is refused before a file is touched.

use crate::determinism::everything;
use crate::pages::{least, make, settings as paged};
use crate::support::{bits, outcome, render};
use std::path::Path;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use std::{fs, thread};
use weir::film::read::read_image;
use weir::render::{Control, Outcome, Progress};
use weir::scene::SceneDescription;
use weir::settings::{Checkpointing, RenderSettings, Sampler, Schedule};
use weir::study::generate::Kind;

fn kept(folder: &Path) -> Option<Checkpointing> {
    Some(Checkpointing { path: folder.join("a.exr.weir"), every_seconds: 60.0 })
}

/// Renders, is stopped after a while, and goes on, until it is done: the picture, and how often it was stopped.
fn in_parts(scene: &SceneDescription, settings: &RenderSettings, first_wait: Duration) -> (Outcome, u32) {
    let mut stops = 0;
    loop {
        let cancel = AtomicBool::new(false);
        let over = AtomicBool::new(false);
        let rendering = AtomicBool::new(false);
        // Longer each time, so that any machine comes to an end.
        let wait = first_wait.mul_f64(1.0 + f64::from(stops) / 3.0);
        let outcome = thread::scope(|scope| {
            let (cancel, over, rendering) = (&cancel, &over, &rendering);
            scope.spawn(move || {
                while !over.load(Ordering::Relaxed) {
                    if rendering.load(Ordering::Relaxed) {
                        thread::sleep(wait);
                        cancel.store(true, Ordering::Relaxed);
                        return;
                    }
                    thread::sleep(Duration::from_micros(200));
                }
            });
            let progress = |progress: Progress| {
                if matches!(progress, Progress::Phase("rendering")) {
                    rendering.store(true, Ordering::Relaxed);
                }
            };
            let control = Control { cancel, progress: &progress, watch: None };
            let outcome = weir::render::render(scene, settings, &control);
            over.store(true, Ordering::Relaxed);
            outcome.unwrap_or_else(|e| panic!("{e}"))
        });
        if !outcome.interrupted {
            return (outcome, stops);
        }
        stops += 1;
        assert!(stops < 200, "it never ends");
    }
}

#[test]
fn however_often_it_is_stopped_the_picture_is_that_of_one_go() {
    let all = AtomicU64::new(0);
    thread::scope(|scope| {
        for (schedule, threads, crop, noise) in [
            (Schedule::Depth, 1, None, None),
            (Schedule::Depth, 3, Some([7, 5, 50, 30]), None),
            (Schedule::Sorted, 3, None, None),
            (Schedule::Sorted, 1, Some([3, 0, 20, 43]), Some(0.1)),
            (Schedule::Depth, 3, None, Some(0.1)),
        ] {
            let all = &all;
            scope.spawn(move || {
                let folder = tempfile::tempdir().expect("a temporary folder");
                let scene = everything(folder.path());
                let plain = RenderSettings {
                    schedule,
                    crop,
                    noise,
                    threads: Some(threads),
                    spp: Some(if noise.is_some() { 150 } else { 70 }),
                    ..RenderSettings::default()
                };
                let what = format!("{schedule:?}, {threads} threads, {crop:?}, {noise:?}");
                let one = render(&scene, &plain);
                let settings = RenderSettings { checkpoint: kept(folder.path()), ..plain };
                let (parts, stops) = in_parts(&scene, &settings, Duration::from_millis(20));
                assert!(
                    bits(&parts.image) == bits(&one.image),
                    "{what}: another picture after {stops} stops"
                );
                let (image, stats) = (&parts.stats.image, &parts.stats);
                assert_eq!(stats.plan.bytes.film, stats.memory.accounted.film, "{what}: planned");
                assert_eq!(image.samples + image.resumed_samples, one.stats.image.samples, "{what}");
                all.fetch_add(u64::from(stops), Ordering::Relaxed);
                // What is done is only written again.
                let again = render(&scene, &settings);
                assert!(bits(&again.image) == bits(&one.image) && again.stats.image.samples == 0, "{what}");
            });
        }
    });
    assert!(all.load(Ordering::Relaxed) > 5, "hardly any was stopped");
}

#[test]
fn rays_that_wait_in_voxels_go_on_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let scene = make(Kind::City, 60_000, folder.path());
    let base = RenderSettings {
        schedule: Schedule::Voxel,
        page_bytes: Some(4 << 10),
        threads: Some(3),
        spp: Some(40),
        ..paged(folder.path())
    };
    let budget = least(&scene, &base);
    for noise in [None, Some(0.2)] {
        let plain = RenderSettings { noise, schedule: Schedule::Depth, ..base.clone() };
        let one = render(&scene, &plain);
        let _ = fs::remove_file(folder.path().join("a.exr.weir"));
        let settings = RenderSettings {
            noise,
            geometry_memory: Some(budget),
            checkpoint: kept(folder.path()),
            ..base.clone()
        };
        let (parts, stops) = in_parts(&scene, &settings, Duration::from_millis(60));
        assert_eq!(parts.stats.scheduler.name, "voxel");
        assert!(stops > 0, "never stopped");
        assert!(bits(&parts.image) == bits(&one.image), "{noise:?}: another picture after {stops} stops");
    }
}

#[test]
fn more_samples_are_those_of_one_go() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = everything(folder.path());
    // Textures of this scene are filtered by footprints.
    let with = |spp, footprint_spp, checkpoint| RenderSettings {
        spp: Some(spp),
        footprint_spp,
        checkpoint,
        threads: Some(2),
        ..RenderSettings::default()
    };
    for sampler in [Sampler::Sobol, Sampler::Independent] {
        let path = kept(folder.path()).expect("some").path;
        let _ = fs::remove_file(&path);
        for (k, spp) in [1, 7, 16, 20, 33, 35, 90].into_iter().enumerate() {
            let footprints = Some(90);
            let go_on = RenderSettings { sampler, ..with(spp, footprints, kept(folder.path())) };
            let part = render(&scene, &go_on);
            let one = render(&scene, &RenderSettings { sampler, ..with(spp, footprints, None) });
            assert!(bits(&part.image) == bits(&one.image), "{sampler:?}: another picture at {spp} samples");
            assert_eq!((part.stats.image.spp, part.stats.image.resumed_samples > 0), (spp, k > 0));
        }
    }
    // Above 64 samples footprints shrink no more, and below they are part of what is continued.
    let path = kept(folder.path()).expect("some").path;
    fs::remove_file(&path).expect("there");
    let plain = render(&scene, &with(100, None, None));
    render(&scene, &with(70, None, kept(folder.path())));
    let more = render(&scene, &with(100, None, kept(folder.path())));
    assert!(bits(&more.image) == bits(&plain.image), "another picture");
    fs::remove_file(&path).expect("there");
    render(&scene, &with(20, None, kept(folder.path())));
    let refused =
        outcome(&scene, &with(40, None, kept(folder.path()))).err().expect("other textures").to_string();
    assert!(refused.contains("(--footprint-spp) is 20, not 40"), "{refused}");
}

#[test]
fn what_is_of_another_render_is_refused_and_stays() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut scene = everything(folder.path());
    let settings =
        RenderSettings { spp: Some(64), checkpoint: kept(folder.path()), ..RenderSettings::default() };
    let path = kept(folder.path()).expect("some").path;
    render(&scene, &settings);
    let before = fs::read(&path).expect("kept");
    let refuse = |scene: &SceneDescription, settings: RenderSettings, needed: &str| {
        let error = outcome(scene, &settings).err().unwrap_or_else(|| panic!("{needed}: taken"));
        let line = error.to_string();
        assert!(error.exit_code() == 2 && line.contains(needed) && !line.contains('\n'), "{line}");
        assert!(fs::read(&path).expect("there") == before, "{needed}: it was written");
    };
    let with = || settings.clone();
    refuse(&scene, RenderSettings { seed: Some(5), ..with() }, "its seed is");
    refuse(&scene, RenderSettings { size: Some((60, 43)), ..with() }, "its size is 61x43, not 60x43");
    refuse(&scene, RenderSettings { crop: Some([0, 0, 8, 8]), ..with() }, "its crop is");
    refuse(&scene, RenderSettings { max_depth: Some(2), ..with() }, "its depth is 6, not 2");
    refuse(&scene, RenderSettings { roulette: Some(false), ..with() }, "its roulette is on, not off");
    refuse(&scene, RenderSettings { sampler: Sampler::Independent, ..with() }, "its sampler is sobol");
    refuse(&scene, RenderSettings { noise: Some(0.5), ..with() }, "it has no noise");
    refuse(
        &scene,
        RenderSettings { spp: Some(63), footprint_spp: Some(64), ..with() },
        "64 samples per pixel already",
    );
    scene.camera.lens_radius = 0.5;
    refuse(&scene, with(), "the scene has changed since");
    scene.camera.lens_radius = 0.05;
    fs::write(folder.path().join("texture.png"), fs::read(folder.path().join("texture.png")).expect("there"))
        .expect("touched");
    refuse(&scene, with(), "the scene has changed since");
    fs::write(&path, &before[..before.len() / 2]).expect("cut short");
    let line = outcome(&scene, &with()).err().expect("damaged").to_string();
    assert!(line.contains("damaged or cut short"), "{line}");
}

#[test]
fn a_killed_program_goes_on_where_it_was() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.pbrt");
    let weir = |outputs: [&str; 2], more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_weir"));
        command.current_dir(folder.path()).arg(&scene).args(["--size", "64x64", "--spp", "300", "-q"]);
        command.args(["-o", outputs[0], "-o", outputs[1]]).args(more);
        command
    };
    let status = weir(["plain.exr", "plain.png"], &["--threads", "3"]).status().expect("a program");
    assert!(status.success());
    let resume = |more: &[&str]| {
        let mut line = vec!["--resume", "--checkpoint-every", "15ms"];
        line.extend(more);
        weir(["a.exr", "a.pfm"], &line)
    };
    let mut kills = 0;
    for wait in 1..40u64 {
        let mut child =
            resume(&["--threads", if wait % 2 == 0 { "1" } else { "3" }]).spawn().expect("a program");
        thread::sleep(Duration::from_millis(20 * wait));
        if child.try_wait().expect("our child").is_some() {
            break;
        }
        child.kill().expect("our child");
        child.wait().expect("our child");
        kills += 1;
    }
    let checkpoint = folder.path().join("a.exr.weir");
    assert!(kills > 2 && checkpoint.is_file(), "{kills} kills");
    assert!(resume(&[]).status().expect("a program").success());
    let read = |name: &str| bits(&read_image(&folder.path().join(name)).unwrap_or_else(|e| panic!("{e}")));
    assert!(read("a.exr") == read("plain.exr") && read("a.pfm") == read("plain.exr"), "another picture");
    // What is refused leaves all as it was.
    let images =
        ["a.exr", "a.pfm", "a.exr.weir"].map(|name| fs::read(folder.path().join(name)).expect("there"));
    let refused = resume(&["--seed", "77"]).output().expect("a program");
    let line = String::from_utf8_lossy(&refused.stderr);
    assert_eq!((refused.status.code(), line.lines().count()), (Some(2), 1), "{line}");
    assert!(line.contains("a.exr.weir: a checkpoint of another render: its seed is"), "{line}");
    let after =
        ["a.exr", "a.pfm", "a.exr.weir"].map(|name| fs::read(folder.path().join(name)).expect("there"));
    assert!(images == after, "something was written");
}

#[test]
fn a_checkpoint_that_fails_is_said_when_it_fails_and_once() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let scene = everything(folder.path());
    let path = folder.path().join("a.exr.weir");
    let checkpoint = Some(Checkpointing { path: path.clone(), every_seconds: 0.002 });
    // More samples than anybody waits for: it ends when the line has come, and some time after that.
    let settings = RenderSettings { spp: Some(1 << 20), checkpoint, ..RenderSettings::default() };
    let (cancel, said) = (AtomicBool::new(false), Mutex::new(Vec::new()));
    let progress = |progress: Progress<'_>| match progress {
        // What is in the way stands there from now on, and no file can take its place.
        Progress::Phase("rendering") => fs::create_dir_all(path.join("in the way")).expect("a folder"),
        Progress::Warning(line) => {
            let mut said = said.lock().expect("whole");
            said.push(line.to_owned());
        }
        _ => {}
    };
    let control = Control { cancel: &cancel, progress: &progress, watch: None };
    let outcome = thread::scope(|scope| {
        scope.spawn(|| {
            let start = Instant::now();
            while said.lock().expect("whole").is_empty() && start.elapsed() < Duration::from_secs(60) {
                thread::sleep(Duration::from_millis(1));
            }
            // Dozens of tries.
            thread::sleep(Duration::from_millis(200));
            cancel.store(true, Ordering::Relaxed);
        });
        weir::render::render(&scene, &settings, &control).unwrap_or_else(|e| panic!("{e}"))
    });
    assert!(outcome.interrupted, "it was told before the end");
    let said = said.into_inner().expect("whole");
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(
        said[0].starts_with("warning: the checkpoint was not written: ") && said[0].contains("a.exr.weir"),
        "{said:?}"
    );
    assert!(outcome.unsaved.is_some_and(|line| said[0].contains(&line)), "and again at the end");
}

#[test]
fn under_noise_progress_is_told_in_regions() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.pbrt");
    let scene = weir::scene::load(&scene).unwrap_or_else(|e| panic!("{e}"));
    for (threads, schedule) in [(1, Schedule::Depth), (3, Schedule::Sorted)] {
        let settings = RenderSettings {
            size: Some((64, 60)),
            noise: Some(0.1),
            threads: Some(threads),
            schedule,
            ..RenderSettings::default()
        };
        let told = Mutex::new(Vec::new());
        let progress = |progress: Progress<'_>| match progress {
            Progress::Regions { done, total, samples } => {
                told.lock().expect("whole").push((done, total, samples));
            }
            Progress::Samples { .. } => panic!("of samples nobody knows how many there will be"),
            _ => {}
        };
        let control = Control { cancel: &AtomicBool::new(false), progress: &progress, watch: None };
        let outcome = weir::render::render(&scene, &settings, &control).unwrap_or_else(|e| panic!("{e}"));
        let told = told.into_inner().expect("whole");
        let [width, height] = outcome.stats.settings.full_size;
        let tiles = u64::from(width.div_ceil(8) * height.div_ceil(8));
        assert!(told.iter().all(|&(done, total, _)| total == tiles && done < total), "{told:?}");
        // The first rounds are about all, the last about few.
        assert_eq!(told.first(), Some(&(0, tiles, 0)));
        assert!(told.last().is_some_and(|&(done, ..)| done > tiles / 4), "{told:?}");
        let samples = outcome.stats.image.samples;
        assert!(told.iter().all(|&(.., n)| n <= samples), "{samples}: {told:?}");
    }
}
