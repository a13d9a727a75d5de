//! What the mistakes of a diagnoser cost the policy that receives its diagnoses.

use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::error::{LearnError, Result};
use dappo_learn::evaluate::Score;
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
    /// Score of the policy with the code of the true class, mean over episodes.
    pub true_score: f64,
    /// Score of the policy with the code of the diagnosed class.
    pub mistaken_score: f64,
}

/// The score of a policy that has the code of every robot's diagnosis instead of its damage's.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cost {
    /// What the scores are: forward rewards, m/s, or the tracking of commands, from 0 to 1.
    pub compared_by: Score,
    /// Mean score over the classes, with the true code.
    pub true_score: f64,
    /// The same with the code of the diagnosis; mistakes are weighted by how often they were made.
    pub diagnosed_score: f64,
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
    let Some(scores) = scores(policy, config, &pairs, factory, stop)? else { return Ok(None) };
    let truth: Vec<f64> = (0..names.len())
        .filter_map(|class| pairs.iter().position(|&pair| pair == (class, class)).map(|index| scores[index]))
        .collect();
    let mut mistakes: Vec<Mistake> = pairs
        .iter()
        .zip(&scores)
        .filter(|((class, diagnosed), _)| class != diagnosed)
        .map(|(&(class, diagnosed), &mistaken_score)| Mistake {
            class: names[class].clone(),
            diagnosed: names[diagnosed].clone(),
            share: report.share(class, diagnosed),
            true_score: truth[class],
            mistaken_score,
        })
        .collect();
    let loss = |mistake: &Mistake| mistake.share * (mistake.true_score - mistake.mistaken_score);
    mistakes.sort_by(|one, other| loss(other).total_cmp(&loss(one)));
    let true_score = truth.iter().sum::<f64>() / names.len() as f64;
    let diagnosed_score = true_score - mistakes.iter().map(loss).sum::<f64>() / names.len() as f64;
    Ok(Some(Cost {
        compared_by: Score::of(factory.robot(), config.env.reward.as_deref())?,
        true_score,
        diagnosed_score,
        gait_equivalent_accuracy: diagnosed_score / true_score,
        mistakes,
    }))
}

/// The mean score of a policy with the code of the second class of each pair, on robots with the first.
///
/// # Shapes
/// pairs `[P]`; returns `[P]`
fn scores(
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
    let score = Score::of(factory.robot(), config.env.reward.as_deref())?;
    let steps = factory.max_episode_steps(config);
    let mean = |episodes: &[Episode]| mean(episodes.iter().map(|episode| score.of_episode(episode, steps)));
    Ok(walks.map(|walks| walks.episodes.chunks_exact(trial.episodes).map(mean).collect()))
}
