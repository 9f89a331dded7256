//! `weir render`: loads, renders, writes images and statistics, and says so.

use crate::cli::options::SettingsOptions;
use crate::cli::progress::Bar;
use crate::cli::{End, check_apart, check_not_input, interrupt, note, print, values};
use clap::Args;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;
use weir::error::{Error, Result};
use weir::film::replace::{check_replaceable, replace_with_bytes};
use weir::film::write::{Format, check_writable, write_image};
use weir::render::{Control, Outcome, render};
use weir::report::{attributes, bytes, count, html_page, seconds};
use weir::scene::{self, SceneDescription};
use weir::settings::{Checkpointing, RenderSettings};
use weir::stats::{MemoryWatch, RenderStats};

const EXAMPLES: &str = "\
Examples:
  weir scene.pbrt                        the scene's own size, samples and file name
  weir scene.pbrt -o out.exr -o out.png  both from one render
  weir scene.pbrt --spp 16 --size 640x360
  weir scene.pbrt --time 60s             as many samples as fit in a minute, up to --spp
  weir scene.pbrt --crop 100,50,300,200  a window of the image; EXR keeps its place
  weir model.obj -o model.png            a model: camera and sky are made up for it

Ctrl-C stops the render and writes what is done (exit code 0); a second one quits at once (130).";

/// Options of `weir render`.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Options {
    /// Scene: .pbrt, .pbrt.gz, .obj or .ply
    scene: PathBuf,
    /// Image to write: .exr (linear float), .png (sRGB) or .pfm; may be repeated
    #[arg(short, long = "output", value_name = "FILE")]
    output: Vec<PathBuf>,
    #[command(flatten)]
    settings: SettingsOptions,
    /// Go on from the checkpoint beside the first image (NAME.weir), and keep one there: what was stopped, or has too few
    /// samples, ends as it would in one go
    #[arg(long)]
    resume: bool,
    /// With --resume: time from one checkpoint to the next
    #[arg(long, value_name = "TIME", default_value = "60s", requires = "resume", value_parser = values::seconds, allow_hyphen_values = true)]
    checkpoint_every: f64,
    /// What stands in for something unsupported is an error
    #[arg(long)]
    strict: bool,
    /// Write what the render cost, as JSON
    #[arg(long, value_name = "FILE.json")]
    stats: Option<PathBuf>,
    /// Write what the render cost as a page of charts, with the image
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

impl Options {
    /// Files that say what the render cost.
    fn records(&self) -> impl Iterator<Item = &Path> {
        self.stats.iter().chain(&self.report).map(PathBuf::as_path)
    }

    /// Neither of them takes the place of `image`.
    fn check_apart_from(&self, image: &Path) -> Result<()> {
        self.records().try_for_each(|record| check_apart(image, record))
    }

    /// As the library takes them; `image` is the first that is written.
    pub(super) fn settings(&self, image: &Path) -> RenderSettings {
        let (outputs, strict) = (self.output.clone(), self.strict);
        let checkpoint = self
            .resume
            .then(|| Checkpointing { path: checkpoint(image), every_seconds: self.checkpoint_every });
        RenderSettings { outputs, strict, checkpoint, ..self.settings.settings() }
    }

    /// Whether a checkpoint beside `image` can be written, and takes no other file's place.
    fn check_checkpoint(&self, image: &Path) -> Result<()> {
        if !self.resume {
            return Ok(());
        }
        let path = checkpoint(image);
        check_not_input(&path, &self.scene, "scene")?;
        self.check_apart_from(&path)?;
        check_replaceable(&path)
    }
}

/// Where a render of `image` is kept while it is half done.
fn checkpoint(image: &Path) -> PathBuf {
    let mut name = image.as_os_str().to_owned();
    name.push(".weir");
    PathBuf::from(name)
}

