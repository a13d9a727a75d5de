//! Terms of a task that are Python functions over all envs (`terms.py`): a backend around another one.

use dappo_sim::backend::{Backend, BackendSnapshot, ObsRows, Reset, StepOutputs};
use dappo_sim::task::Task;
use dappo_sim::{Physics, SimError};
use pyo3::prelude::*;

use crate::errors::{is_ours, to_sim};
use crate::warp::arrays::{copy, numbers, rows};

/// A backend whose task has terms in Python.
pub struct PythonTerms {
    inner: Box<dyn Backend>,
    /// A `dappo_batch.terms.PythonTerms`.
    terms: Py<PyAny>,
    classes: Vec<usize>,
    /// Actions of the last step, `[N, nu]`.
    actions: Vec<f32>,
}

impl PythonTerms {
    /// Adds the Python terms of its task to a backend, if there are any.
    pub fn around(inner: Box<dyn Backend>) -> PyResult<Box<dyn Backend>> {
        let task = inner.task();
        let observations: Vec<(&str, usize)> =
            task.python_observations().map(|(name, block)| (name, block.len())).collect();
        let rewards: Vec<&str> = task.python_rewards().map(|(name, ..)| name).collect();
        let failures = task.python_failures();
        if observations.is_empty() && rewards.is_empty() && failures.is_empty() {
            return Ok(inner);
        }
        let terms = Python::attach(|py| {
            let arguments = (observations, rewards, failures.to_vec(), task.dt());
            py.import("dappo_batch.terms")?.getattr("PythonTerms")?.call1(arguments).map(Bound::unbind)
        })?;
        let (envs, nu) = (inner.num_envs(), task.layout().nu);
        Ok(Box::new(Self { inner, terms, classes: vec![0; envs], actions: vec![0.0; envs * nu] }))
    }

    /// Calls a method with the arrays of a `TermBatch`.
    fn call<R>(
        &self,
        method: &str,
        read: impl FnOnce(Bound<'_, PyAny>) -> PyResult<R>,
    ) -> Result<R, SimError> {
        let (task, envs) = (self.inner.task(), self.classes.len());
        let (nq, nv) = (task.layout().nq, task.layout().nv);
        let (mut qpos, mut qvel) = (vec![0.0; envs * nq], vec![0.0; envs * nv]);
        self.inner.state(&mut qpos, &mut qvel)?;
        let command: Vec<f64> =
            (0..envs).flat_map(|env| task.command(self.inner.memory(env)).to_vec()).collect();
        let classes: Vec<i64> = self.classes.iter().map(|&class| class as i64).collect();
        Python::attach(|py| {
            let call = || {
                let arrays = (
                    rows(py, &qpos, envs)?,
                    rows(py, &qvel, envs)?,
                    rows(py, &self.actions, envs)?,
                    rows(py, &command, envs)?,
                    numbers(py, &classes),
                );
                read(self.terms.bind(py).call_method1(method, arrays)?)
            };
            call().map_err(|error| explain(py, &error, "a term of the task"))
        })
    }

    /// Writes the terms of the observations of the envs that `is_shown` selects.
    fn observe(&self, obs: &mut ObsRows<'_>, is_shown: impl Fn(usize) -> bool) -> Result<(), SimError> {
        let blocks: Vec<_> = self.inner.task().python_observations().map(|(_, block)| block).collect();
        if blocks.is_empty() {
            return Ok(());
        }
        let envs = self.classes.len();
        let values = self.call("observe", |found| {
            let of_block = |(item, block): (PyResult<Bound<'_, PyAny>>, &std::ops::Range<usize>)| {
                let mut values = vec![0.0_f32; envs * block.len()];
                copy(&item?, "a term of the observation", &mut values)?;
                Ok(values)
            };
            found.try_iter()?.zip(&blocks).map(of_block).collect::<PyResult<Vec<_>>>()
        })?;
        for (block, values) in blocks.iter().zip(&values) {
            for env in (0..envs).filter(|&env| is_shown(env)) {
                let row = env * obs.stride;
                obs.data[row + block.start..row + block.end]
                    .copy_from_slice(&values[env * block.len()..(env + 1) * block.len()]);
            }
        }
        Ok(())
    }
}

/// An exception of a function of a user, `what`: says where it was raised.
pub fn explain(py: Python<'_>, error: &PyErr, what: &str) -> SimError {
    if is_ours(py, error) {
        return to_sim(py, error);
    }
    let place = error.traceback(py).and_then(|traceback| traceback.format().ok()).unwrap_or_default();
    SimError::Config(format!("{what} raised {error}\n{}", place.trim_end()))
}

impl Backend for PythonTerms {
    fn physics(&self) -> Physics {
        self.inner.physics()
    }

