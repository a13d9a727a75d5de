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
    /// Forward velocity of the policy with the true code, m/s, one a damage class.
    pub baselines: Vec<f64>,
}

impl Skills {
    /// 1 / standard deviation of every position and velocity in training, 0 of all other entries of an observation:
    /// contact forces jump, so that the least noise of a sensor would pass for damage. `[O]`
    pub fn compared(&self, task: &Task) -> Result<Vec<f32>> {
        let entries = self.policy.standardizer()?.scale().iter().zip(task.shows_state());
        Ok(entries.map(|(scale, is_state)| if is_state { *scale } else { 0.0 }).collect())
    }

    /// Fails unless all parts have the same robot and the same damage classes.
    pub fn check(&self, twins: &dyn Backend) -> Result<()> {
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
        let obs_dim = twins.task().obs_dim();
        let nu = twins.task().layout().nu;
        for (part, got, expected) in [
            ("entries in an action of the policy", policy.action_dim(), nu),
            ("entries in an action of the expert", expert.action_dim(), nu),
            ("entries in an observation of the policy", policy.obs_dim(), obs_dim),
            ("entries in the damage code of the policy", code_length, subject.code_length()),
            ("entries in an observation of the expert", expert.obs_dim(), obs_dim),
            ("entries in an observation of the diagnoser", description.obs_dim, obs_dim),
            ("entries in an action of the diagnoser", description.action_dim, nu),
            ("damage classes of the diagnoser", subject.classes(), twins.num_classes()),
            ("baselines", baselines.len(), subject.classes()),
        ] {
            if got != expected {
                return Err(LearnError::Invalid(format!(
                    "there are {got} {part}, expected {expected}; policy, expert and diagnoser must be of one robot"
                )));
            }
        }
        Ok(())
    }
}
