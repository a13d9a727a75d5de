//! Policies of other learners: Python functions (`outside_policy.py`) that choose actions.

use std::convert::Infallible;
use std::str::FromStr;
use std::sync::Arc;

use dappo_learn::Sizes;
use dappo_learn::walk::MeanActions;
use dappo_nn::PolicyState;
use pyo3::prelude::*;

use crate::keywords::FromValue;
use crate::python_terms::explain;
use crate::warp::arrays::{copy, rows};

/// The function that an argument gives: `module:function` on the command line, any callable in Python.
#[derive(Debug, Clone)]
pub enum Function {
    Named(String),
    Given(Arc<Py<PyAny>>),
}

impl FromStr for Function {
    type Err = Infallible;

    fn from_str(name: &str) -> Result<Self, Infallible> {
        Ok(Self::Named(name.to_owned()))
    }
}

impl FromValue for Function {
    fn from_value(value: &Bound<'_, PyAny>, _: &str) -> PyResult<Self> {
        Ok(Self::Given(Arc::new(value.clone().unbind())))
    }
}

/// A policy that is a Python function.
pub struct OutsidePolicy {
    /// A `dappo_batch.outside_policy.OutsidePolicy`.
    inner: Py<PyAny>,
    name: String,
    folder: String,
    /// Length of an observation, damage code included.
    obs_dim: usize,
    action_dim: usize,
}

impl OutsidePolicy {
    /// The policy for observations, with damage code, and actions of these lengths; fails if there is no such function.
    pub fn new(py: Python<'_>, function: &Function, sizes: Sizes) -> PyResult<Self> {
        let (obs_dim, action_dim) = (sizes.seen() + sizes.code_length, sizes.action_dim);
        let class = py.import("dappo_batch.outside_policy")?.getattr("OutsidePolicy")?;
        let inner = match function {
            Function::Named(name) => class.call1((name, action_dim))?,
            Function::Given(function) => class.call1((function.as_ref(), action_dim))?,
        };
        let (name, folder) = (inner.getattr("name")?.extract()?, inner.getattr("folder")?.extract()?);
        Ok(Self { inner: inner.unbind(), name, folder, obs_dim, action_dim })
    }

    /// Its name for people.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its name as part of the name of a folder.
    pub fn folder(&self) -> &str {
        &self.folder
    }

    /// Begins new episodes.
    pub fn reset(&self, py: Python<'_>) -> PyResult<()> {
        self.inner.call_method0(py, "reset").map(drop)
    }
}

impl MeanActions for OutsidePolicy {
    fn mean_actions(&self, obs: &[f32], _: &mut PolicyState) -> dappo_learn::Result<Vec<f32>> {
        let robots = obs.len() / self.obs_dim;
        Python::attach(|py| {
            let call = || {
                let found = self.inner.call_method1(py, "act", (rows(py, obs, robots)?,))?;
                let mut actions = vec![0.0; robots * self.action_dim];
                copy(found.bind(py), "actions", &mut actions).map(|()| actions)
            };
            call().map_err(|error| explain(py, &error, "the policy").into())
        })
    }
}
