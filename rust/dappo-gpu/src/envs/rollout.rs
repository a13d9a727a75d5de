//! Rollouts.

use cubecl::client::Client;
use cubecl::prelude::*;
use dappo_lanes::Precision;

use super::buffer::{Buffer, cube, cubes};
use super::networks::{Networks, Uploaded};
use super::{Envs, failure};
use crate::engine::{Number, check_process};
use crate::error::Error;
use crate::kernel::advance;
use crate::task::kernels::{OUTCOME, begin_step, end, end_step};

/// Rows that go through the value net at once, about.
const ROWS: usize = 1 << 17;

/// A rollout of T steps of N envs, time-major.
#[derive(Debug, Clone, Default)]
pub struct Collected {
    /// Observations before each step, `[T, N, O]`.
    pub obs: Vec<f32>,
    /// Actions, `[T, N, A]`.
    pub actions: Vec<f32>,
    /// Their means, `[T, N, A]`.
    pub means: Vec<f32>,
    /// Their log-densities, `[T, N]`.
    pub log_probs: Vec<f32>,
    /// Values of the observations, `[T, N]`.
    pub values: Vec<f32>,
    /// Values of the last observations of episodes that the time limit has ended, `[T, N]`; 0 elsewhere.
    pub final_values: Vec<f32>,
    /// Values of the observations after the last step, `[N]`.
    pub last_values: Vec<f32>,
    /// Rewards, `[T, N]`.
    pub rewards: Vec<f32>,
    /// Velocities along +x, m/s, `[T, N]`.
    pub forward_velocity: Vec<f32>,
    /// Failures, `[T, N]`.
    pub terminated: Vec<bool>,
    /// Time limits, `[T, N]`.
    pub truncated: Vec<bool>,
    /// Worlds that diverged.
    pub diverged: u64,
}

/// The buffers of a rollout.
pub(super) struct Buffers {
    pub obs: Buffer,
    pub final_obs: Buffer,
    pub actions: Buffer,
    pub means: Buffer,
    pub log_probs: Buffer,
    pub values: Buffer,
    pub outcomes: Buffer,
}

impl Buffers {
    fn read(&self, client: &Client, horizon: usize, envs: usize, width: usize) -> Result<Collected, Error> {
        let handles = [&self.obs, &self.actions, &self.means, &self.log_probs, &self.values, &self.outcomes]
            .map(|buffer| buffer.handle.clone());
        let bytes = client.read(handles.to_vec()).map_err(failure)?;
        let mut arrays = bytes.iter().map(|bytes| f32::from_bytes(bytes).to_vec());
        let mut next = || arrays.next().unwrap_or_default();
        let mut collected = Collected {
            obs: next(),
            actions: next(),
            means: next(),
            log_probs: next(),
            values: next(),
            final_values: vec![0.0; horizon * envs],
            ..Collected::default()
        };
        collected.obs.truncate(horizon * envs * width);
        collected.last_values = collected.values.split_off(horizon * envs);
        for outcome in next().chunks_exact(OUTCOME) {
            let [reward, velocity, ends] = [outcome[0], outcome[1], outcome[2]];
            let ends = ends as u32;
            let has = |end: f64| ends & end as u32 != 0;
            collected.rewards.push(reward);
            collected.forward_velocity.push(velocity);
            collected.terminated.push(has(end::TERMINATED));
            collected.truncated.push(has(end::TRUNCATED));
            collected.diverged += u64::from(has(end::DIVERGED));
        }
        Ok(collected)
    }
}

impl Envs {
    /// Runs a policy for `horizon` steps. `first_step` numbers them over the whole run, so that every (env, step) has
    /// noise of its own.
    ///
    /// # Errors
    /// If the device fails.
    pub fn collect(
        &mut self,
        networks: &Networks<'_>,
        horizon: usize,
        first_step: u64,
    ) -> Result<Collected, Error> {
        check_process(self.process)?;
        match self.precision {
            Precision::F32 => self.collect_as::<f32>(networks, horizon, first_step),
            Precision::F64 => self.collect_as::<f64>(networks, horizon, first_step),
        }
    }

