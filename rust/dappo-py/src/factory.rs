//! Makes vector envs for a configuration: Python compiles the class table, Rust simulates it.

use std::path::PathBuf;

use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_sim::backend::Choice;
use dappo_sim::backend::lanes::simd;
use dappo_sim::{Backend, BackendKind, DamageSpace, Precision, Robot, SimError};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::class_table::{BackendOptions, ClassTable};
use crate::errors::{Kind, from_sim, raise};

/// The class table of a configuration.
pub struct TableFactory {
    table: Py<PyAny>,
    robot: Robot,
    space: DamageSpace,
    threads: Option<usize>,
    choice: Choice,
}

impl TableFactory {
    /// Compiles the robot of a configuration with all its damage classes.
    pub fn compile(py: Python<'_>, config: &Config) -> PyResult<Self> {
        let options = PyDict::new(py);
        options.set_item("types", config.damage.types.clone())?;
        options.set_item("max_damaged_limbs", config.damage.max_damaged_limbs)?;
        options.set_item("severity", config.damage.severity)?;
        options.set_item("physics", config.env.physics.clone())?;
        options.set_item("damage_options", to_python(py, &config.damage.options)?)?;
        let module = py.import("dappo_batch.class_table")?;
        let object = module.call_method("compile_class_table", (&config.robot,), Some(&options))?;
        let table = ClassTable::read(&object)?;
        let choice = table.choose(config.env.backend)?;
        if let Choice::Lanes(_) = choice {
            // An instruction set that cannot be used is to be known before there is a run folder.
            simd().map_err(|error| from_sim(&error))?;
        }
        Ok(Self {
            choice,
            robot: table.robot,
            space: table.space,
            table: object.unbind(),
            threads: config.env.threads,
        })
    }

    /// Name of the reward function that a configuration means.
    pub fn reward_name(&self, config: &Config) -> String {
        config.env.reward.clone().unwrap_or_else(|| self.robot.reward.default.clone())
    }

    /// The backend that the configuration means for this robot.
    pub fn backend_kind(&self) -> BackendKind {
        self.choice.kind()
    }

    /// Name of the precision in which the backend computes when `wanted` is asked for.
    pub fn precision(&self, wanted: Precision) -> &'static str {
        self.choice.precision(wanted)
    }

    /// A line about the backend: which, how precise, and why not the faster one.
    pub fn describe(&self, wanted: Precision) -> String {
        let (name, precision, note) =
            (self.backend_kind().name(), self.precision(wanted), self.choice.note());
        if note.is_empty() {
            format!("backend {name}, {precision}")
        } else {
            format!("backend {name}, {precision}: {note}")
        }
    }

    /// The class table in Python.
    pub fn table<'py>(&self, py: Python<'py>) -> &Bound<'py, PyAny> {
        self.table.bind(py)
    }

    /// The robot file as it is written, and the MJCF file that it names.
    pub fn robot_files(&self, py: Python<'_>) -> PyResult<(String, PathBuf)> {
        let robot = self.table(py).getattr("robot")?;
        Ok((robot.getattr("toml_text")?.extract()?, robot.getattr("mjcf_path")?.extract()?))
    }

    /// Integrator of the compiled models, as MuJoCo names it.
    pub fn integrator(&self, py: Python<'_>) -> PyResult<String> {
        py.import("dappo_batch.mujoco_library")?
            .call_method1("integrator_name", (self.table.bind(py),))?
            .extract()
    }
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

    fn backend(
        &self,
        num_envs: usize,
        reward: Option<&str>,
        precision: Precision,
    ) -> Result<Box<dyn Backend>, SimError> {
        let options = BackendOptions { reward, num_envs, threads: self.threads, precision };
        Python::attach(|py| {
            ClassTable::read(self.table.bind(py))
                .and_then(|table| table.backend(&self.choice, options))
                .map_err(|error| {
                    // Ctrl-C while Python code runs becomes an exception there.
                    if error.is_instance_of::<PyKeyboardInterrupt>(py) {
                        SimError::Interrupted
                    } else {
                        SimError::Config(error.value(py).to_string())
                    }
                })
        })
    }
}
