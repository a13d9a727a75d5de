//! What the mistakes of a diagnoser cost the policy that receives its diagnoses.

use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::error::{LearnError, Result};
use dappo_learn::statistics::mean;
use dappo_learn::walk::{Agent, Encoding, Episode, KnownClasses, MeanActions, Trial};
use serde::Serialize;

use super::Report;

/// One kind of mistake.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mistake {
    /// The true class.
    pub class: String,
    /// The diagnosed class.
    pub diagnosed: String,
    /// Share of the windows of the true class, 0 to 1.
    pub share: f64,
    /// Forward reward of the policy with the code of the true class: mean over episodes of Σ forward velocity, m/s.
    pub true_reward: f64,
    /// Forward reward of the policy with the code of the diagnosed class, m/s.
    pub mistaken_reward: f64,
}

/// The forward reward of a policy that has the code of every robot's diagnosis instead of its damage's.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cost {
    /// Mean forward reward over the classes, with the true code, m/s.
    pub true_reward: f64,
    /// The same with the code of the diagnosis, m/s; mistakes are weighted by how often they were made.
    pub diagnosed_reward: f64,
    /// The second as a share of the first, the gait-equivalent accuracy; 1 without mistakes that cost anything.
    pub gait_equivalent_accuracy: f64,
    /// The mistakes, those that cost most over all classes first.
    pub mistakes: Vec<Mistake>,
}

/// Runs the policy on every class, with the true code and that of every mistake that the report counts, in
/// the same episodes as [`evaluate`](dappo_learn::evaluate::evaluate). `None` once `stop` returns true.
pub fn cost(
    report: &Report,
    policy: &dyn MeanActions,
    config: &Config,
    factory: &dyn EnvFactory,
    stop: &dyn Fn() -> bool,
) -> Result<Option<Cost>> {
    let names = &report.class_names;
    let expected: Vec<&String> = factory.space().classes().iter().map(|class| &class.name).collect();
    if expected != names.iter().collect::<Vec<_>>() {
        return Err(LearnError::Invalid(format!(
            "the policy was trained with {} damage classes, the diagnoser with {} or with others",
            expected.len(),
            names.len()
        )));
    }
    let made = |class: usize, diagnosed: usize| class == diagnosed || report.share(class, diagnosed) > 0.0;
    let pairs: Vec<(usize, usize)> = (0..names.len())
        .flat_map(|class| (0..names.len()).map(move |diagnosed| (class, diagnosed)))
        .filter(|&(class, diagnosed)| made(class, diagnosed))
        .collect();
    let Some(rewards) = rewards(policy, config, &pairs, factory, stop)? else { return Ok(None) };
    let truth: Vec<f64> = (0..names.len())
        .filter_map(|class| pairs.iter().position(|&pair| pair == (class, class)).map(|index| rewards[index]))
        .collect();
    let mut mistakes: Vec<Mistake> = pairs
        .iter()
        .zip(&rewards)
        .filter(|((class, diagnosed), _)| class != diagnosed)
        .map(|(&(class, diagnosed), &mistaken_reward)| Mistake {
            class: names[class].clone(),
            diagnosed: names[diagnosed].clone(),
            share: report.share(class, diagnosed),
            true_reward: truth[class],
            mistaken_reward,
        })
        .collect();
    let loss = |mistake: &Mistake| mistake.share * (mistake.true_reward - mistake.mistaken_reward);
    mistakes.sort_by(|one, other| loss(other).total_cmp(&loss(one)));
    let true_reward = truth.iter().sum::<f64>() / names.len() as f64;
    let diagnosed_reward = true_reward - mistakes.iter().map(loss).sum::<f64>() / names.len() as f64;
    Ok(Some(Cost {
        true_reward,
        diagnosed_reward,
        gait_equivalent_accuracy: diagnosed_reward / true_reward,
        mistakes,
    }))
}

/// The mean forward reward of a policy with the code of the second class of each pair, on robots with the
/// first, m/s.
///
/// # Shapes
/// pairs `[P]`; returns `[P]`
fn rewards(
    policy: &dyn MeanActions,
    config: &Config,
    pairs: &[(usize, usize)],
    factory: &dyn EnvFactory,
    stop: &dyn Fn() -> bool,
) -> Result<Option<Vec<f64>>> {
    let (sizes, space) = (factory.sizes(config)?, factory.space());
    Encoding::Wrong.check(sizes.code_length, space.classes().len())?;
    let known = KnownClasses::of(space);
    let (classes, given): (Vec<usize>, Vec<usize>) = pairs.iter().copied().unzip();
    let trial = Trial::of_evaluation(classes, config);
    let walks = trial.run(&mut Agent::Given(policy, &known, &given), config, factory, stop)?;
    let mean = |episodes: &[Episode]| mean(episodes.iter().map(|episode| episode.forward_reward));
    Ok(walks.map(|walks| walks.episodes.chunks_exact(trial.episodes).map(mean).collect()))
}
