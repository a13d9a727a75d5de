//! `Controller` in Python, and what a controller is made of.

use std::path::{Path, PathBuf};

use dappo_diagnose::controller::{Controller, ControllerConfig, Skills};
use dappo_diagnose::export::{DiagnoserSource, Export, RunSource, Sources};
use dappo_diagnose::{Diagnoser, TrainingFolder};
use dappo_learn::LearnError;
use dappo_learn::config::{Assignment, Config, Layers};
use dappo_learn::envs::EnvFactory;
use dappo_learn::evaluate::MeanVelocities;
use dappo_learn::run_folder::RunFolder;
use dappo_learn::walk::Onboard;
use dappo_nn::Policy;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::cli::policy::{self, LoadedPolicy};
use crate::errors::{Kind, from_learn, from_sim, raise};
use crate::factory::{TableFactory, to_python};
use crate::keywords::assignments;
use crate::pool::Pool;
use crate::run_robot::{self, OpenRun, RobotChanged};
use crate::vector_env::not_contiguous;

/// The parts of a controller that its policy does not bring along.
pub struct Parts {
    /// Run of the expert; the policy itself, as if nothing were damaged, for `None`.
    expert: Option<OpenRun>,
    /// Folder of the diagnoser's training.
    diagnoser: PathBuf,
}

impl Parts {
    /// Opens the parts; fails unless they were made with the robot of the policy's run.
    pub fn open(py: Python<'_>, run: &OpenRun, expert: Option<&Path>, diagnoser: &Path) -> PyResult<Self> {
        // The expert takes every robot for healthy.
        let expert = expert.map(|expert| run.open_beside(py, expert, false)).transpose()?;
        run.check_folder(py, diagnoser)?;
        Ok(Self { expert, diagnoser: diagnoser.to_owned() })
    }

    /// Reads all parts, and where they come from; `factory` and `config` are those of the policy's run.
    pub fn load(
        &self,
        folder: &RunFolder,
        config: &Config,
        factory: &TableFactory,
    ) -> dappo_learn::Result<(Skills, Sources)> {
        let names: Vec<String> = factory.space().classes().iter().map(|class| class.name.clone()).collect();
        let velocities = MeanVelocities::read(folder)?.ok_or_else(|| {
            let root = folder.root().display();
            LearnError::Invalid(format!(
                "{root} has no table of mean velocities; `dappo-batch evaluate {root}` writes it"
            ))
        })?;
        let baselines = velocities.of(&names)?;
        let (policy, policy_source) = load_policy(folder, config, factory)?;
        let (expert, expert_source) = match &self.expert {
            None => (policy.clone(), None),
            Some(run) => {
                let (policy, source) = load_policy(&run.folder, &run.config, factory)?;
                (policy, Some(source))
            }
        };
        let (training, _) = TrainingFolder::open(&self.diagnoser)?;
        let diagnoser = Diagnoser::load(&training.model())?;
        let sources = Sources {
            policy: policy_source,
            expert: expert_source,
            diagnoser: Some(DiagnoserSource {
                folder: last_name(&self.diagnoser),
                fingerprint: Diagnoser::fingerprint(&training.model())?,
            }),
        };
        Ok((Skills { policy, expert, diagnoser, baselines }, sources))
    }

    /// A controller of `robots` robots made of these parts.
    pub fn assemble(
        &self,
        folder: &RunFolder,
        config: &Config,
        factory: &TableFactory,
        wanted: ControllerConfig,
        robots: usize,
    ) -> dappo_learn::Result<Controller> {
        let (skills, _) = self.load(folder, config, factory)?;
        let twins = factory.backend(robots, None, factory.evaluation_physics())?;
        Controller::new(skills, wanted, twins)
    }
}

/// The policy of a run by itself, and where it comes from.
pub fn load_policy(
    folder: &RunFolder,
    config: &Config,
    factory: &TableFactory,
) -> dappo_learn::Result<(Policy, RunSource)> {
    let LoadedPolicy { policy, env_steps, fingerprint } = policy::load_trained(folder, config, factory)?;
    let (run, version) = (last_name(folder.root()), folder.version()?);
    Ok((policy, RunSource { run, version, env_steps, fingerprint }))
}

