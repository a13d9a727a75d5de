//! The policy of a run: what its newest checkpoint holds, ready to act.

use dappo_nn::{Policy, cpu};

use crate::checkpoint::Checkpoint;
use crate::config::Config;
use crate::envs::EnvFactory;
use crate::error::{LearnError, Result};
use crate::run_folder::RunFolder;

/// A policy, and the checkpoint that it comes from.
#[derive(Clone)]
pub struct RunPolicy {
    /// The policy.
    pub policy: Policy,
    /// Path of the run folder, as the user wrote it.
    pub run: String,
    /// Env steps that the policy was trained for.
    pub env_steps: u64,
    /// CRC-32 of the checkpoint.
    pub fingerprint: String,
}

impl RunPolicy {
    /// Reads the newest checkpoint of a run, onto the CPU; `config` and `factory` are those of the run.
    pub fn newest(run: &RunFolder, config: &Config, factory: &dyn EnvFactory) -> Result<Self> {
        let checkpoint = Checkpoint::newest(&run.checkpoints(), &factory.robot().name)?;
        Ok(Self {
            policy: checkpoint.learner(&config.ppo, factory.sizes(config)?, &cpu())?.frozen()?.policy,
            run: run.root().display().to_string(),
            env_steps: checkpoint.progress.env_steps,
            fingerprint: checkpoint.fingerprint(),
        })
    }

    /// The same; fails if the policy was never trained, and has no statistics of observations.
    pub fn trained(run: &RunFolder, config: &Config, factory: &dyn EnvFactory) -> Result<Self> {
        let found = Self::newest(run, config, factory)?;
        found.policy.standardizer()?;
        Ok(found)
    }

    /// The same; fails if the policy is recurrent, too: twins and controllers do not go on with what it remembers.
    pub fn stateless(run: &RunFolder, config: &Config, factory: &dyn EnvFactory) -> Result<Self> {
        let found = Self::trained(run, config, factory)?;
        let named = |error| LearnError::Invalid(format!("{}: {error}", found.run));
        found.policy.refuse_memory().map_err(named)?;
        Ok(found)
    }
}
