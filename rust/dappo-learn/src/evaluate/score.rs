//! What policies are compared by.

use dappo_sim::Robot;
use serde::Serialize;

use crate::walk::Episode;

/// What policies are compared by; more is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Score {
    /// Σ forward velocity of an episode, m/s.
    ForwardReward,
    /// How well commanded velocities are tracked, from 0 to 1.
    Tracking,
}

impl Score {
    /// Tracking for a task with commands, else the forward reward.
    #[must_use]
    pub fn of(robot: &Robot) -> Self {
        if robot.commands.velocity.is_some() { Self::Tracking } else { Self::ForwardReward }
    }

    /// The score of an episode that has at most `steps` env steps.
    #[must_use]
    pub fn of_episode(self, episode: &Episode, steps: usize) -> f64 {
        match self {
            Self::ForwardReward => episode.forward_reward,
            // What an episode misses by its failure is not tracked.
            Self::Tracking => episode.tracking / steps as f64,
        }
    }

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::ForwardReward => "forward reward",
            Self::Tracking => "tracking",
        }
    }

    /// Decimals of its numbers in texts.
    #[must_use]
    pub fn decimals(self) -> usize {
        match self {
            Self::ForwardReward => 1,
            Self::Tracking => 3,
        }
    }

    /// Columns of both sides in a table.
    pub(super) fn columns(self) -> [&'static str; 2] {
        match self {
            Self::ForwardReward => ["forward_reward", "other_forward_reward"],
            Self::Tracking => ["tracking", "other_tracking"],
        }
    }
}
