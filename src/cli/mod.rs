//! What stands on the command line, and what a person sees. One file a subcommand. Invariant: results
//! go to stdout, everything else to stderr; an error is one line; a closed pipe is no error and
//! never a panic. Never renders, compares or parses scenes itself.

pub(crate) mod compare;
pub(crate) mod cost;
pub(crate) mod diff;
pub(crate) mod generate;
pub(crate) mod info;
mod interrupt;
mod options;
pub(crate) mod plan;
mod progress;
pub(crate) mod render;
pub(crate) mod report;
pub(crate) mod texture;
mod values;

use clap::Parser;
use clap::error::ErrorKind;
use nix::sys::signal::{SigSet, Signal};
use std::ffi::OsString;
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::ExitCode;
use weir::error::{Error, Result};

const EXAMPLES: &str = "\
Examples:
  weir scene.pbrt                        render with the scene's own settings
  weir model.obj -o model.png            a picture of a model
  weir scene.pbrt --spp 16 --size 640x360 -o quick.exr -o quick.png
  weir scene.pbrt --time 60s --stats stats.json
  weir diff new.exr reference.exr        how far two images are apart
  weir report stats.json                 where time and memory went
  weir plan scene.pbrt                   what it calls for, and what that takes
  weir texture bark.png -o bark.tx       a tiled, mip-mapped texture
  weir cost scene.pbrt --report c.html   what accuracy costs in time, knob by knob
  weir compare scene.pbrt                Embree against the native hierarchy, hit by hit
  weir info scene.pbrt                   what is in a scene, mesh or image
  weir generate terrain -o valley        a large scene, made from a seed

`weir SCENE` alone is `weir render SCENE`; `weir render --help` lists its options.

Exit codes: 0 done; 1 the verdict is negative (diff past --fail-above, an
unexplained difference in compare); 2 bad usage or bad input;
3 out of memory or disk; 130 interrupted before there was anything to write.";

#[derive(Parser)]
#[command(name = "weir", version, about, after_help = EXAMPLES, arg_required_else_help = false)]
struct Arguments {
    #[command(subcommand)]
    command: Subcommand,
}

#[derive(clap::Subcommand)]
enum Subcommand {
    /// Render a scene (pbrt-v4, OBJ, PLY)
    Render(render::Options),
    /// Say what a scene calls for, what it takes, and how it would be rendered
    Plan(plan::Options),
    /// Hold Embree against the native hierarchy, hit by hit, and time both
    Compare(compare::Options),
    /// Measure what accuracy costs in time, knob by knob
    Cost(cost::Options),
    /// Compare two images: means, relMSE, FLIP, agreement
    Diff(diff::Options),
    /// Say what is in a scene, a mesh or an image
    Info(info::Options),
    /// Print what --stats wrote as text
    Report(report::Options),
    /// Make a tiled, mip-mapped texture of an image
    Texture(texture::Options),
    /// Make a large procedural scene
    Generate(generate::Options),
}

/// What to do.
pub(crate) enum Command {
    Render(render::Options),
    Plan(plan::Options),
    Compare(compare::Options),
    Cost(cost::Options),
    Diff(diff::Options),
    Info(info::Options),
    Report(report::Options),
    Texture(texture::Options),
    Generate(generate::Options),
    /// `--help` or `--version`: a text that was asked for.
    Help(String),
}

/// How a command ended that did what it was told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum End {
    /// Done.
    Done,
    /// The command's own verdict is negative.
    Negative,
    /// Done as far as the input allowed; what was wrong with it has been said.
    BadInput,
    /// Stopped before there was anything to write.
    Interrupted,
}

