//! Whole rollouts on the device: policy, physics, ends and resets in one captured graph, one call a rollout.

use dappo_learn::Sizes;
use dappo_learn::config::Config;
use dappo_learn::engine::RolloutEngine;
use dappo_learn::episodes::EpisodeTracker;
use dappo_learn::{LearnError, Result, Rollout};
use dappo_nn::{FrozenActorCritic, PolicyState};
use dappo_sim::backend::BackendSnapshot;
use dappo_sim::curriculum::ClassDistribution;
use dappo_sim::vector_env::{VectorEnvConfig, VectorEnvSnapshot};
use dappo_sim::{SimError, WarpDevice};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{copy, numbers, rows, vector};
use super::{Handle, Room, devices, undisturbed};

/// Entries of an episode on the device: key, number, step, class, onset and steps of the class before. Episodes there
/// never wait for a reset.
const EPISODE: usize = 6;

/// An `Engine` of `kernels/engine.py`.
pub struct WarpEngine {
    engine: Handle,
    sizes: Sizes,
    num_envs: usize,
    num_classes: usize,
    horizon: usize,
    /// Length of the state of the physics of an env.
    row: usize,
    diverged: u64,
}

impl WarpEngine {
    /// Compiles and captures a step of the envs of a configuration, and begins their first episodes.
    pub fn new(
        table: &Py<PyAny>,
        device: WarpDevice,
        room: Room,
        config: &Config,
        envs: &VectorEnvConfig,
        sizes: Sizes,
    ) -> std::result::Result<Self, SimError> {
        let onset = envs.course.onset;
        let refused = [
            (envs.course.duration.is_some(), "damage that ends (damage.duration)"),
            (envs.course.code_delay.last > 0, "damage codes that are late (damage.code_delay)"),
        ];
        if let Some((_, what)) = refused.iter().find(|(is_set, _)| *is_set) {
            return Err(SimError::Config(format!(
                "training on the backend `warp` does not support {what}; use --device cpu (device=\"cpu\" in Python)"
            )));
        }
        let (engine, row) = undisturbed(|py| {
            let options = PyDict::new(py);
            options.set_item("device", device.name())?;
            options.set_item("reward", config.env.reward.as_deref())?;
            options.set_item("horizon", config.horizon)?;
            options.set_item("hidden", &config.ppo.hidden)?;
            options.set_item("cumulative", numbers(py, envs.classes.cumulative()))?;
            options.set_item("onset", (onset.first, onset.last))?;
            options.set_item("min_class_steps", envs.min_class_steps)?;
            options.set_item("observe_damage", envs.observe_damage)?;
            options.set_item("max_episode_steps", envs.max_episode_steps)?;
            options.set_item("njmax", room.njmax)?;
            options.set_item("nconmax", room.nconmax)?;
            let arguments = (table.bind(py), numbers(py, &envs.keys));
            let engine = devices(py)?.call_method("open_engine", arguments, Some(&options))?;
            let row = engine.getattr("row_length")?.extract()?;
            Ok((Handle::new(engine), row))
        })?;
        Ok(Self {
            engine,
            sizes,
            num_envs: envs.keys.len(),
            num_classes: envs.classes.len(),
            horizon: config.horizon,
            row,
            diverged: 0,
        })
    }

    /// Runs one horizon; fills the rollout and returns the forward velocities, `[T, N]`.
    fn run(
        &mut self,
        networks: &FrozenActorCritic,
        rollout: &mut Rollout,
        first_step: u64,
    ) -> Result<Vec<f32>> {
        let (policy, transform) = (&networks.policy, networks.transform());
        let engine = &self.engine;
        let (velocities, diverged) = undisturbed(|py| {
            let engine = engine.bind(py)?;
            let weights = (
                numbers(py, policy.net().parameters()),
                numbers(py, networks.value().parameters()),
                numbers(py, networks.log_std()),
            );
            engine.call_method1("assign", weights)?;
            let statistics = transform
                .standardizer()
                .map(|standardizer| (numbers(py, standardizer.mean()), numbers(py, standardizer.scale())));
            engine.call_method1("assign_transform", (statistics, transform.code_scale()))?;
            let buffers = engine.call_method1("collect", (first_step,))?;
            for (name, out) in [
                ("obs", &mut rollout.obs),
                ("actions", &mut rollout.actions),
                ("means", &mut rollout.means),
                ("log_probs", &mut rollout.log_probs),
                ("values", &mut rollout.values),
                ("rewards", &mut rollout.rewards),
                ("final_values", &mut rollout.final_values),
                ("last_values", &mut rollout.last_values),
            ] {
                copy(&buffers.get_item(name)?, name, out)?;
            }
            copy(&buffers.get_item("terminated")?, "terminated", &mut rollout.terminated)?;
            copy(&buffers.get_item("truncated")?, "truncated", &mut rollout.truncated)?;
            Ok((vector(&buffers.get_item("forward_velocity")?)?, engine.getattr("diverged")?.extract()?))
        })?;
        self.diverged = diverged;
        Ok(velocities)
    }

