//! The policy and the value net, and the decisions that a rollout needs from them.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};

use super::Mlp;
use super::host::read;
use crate::error::{Result, check_length};
use crate::normalizer::Normalizer;

/// ln √(2π), the constant of a normal log-density.
pub(crate) const LN_SQRT_TAU: f64 = 0.918_938_533_204_672_7;
/// The last policy layer starts small, so that a new policy acts around 0 in every state and its noise
/// explores evenly (Andrychowicz et al., 2021, "What matters in on-policy RL", section 3.2).
const POLICY_OUTPUT_GAIN: f64 = 0.01;

/// A diagonal Gaussian whose standard deviation does not depend on the state.
#[derive(Module, Debug)]
pub struct GaussianPolicy {
    /// The mean of the action, given a normalised observation.
    pub mean: Mlp,
    /// Logarithm of the standard deviation of every action component, `[A]`.
    pub log_std: Param<Tensor<1>>,
}

/// The two separate networks of DA-PPO.
#[derive(Module, Debug)]
pub struct ActorCritic {
    /// The policy.
    pub policy: GaussianPolicy,
    /// The value net; its unit is that of rewards × (1 − γ).
    pub value: Mlp,
}

/// What the policy decided for N observations, and what the value net thinks of them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Decision {
    /// Sampled actions, unbounded, `[N, A]`.
    pub actions: Vec<f32>,
    /// Means of the actions, `[N, A]`.
    pub means: Vec<f32>,
    /// Log-densities of the actions, `[N]`.
    pub log_probs: Vec<f32>,
    /// V(obs), `[N]`.
    pub values: Vec<f32>,
}

impl ActorCritic {
    /// Draws new networks with the given hidden layers; `normal` yields standard normals.
    pub fn new(
        obs_dim: usize,
        hidden: &[usize],
        action_dim: usize,
        initial_log_std: f64,
        normal: &mut dyn FnMut() -> f64,
        device: &Device,
    ) -> Self {
        let sizes = |outputs: usize| [&[obs_dim], hidden, &[outputs]].concat();
        let log_std = TensorData::new(vec![initial_log_std as f32; action_dim], [action_dim]);
        Self {
            policy: GaussianPolicy {
                mean: Mlp::new(&sizes(action_dim), POLICY_OUTPUT_GAIN, normal, device),
                log_std: Param::from_data(log_std, device),
            },
            value: Mlp::new(&sizes(1), 1.0, normal, device),
        }
    }

    /// Length of an observation, damage code included.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.value.sizes().first().copied().unwrap_or(0)
    }

    /// Length of an action.
    #[must_use]
    pub fn action_dim(&self) -> usize {
        self.policy.log_std.lazy_shape()[0]
    }

    /// Logarithm of the policy's standard deviations, `[A]`.
    pub fn log_std(&self) -> Result<Vec<f32>> {
        read(self.policy.log_std.val())
    }

    /// Samples an action for every observation: action = mean + std · noise.
    ///
    /// The noise comes from the caller, who draws it from a counter-based stream.
    ///
    /// # Shapes
    /// obs `[N, O]`, raw; noise `[N, A]`, standard normal
    pub fn act(&self, obs: &[f32], normalizer: &Normalizer, noise: &[f32]) -> Result<Decision> {
        let rows = obs.len() / self.obs_dim();
        check_length("noise [N, A]", noise, rows * self.action_dim())?;
        let input = self.input(obs, normalizer)?;
        let means = self.policy.mean.apply(input.clone())?;
        let values = self.value.apply(input)?;
        let log_std = self.log_std()?;
        let std: Vec<f32> = log_std.iter().map(|log_std| log_std.exp()).collect();
        let constant = log_std.iter().map(|x| f64::from(*x) + LN_SQRT_TAU).sum::<f64>();
        let mut actions = means.clone();
        let mut log_probs = Vec::with_capacity(rows);
        for (actions, noise) in actions.chunks_exact_mut(std.len()).zip(noise.chunks_exact(std.len())) {
            let mut squares = 0.0;
            for ((action, z), std) in actions.iter_mut().zip(noise).zip(&std) {
                *action += std * z;
                squares += z * z;
            }
            log_probs.push((-0.5 * f64::from(squares) - constant) as f32);
        }
        Ok(Decision { actions, means, log_probs, values })
    }

    /// The most probable action of every observation, for evaluation.
    ///
    /// # Shapes
    /// obs `[N, O]`, raw; returns `[N, A]`
    pub fn mean_actions(&self, obs: &[f32], normalizer: &Normalizer) -> Result<Vec<f32>> {
        self.policy.mean.apply(self.input(obs, normalizer)?)
    }

    /// The value of every observation.
    ///
    /// # Shapes
    /// obs `[N, O]`, raw; returns `[N]`
    pub fn values(&self, obs: &[f32], normalizer: &Normalizer) -> Result<Vec<f32>> {
        self.value.apply(self.input(obs, normalizer)?)
    }

    /// Normalised observations, `[N, O]`.
    fn input(&self, obs: &[f32], normalizer: &Normalizer) -> Result<Vec<f32>> {
        let width = self.obs_dim();
        let tracked = width.saturating_sub(normalizer.code_length());
        check_length("mean of the normaliser", normalizer.mean(), tracked)?;
        normalizer.apply(obs)
    }
}

