//! Where rollouts come from: envs that the host steps, or a device that runs whole rollouts by itself.

#[cfg(feature = "gpu")]
mod gpu;
mod host;

use dappo_nn::{FrozenActorCritic, PolicyState};
use dappo_sim::curriculum::ClassDistribution;
use dappo_sim::vector_env::VectorEnvSnapshot;

use crate::episodes::EpisodeTracker;
use crate::error::Result;
use crate::rollout::Rollout;

#[cfg(feature = "gpu")]
pub use gpu::GpuEngine;
pub use host::HostEngine;

/// Envs in which a policy acts for a fixed number of steps at a time. Episodes continue from one rollout to
/// the next.
pub trait RolloutEngine {
    /// Runs a policy, which remembers `state`, for one horizon and adds its steps to `episodes`. `first_step` numbers
    /// them over the whole run, so that every (env, step) has exploration noise of its own.
    fn collect(
        &mut self,
        networks: &FrozenActorCritic,
        state: &mut PolicyState,
        episodes: &mut EpisodeTracker,
        first_step: u64,
    ) -> Result<Rollout>;

    /// Changes the class distribution from the next episode of each env on.
    fn set_class_distribution(&mut self, classes: ClassDistribution) -> Result<()>;

    /// How often the physics of an env has diverged since the engine was made.
    fn diverged(&self) -> u64;

    /// The state between two rollouts.
    fn snapshot(&self) -> Result<VectorEnvSnapshot>;

    /// Goes back to a snapshot of an engine of the same configuration.
    fn restore(&mut self, snapshot: &VectorEnvSnapshot) -> Result<()>;
}
