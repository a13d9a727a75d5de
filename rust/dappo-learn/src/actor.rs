//! A trained policy for use alone: no value net, no optimiser, statistics that stay as they are.

use burn::module::Module;

use crate::diagnose::Standardizer;
use crate::error::{LearnError, Result, check_length};
use crate::evaluate::Policy;
use crate::nn::Mlp;
use crate::ppo::Ppo;

/// Chooses the most probable actions, to the bit those of the learner that it comes from.
#[derive(Debug, Clone)]
pub struct Actor {
    net: Mlp,
    /// Of the entries before the damage code.
    standardizer: Standardizer,
    code_length: usize,
    /// What the entries of the damage code are multiplied by.
    code_scale: f32,
}

impl Actor {
    /// A network over standardised observations, followed by a damage code of `code_length` entries.
    pub fn new(net: Mlp, standardizer: Standardizer, code_length: usize, code_scale: f32) -> Result<Self> {
        let actor = Self { net, standardizer, code_length, code_scale };
        if !code_scale.is_finite() {
            return Err(LearnError::Invalid(format!(
                "the scale of the damage code is {code_scale}, expected a finite number"
            )));
        }
        let (got, expected) = (actor.net.sizes(), actor.obs_dim().saturating_add(code_length));
        if got.len() < 2 || got[0] != expected {
            return Err(LearnError::Invalid(format!(
                "the layers of the policy have widths {got:?}, expected {expected} inputs"
            )));
        }
        Ok(actor)
    }

    /// What a learner has learned so far.
    pub fn of(ppo: &Ppo) -> Result<Self> {
        let normalizer = ppo.normalizer();
        if normalizer.count() == 0 {
            return Err(LearnError::Invalid("the policy has not been trained yet".into()));
        }
        let mean = normalizer.mean().iter().map(|mean| *mean as f32).collect();
        Self::new(
            ppo.actor_critic().policy.mean.valid(),
            Standardizer::of(mean, normalizer.scale())?,
            normalizer.code_length(),
            normalizer.code_scale(),
        )
    }

    /// The network.
    #[must_use]
    pub fn net(&self) -> &Mlp {
        &self.net
    }

    /// What observations are standardised with.
    #[must_use]
    pub fn standardizer(&self) -> &Standardizer {
        &self.standardizer
    }

    /// Length of an observation, without damage code.
    #[must_use]
    pub fn obs_dim(&self) -> usize {
        self.standardizer.input_dim()
    }

    /// Length of the damage code.
    #[must_use]
    pub fn code_length(&self) -> usize {
        self.code_length
    }

    /// What the entries of the damage code are multiplied by.
    #[must_use]
    pub fn code_scale(&self) -> f32 {
        self.code_scale
    }
}

impl Policy for Actor {
    fn mean_actions(&self, obs: &[f32]) -> Result<Vec<f32>> {
        let width = self.obs_dim() + self.code_length;
        let rows = obs.len() / width;
        check_length("obs [N, obs_dim]", obs, rows * width)?;
        let mut inputs = obs.to_vec();
        for row in inputs.chunks_exact_mut(width) {
            let (observed, code) = row.split_at_mut(self.obs_dim());
            self.standardizer.apply(observed);
            code.iter_mut().for_each(|bit| *bit *= self.code_scale);
        }
        self.net.apply(inputs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ppo::PpoConfig;
    use crate::{Rollout, cpu, gae};

    fn learner(updates: u32) -> Ppo {
        let config = PpoConfig { hidden: vec![6, 5], code_scale: 4.0, ..PpoConfig::default() };
        let mut ppo = Ppo::new(&config, 5, 2, 3, 1, &cpu()).unwrap();
        for _ in 0..updates {
            let mut rollout = Rollout::new(1, 4, 3, ppo.normalizer().clone());
            let decision = ppo.actor_critic().act(&rows(), ppo.normalizer(), &[0.1; 12]).unwrap();
            rollout.record_decision(0, &rows(), &decision).unwrap();
            rollout.record_outcome(0, &[1.0, 0.0, 2.0, 1.0], &[true; 4], &[false; 4]).unwrap();
            ppo.update(&rollout, &gae(&rollout, 0.99, 0.9).unwrap()).unwrap();
        }
        ppo
    }

    /// Four observations of three numbers with damage codes of two.
    fn rows() -> Vec<f32> {
        (0..20_u8).map(|x| if x % 5 < 3 { f32::from(x) * 0.3 - 2.0 } else { f32::from(x % 2) }).collect()
    }

    #[test]
    fn an_actor_acts_to_the_bit_as_its_learner() {
        let ppo = learner(1);
        let actor = Actor::of(&ppo).unwrap();
        assert_eq!((actor.obs_dim(), actor.code_length(), actor.code_scale()), (3, 2, 4.0));
        assert_eq!(actor.mean_actions(&rows()).unwrap(), ppo.mean_actions(&rows()).unwrap());
        assert!(actor.mean_actions(&rows()[..7]).is_err());
    }

    #[test]
    fn a_learner_that_has_seen_nothing_and_layers_of_another_width_are_refused() {
        assert!(Actor::of(&learner(0)).unwrap_err().to_string().contains("not been trained"));
        let actor = Actor::of(&learner(1)).unwrap();
        let wrong = Actor::new(actor.net, actor.standardizer, 3, 1.0).unwrap_err().to_string();
        assert!(wrong.contains("expected 6 inputs"), "{wrong}");
    }
}
