//! The one error of the crate.

/// Why the engine cannot simulate a robot.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Unsupported(pub String);
