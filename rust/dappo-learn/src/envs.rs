//! Where the envs of a run come from: whoever can compile robots implements [`EnvFactory`].

use dappo_sim::rng::env_keys;
use dappo_sim::vector_env::{Autoreset, VectorEnv, VectorEnvConfig};
use dappo_sim::{Backend, DamageSpace, Precision, Robot, SimError};

use crate::config::Config;
use crate::error::Result;

/// Makes the envs of one robot and one set of damage classes.
pub trait EnvFactory {
    /// The robot.
    fn robot(&self) -> &Robot;

    /// Its damage classes.
    fn space(&self) -> &DamageSpace;

    /// The physics of `num_envs` envs with the reward of this name, of this precision where there is a choice.
    fn backend(
        &self,
        num_envs: usize,
        reward: Option<&str>,
        precision: Precision,
    ) -> std::result::Result<Box<dyn Backend>, SimError>;

    /// A vector env with one env for each key of `config`, over a [backend](Self::backend).
    fn make(
        &self,
        config: VectorEnvConfig,
        reward: Option<&str>,
        precision: Precision,
    ) -> std::result::Result<VectorEnv, SimError> {
        VectorEnv::new(self.backend(config.keys.len(), reward, precision)?, self.space(), config)
    }

    /// The training envs of a configuration.
    fn env_config(&self, config: &Config) -> Result<VectorEnvConfig> {
        Ok(VectorEnvConfig {
            keys: env_keys(config.seed, config.env.num_envs),
            observe_damage: config.env.observe_damage,
            autoreset: Autoreset::SameStep,
            max_episode_steps: config.env.max_episode_steps.unwrap_or(self.robot().max_episode_steps),
            classes: config.curriculum[0].mix.distribution(self.space())?,
            onset: config.damage.onset,
        })
    }
}
