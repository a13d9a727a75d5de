//! What can go wrong in a simulation. Every message contains what was wrong and what was expected.

use thiserror::Error;

/// Errors of this crate.
#[derive(Debug, Error)]
pub enum SimError {
    /// A robot file, damage specification or option that cannot be used.
    #[error("{0}")]
    Config(String),

    /// An array of the wrong length.
    #[error("{what} has {got} entries, expected {expected}")]
    Shape {
        /// Name of the argument.
        what: &'static str,
        /// Length received.
        got: usize,
        /// Length required.
        expected: usize,
    },

    /// An action that is NaN or infinite.
    #[error(
        "the action of env {env} is not finite (component {component} is {value}); check the policy's output"
    )]
    NonFiniteAction {
        /// Index of the env.
        env: usize,
        /// Index of the action component.
        component: usize,
        /// The offending value.
        value: f32,
    },

    /// libmujoco could not be loaded or lacks a function.
    #[error("cannot use the MuJoCo library {path}: {reason}; reinstall the `mujoco` package")]
    Library {
        /// Path of the shared library.
        path: String,
        /// The message of the dynamic loader.
        reason: String,
    },

    /// A robot that the lane engine does not support, with all reasons; `mujoco` simulates it.
    #[error("the lane engine cannot simulate this robot: {}", .0.join("; "))]
    Unsupported(Vec<String>),

    /// A worker pool could not be started.
    #[error("cannot start {threads} worker threads: {reason}")]
    Threads {
        /// Number of threads requested.
        threads: usize,
        /// The message of the operating system.
        reason: String,
    },

    /// The device of the physics cannot continue: too little memory, too little room for contacts.
    #[error("{0}")]
    Device(String),

    /// The creation of the physics was interrupted, for example with Ctrl-C.
    #[error("interrupted")]
    Interrupted,

    /// More memory than there is.
    #[error(
        "not enough memory for {what}: about {} are needed, {} are available; request less, or give the process more",
        gigabytes(*needed), gigabytes(u128::from(*available))
    )]
    Memory {
        /// What needs it.
        what: String,
        /// Bytes, estimated.
        needed: u128,
        /// Bytes that the machine and the limits of the process leave.
        available: u64,
    },

    /// A saved env state that belongs to another env.
    #[error("cannot restore the env state: {0}")]
    Snapshot(String),
}

/// A number of bytes as text.
fn gigabytes(bytes: u128) -> String {
    let gigabytes = bytes as f64 / 1e9;
    if gigabytes < 1e6 { format!("{gigabytes:.2} GB") } else { format!("{gigabytes:.1e} GB") }
}

/// Checks the length of a slice.
pub(crate) fn expect_len(what: &'static str, got: usize, expected: usize) -> Result<(), SimError> {
    if got == expected { Ok(()) } else { Err(SimError::Shape { what, got, expected }) }
}
