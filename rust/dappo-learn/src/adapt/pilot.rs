//! Who walks: a controller, or a policy with one fixed relation to the truth.

use dappo_sim::vector_env::VectorEnv;

use super::Vocabulary;
use crate::controller::{Controller, Event};
use crate::error::Result;
use crate::evaluate::Policy;

/// Chooses the actions of a trial's robots.
pub enum Pilot<'a> {
    /// Finds out by itself.
    Controller(&'a mut Controller),
    /// A damage-aware policy that is told the damage in the step in which it strikes.
    Oracle(&'a dyn Policy, &'a Vocabulary),
    /// A damage-aware policy that takes every robot for healthy.
    Unadapted(&'a dyn Policy, &'a Vocabulary),
    /// A policy that observes no damage code.
    Unaware(&'a dyn Policy),
}

impl Pilot<'_> {
    /// Name in tables.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Controller(_) => "adapted",
            Self::Oracle(..) => "oracle",
            Self::Unadapted(..) => "unadapted",
            Self::Unaware(_) => "unaware",
        }
    }

    /// The actions of all robots, `[N, A]`.
    pub(super) fn act(&mut self, env: &VectorEnv) -> Result<Vec<f32>> {
        let buffers = env.buffers();
        match self {
            Self::Controller(controller) => controller.act(&buffers.obs, &buffers.forward_velocity),
            Self::Oracle(policy, vocabulary) => {
                let codes = buffers.damage_class.iter().map(|&class| &vocabulary.codes[class as usize]);
                policy.mean_actions(&with_codes(env, codes))
            }
            Self::Unadapted(policy, vocabulary) => {
                let codes = std::iter::repeat_n(&vocabulary.codes[0], env.num_envs());
                policy.mean_actions(&with_codes(env, codes))
            }
            Self::Unaware(policy) => policy.mean_actions(&buffers.obs),
        }
    }

    pub(super) fn take_events(&mut self) -> Vec<Event> {
        match self {
            Self::Controller(controller) => controller.take_events(),
            _ => Vec::new(),
        }
    }
}

/// The observations of all robots, each with a damage code behind it.
fn with_codes<'a>(env: &VectorEnv, codes: impl Iterator<Item = &'a Vec<f32>>) -> Vec<f32> {
    let rows = env.buffers().obs.chunks_exact(env.obs_dim());
    rows.zip(codes).flat_map(|(row, code)| row.iter().chain(code)).copied().collect()
}
