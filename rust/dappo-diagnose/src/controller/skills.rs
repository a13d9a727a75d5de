//! What a controller has learned, part by part.

use dappo_learn::error::{LearnError, Result};
use dappo_nn::Policy;
use dappo_sim::backend::Backend;
use dappo_sim::task::Task;

use crate::Diagnoser;

/// The learned parts of a controller.
pub struct Skills {
    /// The damage-aware policy.
    pub policy: Policy,
    /// The policy that acts during a diagnosis window, as in the diagnoser's training.
    pub expert: Policy,
    /// The diagnoser.
    pub diagnoser: Diagnoser,
    /// Forward velocity of the policy with the true code, m/s, one a damage class; not known of a run that was not
    /// evaluated. Only a controller with twins needs them.
    pub baselines: Option<Vec<f64>>,
}

impl Skills {
    /// 1 / standard deviation of every position and velocity in training, 0 of all other entries of an observation:
    /// contact forces jump, so that the least noise of a sensor would pass for damage. `[O]`
    pub fn compared(&self, task: &Task) -> Result<Vec<f32>> {
        let entries = self.policy.standardizer()?.scale().iter().zip(task.shows_state());
        Ok(entries.map(|(scale, is_state)| if is_state { *scale } else { 0.0 }).collect())
    }

    /// Forward velocities of all classes.
    pub fn baselines(&self) -> Result<&[f64]> {
        self.baselines.as_deref().ok_or_else(|| {
            LearnError::Invalid(
                "the mean forward velocities of the policy are not known; `dappo-batch evaluate RUN` measures them"
                    .into(),
            )
        })
    }

    /// Fails unless all parts have the same robot and the same damage classes.
    pub fn check(&self) -> Result<()> {
        let Self { policy, expert, diagnoser, baselines } = self;
        let description = diagnoser.description();
        let subject = &description.subject;
        let code_length = policy.code_length();
        if code_length == 0 {
            return Err(LearnError::Invalid(
                "the policy does not observe the damage, so that it cannot adapt to it; train one without --unaware"
                    .into(),
            ));
        }
        let classes = subject.classes();
        equal(&[
            ("entries in an action of the expert", expert.action_dim(), policy.action_dim()),
            ("entries in the damage code of the policy", code_length, subject.code_length()),
            ("entries in an observation of the expert", expert.obs_dim(), policy.obs_dim()),
            ("entries in an observation of the diagnoser", description.obs_dim, policy.obs_dim()),
            ("entries in an action of the diagnoser", description.action_dim, policy.action_dim()),
            ("baselines", baselines.as_ref().map_or(classes, Vec::len), classes),
        ])
    }

    /// Fails unless the parts are those of the robot that a backend simulates.
    pub fn check_robot(&self, backend: &dyn Backend) -> Result<()> {
        let (policy, subject) = (&self.policy, &self.diagnoser.description().subject);
        equal(&[
            ("entries in an action of the policy", policy.action_dim(), backend.task().layout().nu),
            ("entries in an observation of the policy", policy.obs_dim(), backend.task().obs_dim()),
            ("damage classes of the diagnoser", subject.classes(), backend.num_classes()),
        ])
    }
}

/// Fails for the first size that is not as expected.
fn equal(sizes: &[(&str, usize, usize)]) -> Result<()> {
    match sizes.iter().find(|(_, got, expected)| got != expected) {
        None => Ok(()),
        Some((part, got, expected)) => Err(LearnError::Invalid(format!(
            "there are {got} {part}, expected {expected}; policy, expert and diagnoser must be of one robot"
        ))),
    }
}
