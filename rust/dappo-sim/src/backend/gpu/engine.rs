//! The backend, in a build that has it.

use dappo_gpu::{Device, Engine, Error, Group};
use dappo_lanes::WorldAccess;
use rayon::prelude::*;

use super::super::block::{Block, BlockOutputs};
use super::super::worlds::Worlds;
use super::super::{
    Backend, BackendSnapshot, ObsRows, Physics, Precision, Reset, StepOutputs, check_class, check_envs,
};
use crate::backend::lanes::LaneTable;
use crate::error::{SimError, expect_len};
use crate::task::Task;

/// Envs in a block: those that a thread of the CPU takes at once.
const WIDTH: usize = 32;

/// The GPU engine × rayon for the tasks.
pub struct GpuBackend {
    task: Task,
    table: LaneTable,
    precision: Precision,
    engine: Engine,
    blocks: Vec<Block<Group>>,
    classes: Vec<usize>,
}

/// The device of this machine.
pub fn find() -> Result<Device, SimError> {
    Device::find().map_err(failure)
}

pub(super) fn failure(error: Error) -> SimError {
    match error {
        Error::Unsupported(reasons) => super::unusable(&reasons.join("; ")),
        Error::Device(why) => SimError::Device(why),
    }
}

impl GpuBackend {
    /// A backend for `num_envs` robots of a table.
    pub fn new(
        task: Task,
        table: LaneTable,
        precision: Precision,
        num_envs: usize,
    ) -> Result<Self, SimError> {
        check_envs(num_envs)?;
        let engine = Engine::new(table.models(), precision.into(), &find()?, num_envs).map_err(failure)?;
        let groups = engine.groups(WIDTH).into_iter();
        let blocks = groups.map(|group| Block::new(Box::new(group), &task, &table)).collect();
        Ok(Self { task, table, precision, engine, blocks, classes: vec![0; num_envs] })
    }

    /// Computes the forces of the envs that have just been placed, and observes them.
    ///
    /// # Shapes
    /// - `lanes`: `[blocks]`
    fn begin(&mut self, lanes: &[u32], obs: &mut [f32], stride: usize) -> Result<(), SimError> {
        if lanes.iter().all(|lanes| *lanes == 0) {
            return Ok(());
        }
        self.engine.forward(&mut groups(&mut self.blocks, lanes)).map_err(failure)?;
        let (task, table) = (&self.task, &self.table);
        (
            self.blocks.par_iter_mut(),
            lanes,
            self.classes.par_chunks(WIDTH),
            obs.par_chunks_mut(WIDTH * stride),
        )
            .into_par_iter()
            .for_each(|(block, &lanes, classes, obs)| {
                block.observe_first(task, table, lanes, classes, obs, stride);
            });
        Ok(())
    }
}

/// The groups of all blocks with their lanes.
fn groups<'a>(blocks: &'a mut [Block<Group>], lanes: &[u32]) -> Vec<(&'a mut Group, u32)> {
    blocks.iter_mut().zip(lanes).map(|(block, &lanes)| (block.group.as_mut(), lanes)).collect()
}

impl Backend for GpuBackend {
    fn physics(&self) -> Physics {
        Physics::Gpu(self.precision)
    }

    fn num_envs(&self) -> usize {
        self.classes.len()
    }

    fn num_classes(&self) -> usize {
        self.table.classes()
    }

    fn task(&self) -> &Task {
        &self.task
    }

    fn memory(&self, env: usize) -> &[f64] {
        self.blocks[env / WIDTH].memory(&self.task, env % WIDTH)
    }

    fn reset(&mut self, resets: &[Reset], obs: ObsRows<'_>) -> Result<(), SimError> {
        let mut wanted: Vec<Option<Reset>> = vec![None; self.num_envs()];
        for reset in resets {
            check_class(reset.class, self.table.classes())?;
            self.classes[reset.env] = reset.class;
            wanted[reset.env] = Some(*reset);
        }
        let (task, table) = (&self.task, &self.table);
        let lanes: Vec<u32> = (self.blocks.par_iter_mut(), wanted.par_chunks(WIDTH))
            .into_par_iter()
            .map(|(block, resets)| block.place(task, table, resets))
            .collect();
        self.begin(&lanes, obs.data, obs.stride)
    }

    fn set_classes(&mut self, changes: &[(usize, usize)]) -> Result<(), SimError> {
        for &(env, class) in changes {
            check_class(class, self.table.classes())?;
            self.blocks[env / WIDTH].strike(&self.task, &self.table, env % WIDTH, class);
            self.classes[env] = class;
        }
        Ok(())
    }

