//! The command line. Exit codes: 0 done, 1 failed, 2 bad usage, 130 interrupted.

mod adapt;
pub mod args;
mod caller;
mod classes;
pub mod console;
mod diagnose;
mod evaluate;
mod export;
mod film;
mod progress;
mod render;
pub mod settings;
mod signals;
mod tools;
mod train;

use std::ffi::{OsStr, OsString};

use clap::Parser;
use clap::error::ErrorKind;
use pyo3::prelude::*;

use args::{Cli, Command};
pub use caller::Caller;

const FAILED: i32 = 1;
const BAD_USAGE: i32 = 2;
const INTERRUPTED: i32 = 130;

/// Runs the command line and returns its exit code.
#[pyfunction]
#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
pub fn run_cli(py: Python<'_>, argv: Vec<OsString>) -> i32 {
    let code = match parse(&argv) {
        Ok(cli) => {
            let outcome = run(py, &cli.command, &words(&argv), &Caller::Terminal);
            outcome.unwrap_or_else(|error| report(py, &error))
        }
        Err(error) => {
            let is_help = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
            let printed = error.print();
            if is_help {
                console::remember(printed);
            }
            if is_help { 0 } else { BAD_USAGE }
        }
    };
    let code = match console::finish() {
        Err(message) => {
            console::error(&message);
            if code == 0 { FAILED } else { code }
        }
        Ok(()) => code,
    };
    // A Ctrl-C that a command has handled is still pending in Python, which would end with a traceback.
    if py.check_signals().is_err() { INTERRUPTED } else { code }
}

/// Reads a command line, without the program's name.
pub fn parse(argv: &[OsString]) -> Result<Cli, clap::Error> {
    Cli::try_parse_from(
        std::iter::once(OsStr::new("dappo-batch")).chain(argv.iter().map(OsString::as_os_str)),
    )
}

/// A command line as a person reads it.
pub fn words(argv: &[OsString]) -> Vec<String> {
    std::iter::once("dappo-batch".into())
        .chain(argv.iter().map(|word| word.to_string_lossy().into()))
        .collect()
}

/// Runs a command; returns its exit code. `given` is how it was given, word by word.
pub fn run(py: Python<'_>, command: &Command, given: &[String], caller: &Caller) -> PyResult<i32> {
    match command {
        Command::Train(arguments) => train::run(py, arguments, given, caller),
        Command::Evaluate(arguments) => evaluate::run(py, arguments, caller),
        Command::Diagnose(arguments) => diagnose::run(py, arguments, caller),
        Command::Adapt(arguments) => adapt::run(py, arguments, caller),
        Command::Export(arguments) => export::run(py, arguments, caller),
        Command::Render(arguments) => render::run(py, arguments, caller),
        Command::View(arguments) => render::view(py, arguments, caller),
        Command::Sweep(arguments) => tools::run(py, "dappo_batch.sweeps.command", arguments),
        Command::Report(arguments) => tools::run(py, "dappo_batch.report", arguments),
        Command::Check(arguments) => tools::run(py, "dappo_batch.commands.check", arguments),
        Command::Classes(arguments) => classes::run(py, arguments, caller),
        Command::Config(arguments) => settings::print(py, arguments),
        Command::Bench(arguments) => tools::run(py, "dappo_batch.bench", arguments),
        Command::Doctor(arguments) => tools::run(py, "dappo_batch.doctor", arguments),
    }
}

/// Prints an error and chooses the exit code. Our own exceptions explain themselves; others keep their trace.
fn report(py: Python<'_>, error: &PyErr) -> i32 {
    if error.is_instance_of::<pyo3::exceptions::PyKeyboardInterrupt>(py) {
        return INTERRUPTED;
    }
    if crate::errors::is_ours(py, error) {
        console::error(&error.value(py).to_string());
    } else {
        error.print(py);
    }
    FAILED
}
