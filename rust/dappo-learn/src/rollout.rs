//! What a policy saw and did: `horizon` steps of `num_envs` environments, time-major.

use dappo_nn::error::{check_finite, check_length};
use dappo_nn::{Decision, InputTransform, PolicyState};

use crate::error::Result;

/// A rollout. T = `horizon`, N = `num_envs`, O = `obs_dim`, A = `action_dim`, H = units of the policy's memory, if any.
#[derive(Debug, Clone)]
pub struct Rollout {
    /// Steps.
    pub horizon: usize,
    /// Environments.
    pub num_envs: usize,
    /// Length of an observation, damage code included.
    pub obs_dim: usize,
    /// Length of an action.
    pub action_dim: usize,
    /// Observations before each step, raw, `[T, N, O]`.
    pub obs: Vec<f32>,
    /// Actions as sampled, before any clipping, `[T, N, A]`.
    pub actions: Vec<f32>,
    /// Means of the distributions that the actions were drawn from, `[T, N, A]`.
    pub means: Vec<f32>,
    /// Log-densities of the actions, `[T, N]`.
    pub log_probs: Vec<f32>,
    /// Rewards of each step, unscaled, `[T, N]`.
    pub rewards: Vec<f32>,
    /// Whether the step ended the episode in a terminal state, `[T, N]`.
    pub terminated: Vec<bool>,
    /// Whether the step ended the episode at its time limit, `[T, N]`.
    pub truncated: Vec<bool>,
    /// V(obs) in the value net's unit, which is that of rewards × (1 − γ), `[T, N]`.
    pub values: Vec<f32>,
    /// V(`final_obs`) in the same unit, `[T, N]`; read only where a step truncated its episode.
    pub final_values: Vec<f32>,
    /// V of the observations after the last step, `[N]`.
    pub last_values: Vec<f32>,
    /// What the networks were given of the observations.
    pub transform: InputTransform,
    /// What a recurrent policy remembered before the first step, of N robots.
    pub state: PolicyState,
    /// Hidden states of its memory at each step, `[T, N, H]`.
    pub hidden: Vec<f32>,
}

impl Rollout {
    /// An empty rollout, all zeros, for a policy that transforms its observations so.
    #[must_use]
    pub fn new(horizon: usize, num_envs: usize, action_dim: usize, transform: InputTransform) -> Self {
        let (rows, obs_dim) = (horizon * num_envs, transform.width());
        Self {
            horizon,
            num_envs,
            obs_dim,
            action_dim,
            obs: vec![0.0; rows * obs_dim],
            actions: vec![0.0; rows * action_dim],
            means: vec![0.0; rows * action_dim],
            log_probs: vec![0.0; rows],
            rewards: vec![0.0; rows],
            terminated: vec![false; rows],
            truncated: vec![false; rows],
            values: vec![0.0; rows],
            final_values: vec![0.0; rows],
            last_values: vec![0.0; num_envs],
            transform,
            state: PolicyState::default(),
            hidden: Vec::new(),
        }
    }

    /// The same for a recurrent policy that remembers `state`.
    #[must_use]
    pub fn from_state(self, state: PolicyState) -> Self {
        Self { hidden: vec![0.0; self.len() * state.units()], state, ..self }
    }

    /// Whether each step of each env is the first one of an episode, as far as the steps of the rollout tell,
    /// `[T, N]`: those before the first step are part of its state.
    #[must_use]
    pub fn begins(&self) -> Vec<bool> {
        let ended = self
            .terminated
            .iter()
            .zip(&self.truncated)
            .map(|(terminated, truncated)| *terminated || *truncated);
        std::iter::repeat_n(false, self.num_envs).chain(ended).take(self.len()).collect()
    }

    /// Number of transitions, T · N.
    #[must_use]
    pub fn len(&self) -> usize {
        self.horizon * self.num_envs
    }

    /// Whether there is no transition.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Writes what the policy saw and decided at `step`.
    ///
    /// # Shapes
    /// obs `[N, O]`, raw; decision of N rows
    pub fn record_decision(&mut self, step: usize, obs: &[f32], decision: &Decision) -> Result<()> {
        write_step("obs [N, O]", &mut self.obs, self.horizon, step, obs)?;
        write_step("actions [N, A]", &mut self.actions, self.horizon, step, &decision.actions)?;
        write_step("means [N, A]", &mut self.means, self.horizon, step, &decision.means)?;
        write_step("log_probs [N]", &mut self.log_probs, self.horizon, step, &decision.log_probs)?;
        write_step("hidden [N, H]", &mut self.hidden, self.horizon, step, &decision.hidden)?;
        write_step("values [N]", &mut self.values, self.horizon, step, &decision.values)
    }

