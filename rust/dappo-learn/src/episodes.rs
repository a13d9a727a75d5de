//! Sums over running episodes, and means over those that end.

use dappo_nn::error::check_length;
use dappo_sim::vector_env::Buffers;
use serde::Serialize;

use crate::error::Result;
use crate::rollout::Rollout;

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
    /// Σ of each term of the reward over all steps of an iteration, and their number.
    reward_terms: (Vec<f64>, u64),
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
            reward_terms: (Vec::new(), 0),
        }
    }

    /// Adds one step of a same-step vector env.
    pub fn add(&mut self, buffers: &Buffers) {
        let (sums, steps) = &mut self.reward_terms;
        let envs = self.forward.len();
        sums.resize(buffers.reward_terms.len() / envs.max(1), 0.0);
        for row in buffers.reward_terms.chunks_exact(sums.len().max(1)) {
            sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
        *steps += envs as u64;
        for env in 0..self.forward.len() {
            let ended = buffers.final_mask[env];
            // The reset has already overwritten the velocity of an env whose episode ended.
            let velocity =
                if ended { buffers.final_forward_velocity[env] } else { buffers.forward_velocity[env] };
            self.count(env, velocity, buffers.rewards[env]);
            if ended {
                self.end(env, buffers.terminated[env]);
            }
        }
    }

    /// Adds all steps of a rollout; `forward_velocity` is `[T, N]`, of every step before its reset.
    pub fn add_rollout(&mut self, rollout: &Rollout, forward_velocity: &[f32]) -> Result<()> {
        check_length("forward_velocity [T, N]", forward_velocity, rollout.len())?;
        check_length("envs of the episode tracker", &self.forward, rollout.num_envs)?;
        for (index, velocity) in forward_velocity.iter().enumerate() {
            let env = index % rollout.num_envs;
            self.count(env, f64::from(*velocity), f64::from(rollout.rewards[index]));
            if rollout.terminated[index] || rollout.truncated[index] {
                self.end(env, rollout.terminated[index]);
            }
        }
        Ok(())
    }

    /// Adds a step of an env to its running episode.
    fn count(&mut self, env: usize, velocity: f64, reward: f64) {
        self.forward[env] += velocity;
        self.returns[env] += reward;
        self.lengths[env] += 1.0;
    }

    /// Ends the running episode of an env.
    fn end(&mut self, env: usize, is_fall: bool) {
        self.ended.count += 1;
        self.ended.falls += u64::from(is_fall);
        self.ended.forward += std::mem::take(&mut self.forward[env]);
        self.ended.returns += std::mem::take(&mut self.returns[env]);
        self.ended.length += std::mem::take(&mut self.lengths[env]);
    }

    /// The mean of each term of the reward over the env steps since the last call; empty where the steps came without
    /// their terms.
    pub(crate) fn mean_reward_terms(&mut self) -> Vec<f64> {
        let (sums, steps) = std::mem::take(&mut self.reward_terms);
        sums.into_iter().map(|sum| sum / steps as f64).collect()
    }

    /// The means since the last call.
    pub(crate) fn summarize(&mut self) -> EpisodeSummary {
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

#[cfg(test)]
mod tests {
    use super::*;
    use dappo_nn::InputTransform;

    #[test]
    fn the_steps_of_a_rollout_add_up_to_episodes_that_may_begin_in_an_earlier_one() {
        let mut rollout = Rollout::new(3, 2, 1, InputTransform::new(1, 0, 1.0).unwrap());
        rollout.rewards = vec![1.0, 10.0, 2.0, 20.0, 4.0, 40.0];
        rollout.terminated = vec![false, false, true, false, false, false];
        rollout.truncated = vec![false, false, true, false, false, true];
        let velocity = [0.5, 5.0, 0.25, 2.5, 0.125, 1.25];
        let mut tracker = EpisodeTracker::new(2);
        tracker.add_rollout(&rollout, &velocity).unwrap();
        // Env 0 ends after two steps by a fall in its last step, env 1 after three at its time limit.
        assert_eq!(
            tracker.summarize(),
            EpisodeSummary {
                episodes: 2,
                forward_reward: Some(f64::midpoint(0.75, 8.75)),
                episode_return: Some(f64::midpoint(3.0, 70.0)),
                episode_length: Some(2.5),
                fall_rate: Some(0.5),
            }
        );
        assert_eq!((&tracker.forward, &tracker.lengths), (&vec![0.125, 0.0], &vec![1.0, 0.0]));
        tracker.add_rollout(&rollout, &velocity).unwrap();
        assert_eq!(tracker.summarize().episode_length, Some(3.0));
        assert!(tracker.add_rollout(&rollout, &velocity[1..]).is_err());
    }
}
