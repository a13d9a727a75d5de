//! What simulated a result: no two of these give the same numbers.

use dappo_sim::{Device, Precision};
use serde::Serialize;

/// Where physics is to be computed, and how precisely where there is a choice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Compute {
    /// The device.
    pub device: Device,
    /// Precision of the backend `lanes`.
    pub precision: Precision,
}

/// The simulator behind a result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Simulator {
    /// Backend of the physics.
    pub backend: String,
    /// Its floating-point format.
    pub precision: String,
    /// The device that it computes on.
    pub device: String,
    /// Integrator, as MuJoCo names it.
    pub physics: String,
}

impl Simulator {
    /// Names of the columns that every table of results ends with.
    pub(crate) const COLUMNS: &str = "backend,precision,device,physics";

    /// The entries of these columns.
    pub(crate) fn cells(&self) -> String {
        [&self.backend, &self.precision, &self.device, &self.physics].map(String::as_str).join(",")
    }
}
