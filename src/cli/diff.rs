//! `weir diff`: how far one image is from another.

use crate::cli::{End, print, values};
use clap::Args;
use std::fmt::Write;
use std::path::PathBuf;
use weir::error::Result;
use weir::film::read::read_image;
use weir::study::diff::{Diff, PerChannel, diff};

const EXAMPLES: &str = "\
Examples:
  weir diff new.exr reference.exr
  weir diff new.exr reference.exr --json
  weir diff new.exr reference.exr --fail-above 0.01 || echo 'too far off'

relMSE is the mean over pixels of the mean over channels of (A-B)^2 / (B^2 + 0.01), in linear light.
FLIP compares both images clipped to [0, 1] as 8-bit sRGB. Images agree when the ratio of their mean
luminances (clipped at 50) is within 2 % and 95 % of the 16x16 blocks agree: a block's means differ by at
most 5 % of B, plus three standard errors of the difference within the block, plus 0.002.

Exit codes: 0 compared; 1 relMSE is past --fail-above, or pixels of A are infinite or not a number;
2 the images cannot be read or are not of one size.";

/// Options of `weir diff`.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Options {
    /// Image to judge: EXR, PNG, PFM, HDR, JPEG, TGA, BMP or TIFF
    a: PathBuf,
    /// Reference, of the same size
    b: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Exit with 1 when relMSE is above this
    #[arg(long, value_name = "X", value_parser = values::limit, allow_negative_numbers = true)]
    fail_above: Option<f64>,
}

/// Runs the command.
pub(crate) fn run(options: &Options) -> Result<End> {
    let (a, b) = (read_image(&options.a)?, read_image(&options.b)?);
    let result = diff(&a, &b)?;
    if options.json {
        let mut json = serde_json::to_string_pretty(&result).expect("a record of plain data");
        json.push('\n');
        print(&json)?;
    } else {
        print(&text(&result))?;
    }
    Ok(if options.fail_above.is_some_and(|limit| result.exceeds(limit)) { End::Negative } else { End::Done })
}

fn text(result: &Diff) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(result, &mut text);
    text
}

fn write_text(result: &Diff, out: &mut String) -> std::fmt::Result {
    let columns = |p: &PerChannel| [p.r, p.g, p.b, p.luminance];
    let [a, b, ratio] = [&result.mean_a, &result.mean_b, &result.mean_ratio].map(columns);
    writeln!(out, "mean                  A            B        A/B")?;
    for (i, name) in ["red", "green", "blue", "luminance"].iter().enumerate() {
        writeln!(out, "  {name:<10} {:>11.6}  {:>11.6}   {:>8.5}", a[i], b[i], ratio[i])?;
    }
    writeln!(
        out,
        "relMSE       {:.6e}  (epsilon {}, B the reference)",
        result.relmse, result.relmse_epsilon
    )?;
    writeln!(
        out,
        "  trimmed    {:.6e}  (without the {} pixels of largest error)",
        result.relmse_trimmed, result.trimmed_pixels
    )?;
    match result.flip {
        Some(flip) => writeln!(
            out,
            "FLIP         {:.6}  (mean; clipped to [0, 1], sRGB, {:.2} pixels per degree)",
            flip.mean, flip.pixels_per_degree
        )?,
        None => writeln!(out, "FLIP         not computed: the image is too large for it")?,
    }
    let agreement = &result.agreement;
    writeln!(
        out,
        "agreement    {}: {} of {} blocks ({:.2} %), luminance ratio {:.5}",
        if agreement.agree { "yes" } else { "no" },
        agreement.agreeing,
        agreement.blocks,
        agreement.share * 100.0,
        agreement.luminance_ratio
    )?;
    if result.non_finite_a + result.non_finite_b > 0 {
        writeln!(
            out,
            "not finite   {} pixels of A, {} of B: left out above",
            result.non_finite_a, result.non_finite_b
        )?;
    }
    if result.identical {
        writeln!(out, "identical, bit for bit")?;
    }
    Ok(())
}
