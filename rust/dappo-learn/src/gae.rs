//! Generalised advantage estimation (Schulman et al., 2016), as a pure function of a rollout.

use dappo_nn::error::check_finite;

use crate::error::{LearnError, Result};
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
///
/// # Shapes
/// values, returns `[B]`
#[must_use]
pub(crate) fn explained_variance(values: &[f32], returns: &[f32]) -> f64 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use dappo_nn::InputTransform;

    const REWARDS: [f32; 10] = [0.13, -0.13, 0.64, 0.10, -0.54, 0.36, 1.30, 0.95, -0.70, -1.27];
    const VALUES: [f32; 10] = [-0.62, 0.04, -2.33, -0.22, -1.25, -0.73, -0.54, -0.32, 0.41, 1.04];
    const FINAL_VALUES: [f32; 10] = [-0.13, 1.37, -0.67, 0.35, 0.90, 0.09, -0.74, -0.92, -0.46, 0.22];
    // γ = 0.9, λ = 0.8; env 0 terminates at step 1, env 1 is truncated at step 2. NumPy, by the definition
    // of GAE as a sum rather than by recursion:
    //   nxt = lambda t, n: 0 if term[t, n] else fv[t, n] if trunc[t, n] else v[t+1, n] if t+1 < T else last[n]
    //   for n in range(N):
    //       for t in range(T):
    //           k, w = t, 1.0
    //           while True:
    //               A[t, n] += w * ((1 - gamma) * r[k, n] + gamma * nxt(k, n) - v[k, n])
    //               if term[k, n] or trunc[k, n] or k + 1 == T: break
    //               k, w = k + 1, w * gamma * lam
    const ADVANTAGES: [f64; 10] =
        [0.25968, -0.119_355_2, 2.394, 0.18284, 0.738_022_4, 0.847, 0.03892, 0.37468, -1.389, -1.356];
    // A + v
    const RETURNS: [f64; 10] =
        [-0.36032, -0.079_355_2, 0.064, -0.03716, -0.511_977_6, 0.117, -0.50108, 0.05468, -0.979, -0.316];

    fn rollout() -> Rollout {
        let mut rollout = Rollout::new(5, 2, 1, InputTransform::new(1, 0, 1.0).unwrap());
        rollout.rewards = REWARDS.to_vec();
        rollout.values = VALUES.to_vec();
        rollout.final_values = FINAL_VALUES.to_vec();
        rollout.last_values = vec![-1.01, -0.21];
        rollout.terminated[2] = true;
        rollout.truncated[5] = true;
        rollout
    }

    fn assert_close(got: &[f32], expected: &[f64]) {
        for (index, (got, expected)) in got.iter().zip(expected).enumerate() {
            assert!((f64::from(*got) - expected).abs() < 1e-6, "[{index}] {got}, expected {expected}");
        }
    }

    #[test]
    fn advantages_and_returns_equal_numpy_across_terminations_and_truncations() {
        let targets = gae(&rollout(), 0.9, 0.8).unwrap();
        assert_close(&targets.advantages, &ADVANTAGES);
        assert_close(&targets.returns, &RETURNS);
    }

    #[test]
    fn a_termination_ignores_the_final_value_and_a_truncation_bootstraps_from_it() {
        let base = gae(&rollout(), 0.9, 0.8).unwrap();
        let mut changed = rollout();
        changed.final_values[2] = 100.0;
        assert_eq!(gae(&changed, 0.9, 0.8).unwrap(), base, "V(final_obs) of a terminated step");
        changed.final_values[5] += 1.0;
        let moved = gae(&changed, 0.9, 0.8).unwrap();
        assert!((moved.advantages[5] - base.advantages[5] - 0.9).abs() < 1e-6);
        changed.terminated[5] = true;
        let terminated = gae(&changed, 0.9, 0.8).unwrap().advantages[5];
        assert!((terminated - (0.1 * 0.36 + 0.73)).abs() < 1e-6, "termination wins over truncation");
    }

    #[test]
    fn nothing_crosses_the_boundary_of_an_episode() {
        let base = gae(&rollout(), 0.9, 0.8).unwrap();
        let mut changed = rollout();
        (changed.rewards[4], changed.values[4]) = (50.0, 50.0); // env 0, after its episode ended
        let moved = gae(&changed, 0.9, 0.8).unwrap();
        assert_eq!(moved.advantages[0], base.advantages[0]);
        assert_eq!(moved.advantages[2], base.advantages[2]);
    }

    #[test]
    fn a_constant_reward_is_its_own_value() {
        let mut rollout = rollout();
        rollout.terminated.fill(false);
        rollout.truncated.fill(false);
        rollout.rewards.fill(2.5);
        rollout.values.fill(2.5);
        rollout.last_values.fill(2.5);
        let targets = gae(&rollout, 0.995, 0.98).unwrap();
        assert_close(&targets.advantages, &[0.0; 10]);
        assert_close(&targets.returns, &[2.5; 10]);
    }

    #[test]
    fn a_discount_of_one_is_rejected() {
        let message = gae(&rollout(), 1.0, 0.8).unwrap_err().to_string();
        assert_eq!(message, "gamma is 1, expected a number in [0, 1)");
    }

    #[test]
    fn explained_variance_equals_numpy() {
        // 1 - np.var(returns - values) / np.var(returns), with the arrays above
        let returns = RETURNS.map(|x| x as f32);
        let got = explained_variance(&VALUES, &returns);
        assert!((got - -8.843_181_739).abs() < 1e-4, "{got}");
        assert!((explained_variance(&returns, &returns) - 1.0).abs() < 1e-12);
        assert_eq!(explained_variance(&VALUES, &[1.0; 10]), 0.0);
    }
}
