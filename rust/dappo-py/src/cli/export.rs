//! `dappo-batch export`.

use std::path::Path;

use dappo_learn::config::Config;
use dappo_learn::controller::{ControllerConfig, Skills};
use dappo_learn::envs::EnvFactory;
use dappo_learn::export::{Body, Contents, Export, Header, Sources, Staged};
use dappo_learn::run_folder::RunFolder;
use dappo_learn::{LearnError, Result};
use pyo3::prelude::*;

use super::args::ExportArgs;
use super::console;
use crate::controller;
use crate::errors::{Kind, from_learn, raise};
use crate::factory::TableFactory;
use crate::pool::Pool;

/// What Python knows about the robot.
struct RobotFiles {
    toml: String,
    mjcf: Vec<u8>,
    integrator: String,
    mujoco: String,
}

pub fn run(py: Python<'_>, arguments: &ExportArgs) -> PyResult<i32> {
    let wanted = arguments.controller.config().map_err(|error| from_learn(&error))?;
    Staged::check(&arguments.out).map_err(|error| from_learn(&error))?;
    let (folder, config) = RunFolder::open(&arguments.run).map_err(|error| from_learn(&error))?;
    let factory = TableFactory::compile(py, &config)?;
    let files = RobotFiles::read(py, &factory)?;
    // There is nothing here for a second one to do.
    let pool = Pool::new(Some(1))?;
    let staged = pool.run(py, || {
        let parts = arguments.controller.parts();
        let (skills, sources) = parts.load(&folder, &config, &factory)?;
        stage(&arguments.out, &skills, sources, &wanted, (&config, &factory), files)
    })?;
    let export = Export::open(staged.folder()).map_err(|error| from_learn(&error))?;
    // The copy must do without anything that lies beside the original.
    controller::open_export(py, &export, 1).map_err(|error| {
        raise(
            Kind::Config,
            format!("the robot cannot be copied, its MJCF must not need other files: {}", error.value(py)),
        )
    })?;
    staged.commit().map_err(|error| from_learn(&error))?;
    describe(export.header(), &arguments.out);
    Ok(0)
}

impl RobotFiles {
    fn read(py: Python<'_>, factory: &TableFactory) -> PyResult<Self> {
        let (toml, path) = factory.robot_files(py)?;
        let mjcf = std::fs::read(&path)
            .map_err(|source| from_learn(&LearnError::Io { path: path.clone(), source }))?;
        let mujoco = py.import("mujoco")?.getattr("__version__")?.extract()?;
        Ok(Self { toml, mjcf, integrator: factory.integrator(py)?, mujoco })
    }
}

fn stage(
    out: &Path,
    skills: &Skills,
    sources: Sources,
    controller: &ControllerConfig,
    (config, factory): (&Config, &TableFactory),
    files: RobotFiles,
) -> Result<Staged> {
    let twins = factory.backend(1, None, config.evaluation.compute())?;
    skills.check(twins.as_ref())?;
    let RobotFiles { toml, mjcf, integrator, mujoco } = files;
    let body = Body { robot: factory.robot(), toml, mjcf, task: twins.task(), integrator, mujoco };
    Contents { skills, controller, body, config, sources }.stage(out)
}

fn describe(header: &Header, out: &Path) {
    let diagnoser = &header.diagnoser;
    console::print_line(&format!(
        "{}: {} damage classes, a window of {} steps, control period {} s",
        header.robot,
        header.classes.len(),
        diagnoser.timesteps,
        header.control_period
    ));
    for (name, file) in &header.files {
        console::print_line(&format!("  {name:<24} {:>10} bytes", file.bytes));
    }
    console::print_line(&format!("{}", out.display()));
}
