//! The metrics of a run, one JSON object a line in `metrics.jsonl`.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::PathBuf;

use serde::Serialize;

use crate::episodes::EpisodeSummary;
use crate::error::{LearnError, Result};
use crate::files::{io, write_atomically};
use crate::ppo::PpoLosses;
use crate::simulator::Simulator;

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

/// A file of metrics, which grows line by line.
#[derive(Debug, Clone)]
pub struct MetricsFile {
    path: PathBuf,
}

impl MetricsFile {
    /// The file of this name, which need not exist.
    #[must_use]
    pub fn new(path: PathBuf) -> Self {
        Self { path }
    }

    /// Whether a line has been written.
    #[must_use]
    pub fn exists(&self) -> bool {
        self.path.exists()
    }

    /// Appends one line.
    pub fn append(&self, metrics: &impl Serialize) -> Result<()> {
        let path = &self.path;
        let mut line =
            serde_json::to_string(metrics).map_err(|error| LearnError::Invalid(error.to_string()))?;
        line.push('\n');
        let mut file = OpenOptions::new().create(true).append(true).open(path).map_err(io(path))?;
        file.write_all(line.as_bytes()).map_err(io(path))?;
        // A checkpoint must not outlive the lines that led to it.
        file.sync_data().map_err(io(path))
    }

    /// Drops the lines whose entry `key` is above `last`, and a line cut short by a kill: the run goes on from there.
    pub fn rewind(&self, key: &str, last: u64) -> Result<()> {
        if !self.exists() {
            return Ok(());
        }
        // A line cut short may end inside a character.
        let bytes = fs::read(&self.path).map_err(io(&self.path))?;
        let text = String::from_utf8_lossy(&bytes);
        let is_kept = |line: &&str| {
            let parsed: Option<serde_json::Value> = serde_json::from_str(line).ok();
            parsed.and_then(|value| value[key].as_u64()).is_some_and(|number| number <= last)
        };
        let kept: String = text.lines().filter(is_kept).flat_map(|line| [line, "\n"]).collect();
        write_atomically(&self.path, kept.as_bytes())
    }
}
