//! Commands for Python programs: the same as at the terminal, with objects instead of text and exceptions instead of
//! exit codes.

use std::ffi::OsString;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;

use crate::cli::{self, Caller};
use crate::errors::{Kind, raise};

/// How long Ctrl-C waits to be noticed.
const PATIENCE: Duration = Duration::from_millis(50);

/// Runs a command line, without the program's name.
///
/// `callback` gets every object that the command prints with `--json`; when it returns `False`, the command stops in
/// good order. The command runs in a thread of its own, so that this one hears Ctrl-C.
#[pyfunction]
#[expect(
    clippy::redundant_closure_for_method_calls,
    reason = "the method alone fixes the lifetime of its Python"
)]
#[pyo3(signature = (arguments, callback=None))]
#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
pub fn run_command(py: Python<'_>, arguments: Vec<OsString>, callback: Option<Py<PyAny>>) -> PyResult<()> {
    let command = cli::parse(&arguments).map_err(|error| raise(Kind::Config, error.to_string()))?;
    let stop = Arc::new(AtomicBool::new(false));
    let (objects, received) = channel();
    let caller = Caller::Program { objects, stop: Arc::clone(&stop) };
    let hear = |text: &str| {
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
    let (stop, hear) = (&stop, &hear);
    py.detach(move || {
        thread::scope(|scope| {
            let worker =
                scope.spawn(move || Python::attach(|py| cli::run(py, &command, &arguments, &caller)));
            let mut outcome: PyResult<()> = Ok(());
            loop {
                let heard = match received.recv_timeout(PATIENCE) {
                    // A callback that has raised is not asked again.
                    Ok(text) if outcome.is_ok() => hear(&text),
                    Ok(_) => Ok(()),
                    Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals()),
                    Err(RecvTimeoutError::Disconnected) => break,
                };
                if let Err(error) = heard {
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
