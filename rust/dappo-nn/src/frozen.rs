//! The policy and the value net of one iteration, as rollouts take them.

use std::borrow::Cow;

use crate::error::{Result, check_length};
use crate::memory::with_hidden;
use crate::{FrozenMlp, InputTransform, LN_SQRT_TAU, Policy, PolicyState};

/// What collects rollouts: a policy that explores, and a value net.
#[derive(Debug, Clone, PartialEq)]
pub struct FrozenActorCritic {
    /// Chooses the means of the actions.
    pub policy: Policy,
    /// Logarithm of the standard deviation of every action component, `[A]`.
    log_std: Vec<f32>,
    /// Its unit is that of rewards × (1 − γ). It is given the hidden state of the policy's memory, too.
    value: FrozenMlp,
    /// What the value net gets of a row: all of it. The policy gets the same without privileged entries.
    transform: InputTransform,
}

/// What the policy decided for N observations, and what the value net estimates of them.
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
    /// Hidden states of the policy's memory, `[N, H]`; empty for a policy without one.
    pub hidden: Vec<f32>,
}

impl FrozenActorCritic {
    /// A policy with a standard deviation for each action component, and a value net over rows that `transform`
    /// prepares: the policy's observation, then privileged entries, if any, then the damage code.
    ///
    /// # Shapes
    /// `log_std` `[A]`
    pub fn new(
        policy: Policy,
        log_std: Vec<f32>,
        value: FrozenMlp,
        transform: InputTransform,
    ) -> Result<Self> {
        check_length("log_std [A]", &log_std, policy.action_dim())?;
        let inputs = transform.width() + policy.initial_state(0).units();
        check_length("inputs of the value net", &vec![(); value.sizes()[0]], inputs)?;
        Ok(Self { policy, log_std, value, transform })
    }

    /// What becomes of a row of observations before the networks get it.
    #[must_use]
    pub fn transform(&self) -> &InputTransform {
        &self.transform
    }

    /// Logarithm of the policy's standard deviations, `[A]`.
    #[must_use]
    pub fn log_std(&self) -> &[f32] {
        &self.log_std
    }

    /// The value net.
    #[must_use]
    pub fn value(&self) -> &FrozenMlp {
        &self.value
    }

    /// Samples an action for every observation: action = mean + std · noise. What the policy remembers goes on by a step.
    ///
    /// The noise comes from the caller, which draws it from a counter-based stream.
    ///
    /// # Shapes
    /// obs `[N, O]`, raw, privileged entries included; noise `[N, A]`, standard normal; the state of N robots
    pub fn act(&self, obs: &[f32], noise: &[f32], state: &mut PolicyState) -> Result<Decision> {
        let input = self.transform.apply(obs)?;
        let means = self.policy.means(&self.seen(&input), state)?;
        check_length("noise [N, A]", noise, means.len())?;
        let hidden = state.hidden();
        let values = self.value.apply(&with_hidden(input.into(), &hidden, state.units()))?;
        let std: Vec<f32> = self.log_std.iter().map(|log_std| log_std.exp()).collect();
        let constant = self.log_std.iter().map(|x| f64::from(*x) + LN_SQRT_TAU).sum::<f64>();
        let mut actions = means.clone();
        let mut log_probs = Vec::with_capacity(values.len());
        for (actions, noise) in actions.chunks_exact_mut(std.len()).zip(noise.chunks_exact(std.len())) {
            let mut squares = 0.0;
            for ((action, z), std) in actions.iter_mut().zip(noise).zip(&std) {
                *action += std * z;
                squares += z * z;
            }
            log_probs.push((-0.5 * f64::from(squares) - constant) as f32);
        }
        Ok(Decision { actions, means, log_probs, values, hidden })
    }

    /// The value of every observation, which follows those that the policy remembers.
    ///
    /// # Shapes
    /// obs `[N, O]`, raw, privileged entries included; the state of N robots; returns `[N]`
    pub fn values(&self, obs: &[f32], state: &PolicyState) -> Result<Vec<f32>> {
        let input = self.transform.apply(obs)?;
        let mut after = state.clone();
        if let Some(memory) = self.policy.memory() {
            memory.step(&self.seen(&input), &mut after)?;
        }
        self.value.apply(&with_hidden(input.into(), &after.hidden(), after.units()))
    }

    /// Of transformed rows what the policy is given.
    fn seen<'a>(&self, rows: &'a [f32]) -> Cow<'a, [f32]> {
        unprivileged(rows, &self.transform, self.policy.transform().obs_dim())
    }
}

