//! Evaluation: the mean action of a policy on every damage class, with fixed seeds.

use std::fmt::Write as _;

use dappo_sim::rng::env_keys;
use dappo_sim::vector_env::{Autoreset, ResetOptions, VectorEnv, VectorEnvConfig};
use serde::Serialize;

use crate::config::Config;
use crate::envs::EnvFactory;
use crate::error::Result;
use crate::ppo::Ppo;

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

/// The result of one damage class.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClassResult {
    /// Damage class.
    pub class: usize,
    /// Its name.
    pub name: String,
    /// Its group.
    pub group: String,
    /// Episodes run.
    pub episodes: usize,
    /// Mean over episodes of Σ forward velocity, m/s.
    pub forward_reward: f64,
    /// Standard error of that mean; NaN for a single episode.
    pub standard_error: f64,
    /// Mean of Σ reward.
    pub episode_return: f64,
    /// Mean number of steps.
    pub episode_length: f64,
    /// Episodes that ended in failure.
    pub falls: usize,
}

/// The results of all damage classes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evaluation {
    /// Backend of the physics.
    pub backend: &'static str,
    /// Its floating-point format.
    pub precision: &'static str,
    /// One entry a class, in canonical order.
    pub classes: Vec<ClassResult>,
}

/// Runs the episodes of every damage class, as many as the section `[evaluation]` says, all at once.
///
/// `stop` is asked before every step; once it says yes, the result is `None`.
pub fn evaluate(
    policy: &dyn Policy,
    config: &Config,
    factory: &dyn EnvFactory,
    stop: &dyn Fn() -> bool,
) -> Result<Option<Evaluation>> {
    let episodes = config.evaluation.episodes;
    let classes = factory.space().classes().len();
    let envs = classes * episodes;
    // Episode e of every class starts from the same state, and so does that of every policy compared.
    let starts = env_keys(config.evaluation.seed, episodes);
    let mut env = factory.make(
        VectorEnvConfig {
            keys: (0..envs).map(|env| starts[env % episodes]).collect(),
            autoreset: Autoreset::Disabled,
            ..factory.env_config(config)?
        },
        config.env.reward.as_deref(),
        config.evaluation.precision,
    )?;
    let assigned: Vec<Option<usize>> = (0..envs).map(|env| Some(env / episodes)).collect();
    env.reset(ResetOptions { classes: Some(&assigned), ..ResetOptions::default() })?;
    let Some(sums) = run_to_the_end(policy, &mut env, stop)? else { return Ok(None) };
    let summarize = |class: &dappo_sim::DamageClass| {
        let of_class = &sums[class.id * episodes..(class.id + 1) * episodes];
        let forward = moments(of_class.iter().map(|sum| sum.forward));
        ClassResult {
            class: class.id,
            name: class.name.clone(),
            group: class.group.clone(),
            episodes,
            forward_reward: forward.0,
            standard_error: forward.1,
            episode_return: moments(of_class.iter().map(|sum| sum.returns)).0,
            episode_length: moments(of_class.iter().map(|sum| sum.length)).0,
            falls: of_class.iter().filter(|sum| sum.fell).count(),
        }
    };
    Ok(Some(Evaluation {
        backend: env.backend().name(),
        precision: env.backend().precision(),
        classes: factory.space().classes().iter().map(summarize).collect(),
    }))
}

#[derive(Debug, Clone, Copy, Default)]
struct EpisodeSums {
    forward: f64,
    returns: f64,
    length: f64,
    fell: bool,
    ended: bool,
}

/// Steps until the episode of every env has ended, or until `stop` says so.
fn run_to_the_end(
    policy: &dyn Policy,
    env: &mut VectorEnv,
    stop: &dyn Fn() -> bool,
) -> Result<Option<Vec<EpisodeSums>>> {
    let mut sums = vec![EpisodeSums::default(); env.num_envs()];
    while sums.iter().any(|sum| !sum.ended) {
        if stop() {
            return Ok(None);
        }
        let actions = policy.mean_actions(&env.buffers().obs)?;
        env.step(&actions)?;
        let buffers = env.buffers();
        for (env, sum) in sums.iter_mut().enumerate().filter(|(_, sum)| !sum.ended) {
            sum.forward += buffers.forward_velocity[env];
            sum.returns += buffers.rewards[env];
            sum.length += 1.0;
            sum.fell = buffers.terminated[env];
            sum.ended = buffers.terminated[env] || buffers.truncated[env];
        }
    }
    Ok(Some(sums))
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

impl Evaluation {
    /// Mean forward reward over all classes.
    #[must_use]
    pub fn mean_forward_reward(&self) -> f64 {
        self.classes.iter().map(|class| class.forward_reward).sum::<f64>() / self.classes.len() as f64
    }

    /// The table as CSV with a header line.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut text =
            "class,name,group,episodes,forward_reward,standard_error,episode_return,episode_length,\
                        falls,backend,precision\n"
                .to_owned();
        for c in &self.classes {
            let error =
                if c.standard_error.is_nan() { String::new() } else { format!("{:.4}", c.standard_error) };
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "{},{},{},{},{:.4},{error},{:.4},{:.2},{},{},{}",
                c.class,
                c.name,
                c.group,
                c.episodes,
                c.forward_reward,
                c.episode_return,
                c.episode_length,
                c.falls,
                self.backend,
                self.precision
            );
        }
        text
    }
}
