//! Where the envs of a run come from: what can compile robots implements [`EnvFactory`].

use dappo_sim::rng::env_keys;
use dappo_sim::task::Reflections;
use dappo_sim::vector_env::{Autoreset, VectorEnv, VectorEnvConfig};
use dappo_sim::{Backend, DamageSpace, Physics, Robot, SimError};

use crate::config::Config;
use crate::engine::{HostEngine, RolloutEngine};
use crate::error::Result;
use crate::simulator::Simulator;
use crate::sizes::Sizes;

/// Makes the envs of one robot and one set of damage classes.
pub trait EnvFactory {
    /// The robot.
    fn robot(&self) -> &Robot;

    /// Its damage classes.
    fn space(&self) -> &DamageSpace;

    /// Lengths of what the policies of a configuration see and do.
    fn sizes(&self, config: &Config) -> std::result::Result<Sizes, SimError>;

    /// How observations and actions are reflected where `ppo.symmetry` is on, or else `None`.
    fn mirror(&self, config: &Config) -> std::result::Result<Option<Reflections>, SimError>;

    /// Integrator of the robot, as MuJoCo names it.
    fn integrator(&self) -> &str;

    /// Time from one action to the next, s. A forward reward, Σ forward velocity over env steps, times this is the
    /// distance in m.
    fn control_period(&self) -> f64;

    /// The simulator behind results of this physics.
    fn simulator(&self, physics: Physics) -> Simulator {
        Simulator { physics, integrator: self.integrator().to_owned() }
    }

    /// The physics of a training.
    fn training_physics(&self) -> Physics;

    /// The physics of everything else: evaluations, controllers, records.
    fn evaluation_physics(&self) -> Physics;

    /// The backend of `num_envs` envs with the reward of this name.
    fn backend(
        &self,
        num_envs: usize,
        reward: Option<&str>,
        physics: Physics,
    ) -> std::result::Result<Box<dyn Backend>, SimError>;

    /// A vector env with one env for each key of `config`, over a [backend](Self::backend).
    fn make(
        &self,
        config: VectorEnvConfig,
        reward: Option<&str>,
        physics: Physics,
    ) -> std::result::Result<VectorEnv, SimError> {
        VectorEnv::new(self.backend(config.keys.len(), reward, physics)?, self.space(), config)
    }

    /// Where the rollouts of a training come from, at the start of all first episodes.
    fn engine(&self, config: &Config) -> Result<Box<dyn RolloutEngine>> {
        let (envs, reward) = (self.env_config(config)?, config.env.reward.as_deref());
        let env = self.make(envs, reward, self.training_physics())?;
        Ok(Box::new(HostEngine::new(env, config)?))
    }

    /// Env steps of an episode that does not end in a failure.
    fn max_episode_steps(&self, config: &Config) -> usize {
        config.env.max_episode_steps.unwrap_or(self.robot().max_episode_steps)
    }

    /// The training envs of a configuration.
    fn env_config(&self, config: &Config) -> Result<VectorEnvConfig> {
        Ok(VectorEnvConfig {
            keys: env_keys(config.seed, config.env.num_envs),
            observe_damage: config.env.observe_damage,
            autoreset: Autoreset::SameStep,
            max_episode_steps: self.max_episode_steps(config),
            classes: config.curriculum[0].mix.distribution(self.space())?,
            min_class_steps: config.damage.min_class_steps,
            course: config.damage.course(),
        })
    }
}