    /// Writes what the environments answered at `step`.
    ///
    /// # Shapes
    /// rewards, terminated, truncated `[N]`
    pub fn record_outcome(
        &mut self,
        step: usize,
        rewards: &[f64],
        terminated: &[bool],
        truncated: &[bool],
    ) -> Result<()> {
        let rewards: Vec<f32> = rewards.iter().map(|reward| *reward as f32).collect();
        write_step("rewards [N]", &mut self.rewards, self.horizon, step, &rewards)?;
        write_step("terminated [N]", &mut self.terminated, self.horizon, step, terminated)?;
        write_step("truncated [N]", &mut self.truncated, self.horizon, step, truncated)
    }

    /// Fails unless every buffer has its shape and every number that training reads is finite.
    pub fn check(&self) -> Result<()> {
        let rows = self.len();
        check_length("obs [T, N, O]", &self.obs, rows * self.obs_dim)?;
        check_length("actions [T, N, A]", &self.actions, rows * self.action_dim)?;
        check_length("means [T, N, A]", &self.means, rows * self.action_dim)?;
        check_length("terminated [T, N]", &self.terminated, rows)?;
        check_length("truncated [T, N]", &self.truncated, rows)?;
        check_length("last_values [N]", &self.last_values, self.num_envs)?;
        check_length("hidden [T, N, H]", &self.hidden, rows * self.state.units())?;
        for (name, what, array) in [
            ("log_probs", "log_probs [T, N]", &self.log_probs),
            ("rewards", "rewards [T, N]", &self.rewards),
            ("values", "values [T, N]", &self.values),
            ("final_values", "final_values [T, N]", &self.final_values),
        ] {
            check_length(what, array, rows)?;
            if let Some(index) = array.iter().position(|x| !x.is_finite()) {
                let (step, env) = (index / self.num_envs, index % self.num_envs);
                check_finite(format!("{name} of step {step}, env {env}"), f64::from(array[index]))?;
            }
        }
        Ok(())
    }
}

/// Copies the values of one step into a time-major buffer.
fn write_step<T: Copy>(
    what: &'static str,
    buffer: &mut [T],
    horizon: usize,
    step: usize,
    values: &[T],
) -> Result<()> {
    let width = buffer.len() / horizon.max(1);
    check_length(what, values, width)?;
    match buffer.get_mut(step * width..(step + 1) * width) {
        Some(slot) => {
            slot.copy_from_slice(values);
            Ok(())
        }
        None => Ok(check_length("rows of the rollout", buffer, (step + 1) * width)?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decision(rows: usize, actions: usize) -> Decision {
        Decision {
            actions: vec![1.0; rows * actions],
            means: vec![2.0; rows * actions],
            log_probs: vec![3.0; rows],
            values: vec![4.0; rows],
            hidden: Vec::new(),
        }
    }

    #[test]
    fn a_step_lands_in_its_own_rows() {
        let mut rollout = Rollout::new(3, 2, 1, InputTransform::new(2, 0, 1.0).unwrap());
        rollout.record_decision(1, &[1.0, 2.0, 3.0, 4.0], &decision(2, 1)).unwrap();
        rollout.record_outcome(1, &[5.0, 6.0], &[true, false], &[false, true]).unwrap();
        assert_eq!(rollout.obs, [0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(rollout.rewards, [0.0, 0.0, 5.0, 6.0, 0.0, 0.0]);
        assert_eq!(rollout.terminated, [false, false, true, false, false, false]);
        assert_eq!(rollout.truncated, [false, false, false, true, false, false]);
        rollout.check().unwrap();
    }

    #[test]
    fn wrong_lengths_late_steps_and_non_finite_rewards_are_rejected_by_name() {
        let mut rollout = Rollout::new(3, 2, 1, InputTransform::new(2, 0, 1.0).unwrap());
        let message = rollout.record_decision(0, &[1.0], &decision(2, 1)).unwrap_err().to_string();
        assert_eq!(message, "obs [N, O] has 1 elements, expected 4");
        assert!(rollout.record_outcome(3, &[0.0; 2], &[false; 2], &[false; 2]).is_err());
        rollout.record_outcome(2, &[0.0, f64::NAN], &[false; 2], &[false; 2]).unwrap();
        let message = rollout.check().unwrap_err().to_string();
        assert_eq!(message, "rewards of step 2, env 1 is NaN, expected a finite number");
    }
}