    fn num_envs(&self) -> usize {
        self.inner.num_envs()
    }

    fn num_classes(&self) -> usize {
        self.inner.num_classes()
    }

    fn task(&self) -> &Task {
        self.inner.task()
    }

    fn memory(&self, env: usize) -> &[f64] {
        self.inner.memory(env)
    }

    fn reset(&mut self, resets: &[Reset], mut obs: ObsRows<'_>) -> Result<(), SimError> {
        let stride = obs.stride;
        self.inner.reset(resets, ObsRows { data: &mut *obs.data, stride })?;
        let nu = self.inner.task().layout().nu;
        let mut is_reset = vec![false; self.classes.len()];
        for reset in resets {
            is_reset[reset.env] = true;
            self.classes[reset.env] = reset.class;
            self.actions[reset.env * nu..(reset.env + 1) * nu].fill(0.0);
        }
        self.observe(&mut obs, |env| is_reset[env])
    }

    fn set_classes(&mut self, changes: &[(usize, usize)]) -> Result<(), SimError> {
        self.inner.set_classes(changes)?;
        for &(env, class) in changes {
            self.classes[env] = class;
        }
        Ok(())
    }

    fn step(&mut self, actions: &[f32], skip: &[bool], outputs: StepOutputs<'_>) -> Result<(), SimError> {
        let StepOutputs { mut obs, rewards, reward_terms, terminated, forward_velocity, diverged } = outputs;
        let stride = obs.stride;
        self.inner.step(
            actions,
            skip,
            StepOutputs {
                obs: ObsRows { data: &mut *obs.data, stride },
                rewards: &mut *rewards,
                reward_terms: &mut *reward_terms,
                terminated: &mut *terminated,
                forward_velocity,
                diverged: &mut *diverged,
            },
        )?;
        self.actions.copy_from_slice(actions);
        let envs = self.classes.len();
        let (values, failures) = self.call("judge", |found| {
            let (values, failures): (Vec<Bound<'_, PyAny>>, Vec<Bound<'_, PyAny>>) = found.extract()?;
            let numbers = values.iter().map(|item| {
                let mut numbers = vec![0.0_f64; envs];
                copy(item, "a term of the reward", &mut numbers).map(|()| numbers)
            });
            let flags = failures.iter().map(|item| {
                let mut flags = vec![false; envs];
                copy(item, "a termination", &mut flags).map(|()| flags)
            });
            Ok((numbers.collect::<PyResult<Vec<_>>>()?, flags.collect::<PyResult<Vec<_>>>()?))
        })?;
        let task = self.inner.task();
        // A robot whose physics has diverged is at rest elsewhere.
        for env in (0..envs).filter(|&env| !skip[env] && !diverged[env]) {
            for ((_, index, weight), values) in task.python_rewards().zip(&values) {
                let value = weight * values[env];
                reward_terms[env * task.reward_len() + index] = value;
                rewards[env] += value;
            }
            terminated[env] |= failures.iter().any(|flags| flags[env]);
        }
        self.observe(&mut obs, |env| !skip[env])
    }

    fn state(&self, qpos: &mut [f64], qvel: &mut [f64]) -> Result<(), SimError> {
        self.inner.state(qpos, qvel)
    }

    fn set_state(
        &mut self,
        qpos: &[f64],
        qvel: &[f64],
        skip: &[bool],
        mut obs: ObsRows<'_>,
    ) -> Result<(), SimError> {
        let stride = obs.stride;
        self.inner.set_state(qpos, qvel, skip, ObsRows { data: &mut *obs.data, stride })?;
        self.observe(&mut obs, |env| !skip[env])
    }

    fn snapshot(&self) -> Result<BackendSnapshot, SimError> {
        self.inner.snapshot()
    }

    fn restore(&mut self, snapshot: &BackendSnapshot) -> Result<(), SimError> {
        self.inner.restore(snapshot)?;
        self.classes.copy_from_slice(&snapshot.classes);
        Ok(())
    }
}
