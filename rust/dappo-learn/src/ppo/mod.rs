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
mod symmetry;
mod update;
mod written;

use burn::module::Module;
use burn::optim::ModuleOptimizer;
use burn::tensor::Device;
use dappo_nn::{
    ActorCritic, ActorCriticSizes, FrozenActorCritic, Gradients, Mlp, MlpSymmetry, NnError, Normalizer,
    PolicySymmetry, adam,
};
use dappo_sim::rng::{Purpose, Stream};
use dappo_sim::task::{Reflection, Reflections};

pub use config::{PpoConfig, Schedule};
pub use loss::{Adaptation, PpoLosses};
pub use symmetry::Symmetry;

use crate::error::{LearnError, Result};
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
    /// How the networks are kept their own mirror images, if they are.
    mirror: Option<Mirror>,
}

/// What keeps the networks their own mirror images.
struct Mirror {
    /// Of a row of observations.
    obs: Reflection,
    policy: PolicySymmetry,
    value: MlpSymmetry,
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
        let (memory, hidden) = (config.memory(), config.hidden.as_slice());
        let actor_critic = ActorCritic::new(
            ActorCriticSizes { obs_dim, privileged, memory, hidden, action_dim },
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

    /// The same learner with networks that are their own mirror images and stay so: the policy takes the reflected action
    /// for a reflected observation, and the value is the same. What is seen on one side is learned for both. Does nothing
    /// for `None`.
    pub fn with_mirror(mut self, mirror: Option<Reflections>) -> Result<Self> {
        let Some(Reflections { obs, action }) = mirror else { return Ok(self) };
        let networks = &self.actor_critic;
        let (hidden, code_length) = (&self.config.hidden, self.normalizer.code_length());
        for (what, got, expected) in [
            ("obs_dim of the reflection", obs.len(), networks.obs_dim()),
            ("action_dim of the reflection", action.len(), networks.action_dim()),
        ] {
            if got != expected {
                return Err(NnError::Length { what, got, expected }.into());
            }
        }
        let end = obs.len() - code_length;
        let seen = obs.without(end - networks.privileged()..end).ok_or_else(|| {
            LearnError::Invalid("what the policy observes is the mirror image of privileged entries".into())
        })?;
        let policy = PolicySymmetry::new(seen, networks.memory(), hidden, action);
        let valued = policy.memory().map_or_else(|| obs.clone(), |memory| obs.followed_by(memory.hidden()));
        let value = MlpSymmetry::new(valued, hidden, Reflection::identity(1));
        let mut networks = networks.valid();
        if let (Some(memory), Some(symmetry)) = (networks.policy.memory.take(), policy.memory()) {
            let mut parameters = memory.parameters()?;
            symmetry.impose(&mut parameters);
            networks.policy.memory = Some(memory.with_parameters(&parameters));
        }
        networks.policy.mean = imposed(networks.policy.mean, policy.mean())?;
        networks.value = imposed(networks.value, &value)?;
        self.actor_critic = trainable(networks, self.config.gradients());
        self.mirror = Some(Mirror { obs, policy, value });
        Ok(self)
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

fn imposed(net: Mlp, symmetry: &MlpSymmetry) -> Result<Mlp> {
    let mut parameters = net.parameters()?;
    symmetry.impose(&mut parameters);
    Ok(net.with_parameters(&parameters))
}

fn optimizer(config: &PpoConfig) -> ModuleOptimizer {
    adam(ADAM_EPSILON, config.gradients())
}
