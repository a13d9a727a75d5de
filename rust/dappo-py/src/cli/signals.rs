//! Ctrl-C, `kill` and a closed terminal: the first signal stops in good order, a second Ctrl-C or `kill` ends
//! the program at once.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use pyo3::prelude::*;
use signal_hook::consts::{SIGINT, SIGTERM};

use super::INTERRUPTED;
use crate::errors::{Kind, raise};

/// A flag that the first signal raises.
pub fn watch() -> PyResult<Arc<AtomicBool>> {
    let failed = |error: std::io::Error| raise(Kind::Simulation, format!("cannot watch for Ctrl-C: {error}"));
    let interrupted = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, INTERRUPTED, Arc::clone(&interrupted))
            .map_err(failed)?;
        signal_hook::flag::register(signal, Arc::clone(&interrupted)).map_err(failed)?;
    }
    if let Some(signal) = Python::attach(hang_up)? {
        // A closing terminal may send it twice, by its shell and by the kernel, so the second ends nothing.
        signal_hook::flag::register(signal, Arc::clone(&interrupted)).map_err(failed)?;
    }
    Ok(interrupted)
}

/// Ends a watch: from now on the first signal ends Python code with a `KeyboardInterrupt`.
pub fn leave_to_python(py: Python<'_>) -> PyResult<()> {
    let signal = py.import("signal")?;
    let handler = signal.getattr("default_int_handler")?;
    for number in [SIGINT, SIGTERM].into_iter().chain(hang_up(py)?) {
        signal.call_method1("signal", (number, &handler))?;
    }
    Ok(())
}

/// SIGHUP, unless the system has none or the program is to survive its terminal, as under `nohup`.
fn hang_up(py: Python<'_>) -> PyResult<Option<i32>> {
    let signal = py.import("signal")?;
    if !signal.hasattr("SIGHUP")? {
        return Ok(None);
    }
    let number = signal.getattr("SIGHUP")?;
    let is_ignored = signal.call_method1("getsignal", (&number,))?.eq(signal.getattr("SIG_IGN")?)?;
    if is_ignored { Ok(None) } else { number.extract().map(Some) }
}
