//! How memory is divided, for all kinds of scenes and budgets.

use super::*;
use crate::error::Error;

/// Rooms that want round numbers.
struct Round;

impl Least for Round {
    fn page_bytes(&self) -> u64 {
        1 << 16
    }
    fn pages(&self, waiting: bool) -> u64 {
        if waiting { 1 << 21 } else { 1 << 18 }
    }
    fn textures(&self, waiting: bool) -> u64 {
        if waiting { 1 << 20 } else { 1 << 17 }
    }
    fn rays(&self) -> u64 {
        5 << 20
    }
    fn usual_rays(&self) -> u64 {
        256 << 20
    }
    fn usual_textures(&self) -> u64 {
        1 << 33
    }
}

const FIXED: [u64; 3] = [10_000_000, 2_000_000, 1_000_000];

/// Some triangles, a tenth of which stay.
fn geometry(triangles: u64) -> impl Fn(Backend) -> GeometryBytes {
    move |backend| {
        let each = if backend == Backend::Embree { 120 } else { 100 };
        GeometryBytes {
            whole: triangles * (each - 10),
            whole_most: triangles * each,
            building: triangles * 32,
            building_staying: triangles * 3,
            staying: triangles * 10,
            pages: triangles * 80,
            primitives: triangles,
            shining: 0,
            exact: true,
        }
    }
}

fn with(memory: u64) -> RenderSettings {
    RenderSettings { memory: Some(memory), backend: Backend::Embree, ..RenderSettings::default() }
}

fn divided(settings: &RenderSettings, textures: u64, triangles: u64) -> Result<Division> {
    divide(settings, FIXED, textures, &geometry(triangles), &Round)
}

#[track_caller]
fn assert_within(settings: &RenderSettings, d: &Division, what: &str) {
    // Whoever asks for rays that wait has memory for them, and nobody else.
    match settings.schedule {
        Schedule::Auto => assert!(!d.waiting || (d.pages && settings.time_limit_seconds.is_none()), "{what}"),
        asked => assert_eq!(d.waiting, asked != Schedule::Depth, "{what}"),
    }
    let memory = settings.memory.expect("a bound");
    let rays = if d.waiting { d.rays } else { 0 };
    // Textures may be allowed more than there are.
    let sum = FIXED.iter().sum::<u64>() + d.geometry.expect("a bound") + d.textures + rays + d.tables;
    assert!(sum <= memory, "{what}: {sum} of {memory}: {d:?}");
}

#[test]
fn parts_never_exceed_the_whole_and_a_refusal_names_what_does() {
    for (textures, triangles) in [
        (0, 12),
        (50_000_000, 20_000_000),
        (8_000_000_000, 20_000_000),
        (8_000_000_000, 100_000),
        (3_000_000, 500_000),
    ] {
        for schedule in [Schedule::Auto, Schedule::Depth, Schedule::Sorted, Schedule::Voxel] {
            for (backend_named, time) in [(false, None), (true, None), (false, Some(1.0))] {
                let mut before = None;
                for step in 0..120 {
                    let memory = (1e6 * 1.09f64.powi(step)) as u64;
                    let settings =
                        RenderSettings { schedule, backend_named, time_limit_seconds: time, ..with(memory) };
                    let what =
                        format!("{textures} {triangles} {schedule:?} {backend_named} {time:?} {memory}");
                    match divided(&settings, textures, triangles) {
                        Ok(d) => {
                            assert_within(&settings, &d, &what);
                            before = Some(memory);
                        }
                        Err(e @ Error::Usage(_)) => {
                            assert!(before.is_none(), "{what}: less did");
                            let line = e.to_string();
                            let after =
                                line.split("--memory ").nth(1).unwrap_or_else(|| panic!("{what}: {line}"));
                            let n: u64 =
                                after.split(' ').next().and_then(|n| n.parse().ok()).expect("a number");
                            assert!(n > memory, "{what}: {line}");
                            let enough = RenderSettings { memory: Some(n), ..settings.clone() };
                            let d = divided(&enough, textures, triangles)
                                .unwrap_or_else(|e| panic!("{what}: {e}"));
                            assert_within(&enough, &d, &what);
                        }
                        Err(e) => panic!("{what}: {e}"),
                    }
                }
                assert!(before.is_some(), "{textures} {triangles}: nothing was enough");
            }
        }
    }
}

