//! What a controller has learned, part by part.

use dappo_sim::backend::Backend;

use crate::diagnose::{Diagnoser, Expert};
use crate::error::{LearnError, Result};
use crate::ppo::Ppo;

/// What a controller has learned.
pub struct Skills {
    /// The damage-aware policy.
    pub policy: Ppo,
    /// The policy that walks while the diagnoser watches, as it did in the diagnoser's training.
    pub expert: Expert,
    /// The diagnoser.
    pub diagnoser: Diagnoser,
    /// Forward velocity of the policy when it is told the truth, m/s, one a damage class.
    pub baselines: Vec<f64>,
}

impl Skills {
    /// Fails unless all parts know the same robot and the same damage classes.
    pub(super) fn check(&self, twins: &dyn Backend) -> Result<()> {
        let Self { policy, expert, diagnoser, baselines } = self;
        let description = diagnoser.description();
        let subject = &description.subject;
        let code_length = policy.normalizer().code_length();
        if code_length == 0 {
            return Err(LearnError::Invalid(
            "the policy does not observe the damage, so that it cannot adapt to it; train one without --unaware"
                .into(),
        ));
        }
        let obs_dim = twins.task().obs_dim();
        for (part, got, expected) in [
            ("entries in an observation of the policy", policy.normalizer().mean().len(), obs_dim),
            ("entries in the damage code of the policy", code_length, subject.code_length()),
            ("entries in an observation of the expert", expert.obs_dim(), obs_dim),
            ("entries in an observation of the diagnoser", description.obs_dim, obs_dim),
            ("entries in an action of the diagnoser", description.action_dim, twins.task().layout().nu),
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
