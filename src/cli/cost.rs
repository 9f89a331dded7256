//! `weir cost`: what accuracy costs in time, for every knob that trades one for the other.

use crate::cli::progress::Bar;
use crate::cli::render::note_warnings;
use crate::cli::{End, check_apart, check_not_input, interrupt, print, values};
use clap::Args;
use std::path::PathBuf;
use weir::error::Result;
use weir::film::replace::{check_replaceable, replace_with_bytes};
use weir::render::Control;
use weir::report::cost::{cost_page, write_cost};
use weir::scene;
use weir::settings::{Backend, RenderSettings};
use weir::study::cost::{self, Found};

const EXAMPLES: &str = "\
Examples:
  weir cost scene.pbrt
  weir cost scene.pbrt --budget 5m --report cost.html --json cost.json
  weir cost scene.pbrt --target 0.02 --size 640x360
  weir cost scene.pbrt --reference truth.exr

Errors are root mean square relative errors against the reference, which is rendered unless it
is given: the root of the trimmed relMSE that weir diff prints, less what the reference's own
noise adds. Every setting is rendered some times with few samples, which tells noise from bias:
noise goes with more samples, bias stays. Where there are more pixels than the budget is good
for, fewer are rendered; seconds are told for all of them. The scene's crop window is left
aside. Times are processor seconds of rendering over threads, without loading.

Exit codes: 0 done; 2 bad usage or bad input; 3 out of a resource; 130 interrupted.";

/// Options of `weir cost`.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Options {
    /// Scene: .pbrt, .pbrt.gz, .obj or .ply
    scene: PathBuf,
    /// Time to spend in all: 60s, 5m, 1h
    #[arg(long, value_name = "TIME", default_value = "120s", value_parser = values::seconds, allow_hyphen_values = true)]
    budget: f64,
    /// The error that is wanted, as a share: 0.05 is five per cent
    #[arg(long, value_name = "X", default_value = "0.05", value_parser = values::share, allow_negative_numbers = true)]
    target: f64,
    /// Image to hold errors against, of the film's size
    #[arg(long, value_name = "REF.exr")]
    reference: Option<PathBuf>,
    /// Write everything as JSON
    #[arg(long, value_name = "FILE.json")]
    json: Option<PathBuf>,
    /// Write one self-contained page of charts and crops
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Size of the film in pixels, for which seconds are told
    #[arg(long, value_name = "WxH", value_parser = values::size, allow_hyphen_values = true)]
    size: Option<(u32, u32)>,
    /// Scattering events of a path, in place of what the scene says
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    max_depth: Option<u32>,
    /// Traversal that the scene's own settings have
    #[arg(long, value_name = "NAME", value_parser = values::named(&Backend::ALL, Backend::name))]
    backend: Option<Backend>,
    /// Seed of the first render
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Worker threads; all processors if not given
    #[arg(long, value_name = "N", value_parser = values::threads, allow_negative_numbers = true)]
    threads: Option<usize>,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

/// Runs the command.
pub(crate) fn run(options: &Options) -> Result<End> {
    let outputs = || options.json.iter().chain(&options.report);
    outputs().try_for_each(|path| check_not_input(path, &options.scene, "scene"))?;
    if let Some(reference) = &options.reference {
        outputs().try_for_each(|path| check_not_input(path, reference, "reference"))?;
    }
    if let (Some(json), Some(report)) = (&options.json, &options.report) {
        check_apart(json, report)?;
    }
    outputs().try_for_each(|path| check_replaceable(path))?;
    let bar = Bar::new(!options.quiet, None);
    interrupt::listen(bar.handle());
    let scene = scene::load(&options.scene)?;
    if !options.quiet {
        note_warnings(&scene);
    }
    let control =
        Control { cancel: &interrupt::CANCEL, progress: &|progress| bar.update(progress), watch: None };
    let settings = RenderSettings {
        size: options.size,
        max_depth: options.max_depth,
        backend: options.backend.unwrap_or_default(),
        backend_named: options.backend.is_some(),
        seed: options.seed,
        threads: options.threads,
        ..RenderSettings::default()
    };
    let what = cost::Options {
        settings,
        budget_s: options.budget,
        target: options.target,
        reference: options.reference.clone(),
        patience: cost::PATIENCE,
    };
    let found = cost::study(&scene, &what, &control);
    bar.clear();
    let Found { study, reference, pictures } = found?;
    if let Some(path) = &options.json {
        let mut json = serde_json::to_string_pretty(&study).expect("a record of plain data");
        json.push('\n');
        replace_with_bytes(path, json.as_bytes())?;
    }
    if let Some(path) = &options.report {
        replace_with_bytes(path, cost_page(&study, &reference, &pictures).as_bytes())?;
    }
    if options.quiet { Ok(End::Done) } else { print(&write_cost(&study)) }
}