#[cfg(test)]
mod tests {
    use dappo_sim::rng::{Purpose, Stream};

    use super::*;
    use crate::ppo::loss::log_prob;

    const OBS: [f32; 6] = [0.1, -0.4, 1.0, 2.0, 0.3, 0.0];
    const NOISE: [f32; 4] = [0.5, -1.0, 0.0, 2.0];

    fn networks() -> (ActorCritic, Normalizer) {
        let mut stream = Stream::new(5, 0, Purpose::Weights);
        let device = Device::flex().autodiff();
        let networks = ActorCritic::new(3, &[8, 8], 2, -0.5, &mut || stream.normal(), &device);
        let mut normalizer = Normalizer::new(3, 1).unwrap();
        normalizer.update(&[0.0, 1.0, 1.0, 3.0, 2.0, 0.0]).unwrap();
        (networks, normalizer)
    }

    fn tensor(values: &[f32]) -> Tensor<2> {
        Tensor::from_data(TensorData::new(values.to_vec(), [values.len() / 2, 2]), &Device::flex())
    }

    #[test]
    fn actions_are_means_plus_scaled_noise_with_the_density_that_the_loss_computes() {
        let (networks, normalizer) = networks();
        let decision = networks.act(&OBS, &normalizer, &NOISE).unwrap();
        let std = (-0.5_f32).exp();
        for ((action, mean), z) in decision.actions.iter().zip(&decision.means).zip(NOISE) {
            assert!((action - mean - std * z).abs() < 1e-6);
        }
        let log_std = networks.policy.log_std.val().without_autodiff();
        let expected = read(log_prob(tensor(&decision.actions), tensor(&decision.means), log_std)).unwrap();
        for (got, expected) in decision.log_probs.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-5, "{got}, expected {expected}");
        }
    }

    #[test]
    fn acting_agrees_with_the_mean_action_the_value_and_the_composed_net() {
        let (networks, normalizer) = networks();
        let decision = networks.act(&OBS, &normalizer, &[0.0; 4]).unwrap();
        assert_eq!(decision.actions, decision.means);
        assert_eq!(decision.means, networks.mean_actions(&OBS, &normalizer).unwrap());
        assert_eq!(decision.values, networks.values(&OBS, &normalizer).unwrap());
        let rows = TensorData::new(normalizer.apply(&OBS).unwrap(), [2, 3]);
        let input = Tensor::from_data(rows, &Device::flex());
        let composed = read(networks.value.valid().forward(input)).unwrap();
        for (got, expected) in decision.values.iter().zip(composed) {
            assert!((got - expected).abs() < 1e-6, "{got}, expected {expected}");
        }
    }

    #[test]
    fn observations_of_another_length_and_too_little_noise_are_refused() {
        let (networks, normalizer) = networks();
        assert!(networks.act(&OBS, &normalizer, &NOISE[..2]).is_err());
        assert!(networks.act(&OBS[..5], &normalizer, &NOISE[..2]).is_err());
        assert!(networks.act(&OBS, &Normalizer::new(4, 1).unwrap(), &NOISE).is_err());
    }
}
