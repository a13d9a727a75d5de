//! What a training takes of the memory, estimated before anything is taken.

use dappo_nn::kernels::{lstm_sequence, parameter_count, partitions};
use dappo_sim::memory::{Bytes, of_envs};
use dappo_sim::{Layout, SimError};

use crate::config::Config;
use crate::sizes::Sizes;

/// Bytes of a number of the networks.
pub const FLOAT: usize = size_of::<f32>();
/// Copies of the parameters of a network while it learns: the network, the one before, two moments of Adam, the
/// gradient and what forms it.
pub const COPIES: usize = 8;

/// Fails if a training of this configuration, or the evaluation at its end, does not fit the memory.
pub fn check_training(
    config: &Config,
    sizes: Sizes,
    layout: &Layout,
    classes: usize,
) -> Result<(), SimError> {
    let (envs, rows) = (config.env.num_envs, Bytes::of(config.env.num_envs, config.horizon));
    let inputs = sizes.obs_dim.saturating_add(config.ppo.memory());
    let row = |obs: usize| FLOAT * (obs * inputs + 2 * sizes.action_dim + 9);
    // Observations of the rollout, those that the networks see, and both batches of the value net, which come later.
    let goes_on = config.total_steps > (envs * config.horizon) as u64;
    let rollout = rows.times(row(if goes_on { 5 } else { 3 }));
    let networks =
        network(config, inputs, sizes.action_dim).and(network(config, inputs, 1)).and(memory(config, sizes));
    let training = of_envs(envs, layout, sizes.obs_dim).and(rollout).and(networks);
    let lstm = config.ppo.lstm.map_or_else(String::new, |units| format!(" behind an LSTM of {units} units"));
    training.require(&format!(
        "a training with {envs} envs, a horizon of {} and hidden layers {:?}{lstm}",
        config.horizon, config.ppo.hidden
    ))?;
    let episodes = config.evaluation.episodes;
    of_envs(classes, layout, sizes.obs_dim)
        .times(episodes)
        .require(&format!("the evaluation of {classes} damage classes with {episodes} episodes each"))
}

/// A network of the policy or the values while it learns.
fn network(config: &Config, inputs: usize, outputs: usize) -> Bytes {
    let ppo = &config.ppo;
    let sizes = [&[inputs], ppo.hidden.as_slice(), &[outputs]].concat();
    let rows = 2 * config.env.num_envs * config.horizon;
    let minibatch = ppo.minibatch_size.max(ppo.value_minibatch_size).min(rows);
    let copies = COPIES + partitions(minibatch);
    parameters(parameter_count(&sizes)).times(copies * FLOAT)
}

/// The memory of a recurrent policy while it learns, and what the backward pass of a minibatch needs.
fn memory(config: &Config, sizes: Sizes) -> Bytes {
    let Some(units) = config.ppo.lstm else { return Bytes::of(0, 1) };
    let kept = Bytes::of(config.ppo.minibatch_size.max(config.horizon), FLOAT).times(8).times(units);
    parameters(lstm_sequence::parameter_count(sizes.obs_dim, units)).times((COPIES + 8) * FLOAT).and(kept)
}

/// Parameters of a network; `None` stands for more than can be counted.
#[must_use]
pub fn parameters(count: Option<usize>) -> Bytes {
    Bytes::of(count.unwrap_or(usize::MAX), 1)
}