/// Runs the command.
pub(crate) fn run(options: &Options) -> Result<End> {
    let start = Instant::now();
    // Before the first file is made: trying whether a name can be written makes one.
    let bar = Bar::new(!options.quiet, options.settings.time());
    interrupt::listen(bar.handle());
    // Before the work, so that none is lost to a name that cannot be written.
    let mut named = options.output.iter().map(PathBuf::as_path).chain(options.records());
    named.try_for_each(|path| check_not_input(path, &options.scene, "scene"))?;
    options.output.iter().try_for_each(|image| options.check_apart_from(image))?;
    if let (Some(stats), Some(report)) = (&options.stats, &options.report) {
        check_apart(stats, report)?;
    }
    options.output.iter().try_for_each(|path| check_writable(path))?;
    options.records().try_for_each(check_replaceable)?;
    options.output.first().map_or(Ok(()), |image| options.check_checkpoint(image))?;
    let watch = options.records().next().map(|_| MemoryWatch::new(start));
    let result = load_and_render(options, &bar, watch.as_ref());
    bar.clear();
    let (parse_s, scene, mut outcome) = match result {
        Err(Error::Interrupted) => return nothing_to_write(),
        result => result?,
    };
    let stats = &mut outcome.stats;
    stats.time.parse_s = parse_s;
    // The library counts from where the scene is there.
    stats.time.first_pixel_s += parse_s;
    stats.time.total_s = start.elapsed().as_secs_f64();
    if outcome.stats.image.samples + outcome.stats.image.resumed_samples == 0 {
        return nothing_to_write();
    }

    let outputs = outputs(options, &scene);
    let write_start = Instant::now();
    let attributes = attributes(&outcome.stats);
    outputs.iter().try_for_each(|path| write_image(path, &outcome.image, &attributes))?;
    let stats = &mut outcome.stats;
    stats.time.write_s = write_start.elapsed().as_secs_f64();
    stats.time.total_s = start.elapsed().as_secs_f64();
    stats.memory.timeline = watch.map(MemoryWatch::finish).unwrap_or_default();
    stats.note_peak_memory();
    stats.command = std::env::args_os().map(|argument| argument.to_string_lossy().into_owned()).collect();
    if let Some(path) = &options.stats {
        let mut json = serde_json::to_string_pretty(stats).expect("a record of plain data");
        json.push('\n');
        replace_with_bytes(path, json.as_bytes())?;
    }
    if let Some(path) = &options.report {
        replace_with_bytes(path, html_page(stats, Some(&outcome.image)).as_bytes())?;
    }
    if !options.quiet {
        outcome.notes.iter().for_each(|line| note(&format!("warning: {line}")));
        note_what_is_odd(&outcome);
        print(&summary(&outcome.stats, &outputs, options.records()))?;
    }
    // Last, where nobody overlooks it: the image is there, but not as the scene wants it.
    outcome.unreadable.iter().chain(&outcome.unsaved).for_each(|line| note(line));
    Ok(if outcome.unreadable.is_empty() { End::Done } else { End::BadInput })
}

fn load_and_render(
    options: &Options,
    bar: &Bar,
    watch: Option<&MemoryWatch>,
) -> Result<(f64, SceneDescription, Outcome)> {
    let start = Instant::now();
    bar.update(weir::render::Progress::Phase("reading the scene"));
    let scene = scene::load(&options.scene)?;
    let parse_s = start.elapsed().as_secs_f64();
    if let (true, Some(first)) = (options.strict, scene.warnings.first()) {
        return Err(Error::at(&first.at, first.message.clone()));
    }
    if !options.quiet {
        bar.handle().suspend(|| note_warnings(&scene));
    }
    if options.output.is_empty() {
        let output = default_output(&scene);
        check_not_input(&output, &options.scene, "scene")?;
        options.check_apart_from(&output)?;
        check_writable(&output)?;
        options.check_checkpoint(&output)?;
    }
    interrupt::rendering();
    let settings = options.settings(&outputs(options, &scene)[0]);
    let control = Control { cancel: &interrupt::CANCEL, progress: &|progress| bar.update(progress), watch };
    let outcome = render(&scene, &settings, &control)?;
    interrupt::writing();
    Ok((parse_s, scene, outcome))
}

/// One line each.
pub(super) fn note_warnings(scene: &SceneDescription) {
    for warning in &scene.warnings {
        note(&format!("{}: warning: {}", warning.at, warning.message).replace(['\n', '\r'], " "));
    }
}

/// A black image would replace what may be a good one.
fn nothing_to_write() -> Result<End> {
    if interrupt::CANCEL.load(Ordering::Relaxed) {
        note("interrupted before the first sample: nothing is written");
        return Ok(End::Interrupted);
    }
    Err(Error::Usage("--time was over before the first sample: nothing is written; give it more".to_owned()))
}

