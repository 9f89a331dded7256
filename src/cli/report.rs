//! `weir report`: the statistics of a render as text, or as a page.

use crate::cli::{End, check_not_input, print};
use clap::Args;
use std::path::{Path, PathBuf};
use weir::error::{Error, Location, Result};
use weir::replace::{check_replaceable, replace_with_bytes};
use weir::report::{html_page, write_text};
use weir::stats::RenderStats;

/// Larger than any record of ours; bounds memory.
const MAX_BYTES: u64 = 64 << 20;

/// Options of `weir report`.
#[derive(Args)]
#[command(after_help = "Example:\n  weir scene.pbrt --stats stats.json && weir report stats.json")]
pub(crate) struct Options {
    /// File that `weir render --stats` wrote
    stats: PathBuf,
    /// Write them as a page of charts instead; the image is not in the statistics, and not in the page
    #[arg(short, long = "output", value_name = "FILE.html")]
    output: Option<PathBuf>,
}

/// Runs the command.
pub(crate) fn run(options: &Options) -> Result<End> {
    if let Some(path) = &options.output {
        check_not_input(path, &options.stats, "record")?;
        check_replaceable(path)?;
    }
    let stats = read(&options.stats)?;
    if let Some(path) = &options.output {
        replace_with_bytes(path, html_page(&stats, None).as_bytes())?;
        return print(&format!("wrote {}\n", path.display()));
    }
    let mut text = Vec::new();
    write_text(&stats, &mut text).expect("memory takes every write");
    print(&String::from_utf8_lossy(&text))
}

fn read(path: &Path) -> Result<RenderStats> {
    let wanted = "a file that weir render --stats wrote is needed";
    let meta = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
    if !meta.is_file() || meta.len() > MAX_BYTES {
        return Err(Error::file(path, format!("not a record of a render; {wanted}")));
    }
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    let record: RenderStats = serde_json::from_slice(&bytes).map_err(|e| {
        let at = Location {
            file: path.into(),
            line: u32::try_from(e.line()).unwrap_or(u32::MAX),
            column: u32::try_from(e.column()).unwrap_or(u32::MAX),
        };
        // serde puts the place at the end of its message, and it already stands at the front.
        let message = e.to_string();
        let message = message.split(" at line ").next().unwrap_or_default();
        Error::at(&at, format!("{message}; {wanted}"))
    })?;
    if record.weir.is_empty() {
        return Err(Error::file(path, format!("no \"weir\" version in it; {wanted}")));
    }
    Ok(record)
}