#[test]
fn what_fits_stays_and_nothing_waits() {
    let d = divided(&with(10_000_000_000), 1_000_000_000, 20_000_000).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((d.backend, d.pages), (Backend::Embree, false));
    assert!(d.textures >= 1_000_000_000 && d.because.contains("everything"), "{d:?}");
    // Geometry stays while a sixteenth of the textures has room beside it.
    let d = divided(&with(3_000_000_000), 1_000_000_000, 20_000_000).unwrap_or_else(|e| panic!("{e}"));
    assert!(!d.pages && (250_000_000..1_000_000_000).contains(&d.textures), "{d:?}");
    let d = divided(&with(2_600_000_000), 1_000_000_000, 20_000_000).unwrap_or_else(|e| panic!("{e}"));
    // Native trees are smaller.
    assert_eq!((d.backend, d.pages), (Backend::Native, true), "{d:?}");
}

#[test]
fn with_embree_by_name_geometry_stays_or_it_is_refused() {
    let named = |memory| RenderSettings { backend_named: true, ..with(memory) };
    let Err(e) = divided(&named(500_000_000), 0, 20_000_000) else { panic!("it does not fit") };
    assert_eq!(e.exit_code(), 2);
    assert!(e.to_string().contains("--backend native"), "{e}");
    let d = divided(&with(500_000_000), 0, 20_000_000).unwrap_or_else(|e| panic!("{e}"));
    assert!(d.pages && d.backend == Backend::Native && d.because.contains("Embree"), "{d:?}");
    let given = RenderSettings { geometry_memory: Some(1_000_000), ..named(10_000_000_000) };
    let Err(e) = divided(&given, 0, 20_000_000) else { panic!("less than stays") };
    assert!(e.to_string().contains("--geometry-memory 2400000000 would do"), "{e}");
}

#[test]
fn what_is_given_is_kept_and_the_rest_is_divided() {
    let settings = RenderSettings {
        geometry_memory: Some(300_000_000),
        texture_memory: Some(70_000_000),
        ray_memory: Some(30_000_000),
        ..with(500_000_000)
    };
    let d = divided(&settings, 1_000_000_000, 20_000_000).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((d.geometry, d.textures, d.rays), (Some(300_000_000), 70_000_000, 30_000_000));
    let free = |memory| divided(&with(memory), 1_000_000_000, 20_000_000).unwrap_or_else(|e| panic!("{e}"));
    let d = free(700_000_000);
    // An eighth each to rays and to what textures begin with, beyond the least.
    let (g, t) = (d.geometry.expect("a bound") as f64, d.textures as f64);
    assert!(t / (g + t) > 0.05 && t / (g + t) < 0.125 && d.balanced, "{d:?}");
    // Geometry takes no more than there is while textures lack some.
    let d = divided(
        &RenderSettings { backend_named: true, backend: Backend::Native, ..with(2_000_000_000) },
        8_000_000_000,
        20_000_000,
    );
    let d = d.unwrap_or_else(|e| panic!("{e}"));
    assert!(d.geometry.is_some_and(|g| g < 1_900_000_000), "{d:?}");
    let d = free(700_000_000);
    assert!(d.rays > 50_000_000 && d.rays <= 256 << 20, "{d:?}");
    assert_eq!(free(700_000_000), d, "the same again");
}

#[test]
fn nothing_is_bound_where_nobody_asks() {
    let settings = RenderSettings { memory: None, geometry_memory: None, ..with(1) };
    let d = divided(&settings, 1 << 40, 1 << 33).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((d.geometry, d.pages, d.textures, d.rays), (None, false, 1 << 33, 256 << 20));
}
