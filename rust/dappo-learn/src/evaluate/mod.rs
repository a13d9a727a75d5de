//! Evaluation: the mean action of a policy on every damage class, with fixed seeds.

mod bootstrap;
mod comparison;
mod conditions;
mod score;
mod tables;
mod text;
mod velocities;

use dappo_sim::DamageClass;

use crate::config::Config;
use crate::envs::EnvFactory;
use crate::error::Result;
use crate::statistics::{mean, standard_error};
use crate::walk::{Agent, Encoding, Episode, KnownClasses, MeanActions, Trial};

pub use bootstrap::{Estimate, Gain};
pub use comparison::{ClassComparison, Comparison, ComparisonSummary, RunEvaluation, RunSummary, Side};
pub use conditions::{Conditions, check_seeds};
pub use score::Score;
pub use tables::{ALL, ClassResult, Evaluation, GroupResult};
pub use text::seeds_text;
pub use velocities::MeanVelocities;

/// Runs the episodes of every damage class, as many as the section `[evaluation]` sets, all at once.
///
/// `stop` is called before every step; once it returns true, the result is `None`.
pub fn evaluate(
    policy: &dyn MeanActions,
    config: &Config,
    encoding: Encoding,
    factory: &dyn EnvFactory,
    stop: &dyn Fn() -> bool,
) -> Result<Option<Evaluation>> {
    let (sizes, space) = (factory.sizes(config)?, factory.space());
    encoding.check(sizes.code_length, space.classes().len())?;
    let known = KnownClasses::of(space);
    let mut agent = if config.env.observe_damage {
        Agent::Encoded(policy, &known, encoding)
    } else {
        Agent::Unaware(policy)
    };
    let trial = Trial::of_evaluation((0..space.classes().len()).collect(), config);
    let Some(walks) = trial.run(&mut agent, config, factory, stop)? else { return Ok(None) };
    let episodes = walks.episodes.chunks_exact(trial.episodes);
    let period = factory.control_period();
    let score = Score::of(factory.robot(), config.env.reward.as_deref())?;
    let steps = (score == Score::Tracking).then(|| factory.max_episode_steps(config));
    let results = space.classes().iter().zip(episodes);
    let results = results.map(|(class, episodes)| summarize(class, episodes, period, steps));
    let simulator = factory.simulator(factory.evaluation_physics());
    Ok(Some(Evaluation::new(encoding, simulator, results.collect())))
}

/// The result of a class from its episodes; `control_period` is the length of a step, s, and `commanded_steps` the
/// number of steps of an episode without a failure for a task whose tracking counts.
fn summarize(
    class: &DamageClass,
    episodes: &[Episode],
    control_period: f64,
    commanded_steps: Option<usize>,
) -> ClassResult {
    let forward: Vec<f64> = episodes.iter().map(|episode| episode.forward_reward).collect();
    let forward_reward = mean(forward.iter().copied());
    let of_episode = |steps| {
        episodes.iter().map(|episode| Score::Tracking.of_episode(episode, steps)).collect::<Vec<f64>>()
    };
    let trackings = commanded_steps.map(of_episode);
    let steps: usize = episodes.iter().map(|episode| episode.steps).sum();
    ClassResult {
        class: class.id,
        name: class.name.clone(),
        group: class.group.clone(),
        episodes: episodes.len(),
        forward_reward,
        standard_error: standard_error(&forward),
        forward_velocity: forward.iter().sum::<f64>() / steps as f64,
        distance: forward_reward * control_period,
        tracking: trackings.as_ref().map(|shares| mean(shares.iter().copied())),
        tracking_standard_error: trackings.as_deref().map(standard_error),
        episode_return: mean(episodes.iter().map(|episode| episode.episode_return)),
        episode_length: mean(episodes.iter().map(|episode| episode.steps as f64)),
        falls: episodes.iter().filter(|episode| episode.fell).count(),
        diverged: episodes.iter().filter(|episode| episode.diverged).count(),
    }
}
