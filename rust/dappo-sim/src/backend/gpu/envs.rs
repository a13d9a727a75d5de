//! Envs that stay on the device for whole rollouts, in a build that has them.

use dappo_gpu::{Clock, Collected, EnvStates, Envs, Networks};

use super::engine::{failure, find};
use crate::backend::lanes::LaneTable;
use crate::backend::{BackendSnapshot, Precision};
use crate::curriculum::ClassDistribution;
use crate::damage::DamageSpace;
use crate::error::SimError;
use crate::task::Task;
use crate::vector_env::{VectorEnvConfig, VectorEnvSnapshot};

/// N damage-randomised episodes on a device; each is followed by its next one in the step in which it ends.
pub struct GpuEnvs {
    task: Task,
    table: LaneTable,
    space: DamageSpace,
    config: VectorEnvConfig,
    envs: Envs,
}

impl GpuEnvs {
    /// Envs at the start of their first episodes. `noise_keys` are the random keys of the exploration noise, `[N]`.
    ///
    /// # Errors
    /// If there is no device, or it does not know the robot or the task: all the reasons.
    pub fn new(
        task: Task,
        table: LaneTable,
        space: &DamageSpace,
        precision: Precision,
        config: VectorEnvConfig,
        noise_keys: &[u64],
    ) -> Result<Self, SimError> {
        let numbers = task.on_device(&table, space, &config)?;
        let envs = Envs::new(table.models(), precision.into(), &find()?, numbers, &config.keys, noise_keys);
        Ok(Self { task, space: space.clone(), config, envs: envs.map_err(failure)?, table })
    }

    /// Runs a policy for `horizon` steps. `first_step` numbers them over the whole run.
    ///
    /// # Errors
    /// If the device fails.
    pub fn collect(
        &mut self,
        networks: &Networks<'_>,
        horizon: usize,
        first_step: u64,
    ) -> Result<Collected, SimError> {
        self.envs.collect(networks, horizon, first_step).map_err(failure)
    }

    /// Changes the class distribution from the next episode of each env on.
    pub fn set_class_distribution(&mut self, classes: ClassDistribution) {
        self.config.classes = classes;
        self.envs.set_classes(&self.task.class_numbers(&self.table, &self.space, &self.config));
    }

    /// The state between two rollouts, as vector envs on the host have it.
    ///
    /// # Errors
    /// If the device fails.
    pub fn snapshot(&self) -> Result<VectorEnvSnapshot, SimError> {
        let EnvStates { physics, mut memory, clocks, obs } = self.envs.states().map_err(failure)?;
        let (count, length) = (clocks.len(), self.task.memory_len());
        let own = physics.len() / count;
        let mut rows = Vec::with_capacity(physics.len() + memory.len());
        for (env, clock) in clocks.iter().enumerate() {
            let memory = &mut memory[env * length..(env + 1) * length];
            self.task.show_clock(memory, clock);
            rows.extend_from_slice(&physics[env * own..(env + 1) * own]);
            rows.extend_from_slice(memory);
        }
        let episode = |clock: &Clock| {
            [
                clock.key,
                clock.number,
                clock.step.into(),
                clock.class.into(),
                clock.onset.into(),
                0,
                clock.duration.into(),
                clock.pause.into(),
                clock.code_delay.into(),
                clock.class_steps.into(),
            ]
        };
        Ok(VectorEnvSnapshot {
            backend: BackendSnapshot {
                row: own + length,
                rows,
                classes: clocks.iter().map(|clock| clock.in_force as usize).collect(),
            },
            episodes: clocks.iter().map(episode).collect(),
            obs,
        })
    }

    /// Goes back to a snapshot of envs of the same configuration, on a device or on the host.
    ///
    /// # Errors
    /// If it is of other envs, or the device fails.
    pub fn restore(&mut self, snapshot: &VectorEnvSnapshot) -> Result<(), SimError> {
        let (classes, length) = (self.table.classes(), self.task.memory_len());
        let layout = self.task.layout();
        let own = layout.nq + 2 * layout.nv + 1;
        let envs = self.envs.num_envs();
        snapshot.backend.check(own + length, envs, classes)?;
        let width = self.envs.plan().obs_len();
        let fits = snapshot.episodes.len() == envs && snapshot.obs.len() == envs * width;
        let runs = |episode: &[u64; 10]| episode[3] < classes as u64 && episode[5] == 0;
        if !fits || !snapshot.episodes.iter().all(runs) {
            return Err(SimError::Snapshot(format!(
                "it holds {} episodes and {} entries of observations of other envs, or episodes that wait for their \
                 reset; expected {envs} and {}",
                snapshot.episodes.len(),
                snapshot.obs.len(),
                envs * width
            )));
        }
        let mut states = EnvStates {
            physics: Vec::new(),
            memory: Vec::new(),
            clocks: Vec::new(),
            obs: snapshot.obs.clone(),
        };
        let rows = snapshot.backend.rows.chunks_exact(own + length);
        for ((row, episode), &class) in rows.zip(&snapshot.episodes).zip(&snapshot.backend.classes) {
            let (physics, memory) = row.split_at(own);
            states.physics.extend_from_slice(physics);
            states.memory.extend_from_slice(memory);
            let steps = |at: usize| u32::try_from(episode[at]).unwrap_or(u32::MAX);
            states.clocks.push(Clock {
                key: episode[0],
                number: episode[1],
                step: steps(2),
                class: steps(3),
                onset: steps(4),
                duration: steps(6),
                pause: steps(7),
                code_delay: steps(8),
                class_steps: steps(9),
                in_force: class as u32,
                model: self.task.model(memory, class) as u32,
            });
        }
        self.envs.restore(&states).map_err(failure)
    }
}
