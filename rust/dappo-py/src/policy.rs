//! `Policy` in Python: a trained policy.

use std::borrow::Cow;
use std::path::PathBuf;

use dappo_diagnose::export::Export;
use dappo_learn::RunPolicy;
use dappo_learn::envs::EnvFactory;
use dappo_nn::{Policy, PolicyState};
use dappo_sim::DamageSpace;
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::arguments::not_contiguous;
use crate::controller;
use crate::errors::{Kind, OrRaise, raise};
use crate::factory::TableFactory;
use crate::kinds::RobotChanged;
use crate::pool::Pool;
use crate::run_robot::OpenRun;

/// Actions, and what a recurrent policy remembers after its step.
type Step<'py> = (Bound<'py, PyArray2<f32>>, Bound<'py, PyArray3<f32>>);

/// A trained policy without exploration noise.
#[pyclass(name = "Policy", module = "dappo_batch._core")]
pub struct PyPolicy {
    policy: Policy,
    pool: Pool,
    space: DamageSpace,
    /// Damage codes of all classes, `[classes, code_length]`; empty rows for a policy that observes no damage.
    codes: Vec<f32>,
    env_steps: u64,
}

#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
#[pymethods]
impl PyPolicy {
    /// Reads the policy in the newest checkpoint of a run.
    #[staticmethod]
    #[pyo3(signature = (run, *, threads=None, robot_changed=None))]
    fn load(
        py: Python<'_>,
        run: PathBuf,
        threads: Option<usize>,
        robot_changed: Option<RobotChanged>,
    ) -> PyResult<Self> {
        let pool = Pool::new(threads)?;
        let OpenRun { folder, config, .. } = OpenRun::open(py, &run, robot_changed)?;
        let factory = TableFactory::compile(py, &config)?;
        let RunPolicy { policy, env_steps, .. } =
            pool.run(py, || RunPolicy::newest(&folder, &config, &factory))?;
        Ok(Self::new(policy, pool, factory.space(), env_steps))
    }

    /// Reads the policy of an export folder.
    #[staticmethod]
    #[pyo3(signature = (folder, *, threads=None))]
    fn from_export(py: Python<'_>, folder: PathBuf, threads: Option<usize>) -> PyResult<Self> {
        let pool = Pool::new(threads)?;
        let export = Export::open(&folder).or_raise()?;
        let factory = controller::open_export(py, &export, 1)?;
        let policy = pool.run(py, || export.policy())?;
        Ok(Self::new(policy, pool, factory.space(), export.header().sources.policy.env_steps))
    }

    /// Length of an observation, without damage code.
    #[getter]
    fn obs_dim(&self) -> usize {
        self.policy.obs_dim()
    }

    /// Length of an action.
    #[getter]
    fn action_dim(&self) -> usize {
        self.policy.action_dim()
    }

    /// Length of the damage code in its observations; 0 if it does not observe damage.
    #[getter]
    fn code_length(&self) -> usize {
        self.policy.code_length()
    }

    /// Names of the damage classes.
    #[getter]
    fn class_names(&self) -> Vec<String> {
        self.space.classes().iter().map(|class| class.name.clone()).collect()
    }

    /// The class that a damage spec names.
    fn parse(&self, spec: &str) -> PyResult<i64> {
        self.space.parse(spec).map(|class| class as i64).or_raise()
    }

    /// Env steps that it was trained for.
    #[getter]
    fn env_steps(&self) -> u64 {
        self.env_steps
    }

    /// Units of its memory; 0 for a policy without one.
    #[getter]
    fn memory(&self) -> usize {
        self.policy.initial_state(0).units()
    }

