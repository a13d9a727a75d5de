//! From command-line arguments to a configuration.

use std::path::Path;

use dappo_learn::config::{Config, Layers};
use dappo_sim::{BackendKind, Device, Precision, SimError};
use pyo3::prelude::*;

use super::args::{ConfigArgs, SimulationArgs};
use super::console;
use crate::errors::{Kind, from_learn, raise};
use crate::warp;

/// The resolved configuration of a new run.
pub fn resolve(py: Python<'_>, arguments: &ConfigArgs) -> PyResult<Config> {
    let robots = py.import("dappo_batch.robots")?;
    let mut layers = Layers::default();
    let default: String = robots.getattr("DEFAULT_ROBOT")?.extract()?;
    layers.set("robot", default).map_err(|error| from_learn(&error))?;
    if arguments.config.is_none() {
        // The configuration that comes with the robot: its file name and text.
        let built_in = robots.call_method1("built_in_config", (arguments.robot.as_deref(),))?;
        if let Some((name, text)) = built_in.extract::<Option<(String, String)>>()? {
            layers.add_toml(&text, &name).map_err(|error| from_learn(&error))?;
        }
    }
    add_arguments(&mut layers, arguments).map_err(|error| from_learn(&error))?;
    let mut config = layers.resolve().map_err(|error| from_learn(&error))?;
    // The run folder must find its robot file from any working directory.
    if let Some(path) =
        Path::new(&config.robot).is_file().then(|| std::path::absolute(&config.robot).ok()).flatten()
    {
        config.robot = path.display().to_string();
    }
    Ok(config)
}

/// Lays `--config` and the flags over what is there.
fn add_arguments(layers: &mut Layers, arguments: &ConfigArgs) -> dappo_learn::Result<()> {
    if let Some(path) = &arguments.config {
        let text = std::fs::read_to_string(path)
            .map_err(|source| dappo_learn::LearnError::Io { path: path.clone(), source })?;
        layers.add_toml(&text, &path.display().to_string())?;
    }
    for (key, value) in [
        ("env.num_envs", arguments.envs),
        ("total_steps", arguments.steps),
        ("seed", arguments.seed),
        ("env.threads", arguments.threads),
    ] {
        if let Some(value) = value {
            layers.set(key, value)?;
        }
    }
    for (key, value) in [
        ("robot", &arguments.robot),
        ("env.device", &arguments.device),
        ("env.backend", &arguments.backend),
        ("env.precision", &arguments.precision),
        ("ppo.device", &arguments.learner),
        ("env.reward", &arguments.reward),
        ("env.physics", &arguments.physics),
    ] {
        if let Some(value) = value {
            layers.set(key, value.as_str())?;
        }
    }
    if arguments.unaware {
        layers.set("env.observe_damage", false)?;
    }
    if arguments.healthy {
        layers.add_toml("curriculum = [{ name = 'healthy', mix = 'healthy' }]", "--healthy")?;
    }
    for assignment in &arguments.set {
        layers.set_assignment(assignment)?;
    }
    Ok(())
}

/// The device that a training means. Who asks for a backend of the CPU, or for its double precision, means the CPU.
pub fn training_device(config: &Config) -> Result<Device, SimError> {
    let is_for_the_cpu = config.env.backend != BackendKind::Auto || config.env.precision == Precision::F64;
    if config.env.device == Device::Auto && is_for_the_cpu {
        return Ok(Device::Cpu);
    }
    warp::resolve(config.env.device)
}

/// Lays flags over the settings of an earlier run.
pub fn simulate_with(arguments: &SimulationArgs, config: &mut Config) -> dappo_learn::Result<()> {
    // Threads are a matter of this machine, not of the one that trained.
    config.env.threads = arguments.threads();
    if let Some(backend) = &arguments.backend {
        config.env.backend = BackendKind::parse(backend)?;
    }
    if let Some(precision) = &arguments.precision {
        config.evaluation.precision = Precision::parse(precision)?;
    }
    if let Some(device) = &arguments.device {
        config.evaluation.device = Device::parse(device)?;
    }
    config.evaluation.device = warp::resolve(config.evaluation.device)?;
    Ok(())
}

/// `dappo-batch config`: prints the resolved configuration.
pub fn print(py: Python<'_>, arguments: &ConfigArgs) -> PyResult<i32> {
    let config = resolve(py, arguments)?;
    // Loading the robot checks its name, so that a typing error shows here and not in the training.
    py.import("dappo_batch.robots")?.call_method1("load_robot", (&config.robot,))?;
    console::print(&config.to_toml().map_err(|error| raise(Kind::Config, error.to_string()))?);
    Ok(0)
}
