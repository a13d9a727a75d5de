//! Commands for Python programs: the same as at the terminal, with objects instead of text and exceptions instead of
//! exit codes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::cli::args::{Command, DiagnoseArgs, DiagnoseCommand};
use crate::cli::{self, Caller};
use crate::errors::{Kind, raise};
use crate::keywords::read;

/// Longest time until Ctrl-C is detected.
const PATIENCE: Duration = Duration::from_millis(50);

/// Runs a command: `train`, `evaluate`, `adapt`, `export`, `collect_pairs`, `train_diagnoser` or `evaluate_diagnoser`.
///
/// `arguments` are those of the command line by their names in Python, and `given` is the command as it was
/// given. `callback` gets every object that the command prints with `--json`; when it returns `False`, the
/// command stops in good order. The command runs in a thread of its own, so that this one receives Ctrl-C.
#[pyfunction]
#[expect(
    clippy::redundant_closure_for_method_calls,
    reason = "the method alone fixes the lifetime of its Python"
)]
#[pyo3(signature = (name, arguments, given, callback=None))]
#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
pub fn run_command(
    py: Python<'_>,
    name: &str,
    arguments: Bound<'_, PyDict>,
    given: String,
    callback: Option<Py<PyAny>>,
) -> PyResult<()> {
    let command = command(name, &arguments)?;
    let stop = Arc::new(AtomicBool::new(false));
    let (objects, received) = channel();
    let caller = Caller::Program { objects, stop: Arc::clone(&stop) };
    let call = |text: &str| {
        let Some(callback) = &callback else { return Ok(()) };
        Python::attach(|py| {
            let object = py.import("json")?.call_method1("loads", (text,))?;
            let answer = callback.bind(py).call1((object,))?;
            if answer.extract::<bool>().is_ok_and(|go_on| !go_on) {
                stop.store(true, Ordering::Relaxed);
            }
            Ok(())
        })
    };
    let (stop, call) = (&stop, &call);
    py.detach(move || {
        thread::scope(|scope| {
            let worker = scope.spawn(move || Python::attach(|py| cli::run(py, &command, &[given], &caller)));
            let mut outcome: PyResult<()> = Ok(());
            loop {
                let called = match received.recv_timeout(PATIENCE) {
                    // A callback that has raised is not called again.
                    Ok((text, _answered)) if outcome.is_ok() => call(&text),
                    Ok(_) => Ok(()),
                    Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals()),
                    Err(RecvTimeoutError::Disconnected) => break,
                };
                if let Err(error) = called {
                    stop.store(true, Ordering::Relaxed);
                    outcome = outcome.and(Err(error));
                }
            }
            let ended = worker
                .join()
                .unwrap_or_else(|_| Err(raise(Kind::Simulation, "the thread of the command has died")));
            outcome.and(ended.map(drop))
        })
    })
}

/// A command that passes on its objects.
fn command(name: &str, arguments: &Bound<'_, PyDict>) -> PyResult<Command> {
    if arguments.contains("json")? {
        return Err(raise(Kind::Config, "there is no argument `json`; results are returned"));
    }
    arguments.set_item("json", true)?;
    let diagnose = |command| Command::Diagnose(DiagnoseArgs { command });
    Ok(match name {
        "train" => Command::Train(Box::new(read(arguments)?)),
        "evaluate" => Command::Evaluate(read(arguments)?),
        "export" => Command::Export(read(arguments)?),
        "adapt" => Command::Adapt(Box::new(read(arguments)?)),
        "collect_pairs" => diagnose(DiagnoseCommand::Collect(Box::new(read(arguments)?))),
        "train_diagnoser" => diagnose(DiagnoseCommand::Train(read(arguments)?)),
        "evaluate_diagnoser" => diagnose(DiagnoseCommand::Test(read(arguments)?)),
        _ => return Err(raise(Kind::Config, format!("there is no command `{name}`"))),
    })
}