fn note_what_is_odd(outcome: &Outcome) {
    let stats = &outcome.stats;
    let pixels = u64::from(stats.image.width) * u64::from(stats.image.height);
    let samples = stats.image.samples + stats.image.resumed_samples;
    let per_pixel = samples as f64 / pixels.max(1) as f64;
    let asked = stats.settings.spp;
    if outcome.interrupted && interrupt::CANCEL.load(Ordering::Relaxed) {
        note(&format!("interrupted: the image has {per_pixel:.1} of {asked} samples per pixel"));
    } else if outcome.interrupted {
        note(&format!("stopped by --time: the image has {per_pixel:.1} of {asked} samples per pixel"));
    }
    let unreached = stats.image.pixels_without_samples;
    if unreached > 0 {
        let share = unreached as f64 / pixels.max(1) as f64 * 100.0;
        note(&format!("warning: {unreached} pixels ({share:.0} %) were not reached and are black"));
    }
    let (samples, pixels) = (stats.image.non_finite_samples, outcome.image.non_finite_pixels());
    if samples > 0 || pixels > 0 {
        note(&format!("warning: {samples} samples and {pixels} pixels are infinite or not a number"));
    }
}

fn outputs(options: &Options, scene: &SceneDescription) -> Vec<PathBuf> {
    if options.output.is_empty() { vec![default_output(scene)] } else { options.output.clone() }
}

/// The scene's own name for its image, in the current directory whatever directory the scene wants:
/// a file from elsewhere does not say where to write. `.exr` where the kind cannot be written.
fn default_output(scene: &SceneDescription) -> PathBuf {
    let name = scene.film.filename.as_deref().and_then(Path::file_name).map(PathBuf::from);
    match name {
        Some(name) if Format::of(&name).is_ok() => name,
        Some(name) => name.with_extension("exr"),
        None => {
            let stem = |path: &Path| PathBuf::from(path.file_stem().unwrap_or("weir".as_ref()));
            let is_gzip = scene.path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"));
            let name = if is_gzip { stem(&stem(&scene.path)) } else { stem(&scene.path) };
            // Not `with_extension`: the stem of `a.b.pbrt` is `a.b`.
            let mut name = name.into_os_string();
            name.push(".exr");
            PathBuf::from(name)
        }
    }
}

fn summary<'a>(stats: &RenderStats, outputs: &[PathBuf], records: impl Iterator<Item = &'a Path>) -> String {
    let mut text = String::new();
    let image = &stats.image;
    let samples = match (stats.settings.noise, image.spp_min, image.spp_max) {
        (Some(_), Some(least), Some(most)) if least < most => format!("{least} to {most}"),
        _ => image.spp.to_string(),
    };
    for path in outputs {
        let _ = writeln!(
            text,
            "wrote {}: {}x{}, {samples} sample{} per pixel",
            path.display(),
            image.width,
            image.height,
            if samples == "1" { "" } else { "s" }
        );
    }
    for path in records {
        let _ = writeln!(text, "wrote {}", path.display());
    }
    let _ = writeln!(
        text,
        "{} in all, {} rendering, {} samples/s, {} peak memory",
        seconds(stats.time.total_s),
        seconds(stats.time.render_s),
        count(stats.samples_per_second()),
        stats.memory.peak_rss.map_or("unknown".to_owned(), bytes)
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_output_is_in_the_current_directory() {
        let name = |path: &str, filename: Option<&str>| {
            let mut scene = SceneDescription { path: path.into(), ..SceneDescription::default() };
            scene.film.filename = filename.map(PathBuf::from);
            default_output(&scene).to_string_lossy().into_owned()
        };
        assert_eq!(name("scenes/a.pbrt", None), "a.exr");
        assert_eq!(name("scenes/a.b.pbrt.gz", None), "a.b.exr");
        assert_eq!(name("model.v2.obj", None), "model.v2.exr");
        assert_eq!(name("a.pbrt", Some("out.png")), "out.png");
        assert_eq!(name("a.pbrt", Some("/etc/../deep/out.exr")), "out.exr");
        assert_eq!(name("a.pbrt", Some("out.tga")), "out.exr");
        assert_eq!(name("a.pbrt", Some("..")), "a.exr");
    }

    #[test]
    fn the_summary_has_a_line_a_file_and_one_more() {
        let mut stats = RenderStats::default();
        stats.image.samples = 1_000_000;
        stats.time.render_s = 0.5;
        stats.time.total_s = 1.25;
        stats.memory.peak_rss = Some(21_000_000);
        let text = summary(&stats, &["a.exr".into(), "b.png".into()], [Path::new("s.json")].into_iter());
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 4);
        assert!(lines[0].starts_with("wrote a.exr") && lines[2] == "wrote s.json");
        assert_eq!(lines[3], "1.25 s in all, 0.500 s rendering, 2.00 M samples/s, 21.0 MB peak memory");
    }
}
