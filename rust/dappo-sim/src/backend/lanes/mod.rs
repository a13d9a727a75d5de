//! The `lanes` backend: the lane engine, several envs in the lanes of a register.
//!
//! Env i lives in lane i mod width of group i / width. It supports limbed robots on a level floor only; every
//! other robot is refused with the reason, and belongs to the `mujoco` backend.

mod arrays;
mod block;
mod compile;
mod contacts;
mod features;
mod geometry;
mod joints;
mod refuse;
mod softness;
mod tree;

use rayon::prelude::*;

use super::block::{Block, BlockOutputs};
use super::{
    Backend, BackendSnapshot, ObsRows, Physics, Precision, Reset, StepOutputs, check_class, check_envs,
};
use crate::error::{SimError, expect_len};
use crate::simd::Simd;
use crate::task::Task;

pub use arrays::{ModelArrays, ModelReader, Rules};
pub use compile::{LaneTable, Sizes};
pub use dappo_lanes::{Group, Readout, WorldAccess};

/// The lane engine × rayon.
pub struct LanesBackend {
    task: Task,
    table: LaneTable,
    precision: Precision,
    /// Envs in a block.
    width: usize,
    blocks: Vec<Block<dyn Group>>,
    classes: Vec<usize>,
}

impl LanesBackend {
    /// A backend for `num_envs` robots of a table, which so many threads step with one of the instruction sets.
    pub fn new(
        task: Task,
        table: LaneTable,
        precision: Precision,
        choices: &[Simd],
        num_envs: usize,
        threads: usize,
    ) -> Result<Self, SimError> {
        check_envs(num_envs)?;
        let time = |simd: &&Simd| step_time(**simd, precision, num_envs, threads);
        let simd = choices.iter().min_by_key(time).copied().unwrap_or(Simd::Portable);
        let engine = table.engine(precision, simd)?;
        let width = engine.width();
        let blocks =
            (0..num_envs.div_ceil(width)).map(|_| Block::new(engine.group(), &task, &table)).collect();
        Ok(Self { task, table, precision, width, blocks, classes: vec![0; num_envs] })
    }

    /// The block of an env, and its lane in it.
    fn place(&self, env: usize) -> (usize, usize) {
        (env / self.width, env % self.width)
    }
}

/// Time of a step, in tenths of the time that one group takes with AVX-512.
///
/// A few envs fit into one group of wide registers, which one thread steps while the others have nothing to do, and in
/// which most lanes are empty: narrower registers are then faster. Results are the same bits.
fn step_time(simd: Simd, precision: Precision, num_envs: usize, threads: usize) -> usize {
    let of_a_group = match simd {
        Simd::Avx512 => 10,
        Simd::Avx2 | Simd::Neon => 6,
        Simd::Portable => 20,
    };
    let groups = num_envs.div_ceil(simd.worlds(precision.into()));
    groups.div_ceil(threads.max(1)) * of_a_group
}

impl Backend for LanesBackend {
    fn physics(&self) -> Physics {
        Physics::Lanes(self.precision)
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
        let (block, lane) = self.place(env);
        self.blocks[block].memory(&self.task, lane)
    }

    fn reset(&mut self, resets: &[Reset], obs: ObsRows<'_>) -> Result<(), SimError> {
        let mut wanted: Vec<Option<Reset>> = vec![None; self.num_envs()];
        for reset in resets {
            check_class(reset.class, self.table.classes())?;
            self.classes[reset.env] = reset.class;
            wanted[reset.env] = Some(*reset);
        }
        let (task, table, width, stride) = (&self.task, &self.table, self.width, obs.stride);
        (
            self.blocks.par_iter_mut(),
            wanted.par_chunks(width),
            self.classes.par_chunks(width),
            obs.data.par_chunks_mut(width * stride),
        )
            .into_par_iter()
            .filter(|(_, resets, ..)| resets.iter().any(Option::is_some))
            .for_each(|(block, resets, classes, obs)| {
                block.reset(task, table, resets, classes, obs, stride);
            });
        Ok(())
    }

    fn set_classes(&mut self, changes: &[(usize, usize)]) -> Result<(), SimError> {
        for &(env, class) in changes {
            check_class(class, self.table.classes())?;
            let (block, lane) = self.place(env);
            self.blocks[block].strike(&self.task, &self.table, lane, class);
            self.classes[env] = class;
        }
        Ok(())
    }

