//! What policies are compared by.

use dappo_sim::Robot;
use serde::Serialize;

use crate::error::Result;
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
    /// Tracking for a reward function with `track_lin_vel`, else the forward reward.
    ///
    /// # Errors
    /// If the robot has no such reward function.
    pub fn of(robot: &Robot, reward: Option<&str>) -> Result<Self> {
        let tracks = robot.reward(reward)?.tracking().is_some();
        Ok(if tracks { Self::Tracking } else { Self::ForwardReward })
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

#[cfg(test)]
mod tests {
    use super::*;

    const GO1: &str = include_str!("../../../../python/dappo_batch/robots/go1.toml");
    const VELOCITY: &str = include_str!("../../../../python/dappo_batch/tasks/velocity.toml");

    fn score(task: &str) -> Score {
        let merged = dappo_sim::robot::with_task(GO1, task, "velocity").unwrap();
        Score::of(&Robot::from_toml(&merged).unwrap(), None).unwrap()
    }

    #[test]
    fn tracking_counts_only_with_a_reward_for_it() {
        assert_eq!(score(VELOCITY), Score::Tracking);
        let untracked: String =
            VELOCITY.split_inclusive('\n').filter(|line| !line.starts_with("track_lin_vel")).collect();
        assert_eq!(score(&untracked), Score::ForwardReward);
    }
}