    /// The actions for rows of observations: without damage code, each with the code of a class, or complete.
    #[pyo3(signature = (obs, damage_classes=None))]
    fn act<'py>(
        &self,
        py: Python<'py>,
        obs: PyReadonlyArray2<'py, f32>,
        damage_classes: Option<PyReadonlyArray1<'py, i64>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let rows = obs.as_slice().map_err(not_contiguous)?;
        let complete = self.complete(rows, obs.shape(), damage_classes.as_ref())?;
        let actions = self.pool.run(py, || dappo_learn::Result::Ok(self.policy.mean_actions(&complete)?))?;
        PyArray1::from_vec(py, actions).reshape([obs.shape()[0], self.policy.action_dim()])
    }

    /// The same for a recurrent policy, with what it remembers before and after the step, `[N, 2, H]`.
    #[pyo3(signature = (obs, state, damage_classes=None))]
    fn step<'py>(
        &self,
        py: Python<'py>,
        obs: PyReadonlyArray2<'py, f32>,
        state: PyReadonlyArray3<'py, f32>,
        damage_classes: Option<PyReadonlyArray1<'py, i64>>,
    ) -> PyResult<Step<'py>> {
        let rows = obs.as_slice().map_err(not_contiguous)?;
        let complete = self.complete(rows, obs.shape(), damage_classes.as_ref())?;
        let shape = [obs.shape()[0], 2, self.memory()];
        let numbers = state.as_slice().map_err(not_contiguous)?.to_vec();
        let state = PolicyState::of(self.memory(), numbers).filter(|_| state.shape() == shape);
        let Some(mut state) = state else {
            return Err(raise(Kind::Shape, format!("expected a state of finite numbers, {shape:?}")));
        };
        let actions =
            self.pool.run(py, || dappo_learn::Result::Ok(self.policy.step(&complete, &mut state)?))?;
        let actions = PyArray1::from_vec(py, actions).reshape([shape[0], self.policy.action_dim()])?;
        Ok((actions, PyArray1::from_slice(py, state.numbers()).reshape(shape)?))
    }
}

impl PyPolicy {
    fn new(policy: Policy, pool: Pool, space: &DamageSpace, env_steps: u64) -> Self {
        let codes = if policy.code_length() > 0 { space.codes() } else { Vec::new() };
        Self { policy, pool, codes, space: space.clone(), env_steps }
    }

    /// Rows `[N, O + K]` of an array of this shape, with the codes of classes if there are any.
    fn complete<'a>(
        &self,
        rows: &'a [f32],
        shape: &[usize],
        damage_classes: Option<&PyReadonlyArray1<'_, i64>>,
    ) -> PyResult<Cow<'a, [f32]>> {
        let (robots, width) = (shape[0], shape[1]);
        let (obs_dim, code_length) = (self.policy.obs_dim(), self.policy.code_length());
        match damage_classes {
            Some(classes) if width == obs_dim && classes.shape() == [robots] => {
                Ok(Cow::Owned(self.with_codes(rows, classes.as_slice().map_err(not_contiguous)?)?))
            }
            None if width == obs_dim + code_length => Ok(Cow::Borrowed(rows)),
            _ => {
                let classes = damage_classes.map(|classes| classes.shape().to_vec());
                let classes =
                    classes.map_or_else(String::new, |shape| format!(" and damage_class {shape:?}"));
                Err(raise(
                    Kind::Shape,
                    format!(
                        "obs have shape {shape:?}{classes}, expected [N, {obs_dim}] (without damage code) and [N], \
                         or [N, {}] (with it) and no damage_class",
                        obs_dim + code_length
                    ),
                ))
            }
        }
    }

    /// Appends the code of its class to every observation.
    fn with_codes(&self, rows: &[f32], classes: &[i64]) -> PyResult<Vec<f32>> {
        let (known, code_length) = (self.space.classes().len(), self.policy.code_length());
        let mut coded = Vec::with_capacity(classes.len() * self.policy.transform().width());
        for (row, &class) in rows.chunks_exact(self.policy.obs_dim()).zip(classes) {
            let Some(class) = usize::try_from(class).ok().filter(|&class| class < known) else {
                let message =
                    format!("damage class {class} does not exist; the classes are 0 to {}", known - 1);
                return Err(raise(Kind::Config, message));
            };
            coded.extend_from_slice(row);
            coded.extend_from_slice(&self.codes[class * code_length..][..code_length]);
        }
        Ok(coded)
    }
}
