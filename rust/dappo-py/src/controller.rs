//! `Controller` in Python, and what a controller is made of.

use std::path::{Path, PathBuf};

use dappo_diagnose::controller::{Controller, ControllerConfig, Parts};
use dappo_diagnose::export::Export;
use dappo_learn::LearnError;
use dappo_learn::config::Assignment;
use dappo_learn::envs::EnvFactory;
use dappo_learn::walk::Onboard;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arguments::not_contiguous;
use crate::errors::{Kind, OrRaise, raise};
use crate::factory::{TableFactory, to_python};
use crate::keywords::assignments;
use crate::kinds::RobotChanged;
use crate::pool::Pool;
use crate::run_robot::{self, OpenRun};

/// Opens the parts of a controller; fails unless they were made with the robot of the policy's run.
pub fn open_parts(py: Python<'_>, run: &OpenRun, expert: Option<&Path>, diagnoser: &Path) -> PyResult<Parts> {
    // The expert has no damage code, so that its damage classes may be others.
    let expert = expert.map(|expert| run.open_other(py, expert, false)).transpose()?;
    run.check_folder(py, diagnoser)?;
    let expert = expert.map(|OpenRun { folder, config, .. }| (folder, config));
    Ok(Parts { expert, diagnoser: diagnoser.to_owned() })
}

/// The robot of an export with its damage classes.
pub fn open_export(py: Python<'_>, export: &Export, threads: usize) -> PyResult<TableFactory> {
    let mut config = export.config().or_raise()?;
    config.env.threads = Some(threads);
    run_robot::check_export(py, export)?;
    let factory = TableFactory::compile(py, &config)?;
    let found: Vec<String> = factory.space().classes().iter().map(|class| class.name.clone()).collect();
    if found != export.header().class_names() {
        let message = "the damage classes of its robot are not those of its policy; export again";
        return Err(raise(Kind::Checkpoint, message));
    }
    let sizes = factory.sizes(&config).or_raise()?;
    let (header, obs_dim) = (export.header(), sizes.seen());
    let code_lengths = [0, factory.space().code_length()];
    if (header.obs_dim, header.action_dim) != (obs_dim, sizes.action_dim)
        || !code_lengths.contains(&header.policy.code_length)
    {
        let message = "the observations, actions or damage codes of its robot are not those of its policy; export again";
        return Err(raise(Kind::Checkpoint, message));
    }
    Ok(factory)
}

/// The settings of a controller.
pub fn settings(trigger: Option<&str>, assignments: &[Assignment]) -> dappo_learn::Result<ControllerConfig> {
    let trigger = trigger.map(|trigger| Assignment::Value("trigger".into(), trigger.into()));
    ControllerConfig::with(&[trigger.as_slice(), assignments].concat())
}

/// Controls robots online: detects damage, diagnoses it and adapts the policy.
#[pyclass(name = "Controller", module = "dappo_batch._core")]
pub struct PyController {
    controller: Controller,
    pool: Pool,
    obs_dim: usize,
    action_dim: usize,
}

impl PyController {
    fn wrap(controller: Controller, pool: Pool) -> Self {
        Self { obs_dim: controller.obs_dim(), action_dim: controller.action_dim(), controller, pool }
    }
}

#[expect(clippy::needless_pass_by_value, reason = "PyO3 hands arguments over by value")]
#[pymethods]
impl PyController {
    #[new]
    #[pyo3(signature = (run, *, diagnoser, expert=None, num_robots=1, trigger=None, settings=None,
                        threads=1, robot_changed=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments in Python")]
    fn new(
        py: Python<'_>,
        run: PathBuf,
        diagnoser: PathBuf,
        expert: Option<PathBuf>,
        num_robots: usize,
        trigger: Option<&str>,
        settings: Option<Bound<'_, PyAny>>,
        threads: usize,
        robot_changed: Option<RobotChanged>,
    ) -> PyResult<Self> {
        let settings = settings.map_or_else(|| Ok(Vec::new()), |given| assignments(&given, "settings"))?;
        let wanted = self::settings(trigger, &settings).or_raise()?;
        let mut run = OpenRun::open(py, &run, robot_changed)?;
        run.config.env.threads = Some(threads);
        let pool = Pool::new(run.config.env.threads)?;
        let factory = TableFactory::compile(py, &run.config)?;
        let parts = open_parts(py, &run, expert.as_deref(), &diagnoser)?;
        let controller =
            pool.run(py, || parts.assemble(&run.folder, &run.config, &factory, wanted, num_robots))?;
        Ok(Self::wrap(controller, pool))
    }

