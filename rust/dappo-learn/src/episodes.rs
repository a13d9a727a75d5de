//! Sums over running episodes, and means over those that end.

use dappo_sim::vector_env::Buffers;
use serde::Serialize;

/// Running sums of every env's current episode.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeTracker {
    /// Σ forward velocity, `[N]`.
    pub forward: Vec<f64>,
    /// Σ reward, `[N]`.
    pub returns: Vec<f64>,
    /// Steps, `[N]`.
    pub lengths: Vec<f64>,
    ended: Ended,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Ended {
    count: u64,
    falls: u64,
    forward: f64,
    returns: f64,
    length: f64,
}

/// Means over the episodes that ended in an iteration; `None` when none did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EpisodeSummary {
    /// Number of episodes that ended.
    pub episodes: u64,
    /// Mean of Σ forward velocity over an episode, m/s.
    pub forward_reward: Option<f64>,
    /// Mean of Σ reward over an episode.
    pub episode_return: Option<f64>,
    /// Mean number of steps.
    pub episode_length: Option<f64>,
    /// Share of episodes that ended in failure rather than at the time limit.
    pub fall_rate: Option<f64>,
}

impl EpisodeTracker {
    /// Sums for `envs` envs at the start of their episodes.
    #[must_use]
    pub fn new(envs: usize) -> Self {
        Self {
            forward: vec![0.0; envs],
            returns: vec![0.0; envs],
            lengths: vec![0.0; envs],
            ended: Ended::default(),
        }
    }

    /// Adds one step of a same-step vector env.
    pub fn add(&mut self, buffers: &Buffers) {
        for env in 0..self.forward.len() {
            let ended = buffers.final_mask[env];
            // The reset has already overwritten the velocity of an env whose episode ended.
            let velocity =
                if ended { buffers.final_forward_velocity[env] } else { buffers.forward_velocity[env] };
            self.forward[env] += velocity;
            self.returns[env] += buffers.rewards[env];
            self.lengths[env] += 1.0;
            if ended {
                self.ended.count += 1;
                self.ended.falls += u64::from(buffers.terminated[env]);
                self.ended.forward += std::mem::take(&mut self.forward[env]);
                self.ended.returns += std::mem::take(&mut self.returns[env]);
                self.ended.length += std::mem::take(&mut self.lengths[env]);
            }
        }
    }

    /// The means since the last call.
    pub fn summarize(&mut self) -> EpisodeSummary {
        let ended = std::mem::take(&mut self.ended);
        let mean = |sum: f64| (ended.count > 0).then(|| sum / ended.count as f64);
        EpisodeSummary {
            episodes: ended.count,
            forward_reward: mean(ended.forward),
            episode_return: mean(ended.returns),
            episode_length: mean(ended.length),
            fall_rate: mean(ended.falls as f64),
        }
    }
}
