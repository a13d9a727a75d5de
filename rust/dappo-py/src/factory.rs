//! Makes vector envs for a configuration: Python compiles the class table, Rust simulates it.

use dappo_learn::config::Config;
#[cfg(feature = "gpu")]
use dappo_learn::engine::GpuEngine;
use dappo_learn::engine::{HostEngine, RolloutEngine};
use dappo_learn::envs::EnvFactory;
use dappo_learn::memory::check_training;
use dappo_learn::{Sizes, Symmetry};
#[cfg(feature = "gpu")]
use dappo_sim::backend::gpu::GpuEnvs;
use dappo_sim::backend::lanes::LaneTable;
#[cfg(feature = "gpu")]
use dappo_sim::rng::env_keys;
use dappo_sim::simd;
use dappo_sim::task::{MirroredParts, Reflections, Task};
use dappo_sim::threads::available;
#[cfg(feature = "gpu")]
use dappo_sim::vector_env::VectorEnvConfig;
use dappo_sim::{Backend, BackendKind, DamageSpace, Layout, Physics, Robot, SimError, VectorEnv};
use pyo3::IntoPyObjectExt;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::class_table::{BackendOptions, ClassTable};
use crate::errors::{Kind, OrRaise, raise, to_sim};
use crate::symmetry;
use crate::warp::{self, Room, WarpEngine};

/// The class table of a configuration.
pub struct TableFactory {
    table: Py<PyAny>,
    robot: Robot,
    history: Option<usize>,
    space: DamageSpace,
    layout: Layout,
    /// Integrator of the compiled models, as MuJoCo names it.
    integrator: String,
    /// Threads of the pool that the backends will compute in.
    threads: usize,
    room: Room,
    /// The compiled robot of the lane engine, or why libmujoco simulates it on the CPU.
    lanes: Result<LaneTable, String>,
    training: Physics,
    evaluation: Physics,
    /// Why `ppo.symmetry = "auto"` is off for this robot, if it is.
    asymmetry: Option<String>,
}

impl TableFactory {
    /// Compiles the robot of a configuration with all its damage classes.
    pub fn compile(py: Python<'_>, config: &Config) -> PyResult<Self> {
        for module in &config.damage.modules {
            py.import("dappo_batch.terms")?.call_method1("import_module", (module,))?;
        }
        let options = PyDict::new(py);
        options.set_item("types", config.damage.types.clone())?;
        options.set_item("max_damaged_limbs", config.damage.max_damaged_limbs)?;
        options.set_item("max_damages_per_limb", config.damage.max_damages_per_limb)?;
        options.set_item("severity", to_python(py, &config.damage.severity)?)?;
        options.set_item("severity_levels", config.damage.severity_levels)?;
        options.set_item("physics", config.env.physics.clone())?;
        options.set_item("damage_options", to_python(py, &config.damage.options)?)?;
        let module = py.import("dappo_batch.model")?;
        let robot = match &config.robot_file {
            Some(path) => path.into_bound_py_any(py)?,
            None => config.robot.as_str().into_bound_py_any(py)?,
        };
        let object = module.call_method("compile_class_table", (robot,), Some(&options))?;
        let table = ClassTable::read(&object)?.with_history(config.env.history)?;
        let lanes = table.lane_table(config.env.backend)?;
        if lanes.is_ok() {
            // An unusable instruction set is an error before there is a run folder.
            simd::chosen().or_raise()?;
        }
        let integrator = py
            .import("dappo_batch.model.mujoco_library")?
            .call_method1("integrator_name", (&object,))?
            .extract()?;
        let physics = |device, precision| Physics::new(device, lanes.is_ok(), precision);
        Ok(Self {
            training: physics(config.env.device, config.env.precision),
            evaluation: physics(config.evaluation.device, config.evaluation.precision),
            lanes,
            robot: table.robot,
            history: config.env.history,
            space: table.space,
            layout: table.layout,
            table: object.unbind(),
            integrator,
            threads: config.env.threads.unwrap_or_else(available),
            room: Room { njmax: config.env.njmax, nconmax: config.env.nconmax },
            asymmetry: None,
        })
    }

    /// Name of the reward function of a configuration.
    pub fn reward_name(&self, config: &Config) -> String {
        config.env.reward.clone().unwrap_or_else(|| self.robot.reward.default.clone())
    }

    /// The backend of the configuration for this robot on the CPU.
    pub fn backend_kind(&self) -> BackendKind {
        if self.lanes.is_ok() { BackendKind::Lanes } else { BackendKind::Mujoco }
    }

