//! The errors of the crate.

/// Why the GPU engine cannot simulate.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// Features of the robot, or of the device, one sentence each.
    #[error("{}", .0.join("; "))]
    Unsupported(Vec<String>),
    /// The device failed.
    #[error("the GPU failed: {0}")]
    Device(String),
}
