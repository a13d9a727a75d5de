//! The policy that both robots of a pair follow.

use crate::error::Result;
use crate::evaluate::Policy;
use crate::ppo::Ppo;

/// A trained policy that takes every robot for healthy: if it has a damage code, the code is that of no damage.
pub struct Expert {
    ppo: Ppo,
}

impl Expert {
    /// Wraps a policy.
    #[must_use]
    pub fn new(ppo: Ppo) -> Self {
        Self { ppo }
    }

    /// Length of an observation, without damage code.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.ppo.normalizer().mean().len()
    }

    /// The most probable actions.
    ///
    /// # Shapes
    /// - `obs`: `[N, obs_dim]`, raw; output: `[N, action_dim]`
    pub fn actions(&self, obs: &[f32]) -> Result<Vec<f32>> {
        let code = vec![0.0; self.ppo.normalizer().code_length()];
        if code.is_empty() {
            return self.ppo.mean_actions(obs);
        }
        let rows: Vec<f32> =
            obs.chunks_exact(self.obs_dim()).flat_map(|row| row.iter().chain(&code)).copied().collect();
        self.ppo.mean_actions(&rows)
    }
}