    /// Turns `ppo.symmetry = "auto"` on if the robot and its task are their own mirror images, or else off. Fails if it
    /// is on and they are not.
    pub fn settle_symmetry(&mut self, config: &mut Config) -> Result<(), SimError> {
        config.ppo.symmetry = match (config.ppo.symmetry, self.reflections(config)) {
            (Symmetry::Off, _) => Symmetry::Off,
            (Symmetry::On | Symmetry::Auto, Ok(_)) => Symmetry::On,
            (Symmetry::Auto, Err(error)) => {
                self.asymmetry = Some(error.to_string());
                Symmetry::Off
            }
            (Symmetry::On, Err(error)) => {
                return Err(SimError::Config(format!(
                    "`ppo.symmetry` cannot be true: {error}; `--set ppo.symmetry=false` trains ordinary networks"
                )));
            }
        };
        Ok(())
    }

    /// How observations and actions are reflected; an error with the first difference between left and right.
    fn reflections(&self, config: &Config) -> Result<Reflections, SimError> {
        let symmetry =
            Python::attach(|py| symmetry::find(self.table.bind(py)).map_err(|error| to_sim(py, &error)))?;
        if !config.env.observe_damage {
            self.check_mixes(config, &symmetry)?;
        }
        let task = Task::new(&self.robot, &self.layout, config.env.reward.as_deref(), true)?;
        task.reflections(&symmetry, config.env.observe_damage.then_some(&self.space))
    }

    /// Refuses stages with a damage on one side alone, which a policy must tell from that on the other side.
    fn check_mixes(&self, config: &Config, symmetry: &MirroredParts) -> Result<(), SimError> {
        for (index, stage) in config.curriculum.iter().enumerate() {
            let Some(class) = stage.mix.only_class(&self.space)? else { continue };
            let class = &self.space.classes()[class];
            if self.space.mirror_image(class, &symmetry.limbs) != Some(class) {
                return Err(SimError::Config(format!(
                    "`curriculum[{index}].mix` is `{}`, which is not its own mirror image, and the policy does not \
                     observe the damage",
                    class.name
                )));
            }
        }
        Ok(())
    }

    /// Fails if a training of this configuration does not fit the memory.
    pub fn check_memory(&self, config: &Config) -> Result<(), SimError> {
        check_training(config, self.sizes(config)?, &self.layout, self.space.classes().len())
    }

    /// Why the networks are not their own mirror images where the setting left that open; `None` where they are.
    pub fn asymmetry(&self) -> Option<&str> {
        self.asymmetry.as_deref()
    }

    /// A line about what simulates: which backend, how precise, where, and why not the faster one or in what
    /// it differs from the options of the model.
    pub fn describe(&self, physics: Physics) -> String {
        let what = format!("backend {}, {}", physics.backend(), physics.precision());
        match (physics, &self.lanes) {
            (Physics::Warp(_) | Physics::Gpu(_), _) => format!("{what}, device {}", physics.device()),
            (Physics::Mujoco, Err(note)) if !note.is_empty() => format!("{what}: {note}"),
            (Physics::Lanes(_), Ok(table)) if !table.notes().is_empty() => {
                format!("{what}: {}", table.notes().join("; "))
            }
            (Physics::Lanes(_) | Physics::Mujoco, _) => what,
        }
    }

    /// The class table in Python.
    pub fn table<'py>(&self, py: Python<'py>) -> &Bound<'py, PyAny> {
        self.table.bind(py)
    }
}

impl TableFactory {
    /// A backend, for the envs of a training or for others.
    fn open(
        &self,
        num_envs: usize,
        reward: Option<&str>,
        physics: Physics,
        training: bool,
    ) -> Result<Box<dyn Backend>, SimError> {
        let options =
            BackendOptions { reward, training, num_envs, threads: self.threads, physics, room: self.room };
        Python::attach(|py| {
            ClassTable::read(self.table.bind(py))
                .and_then(|table| table.with_history(self.history)?.backend(&self.lanes, options))
                .map_err(|error| to_sim(py, &error))
        })
    }
}

#[cfg(not(feature = "gpu"))]
impl TableFactory {
    /// Why a training whose physics is on the GPU computes all else on the CPU; `None` if there is none.
    #[expect(clippy::unused_self, clippy::unnecessary_wraps, reason = "as in builds with the feature gpu")]
    pub fn task_note(&self, _: &Config) -> dappo_learn::Result<Option<String>> {
        Ok(None)
    }
}

