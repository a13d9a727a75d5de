//! The device step by step, driven by the vector env: for evaluations, controllers, records and comparisons.

use dappo_sim::backend::{Backend, BackendSnapshot, ObsRows, Reset, StepOutputs, check_class};
use dappo_sim::task::Task;
use dappo_sim::{Physics, SimError, WarpDevice};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{copy, numbers, rows, vector};
use super::{Handle, Room, devices, undisturbed};

/// A `Stepper` of `kernels/stepper.py`.
pub struct WarpBackend {
    stepper: Handle,
    device: WarpDevice,
    task: Task,
    num_classes: usize,
    classes: Vec<usize>,
    /// Length of the state of the physics of an env.
    row: usize,
}

/// The results of a step, copied from the device.
struct StepOutcome {
    obs: Vec<f32>,
    rewards: Vec<f32>,
    terminated: Vec<bool>,
    forward_velocity: Vec<f32>,
    diverged: Vec<bool>,
}

impl WarpBackend {
    /// A backend for `num_envs` robots of a `dappo_batch.model.ClassTable`.
    pub fn new(
        table: &Py<PyAny>,
        task: Task,
        reward: Option<&str>,
        num_envs: usize,
        num_classes: usize,
        device: WarpDevice,
        room: Room,
    ) -> Result<Self, SimError> {
        let (stepper, row) = undisturbed(|py| {
            let options = PyDict::new(py);
            options.set_item("device", device.name())?;
            options.set_item("reward", reward)?;
            options.set_item("njmax", room.njmax)?;
            options.set_item("nconmax", room.nconmax)?;
            let arguments = (table.bind(py), num_envs);
            let stepper = devices(py)?.call_method("open_stepper", arguments, Some(&options))?;
            let row = stepper.getattr("row_length")?.extract()?;
            Ok((Handle::new(stepper), row))
        })?;
        Ok(Self { stepper, device, task, num_classes, classes: vec![0; num_envs], row })
    }

    /// Writes the observations of all envs but those to skip.
    fn show(&self, shown: &[f32], skip: impl Fn(usize) -> bool, obs: ObsRows<'_>) {
        let (width, ObsRows { data, stride }) = (self.task.obs_dim(), obs);
        for (env, row) in shown.chunks_exact(width).enumerate().filter(|(env, _)| !skip(*env)) {
            data[env * stride..env * stride + width].copy_from_slice(row);
        }
    }

    fn expect(&self, what: &'static str, got: usize, width: usize) -> Result<(), SimError> {
        let expected = self.classes.len() * width;
        if got == expected { Ok(()) } else { Err(SimError::Shape { what, got, expected }) }
    }
}

impl Backend for WarpBackend {
    fn physics(&self) -> Physics {
        Physics::Warp(self.device)
    }

    fn num_envs(&self) -> usize {
        self.classes.len()
    }

    fn num_classes(&self) -> usize {
        self.num_classes
    }

    fn task(&self) -> &Task {
        &self.task
    }

    fn memory(&self, _env: usize) -> &[f64] {
        &[]
    }

    fn reset(&mut self, resets: &[Reset], obs: ObsRows<'_>) -> Result<(), SimError> {
        let mut is_reset = vec![false; self.num_envs()];
        for reset in resets {
            check_class(reset.class, self.num_classes)?;
            self.classes[reset.env] = reset.class;
            is_reset[reset.env] = true;
        }
        let (envs, classes): (Vec<i64>, Vec<i64>) =
            resets.iter().map(|reset| (reset.env as i64, reset.class as i64)).unzip();
        let (keys, episodes): (Vec<u64>, Vec<u64>) =
            resets.iter().map(|reset| (reset.key, reset.episode)).unzip();
        let stepper = &self.stepper;
        let shown: Vec<f32> = undisturbed(|py| {
            let arguments =
                (numbers(py, &envs), numbers(py, &classes), numbers(py, &keys), numbers(py, &episodes));
            vector(&stepper.bind(py)?.call_method1("reset", arguments)?)
        })?;
        self.show(&shown, |env| !is_reset[env], obs);
        Ok(())
    }

