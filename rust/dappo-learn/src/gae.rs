//! Generalised advantage estimation (Schulman et al., 2016), as a pure function of a rollout.

use crate::error::{LearnError, Result, check_finite};
use crate::rollout::Rollout;

/// What the policy and the value net are trained towards.
#[derive(Debug, Clone, PartialEq)]
pub struct Targets {
    /// Advantages, not yet normalised, `[T, N]`, in the value net's unit.
    pub advantages: Vec<f32>,
    /// λ-returns, advantage + V(obs), `[T, N]`, in the value net's unit.
    pub returns: Vec<f32>,
}

/// Advantages and returns of a rollout.
///
/// Rewards are first scaled by (1 − γ): a constant reward then has itself as its value, so the value net
/// sees targets of the size of one reward, whatever γ is. With r̂ = (1 − γ) r,
///
/// ```text
/// δ_t = r̂_t + γ V_next − V(obs_t)
/// A_t = δ_t + γ λ A_{t+1}              the last term only within an episode
/// V_next = 0                           the step terminated its episode
///        = V(final_obs)                it truncated it: the robot would have gone on
///        = V(obs_{t+1})                otherwise
/// ```
///
/// A step that both terminates and truncates counts as terminated.
pub fn gae(rollout: &Rollout, gamma: f64, gae_lambda: f64) -> Result<Targets> {
    check_unit("gamma", gamma, "a number in [0, 1)", gamma < 1.0)?;
    check_unit("gae_lambda", gae_lambda, "a number in [0, 1]", true)?;
    rollout.check()?;
    let envs = rollout.num_envs;
    let mut advantages = vec![0.0_f32; rollout.len()];
    let mut returns = vec![0.0_f32; rollout.len()];
    for env in 0..envs {
        let mut next_advantage = 0.0;
        let mut next_value = f64::from(rollout.last_values[env]);
        for step in (0..rollout.horizon).rev() {
            let index = step * envs + env;
            let ended = rollout.terminated[index] || rollout.truncated[index];
            if rollout.terminated[index] {
                next_value = 0.0;
            } else if rollout.truncated[index] {
                next_value = f64::from(rollout.final_values[index]);
            }
            let value = f64::from(rollout.values[index]);
            let reward = (1.0 - gamma) * f64::from(rollout.rewards[index]);
            let delta = reward + gamma * next_value - value;
            let later = if ended { 0.0 } else { gamma * gae_lambda * next_advantage };
            next_advantage = delta + later;
            next_value = value;
            advantages[index] = next_advantage as f32;
            returns[index] = (next_advantage + value) as f32;
        }
    }
    Ok(Targets { advantages, returns })
}

fn check_unit(key: &'static str, value: f64, expected: &'static str, more: bool) -> Result<()> {
    check_finite(key, value)?;
    if (0.0..=1.0).contains(&value) && more {
        return Ok(());
    }
    Err(LearnError::Config { key, got: value.to_string(), expected })
}

/// The share of the variance of the returns that the values predicted, 1 − Var(returns − values) /
/// Var(returns): 1 is perfect, 0 is no better than a constant. 0 if the returns do not vary.
#[must_use]
pub fn explained_variance(values: &[f32], returns: &[f32]) -> f64 {
    let variance = |xs: &mut dyn Iterator<Item = f64>| {
        let xs: Vec<f64> = xs.collect();
        let mean = xs.iter().sum::<f64>() / xs.len() as f64;
        xs.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / xs.len() as f64
    };
    let total = variance(&mut returns.iter().map(|x| f64::from(*x)));
    let pairs = returns.iter().zip(values);
    let residual = variance(&mut pairs.map(|(r, v)| f64::from(*r) - f64::from(*v)));
    if total > 0.0 { 1.0 - residual / total } else { 0.0 }
}
