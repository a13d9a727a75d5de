//! What can go wrong while learning. Every message says what was read, what was got and what was expected.

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
    #[error("{}", crate::config::describe(.0))]
    Settings(Vec<crate::config::Fault>),
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
    /// A checkpoint belongs to a learner of another form.
    #[error("checkpoint {}: {what} is {got}, expected {expected}", path.display())]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// The property that differs.
        what: &'static str,
        /// Its value in the checkpoint.
        got: String,
        /// Its value in the configuration.
        expected: String,
    },
    /// A checkpoint file holds something that cannot be understood.
    #[error("checkpoint {}: {message}", path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// What the reader or the writer said.
        message: String,
    },
    /// A folder of pairs cannot be read or written.
    #[error("dataset {}: {message}", path.display())]
    Dataset {
        /// The file.
        path: PathBuf,
        /// What was found and what to do.
        message: String,
    },
    /// An export folder cannot be read or written.
    #[error("export {}: {message}", path.display())]
    Export {
        /// The folder or file.
        path: PathBuf,
        /// What was found and what to do.
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

/// Fails if a training has diverged, which shows in a `value` that is not finite; says what to do.
pub fn check_converging(what: impl Into<String>, value: f64, advice: &str) -> Result<f64> {
    if value.is_finite() {
        return Ok(value);
    }
    Err(LearnError::Diverged { what: what.into(), got: value, advice: advice.into() })
}
