//! What a training takes of the memory, estimated before anything is taken.

use dappo_sim::memory::{Bytes, of_envs};
use dappo_sim::{Layout, SimError};

use crate::config::Config;
use crate::diagnose::{DiagnoserConfig, PairSource};
use crate::envs::Sizes;
use crate::nn::kernels::partitions;

/// Bytes of a number of the networks.
const FLOAT: usize = size_of::<f32>();
/// Copies of the parameters of a network while it learns: the network, the one before, two moments of Adam, the
/// gradient and what forms it.
const COPIES: usize = 8;
/// More of them for the gradient of a diagnoser, which is summed in so many parts.
const DIAGNOSER_COPIES: usize = COPIES + 8;

/// Fails if a training of this configuration, or the evaluation at its end, does not fit the memory.
pub fn check_training(
    config: &Config,
    sizes: Sizes,
    layout: &Layout,
    classes: usize,
) -> Result<(), SimError> {
    let (envs, rows) = (config.env.num_envs, Bytes::of(config.env.num_envs, config.horizon));
    let row = |obs: usize| FLOAT * (obs * sizes.obs_dim + 2 * sizes.action_dim + 9);
    // Observations of the rollout, those that the networks see, and both batches of the value net, which come later.
    let goes_on = config.total_steps > (envs * config.horizon) as u64;
    let rollout = rows.times(row(if goes_on { 5 } else { 3 }));
    let networks = network(config, sizes.obs_dim, sizes.action_dim).and(network(config, sizes.obs_dim, 1));
    let training = of_envs(envs, layout, sizes.obs_dim).and(rollout).and(networks);
    training.require(&format!(
        "a training with {envs} envs, a horizon of {} and hidden layers {:?}",
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
    let parameters =
        sizes.windows(2).fold(Bytes::default(), |sum, layer| sum.and(Bytes::of(layer[0] + 1, layer[1])));
    parameters.times(copies * FLOAT)
}

/// Fails if the training of a diagnoser does not fit the memory.
pub fn check_diagnoser(config: &DiagnoserConfig, source: &dyn PairSource) -> Result<(), SimError> {
    let DiagnoserConfig { timesteps, embedding, lstm, .. } = *config;
    let inputs = 2 * source.obs_dim() + source.action_dim();
    let samples = Bytes::of(config.rollouts.unwrap_or(source.rollouts()), source.classes());
    let outputs = source.classes();
    let dense = [&[lstm], config.hidden.as_slice(), &[outputs]].concat();
    let parameters = dense.windows(2).fold(
        Bytes::of(inputs + 1, embedding).and(Bytes::of(embedding + lstm + 2, 4 * lstm)),
        |sum, layer| sum.and(Bytes::of(layer[0] + 1, layer[1])),
    );
    // The input, the gates and states of the LSTM with their gradients, a step; and the dense layers.
    let step = Bytes::of(timesteps, 2 * inputs + 12 * lstm).and(Bytes::of(3, dense.iter().sum()));
    let minibatch = Bytes::of(config.minibatch_size, 1).min(samples);
    let activations = minibatch.product(step);
    parameters.times(DIAGNOSER_COPIES * FLOAT).and(activations.times(FLOAT)).and(samples.times(32)).require(&format!(
        "the training of a diagnoser with an embedding of {embedding}, an LSTM of {lstm}, hidden layers {:?} and \
         minibatches of {}",
        config.hidden, config.minibatch_size
    ))
}
