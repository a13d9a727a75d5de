//! The policy and the value net, as they are trained.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};

use crate::error::Result;
use crate::host::read;
use crate::{FrozenActorCritic, Lstm, Mlp, Normalizer, Policy};

/// The last policy layer starts small, so that a new policy acts around 0 in every state and its noise
/// explores evenly (Andrychowicz et al., 2021, "What matters in on-policy RL", section 3.2).
const POLICY_OUTPUT_GAIN: f64 = 0.01;

/// A diagonal Gaussian whose standard deviation does not depend on the state.
#[derive(Module, Debug)]
pub struct GaussianPolicy {
    /// What a recurrent policy remembers of its normalised observations.
    pub memory: Option<Lstm>,
    /// The mean of the action, given a normalised observation and, behind it, the hidden state of the memory.
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

/// Widths of the two networks.
#[derive(Debug, Clone, Copy)]
pub struct ActorCriticSizes<'a> {
    /// Length of an observation, privileged entries and damage code included.
    pub obs_dim: usize,
    /// Number of entries of an observation that the value net alone is given.
    pub privileged: usize,
    /// Width of the hidden state of the policy's memory, which the value net is given, too; 0 for a policy without one.
    pub memory: usize,
    /// Hidden layers of both networks.
    pub hidden: &'a [usize],
    /// Length of an action.
    pub action_dim: usize,
}

impl ActorCriticSizes<'_> {
    /// Length of what the policy observes, damage code included.
    #[must_use]
    pub fn seen(&self) -> usize {
        self.obs_dim - self.privileged
    }

    /// `[inputs, hidden…, outputs]` of the net for the mean.
    #[must_use]
    pub fn mean(&self) -> Vec<usize> {
        [&[self.seen() + self.memory], self.hidden, &[self.action_dim]].concat()
    }

    /// `[inputs, hidden…, outputs]` of the value net.
    #[must_use]
    pub fn value(&self) -> Vec<usize> {
        [&[self.obs_dim + self.memory], self.hidden, &[1]].concat()
    }
}

impl ActorCritic {
    /// Draws new networks; `normal` yields standard normals.
    pub fn new(
        sizes: ActorCriticSizes<'_>,
        initial_log_std: f64,
        normal: &mut dyn FnMut() -> f64,
        device: &Device,
    ) -> Self {
        let ActorCriticSizes { memory, action_dim, .. } = sizes;
        let log_std = TensorData::new(vec![initial_log_std as f32; action_dim], [action_dim]);
        Self {
            policy: GaussianPolicy {
                memory: (memory > 0).then(|| Lstm::new(sizes.seen(), memory, normal, device)),
                mean: Mlp::new(&sizes.mean(), POLICY_OUTPUT_GAIN, normal, device),
                log_std: Param::from_data(log_std, device),
            },
            value: Mlp::new(&sizes.value(), 1.0, normal, device),
        }
    }

    /// Length of an observation, privileged entries and damage code included.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.value.sizes().first().copied().unwrap_or(0) - self.memory()
    }

    /// Width of the hidden state of the policy's memory; 0 for a policy without one.
    #[must_use]
    pub fn memory(&self) -> usize {
        self.policy.memory.as_ref().map_or(0, Lstm::units)
    }

    /// Number of entries of an observation that the value net alone is given.
    #[must_use]
    pub fn privileged(&self) -> usize {
        self.obs_dim() + self.memory() - self.policy.mean.sizes().first().copied().unwrap_or(0)
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
        let memory = self.policy.memory.as_ref().map(Lstm::frozen).transpose()?;
        let policy = Policy::recurrent(memory, self.policy.mean.frozen()?, seen)?;
        FrozenActorCritic::new(policy, self.log_std()?, self.value.frozen()?, transform)
    }
}
