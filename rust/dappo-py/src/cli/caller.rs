//! The caller of a command: a terminal, or a Python program in this process.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Sender, channel};

use pyo3::prelude::*;
use serde::Serialize;

use super::{console, signals};

/// Reads the objects that a command prints with `--json`, and stops it.
#[derive(Clone)]
pub enum Caller {
    /// Objects go to standard output, one a line; Ctrl-C and `kill` stop the command.
    Terminal,
    /// Objects go to the thread that waits, which raises the flag to stop the command.
    Program {
        /// Texts of the objects, each with the sender of its answer.
        objects: Sender<(String, Sender<()>)>,
        /// Whether to stop.
        stop: Arc<AtomicBool>,
    },
}

impl Caller {
    /// Sends an object. Without a receiver, this is no error of the command.
    pub fn object(&self, object: &impl Serialize) {
        let text = match serde_json::to_string(object) {
            Ok(text) => text,
            Err(error) => return console::remember(Err(error.into())),
        };
        match self {
            Self::Terminal => console::write_line(&text),
            Self::Program { objects, .. } => {
                let (answered, answer) = channel();
                if objects.send((text, answered)).is_ok() {
                    // The answer comes from Python. A callback can stop the command at the iteration that it
                    // receives.
                    Python::attach(|py| py.detach(move || _ = answer.recv()));
                }
            }
        }
    }

    /// The flag that stops the command.
    pub fn watch(&self) -> PyResult<Arc<AtomicBool>> {
        match self {
            Self::Terminal => signals::watch(),
            Self::Program { stop, .. } => Ok(Arc::clone(stop)),
        }
    }

    /// Restores Ctrl-C before Python code runs, which it ends with a `KeyboardInterrupt`.
    pub fn leave_to_python(&self, py: Python<'_>) -> PyResult<()> {
        match self {
            Self::Terminal => signals::leave_to_python(py),
            Self::Program { .. } => Ok(()),
        }
    }
}
