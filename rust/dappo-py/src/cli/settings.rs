//! From command-line arguments to a configuration.

use std::path::Path;

use dappo_learn::LearnError;
use dappo_learn::config::{Config, Layers};
use dappo_learn::envs::EnvFactory;
use dappo_learn::files::read_given_text;
use dappo_sim::{BackendKind, Device, Precision, SimError};
use pyo3::prelude::*;

use super::args::{ConfigArgs, SimulationArgs};
use super::console;
use crate::errors::{Kind, OrRaise, raise};
use crate::factory::TableFactory;
use crate::keywords::Flags;
use crate::warp;

/// The resolved configuration of a new run.
pub fn resolve(py: Python<'_>, arguments: &ConfigArgs) -> PyResult<Config> {
    let robots = py.import("dappo_batch.robots")?;
    let mut layers = Layers::default();
    let default: String = robots.getattr("DEFAULT_ROBOT")?.extract()?;
    layers.set("robot", default).or_raise()?;
    // As in the shipped configurations: robots of one's own are simulated in as large batches.
    layers.set("ppo.preset", "batch").or_raise()?;
    if arguments.config.is_none() {
        // The configuration that comes with the robot: its file name and text.
        let built_in = robots.call_method1("built_in_config", (arguments.robot.as_deref(),))?;
        if let Some((name, text)) = built_in.extract::<Option<(String, String)>>()? {
            layers.add_toml(&text, &name).or_raise()?;
        }
    }
    add_arguments(&mut layers, arguments).or_raise()?;
    let mut config = layers.resolve().or_raise()?;
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
        let text = read_given_text(path)
            .map_err(|error| LearnError::Invalid(format!("cannot read {}: {error}", path.display())))?;
        layers.add_toml(&text, &path.display().to_string())?;
    }
    layers.assign(&arguments.flags())?;
    layers.assign(&arguments.room.flags())?;
    if arguments.unaware {
        layers.set("env.observe_damage", false)?;
        // Without the code it does harm: the gaits of all damages are one (docs/results/go1.md).
        layers.set("damage.min_class_steps", 0)?;
    }
    let only = if arguments.healthy { Some("healthy") } else { arguments.damage.as_deref() };
    if let Some(damage) = only {
        let stage = ["name", "mix"].map(|key| (key.to_owned(), damage.into()));
        layers.set("curriculum", vec![toml::Table::from_iter(stage)])?;
    }
    layers.assign(&arguments.set)
}

/// Settles the devices and the symmetry and compiles the robot of a training. All detectable errors are refused here, before
/// there is a run folder.
pub fn ready(py: Python<'_>, config: &mut Config) -> PyResult<TableFactory> {
    config.env.device = training_device(config).or_raise()?;
    config.evaluation.device = warp::resolve(config.evaluation.device).or_raise()?;
    config.ppo.device.open().or_raise()?;
    let mut factory = TableFactory::compile(py, config)?;
    check_robot(config, &factory).or_raise()?;
    factory.settle_symmetry(config).or_raise()?;
    Ok(factory)
}

/// Checks what depends on the robot: the name of the reward, the damages of every stage, and the memory.
fn check_robot(config: &Config, factory: &TableFactory) -> Result<(), SimError> {
    factory.robot().reward(config.env.reward.as_deref())?;
    for (index, stage) in config.curriculum.iter().enumerate() {
        // A run that could not enter a later stage leaves no folder behind either.
        stage.mix.distribution(factory.space()).map_err(|error| {
            SimError::Config(format!("`curriculum[{index}].mix` cannot be used: {error}"))
        })?;
    }
    factory.check_memory(config)
}

/// The device of a training. A backend of the CPU, its double precision or a recurrent policy implies the CPU.
fn training_device(config: &Config) -> Result<Device, SimError> {
    let is_for_the_cpu = config.env.backend != BackendKind::Auto
        || config.env.precision == Precision::F64
        || config.ppo.lstm.is_some();
    if config.env.device == Device::Auto && is_for_the_cpu {
        return Ok(Device::Cpu);
    }
    warp::resolve(config.env.device)
}

/// Lays flags over the settings of an earlier run.
pub fn simulate_with(arguments: &SimulationArgs, config: &mut Config) -> dappo_learn::Result<()> {
    // Threads depend on this machine, not on that of the training.
    config.env.threads = arguments.threads();
    arguments.room.lay_over(&mut config.env);
    if let Some(backend) = arguments.backend {
        config.env.backend = backend.get();
    }
    if let Some(precision) = arguments.precision {
        config.evaluation.precision = precision.get();
    }
    if let Some(device) = arguments.device {
        config.evaluation.device = device.get();
    }
    config.evaluation.device = warp::resolve(config.evaluation.device)?;
    Ok(())
}

/// `dappo-batch config`: prints the resolved configuration.
pub fn print(py: Python<'_>, arguments: &ConfigArgs) -> PyResult<i32> {
    let config = resolve(py, arguments)?;
    // What the training would refuse is refused here too.
    ready(py, &mut config.clone())?;
    console::print(&config.to_toml().map_err(|error| raise(Kind::Config, error.to_string()))?);
    Ok(0)
}