    /// A controller from an export folder alone.
    #[staticmethod]
    #[pyo3(signature = (folder, *, num_robots=1, threads=1))]
    fn from_export(py: Python<'_>, folder: PathBuf, num_robots: usize, threads: usize) -> PyResult<Self> {
        let pool = Pool::new(Some(threads))?;
        let export = Export::open(&folder).or_raise()?;
        let (skills, settings) = pool.run(py, || export.controller())?;
        let has_twins = skills.diagnoser.description().twin.is_some();
        let factory = has_twins.then(|| open_export(py, &export, threads)).transpose()?;
        let twins = || match &factory {
            Some(factory) => Ok(factory.backend(num_robots, None, factory.evaluation_physics())?),
            None => Err(LearnError::Invalid("the export has no twin".into())),
        };
        let controller = pool.run(py, || Controller::new(skills, settings, num_robots, twins))?;
        Ok(Self::wrap(controller, pool))
    }

    /// Number of robots.
    #[getter]
    fn num_robots(&self) -> usize {
        self.controller.robots()
    }

    /// Length of an observation, without damage code.
    #[getter]
    fn obs_dim(&self) -> usize {
        self.obs_dim
    }

    /// Length of an action.
    #[getter]
    fn action_dim(&self) -> usize {
        self.action_dim
    }

    /// Names of the damage classes.
    #[getter]
    fn class_names(&self) -> Vec<String> {
        self.controller.class_names().to_vec()
    }

    /// The assumed class of each robot.
    #[getter]
    fn damage_classes<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        PyArray1::from_iter(py, self.controller.classes().into_iter().map(|class| class as i64))
    }

    /// The next actions.
    #[pyo3(signature = (obs, forward_velocity=None))]
    fn act<'py>(
        &mut self,
        py: Python<'py>,
        obs: PyReadonlyArray2<'py, f32>,
        forward_velocity: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let robots = self.controller.robots();
        let velocities = forward_velocity.as_ref();
        if obs.shape() != [robots, self.obs_dim]
            || velocities.is_some_and(|velocities| velocities.shape() != [robots])
        {
            let velocities = velocities.map_or(&[][..], |velocities| velocities.shape());
            return Err(raise(
                Kind::Shape,
                format!(
                    "obs have shape {:?} and forward_velocity {velocities:?}, expected [{robots}, {}] (without damage code) and [{robots}]",
                    obs.shape(),
                    self.obs_dim
                ),
            ));
        }
        let rows = obs.as_slice().map_err(not_contiguous)?;
        let velocities =
            velocities.map_or(Ok(&[][..]), |velocities| velocities.as_slice()).map_err(not_contiguous)?;
        let Self { controller, pool, .. } = self;
        let actions = pool.run(py, || controller.act(rows, velocities))?;
        PyArray1::from_vec(py, actions).reshape([robots, self.action_dim])
    }

    /// Resets the robots of a mask, all for `None`.
    #[pyo3(signature = (mask=None))]
    fn reset(&mut self, py: Python<'_>, mask: Option<Vec<bool>>) -> PyResult<()> {
        let Self { controller, pool, .. } = self;
        pool.run(py, || controller.reset(mask.as_deref()))
    }

    /// Hands over what has happened since the last call, as dicts.
    fn take_events<'py>(&mut self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let event = |event| Ok(to_python(py, &event)?.cast_into::<PyDict>()?);
        self.controller.take_events().into_iter().map(event).collect()
    }
}
