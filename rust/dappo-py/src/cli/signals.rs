//! Ctrl-C and `kill`: the first asks to stop in good order, the second ends the program at once.

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
    Ok(interrupted)
}

/// Ends a watch: from now on the first signal ends Python code with a `KeyboardInterrupt`.
pub fn leave_to_python(py: Python<'_>) -> PyResult<()> {
    let signal = py.import("signal")?;
    let handler = signal.getattr("default_int_handler")?;
    for number in [SIGINT, SIGTERM] {
        signal.call_method1("signal", (number, &handler))?;
    }
    Ok(())
}
