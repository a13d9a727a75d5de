//! What can go wrong while learning. Every message contains what was read, what was got and what was
//! expected.

use std::fmt::Display;
use std::path::PathBuf;

/// The result of a fallible operation of this crate.
pub type Result<T> = std::result::Result<T, LearnError>;

/// An error of the learner.
#[derive(Debug, thiserror::Error)]
pub enum LearnError {
    /// Networks or their inputs do not fit.
    #[error(transparent)]
    Nn(#[from] dappo_nn::NnError),
    /// A setting lies outside its range, or names something unknown.
    #[error("{key} is {got}, expected {expected}")]
    Config {
        /// Name of the setting.
        key: &'static str,
        /// The value found.
        got: String,
        /// The range or the choices.
        expected: &'static str,
    },
    /// Settings that cannot be used, all that there are.
    #[error(transparent)]
    Settings(#[from] crate::faults::Faults),
    /// A configuration, run folder or command that cannot be used.
    #[error("{0}")]
    Invalid(String),
    /// The simulation refused something.
    #[error(transparent)]
    Sim(#[from] dappo_sim::SimError),
    /// Training has left the finite numbers.
    #[error("the training has diverged: {what} is {got}, expected a finite number; {advice}")]
    Diverged {
        /// The quantity.
        what: String,
        /// NaN or an infinity.
        got: f64,
        /// What to do.
        advice: String,
    },
    /// A file or folder of this program cannot be read, written or used.
    #[error("{kind} {}: {message}", path.display())]
    Unusable {
        /// What it belongs to.
        kind: FileKind,
        /// The file or folder.
        path: PathBuf,
        /// What was found, what was expected and what to do.
        message: String,
    },
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
}

/// What a file or folder belongs to, as messages call it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::Display)]
#[strum(serialize_all = "lowercase")]
pub enum FileKind {
    /// A checkpoint, and what else a training keeps: its diagnoser, its copy of the robot.
    Checkpoint,
    /// A folder of pairs.
    Dataset,
    /// An export folder.
    Export,
}

impl FileKind {
    /// An error about a file or folder of this kind.
    pub fn unusable(self, path: impl Into<PathBuf>, message: impl Display) -> LearnError {
        LearnError::Unusable { kind: self, path: path.into(), message: message.to_string() }
    }
}

/// Fails if a training has diverged, which shows in a `value` that is not finite; the error contains what to
/// do.
pub fn check_converging(what: impl Into<String>, value: f64, advice: &str) -> Result<f64> {
    if value.is_finite() {
        return Ok(value);
    }
    Err(LearnError::Diverged { what: what.into(), got: value, advice: advice.into() })
}
