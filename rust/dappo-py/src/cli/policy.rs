//! Loading the newest policy of a run.

use dappo_learn::checkpoint::Checkpoint;
use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_learn::run_folder::RunFolder;
use dappo_nn::{Policy, cpu};

use crate::factory::TableFactory;

/// A policy and the checkpoint that it comes from.
pub struct LoadedPolicy {
    pub policy: Policy,
    /// Env steps that it was trained for.
    pub env_steps: u64,
    /// CRC-32 of the checkpoint.
    pub fingerprint: String,
}

/// The policy in the newest checkpoint of a run.
pub fn load(run: &RunFolder, config: &Config, factory: &TableFactory) -> dappo_learn::Result<LoadedPolicy> {
    let checkpoint = Checkpoint::newest(&run.checkpoints(), &factory.robot().name)?;
    Ok(LoadedPolicy {
        policy: checkpoint.learner(&config.ppo, factory.sizes(config)?, &cpu())?.frozen()?.policy,
        env_steps: checkpoint.progress.env_steps,
        fingerprint: checkpoint.fingerprint(),
    })
}

/// The same; fails if it has never been trained, and has no statistics of observations.
pub fn load_trained(
    run: &RunFolder,
    config: &Config,
    factory: &TableFactory,
) -> dappo_learn::Result<LoadedPolicy> {
    let loaded = load(run, config, factory)?;
    loaded.policy.standardizer()?;
    Ok(loaded)
}
