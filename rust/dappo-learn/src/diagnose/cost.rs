//! What the mistakes of a diagnoser cost the policy that believes it.

use serde::Serialize;

use super::Report;
use crate::config::Config;
use crate::envs::EnvFactory;
use crate::error::{LearnError, Result};
use crate::evaluate::{Policy, evaluate_told};

/// One kind of mistake.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mistake {
    /// The true class.
    pub class: String,
    /// The class that was named.
    pub named: String,
    /// Share of the windows of the true class.
    pub share: f64,
    /// Forward reward of the policy that is told the truth.
    pub told_truth: f64,
    /// Forward reward of the policy that is told the mistake.
    pub told_mistake: f64,
}

/// The forward reward of a policy that is told every robot's diagnosis instead of its damage.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cost {
    /// Mean forward reward over the classes, told the truth.
    pub told_truth: f64,
    /// The same, told the diagnosis; mistakes are weighted by how often they were made.
    pub told_diagnosis: f64,
    /// The second as a share of the first: the gait-equivalent accuracy.
    pub gait_equivalent_accuracy: f64,
    /// The mistakes, those that cost most over all classes first.
    pub mistakes: Vec<Mistake>,
}

/// Runs the policy on every class, told the truth and every mistake that the report counts, from the same starts.
/// `None` once `stop` says so.
pub fn cost(
    report: &Report,
    policy: &dyn Policy,
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
    let made = |class: usize, named: usize| class == named || report.share(class, named) > 0.0;
    let pairs: Vec<(usize, usize)> = (0..names.len())
        .flat_map(|class| (0..names.len()).map(move |named| (class, named)))
        .filter(|&(class, named)| made(class, named))
        .collect();
    let Some(rewards) = evaluate_told(policy, config, &pairs, factory, stop)? else { return Ok(None) };
    let truth: Vec<f64> = (0..names.len())
        .filter_map(|class| pairs.iter().position(|&pair| pair == (class, class)).map(|index| rewards[index]))
        .collect();
    let mut mistakes: Vec<Mistake> = pairs
        .iter()
        .zip(&rewards)
        .filter(|((class, named), _)| class != named)
        .map(|(&(class, named), &told_mistake)| Mistake {
            class: names[class].clone(),
            named: names[named].clone(),
            share: report.share(class, named),
            told_truth: truth[class],
            told_mistake,
        })
        .collect();
    let loss = |mistake: &Mistake| mistake.share * (mistake.told_truth - mistake.told_mistake);
    mistakes.sort_by(|one, other| loss(other).total_cmp(&loss(one)));
    let told_truth = truth.iter().sum::<f64>() / names.len() as f64;
    let told_diagnosis = told_truth - mistakes.iter().map(loss).sum::<f64>() / names.len() as f64;
    Ok(Some(Cost {
        told_truth,
        told_diagnosis,
        gait_equivalent_accuracy: told_diagnosis / told_truth,
        mistakes,
    }))
}