/// Reads the command line; its first item is the program.
pub(crate) fn parse(arguments: impl IntoIterator<Item = OsString>) -> Result<Command> {
    let arguments = with_render(arguments.into_iter().collect())?;
    match Arguments::try_parse_from(arguments) {
        Ok(Arguments { command }) => Ok(match command {
            Subcommand::Render(options) => Command::Render(options),
            Subcommand::Plan(options) => Command::Plan(options),
            Subcommand::Compare(options) => Command::Compare(options),
            Subcommand::Cost(options) => Command::Cost(options),
            Subcommand::Diff(options) => Command::Diff(options),
            Subcommand::Info(options) => Command::Info(options),
            Subcommand::Report(options) => Command::Report(options),
            Subcommand::Texture(options) => Command::Texture(options),
            Subcommand::Generate(options) => Command::Generate(options),
        }),
        Err(e) if matches!(e.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => {
            Ok(Command::Help(e.render().to_string()))
        }
        Err(e) => Err(Error::Usage(one_line(&e.render().to_string()))),
    }
}

/// `weir SCENE` is `weir render SCENE`, wherever the options stand.
fn with_render(mut arguments: Vec<OsString>) -> Result<Vec<OsString>> {
    const COMMANDS: [&str; 10] =
        ["render", "plan", "compare", "cost", "diff", "info", "report", "texture", "generate", "help"];
    let Some(first) = arguments.get(1) else {
        return Err(Error::Usage(
            "no scene given; `weir scene.pbrt` renders one; see weir --help".to_owned(),
        ));
    };
    let text = first.to_string_lossy();
    let about_weir = matches!(&*text, "-h" | "--help" | "-V" | "--version");
    if about_weir || COMMANDS.contains(&&*text) {
        return Ok(arguments);
    }
    // A bare word that is no file is more likely a command misspelt than a scene misplaced.
    if !text.starts_with('-') && !text.contains(['.', '/']) && !Path::new(first).exists() {
        return Err(Error::Usage(format!(
            "no command and no file is called '{text}'; the commands are render, plan, compare, cost, diff, info, report, texture and generate; see weir --help"
        )));
    }
    arguments.insert(1, "render".into());
    Ok(arguments)
}

/// The first paragraph of clap's message and its tip, if it has one, without its usage block.
fn one_line(message: &str) -> String {
    let mut parts: Vec<&str> =
        message.lines().take_while(|line| !line.trim().is_empty()).map(str::trim).collect();
    parts.extend(message.lines().map(str::trim).find_map(|line| line.strip_prefix("tip: ")));
    let mut line = String::new();
    for part in parts {
        let part = part.strip_prefix("error: ").unwrap_or(part);
        if !line.is_empty() {
            line.push_str(if line.ends_with(':') { " " } else { "; " });
        }
        line.push_str(part);
    }
    line + "; see weir --help"
}

/// Refuses to write a file over the one that is read, by whatever name: `role` is what that one is.
pub(crate) fn check_not_input(output: &Path, input: &Path, role: &str) -> Result<()> {
    let file = |path: &Path| std::fs::metadata(path).ok().map(|there| (there.dev(), there.ino()));
    if file(input).is_some_and(|input| file(output) == Some(input)) {
        let output = output.display();
        return Err(Error::Usage(format!("{output}: is the {role} too; name another file to write")));
    }
    Ok(())
}

/// Whoever is written second would replace the first.
pub(crate) fn check_apart(image: &Path, record: &Path) -> Result<()> {
    let place = |path: &Path| {
        let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        (parent.canonicalize().ok(), path.file_name().map(ToOwned::to_owned))
    };
    if image == record || place(image) == place(record) {
        let image = image.display();
        return Err(Error::Usage(format!(
            "{image}: is to be written twice; name another file for one of them"
        )));
    }
    check_not_input(record, image, "image")
}

/// Writes a result to standard output.
pub(crate) fn print(text: &str) -> Result<End> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Ok(()) => Ok(End::Done),
        // Whoever read the output has seen enough.
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(End::Done),
        Err(e) => Err(Error::io("standard output", e)),
    }
}

/// Writes a line for the person to standard error. A closed one is no reason to stop.
pub(crate) fn note(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Says what went wrong, in one line, and turns it into the exit code.
pub(crate) fn exit_code(result: Result<End>) -> ExitCode {
    match result {
        Ok(End::Done) => ExitCode::SUCCESS,
        Ok(End::Negative) => ExitCode::from(1),
        Ok(End::BadInput) => ExitCode::from(2),
        Ok(End::Interrupted) => ExitCode::from(130),
        Err(e) => {
            // File names may hold anything, and so may messages of other libraries.
            let line = e.to_string().replace(['\n', '\r'], " ");
            match e {
                // The place comes first, where editors look for it.
                Error::Input { .. } => note(&line),
                _ => note(&format!("weir: {line}")),
            }
            ExitCode::from(e.exit_code())
        }
    }
}

/// Makes a write beyond the limit on file sizes (`ulimit -f`) an error, as on a full disk, where SIGXFSZ would end the
/// program and leave half a file. To be called before there is another thread: threads inherit what is blocked.
pub(crate) fn take_full_files_for_errors() {
    let mut signals = SigSet::empty();
    signals.add(Signal::SIGXFSZ);
    // Where it cannot be blocked it does what it did.
    let _ = signals.thread_block();
}

/// A panic is our bug: one line that can be reported, and Rust's own exit code 101.
pub(crate) fn report_panics_in_one_line() {
    // Whoever asks for a backtrace gets Rust's own report.
    if std::env::var_os("RUST_BACKTRACE").is_some_and(|v| v != "0") {
        return;
    }
    std::panic::set_hook(Box::new(|info| {
        let payload = info.payload();
        let message = payload
            .downcast_ref::<&str>()
            .copied()
            .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
            .unwrap_or("no message")
            .replace(['\n', '\r'], " ");
        let place = info.location().map(|l| format!(" at {}:{}", l.file(), l.line())).unwrap_or_default();
        note(&format!(
            "weir: internal error{place}: {message}; this is a bug in weir, please report it with the scene \
             (RUST_BACKTRACE=1 says more)"
        ));
    }));
}

#[cfg(test)]
mod tests;
