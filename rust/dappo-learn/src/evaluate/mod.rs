//! Evaluation: the mean action of a policy on every damage class, with fixed seeds.

mod bootstrap;
mod comparison;
mod encoding;
mod tables;

use dappo_sim::DamageClass;
use dappo_sim::memory::Bytes;
use dappo_sim::rng::env_keys;
use dappo_sim::vector_env::{Autoreset, ResetOptions, VectorEnv, VectorEnvConfig};

use crate::config::Config;
use crate::envs::EnvFactory;
use crate::error::Result;
use crate::ppo::Ppo;

pub use bootstrap::{CONFIDENCE, Estimate, Gain, RESAMPLES};
pub use comparison::{ClassComparison, Comparison, RunEvaluation, RunSummary, Side, Summary};
use encoding::Encoder;
pub use encoding::Encoding;
pub use tables::{ALL, ClassResult, Evaluation, GroupResult, mean_velocities};

/// Chooses actions from raw observations.
pub trait Policy {
    /// The actions without exploration noise.
    ///
    /// # Shapes
    /// - `obs`: `[N, obs_dim]`, the damage code included if the policy observes it
    /// - output: `[N, action_dim]`
    fn mean_actions(&self, obs: &[f32]) -> Result<Vec<f32>>;
}

impl Policy for Ppo {
    fn mean_actions(&self, obs: &[f32]) -> Result<Vec<f32>> {
        self.actor_critic().mean_actions(obs, self.normalizer())
    }
}

/// Runs the episodes of every damage class, as many as the section `[evaluation]` says, all at once.
///
/// `stop` is asked before every step; once it says yes, the result is `None`.
pub fn evaluate(
    policy: &dyn Policy,
    config: &Config,
    encoding: Encoding,
    factory: &dyn EnvFactory,
    stop: &dyn Fn() -> bool,
) -> Result<Option<Evaluation>> {
    let (episodes, space) = (config.evaluation.episodes, factory.space());
    let classes: Vec<usize> = (0..space.classes().len()).collect();
    let mut batch = Batch::new(config, factory, &classes)?;
    let mut encoder = Encoder::new(encoding, &batch.env, space, &batch.keys, &batch.classes)?;
    let Some(sums) = batch.run(policy, &mut encoder, stop)? else { return Ok(None) };
    let results =
        space.classes().iter().zip(sums.chunks_exact(episodes)).map(|(class, sums)| summarize(class, sums));
    let simulator = factory.simulator(config.evaluation.compute());
    Ok(Some(Evaluation::new(encoding, simulator, results.collect())))
}

/// What a wrong diagnosis costs: the mean forward reward of a policy on a robot with the first class of each pair
/// that is told the second one, in the same episodes as [`evaluate`].
pub fn evaluate_told(
    policy: &dyn Policy,
    config: &Config,
    pairs: &[(usize, usize)],
    factory: &dyn EnvFactory,
    stop: &dyn Fn() -> bool,
) -> Result<Option<Vec<f64>>> {
    let (classes, told): (Vec<usize>, Vec<usize>) = pairs.iter().copied().unzip();
    let mut batch = Batch::new(config, factory, &classes)?;
    let mut encoder = Encoder::told(&batch.env, factory.space(), &told)?;
    let sums = batch.run(policy, &mut encoder, stop)?;
    let means = |sums: Vec<EpisodeSums>| {
        sums.chunks_exact(config.evaluation.episodes)
            .map(|sums| moments(sums.iter().map(|sum| sum.forward)).0)
            .collect()
    };
    Ok(sums.map(means))
}

/// The episodes of several damage classes, those of a class side by side.
struct Batch {
    env: VectorEnv,
    /// Random key of each episode. Episode e of every class starts from the same state, and so does that of every
    /// policy compared.
    keys: Vec<u64>,
    /// Damage class of each episode.
    classes: Vec<usize>,
}

impl Batch {
    fn new(config: &Config, factory: &dyn EnvFactory, classes: &[usize]) -> Result<Self> {
        let episodes = config.evaluation.episodes;
        // Seeds, classes and sums; the envs are checked where they are made.
        Bytes::of(classes.len(), 128)
            .times(episodes)
            .require(&format!("{episodes} episodes a damage class"))?;
        let starts = env_keys(config.evaluation.seed, episodes);
        let keys: Vec<u64> = classes.iter().flat_map(|_| &starts).copied().collect();
        let classes: Vec<usize> =
            classes.iter().flat_map(|&class| std::iter::repeat_n(class, episodes)).collect();
        let env = factory.make(
            VectorEnvConfig {
                keys: keys.clone(),
                autoreset: Autoreset::Disabled,
                ..factory.env_config(config)?
            },
            config.env.reward.as_deref(),
            config.evaluation.compute(),
        )?;
        Ok(Self { env, keys, classes })
    }

    /// Runs all episodes to their end.
    fn run(
        &mut self,
        policy: &dyn Policy,
        encoder: &mut Encoder,
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Vec<EpisodeSums>>> {
        let assigned: Vec<Option<usize>> = self.classes.iter().copied().map(Some).collect();
        self.env.reset(ResetOptions { classes: Some(&assigned), ..ResetOptions::default() })?;
        run_to_the_end(policy, &mut self.env, encoder, stop)
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct EpisodeSums {
    forward: f64,
    returns: f64,
    length: f64,
    fell: bool,
    diverged: bool,
    ended: bool,
}

/// Steps until the episode of every env has ended, or until `stop` says so.
fn run_to_the_end(
    policy: &dyn Policy,
    env: &mut VectorEnv,
    encoder: &mut Encoder,
    stop: &dyn Fn() -> bool,
) -> Result<Option<Vec<EpisodeSums>>> {
    let mut sums = vec![EpisodeSums::default(); env.num_envs()];
    while sums.iter().any(|sum| !sum.ended) {
        if stop() {
            return Ok(None);
        }
        let actions = policy.mean_actions(&encoder.encode(&env.buffers().obs))?;
        env.step(&actions)?;
        let buffers = env.buffers();
        for (env, sum) in sums.iter_mut().enumerate().filter(|(_, sum)| !sum.ended) {
            sum.forward += buffers.forward_velocity[env];
            sum.returns += buffers.rewards[env];
            sum.length += 1.0;
            sum.fell = buffers.terminated[env];
            sum.diverged = buffers.diverged[env];
            sum.ended = buffers.terminated[env] || buffers.truncated[env];
        }
    }
    Ok(Some(sums))
}

/// The result of a class from the sums over its episodes.
fn summarize(class: &DamageClass, episodes: &[EpisodeSums]) -> ClassResult {
    let forward = moments(episodes.iter().map(|sum| sum.forward));
    ClassResult {
        class: class.id,
        name: class.name.clone(),
        group: class.group.clone(),
        episodes: episodes.len(),
        forward_reward: forward.0,
        standard_error: forward.1,
        episode_return: moments(episodes.iter().map(|sum| sum.returns)).0,
        episode_length: moments(episodes.iter().map(|sum| sum.length)).0,
        falls: episodes.iter().filter(|sum| sum.fell).count(),
        diverged: episodes.iter().filter(|sum| sum.diverged).count(),
    }
}

/// Mean and standard error of the mean.
fn moments(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let values: Vec<f64> = values.collect();
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    if values.len() < 2 {
        return (mean, f64::NAN);
    }
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    (mean, (variance / count).sqrt())
}