    fn step(&mut self, actions: &[f32], skip: &[bool], outputs: StepOutputs<'_>) -> Result<(), SimError> {
        let (task, table) = (&self.task, &self.table);
        let nu = task.layout().nu;
        expect_len("actions", actions.len(), self.classes.len() * nu)?;
        expect_len("skip", skip.len(), self.classes.len())?;
        let stride = outputs.obs.stride;
        let lanes: Vec<u32> =
            (self.blocks.par_iter_mut(), skip.par_chunks(WIDTH), actions.par_chunks(WIDTH * nu))
                .into_par_iter()
                .map(|(block, skip, actions)| block.prepare(task, skip, actions))
                .collect();
        self.engine.step(&mut groups(&mut self.blocks, &lanes), task.frame_skip).map_err(failure)?;
        let diverged: Vec<u32> = (
            self.blocks.par_iter_mut(),
            &lanes,
            self.classes.par_chunks(WIDTH),
            outputs.obs.data.par_chunks_mut(WIDTH * stride),
            outputs.rewards.par_chunks_mut(WIDTH),
            outputs.reward_terms.par_chunks_mut(WIDTH * task.reward_len()),
            outputs.terminated.par_chunks_mut(WIDTH),
            outputs.forward_velocity.par_chunks_mut(WIDTH),
            outputs.diverged.par_chunks_mut(WIDTH),
        )
            .into_par_iter()
            .map(
                |(
                    block,
                    &lanes,
                    classes,
                    obs,
                    rewards,
                    reward_terms,
                    terminated,
                    forward_velocity,
                    diverged,
                )| {
                    let mut outputs = BlockOutputs {
                        obs,
                        stride,
                        rewards,
                        reward_terms,
                        terminated,
                        forward_velocity,
                        diverged,
                    };
                    block.conclude(task, table, lanes, classes, &mut outputs)
                },
            )
            .collect();
        self.begin(&diverged, outputs.obs.data, stride)
    }

    fn state(&self, qpos: &mut [f64], qvel: &mut [f64]) -> Result<(), SimError> {
        let (nq, nv) = (self.task.layout().nq, self.task.layout().nv);
        expect_len("qpos", qpos.len(), self.num_envs() * nq)?;
        expect_len("qvel", qvel.len(), self.num_envs() * nv)?;
        for (env, (qpos, qvel)) in qpos.chunks_exact_mut(nq).zip(qvel.chunks_exact_mut(nv)).enumerate() {
            self.blocks[env / WIDTH].state(env % WIDTH, qpos, qvel);
        }
        Ok(())
    }

    fn set_state(
        &mut self,
        qpos: &[f64],
        qvel: &[f64],
        skip: &[bool],
        obs: ObsRows<'_>,
    ) -> Result<(), SimError> {
        let task = &self.task;
        let (nq, nv) = (task.layout().nq, task.layout().nv);
        expect_len("qpos", qpos.len(), self.classes.len() * nq)?;
        expect_len("qvel", qvel.len(), self.classes.len() * nv)?;
        expect_len("skip", skip.len(), self.classes.len())?;
        let lanes: Vec<u32> = (
            self.blocks.par_iter_mut(),
            skip.par_chunks(WIDTH),
            qpos.par_chunks(WIDTH * nq),
            qvel.par_chunks(WIDTH * nv),
        )
            .into_par_iter()
            .map(|(block, skip, qpos, qvel)| block.put(task, skip, qpos, qvel))
            .collect();
        self.begin(&lanes, obs.data, obs.stride)
    }

    fn snapshot(&self) -> Result<BackendSnapshot, SimError> {
        let row = self.blocks[0].row(&self.task);
        let mut rows = vec![0.0; self.num_envs() * row];
        for (env, row) in rows.chunks_exact_mut(row).enumerate() {
            self.blocks[env / WIDTH].save(&self.task, env % WIDTH, row);
        }
        Ok(BackendSnapshot { row, rows, classes: self.classes.clone() })
    }

    fn restore(&mut self, snapshot: &BackendSnapshot) -> Result<(), SimError> {
        let row = self.blocks[0].row(&self.task);
        snapshot.check(row, self.num_envs(), self.table.classes())?;
        for (env, row) in snapshot.rows.chunks_exact(row).enumerate() {
            let class = snapshot.classes[env];
            self.blocks[env / WIDTH].load(&self.task, &self.table, env % WIDTH, class, row);
        }
        self.classes.copy_from_slice(&snapshot.classes);
        Ok(())
    }
}

/// Worlds without episodes.
pub struct GpuWorlds {
    engine: Engine,
    groups: Vec<Group>,
}

impl GpuWorlds {
    /// `count` worlds of a table, all of class 0.
    pub fn new(table: &LaneTable, precision: Precision, count: usize) -> Result<Self, SimError> {
        let engine = Engine::new(table.models(), precision.into(), &find()?, count).map_err(failure)?;
        let groups = engine.groups(WIDTH);
        Ok(Self { engine, groups })
    }

    fn all(groups: &mut [Group]) -> Vec<(&mut Group, u32)> {
        groups.iter_mut().map(|group| (group, u32::MAX)).collect()
    }
}

impl Worlds for GpuWorlds {
    fn world(&self, index: usize) -> (&dyn WorldAccess, usize) {
        (&self.groups[index / WIDTH], index % WIDTH)
    }

    fn world_mut(&mut self, index: usize) -> (&mut dyn WorldAccess, usize) {
        (&mut self.groups[index / WIDTH], index % WIDTH)
    }

    fn forward(&mut self) -> Result<(), SimError> {
        self.engine.forward(&mut Self::all(&mut self.groups)).map_err(failure)
    }

    fn step(&mut self, substeps: usize) -> Result<(), SimError> {
        self.engine.step(&mut Self::all(&mut self.groups), substeps).map_err(failure)
    }
}
