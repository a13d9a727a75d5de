//! The metrics of a run: one source, written as text, for spreadsheets and for TensorBoard.

mod csv;
mod events;
mod line;
mod log;

use std::collections::BTreeMap;

use serde::Serialize;

use crate::episodes::EpisodeSummary;
use crate::ppo::PpoLosses;
use crate::simulator::Simulator;

pub use log::MetricsLog;

/// Means of an evaluation over all damage classes; `None` after an iteration without one.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct EvaluationMeans {
    /// Forward reward.
    pub evaluation_forward_reward: Option<f64>,
    /// Forward velocity, m/s.
    pub evaluation_forward_velocity: Option<f64>,
    /// Tracking; `None` for a task without commands, too.
    pub evaluation_tracking: Option<f64>,
    /// Share of the episodes that ended in failure.
    pub evaluation_fall_rate: Option<f64>,
}

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
    /// Mean of each term of the reward over the env steps of this iteration, its weight included, as
    /// `reward_NAME`; `warp` does not report them.
    #[serde(flatten)]
    pub reward_terms: BTreeMap<String, f64>,
    /// Mean over the env steps of this iteration of how well commanded velocities were tracked, from 0 to 1; `None`
    /// for a task without commands.
    pub tracking: Option<f64>,
    /// How often the physics of an env diverged in this iteration; such episodes are among the falls.
    pub diverged: u64,
    /// The evaluation after this iteration, see `evaluation.every`.
    #[serde(flatten)]
    pub evaluation: EvaluationMeans,
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
