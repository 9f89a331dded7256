//! Scenes from text, rendered through the library's front door, and what tests ask of the images.
//!
//! Invariant: one thread a render, because tests run side by side and threads change nothing.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use weir::error::Result;
use weir::film::Image;
use weir::render::{self, Control, Outcome, Progress};
use weir::scene::SceneDescription;
use weir::scene::pbrt::parse_str;
use weir::settings::RenderSettings;

/// An image of a test's scene: width, height, samples a pixel, pbrt's `maxdepth`.
#[derive(Clone, Copy)]
pub(crate) struct Frame {
    pub(crate) size: (u32, u32),
    pub(crate) spp: u32,
    pub(crate) max_depth: u32,
}

/// Everything up to `WorldBegin`: `camera` has its transform and its own directive; a box filter,
/// so that a pixel is the mean over its square.
pub(crate) fn head(camera: &str, frame: Frame) -> String {
    let Frame { size: (w, h), spp, max_depth } = frame;
    format!(
        "{camera}\nFilm \"rgb\" \"integer xresolution\" {w} \"integer yresolution\" {h}\n\
         Sampler \"zsobol\" \"integer pixelsamples\" {spp}\nPixelFilter \"box\"\n\
         Integrator \"path\" \"integer maxdepth\" {max_depth}\nWorldBegin\n"
    )
}

/// Looks along +z from `z` with x to the right and y up: the window [−half, half]², undistorted.
pub(crate) fn orthographic(z: f64, half: f64) -> String {
    format!(
        "LookAt 0 0 {z}  0 0 {}  0 1 0\nCamera \"orthographic\" \"float screenwindow\" [ {} {half} {} {half} ]",
        z + 1.0,
        -half,
        -half
    )
}

/// Centre of a pixel's square in the window of [`orthographic`], moved by `dx`, `dy` pixels.
pub(crate) fn window_point(i: usize, n: u32, half: f64, (dx, dy): (f64, f64)) -> (f64, f64) {
    let n64 = f64::from(n);
    let (x, y) = (i as u32 % n, i as u32 / n);
    let at = |k: u32, d: f64| half * (2.0 * (f64::from(k) + 0.5 + d) / n64 - 1.0);
    (at(x, dx), -at(y, dy))
}

/// Mean of `f(x, y)` over each pixel's square (8 by 8 midpoints).
pub(crate) fn over_pixels(n: u32, half: f64, f: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    const SIDE: usize = 8;
    let offset = |k: usize| (k as f64 + 0.5) / SIDE as f64 - 0.5;
    (0..(n * n) as usize)
        .map(|i| {
            let cells = (0..SIDE * SIDE).map(|k| {
                let (x, y) = window_point(i, n, half, (offset(k % SIDE), offset(k / SIDE)));
                f(x, y)
            });
            cells.sum::<f64>() / (SIDE * SIDE) as f64
        })
        .collect()
}

pub(crate) fn scene(text: &str) -> SceneDescription {
    scene_beside(text, Path::new("."))
}

/// A scene whose files stand in `folder`.
pub(crate) fn scene_beside(text: &str, folder: &Path) -> SceneDescription {
    let scene = parse_str(text, &folder.join("test.pbrt")).unwrap_or_else(|e| panic!("{e}"));
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    scene
}

/// Renders; one thread unless `settings` say otherwise.
pub(crate) fn outcome(scene: &SceneDescription, settings: &RenderSettings) -> Result<Outcome> {
    let settings = RenderSettings { threads: settings.threads.or(Some(1)), ..settings.clone() };
    let control = Control { cancel: &AtomicBool::new(false), progress: &|_: Progress| {}, watch: None };
    render::render(scene, &settings, &control)
}

pub(crate) fn image(scene: &SceneDescription, settings: &RenderSettings) -> Image {
    let outcome = outcome(scene, settings).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(outcome.stats.image.non_finite_samples, 0);
    outcome.image
}

/// Renders the text of a scene as it stands.
pub(crate) fn picture(text: &str) -> Image {
    image(&scene(text), &RenderSettings::default())
}

/// Mean of the three channels of every pixel.
pub(crate) fn grey(image: &Image) -> Vec<f64> {
    image.pixels.iter().map(|p| p.iter().map(|&c| f64::from(c)).sum::<f64>() / 3.0).collect()
}

pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Every channel of every pixel is `expected` up to `tolerance`, a bound on rounding.
#[track_caller]
pub(crate) fn assert_flat(image: &Image, expected: f32, tolerance: f32, what: &str) {
    for (i, p) in image.pixels.iter().enumerate() {
        let far = p.iter().map(|c| (c - expected).abs()).fold(0.0, f32::max);
        assert!(far <= tolerance, "{what}: pixel {i} is {p:?}, not {expected} within {tolerance}");
    }
}