/// The name of a folder without those above it, which say nothing on another machine.
fn last_name(folder: &Path) -> String {
    folder.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The robot of an export with its damage classes.
pub fn open_export(py: Python<'_>, export: &Export, threads: usize) -> PyResult<TableFactory> {
    let mut config = export.config().map_err(|error| from_learn(&error))?;
    config.env.threads = Some(threads);
    run_robot::check_export(py, export)?;
    let factory = TableFactory::compile(py, &config)?;
    let found: Vec<String> = factory.space().classes().iter().map(|class| class.name.clone()).collect();
    if found != export.header().class_names() {
        let message = "the damage classes of its robot are not those of its policy; export again";
        return Err(raise(Kind::Checkpoint, message));
    }
    let sizes = factory.sizes(&config).map_err(|error| from_sim(&error))?;
    let (header, obs_dim) = (export.header(), sizes.obs_dim - sizes.code_length);
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
pub fn settings(trigger: &str, assignments: &[Assignment]) -> dappo_learn::Result<ControllerConfig> {
    let mut layers = Layers::default();
    layers.set("trigger", trigger)?;
    layers.assign(assignments)?;
    let config: ControllerConfig = layers.typed()?;
    config.check()?;
    Ok(config)
}

/// Robots that find out by themselves what broke, and walk on.
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
    #[pyo3(signature = (run, *, diagnoser, expert=None, num_robots=1, trigger="residual", settings=None,
                        threads=1, robot_changed=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments in Python")]
    fn new(
        py: Python<'_>,
        run: PathBuf,
        diagnoser: PathBuf,
        expert: Option<PathBuf>,
        num_robots: usize,
        trigger: &str,
        settings: Option<Bound<'_, PyAny>>,
        threads: usize,
        robot_changed: Option<&str>,
    ) -> PyResult<Self> {
        let settings = settings.map_or_else(|| Ok(Vec::new()), |given| assignments(&given, "settings"))?;
        let wanted = self::settings(trigger, &settings).map_err(|error| from_learn(&error))?;
        let mut run = OpenRun::open(py, &run, RobotChanged::parse(robot_changed)?)?;
        run.config.env.threads = Some(threads);
        let pool = Pool::new(run.config.env.threads)?;
        let factory = TableFactory::compile(py, &run.config)?;
        let parts = Parts::open(py, &run, expert.as_deref(), &diagnoser)?;
        let controller =
            pool.run(py, || parts.assemble(&run.folder, &run.config, &factory, wanted, num_robots))?;
        Ok(Self::wrap(controller, pool))
    }

    /// A controller from an export folder alone.
    #[staticmethod]
    #[pyo3(signature = (folder, *, num_robots=1, threads=1))]
    fn from_export(py: Python<'_>, folder: PathBuf, num_robots: usize, threads: usize) -> PyResult<Self> {
        let pool = Pool::new(Some(threads))?;
        let export = Export::open(&folder).map_err(|error| from_learn(&error))?;
        let (skills, settings) = pool.run(py, || export.controller())?;
        let factory = open_export(py, &export, threads)?;
        let controller = pool.run(py, || {
            let twins = factory.backend(num_robots, None, factory.evaluation_physics())?;
            Controller::new(skills, settings, twins)
        })?;
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

    /// The damage class that the policy is told of each robot.
    #[getter]
    fn damage_classes<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        PyArray1::from_iter(py, self.controller.classes().into_iter().map(|class| class as i64))
    }

    /// The next actions.
    fn act<'py>(
        &mut self,
        py: Python<'py>,
        obs: PyReadonlyArray2<'py, f32>,
        forward_velocity: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let robots = self.controller.robots();
        if obs.shape() != [robots, self.obs_dim] || forward_velocity.shape() != [robots] {
            return Err(raise(
                Kind::Shape,
                format!(
                    "obs have shape {:?} and forward_velocity {:?}, expected [{robots}, {}] (without damage code) and [{robots}]",
                    obs.shape(),
                    forward_velocity.shape(),
                    self.obs_dim
                ),
            ));
        }
        let rows = obs.as_slice().map_err(not_contiguous)?;
        let velocities = forward_velocity.as_slice().map_err(not_contiguous)?;
        let Self { controller, pool, .. } = self;
        let actions = pool.run(py, || controller.act(rows, velocities))?;
        PyArray1::from_vec(py, actions).reshape([robots, self.action_dim])
    }

    /// Begins anew with the robots of a mask, all for `None`.
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
