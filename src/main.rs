//! Arguments in, exit code out. 0: done. 1: the command's own verdict is negative. 2: bad usage or bad
//! input. 3: out of a resource. 130: stopped before there was anything to write. 101: our own bug.

mod cli;

use cli::{Command, compare, cost, diff, generate, info, plan, render, report, texture};
use std::process::ExitCode;

fn main() -> ExitCode {
    cli::report_panics_in_one_line();
    cli::take_full_files_for_errors();
    let result = cli::parse(std::env::args_os()).and_then(|command| match command {
        Command::Render(options) => render::run(&options),
        Command::Plan(options) => plan::run(&options),
        Command::Compare(options) => compare::run(&options),
        Command::Cost(options) => cost::run(&options),
        Command::Diff(options) => diff::run(&options),
        Command::Info(options) => info::run(&options),
        Command::Report(options) => report::run(&options),
        Command::Texture(options) => texture::run(&options),
        Command::Generate(options) => generate::run(&options),
        Command::Help(text) => cli::print(&text),
    });
    cli::exit_code(result)
}