/// A cube of six squares, as the parameters of a `catmullclark`.
pub(crate) const CUBE: &str = "\"point3 P\" [ -1 -1 -1 1 -1 -1 -1 1 -1 1 1 -1 -1 -1 1 1 -1 1 -1 1 1 1 1 1 ] \
     \"integer indices\" [ 0 2 3 1 4 5 7 6 0 1 5 4 2 6 7 3 0 4 6 2 1 3 7 5 ]";

/// A sphere of triangles: the vertices of an icosahedron, each triangle split in four `levels`
/// times, all on the unit sphere, facing out. As the parameters of a `trianglemesh`.
pub(crate) fn icosphere(levels: u32) -> String {
    let (a, b) = (1.0f64, 0.5 * (1.0 + 5.0f64.sqrt()));
    let mut points: Vec<[f64; 3]> = Vec::new();
    for (s, t) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        points.extend([[0.0, s * a, t * b], [s * a, t * b, 0.0], [t * b, 0.0, s * a]]);
    }
    for p in &mut points {
        *p = unit(*p);
    }
    let edge = 2.0 * a / a.hypot(b);
    let mut triangles = Vec::new();
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                let near = |x: usize, y: usize| (length(sub(points[x], points[y])) - edge).abs() < 1e-6;
                if near(i, j) && near(j, k) && near(i, k) {
                    let out =
                        dot(cross(sub(points[j], points[i]), sub(points[k], points[i])), points[i]) > 0.0;
                    triangles.push(if out { [i, j, k] } else { [i, k, j] });
                }
            }
        }
    }
    assert_eq!(triangles.len(), 20);
    for _ in 0..levels {
        let mut middles = std::collections::BTreeMap::new();
        let mut middle = |x: usize, y: usize| {
            *middles.entry((x.min(y), x.max(y))).or_insert_with(|| {
                let sum = [0, 1, 2].map(|c| points[x][c] + points[y][c]);
                points.push(unit(sum));
                points.len() - 1
            })
        };
        triangles = triangles
            .iter()
            .flat_map(|&[i, j, k]| {
                let (ij, jk, ki) = (middle(i, j), middle(j, k), middle(k, i));
                [[i, ij, ki], [ij, j, jk], [ki, jk, k], [ij, jk, ki]]
            })
            .collect();
    }
    format!(
        "\"point3 P\" [ {} ] \"integer indices\" [ {} ]",
        list(points.iter().flatten()),
        list(triangles.iter().flatten())
    )
}

/// Numbers with blanks between.
pub(crate) fn list<T: ToString>(values: impl IntoIterator<Item = T>) -> String {
    values.into_iter().map(|v| v.to_string()).collect::<Vec<_>>().join(" ")
}

pub(crate) fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] - b[i])
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| a[i] * b[i]).sum()
}

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(crate) fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

pub(crate) fn unit(a: [f64; 3]) -> [f64; 3] {
    a.map(|c| c / length(a))
}

/// `../shared/scenes` or that below `$WEIR_SHARED`; a note and `None` where it is absent.
pub(crate) fn shared(folder: &str) -> Option<PathBuf> {
    let mut bases: Vec<PathBuf> = std::env::var_os("WEIR_SHARED").map(PathBuf::from).into_iter().collect();
    let house = Path::new(env!("CARGO_MANIFEST_DIR"));
    // Beside the house; a second working tree may stand one folder deeper.
    bases.extend([house.join("../shared"), house.join("../../shared")]);
    let found = bases.iter().map(|b| b.join("scenes").join(folder)).find(|p| p.is_dir());
    if found.is_none() {
        eprintln!("left out: no scenes/{folder} in any of {bases:?}");
    }
    found
}

/// What rendering `scene` comes to, which is sound.
pub(crate) fn render(scene: &SceneDescription, settings: &RenderSettings) -> Outcome {
    outcome(scene, settings).unwrap_or_else(|e| panic!("{e}"))
}

/// Of every channel of every pixel.
pub(crate) fn bits(image: &Image) -> Vec<[u32; 3]> {
    image.pixels.iter().map(|p| p.map(f32::to_bits)).collect()
}

/// The pbrt scenes of `../shared` that are there, by name.
pub(crate) fn shared_scenes() -> Vec<(&'static str, PathBuf)> {
    let names = [
        "classroom",
        "cornell-box",
        "living-room",
        "material-testball",
        "staircase2",
        "veach-ajar",
        "veach-mis",
    ];
    let scene = |name| Some((name, shared(&format!("pbrt-{name}"))?.join("scene-v4.pbrt")));
    names.into_iter().filter_map(scene).collect()
}

/// What lies in the directory `at`, in order.
pub(crate) fn names(at: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(at).expect("readable").map(|entry| entry.expect("readable").file_name());
    let mut names: Vec<String> = entries.map(|name| name.to_string_lossy().into_owned()).collect();
    names.sort();
    names
}