    fn collect_as<F: Number>(
        &mut self,
        networks: &Networks<'_>,
        horizon: usize,
        first_step: u64,
    ) -> Result<Collected, Error> {
        let (envs, width, nu) = (self.len, self.task.plan.obs_len(), self.task.plan.nu());
        let empty = |len: usize| Buffer::empty::<f32>(&self.client, len);
        let buffers = Buffers {
            obs: empty((horizon + 1) * envs * width),
            // Written, and read, only where an episode has ended.
            final_obs: empty(horizon * envs * width),
            actions: empty(horizon * envs * nu),
            means: empty(horizon * envs * nu),
            log_probs: empty(horizon * envs),
            values: empty((horizon + 1) * envs),
            outcomes: empty(horizon * envs * OUTCOME),
        };
        let observed = width - self.task.plan.code;
        let policy = Uploaded::new(&self.client, networks, networks.policy, observed);
        let value = Uploaded::new(&self.client, networks, networks.value, observed);
        let std: Vec<f32> = networks.log_std.iter().map(|log_std| log_std.exp()).collect();
        let std = Buffer::of(&self.client, &std);
        let all: Vec<u32> = (0..envs as u32).collect();
        self.gather(&self.obs, &all, &buffers.obs);
        for step in 0..horizon {
            let row = step * envs;
            self.run(&policy, &buffers.obs, row * width, &buffers.means, row * nu, envs);
            self.sample::<F>(networks.log_std, &std, &buffers, step, first_step + step as u64);
            self.step::<F>(&buffers, step);
        }
        let steps = (ROWS / envs).clamp(1, horizon + 1);
        for first in (0..=horizon).step_by(steps) {
            let rows = steps.min(horizon + 1 - first) * envs;
            let row = first * envs;
            self.run(&value, &buffers.obs, row * width, &buffers.values, row, rows);
        }
        self.obs = Buffer::empty::<f32>(&self.client, envs * width);
        let last: Vec<u32> = all.iter().map(|env| (horizon * envs) as u32 + env).collect();
        self.gather(&buffers.obs, &last, &self.obs);
        let mut collected = buffers.read(&self.client, horizon, envs, width)?;
        self.bootstrap(&value, &buffers, &mut collected)?;
        Ok(collected)
    }

    /// Values of the last observations of the episodes that the time limit has cut short.
    fn bootstrap(
        &self,
        net: &Uploaded<'_>,
        buffers: &Buffers,
        collected: &mut Collected,
    ) -> Result<(), Error> {
        let ends = collected.truncated.iter().zip(&collected.terminated).enumerate();
        let cut: Vec<u32> =
            ends.filter(|(_, (cut, fell))| **cut && !**fell).map(|(row, _)| row as u32).collect();
        if cut.is_empty() {
            return Ok(());
        }
        let rows = Buffer::empty::<f32>(&self.client, cut.len() * self.task.plan.obs_len());
        self.gather(&buffers.final_obs, &cut, &rows);
        let values = Buffer::empty::<f32>(&self.client, cut.len());
        self.run(net, &rows, 0, &values, 0, cut.len());
        let bytes = self.client.read_one(values.handle).map_err(failure)?;
        for (&row, &value) in cut.iter().zip(f32::from_bytes(&bytes)) {
            collected.final_values[row as usize] = value;
        }
        Ok(())
    }

    /// Advances all envs by one step.
    pub(super) fn step<F: Number>(&self, buffers: &Buffers, step: usize) {
        let (client, envs, task) = (&self.client, self.len, &self.task);
        let shape = task.places.shape;
        let (width, nu) = (task.plan.obs_len(), task.plan.nu());
        // SAFETY: all lengths are those of the buffers, rows are those of the table of constants, and all loops end.
        unsafe {
            begin_step::launch_unchecked::<F>(
                client,
                cubes(envs),
                cube(),
                self.state.arg(),
                self.ctrl.arg(),
                self.memory.arg(),
                self.clocks.arg(),
                self.rows.arg(),
                self.classes.arg(),
                self.models.arg(),
                buffers.actions.arg(),
                step * envs * nu,
                envs,
                self.count,
                task.clone(),
            );
            self.vary::<F>();
            advance::launch_unchecked::<F>(
                client,
                cubes(envs * shape.lanes),
                cube(),
                self.numbers.arg(),
                self.rows.arg(),
                self.ctrl.arg(),
                self.state.arg(),
                self.readings.arg(),
                envs,
                task.plan.substeps,
                shape,
            );
            end_step::launch_unchecked::<F>(
                client,
                cubes(envs),
                cube(),
                self.state.arg(),
                self.readings.arg(),
                self.ctrl.arg(),
                self.memory.arg(),
                self.clocks.arg(),
                self.rows.arg(),
                self.placed.arg(),
                self.classes.arg(),
                self.models.arg(),
                buffers.obs.arg(),
                buffers.final_obs.arg(),
                buffers.outcomes.arg(),
                (step + 1) * envs * width,
                step * envs * width,
                step * envs * OUTCOME,
                envs,
                self.count,
                task.clone(),
            );
        }
        self.settle::<F>(&buffers.obs, (step + 1) * envs * width);
    }
}
