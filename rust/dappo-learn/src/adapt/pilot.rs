//! Who walks: a controller, or a policy with one fixed relation to the truth.

use dappo_sim::vector_env::VectorEnv;

use crate::controller::{Controller, Event};
use crate::error::Result;
use crate::evaluate::Policy;

/// Chooses the actions of a trial's robots.
pub enum Pilot<'a> {
    /// Finds out by itself.
    Controller(&'a mut Controller),
    /// A damage-aware policy that is told the damage in the step in which it strikes.
    Oracle(&'a dyn Policy),
    /// A damage-aware policy that takes every robot for healthy.
    Unadapted(&'a dyn Policy),
    /// A policy that observes no damage code.
    Unaware(&'a dyn Policy),
}

impl Pilot<'_> {
    /// Name in tables.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Controller(_) => "adapted",
            Self::Oracle(_) => "oracle",
            Self::Unadapted(_) => "unadapted",
            Self::Unaware(_) => "unaware",
        }
    }

    /// The actions of all robots, `[N, A]`.
    pub(super) fn act(&mut self, env: &VectorEnv) -> Result<Vec<f32>> {
        let (rows, robot) = (&env.buffers().obs, env.obs_dim() - env.code_length());
        let without_code = || rows.chunks_exact(env.obs_dim()).flat_map(|row| &row[..robot]).copied();
        match self {
            Self::Controller(controller) => {
                controller.act(&without_code().collect::<Vec<f32>>(), &env.buffers().forward_velocity)
            }
            Self::Oracle(policy) => policy.mean_actions(rows),
            Self::Unadapted(policy) => {
                let mut rows = rows.clone();
                rows.chunks_exact_mut(env.obs_dim()).for_each(|row| row[robot..].fill(0.0));
                policy.mean_actions(&rows)
            }
            Self::Unaware(policy) => policy.mean_actions(&without_code().collect::<Vec<f32>>()),
        }
    }

    pub(super) fn take_events(&mut self) -> Vec<Event> {
        match self {
            Self::Controller(controller) => controller.take_events(),
            _ => Vec::new(),
        }
    }
}
