//! Proximal policy optimisation with a clipped surrogate and an adaptive KL penalty.
//!
//! Sources: Schulman et al. (2017), "Proximal policy optimization algorithms", and the settings of Verma
//! et al. (2019), section IV, who train the value net on the current and the previous batch and let the
//! KL weight steer the learning rate.

mod batch;
pub mod config;
mod descent;
mod gaussian;
mod loss;
mod recorded;
mod state;
mod update;
mod written;

use burn::module::Module;
use burn::optim::ModuleOptimizer;
use burn::tensor::Device;
use dappo_nn::{ActorCritic, FrozenActorCritic, Gradients, Normalizer, adam};
use dappo_sim::rng::{Purpose, Stream};
use dappo_sim::task::Reflections;

pub use config::{PpoConfig, Schedule};
pub use loss::{Adaptation, PpoLosses};

use crate::error::Result;
use crate::sizes::Sizes;
use batch::ValueBatch;

/// Adam's guard against division by zero, as common in PPO (Andrychowicz et al., 2021).
const ADAM_EPSILON: f32 = 1e-5;

/// The learner: networks, optimisers, and everything that adapts while training.
pub struct Ppo {
    config: PpoConfig,
    /// Where the networks live, without autodiff.
    device: Device,
    seed: u64,
    updates: u64,
    actor_critic: ActorCritic,
    policy_optimizer: ModuleOptimizer,
    value_optimizer: ModuleOptimizer,
    adaptation: Adaptation,
    normalizer: Normalizer,
    previous: Option<ValueBatch>,
    /// How transitions are reflected, if the networks are trained on their mirror images, too.
    mirror: Option<Reflections>,
}

impl Ppo {
    /// A new learner for observations and actions of these lengths.
    ///
    /// Weights and shuffles are functions of `seed`. `device` is where networks are computed; autodiff
    /// is added here.
    pub fn new(config: &PpoConfig, sizes: Sizes, seed: u64, device: &Device) -> Result<Self> {
        config.check()?;
        let device = device.clone().without_autodiff();
        let mut stream = Stream::new(seed, 0, Purpose::Weights);
        let Sizes { obs_dim, privileged, code_length, action_dim } = sizes;
        let actor_critic = ActorCritic::new(
            obs_dim,
            privileged,
            &config.hidden,
            action_dim,
            config.initial_log_std(),
            &mut || stream.normal(),
            &device,
        );
        Ok(Self {
            config: config.clone(),
            seed,
            updates: 0,
            actor_critic: trainable(actor_critic, config.gradients()),
            device,
            policy_optimizer: optimizer(config),
            value_optimizer: optimizer(config),
            adaptation: Adaptation::default(),
            normalizer: Normalizer::new(obs_dim, code_length)?.with_code_scale(config.code_scale as f32),
            previous: None,
            mirror: None,
        })
    }

    /// The same learner with mirror images: in each pass over a batch, each transition is taken as it is or reflected,
    /// by chance, as if half of the robots had been seen in a mirror (Mittal et al., 2024, "Symmetry considerations for
    /// learning task symmetric robot policies"). Does nothing for `None`.
    #[must_use]
    pub fn with_mirror(self, mirror: Option<Reflections>) -> Self {
        Self { mirror, ..self }
    }

    /// The networks as they are now, for whatever acts with them.
    pub fn frozen(&self) -> Result<FrozenActorCritic> {
        Ok(self.actor_critic.frozen(&self.normalizer)?)
    }

    /// The statistics of all observations so far. [`Ppo::update`] adds each rollout to them.
    #[must_use]
    pub fn normalizer(&self) -> &Normalizer {
        &self.normalizer
    }

    /// The current configuration.
    #[must_use]
    pub fn config(&self) -> &PpoConfig {
        &self.config
    }

    /// The current KL weight and learning-rate factor.
    #[must_use]
    pub fn adaptation(&self) -> Adaptation {
        self.adaptation
    }

    /// Updates made so far.
    #[must_use]
    pub fn updates(&self) -> u64 {
        self.updates
    }
}

/// Networks with autodiff, as optimisers take them.
///
/// burn registers every parameter that requires gradients in a table of the process, which only a backward
/// pass clears. Where gradients are written out there is none, and each step's new parameters would never be
/// freed.
fn trainable(networks: ActorCritic, gradients: Gradients) -> ActorCritic {
    match gradients {
        Gradients::Written => networks.no_grad().train(),
        Gradients::Recorded => networks.train(),
    }
}

fn optimizer(config: &PpoConfig) -> ModuleOptimizer {
    adam(ADAM_EPSILON, config.gradients())
}