    fn step(&mut self, actions: &[f32], skip: &[bool], outputs: StepOutputs<'_>) -> Result<(), SimError> {
        let (task, table, width) = (&self.task, &self.table, self.width);
        let nu = task.layout().nu;
        expect_len("actions", actions.len(), self.classes.len() * nu)?;
        expect_len("skip", skip.len(), self.classes.len())?;
        let stride = outputs.obs.stride;
        (
            self.blocks.par_iter_mut(),
            self.classes.par_chunks(width),
            skip.par_chunks(width),
            actions.par_chunks(width * nu),
            outputs.obs.data.par_chunks_mut(width * stride),
            outputs.rewards.par_chunks_mut(width),
            outputs.reward_terms.par_chunks_mut(width * task.reward_len()),
            outputs.terminated.par_chunks_mut(width),
            outputs.forward_velocity.par_chunks_mut(width),
            outputs.diverged.par_chunks_mut(width),
        )
            .into_par_iter()
            .for_each(
                |(
                    block,
                    classes,
                    skip,
                    actions,
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
                    block.step(task, table, classes, skip, actions, &mut outputs);
                },
            );
        Ok(())
    }

    fn state(&self, qpos: &mut [f64], qvel: &mut [f64]) -> Result<(), SimError> {
        let (nq, nv) = (self.task.layout().nq, self.task.layout().nv);
        expect_len("qpos", qpos.len(), self.num_envs() * nq)?;
        expect_len("qvel", qvel.len(), self.num_envs() * nv)?;
        for (env, (qpos, qvel)) in qpos.chunks_exact_mut(nq).zip(qvel.chunks_exact_mut(nv)).enumerate() {
            let (block, lane) = self.place(env);
            self.blocks[block].state(lane, qpos, qvel);
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
        let (task, table, width, stride) = (&self.task, &self.table, self.width, obs.stride);
        let (nq, nv) = (task.layout().nq, task.layout().nv);
        expect_len("qpos", qpos.len(), self.classes.len() * nq)?;
        expect_len("qvel", qvel.len(), self.classes.len() * nv)?;
        expect_len("skip", skip.len(), self.classes.len())?;
        (
            self.blocks.par_iter_mut(),
            self.classes.par_chunks(width),
            skip.par_chunks(width),
            qpos.par_chunks(width * nq),
            qvel.par_chunks(width * nv),
            obs.data.par_chunks_mut(width * stride),
        )
            .into_par_iter()
            .filter(|(_, _, skip, ..)| skip.contains(&false))
            .for_each(|(block, classes, skip, qpos, qvel, obs)| {
                let lanes = block.put(task, skip, qpos, qvel);
                block.group.forward(lanes);
                block.observe_first(task, table, lanes, classes, obs, stride);
            });
        Ok(())
    }

    fn snapshot(&self) -> Result<BackendSnapshot, SimError> {
        let row = self.blocks[0].row(&self.task);
        let mut rows = vec![0.0; self.num_envs() * row];
        for (env, row) in rows.chunks_exact_mut(row).enumerate() {
            let (block, lane) = self.place(env);
            self.blocks[block].save(&self.task, lane, row);
        }
        Ok(BackendSnapshot { row, rows, classes: self.classes.clone() })
    }

    fn restore(&mut self, snapshot: &BackendSnapshot) -> Result<(), SimError> {
        let row = self.blocks[0].row(&self.task);
        snapshot.check(row, self.num_envs(), self.table.classes())?;
        for (env, row) in snapshot.rows.chunks_exact(row).enumerate() {
            let (block, lane) = self.place(env);
            self.blocks[block].load(&self.task, &self.table, lane, snapshot.classes[env], row);
        }
        self.classes.copy_from_slice(&snapshot.classes);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_envs_are_stepped_with_narrow_registers_and_many_with_wide_ones() {
        let fastest = |precision, num_envs, threads| {
            let sets = [Simd::Avx512, Simd::Avx2, Simd::Portable];
            sets.into_iter().min_by_key(|simd| step_time(*simd, precision, num_envs, threads)).unwrap()
        };
        for (num_envs, threads, expected) in [
            (1, 1, Simd::Avx2),
            (8, 1, Simd::Avx2),
            (16, 1, Simd::Avx512),
            (16, 2, Simd::Avx2),
            (1024, 2, Simd::Avx512),
            (1024, 64, Simd::Avx512),
            (512, 64, Simd::Avx2),
        ] {
            assert_eq!(
                fastest(Precision::F32, num_envs, threads),
                expected,
                "{num_envs} envs, {threads} threads"
            );
        }
        assert_eq!(fastest(Precision::F64, 8, 2), Simd::Avx2);
        assert_eq!(fastest(Precision::F64, 8, 1), Simd::Avx512);
    }
}