#[cfg(feature = "gpu")]
impl TableFactory {
    /// Why a training whose physics is on the GPU computes all else on the CPU; `None` if there is none, or if the GPU
    /// computes all.
    pub fn task_note(&self, config: &Config) -> dappo_learn::Result<Option<String>> {
        let (Physics::Gpu(_), Ok(table)) = (self.training, &self.lanes) else { return Ok(None) };
        let task = Task::new(&self.robot, &self.layout, config.env.reward.as_deref(), true)?;
        match task.on_device(table, &self.space, &self.env_config(config)?) {
            Ok(_) => Ok(None),
            Err(SimError::Unsupported(reasons)) => Ok(Some(format!(
                "the GPU computes the physics alone, and the CPU observations, rewards and resets: {}",
                reasons.join("; ")
            ))),
            Err(error) => Err(error.into()),
        }
    }

    /// Whole rollouts on the GPU; `None` if something else simulates, or the kernels do not know the task.
    fn device_engine(
        &self,
        config: &Config,
        envs: &VectorEnvConfig,
    ) -> dappo_learn::Result<Option<Box<dyn RolloutEngine>>> {
        let (Physics::Gpu(precision), Ok(table)) = (self.training, &self.lanes) else { return Ok(None) };
        let task = Task::new(&self.robot, &self.layout, config.env.reward.as_deref(), true)?;
        let noise = env_keys(config.seed, config.env.num_envs);
        match GpuEnvs::new(task, table.clone(), &self.space, precision, envs.clone(), &noise) {
            Ok(envs) => Ok(Some(Box::new(GpuEngine::new(envs, config.horizon)))),
            // Physics alone is on the device then.
            Err(SimError::Unsupported(_)) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}

/// Version of the installed MuJoCo.
pub fn mujoco_version(py: Python<'_>) -> PyResult<String> {
    py.import("mujoco")?.getattr("__version__")?.extract()
}

/// A value as Python's own types, by way of JSON.
pub fn to_python<'py>(py: Python<'py>, value: &impl serde::Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(|error| raise(Kind::Config, error.to_string()))?;
    py.import("json")?.call_method1("loads", (text,))
}

impl EnvFactory for TableFactory {
    fn robot(&self) -> &Robot {
        &self.robot
    }

    fn space(&self) -> &DamageSpace {
        &self.space
    }

    fn sizes(&self, config: &Config) -> Result<Sizes, SimError> {
        let task = Task::new(&self.robot, &self.layout, config.env.reward.as_deref(), true)?;
        let code_length = if config.env.observe_damage { self.space.code_length() } else { 0 };
        Ok(Sizes {
            obs_dim: task.obs_dim() + code_length,
            privileged: task.privileged(),
            code_length,
            action_dim: self.layout.nu,
        })
    }

    fn mirror(&self, config: &Config) -> Result<Option<Reflections>, SimError> {
        (config.ppo.symmetry == Symmetry::On).then(|| self.reflections(config)).transpose()
    }

    fn integrator(&self) -> &str {
        &self.integrator
    }

    fn control_period(&self) -> f64 {
        self.layout.timestep * self.robot.frame_skip as f64
    }

    fn training_physics(&self) -> Physics {
        self.training
    }

    fn evaluation_physics(&self) -> Physics {
        self.evaluation
    }

    fn backend(
        &self,
        num_envs: usize,
        reward: Option<&str>,
        physics: Physics,
    ) -> Result<Box<dyn Backend>, SimError> {
        self.open(num_envs, reward, physics, false)
    }

    fn engine(&self, config: &Config) -> dappo_learn::Result<Box<dyn RolloutEngine>> {
        let envs = self.env_config(config)?;
        #[cfg(feature = "gpu")]
        if let Some(engine) = self.device_engine(config, &envs)? {
            return Ok(engine);
        }
        match self.training {
            Physics::Lanes(_) | Physics::Mujoco | Physics::Gpu(_) => {
                let reward = config.env.reward.as_deref();
                let backend = self.open(envs.keys.len(), reward, self.training, true)?;
                let env = VectorEnv::new(backend, &self.space, envs)?;
                Ok(Box::new(HostEngine::new(env, config)?))
            }
            Physics::Warp(device) => {
                warp::check(&self.robot, &self.layout.variants)?;
                let sizes = self.sizes(config)?;
                Ok(Box::new(WarpEngine::new(&self.table, device, self.room, config, &envs, sizes)?))
            }
        }
    }
}
