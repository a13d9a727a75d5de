//! Rollouts on a GPU: policy, physics, rewards and resets in kernels, without a call of the host between two steps.

use dappo_nn::{CLIP, FrozenActorCritic, FrozenMlp, PolicyState};
use dappo_sim::backend::gpu::{Collected, GpuEnvs, Net, Networks};
use dappo_sim::curriculum::ClassDistribution;
use dappo_sim::vector_env::VectorEnvSnapshot;

use super::RolloutEngine;
use crate::episodes::EpisodeTracker;
use crate::error::Result;
use crate::rollout::Rollout;

/// Envs on a device.
pub struct GpuEngine {
    envs: GpuEnvs,
    horizon: usize,
    diverged: u64,
}

impl GpuEngine {
    /// An engine for rollouts of `horizon` steps.
    #[must_use]
    pub fn new(envs: GpuEnvs, horizon: usize) -> Self {
        Self { envs, horizon, diverged: 0 }
    }
}

impl RolloutEngine for GpuEngine {
    fn collect(
        &mut self,
        networks: &FrozenActorCritic,
        state: &mut PolicyState,
        episodes: &mut EpisodeTracker,
        first_step: u64,
    ) -> Result<Rollout> {
        networks.policy.refuse_memory()?;
        let transform = networks.transform();
        let standardizer = transform.standardizer();
        let device = Networks {
            policy: net(networks.policy.net()),
            value: net(networks.value()),
            log_std: networks.log_std(),
            statistics: standardizer.map(|s| (s.mean(), s.scale(), CLIP)),
            code_scale: transform.code_scale(),
        };
        let Collected {
            obs,
            actions,
            means,
            log_probs,
            values,
            final_values,
            last_values,
            rewards,
            forward_velocity,
            terminated,
            truncated,
            diverged,
        } = self.envs.collect(&device, self.horizon, first_step)?;
        self.diverged += diverged;
        let rollout = Rollout {
            horizon: self.horizon,
            num_envs: last_values.len(),
            obs_dim: transform.width(),
            action_dim: networks.log_std().len(),
            obs,
            actions,
            means,
            log_probs,
            rewards,
            terminated,
            truncated,
            values,
            final_values,
            last_values,
            transform: transform.clone(),
            state: state.clone(),
            hidden: Vec::new(),
        };
        episodes.add_rollout(&rollout, &forward_velocity)?;
        Ok(rollout)
    }

    fn set_class_distribution(&mut self, classes: ClassDistribution) -> Result<()> {
        self.envs.set_class_distribution(classes);
        Ok(())
    }

    fn diverged(&self) -> u64 {
        self.diverged
    }

    fn snapshot(&self) -> Result<VectorEnvSnapshot> {
        Ok(self.envs.snapshot()?)
    }

    fn restore(&mut self, snapshot: &VectorEnvSnapshot) -> Result<()> {
        Ok(self.envs.restore(snapshot)?)
    }
}

fn net(mlp: &FrozenMlp) -> Net<'_> {
    Net { sizes: mlp.sizes(), parameters: mlp.parameters() }
}