/// Rows without their privileged entries: the first `obs_dim` of each and the damage code. `transform` is that of the
/// whole rows.
#[must_use]
pub fn unprivileged<'a>(rows: &'a [f32], transform: &InputTransform, obs_dim: usize) -> Cow<'a, [f32]> {
    if obs_dim == transform.obs_dim() {
        return Cow::Borrowed(rows);
    }
    let mut seen = Vec::with_capacity(rows.len() / transform.width() * (obs_dim + transform.code_length()));
    for row in rows.chunks_exact(transform.width()) {
        seen.extend_from_slice(&row[..obs_dim]);
        seen.extend_from_slice(&row[transform.obs_dim()..]);
    }
    Cow::Owned(seen)
}

#[cfg(test)]
mod tests {
    use burn::module::Module;
    use burn::tensor::{Device, Tensor, TensorData};
    use dappo_sim::rng::{Purpose, Stream};

    use crate::host::read;
    use crate::{ActorCritic, ActorCriticSizes, LN_SQRT_TAU, Normalizer, PolicyState};

    const OBS: [f32; 6] = [0.1, -0.4, 1.0, 2.0, 0.3, 0.0];
    const NOISE: [f32; 4] = [0.5, -1.0, 0.0, 2.0];

    fn networks() -> (ActorCritic, Normalizer) {
        let mut stream = Stream::new(5, 0, Purpose::Weights);
        let device = Device::flex().autodiff();
        let sizes = ActorCriticSizes { obs_dim: 3, privileged: 0, memory: 0, hidden: &[8, 8], action_dim: 2 };
        let networks = ActorCritic::new(sizes, -0.5, &mut || stream.normal(), &device);
        let mut normalizer = Normalizer::new(3, 1).unwrap();
        normalizer.update(&[0.0, 1.0, 1.0, 3.0, 2.0, 0.0]).unwrap();
        (networks, normalizer)
    }

    #[test]
    fn actions_are_means_plus_scaled_noise_with_the_density_of_a_normal() {
        let (networks, normalizer) = networks();
        let decision =
            networks.frozen(&normalizer).unwrap().act(&OBS, &NOISE, &mut PolicyState::default()).unwrap();
        let std = (-0.5_f32).exp();
        for ((action, mean), z) in decision.actions.iter().zip(&decision.means).zip(NOISE) {
            assert!((action - mean - std * z).abs() < 1e-6);
        }
        let pairs = || decision.actions.iter().zip(&decision.means);
        let terms: Vec<f32> = pairs()
            .map(|(action, mean)| -0.5 * ((action - mean) / std).powi(2) + 0.5 - LN_SQRT_TAU as f32)
            .collect();
        for (got, terms) in decision.log_probs.iter().zip(terms.chunks(2)) {
            let expected = terms[0] + terms[1];
            assert!((got - expected).abs() < 1e-5, "{got}, expected {expected}");
        }
    }

    #[test]
    fn acting_agrees_with_the_mean_action_the_value_and_the_nets_of_burns_operations() {
        let (networks, normalizer) = networks();
        let frozen = networks.frozen(&normalizer).unwrap();
        let decision = frozen.act(&OBS, &[0.0; 4], &mut PolicyState::default()).unwrap();
        assert_eq!(decision.actions, decision.means);
        assert_eq!(decision.means, frozen.policy.mean_actions(&OBS).unwrap());
        assert_eq!(decision.values, frozen.values(&OBS, &PolicyState::default()).unwrap());
        let rows = TensorData::new(frozen.policy.transform().apply(&OBS).unwrap(), [2, 3]);
        let input = Tensor::from_data(rows, &Device::flex());
        for (got, net) in [(&decision.values, &networks.value), (&decision.means, &networks.policy.mean)] {
            let expected = read(net.valid().forward(input.clone())).unwrap();
            for (got, expected) in got.iter().zip(expected) {
                assert!((got - expected).abs() < 1e-6, "{got}, expected {expected}");
            }
        }
    }

    #[test]
    fn observations_of_another_length_and_too_little_noise_are_rejected() {
        let (networks, normalizer) = networks();
        let frozen = networks.frozen(&normalizer).unwrap();
        assert!(frozen.act(&OBS, &NOISE[..2], &mut PolicyState::default()).is_err());
        assert!(frozen.act(&OBS[..5], &NOISE[..2], &mut PolicyState::default()).is_err());
        assert!(networks.frozen(&Normalizer::new(4, 1).unwrap()).is_err());
    }
}
