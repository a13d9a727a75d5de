//! A policy that no longer changes.

use crate::error::{NnError, Result, check_length};
use crate::memory::with_hidden;
use crate::{FrozenLstm, FrozenMlp, InputTransform, PolicyState, Standardizer};

/// Chooses the most probable actions. It has no value net and no optimiser, and its statistics stay as they are.
#[derive(Debug, Clone, PartialEq)]
pub struct Policy {
    transform: InputTransform,
    memory: Option<FrozenLstm>,
    net: FrozenMlp,
}

impl Policy {
    /// A network over transformed observations.
    pub fn new(net: FrozenMlp, transform: InputTransform) -> Result<Self> {
        Self::recurrent(None, net, transform)
    }

    /// A network over transformed observations and the hidden state of a memory, if there is one.
    pub fn recurrent(memory: Option<FrozenLstm>, net: FrozenMlp, transform: InputTransform) -> Result<Self> {
        let (got, width) = (net.sizes(), transform.width());
        let expected = width + memory.as_ref().map_or(0, FrozenLstm::units);
        if got[0] != expected {
            return Err(NnError::Invalid(format!(
                "the layers of the policy have widths {got:?}, expected {expected} inputs"
            )));
        }
        if let Some(got) = memory.as_ref().map(FrozenLstm::inputs).filter(|inputs| *inputs != width) {
            return Err(NnError::Invalid(format!(
                "the memory of the policy has {got} inputs, expected {width}"
            )));
        }
        Ok(Self { transform, memory, net })
    }

    /// The memory of a recurrent policy.
    #[must_use]
    pub fn memory(&self) -> Option<&FrozenLstm> {
        self.memory.as_ref()
    }

    /// What it remembers of `robots` robots at the start of their episodes.
    #[must_use]
    pub fn initial_state(&self, robots: usize) -> PolicyState {
        PolicyState::new(robots, self.memory.as_ref().map_or(0, FrozenLstm::units))
    }

    /// The network.
    #[must_use]
    pub fn net(&self) -> &FrozenMlp {
        &self.net
    }

    /// What the network gets of an observation.
    #[must_use]
    pub fn transform(&self) -> &InputTransform {
        &self.transform
    }

    /// Length of an observation, without damage code.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.transform.obs_dim()
    }

    /// Length of the damage code; 0 for a policy that observes no damage.
    #[must_use]
    pub fn code_length(&self) -> usize {
        self.transform.code_length()
    }

    /// Length of an action.
    #[must_use]
    pub fn action_dim(&self) -> usize {
        self.net.outputs()
    }

    /// What observations are standardised with; fails if the policy has never been trained, and has none.
    pub fn standardizer(&self) -> Result<&Standardizer> {
        let untrained = || NnError::Invalid("the policy has not been trained yet".into());
        self.transform.standardizer().ok_or_else(untrained)
    }

    /// The most probable actions of a policy without memory.
    ///
    /// # Shapes
    /// - `obs`: `[N, obs_dim + code_length]`, raw
    /// - output: `[N, action_dim]`
    pub fn mean_actions(&self, obs: &[f32]) -> Result<Vec<f32>> {
        self.refuse_memory()?;
        self.net.apply(&self.transform.apply(obs)?)
    }

    /// The most probable actions; what the policy remembers of each robot goes on by a step.
    ///
    /// # Shapes
    /// - `obs`: `[N, obs_dim + code_length]`, raw; the state of N robots
    /// - output: `[N, action_dim]`
    pub fn step(&self, obs: &[f32], state: &mut PolicyState) -> Result<Vec<f32>> {
        self.means(&self.transform.apply(obs)?, state)
    }

    /// The same for transformed observations.
    pub(crate) fn means(&self, rows: &[f32], state: &mut PolicyState) -> Result<Vec<f32>> {
        let Some(memory) = &self.memory else { return self.net.apply(rows) };
        memory.step(rows, state)?;
        self.net.apply(&with_hidden(rows.into(), &state.hidden(), memory.units()))
    }

    /// Fails for a recurrent policy, whose actions depend on more than the current observation.
    pub fn refuse_memory(&self) -> Result<()> {
        match &self.memory {
            None => Ok(()),
            Some(memory) => Err(NnError::Invalid(format!(
                "the policy is recurrent (`ppo.lstm` = {}), expected one without memory",
                memory.units()
            ))),
        }
    }

    /// The most probable actions where every robot is assumed healthy: if the policy has a damage code, the
    /// code is that of no damage.
    ///
    /// # Shapes
    /// - `obs`: `[N, obs_dim]`, raw, without damage code
    /// - output: `[N, action_dim]`
    pub fn healthy_actions(&self, obs: &[f32]) -> Result<Vec<f32>> {
        let width = self.obs_dim().max(1);
        check_length("obs [N, obs_dim]", obs, obs.len() / width * width)?;
        let code = vec![0.0; self.code_length()];
        if code.is_empty() {
            return self.mean_actions(obs);
        }
        let rows = obs.chunks_exact(width).flat_map(|row| row.iter().chain(&code));
        self.mean_actions(&rows.copied().collect::<Vec<f32>>())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two entries and a code of one, summed.
    fn policy() -> Policy {
        let net = FrozenMlp::new(vec![3, 1], vec![1.0, 1.0, 1.0, 0.5]).unwrap();
        let standardizer = Standardizer::of(vec![1.0, 0.0], vec![2.0, 1.0]).unwrap();
        Policy::new(net, InputTransform::standardized(standardizer, 1, 4.0).unwrap()).unwrap()
    }

    #[test]
    fn actions_are_those_of_the_net_on_transformed_observations() {
        // (2 - 1) · 2 + 3 + 4 · 1 + 0.5, and the same without damage.
        assert_eq!(policy().mean_actions(&[2.0, 3.0, 1.0]).unwrap(), [9.5]);
        assert_eq!(policy().healthy_actions(&[2.0, 3.0]).unwrap(), [5.5]);
        assert!(policy().mean_actions(&[2.0, 3.0]).is_err());
        assert!(policy().healthy_actions(&[2.0, 3.0, 4.0]).is_err());
    }

    #[test]
    fn layers_of_another_width_are_rejected_and_untrained_policies_are_known() {
        let net = policy().net().clone();
        let wrong =
            Policy::new(net.clone(), InputTransform::new(3, 3, 1.0).unwrap()).unwrap_err().to_string();
        assert!(wrong.contains("expected 6 inputs"), "{wrong}");
        assert_eq!(policy().standardizer().unwrap().mean(), [1.0, 0.0]);
        let untrained = Policy::new(net, InputTransform::new(2, 1, 1.0).unwrap()).unwrap();
        assert!(untrained.standardizer().unwrap_err().to_string().contains("not been trained"));
    }
}
