//! Rollouts of a vector env: policy and physics take turns, step by step.

use dappo_nn::{FrozenActorCritic, PolicyState};
use dappo_sim::VectorEnv;
use dappo_sim::curriculum::ClassDistribution;
use dappo_sim::rng::{Purpose, Stream, env_keys};
use dappo_sim::vector_env::{ResetOptions, VectorEnvSnapshot};
use rayon::prelude::*;

use super::RolloutEngine;
use crate::config::Config;
use crate::episodes::EpisodeTracker;
use crate::error::Result;
use crate::rollout::Rollout;

/// A vector env in same-step mode.
pub struct HostEngine {
    env: VectorEnv,
    /// Random keys of the exploration noise, one an env.
    noise_keys: Vec<u64>,
    horizon: usize,
}

impl HostEngine {
    /// Begins the first episodes of the envs of a configuration.
    pub fn new(mut env: VectorEnv, config: &Config) -> Result<Self> {
        env.reset(ResetOptions::default())?;
        let noise_keys = env_keys(config.seed, config.env.num_envs);
        Ok(Self { env, noise_keys, horizon: config.horizon })
    }
}

impl RolloutEngine for HostEngine {
    fn collect(
        &mut self,
        networks: &FrozenActorCritic,
        state: &mut PolicyState,
        episodes: &mut EpisodeTracker,
        first_step: u64,
    ) -> Result<Rollout> {
        let (num_envs, action_dim) = (self.env.num_envs(), self.env.action_dim());
        let env = &mut self.env;
        let mut rollout = Rollout::new(self.horizon, num_envs, action_dim, networks.transform().clone())
            .from_state(state.clone());
        for step in 0..self.horizon {
            let noise = action_noise(&self.noise_keys, first_step + step as u64, action_dim);
            let decision = networks.act(&env.buffers().obs, &noise, state)?;
            rollout.record_decision(step, &env.buffers().obs, &decision)?;
            env.step(&decision.actions)?;
            let buffers = env.buffers();
            rollout.record_outcome(step, &buffers.rewards, &buffers.terminated, &buffers.truncated)?;
            bootstrap_truncations(&mut rollout, env, networks, state, step)?;
            let buffers = env.buffers();
            for env in (0..num_envs).filter(|&env| buffers.terminated[env] || buffers.truncated[env]) {
                state.begin(env);
            }
            episodes.add(env.buffers());
        }
        rollout.last_values = networks.values(&env.buffers().obs, state)?;
        Ok(rollout)
    }

    fn set_class_distribution(&mut self, classes: ClassDistribution) -> Result<()> {
        Ok(self.env.set_class_distribution(classes)?)
    }

    fn diverged(&self) -> u64 {
        self.env.diverged()
    }

    fn snapshot(&self) -> Result<VectorEnvSnapshot> {
        Ok(self.env.snapshot()?)
    }

    fn restore(&mut self, snapshot: &VectorEnvSnapshot) -> Result<()> {
        Ok(self.env.restore(snapshot)?)
    }
}

/// Standard normals, `[N, A]`.
fn action_noise(keys: &[u64], step: u64, action_dim: usize) -> Vec<f32> {
    let mut noise = vec![0.0; keys.len() * action_dim];
    noise.par_chunks_mut(action_dim).with_min_len(64).zip(keys).for_each(|(row, &key)| {
        let mut stream = Stream::new(key, step, Purpose::ActionNoise);
        row.fill_with(|| stream.normal() as f32);
    });
    noise
}

/// V(`final_obs`) of the episodes that the time limit cut short: their return continues beyond it.
fn bootstrap_truncations(
    rollout: &mut Rollout,
    env: &VectorEnv,
    networks: &FrozenActorCritic,
    state: &PolicyState,
    step: usize,
) -> Result<()> {
    let buffers = env.buffers();
    let cut: Vec<usize> =
        (0..env.num_envs()).filter(|&env| buffers.truncated[env] && !buffers.terminated[env]).collect();
    if cut.is_empty() {
        return Ok(());
    }
    let width = env.obs_dim();
    let rows: Vec<f32> =
        cut.iter().flat_map(|&env| &buffers.final_obs[env * width..(env + 1) * width]).copied().collect();
    let values = networks.values(&rows, &state.of_robots(&cut))?;
    for (env, value) in cut.into_iter().zip(values) {
        rollout.final_values[step * buffers.rewards.len() + env] = value;
    }
    Ok(())
}