    fn set_classes(&mut self, changes: &[(usize, usize)]) -> Result<(), SimError> {
        changes.iter().try_for_each(|&(_, class)| check_class(class, self.num_classes))?;
        for &(env, class) in changes {
            self.classes[env] = class;
        }
        let (envs, classes): (Vec<i64>, Vec<i64>) =
            changes.iter().map(|&(env, class)| (env as i64, class as i64)).unzip();
        let stepper = &self.stepper;
        undisturbed(|py| {
            let arguments = (numbers(py, &envs), numbers(py, &classes));
            stepper.bind(py)?.call_method1("set_classes", arguments).map(|_| ())
        })
    }

    fn step(&mut self, actions: &[f32], skip: &[bool], outputs: StepOutputs<'_>) -> Result<(), SimError> {
        self.expect("actions", actions.len(), self.task.layout().nu)?;
        self.expect("skip", skip.len(), 1)?;
        let (stepper, envs) = (&self.stepper, self.classes.len());
        let found = undisturbed(|py| {
            let arguments = (rows(py, actions, envs)?, numbers(py, skip));
            let step = stepper.bind(py)?.call_method1("step", arguments)?;
            Ok(StepOutcome {
                obs: vector(&step.getattr("obs")?)?,
                rewards: vector(&step.getattr("rewards")?)?,
                terminated: vector(&step.getattr("terminated")?)?,
                forward_velocity: vector(&step.getattr("forward_velocity")?)?,
                diverged: vector(&step.getattr("diverged")?)?,
            })
        })?;
        // The kernels sum the terms of the reward.
        let StepOutputs { obs, rewards, reward_terms: _, terminated, forward_velocity, diverged } = outputs;
        for env in (0..envs).filter(|&env| !skip[env]) {
            rewards[env] = f64::from(found.rewards[env]);
            terminated[env] = found.terminated[env];
            forward_velocity[env] = f64::from(found.forward_velocity[env]);
            diverged[env] = found.diverged[env];
        }
        self.show(&found.obs, |env| skip[env], obs);
        Ok(())
    }

    fn state(&self, qpos: &mut [f64], qvel: &mut [f64]) -> Result<(), SimError> {
        self.expect("qpos", qpos.len(), self.task.layout().nq)?;
        self.expect("qvel", qvel.len(), self.task.layout().nv)?;
        let stepper = &self.stepper;
        undisturbed(|py| {
            let state = stepper.bind(py)?.call_method0("state")?;
            copy(&state.get_item(0)?, "qpos", qpos)?;
            copy(&state.get_item(1)?, "qvel", qvel)
        })
    }

    fn set_state(
        &mut self,
        qpos: &[f64],
        qvel: &[f64],
        skip: &[bool],
        obs: ObsRows<'_>,
    ) -> Result<(), SimError> {
        self.expect("qpos", qpos.len(), self.task.layout().nq)?;
        self.expect("qvel", qvel.len(), self.task.layout().nv)?;
        self.expect("skip", skip.len(), 1)?;
        let (stepper, envs) = (&self.stepper, self.classes.len());
        let shown: Vec<f32> = undisturbed(|py| {
            let arguments = (rows(py, qpos, envs)?, rows(py, qvel, envs)?, numbers(py, skip));
            vector(&stepper.bind(py)?.call_method1("set_state", arguments)?)
        })?;
        self.show(&shown, |env| skip[env], obs);
        Ok(())
    }

    fn snapshot(&self) -> Result<BackendSnapshot, SimError> {
        let stepper = &self.stepper;
        let rows: Vec<f32> = undisturbed(|py| vector(&stepper.bind(py)?.call_method0("snapshot")?))?;
        let rows = rows.into_iter().map(f64::from).collect();
        Ok(BackendSnapshot { row: self.row, rows, classes: self.classes.clone() })
    }

    fn restore(&mut self, snapshot: &BackendSnapshot) -> Result<(), SimError> {
        let envs = self.classes.len();
        snapshot.check(self.row, envs, self.num_classes)?;
        let state: Vec<f32> = snapshot.rows.iter().map(|number| *number as f32).collect();
        let classes: Vec<i64> = snapshot.classes.iter().map(|class| *class as i64).collect();
        let stepper = &self.stepper;
        undisturbed(|py| {
            let arguments = (rows(py, &state, envs)?, numbers(py, &classes));
            stepper.bind(py)?.call_method1("restore", arguments).map(|_| ())
        })?;
        self.classes.copy_from_slice(&snapshot.classes);
        Ok(())
    }
}
