//! Makes vector envs for a configuration: Python compiles the class table, Rust simulates it.

use dappo_learn::config::Config;
use dappo_learn::envs::EnvFactory;
use dappo_sim::vector_env::{VectorEnv, VectorEnvConfig};
use dappo_sim::{DamageSpace, Robot, SimError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::class_table::ClassTable;
use crate::errors::{Kind, raise};

/// The class table of a configuration.
pub struct TableFactory {
    table: Py<PyAny>,
    robot: Robot,
    space: DamageSpace,
    threads: Option<usize>,
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
        Ok(Self {
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

    /// Integrator of the compiled models, as MuJoCo names it.
    pub fn integrator(&self, py: Python<'_>) -> PyResult<String> {
        py.import("dappo_batch.mujoco_library")?
            .call_method1("integrator_name", (self.table.bind(py),))?
            .extract()
    }
}

/// A TOML table as a Python dict, by way of JSON.
fn to_python<'py>(py: Python<'py>, table: &toml::Table) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(table).map_err(|error| raise(Kind::Config, error.to_string()))?;
    py.import("json")?.call_method1("loads", (text,))
}

impl EnvFactory for TableFactory {
    fn robot(&self) -> &Robot {
        &self.robot
    }

    fn space(&self) -> &DamageSpace {
        &self.space
    }

    fn make(&self, config: VectorEnvConfig, reward: Option<&str>) -> Result<VectorEnv, SimError> {
        let backend = Python::attach(|py| {
            ClassTable::read(self.table.bind(py))
                .and_then(|table| table.mujoco_backend(reward, config.keys.len(), self.threads))
                .map_err(|error| SimError::Config(error.value(py).to_string()))
        })?;
        VectorEnv::new(backend, &self.space, config)
    }
}
