//! The policy that both robots of a pair follow.

use crate::actor::Actor;
use crate::error::Result;
use crate::evaluate::Policy;

/// A trained policy that takes every robot for healthy: if it has a damage code, the code is that of no damage.
pub struct Expert {
    actor: Actor,
}

impl Expert {
    /// Wraps a policy.
    #[must_use]
    pub fn new(actor: Actor) -> Self {
        Self { actor }
    }

    /// The policy itself.
    #[must_use]
    pub fn actor(&self) -> &Actor {
        &self.actor
    }

    /// Length of an observation, without damage code.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.actor.obs_dim()
    }

    /// The most probable actions.
    ///
    /// # Shapes
    /// - `obs`: `[N, obs_dim]`, raw; output: `[N, action_dim]`
    pub fn actions(&self, obs: &[f32]) -> Result<Vec<f32>> {
        let code = vec![0.0; self.actor.code_length()];
        if code.is_empty() {
            return self.actor.mean_actions(obs);
        }
        let rows: Vec<f32> =
            obs.chunks_exact(self.obs_dim()).flat_map(|row| row.iter().chain(&code)).copied().collect();
        self.actor.mean_actions(&rows)
    }
}