    fn check(&self, snapshot: &VectorEnvSnapshot) -> std::result::Result<(), SimError> {
        let (envs, classes) = (self.num_envs, self.num_classes);
        snapshot.backend.check(self.row, envs, classes)?;
        let has_classes = snapshot.episodes.iter().all(|episode| episode[3] < classes as u64);
        if snapshot.episodes.len() == envs && has_classes && snapshot.obs.len() == envs * self.sizes.obs_dim {
            return Ok(());
        }
        Err(SimError::Snapshot(format!(
            "it holds {} episodes and {} entries of observations of other envs or damage classes, expected {envs} and {}",
            snapshot.episodes.len(),
            snapshot.obs.len(),
            envs * self.sizes.obs_dim
        )))
    }
}

impl RolloutEngine for WarpEngine {
    fn collect(
        &mut self,
        networks: &FrozenActorCritic,
        _: &mut PolicyState,
        episodes: &mut EpisodeTracker,
        first_step: u64,
    ) -> Result<Rollout> {
        networks.policy.refuse_memory()?;
        let transform = networks.transform().clone();
        let mut rollout = Rollout::new(self.horizon, self.num_envs, self.sizes.action_dim, transform);
        let velocities = self.run(networks, &mut rollout, first_step)?;
        episodes.add_rollout(&rollout, &velocities)?;
        Ok(rollout)
    }

    fn set_class_distribution(&mut self, classes: ClassDistribution) -> Result<()> {
        let engine = &self.engine;
        let set = undisturbed(|py| {
            let sums = numbers(py, classes.cumulative());
            engine.bind(py)?.call_method1("set_class_distribution", (sums,)).map(|_| ())
        });
        set.map_err(LearnError::from)
    }

    fn diverged(&self) -> u64 {
        self.diverged
    }

    fn snapshot(&self) -> Result<VectorEnvSnapshot> {
        let engine = &self.engine;
        let (rows, classes, episodes, obs) = undisturbed(|py| {
            let snapshot = engine.bind(py)?.call_method0("snapshot")?;
            Ok((
                vector::<f32>(&snapshot.getattr("rows")?)?,
                vector::<i32>(&snapshot.getattr("classes")?)?,
                vector::<u64>(&snapshot.getattr("episodes")?)?,
                vector::<f32>(&snapshot.getattr("obs")?)?,
            ))
        })?;
        Ok(VectorEnvSnapshot {
            backend: BackendSnapshot {
                row: self.row,
                rows: rows.into_iter().map(f64::from).collect(),
                classes: classes.into_iter().map(|class| class as usize).collect(),
            },
            episodes: episodes
                .chunks_exact(EPISODE)
                .map(|e| [e[0], e[1], e[2], e[3], e[4], 0, 0, 0, 0, e[5]])
                .collect(),
            obs,
        })
    }

    fn restore(&mut self, snapshot: &VectorEnvSnapshot) -> Result<()> {
        self.check(snapshot)?;
        let (engine, envs) = (&self.engine, self.num_envs);
        let state: Vec<f32> = snapshot.backend.rows.iter().map(|number| *number as f32).collect();
        let classes: Vec<i32> = snapshot.backend.classes.iter().map(|class| *class as i32).collect();
        let episodes: Vec<u64> =
            snapshot.episodes.iter().flat_map(|e| [e[0], e[1], e[2], e[3], e[4], e[9]]).collect();
        undisturbed(|py| {
            let arguments = (
                rows(py, &state, envs)?,
                numbers(py, &classes),
                rows(py, &episodes, envs)?,
                rows(py, &snapshot.obs, envs)?,
            );
            engine.bind(py)?.call_method1("restore", arguments).map(|_| ())
        })
        .map_err(LearnError::from)
    }
}
