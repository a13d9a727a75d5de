//! `Diagnoser` in Python: a trained diagnoser without a controller, for trajectories that were logged.

use std::path::PathBuf;

use dappo_diagnose::trajectory::Trajectories;
use dappo_diagnose::{Diagnoser, TrainingFolder, Window};
use dappo_learn::RunPolicy;
use dappo_learn::envs::EnvFactory;
use dappo_nn::Policy;
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::arguments::not_contiguous;
use crate::errors::{Kind, OrRaise, raise};
use crate::factory::TableFactory;
use crate::kinds::RobotChanged;
use crate::pool::Pool;
use crate::run_robot::OpenRun;

/// A trained diagnoser, and what simulates the healthy twins that it compares robots with.
#[pyclass(name = "Diagnoser", module = "dappo_batch._core")]
pub struct PyDiagnoser {
    diagnoser: Diagnoser,
    expert: Policy,
    factory: TableFactory,
    pool: Pool,
}

#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
#[pymethods]
impl PyDiagnoser {
    /// Reads a diagnoser, and the expert that its twins follow.
    #[staticmethod]
    #[pyo3(signature = (folder, expert, *, threads=None, robot_changed=None))]
    fn load(
        py: Python<'_>,
        folder: PathBuf,
        expert: PathBuf,
        threads: Option<usize>,
        robot_changed: Option<RobotChanged>,
    ) -> PyResult<Self> {
        let pool = Pool::new(threads)?;
        let (training, _) = TrainingFolder::open(&folder).or_raise()?;
        let diagnoser = pool.run(py, || Diagnoser::load(&training.model()))?;
        let run = OpenRun::open(py, &expert, robot_changed)?;
        run.check_folder(py, &folder)?;
        let OpenRun { folder: run, mut config, .. } = run;
        // Threads depend on this machine, not on that of the training.
        config.env.threads = threads;
        let factory = TableFactory::compile(py, &config)?;
        let expert = pool.run(py, || RunPolicy::stateless(&run, &config, &factory))?.policy;
        let description = diagnoser.description();
        let (own, classes) = (description.subject.classes(), factory.space().classes().len());
        if (description.obs_dim, own) != (expert.obs_dim(), classes) {
            return Err(raise(
                Kind::Config,
                format!(
                    "the diagnoser has {own} damage classes and observations of {} numbers, the expert {classes} and {}; \
                     they must be of one robot",
                    description.obs_dim,
                    expert.obs_dim()
                ),
            ));
        }
        Ok(Self { diagnoser, expert, factory, pool })
    }

    /// Length of an observation, without damage code.
    #[getter]
    fn obs_dim(&self) -> usize {
        self.diagnoser.description().obs_dim
    }

    /// Length of an action.
    #[getter]
    fn action_dim(&self) -> usize {
        self.diagnoser.description().action_dim
    }

    /// Steps of a window, T.
    #[getter]
    fn timesteps(&self) -> usize {
        self.diagnoser.description().timesteps
    }

    /// Names of the damage classes.
    #[getter]
    fn class_names(&self) -> Vec<String> {
        self.diagnoser.description().subject.class_names.clone()
    }

    /// What the healthy twins of logged robots observe after each step.
    fn twin<'py>(
        &self,
        py: Python<'py>,
        obs: PyReadonlyArray3<'py, f32>,
        actions: PyReadonlyArray3<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let [robots, steps, _] = *actions.shape() else { return Err(shapes(&obs, &actions)) };
        if self.diagnoser.description().twin.is_none() {
            let message =
                "the diagnoser was trained on records without twins (preset `observation`) and has none";
            return Err(raise(Kind::Config, message));
        }
        let windows = self.windows(py, &obs, &actions)?;
        let rows: Vec<f32> = windows.into_iter().flat_map(|window| window.twin).collect();
        PyArray1::from_vec(py, rows).reshape([robots, steps, self.obs_dim()])
    }

    /// How probable every damage class is.
    fn diagnose<'py>(
        &self,
        py: Python<'py>,
        obs: PyReadonlyArray3<'py, f32>,
        actions: PyReadonlyArray3<'py, f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let windows = self.windows(py, &obs, &actions)?;
        let rows = self.pool.run(py, || -> dappo_learn::Result<_> {
            let rows = windows.iter().map(|window| self.diagnoser.probabilities_of(window));
            Ok(rows.collect::<dappo_learn::Result<Vec<_>>>()?.concat())
        })?;
        PyArray1::from_vec(py, rows).reshape([windows.len(), self.diagnoser.description().subject.classes()])
    }
}

impl PyDiagnoser {
    fn windows(
        &self,
        py: Python<'_>,
        obs: &PyReadonlyArray3<'_, f32>,
        actions: &PyReadonlyArray3<'_, f32>,
    ) -> PyResult<Vec<Window>> {
        let [robots, steps, action_dim] = *actions.shape() else { return Err(shapes(obs, actions)) };
        let expected = [robots, steps + 1, self.obs_dim()];
        if obs.shape() != expected || action_dim != self.action_dim() || robots == 0 {
            return Err(shapes(obs, actions));
        }
        let trajectories = Trajectories {
            steps,
            obs: obs.as_slice().map_err(not_contiguous)?,
            actions: actions.as_slice().map_err(not_contiguous)?,
        };
        let mode = self.diagnoser.description().twin;
        self.pool.run(py, || {
            let Some(mode) = mode else {
                return trajectories.without_twins(robots, self.obs_dim(), action_dim);
            };
            let twins = self.factory.backend(robots, None, self.factory.evaluation_physics())?;
            trajectories.windows(mode, &self.expert, twins)
        })
    }
}

fn shapes(obs: &PyReadonlyArray3<'_, f32>, actions: &PyReadonlyArray3<'_, f32>) -> PyErr {
    raise(
        Kind::Shape,
        format!(
            "obs have shape {:?} and actions {:?}, expected [N, T + 1, O] (without damage code) and [N, T, A]",
            obs.shape(),
            actions.shape()
        ),
    )
}
