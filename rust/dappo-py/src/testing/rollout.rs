//! One rollout as numpy arrays: what the learner sees, for tests and research.

use dappo_learn::Ppo;
use dappo_learn::envs::EnvFactory;
use dappo_learn::episodes::EpisodeTracker;
use dappo_nn::PolicyState;
use numpy::{Element, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::cli::args::ConfigArgs;
use crate::cli::settings;
use crate::keywords::read;
use crate::pool::Pool;

/// Collects the first rollout of a training: the one that `dappo-batch train` with the same arguments begins with.
#[pyfunction]
#[pyo3(signature = (**arguments))]
pub fn collect_rollout<'py>(
    py: Python<'py>,
    arguments: Option<Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyDict>> {
    let arguments: ConfigArgs = read(&arguments.unwrap_or_else(|| PyDict::new(py)))?;
    let mut config = settings::resolve(py, &arguments)?;
    let pool = Pool::new(config.env.threads)?;
    let factory = settings::ready(py, &mut config)?;
    let (start, rollout) = pool.run(py, || -> dappo_learn::Result<_> {
        let sizes = factory.sizes(&config)?;
        let device = dappo_nn::cpu();
        let ppo = Ppo::new(&config.ppo, sizes, config.seed, &device)?;
        let mut engine = factory.engine(&config)?;
        let start = engine.snapshot()?;
        let mut state = PolicyState::new(config.env.num_envs, config.ppo.memory());
        let mut episodes = EpisodeTracker::new(config.env.num_envs);
        let rollout = engine.collect(&ppo.frozen()?, &mut state, &mut episodes, 0)?;
        Ok((start, rollout))
    })?;
    let (steps, envs) = (rollout.horizon, rollout.num_envs);
    let arrays = PyDict::new(py);
    let episodes: Vec<u64> = start.episodes.iter().flatten().copied().collect();
    put(&arrays, "start_episodes", episodes, &[envs, 10])?;
    put(&arrays, "obs", rollout.obs, &[steps, envs, rollout.obs_dim])?;
    put(&arrays, "actions", rollout.actions, &[steps, envs, rollout.action_dim])?;
    put(&arrays, "means", rollout.means, &[steps, envs, rollout.action_dim])?;
    for (name, values) in [
        ("log_probs", rollout.log_probs),
        ("rewards", rollout.rewards),
        ("values", rollout.values),
        ("final_values", rollout.final_values),
    ] {
        put(&arrays, name, values, &[steps, envs])?;
    }
    put(&arrays, "terminated", rollout.terminated, &[steps, envs])?;
    put(&arrays, "truncated", rollout.truncated, &[steps, envs])?;
    put(&arrays, "last_values", rollout.last_values, &[envs])?;
    Ok(arrays)
}

fn put<T: Element>(arrays: &Bound<'_, PyDict>, name: &str, values: Vec<T>, shape: &[usize]) -> PyResult<()> {
    arrays.set_item(name, PyArray1::from_vec(arrays.py(), values).reshape(shape.to_vec())?)
}
