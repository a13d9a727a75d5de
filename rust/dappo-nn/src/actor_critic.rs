//! The policy and the value net, as they are trained.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};

use crate::error::Result;
use crate::host::read;
use crate::{FrozenActorCritic, Mlp, Normalizer, Policy};

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

impl ActorCritic {
    /// Draws new networks with hidden layers of the given widths; `normal` yields standard normals. The value net
    /// observes rows of `obs_dim` entries, the policy the same without `privileged` ones of them.
    pub fn new(
        obs_dim: usize,
        privileged: usize,
        hidden: &[usize],
        action_dim: usize,
        initial_log_std: f64,
        normal: &mut dyn FnMut() -> f64,
        device: &Device,
    ) -> Self {
        let sizes = |inputs: usize, outputs: usize| [&[inputs], hidden, &[outputs]].concat();
        let log_std = TensorData::new(vec![initial_log_std as f32; action_dim], [action_dim]);
        Self {
            policy: GaussianPolicy {
                mean: Mlp::new(&sizes(obs_dim - privileged, action_dim), POLICY_OUTPUT_GAIN, normal, device),
                log_std: Param::from_data(log_std, device),
            },
            value: Mlp::new(&sizes(obs_dim, 1), 1.0, normal, device),
        }
    }

    /// Length of an observation, privileged entries and damage code included.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.value.sizes().first().copied().unwrap_or(0)
    }

    /// Number of entries of an observation that the value net alone is given.
    #[must_use]
    pub fn privileged(&self) -> usize {
        self.obs_dim() - self.policy.mean.sizes().first().copied().unwrap_or(0)
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

    /// What is left of the networks for acting, on observations with these statistics.
    pub fn frozen(&self, normalizer: &Normalizer) -> Result<FrozenActorCritic> {
        let transform = normalizer.transform()?;
        let seen = transform.without_privileged(self.privileged())?;
        let policy = Policy::new(self.policy.mean.frozen()?, seen)?;
        FrozenActorCritic::new(policy, self.log_std()?, self.value.frozen()?, transform)
    }
}
