//! The metrics of a run: one source, written for people, for spreadsheets and for TensorBoard.

mod csv;
mod events;
mod line;
mod log;

use serde::Serialize;

use crate::episodes::EpisodeSummary;
use crate::ppo::PpoLosses;
use crate::simulator::Simulator;

pub use log::MetricsLog;

/// The metrics of one iteration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Metrics {
    /// Number of the iteration, from 1.
    pub iteration: u64,
    /// Env steps done so far.
    pub env_steps: u64,
    /// Name of the curriculum stage.
    pub stage: String,
    /// Episodes that ended in this iteration and their means.
    #[serde(flatten)]
    pub episodes: EpisodeSummary,
    /// How often the physics of an env diverged in this iteration; such episodes are among the falls.
    pub diverged: u64,
    /// What the update reports.
    #[serde(flatten)]
    pub losses: PpoLosses,
    /// What simulated.
    #[serde(flatten)]
    pub simulator: Simulator,
    /// Time spent collecting, s.
    pub rollout_seconds: f64,
    /// Time spent updating, s.
    pub update_seconds: f64,
}
