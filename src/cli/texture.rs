//! `weir texture`: an image into a tiled, mip-mapped one. Never decides what a texture looks like; the
//! scene does.

use crate::cli::progress::Bar;
use crate::cli::{End, check_not_input, interrupt, print, values};
use clap::{Args, ValueEnum};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;
use weir::error::{Error, Result};
use weir::replace::{check_replaceable, try_replace_file};
use weir::report::{bytes, seconds};
use weir::scene::Encoding;
use weir::texture::convert::fingerprint::{Stamp, encoding_from_name, encoding_name, of_file};
use weir::texture::convert::{Compression, Container, Failure, Settings, Summary, Watch, WrapMode, convert};

const EXAMPLES: &str = "\
Examples:
  weir texture bark.png -o bark.tx       tiles of 64x64, all mip levels, as TIFF
  weir texture sky.hdr -o sky.exr        the same as EXR, in linear halves or floats
  weir texture bump.png -o bump.tx --encoding linear
  weir texture rock.png -o rock.tx --compression none

TIFF keeps what Weir would keep in memory, to the bit: 8-bit numbers at 8 bits, 16-bit ones as linear
halves, floats as halves where all of them fit. EXR takes 8-bit numbers as linear halves. Alpha that is
opaque throughout is left out. Infinite texels become 65504, and those that are not numbers 0.
PNG, TIFF, EXR, HDR and PFM are read a few rows at a time, whatever their size; JPEG, TGA, BMP,
interlaced PNG and unusual varieties of the others are decoded whole, up to 4 GiB.";

/// Options of `weir texture`.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Options {
    /// Image: PNG, JPEG, TGA, BMP, TIFF, HDR, EXR or PFM
    input: PathBuf,
    /// File to write: .tx, .tif (TIFF) or .exr
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// How integers are read: auto, srgb, linear or gamma:G; auto is sRGB for 8 bits, linear for 16
    #[arg(long, value_name = "NAME", default_value = "auto", value_parser = encoding)]
    encoding: EncodingName,
    /// Recorded for programs that ask the file; scenes say it themselves
    #[arg(long, value_name = "MODE", default_value = "periodic")]
    wrap: WrapName,
    /// Of tiles
    #[arg(long, value_name = "KIND", default_value = "zip")]
    compression: CompressionName,
    /// Worker threads; all processors if not given
    #[arg(long, value_name = "N", value_parser = values::threads, allow_negative_numbers = true)]
    threads: Option<usize>,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
}

/// `None`: auto.
#[derive(Clone, Copy)]
struct EncodingName(Option<Encoding>);

fn encoding(text: &str) -> std::result::Result<EncodingName, String> {
    if text == "auto" {
        return Ok(EncodingName(None));
    }
    let found = encoding_from_name(text).map(|encoding| EncodingName(Some(encoding)));
    found.ok_or_else(|| "auto, srgb, linear or gamma:G is needed, as in gamma:2.2".to_owned())
}

#[derive(Clone, Copy, ValueEnum)]
enum WrapName {
    Periodic,
    Black,
    Clamp,
    Mirror,
}

#[derive(Clone, Copy, ValueEnum)]
enum CompressionName {
    None,
    Zip,
}

impl Options {
    fn settings(&self) -> Result<Settings> {
        let extension = self.output.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let container = match extension.as_deref() {
            Some("tx" | "tif" | "tiff") => Container::Tiff,
            Some("exr") => Container::Exr,
            _ => {
                let message = "cannot write a texture of this kind; name it .tx, .tif or .exr";
                return Err(Error::Usage(format!("{}: {message}", self.output.display())));
            }
        };
        Ok(Settings {
            container,
            compression: match self.compression {
                CompressionName::None => Compression::None,
                CompressionName::Zip => Compression::Zip,
            },
            wrap: match self.wrap {
                WrapName::Periodic => WrapMode::Periodic,
                WrapName::Black => WrapMode::Black,
                WrapName::Clamp => WrapMode::Clamp,
                WrapName::Mirror => WrapMode::Mirror,
            },
            encoding: self.encoding.0,
        })
    }
}

/// Runs the command.
pub(crate) fn run(options: &Options) -> Result<End> {
    let start = Instant::now();
    let (input, output) = (&options.input, &options.output);
    let settings = options.settings()?;
    check_not_input(output, input, "input")?;
    let bar = Bar::counting("rows", !options.quiet);
    // The first Ctrl-C ends it: there is nothing to write that is of use.
    interrupt::listen(bar.handle());
    let stamp = Stamp::of(input)?;
    let hash = of_file(input)?;
    stamp.check(input)?;
    check_replaceable(output)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(options.threads.unwrap_or(0))
        .build()
        .map_err(|e| Error::Resource(format!("no threads to work with: {e}")))?;
    let progress = |done, total| bar.update_count(done, total);
    let watch = Watch { progress: &progress, ..Watch::nobody() };
    let written = try_replace_file(output, |out| {
        let summary = pool.install(|| convert(input, &settings, &hash, out, watch))?;
        stamp.check(input)?;
        Ok(summary)
    });
    bar.clear();
    let summary = written.map_err(|failure| match failure {
        Failure::Source(e) => e,
        Failure::Write(e) => Error::io(output, e),
    })?;
    if options.quiet {
        return Ok(End::Done);
    }
    print(&text(output, &summary, &settings, start.elapsed().as_secs_f64()))
}

fn text(output: &Path, summary: &Summary, settings: &Settings, elapsed: f64) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(output, summary, settings, elapsed, &mut out);
    out
}

fn write_text(
    output: &Path,
    summary: &Summary,
    settings: &Settings,
    elapsed: f64,
    out: &mut String,
) -> std::fmt::Result {
    let channels = match summary.channels {
        1 => "grey",
        3 => "RGB",
        _ => "RGB and alpha",
    };
    let numbers = match summary.bits {
        8 => format!("8-bit, {}", encoding_name(summary.encoding)),
        16 => "half float, linear".to_owned(),
        _ => "float, linear".to_owned(),
    };
    let compression = match settings.compression {
        Compression::None => "not compressed",
        Compression::Zip => "zip",
    };
    let (width, height) = summary.size;
    writeln!(out, "wrote       {}", output.display())?;
    writeln!(out, "size        {width} x {height} texels, {} levels", summary.levels)?;
    writeln!(out, "channels    {channels}, {numbers}")?;
    writeln!(out, "file        {} ({} bytes), {compression}", bytes(summary.bytes), summary.bytes)?;
    if summary.replaced > 0 {
        writeln!(out, "replaced    {} non-finite texels", summary.replaced)?;
    }
    writeln!(out, "time        {}", seconds(elapsed))
}
