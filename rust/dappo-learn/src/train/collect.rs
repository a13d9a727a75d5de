//! Collecting a rollout: the policy acts for `horizon` steps in every env.

use dappo_sim::VectorEnv;
use dappo_sim::rng::{Purpose, Stream};
use rayon::prelude::*;

use crate::episodes::EpisodeTracker;
use crate::error::Result;
use crate::ppo::Ppo;
use crate::rollout::Rollout;

/// Runs the policy for `horizon` steps; `first_step` numbers them over the whole run, so that every
/// (env, step) has exploration noise of its own.
///
/// The envs must be in same-step mode.
pub fn collect(
    env: &mut VectorEnv,
    ppo: &Ppo,
    episodes: &mut EpisodeTracker,
    noise_keys: &[u64],
    first_step: u64,
    horizon: usize,
) -> Result<Rollout> {
    let (num_envs, action_dim) = (env.num_envs(), env.action_dim());
    let actor_critic = ppo.actor_critic();
    let mut rollout = Rollout::new(horizon, num_envs, action_dim, ppo.normalizer().clone());
    for step in 0..horizon {
        let noise = action_noise(noise_keys, first_step + step as u64, action_dim);
        let decision = actor_critic.act(&env.buffers().obs, &rollout.normalizer, &noise)?;
        rollout.record_decision(step, &env.buffers().obs, &decision)?;
        env.step(&decision.actions)?;
        let buffers = env.buffers();
        rollout.record_outcome(step, &buffers.rewards, &buffers.terminated, &buffers.truncated)?;
        bootstrap_truncations(&mut rollout, env, ppo, step)?;
        episodes.add(env.buffers());
    }
    rollout.last_values = actor_critic.values(&env.buffers().obs, &rollout.normalizer)?;
    Ok(rollout)
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

/// V(`final_obs`) of the episodes that the time limit cut short: their return goes on beyond it.
fn bootstrap_truncations(rollout: &mut Rollout, env: &VectorEnv, ppo: &Ppo, step: usize) -> Result<()> {
    let buffers = env.buffers();
    let cut: Vec<usize> =
        (0..env.num_envs()).filter(|&env| buffers.truncated[env] && !buffers.terminated[env]).collect();
    if cut.is_empty() {
        return Ok(());
    }
    let width = env.obs_dim();
    let rows: Vec<f32> =
        cut.iter().flat_map(|&env| &buffers.final_obs[env * width..(env + 1) * width]).copied().collect();
    let values = ppo.actor_critic().values(&rows, &rollout.normalizer)?;
    for (env, value) in cut.into_iter().zip(values) {
        rollout.final_values[step * buffers.rewards.len() + env] = value;
    }
    Ok(())
}
