//! Policies that act while robots are recorded.

use dappo_learn::error::{LearnError, Result};
use dappo_learn::walk::MeanActions;
use dappo_learn::{RunPolicy, Sizes};
use dappo_nn::PolicyState;

use crate::dataset::PolicyId;

/// A policy without memory: that of a run, or of another learner.
///
/// It acts for many robots at once and for their twins in between, so that its actions must depend on the current
/// observations alone.
pub struct ActingPolicy<'a> {
    policy: &'a (dyn MeanActions + Sync),
    /// Length of an observation, without damage code.
    obs_dim: usize,
    code_length: usize,
    id: PolicyId,
}

impl<'a> ActingPolicy<'a> {
    /// The policy of a run.
    #[must_use]
    pub fn of_run(run: &'a RunPolicy) -> Self {
        let (obs_dim, code_length) = (run.policy.obs_dim(), run.policy.code_length());
        Self { policy: &run.policy, obs_dim, code_length, id: PolicyId::of(run) }
    }

    /// A policy of another learner, for observations and damage codes of these lengths.
    #[must_use]
    pub fn of_other(policy: &'a (dyn MeanActions + Sync), name: &str, sizes: Sizes) -> Self {
        let id = PolicyId { run: name.to_owned(), fingerprint: name.to_owned(), env_steps: 0 };
        Self { policy, obs_dim: sizes.seen(), code_length: sizes.code_length, id }
    }

    /// Length of the damage code; 0 for a policy that observes no damage.
    pub(super) fn code_length(&self) -> usize {
        self.code_length
    }

    /// What the header of a dataset has of it.
    pub(super) fn id(&self) -> &PolicyId {
        &self.id
    }

    /// Fails unless it is for robots that observe so many numbers.
    pub(super) fn check(&self, robot: &str, obs_dim: usize) -> Result<()> {
        if self.obs_dim == obs_dim {
            return Ok(());
        }
        Err(LearnError::Invalid(format!(
            "the policy in {} observes {} numbers, expected {obs_dim} of robot `{robot}`",
            self.id.run, self.obs_dim
        )))
    }

    /// The actions for observations with damage codes, if it observes damage.
    ///
    /// # Shapes
    /// rows `[N, obs_dim + code_length]`; returns `[N, A]`
    pub(super) fn actions(&self, rows: &[f32]) -> Result<Vec<f32>> {
        self.policy.mean_actions(rows, &mut PolicyState::default())
    }

    /// The actions where every robot is assumed healthy.
    ///
    /// # Shapes
    /// obs `[N, obs_dim]`; returns `[N, A]`
    pub(super) fn healthy_actions(&self, obs: &[f32]) -> Result<Vec<f32>> {
        if self.code_length == 0 {
            return self.actions(obs);
        }
        let code = vec![0.0; self.code_length];
        let rows = obs.chunks_exact(self.obs_dim).flat_map(|row| row.iter().chain(&code));
        self.actions(&rows.copied().collect::<Vec<f32>>())
    }
}
