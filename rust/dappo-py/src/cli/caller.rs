//! Who gave a command: a person or script at a terminal, or a Python program in this process.

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
        /// Texts of the objects, each with the one who waits until it has been answered.
        objects: Sender<(String, Sender<()>)>,
        /// Whether to stop.
        stop: Arc<AtomicBool>,
    },
}

impl Caller {
    /// Hands an object over. One that nobody waits for is no error of the command.
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
                    // The answer comes from Python. Whoever is told of an iteration can stop the command at it.
                    Python::attach(|py| py.detach(move || _ = answer.recv()));
                }
            }
        }
    }

    /// The flag that says when to stop.
    pub fn watch(&self) -> PyResult<Arc<AtomicBool>> {
        match self {
            Self::Terminal => signals::watch(),
            Self::Program { stop, .. } => Ok(Arc::clone(stop)),
        }
    }

    /// Ends the watch before Python code runs, which Ctrl-C ends with a `KeyboardInterrupt`.
    pub fn leave_to_python(&self, py: Python<'_>) -> PyResult<()> {
        match self {
            Self::Terminal => signals::leave_to_python(py),
            Self::Program { .. } => Ok(()),
        }
    }
}
