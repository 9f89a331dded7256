//! `weir plan`: what a scene calls for, what it takes, and how a render would go about it.

use crate::cli::options::SettingsOptions;
use crate::cli::render::note_warnings;
use crate::cli::{End, print};
use clap::Args;
use std::fmt::Write;
use std::path::PathBuf;
use weir::error::{Error, Result};
use weir::prepare::EFFECTS;
use weir::render::plan;
use weir::report::{bytes, count, write_division};
use weir::scene;
use weir::stats::PlanStats;

const EXAMPLES: &str = "\
Examples:
  weir plan scene.pbrt                       effects, who asks for them, bytes, schedule
  weir plan scene.pbrt --memory 2G           how a render in 2 GiB would divide them
  weir plan scene.pbrt --backend native --geometry-memory 512M --json

Only headers of meshes and images are read. A render with the same options has the same plan (`--stats`, `plan`).";

/// Options of `weir plan`.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Options {
    /// Scene: .pbrt, .pbrt.gz, .obj or .ply
    scene: PathBuf,
    #[command(flatten)]
    settings: SettingsOptions,
    /// What stands in for something unsupported is an error
    #[arg(long)]
    strict: bool,
    /// Print the plan as JSON
    #[arg(long)]
    json: bool,
    /// Print no warnings about the scene
    #[arg(short, long)]
    quiet: bool,
}

/// Runs the command.
pub(crate) fn run(options: &Options) -> Result<End> {
    let scene = scene::load(&options.scene)?;
    if let (true, Some(first)) = (options.strict, scene.warnings.first()) {
        return Err(Error::at(&first.at, first.message.clone()));
    }
    if !options.quiet {
        note_warnings(&scene);
    }
    let plan = plan(&scene, &options.settings.settings())?;
    if options.json {
        let json = serde_json::to_string_pretty(&plan).expect("a record of plain data");
        return print(&(json + "\n"));
    }
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&plan, &mut text);
    print(&text)
}

fn write_text(plan: &PlanStats, out: &mut String) -> std::fmt::Result {
    let PlanStats { effects, kernel, calls, schedule, because, backend, bytes: all, memory } = plan;
    writeln!(out, "{:<21} {:<4} because", "effect", "")?;
    for name in EFFECTS {
        let Some(effect) = effects.get(name) else { continue };
        let on = if effect.on { "on" } else { "off" };
        writeln!(out, "{:<21} {on:<4} {}", name.replace('_', " "), effect.because)?;
    }
    writeln!(out, "\nwere everything resident")?;
    let primitives = format!("{} primitives, with {backend} trees", count(all.primitives as f64));
    for (name, size, note) in [
        ("geometry", all.geometry, &*primitives),
        ("textures", all.textures, "all levels, decoded"),
        ("film", all.film, "sums and image"),
        ("lights", all.lights, "sky images, and what chooses among lights"),
        ("description", all.description, "the scene's own tables and meshes"),
        ("building", all.building, "beside the rest, while trees are built"),
        ("pages", all.pages, "what can come and go of geometry, as pages"),
    ] {
        writeln!(out, "  {name:<12} {:>8}  {note}", bytes(size))?;
    }
    writeln!(out, "\na render with these options")?;
    writeln!(out, "  backend      {backend}")?;
    writeln!(out, "  kernel       {kernel}: {calls}")?;
    writeln!(out, "  schedule     {schedule}: {because}")?;
    let mut division = Vec::new();
    if write_division(memory, "  ", &mut division).is_ok() {
        out.push_str(&String::from_utf8_lossy(&division));
    }
    Ok(())
}
