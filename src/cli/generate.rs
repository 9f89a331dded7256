//! `weir generate`: large procedural scenes from a seed.

use crate::cli::{End, interrupt, note, print, values};
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::fmt::Write;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::time::Instant;
use weir::error::{Error, Result};
use weir::report::{bytes, count, seconds};
use weir::study::generate::{Kind, Recipe, TextureFormat, Written, generate};

const EXAMPLES: &str = "\
Examples:
  weir generate terrain -o valley               5 M triangles, 200 MB of textures
  weir generate city --triangles 50M --texture-bytes 20G -o city
  weir generate forest --triangles 2e7 --texture-bytes 2e9 --seed 7 -o wood

NAME is one of
  city     buildings along streets, each with a facade texture of its own
  forest   instances of trees, bushes, grass and stones on uneven ground
  terrain  mountains around a lake, one mesh for up to 1 GB of textures, patches beyond

The directory gets scene.pbrt (last, so that a broken run leaves no scene), meshes/*.ply, textures/* and a
note of the command. It must be new or empty, or hold an earlier scene of this command, which is
replaced. The same seed gives the same bytes on every machine.

Triangles are those stored: instances do not count. Bytes of textures are those of all mip levels at
their stored depth: 3 bytes a texel and a third for the smaller levels; the sky is not counted. Both
are met within 5 %. Memory: some 20 MB a thread, whatever the size.";

/// Options of `weir generate`.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Options {
    /// Which scene
    #[arg(value_name = "NAME")]
    kind: Name,
    /// Triangles to store, as 5M or 1e9
    #[arg(long, value_name = "N", default_value = "5M", value_parser = values::amount, allow_hyphen_values = true)]
    triangles: u64,
    /// Decoded bytes of all textures with mip levels, as 500M or 2e10
    #[arg(long, value_name = "N", default_value = "200M", value_parser = values::amount, allow_hyphen_values = true)]
    texture_bytes: u64,
    /// Directory to write
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Seed: another one, another scene of the kind
    #[arg(long, value_name = "N", default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    /// Size of the film in pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = values::size, allow_hyphen_values = true)]
    size: (u32, u32),
    /// How textures are stored
    #[arg(long, value_name = "FORMAT", default_value = "tx")]
    texture_format: Format,
    /// Worker threads; all processors if not given
    #[arg(long, value_name = "N", value_parser = values::threads, allow_negative_numbers = true)]
    threads: Option<usize>,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Name {
    City,
    Forest,
    Terrain,
}

#[derive(Clone, Copy, ValueEnum)]
enum Format {
    Tx,
    Png,
}

/// Runs the command.
pub(crate) fn run(options: &Options) -> Result<End> {
    let recipe = Recipe {
        kind: match options.kind {
            Name::City => Kind::City,
            Name::Forest => Kind::Forest,
            Name::Terrain => Kind::Terrain,
        },
        triangles: options.triangles,
        texture_bytes: options.texture_bytes,
        seed: options.seed,
        size: options.size,
        format: match options.texture_format {
            Format::Tx => TextureFormat::Tx,
            Format::Png => TextureFormat::Png,
        },
        directory: options.output.clone(),
    };
    let bar = bar(!options.quiet);
    interrupt::listen(bar.clone());
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(options.threads.unwrap_or(0))
        .build()
        .map_err(|e| Error::Resource(format!("threads cannot be started: {e}")))?;
    let start = Instant::now();
    let progress = |done: u64, total: u64| {
        bar.set_length(total);
        if done > bar.position() {
            bar.set_position(done);
        }
    };
    let written = pool.install(|| generate(&recipe, &progress));
    bar.finish_and_clear();
    let written = written?;
    if options.quiet {
        return Ok(End::Done);
    }
    if written.scene.metadata().is_err() {
        note("warning: the scene file has gone");
    }
    print(&text(&written, start.elapsed().as_secs_f64()))
}

fn bar(shown: bool) -> ProgressBar {
    let shown = shown && std::io::stderr().is_terminal();
    let target = if shown { ProgressDrawTarget::stderr_with_hz(4) } else { ProgressDrawTarget::hidden() };
    let bar = ProgressBar::with_draw_target(None, target);
    let style =
        ProgressStyle::with_template("[{bar:24}] {percent:>3} %  {decimal_bytes_per_sec}  {eta} left")
            .expect("our own template is well formed")
            .progress_chars("= ");
    bar.set_style(style);
    bar
}

fn text(w: &Written, elapsed: f64) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = writeln!(text, "wrote {}", w.scene.display());
    let _ = write!(text, "  {} triangles in {} meshes", grouped(w.triangles), w.meshes);
    if w.instanced_triangles != w.triangles {
        let _ = write!(text, ", {} with instances", count(w.instanced_triangles as f64));
    }
    let _ = writeln!(
        text,
        "\n  {} bytes of textures, decoded, in {} images (the sky is one more kind of light, not counted in bytes)",
        grouped(w.texture_bytes),
        w.textures
    );
    let rate = if elapsed > 0.0 { w.disk_bytes as f64 / elapsed } else { 0.0 };
    let _ =
        writeln!(text, "  {} on disk in {}, {}/s", bytes(w.disk_bytes), seconds(elapsed), bytes(rate as u64));
    text
}

/// `12,345,678`.
fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(c);
    }
    text
}
